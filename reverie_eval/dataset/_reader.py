"""Reading JSON files, valid or not: digests, problems and their rules, the forms of records."""

import gzip
import hashlib
import json
import re
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    StringConstraints,
    TypeAdapter,
    ValidationError,
)

from reverie_eval.arrays import INT32_END, LARGEST_OBJECT_ID
from reverie_eval.dataset._rules import Count, Rule, error, info
from reverie_eval.processes import Progress, no_progress
from reverie_eval.tasks import Annotation
from reverie_eval.text import damage_text, first_few

T = TypeVar("T")


_SHOWN_ERRORS = 3
_GZIP_MAGIC = b"\x1f\x8b"


class Reader:
    """Reads files of JSON or JSON Lines, also gzipped, and records their digests and problems."""

    def __init__(self, progress: Progress = no_progress) -> None:
        self.n_files = 0
        self.unreadable: list[tuple[Path, str]] = []
        """Files that do not have the published form, with the reason."""
        self.duplicate_keys: list[str] = []
        """Keys that occur more than once in a JSON object, each after the name of its file."""
        self._progress = progress
        self._digests: dict[str, list[bytes]] = {}

    def read(self, adapter: TypeAdapter[T], path: Path, kind: str) -> T | None:
        """Return the content of a file; None if it cannot be read or does not have this form."""
        self.n_files += 1
        try:
            content = path.read_bytes()
            if content.startswith(_GZIP_MAGIC):
                content = gzip.decompress(content)
            # Of the unpacked content: a file and its gzip are one source.
            self._digests.setdefault(kind, []).append(hashlib.sha256(content).digest())
            return adapter.validate_python(self._parse(content, path.name))
        except ValidationError as error:
            reason = explain(error)
        except (gzip.BadGzipFile, EOFError, zlib.error) as error:
            reason = f"cannot be unpacked: {damage_text(error)}"
        except (ValueError, RecursionError) as error:
            reason = f"not JSON: {error}"
        except OSError as error:
            reason = f"cannot be read: {error.strerror}"
        self.unreadable.append((path, reason))
        return None

    def read_each(
        self, adapter: TypeAdapter[T], paths: Sequence[Path], kind: str
    ) -> Iterable[tuple[Path, T]]:
        """Read files one after another, showing progress; leave out those that cannot be read."""
        for path in self._progress(paths, kind, len(paths)):
            content = self.read(adapter, path, kind)
            if content is not None:
                yield path, content

    def digests(self) -> Mapping[str, str]:
        """Return SHA-256 by kind of file: of the only file, or of all digests in reading order.

        For a gzipped file, it is that of the unpacked content.
        """
        return {
            kind: (parts[0] if len(parts) == 1 else hashlib.sha256(b"".join(parts)).digest()).hex()
            for kind, parts in self._digests.items()
        }

    def _parse(self, content: bytes, name: str) -> Any:
        def build_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
            fields = dict(pairs)
            if len(fields) < len(pairs):
                counts = Counter(key for key, _ in pairs)
                repeated = [key for key, count in counts.items() if count > 1]
                self.duplicate_keys.extend(f"{name}: {key}" for key in repeated)
            return fields

        # The standard library's parser is slower than others, but shows every repeated key.
        if ".jsonl" not in name:
            return json.loads(content, object_pairs_hook=build_object)
        lines = content.splitlines()
        return [json.loads(line, object_pairs_hook=build_object) for line in lines if line.strip()]


def explain(error: ValidationError) -> str:
    """Return in one line where and how a document differs from its schema."""
    errors = error.errors(include_url=False, include_input=False)
    reasons = [": ".join(filter(None, [_path(detail["loc"]), detail["msg"]])) for detail in errors]
    return first_few(reasons, _SHOWN_ERRORS)


