"""The published dataset on disk: where its files are, and what is in them.

Layout of a clone of the dataset repository::

    tasks/REVERIE/data/REVERIE_{split}.json
    tasks/REVERIE/data/BBox/{scan}_{viewpoint}.json     or BBoxes.json, all of them in one file
    connectivity/{scan}_connectivity.json

Each of the three may lie elsewhere.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self, TypeAlias, TypeVar

from pydantic import TypeAdapter, ValidationError

from reverie_eval.errors import DatasetError, Problem
from reverie_eval.schemas.dataset import (
    ANNOTATIONS,
    BOXES,
    CONNECTIVITY,
    OBJECT_POSITIONS,
    ObjectBoxes,
    Position,
    Task,
    Viewpoint,
)
from reverie_eval.wording import some

T = TypeVar("T")
Track: TypeAlias = Callable[[Sequence[Path], str], Iterable[Path]]
"""Wraps a sequence of files about to be read, with a description: where progress is shown."""

_DATA = Path("tasks", "REVERIE", "data")
_ONE_FILE = "BBoxes.json"
_ANY_SPLIT = "REVERIE_*.json"
_CONNECTIVITY = "_connectivity.json"
_SHOWN_ERRORS = 3


def untracked(files: Sequence[Path], description: str) -> Iterable[Path]:  # noqa: ARG001
    """Show no progress."""
    return files


def connectivity_file(folder: Path, scan_id: str) -> Path:
    """Return where a scan's navigation graph is in the folder of connectivity files."""
    return folder / f"{scan_id}{_CONNECTIVITY}"


def connectivity_files(folder: Path) -> Mapping[str, Path]:
    """Return the files of all navigation graphs in a folder, by scan."""
    paths = sorted(folder.glob(f"*{_CONNECTIVITY}"))
    return {path.name.removesuffix(_CONNECTIVITY): path for path in paths}


@dataclass(frozen=True, slots=True)
class DatasetFiles:
    """Where a split's published files are."""

    annotations: Path
    boxes: Path
    """The ``BBox`` folder, or one file with all boxes."""
    connectivity: Path
    object_positions: Path | None = None
    """``objpos.json``, for the protocol that measures the distance to the object."""
    published_annotations: Path | None = None
    """The clone's folder of annotations: where other splits' are if a private file lies alone."""

    @classmethod
    def find(
        cls,
        split: str | None,
        root: Path | None = None,
        *,
        annotations: Path | None = None,
        boxes: Path | None = None,
        connectivity: Path | None = None,
        object_positions: Path | None = None,
    ) -> Self:
        """Locate the files below a clone's root, or where they are pointed at.

        Parameters
        ----------
        split : str or None
            The split whose annotations are meant; None for the first one that is there.
        root : Path, optional
            A clone of the dataset repository, for whatever is not pointed at.
        annotations : Path, optional
            ``REVERIE_{split}.json``, or the folder that holds it.
        boxes : Path, optional
            The ``BBox`` folder, or DUET's ``BBoxes.json``.
        connectivity : Path, optional
            The folder of ``{scan}_connectivity.json`` files.
        object_positions : Path, optional
            A file with the centres of all objects; never looked for by itself.

        Raises
        ------
        DatasetError
            Naming each of them that is not there.
        """
        annotations = annotations or _below(root, _DATA)
        if annotations and not annotations.is_file():
            annotations = _annotations_in(annotations, split)
        boxes = boxes or _first_that_exists(
            _below(root, _DATA / "BBox"), _below(root, _DATA / _ONE_FILE)
        )
        if boxes and (boxes / _ONE_FILE).is_file():
            boxes = boxes / _ONE_FILE
        connectivity = connectivity or _below(root, Path("connectivity"))
        found = {"annotations": annotations, "boxes": boxes, "connectivity": connectivity}
        if object_positions:
            found["object-positions"] = object_positions
        problems = [_missing_input(*item) for item in found.items() if not _exists(item[1])]
        if problems or not (annotations and boxes and connectivity):
            raise DatasetError(problems)
        return cls(annotations, boxes, connectivity, object_positions, _below(root, _DATA))

    def all_annotations(self) -> Mapping[str, Path]:
        """Return the annotation files in the same folder, this one's among them, by split."""
        paths = {self.annotations, *self.annotations.parent.glob(_ANY_SPLIT)}
        return {_split_of(path): path for path in sorted(paths)}

    def other_annotations(self) -> Mapping[str, Path]:
        """Return the annotation files of other splits, in the same folder and in the clone."""
        published = self.published_annotations
        paths = [] if published is None else sorted(published.glob(_ANY_SPLIT))
        others = {**{_split_of(path): path for path in paths}, **self.all_annotations()}
        return {split: path for split, path in others.items() if path != self.annotations}


def _split_of(annotations: Path) -> str:
    return annotations.stem.removeprefix("REVERIE_")


