"""A submission's scores for leaderboards on other platforms: the digits that ours show."""

from collections.abc import Mapping, Sequence

from reverie_eval.errors import Problem, SubmissionError
from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.report import ScoreReport


def displayed_scores(report: ScoreReport, metrics: Sequence[str]) -> Mapping[str, float]:
    """Return the values of a leaderboard's metrics as they are displayed, by their keys.

    Raises
    ------
    SubmissionError
        If the file has no answers and a metric needs them. Other platforms would show a missing
        value at the top of the leaderboard.
    """
    missing = [CATALOGUE[key].label for key in metrics if key not in report.scores]
    if missing:
        message = (
            f"no record has an answer, so there is no {' and no '.join(missing)}, which this "
            "leaderboard shows; add the answers"
        )
        raise SubmissionError([Problem("navigation-only", "file", message)])
    return {key: float(CATALOGUE[key].display(report.scores[key])) for key in metrics}
