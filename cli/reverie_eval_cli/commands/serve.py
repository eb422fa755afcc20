"""``reverie-eval serve [FOLDER]``: run an evaluation server."""

import shlex
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import click

from reverie_eval_cli import options
from reverie_eval_cli.output import note, write_text

_DEMO = Path("reverie-eval-server")
_SAMPLE = _DEMO / "sample.json"
_SAMPLE_SPLIT = "val_unseen"


@click.command()
@click.argument("folder", required=False, type=options.PATH)
# This machine alone, until somebody decides otherwise.
@options.with_default("--host", default="127.0.0.1", help="Address to listen at.")
@options.with_default(
    "--port",
    metavar="N",
    type=options.Number(0, 0xFFFF),
    default=8000,
    help="Port to listen at; 0 for any free one.",
)
@click.option(
    "--workers",
    metavar="N",
    type=options.Number(1, 64),
    help="Processes that read and score files.  [default: one per processor, at least 2]",
)
def serve(*, folder: Path | None, host: str, port: int, workers: int | None) -> None:
    """Run an evaluation server.

    FOLDER is what `reverie-eval server init` made. Without it, a server with the demo world runs in
    ./reverie-eval-server, which is made if needed.

    Exit status: 0 stopped, 1 settings or data are not sound, 2 usage or system error.
    """
    from reverie_eval.server.scoring import begin_importing

    begin_importing()  # beside what this process imports and checks
    from reverie_eval.server.operations.checks import check_sound
    from reverie_eval.server.run import WORKERS, run_server

    # A demo that is there already keeps its people and results.
    token = None if folder or _DEMO.exists() else _make_demo()
    root = folder or _DEMO
    settings = check_sound(root, note)
    print(f"{settings.title}, data in {settings.folder}", flush=True)
    with suppress(KeyboardInterrupt):
        run_server(
            settings,
            host,
            port,
            _announcement(root, settings.public_address, token),
            workers=workers or WORKERS,
        )


def _make_demo() -> str:
    """Make a server with the demo world and a sample submission; return its first token."""
    from reverie_eval.ground_truth import find_ground_truth
    from reverie_eval.runner import run_agent
    from reverie_eval.server.opening import database_errors
    from reverie_eval.server.operations.folder import make_server
    from reverie_eval.submissions import submission_text
    from reverie_eval_cli.organising import actor, now

    with database_errors():
        token = make_server(_DEMO, now=now(), actor=actor())
    # Only its digest is stored.
    print(f"organiser's token, not shown again: {token}", flush=True)
    truth = find_ground_truth(_DEMO / "bundles", _SAMPLE_SPLIT)
    write_text(submission_text(run_agent("shortest", truth, 0)), str(_SAMPLE))
    return token


def _announcement(folder: Path, public_address: str, token: str | None) -> Callable[[str], None]:
    """Return what prints where the server listens, and how to try it or to sign in."""

    def announce(url: str) -> None:
        # A person who tries the demo wants lines to copy.
        if token:
            further = (
                "try, in another terminal:\n"
                f"REVERIE_EVAL_TOKEN={token} reverie-eval submit {_SAMPLE} "
                f"--split {_SAMPLE_SPLIT} --method Shortest --publish --server {url}\n"
                f"reverie-eval leaderboard --split {_SAMPLE_SPLIT} --server {url}"
            )
        else:
            further = (
                f"to sign in: reverie-eval login --server {public_address or url}\n"
                "for a token, or to replace a lost one: "
                f"reverie-eval server token add {shlex.quote(str(folder))} PERSON"
            )
        print(f"listening at {url}, until Ctrl-C\n{further}", flush=True)

    return announce
