"""The bundle file: everything that scoring one split needs, as plain arrays.

A bundle is an ``.npz`` file (without pickle) with a JSON header. One file per split makes privacy a
matter of files: a *public* bundle does not contain the solution at all.
"""

import errno
import hashlib
import os
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import msgspec
import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import Array, frozen, read_arrays, take_prefixed
from reverie_eval.errors import GroundTruthError, ProtocolError
from reverie_eval.files import staged_file
from reverie_eval.tasks import DEFAULT_TASK, Task, find_task

CUSTOM_DATASET = "custom"
"""Name of a dataset that is not a known release."""

FORMAT_VERSION = 1

PUBLIC_ARRAYS: Mapping[str, str] = MappingProxyType(
    {
        "instr_id": "U",  # (n_episodes,)
        "episode_task": "i4",  # (n_episodes,) row of the episode's item
        "task_start": "i4",  # (n_items,) viewpoint
        "scan_id": "U",  # (n_scans,)
        "viewpoint_id": "U",  # (n_viewpoints,) scan by scan
        "viewpoint_scan": "i4",  # (n_viewpoints,)
        "viewpoint_position": "f8",  # (n_viewpoints, 3) metres
        "distance": "f8",  # all pairs of each scan's viewpoints, end to end
        "edge": "b1",  # the same
    }
)
SOLUTION_ARRAYS: Mapping[str, str] = MappingProxyType(
    {
        "path": "i4",  # annotated paths, end to end
        "path_offsets": "i8",  # (n_items + 1,)
    }
)
TARGET_ARRAYS: Mapping[str, str] = MappingProxyType(
    {
        "task_target": "i4",  # (n_items,) object id within the scan
        "candidate_viewpoint": "i4",  # (n_candidates,) ordered by viewpoint, then object
        "candidate_object": "i4",  # (n_candidates,) object id, visible from the viewpoint
        "box_candidate": "i4",  # (n_boxes,) row of the candidate in the box
        "box_view": "u1",  # (n_boxes,) view index, 0 to 35
        "box_xywh": "i2",  # (n_boxes, 4) pixels of the 640 x 480 view
    }
)
"""All of them are in a bundle with the solution, if its task has target objects."""
OPTIONAL_SOLUTION_ARRAYS: Mapping[str, str] = MappingProxyType(
    {
        "candidate_distance": "f8",  # (n_candidates,) metres from camera to object centre
        "target_position": "f8",  # (n_items, 3) metres: the target's centre, inf if unknown
    }
)
GOAL_ARRAYS: Mapping[str, str] = MappingProxyType(
    {
        "goal_viewpoint": "i4",  # annotated goals of the items, end to end
        "goal_offsets": "i8",  # (n_items + 1,)
        "goal_outline": "f8",  # (n_goals, 5, 2) turns: the target as seen there
    }
)
"""Parts of the solution, if the task annotates goals besides paths. Further annotated paths are in
arrays like ``path/planner`` and ``path_offsets/planner``, of the types of ``path`` and
``path_offsets``."""
UNSCORED_ARRAYS: Mapping[str, str] = MappingProxyType(
    {
        "viewpoint_rotation": "f4",  # (n_viewpoints, 3, 3) from the camera's frame to the scan's
        "task_heading": "f8",  # (n_items,) radians: where the agent looks at the start
    }
)
"""Public arrays that no score depends on; they are not part of the fingerprint."""
PUBLIC_TEXTS = frozenset({"instruction", "language"})
"""Texts that are public; languages only in a task of several."""
_INSTRUCTION = "instruction"
TARGET_TEXTS = frozenset({"target_category", "candidate_category"})
"""Texts of the solution, if the task has target objects."""
_HEADER = "header"
_OTHER_SPLIT = "other_split/"
# Less what the process's umask takes away.
_FOR_EVERYONE = 0o666
_FOR_ITS_OWNER = 0o600
_TEXT = "text/"


