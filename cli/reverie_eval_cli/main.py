"""``reverie-eval``: the command line.

Results go to standard output, reasons to standard error. Exit status: 0 done, 1 what was given was
rejected, 2 it could not be tried.
"""

import argparse
import os
import sys
from collections.abc import Sequence

from reverie_eval import RejectedError, ReverieEvalError, SubmissionError
from reverie_eval_cli.parser import PROGRAM, complete, parse


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status."""
    if "_ARGCOMPLETE" in os.environ:
        complete()
    arguments = parse(sys.argv[1:] if argv is None else argv)
    try:
        status: int = arguments.run(arguments)
        if sys.stdout is not None:  # closed by the shell: `>&-`
            sys.stdout.flush()
    except RejectedError as error:
        return _fail(f"{_subject(arguments, error)}: {error}", 1)
    except BrokenPipeError:
        # The reader (`| head`) has seen enough; keep Python from complaining at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except ReverieEvalError as error:
        return _fail(f"{PROGRAM}: {error}", 2)
    except OSError as error:
        where = "" if error.filename is None else f"{error.filename}: "
        return _fail(f"{PROGRAM}: {where}{error.strerror}", 2)
    except KeyboardInterrupt:
        return _fail(f"{PROGRAM}: interrupted", 2)
    return status


def _subject(arguments: argparse.Namespace, error: RejectedError) -> str:
    if not isinstance(error, SubmissionError):
        return PROGRAM
    return "standard input" if arguments.submission == "-" else str(arguments.submission)


def _fail(reason: str, status: int) -> int:
    print(reason, file=sys.stderr)
    return status
