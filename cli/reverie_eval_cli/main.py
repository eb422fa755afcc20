"""``reverie-eval``: the command line.

Results go to standard output, reasons to standard error. Exit status: 0 done, 1 input rejected,
2 usage or system error.
"""

import io
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

import click

from reverie_eval import RejectedError, ReverieEvalError
from reverie_eval.errors import naming_missing_parts
from reverie_eval.version import __version__
from reverie_eval_cli.groups import Program

PROGRAM = "reverie-eval"
COMPLETION_VARIABLE = "_REVERIE_EVAL_COMPLETE"
"""The environment variable in which a shell asks for completions."""

program = click.version_option(__version__, message="%(prog)s %(version)s")(
    Program(
        "reverie_eval_cli.commands",
        {
            "Check and score": {
                "score": "score:score",
                "validate": "submissions:validate_submission",
                "compare": "compare:compare",
                "report": "compare:report",
                "figure": "paper:figure",
                "table": "paper:table",
                "check-table": "paper:check_table",
                "plan": "compare:plan",
                "protocol": "protocol:protocol",
                "subset": "submissions:draw_episodes",
                "convert": "submissions:convert_submission",
                "export": "export:export",
            },
            "Train and run an agent": {
                "simulator": "shell:simulator",
                "run": "run:run_agent",
                "train": "training:train",
            },
            "Send to an evaluation server": {
                "login": "evaluation_server:login",
                "submit": "evaluation_server:submit",
                "leaderboard": "evaluation_server:leaderboard",
                "verify": "evaluation_server:verify",
            },
            "Prepare ground truth": {
                "compile": "dataset:compile_bundle",
                "lint": "dataset:lint",
                "describe": "dataset:describe",
                "boxes": "dataset:boxes",
            },
            "Run an evaluation server": {
                "serve": "serve:serve",
                "server": "server:server",
            },
            "Further help": {
                "demo": "submissions:write_samples",
                "schema": "shell:schema",
                "completion": "shell:completion",
            },
        },
        options_metavar="",
        subcommand_metavar="SUBMISSION|COMMAND [OPTIONS]",
        help="""Score submissions to the REVERIE benchmark.

        \b
          reverie-eval submit.json --split val_unseen     score a result file
          reverie-eval validate submit.json --split test  check it before sending it
          reverie-eval help submit                        explain a command

        A first word that is not a command is a file to score. Without ground truth
        of your own (`reverie-eval compile`), the demo world is used, for which
        `reverie-eval demo` writes sample files.

        Exit status: 0 done, 1 input rejected, 2 usage or system error.
        """,
    )
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status."""
    # Python has no stream for what the shell closed: `>&-`.
    sys.stdout, sys.stderr = (
        stream or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
        for stream in (sys.stdout, sys.stderr)
    )
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A file's name may have characters that the terminal's encoding lacks.
            stream.reconfigure(errors="backslashreplace")
    status = 0
    try:
        status = _status(sys.argv[1:] if argv is None else list(argv))
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader (`| head`) has seen enough. What is still buffered goes nowhere, so that
        # Python does not complain at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return status


def _status(words: list[str]) -> int:
    """Run the command; print why it failed in a line, without a traceback."""
    try:
        # A shell starts the program at each press of the tab key.
        if instruction := os.environ.get(COMPLETION_VARIABLE):
            from click.shell_completion import shell_complete

            return shell_complete(program, {}, PROGRAM, COMPLETION_VARIABLE, instruction)
        with naming_missing_parts(), program.make_context(PROGRAM, words) as context:
            status: int | None = program.invoke(context)
            return status or 0
    # Returned, not raised as SystemExit: tests call this function.
    except click.exceptions.Exit as finished:  # after --help and --version
        return finished.exit_code
    except click.ClickException as error:
        with suppress(OSError):  # a closed or full standard error leaves the exit status
            error.show()
        return error.exit_code
    except BrokenPipeError:
        raise
    except (ReverieEvalError, OSError, MemoryError, KeyboardInterrupt) as error:
        with suppress(OSError):  # as above
            print(f"{PROGRAM}: {_reason(error)}", file=sys.stderr)
        # 1 says that the input is wrong, so scripts can tell it from a server that is down.
        return 1 if isinstance(error, RejectedError) else 2


def _reason(error: BaseException) -> str:
    match error:
        case OSError():
            where = "" if error.filename is None else f"{error.filename}: "
            return f"{where}{error.strerror or error}"
        case MemoryError():
            return "out of memory, which no submission should need"
        case KeyboardInterrupt():
            return "interrupted"
        case _:
            return str(error)
