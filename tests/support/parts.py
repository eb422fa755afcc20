"""What the package installs, alone or with extras, and commands that can import nothing else."""

import json
import subprocess
import sys
from collections.abc import Collection, Iterator, Sequence
from importlib.metadata import packages_distributions, requires
from pathlib import Path
from typing import TextIO

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

_PROGRAM = """
import contextlib, io, json, sys
blocked, commands = json.loads(sys.argv[1])
sys.modules.update((name, None) for name in blocked if name not in sys.modules)
from reverie_eval_cli.main import main
for words in commands:
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(words)
    print(json.dumps([status, *(text.buffer.getvalue().decode() for text in (out, err))]))
"""


def installed_with(package: str, extras: Collection[str] = ()) -> Iterator[str]:
    """Yield the package, also with some of its extras, and everything that it needs here."""
    yield canonicalize_name(package)
    for requirement in map(Requirement, requires(package) or ()):
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": each}) for each in ("", *extras)):
            yield from installed_with(requirement.name, requirement.extras)


def blocked(extras: Collection[str] = ()) -> Sequence[str]:
    """Return what can be imported here that the package does not install with some extras."""
    installed = {*installed_with("reverie-eval", extras)}
    return [
        name
        for name, packages in packages_distributions().items()
        if installed.isdisjoint(map(canonicalize_name, packages))
    ]


def run_alone(
    commands: Sequence[Sequence[str]],
    folder: Path,
    extras: Collection[str] = (),
    stdin: TextIO | None = None,
) -> Sequence[tuple[int, str, str]]:
    """Run commands in a process that can import nothing else.

    Return the status of each, its output and what it says to standard error.
    """
    said = subprocess.check_output(
        [sys.executable, "-c", _PROGRAM, json.dumps([blocked(extras), commands])],
        cwd=folder,
        stdin=stdin,
        text=True,
    )
    return [tuple(json.loads(line)) for line in said.splitlines()]
