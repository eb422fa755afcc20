"""Reads JSON files whatever is in them, and remembers which of them cannot be read."""

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from reverie_eval.ground_truth.dataset import Track, explain
from reverie_eval.linting.rows import Count, Found, fact, fault

T = TypeVar("T")


class Reader:
    """Reads files one after the other and keeps account of them."""

    def __init__(self, track: Track) -> None:
        self._track = track
        self._files = 0
        self._unreadable: list[str] = []
        self._repeated: list[str] = []

    def tracked(self, files: Sequence[Path], description: str) -> Iterable[Path]:
        """Show progress over files that are about to be read."""
        return self._track(files, description)

    def read(self, adapter: TypeAdapter[T], path: Path) -> T | None:
        """Return what a file holds, or None if it is no JSON or not of this form."""
        self._files += 1
        try:
            return adapter.validate_python(self._document(path))
        except ValidationError as error:
            self._unreadable.append(f"{path.name}: {explain(error)}")
        except (ValueError, RecursionError) as error:
            self._unreadable.append(f"{path.name}: no JSON: {error}")
        return None

    def counts(self) -> list[Count]:
        """Say how many files were read, and what kept others from being read."""
        return [
            fact("files", "files read", self._files),
            fault(
                "malformed-file",
                "files that do not have the published form",
                "Nothing in them is counted below: fetch them again first.",
                Found.among(self._unreadable, self._files),
            ),
            fault(
                "duplicate-key",
                "names given twice in one JSON object",
                "Every reader keeps one of the two values and drops the other: remove one.",
                Found(len(self._repeated), None, tuple(self._repeated)),
            ),
        ]

    def _document(self, path: Path) -> Any:
        def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
            content = dict(pairs)
            if len(content) < len(pairs):
                counts = Counter(key for key, _ in pairs)
                repeated = [key for key, count in counts.items() if count > 1]
                self._repeated.extend(f"{path.name}: {key}" for key in repeated)
            return content

        return json.loads(path.read_bytes(), object_pairs_hook=unique)
