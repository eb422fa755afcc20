"""Scoring again on the server of a test, as the command does in one of its own."""

from typing import NamedTuple

from reverie_eval.server.corrections.corrections import outdated, replace_results, rescore_one
from tests.support.serving import OPEN, ORGANISER, Serving

WHY = "The target of a task was corrected."


class Corrected(NamedTuple):
    """The outcome of scoring a split's submissions again, over all its leaderboards."""

    scored: int
    rejected: dict[str, str]
    """Why submissions kept their earlier results."""


def rescored(server: Serving, split: str = OPEN, reason: str = WHY) -> Corrected:
    """Score everything again that was scored by other ground truth or rules."""
    state, scored = server.state, 0
    rejected: dict[str, str] = {}
    for board in state.board(split).all:
        with state.database.reading() as session:
            jobs = outdated(session, board)
        outcomes = {job: state.scoring.run(rescore_one, split, board.name, job) for job in jobs}
        with state.transactions.begin(server.person(ORGANISER)) as transaction:
            replace_results(transaction, board, reason, outcomes)
        told = {job.submission_id: why for job, why in outcomes.items() if isinstance(why, str)}
        rejected |= told
        scored += len(jobs) - len(told)
    return Corrected(scored, rejected)
