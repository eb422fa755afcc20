"""A file that another team has submitted: a notice for the organiser, not a verdict."""

import logging
from urllib.parse import quote

from sqlalchemy import bindparam, select

from reverie_eval.server.audit.log import SERVER
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.messages.queue import notify
from reverie_eval.server.store.tables import IS_SHOWN, SAME_FILE, Submission, Team

MOST_NAMED = 5
"""Teams that a notice names, at most."""


_LOGGER = logging.getLogger("reverie_eval.server")


# Built here, because building it takes longer than running it, which each upload does.
_SAME_FROM_OTHERS = (
    select(Submission.id, Team.name, IS_SHOWN.label("is_shown"))
    .join(Team, Submission.team_id == Team.id)
    .where(
        Submission.split == bindparam("split"),
        Submission.sha256 == bindparam("sha256"),
        Submission.team_id != bindparam("team"),
    )
    .order_by(IS_SHOWN.desc(), Submission.received_at, Submission.id)
    .limit(MOST_NAMED)
)


def notify_of_same_file(transaction: Transaction, new: Submission) -> None:
    """Notify the organiser if another team has submitted the same file to the split.

    The same file has the same bytes after unpacking. The same predictions in another file are left
    to the report: an upload does not wait until they are compared with all others.
    """
    given = {"split": new.split, "sha256": new.sha256, "team": new.team.id}
    others = transaction.session.execute(_SAME_FROM_OTHERS, given).all()
    if not others:
        return
    same_as = [each.id for each in others]
    # About the split, not the submission, whose history its team sees.
    transaction.as_actor(SERVER).record(SAME_FILE, new, new.split, same_as=same_as)
    names = ", ".join(f"{each.name}{' (published)' * each.is_shown}" for each in others)
    whose = "other teams" if len(others) > 1 else "another team"
    text = f"{new.team.name} submitted to {new.split} the file that {whose} had submitted: {names}"
    notify(transaction, "same-file", text, f"/desk/evidence?split={quote(new.split)}")
    about = {"split": new.split, "team": new.team.id, "submission": new.id, "same_as": same_as}
    _LOGGER.warning("same file from two teams", extra={"fields": about})
