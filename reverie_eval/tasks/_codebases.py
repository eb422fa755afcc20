"""Public codebases: by which protocol their numbers are reproduced, and what their files look like.

What is known stands in ``codebases.toml``, and nowhere else.
"""

import re
from collections.abc import Sequence
from datetime import date
from functools import cache
from pathlib import Path

import msgspec
from msgspec import Struct

from reverie_eval.errors import ProtocolError
from reverie_eval.files import parse_toml
from reverie_eval.tasks._registry import BUILT_IN, find_task

_FILE = Path(__file__).with_name("codebases.toml")
_ON_GITHUB = re.compile(r"github\.com[:/]([^/]+/[^/]+)")
# How similar an unknown name must be to be asked about: FAST is not FSTTA.
_CLOSE = 0.7


class _Tried(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Code that was executed, or only read."""

    executed: date | None = None
    """When it was last run here; None if it was only read."""

    @property
    def standing(self) -> str:
        """Whether it was executed, and when."""
        return "read" if self.executed is None else f"executed {self.executed}"


class CodebaseEvaluator(_Tried, frozen=True, kw_only=True):
    """How a codebase scores one task."""

    task: str
    protocol: str
    """The protocol of the task that gives the same values for every episode, apart from
    ``differs``."""
    source: str
    """The file and lines in the repository; empty if it has no evaluator for the task."""
    differs: str = ""
    """What the evaluator does otherwise than the protocol, as sentences."""


class CodebaseFile(_Tried, frozen=True, kw_only=True):
    """What a codebase's own result writer writes."""

    name: str = ""
    """The name of the file, with ``{split}``."""
    form: str
    """The records, trajectories and answers, in a sentence."""
    example: str = ""
    """A record as the writer wrote it, on made-up viewpoints; empty if it was only read."""


class Codebase(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A public repository that scores a task, or writes files to be scored."""

    name: str
    """What papers and tables call the method."""
    repository: str
    """``owner/name`` on GitHub."""
    commit: str
    """The commit that was executed or read."""
    also: Sequence[str] = ()
    """Other names that the codebase is known by."""
    evaluator: Sequence[CodebaseEvaluator] = ()
    """How the codebase scores, for each task that it does."""
    file: Sequence[CodebaseFile] = ()
    """What the codebase writes, for each form of a file."""

    @property
    def names(self) -> Sequence[str]:
        """Everything that the codebase can be looked up by."""
        return [self.name, *self.also, self.repository, self.repository.partition("/")[2]]


class _Codebases(Struct, frozen=True, forbid_unknown_fields=True):
    codebase: Sequence[Codebase]


@cache
def codebases() -> Sequence[Codebase]:
    """Return all codebases, by name."""
    found = msgspec.convert(parse_toml(_FILE.read_text("utf-8")), _Codebases)
    return sorted(found.codebase, key=lambda each: each.name.casefold())


def find_codebase(name: str) -> Codebase:
    """Return a codebase by its name, another name, or its repository; case does not matter.

    Raises
    ------
    ProtocolError
        If there is none; the message suggests the closest.

    Examples
    --------
    >>> find_codebase("vln-duet").name, find_codebase("git@github.com:cshizhe/VLN-DUET.git").name
    ('DUET', 'DUET')
    """
    from difflib import get_close_matches  # slow to import, and only needed in errors

    address = _ON_GITHUB.search(name)
    wanted = (name if address is None else address[1]).strip("/").removesuffix(".git").casefold()
    by_name = {key.casefold(): each for each in codebases() for key in each.names}
    if wanted in by_name:
        return by_name[wanted]
    scored = [task for task in map(find_task, BUILT_IN) if task.has_protocol(name)]
    if scored:
        options = " or ".join(f"--task {task.name} --protocol {name}" for task in scored)
        raise ProtocolError(f"{name!r} is a protocol itself: score with {options}")
    close = get_close_matches(wanted, by_name, n=1, cutoff=_CLOSE)
    guess = f"did you mean {by_name[close[0]].name}? " if close else ""
    raise ProtocolError(f"unknown codebase {name!r}; {guess}`reverie-eval protocol` lists all")
