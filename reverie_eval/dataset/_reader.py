"""Read JSON files, valid or not, and keep a record of their digests and problems."""

import gzip
import hashlib
import json
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from pydantic import TypeAdapter, ValidationError

from reverie_eval.text import first_few

T = TypeVar("T")
Progress: TypeAlias = Callable[[Sequence[Path], str], Iterable[Path]]
"""Wraps the files that are about to be read, and is given a description; it may show progress."""

_SHOWN_ERRORS = 3
_GZIP_MAGIC = b"\x1f\x8b"
_LINES = ".jsonl"


def has_lines(name: str) -> bool:
    """Whether a file of this name has a JSON object on each line."""
    return _LINES in name


def no_progress(files: Sequence[Path], description: str) -> Iterable[Path]:  # noqa: ARG001
    return files


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
            self._digests.setdefault(kind, []).append(hashlib.sha256(content).digest())
            return adapter.validate_python(self._parse(content, path.name))
        except ValidationError as error:
            reason = explain(error)
        except (gzip.BadGzipFile, EOFError, zlib.error) as error:
            reason = f"cannot be unpacked: {error}"
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
        for path in self._progress(paths, kind):
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
        if not has_lines(name):
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