class Sources:
    """Reads published files, remembers their digests, and collects what is wrong with them."""

    def __init__(self, files: DatasetFiles, track: Track = untracked) -> None:
        self.files = files
        self.problems: list[Problem] = []
        self._track = track
        self._digests: dict[str, list[bytes]] = {}

    def tasks(self) -> list[Task]:
        """Read the split's annotations."""
        return self._read(ANNOTATIONS, self.files.annotations, "annotations") or []

    def graphs(self, scans: Sequence[str]) -> dict[str, list[Viewpoint]]:
        """Read the connectivity of the scans; one without a file is a problem and left out."""
        paths = {scan: connectivity_file(self.files.connectivity, scan) for scan in scans}
        missing = [scan for scan, path in paths.items() if not path.is_file()]
        if missing:
            self.report(
                "missing-scan",
                self.files.connectivity,
                f"no connectivity file for {len(missing)} of {len(scans)} scans: "
                f"{some(missing)}; copy the dataset's whole connectivity folder",
            )
        present = {scan: path for scan, path in paths.items() if scan not in missing}
        tracked = self._track(list(present.values()), "navigation graphs")
        graphs = (self._read(CONNECTIVITY, path, "connectivity") for path in tracked)
        return {
            scan: graph for scan, graph in zip(present, graphs, strict=True) if graph is not None
        }

    def boxes(self, scans: Sequence[str]) -> dict[str, dict[str, ObjectBoxes]]:
        """Read the objects seen from each viewpoint of the scans."""
        wanted = set(scans)
        seen: dict[str, dict[str, ObjectBoxes]] = {}
        if self.files.boxes.is_file():
            for key, objects in (self._read(BOXES, self.files.boxes, "boxes") or {}).items():
                if _scan(key) in wanted:
                    seen[key.rpartition("_")[2]] = objects
            return seen
        paths = [path for path in self.files.boxes.glob("*.json") if _scan(path.stem) in wanted]
        for path in self._track(sorted(paths), "boxes"):
            objects_at = self._read(BOXES, path, "boxes")
            seen |= objects_at or {}
        return seen

    def object_positions(self) -> dict[str, dict[str, Position]] | None:
        """Read the centres of the objects by scan, if they are given."""
        path = self.files.object_positions
        return self._read(OBJECT_POSITIONS, path, "object_positions") if path else None

    def other_splits(self) -> dict[str, list[str]]:
        """Read the instr_ids of the dataset's other splits, as far as their files can be read."""
        splits = {}
        for split, path in self.files.other_annotations().items():
            try:
                tasks = ANNOTATIONS.validate_json(path.read_bytes())
            except (ValidationError, OSError):
                continue  # A help for messages only: another split's fault is not this one's.
            splits[split] = [instr_id for task in tasks for instr_id in task.instr_ids]
        return splits

    def digests(self) -> dict[str, str]:
        """SHA-256 of the annotations, and over the digests of the other files in reading order."""
        return {
            kind: (parts[0] if len(parts) == 1 else hashlib.sha256(b"".join(parts)).digest()).hex()
            for kind, parts in self._digests.items()
        }

    def report(self, code: str, where: Path | str, message: str) -> None:
        """Note a problem, to be raised with all others."""
        self.problems.append(Problem(code, str(where), message, (len(self.problems),)))

    def raise_problems(self) -> None:
        """Raise what was noted, if anything was."""
        if self.problems:
            raise DatasetError(self.problems)

    def _read(self, adapter: TypeAdapter[T], path: Path, kind: str) -> T | None:
        content = path.read_bytes()
        self._digests.setdefault(kind, []).append(hashlib.sha256(content).digest())
        try:
            return adapter.validate_json(content)
        except ValidationError as error:
            self.report("malformed-file", path, explain(error))
            return None


def _scan(scan_and_viewpoint: str) -> str:
    return scan_and_viewpoint.rpartition("_")[0]


def _annotations_in(folder: Path, split: str | None) -> Path:
    if split is None:
        return min(folder.glob(_ANY_SPLIT), default=folder / _ANY_SPLIT)
    return folder / f"REVERIE_{split}.json"


def _below(root: Path | None, path: Path) -> Path | None:
    return root / path if root else None


def _exists(path: Path | None) -> bool:
    return path is not None and path.exists()


def _first_that_exists(*paths: Path | None) -> Path | None:
    return next((path for path in paths if _exists(path)), paths[0])


def _missing_input(kind: str, path: Path | None) -> Problem:
    return Problem(
        "missing-input",
        kind if path is None else str(path),
        f"no {kind} found here; give a clone of the dataset repository, or point at them "
        f"with --{kind}",
    )


def explain(error: ValidationError) -> str:
    """Say in a line where a document differs from its schema, and how."""
    errors = error.errors(include_url=False, include_input=False)
    reasons = [": ".join(filter(None, [_place(detail["loc"]), detail["msg"]])) for detail in errors]
    return f"not the published format: {some(reasons, _SHOWN_ERRORS)}"


def _place(location: tuple[int | str, ...]) -> str:
    """Write a place as a path into the file: ``[3].objId``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return "".join(parts).lstrip(".")
