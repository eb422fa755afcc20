"""Groups of commands: with help at hand, imported when needed, and one that takes a file first."""

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from click.exceptions import NoSuchCommand
from click.shell_completion import CompletionItem

_HELP = ("-h", "--help")
_LONGEST_SUMMARY = 120
# Words for our commands that others use, too far from their names for a guess by letters.
_OTHER_WORDS = {"agent": "run", "check": "validate", "evaluate": "score", "upload": "submit"}


class Group(click.Group):
    """A group that shows its help when no command is named, or the command is ``help``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Turn ``help COMMAND`` into ``COMMAND --help``."""
        if not args:
            args = ["--help"]
        elif args[0] == "help":
            args = [*(word for word in args if word != "help"), "--help"]
        return super().parse_args(ctx, args)


class LazyGroup(Group):
    """A group whose commands are imported when they are run or listed.

    ``sections`` has, by heading, the commands by name, each as ``module:attribute`` below
    ``package``.
    """

    def __init__(
        self, package: str, sections: Mapping[str, Mapping[str, str]], **settings: Any
    ) -> None:
        super().__init__(context_settings={"help_option_names": list(_HELP)}, **settings)
        self._package = package
        self._sections = sections
        self._attributes = {name: it for part in sections.values() for name, it in part.items()}

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of all commands, in the order of the help."""
        return list(self._attributes)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; an unknown name is an error that suggests a known one."""
        if cmd_name not in self._attributes:
            if ctx.resilient_parsing:  # while completing, nothing is an error
                return None
            # click suggests the closest name.
            raise NoSuchCommand(cmd_name, possibilities=self._attributes, ctx=ctx)
        module, _, attribute = self._attributes[cmd_name].partition(":")
        # Only the command that runs is imported: those of the server load a web framework.
        command: click.Command = getattr(
            importlib.import_module(f"{self._package}.{module}"), attribute
        )
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands below the headings of their sections."""
        longest = max(map(len, self._attributes))
        for heading, names in self._sections.items():
            commands = {name: self.get_command(ctx, name) for name in names}
            rows = [
                (name.ljust(longest), command.get_short_help_str(_LONGEST_SUMMARY))
                for name, command in commands.items()
                if command
            ]
            with formatter.section(heading):
                formatter.write_dl(rows)


class Program(LazyGroup):
    """The program: a first word that is not a command is a file, which ``score`` takes."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put ``score`` before a file, or before one of its options."""
        if args and args[0] not in {*self._attributes, *_HELP, "help", "--version"}:
            # ``submits`` is a slip of a command's name; ``submit.json`` and ``runs/1`` are files,
            # there or not.
            looks_like_command = args[0].isidentifier() and not Path(args[0]).exists()
            if looks_like_command and not ctx.resilient_parsing:
                message = f"{args[0]!r} is neither a command nor a file."
                if meant := _OTHER_WORDS.get(args[0]):
                    raise click.UsageError(f"{message} Did you mean {meant!r}?", ctx)
                raise NoSuchCommand(args[0], message, self._attributes, ctx)
            args = ["score", *args]
        return super().parse_args(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete a first word: to a command, a file to score, or an option of ``score``."""
        score = self.get_command(ctx, "score")
        options = score.shell_complete(ctx, incomplete) if score else []
        helps = [CompletionItem("help")] if "help".startswith(incomplete) else []
        files = [CompletionItem(str(path)) for path in Path().glob(f"{incomplete}*")]
        return [*super().shell_complete(ctx, incomplete), *helps, *options, *files]
