"""``reverie-eval server invite FOLDER PERSON``: print an invitation, which is used once."""

import argparse

from reverie_eval_cli.arguments import add_expiry, add_server_folder
from reverie_eval_cli.organising import actor, after, now, show_token, writing

SUMMARY = "print an invitation, which a person turns into a token once"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)
    parser.add_argument("person", help="who is invited; `server person add` first")
    add_expiry(parser, default=14)


def run(arguments: argparse.Namespace) -> int:
    """Mint an invitation."""
    from reverie_eval.server.service.people import mint, person_named

    ends = after(arguments.expires_days)
    with writing(arguments.folder) as session:
        person = person_named(session, arguments.person)
        minted = mint(session, person, "invite", now=now(), actor=actor(), expires_at=ends)
    show_token(minted)
    return 0
