"""Files of people: CSV with a team, a person, an e-mail address and a role in each line."""

import csv
import io
from collections.abc import Sequence

from reverie_eval.schemas.joining import PersonInvitation
from reverie_eval.server.service.leaderboard import spreadsheet_cell


def invitations_csv(invitations: Sequence[PersonInvitation]) -> str:
    """Return invitations as CSV, for a program that mails them."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("team", "person", "email", "invitation", "expires"))
    for each in invitations:
        expires = None if each.expires_at is None else each.expires_at.isoformat()
        cells = (each.team, each.person, each.email, each.token, expires)
        writer.writerow(map(spreadsheet_cell, cells))
    return text.getvalue()
