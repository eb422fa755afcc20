"""Read JSON files whatever is in them, and keep an account of what was read."""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

from pydantic import TypeAdapter, ValidationError

from reverie_eval.text import first_few

T = TypeVar("T")
Progress: TypeAlias = Callable[[Sequence[Path], str], Iterable[Path]]
"""Wraps the files that are about to be read, with a description: where progress is shown."""

_SHOWN_ERRORS = 3


def no_progress(files: Sequence[Path], description: str) -> Iterable[Path]:  # noqa: ARG001
    """Show no progress."""
    return files


class UnreadableFile(NamedTuple):
    """A file that does not have the published form."""

    path: Path
    reason: str


class Reader:
    """Reads files, and remembers their digests and what was wrong with them."""

    def __init__(self, progress: Progress = no_progress) -> None:
        self.n_files = 0
        self.unreadable: list[UnreadableFile] = []
        self.duplicate_keys: list[str] = []
        """Keys that a JSON object has more than once, after the name of their file."""
        self._progress = progress
        self._digests: dict[str, list[bytes]] = {}

    def read(self, adapter: TypeAdapter[T], path: Path, kind: str) -> T | None:
        """Return what a file holds; None if it cannot be read or does not have this form."""
        self.n_files += 1
        try:
            content = path.read_bytes()
            self._digests.setdefault(kind, []).append(hashlib.sha256(content).digest())
            return adapter.validate_python(self._parse(content, path.name))
        except ValidationError as error:
            reason = explain(error)
        except (ValueError, RecursionError) as error:
            reason = f"not JSON: {error}"
        except OSError as error:
            reason = f"cannot be read: {error.strerror}"
        self.unreadable.append(UnreadableFile(path, reason))
        return None

    def read_each(
        self, adapter: TypeAdapter[T], paths: Sequence[Path], kind: str
    ) -> Iterable[tuple[Path, T]]:
        """Read files one after the other, showing progress; unreadable ones are left out."""
        for path in self._progress(paths, kind):
            content = self.read(adapter, path, kind)
            if content is not None:
                yield path, content

    def digests(self) -> Mapping[str, str]:
        """SHA-256 by kind of file: of the one file, or over the digests in reading order."""
        return {
            kind: (parts[0] if len(parts) == 1 else hashlib.sha256(b"".join(parts)).digest()).hex()
            for kind, parts in self._digests.items()
        }

    def _parse(self, content: bytes, name: str) -> Any:
        def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
            unique_pairs = dict(pairs)
            if len(unique_pairs) < len(pairs):
                counts = Counter(key for key, _ in pairs)
                repeated = [key for key, count in counts.items() if count > 1]
                self.duplicate_keys.extend(f"{name}: {key}" for key in repeated)
            return unique_pairs

        return json.loads(content, object_pairs_hook=unique)


def explain(error: ValidationError) -> str:
    """Say in a line where a document differs from its schema, and how."""
    errors = error.errors(include_url=False, include_input=False)
    reasons = [": ".join(filter(None, [_path(detail["loc"]), detail["msg"]])) for detail in errors]
    return first_few(reasons, _SHOWN_ERRORS)


def _path(location: tuple[int | str, ...]) -> str:
    """Write a location as a path into the file: ``[3].objId``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return "".join(parts).lstrip(".")
