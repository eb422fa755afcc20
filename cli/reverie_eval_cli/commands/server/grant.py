"""``reverie-eval server grant FOLDER TEAM SPLIT N --reason TEXT``: give further submissions."""

import argparse
from datetime import timedelta

from reverie_eval.text import count_text
from reverie_eval_cli.arguments import add_server_folder, days, positive_number
from reverie_eval_cli.organising import actor, minute, now, writing

SUMMARY = "give a team further submissions, with the reason in the audit log"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)
    parser.add_argument("team")
    parser.add_argument("split")
    parser.add_argument(
        "number", type=positive_number, help="by which each limit of the quota is raised"
    )
    parser.add_argument("--reason", required=True, metavar="TEXT", help="for the audit log")
    parser.add_argument(
        "--days",
        metavar="N",
        type=days,
        default=30,
        help="how long the limits stay raised (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Raise the limits."""
    from reverie_eval.server.service.grants import grant
    from reverie_eval.server.settings import load_settings

    begins = now()
    ends = begins + timedelta(days=arguments.days)
    splits = load_settings(arguments.folder).splits
    with writing(arguments.folder) as session:
        grant(
            session,
            arguments.team,
            arguments.split,
            arguments.number,
            splits=splits,
            reason=arguments.reason,
            now=begins,
            expires_at=ends,
            actor=actor(),
        )
    further = count_text(arguments.number, "further submission")
    print(f"{arguments.team}: {further} to {arguments.split} until {minute(ends)} UTC")
    return 0
