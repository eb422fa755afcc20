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
    state, scored, rejected = server.state, 0, {}
    for board in state.board(split).all:
        with state.database.reading() as session:
            jobs = outdated(session, board)
        outcomes = (state.scoring.run(rescore_one, split, board.name, job) for job in jobs)
        actor = server.person(ORGANISER)
        for job, outcome in replace_results(
            state.transactions, board, jobs, outcomes, actor=actor, reason=reason
        ):
            if isinstance(outcome, str):
                rejected[job.submission_id] = outcome
            else:
                scored += 1
    return Corrected(scored, rejected)
