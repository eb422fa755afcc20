"""The two grammars: a file to score with its options, or a command with its own.

A first word that is a command's name is that command; anything else is a file to score.
"""

import argparse
import os
from collections.abc import Mapping, Sequence
from importlib import import_module
from types import ModuleType
from typing import Any

from reverie_eval import __version__
from reverie_eval_cli.commands import score

PROGRAM = "reverie-eval"
COMMANDS = (
    "compare",
    "report",
    "validate",
    "login",
    "submit",
    "leaderboard",
    "verify",
    "convert",
    "agent",
    "compile",
    "boxes",
    "lint",
    "describe",
    "serve",
    "server",
    "schema",
    "completion",
)
"""Each is a module of its name, imported when it is wanted: a file is scored without them."""


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Parse a command line; the result's ``run`` is what to do.

    Exits with status 2, usage on stderr, if the words make no sense.
    """
    if not words or words[0] not in COMMANDS:
        return _score_parser().parse_args(words)
    name, *rest = words
    module = _module(name)
    if hasattr(module, "commands"):
        return _command_parser().parse_args(words)
    parser = argparse.ArgumentParser(prog=f"{PROGRAM} {name}", description=module.SUMMARY)
    _declare(parser, module)
    return parser.parse_intermixed_args(rest)  # files may stand before and after an option


def complete() -> None:
    """Answer the shell's question for completions, which comes in the environment."""
    import argcomplete

    line = os.environ["COMP_LINE"][: int(os.environ["COMP_POINT"])]
    finished = line.split()[1:] if line.endswith(" ") else line.split()[1:-1]
    if finished and finished[0] in COMMANDS:
        argcomplete.autocomplete(_command_parser())
    words = () if finished else COMMANDS
    completer: Any = _WordsAndFiles(words)
    argcomplete.autocomplete(_score_parser(), default_completer=completer)


class _WordsAndFiles:
    """Completes to files, and to words that may stand in a file's place."""

    def __init__(self, words: Sequence[str]) -> None:
        self._words = words

    def __call__(self, prefix: str, **context: object) -> list[str]:
        from argcomplete.completers import FilesCompleter

        words = [word for word in self._words if word.startswith(prefix)]
        return words + list(FilesCompleter()(prefix, **context))


def _score_parser() -> argparse.ArgumentParser:
    parser = _ScoreParser(
        prog=PROGRAM,
        description="Score a submission to the REVERIE benchmark.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    score.add_arguments(parser)
    parser.set_defaults(run=score.run)
    return parser


class _ScoreParser(argparse.ArgumentParser):
    """Lists the commands in its help, which alone needs to know what they all do."""

    def format_help(self) -> str:
        """Return the help, the commands below it."""
        commands = "\n".join(f"  {name:12}{one.SUMMARY}" for name, one in _modules().items())
        self.epilog = (
            f"commands ({PROGRAM} COMMAND --help):\n{commands}\n\n"
            "exit status: 0 done, 1 what was given was rejected, 2 it could not be tried"
        )
        return super().format_help()


def _modules() -> Mapping[str, ModuleType]:
    return {name: _module(name) for name in COMMANDS}


def _module(name: str) -> ModuleType:
    return import_module(f"reverie_eval_cli.commands.{name}")


def _command_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=PROGRAM)
    _add_commands(parser, _modules())
    return parser


def _add_commands(parser: argparse.ArgumentParser, commands: Mapping[str, ModuleType]) -> None:
    """Add commands; a module that has commands of its own is a group of them."""
    adding = parser.add_subparsers(required=True, title="commands", metavar="COMMAND")
    for name, module in commands.items():
        command = adding.add_parser(name, description=module.SUMMARY, help=module.SUMMARY)
        if hasattr(module, "commands"):
            _add_commands(command, module.commands())
        else:
            _declare(command, module)


def _declare(parser: argparse.ArgumentParser, module: ModuleType) -> None:
    """Add what a command takes, and what it does."""
    module.add_arguments(parser)
    parser.set_defaults(run=module.run)
