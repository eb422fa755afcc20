"""``reverie-eval``: the command line.

Results go to standard output, reasons to standard error. Exit status: 0 done, 1 what was given was
rejected, 2 it could not be tried.
"""

import argparse
import io
import os
import sys
from collections.abc import Sequence

from reverie_eval import RejectedError, ReverieEvalError, SubmissionError
from reverie_eval_cli.parser import PROGRAM, complete, parse
from reverie_eval_cli.submissions import rejection

_EXPECTED = (ReverieEvalError, OSError, MemoryError, KeyboardInterrupt)
"""What may end a command and is told in a line, without a traceback."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status."""
    if "_ARGCOMPLETE" in os.environ:
        complete()
    arguments = parse(sys.argv[1:] if argv is None else argv)
    _show_any_name()
    try:
        status: int = arguments.run(arguments)
        if sys.stdout is not None:  # closed by the shell: `>&-`
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader (`| head`) has seen enough; keep Python from complaining at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except _EXPECTED as error:
        print(_reason(arguments, error), file=sys.stderr)
        return 1 if isinstance(error, RejectedError) else 2
    return status


def _show_any_name() -> None:
    """Let a file name that the terminal has no letters for be written with escapes."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _reason(arguments: argparse.Namespace, error: BaseException) -> str:
    match error:
        case SubmissionError():
            return rejection(arguments.submission, error)
        case ReverieEvalError():
            return f"{PROGRAM}: {error}"
        case OSError():
            where = "" if error.filename is None else f"{error.filename}: "
            return f"{PROGRAM}: {where}{error.strerror}"
        case MemoryError():
            return f"{PROGRAM}: out of memory, which no submission should need"
        case _:
            return f"{PROGRAM}: interrupted"
