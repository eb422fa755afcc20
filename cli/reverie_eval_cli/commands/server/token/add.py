"""``reverie-eval server token add FOLDER PERSON``: print a new token, which is shown once."""

import argparse

from reverie_eval_cli.arguments import add_expiry, add_server_folder
from reverie_eval_cli.organising import actor, after, now, show_token, writing

SUMMARY = "print a new token of a person; it is kept as a digest and cannot be shown again"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)
    parser.add_argument("person", help="whose; `server person add` first")
    add_expiry(parser, default=None)


def run(arguments: argparse.Namespace) -> int:
    """Mint a token."""
    from reverie_eval.server.service.people import mint, person_named

    ends = after(arguments.expires_days)
    with writing(arguments.folder) as session:
        person = person_named(session, arguments.person)
        minted = mint(session, person, "access", now=now(), actor=actor(), expires_at=ends)
    show_token(minted)
    return 0
