"""``reverie-eval serve [FOLDER]``: run an evaluation server.

Exit status: 0 it was stopped, 1 it refused to start, 2 it could not listen.
"""

import argparse
import gc
import shlex
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from reverie_eval_cli.submissions import write_submission

SUMMARY = "run an evaluation server; without a folder, one with the demo world"

_DEMO = Path("reverie-eval-server")
_SAMPLE = _DEMO / "sample.json"
_SAMPLE_SPLIT = "val_unseen"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.add_argument(
        "folder",
        nargs="?",
        type=Path,
        help=f"what `reverie-eval server init` made (default: ./{_DEMO}, made if need be)",
    )
    parser.add_argument("--host", default="127.0.0.1", help="(default: %(default)s)")
    parser.add_argument(
        "--port", type=_port, default=8000, help="0 for any that is free (default: %(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Serve until it is stopped."""
    from reverie_eval.server.checks import demand_sound
    from reverie_eval.server.run import run_server
    from reverie_eval.server.state import ServerState

    gc.enable()  # the installed command works without, which pays in short lives only
    folder = arguments.folder or _DEMO
    token = None if arguments.folder or _DEMO.exists() else _make_demo()
    state = ServerState.open(demand_sound(folder, _note))
    print(f"{state.settings.title}, data in {state.settings.folder}", flush=True)
    with suppress(KeyboardInterrupt):
        run_server(state, arguments.host, arguments.port, _announcement(folder, token))
    return 0


def _note(said: str) -> None:
    print(f"note: {said}", file=sys.stderr)


def _make_demo() -> str:
    """Make a server with the demo world and a sample to send to it; return its first token."""
    from reverie_eval.agents import run_agent
    from reverie_eval.ground_truth import find_ground_truth
    from reverie_eval.server.checks import database_errors
    from reverie_eval.server.folder import make_server
    from reverie_eval_cli.organising import actor, now

    with database_errors():
        token = make_server(_DEMO, now=now(), actor=actor())
    print(f"organiser's token, not shown again: {token}", flush=True)
    truth = find_ground_truth(_DEMO / "bundles", _SAMPLE_SPLIT)
    write_submission(run_agent("shortest", truth, 0), str(_SAMPLE))
    return token


def _announcement(folder: Path, token: str | None) -> Callable[[str], None]:
    """Return what says where the server listens, and how to try it or to get in."""

    def announce(url: str) -> None:
        further = _trying(url, token) if token else _signing_in(url, folder)
        print(f"listening at {url}, until Ctrl-C\n{further}", flush=True)

    return announce


def _trying(url: str, token: str) -> str:
    return (
        "try, in another terminal:\n"
        f"REVERIE_EVAL_TOKEN={token} reverie-eval submit {_SAMPLE} "
        f"--split {_SAMPLE_SPLIT} --method Shortest --publish --server {url}\n"
        f"reverie-eval leaderboard --split {_SAMPLE_SPLIT} --server {url}"
    )


def _signing_in(url: str, folder: Path) -> str:
    return (
        f"to sign in: reverie-eval login --server {url}\n"
        "for a token, also in place of a lost one: "
        f"reverie-eval server token add {shlex.quote(str(folder))} PERSON"
    )


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 0xFFFF:
        raise argparse.ArgumentTypeError(f"{text!r} is no port; give 0 to 65535")
    return int(text)