def _path(location: tuple[int | str, ...]) -> str:
    """Write a location as a path into the file: ``[3].objId``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return "".join(parts).lstrip(".")


# Records.


FARTHEST = 1e6
"""Largest coordinate and half extent, metres. No building is that large, though coordinates in the
frame of a map may come near. A larger number was misread, and its square might overflow."""

_OBJECT_KEY = re.compile(r"0|[1-9]\d{0,9}", re.ASCII)


def object_key(text: str) -> str:
    """Return the key of a JSON object if it is an object id.

    Raises
    ------
    ValueError
        If it is not, or has a sign or leading zeros, which the published files do not write.
    """
    if _OBJECT_KEY.fullmatch(text) and int(text) <= LARGEST_OBJECT_ID:
        return text
    raise ValueError(f"expected an object id, a whole number from 0 to {LARGEST_OBJECT_ID:,}")


class ViewpointKey(NamedTuple):
    """A viewpoint of a scan."""

    scan_id: str
    viewpoint_id: str

    def __str__(self) -> str:
        return "_".join(self)


ObjectKey = Annotated[str, AfterValidator(object_key)]
Metres = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
Position = tuple[Metres, Metres, Metres]
"""A position in the scan's own frame: x, y, and z up."""


def viewpoints_of(annotation: Annotation) -> list[ViewpointKey]:
    """Return the viewpoints of the annotated path, the start first and the goal last."""
    return [ViewpointKey(annotation.scan, viewpoint_id) for viewpoint_id in annotation.reference]


def mentioned_by(annotation: Annotation) -> set[ViewpointKey]:
    """Return all viewpoints that an annotation names, of every path and of the goals."""
    paths = [annotation.reference, *annotation.further_paths.values(), annotation.goals]
    return {ViewpointKey(annotation.scan, viewpoint_id) for path in paths for viewpoint_id in path}


def target_of(annotation: Annotation) -> int:
    """Return the target object of an annotation that has one."""
    if annotation.target is None:
        raise ValueError(f"annotation {annotation.name} has no target")
    return annotation.target


class _Published(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Viewpoint(_Published):
    """One record of ``{scan}_connectivity.json``."""

    image_id: Annotated[str, StringConstraints(pattern=r"^[^/\\]+$")]
    """Part of the names of files."""
    pose: Annotated[list[Metres], Field(min_length=16, max_length=16)]
    """Row-major 4 x 4 matrix from the camera's frame to the scan's. Its last column, elements 3, 7
    and 11, is the camera's position in metres."""
    included: bool
    unobstructed: list[bool]
    """Which viewpoints of the same file an agent can walk to from here."""

    @property
    def position(self) -> Position:
        """The camera's position in the scan's frame, metres."""
        return self.pose[3], self.pose[7], self.pose[11]


_Number = Annotated[int, msgspec.Meta(ge=-INT32_END, lt=INT32_END)]


class ObjectRecord(msgspec.Struct, frozen=True):
    """An object listed at a viewpoint. Only types are checked here; rules check the values."""

    visible_pos: list[_Number]
    """The views that show the object. If empty, the object is listed but not visible."""
    bbox2d: list[tuple[_Number, _Number, _Number, _Number]]
    """Left, top, width, height in pixels, in the order of the views."""
    name: str = ""


ANNOTATIONS = TypeAdapter(Annotated[list[Any], Field(min_length=1)])
"""An annotation file, whose records are read one by one as the task's annotations."""
CONNECTIVITY = TypeAdapter(list[Viewpoint])
BOXES = TypeAdapter(dict[str, dict[str, Any]])
"""A file of the ``BBox`` folder (key: viewpoint) or ``BBoxes.json`` (key: ``scan_viewpoint``); its
entries are read one by one as :class:`ObjectRecord`."""
OBJECT_POSITIONS = TypeAdapter(dict[str, dict[ObjectKey, Position]])
"""``objpos.json``: the centre of every object by scan and object id."""


# Rules.

FILE_RULES: Sequence[Rule[Reader]] = (
    info("files", "files read", lambda reader: Count(reader.n_files)),
    error(
        "malformed-file",
        "files that do not have the published form",
        "All other counts leave out their content, so fetch them again first.",
        lambda reader: Count.from_names(
            [f"{path.name}: {reason}" for path, reason in reader.unreadable], reader.n_files
        ),
    ),
    error(
        "duplicate-key",
        "keys that occur twice in one JSON object",
        "JSON readers keep one of the two values and drop the other: remove one.",
        lambda reader: Count.from_names(reader.duplicate_keys, None),
    ),
)
