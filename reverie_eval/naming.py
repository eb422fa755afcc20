"""What to call submissions that are shown side by side."""

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from reverie_eval.errors import ProtocolError
from reverie_eval.reading import called

_ENDING = re.compile(r"(?<=.)(\.json)?(\.gz|\.zip)?$")


def names_of(submissions: Sequence[object]) -> Sequence[str]:
    """Name submissions by their files, as shortly as tells them apart.

    The files' names without their endings, if each has one of its own, and otherwise the parts of
    the paths that differ; where not all are files, or one is given twice, numbers.

    >>> names_of(["runs/a.json", "b.json.gz"])
    ['a', 'b']
    >>> names_of(["runs/a/test/submit.json", "runs/b/test/submit.json"])
    ['a', 'b']
    >>> names_of([b"[]", "a.json"])
    ['submission 1', 'submission 2']
    """
    files = [Path(called(each)) for each in submissions if isinstance(each, (str, os.PathLike))]
    bare = [file.with_name(_ENDING.sub("", file.name)) for file in files]
    for names in ([file.name for file in bare], _differing_parts(bare), _differing_parts(files)):
        if len(set(names)) == len(submissions):
            return names
    return [f"submission {number}" for number in range(1, len(submissions) + 1)]


def demand_texts(names: Iterable[object]) -> None:
    """Make sure that names can be shown.

    Raises
    ------
    ProtocolError
        If one of them is no text.
    """
    for name in names:
        if not isinstance(name, str):
            raise ProtocolError(f"submissions are named by texts; got {name!r}")


def _differing_parts(files: Sequence[Path]) -> Sequence[str]:
    """Write paths without what all of them begin and end with; a part of each stays."""
    paths = [list(file.parts) for file in files]
    for end in (0, -1):
        while len({path[end] for path in paths}) == 1 and min(map(len, paths)) > 1:
            for path in paths:
                path.pop(end)
    return [str(Path(*path)) for path in paths]
