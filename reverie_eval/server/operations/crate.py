"""The description of a site, or of exported tables, for archives: RO-Crate metadata.

References
----------
RO-Crate Metadata Specification 1.1, https://w3id.org/ro/crate/1.1.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

from reverie_eval.server.state import ServerState
from reverie_eval.tasks import Task
from reverie_eval.version import __version__

METADATA = "ro-crate-metadata.json"
_SPECIFICATION = "https://w3id.org/ro/crate/1.1"
_SOFTWARE = "#reverie-eval"
"""The id of the software that made the files."""
_FIRST_PAGE = "index.html"
"""Together with the software, this identifies an earlier site."""
_KINDS = {
    "text/html": "Page",
    "text/csv": "Leaderboard as a table, one row for each result",
    "application/json": "Data for programs",
    "application/atom+xml": "Feed of news and results",
    "text/plain": "Text for papers and tools",
}


@dataclass(frozen=True, slots=True)
class File:
    """A file of a site or an export."""

    name: str
    """Relative to the folder."""
    media_type: str
    size: int
    """Bytes."""
    address: str = ""
    """For a page, its path and query on the server."""
    title: str = ""


@dataclass(frozen=True, slots=True)
class Crate:
    """The description of a folder of files, for archives."""

    contents: str
    """What the files are: ``The public pages``."""
    title: str
    address: str
    """The server's address; may be empty."""
    date: datetime
    files: Sequence[File]
    papers: Mapping[str, str]
    """Names of methods by the addresses of their papers."""
    tasks: Sequence[Task]

    @classmethod
    def of(cls, contents: str, state: ServerState, files: Sequence[File]) -> Self:
        """Describe files with what a server shows."""
        papers: dict[str, str] = {}
        with state.database.reading() as session:
            for board in state.boards.values():
                ranking = state.ranking(session, board)
                for row in (*ranking.rows, *ranking.apart):
                    if row.entry.method["paper"]:
                        papers.setdefault(row.entry.method["paper"], row.entry.method["name"])
        settings = state.settings
        now = state.clock()
        origin = settings.title, settings.public_address, now
        return cls(contents, *origin, files, papers, state.tasks)

    def document(self) -> Mapping[str, Any]:
        """Return the metadata as JSON-LD."""
        return {"@context": f"{_SPECIFICATION}/context", "@graph": list(self._graph())}

    def _graph(self) -> Iterator[Mapping[str, Any]]:
        yield {
            "@id": METADATA,
            "@type": "CreativeWork",
            "about": {"@id": "./"},
            "conformsTo": {"@id": _SPECIFICATION},
        }
        benchmarks = [_benchmark(task) for task in self.tasks]
        known = {each["@id"] for each in benchmarks}
        papers = [
            {"@id": paper, "@type": "ScholarlyArticle", "name": f"Paper of {method}"}
            for paper, method in sorted(self.papers.items())
            if paper not in known
        ]
        citations = [*benchmarks, *papers]
        yield {
            "@id": "./",
            "@type": "Dataset",
            "name": f"{self.title}: leaderboards",
            "description": f"{self.contents} of an evaluation server of the {self._benchmarks}"
            f"{f', {self.address},' if self.address else ''} as they were on "
            f"{self.date:%Y-%m-%d %H:%M} UTC: leaderboards, submissions and rules.",
            "datePublished": self.date.isoformat(),
            "license": "The organiser of the server decides how these files may be used.",
            **({"url": self.address} if self.address else {}),
            "citation": [{"@id": each["@id"]} for each in citations],
            "hasPart": [{"@id": quote(file.name)} for file in self.files],
            "creator": {"@id": _SOFTWARE},
        }
        yield {
            "@id": _SOFTWARE,
            "@type": "SoftwareApplication",
            "name": "reverie-eval",
            "softwareVersion": __version__,
        }
        yield from citations
        yield from map(self._entity, self.files)

    @property
    def _benchmarks(self) -> str:
        titles = ", ".join(task.title for task in self.tasks)
        return f"{titles} benchmark{'s' if len(self.tasks) > 1 else ''}"

    def _entity(self, file: File) -> Mapping[str, Any]:
        kind = _KINDS.get(file.media_type, "Part of the pages")
        return {
            "@id": quote(file.name),
            "@type": "File",
            "name": file.title or file.name,
            **({"description": f"{kind}: {file.address}"} if file.address else {}),
            "encodingFormat": file.media_type,
            "contentSize": str(file.size),
        }


def _benchmark(task: Task) -> Mapping[str, Any]:
    """Return what to cite for a task."""
    if task.paper is not None:
        return {
            "@id": task.paper.url,
            "@type": "ScholarlyArticle",
            "name": task.paper.title,
            "datePublished": task.paper.year,
        }
    return {"@id": f"https://{task.source}", "@type": "CreativeWork", "name": task.citation}


def is_crate_of_ours(file: Path) -> bool:
    """Return whether a file is the description of a site that this module wrote."""
    try:
        graph = json.loads(file.read_bytes())["@graph"]
        return {_SOFTWARE, _FIRST_PAGE} <= {entity["@id"] for entity in graph}
    except (OSError, ValueError, KeyError, TypeError):
        return False