@dataclass(frozen=True, slots=True)
class BundleHeader:
    """The description of a bundle and its sources."""

    split: str
    dataset: str
    """The release: ``REVERIE v1``, ``demo``, ``custom``."""
    sources: Mapping[str, str]
    """SHA-256 of the annotations, boxes and connectivity files it was compiled from."""
    fingerprint: str
    """SHA-256 of the arrays, as :func:`_fingerprint_of` computes it."""
    task: str = DEFAULT_TASK
    """The name of the task; headers of the default task do not have it."""
    episodes: tuple[str, ...] = ()
    """The instr_ids of a declared sample, which alone is scored; headers of a whole split do not
    have them. The arrays are those of the split, so its fingerprint stays, and so does a signature
    that names the sample."""
    format_version: int = FORMAT_VERSION


class _AnyHeader(msgspec.Struct):
    """The part of a header that all format versions share, so that any of them can be named."""

    format_version: int


@dataclass(frozen=True, eq=False)
class Bundle:
    """The contents of a bundle file; its arrays are read-only."""

    header: BundleHeader
    arrays: Mapping[str, Array]
    other_splits: Mapping[str, Array] = field(default_factory=dict)
    """The instr_ids of the dataset's other splits: used in messages, not in scores."""
    texts: Mapping[str, Array] = field(default_factory=dict)
    """Instructions and categories, as :func:`pack_texts` returns them: not used in scores."""

    @classmethod
    def build(
        cls,
        split: str,
        dataset: str,
        sources: Mapping[str, str],
        arrays: Mapping[str, Array],
        other_splits: Mapping[str, Array],
        *,
        texts: Mapping[str, Array] = MappingProxyType({}),
        task: str = DEFAULT_TASK,
        episodes: tuple[str, ...] = (),
    ) -> Self:
        """Build a bundle from arrays, each converted to the type that the format defines."""
        formats = {**PUBLIC_ARRAYS, **SOLUTION_ARRAYS, **TARGET_ARRAYS, **OPTIONAL_SOLUTION_ARRAYS}
        formats |= {**GOAL_ARRAYS, **UNSCORED_ARRAYS}
        # ``path/planner`` has the type of ``path``.
        typed = {
            name: frozen(array.astype(formats[name.partition("/")[0]]))
            for name, array in arrays.items()
        }
        header = BundleHeader(split, dataset, dict(sources), _fingerprint_of(typed), task, episodes)
        return cls(header, typed, other_splits, texts)

    @property
    def is_public(self) -> bool:
        """Whether the bundle has no solution."""
        return not SOLUTION_ARRAYS.keys() & self.arrays.keys()

    def public(self) -> Self:
        """Return the bundle without the solution."""
        arrays = {name: self.arrays[name] for name in (*PUBLIC_ARRAYS, *UNSCORED_ARRAYS)}
        # A digest of private annotations would let anyone check a guess of them.
        sources = {"connectivity": self.header.sources["connectivity"]}
        texts = {name: text for name, text in self.texts.items() if name in PUBLIC_TEXTS}
        return self.build(
            self.header.split,
            self.header.dataset,
            sources,
            arrays,
            self.other_splits,
            texts=texts,
            task=self.header.task,
            episodes=self.header.episodes,
        )

    def of_sample(self, instr_ids: Sequence[str]) -> Self:
        """Return the bundle of a declared sample of its episodes."""
        return replace(self, header=replace(self.header, episodes=tuple(instr_ids)))

    def save(self, path: Path) -> None:
        """Write the bundle; the file appears complete or not at all.

        A new file with the solution is readable only by its owner.
        """
        members: dict[str, Array] = {
            _HEADER: np.frombuffer(msgspec.json.encode(self._written_header), np.uint8)
        }
        members |= self.arrays
        members |= {_OTHER_SPLIT + split: ids for split, ids in self.other_splits.items()}
        members |= {_TEXT + name: text for name, text in self.texts.items()}
        if not path.parent.is_dir():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
        # As np.savez, but without dates: the same contents give the same bytes.
        mode = _FOR_EVERYONE if self.is_public else _FOR_ITS_OWNER
        with staged_file(path, mode=mode) as file, zipfile.ZipFile(file, "w") as archive:
            for name, array in members.items():
                with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)

    @property
    def _written_header(self) -> Mapping[str, object]:
        """The header as a file has it: REVERIE's are the same bytes as before there were tasks."""
        written = asdict(self.header)
        if self.header.task == DEFAULT_TASK:
            del written["task"]
        if not self.header.episodes:
            del written["episodes"]
        return written

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a bundle and check that it is complete; errors are those of `GroundTruth.load`."""
        try:
            members = read_arrays(path)
            header = _read_header(path, members.pop(_HEADER).tobytes())
        except (ValueError, KeyError, msgspec.DecodeError) as error:
            raise GroundTruthError(
                f"{path} is not a ground-truth bundle, or is damaged; `reverie-eval compile` "
                "creates one"
            ) from error
        # What is taken out here is not scored, and so not a part of the fingerprint below.
        other_splits = take_prefixed(members, _OTHER_SPLIT)
        texts = take_prefixed(members, _TEXT)
        has_targets = _task_of(path, header).has_targets
        needed = {*SOLUTION_ARRAYS, *(TARGET_ARRAYS if has_targets else ())}
        # All of the solution or none: half of one is neither a public bundle nor one that scores.
        is_complete = members.keys() >= PUBLIC_ARRAYS.keys() | UNSCORED_ARRAYS.keys() and (
            needed & members.keys() in (set(), needed)
        )
        is_complete &= _INSTRUCTION in texts and (
            texts.keys() >= TARGET_TEXTS or not TARGET_ARRAYS.keys() & members.keys()
        )
        is_complete &= is_complete and set(header.episodes) <= set(members["instr_id"].tolist())
        if not is_complete or _fingerprint_of(members) != header.fingerprint:
            raise GroundTruthError(
                f"{path} is damaged: its contents do not match its header; compile it again"
            )
        arrays = {name: frozen(array) for name, array in members.items()}
        return cls(header, arrays, other_splits, texts)


def bundle_name(split: str, *, public: bool) -> str:
    """Return the name of a split's bundle in a folder of bundles."""
    return f"{split}.public.npz" if public else f"{split}.npz"


def pack_texts(texts: Sequence[str]) -> Array:
    """Return texts as a bundle stores them: the bytes of a JSON list."""
    # An array of str would give every text the space of the longest, four bytes per letter.
    return np.frombuffer(msgspec.json.encode(texts), np.uint8)


def unpack_texts(packed: Array, what: str, count: int) -> tuple[str, ...]:
    """Return the ``count`` texts that :func:`pack_texts` packed; errors call them ``what``."""
    try:
        texts = msgspec.json.decode(packed.tobytes(), type=tuple[str, ...])
    except msgspec.DecodeError:
        texts = ()
    if len(texts) != count:
        raise GroundTruthError(f"the {what} of this ground truth are damaged; compile it again")
    return texts


def _fingerprint_of(arrays: Mapping[str, Array]) -> str:
    """Return the SHA-256 of the names, types, shapes and bytes of scored arrays, by name."""
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        if name in UNSCORED_ARRAYS:
            continue
        # Distances are hashed in single precision: C libraries differ in the last bit of some,
        # and the same dataset must have the same fingerprint on every machine.
        hashed = array.astype("f4") if name == "distance" else np.ascontiguousarray(array)
        # Name, type and shape too: equal bytes of another shape are another array.
        digest.update(f"{name} {hashed.dtype.str} {hashed.shape}\n".encode())
        digest.update(hashed.data)
    return digest.hexdigest()


def _read_header(path: Path, header: bytes) -> BundleHeader:
    # The version is read alone first: a newer header may have fields that this one cannot read.
    version = msgspec.json.decode(header, type=_AnyHeader).format_version
    if version == FORMAT_VERSION:
        return msgspec.json.decode(header, type=BundleHeader)
    raise GroundTruthError(
        f"{path} has bundle format {version}, this version of reverie-eval reads format "
        f"{FORMAT_VERSION}; compile it again"
    )


def _task_of(path: Path, header: BundleHeader) -> Task:
    try:
        return find_task(header.task)
    except ProtocolError as error:
        raise GroundTruthError(
            f"{path} is the ground truth of a task that is not installed: {error}"
        ) from error
