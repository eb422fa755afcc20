"""A challenge on EvalAI: a server's splits as its phases and leaderboards, and how it scores.

The files are scored on the organiser's machine, so the solution stays there. EvalAI's own worker
fetches them and calls :func:`evaluate`.

References
----------
EvalAI 0f0403929, ``apps/challenges/challenge_config_utils.py`` and ``apps/jobs/views.py``;
EvalAI-Starters 8a282bad, ``remote_challenge_evaluation``.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from reverie_eval.errors import ReverieEvalError, SubmissionError
from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.service import Phase, Schedule
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.opening import opened_server
from reverie_eval.server.platforms.scores import displayed_scores
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import Settings, load_settings
from reverie_eval.submissions import unpack

_ONLY_HOSTS, _EVERYBODY = 1, 3
"""EvalAI's values for who sees a leaderboard."""
_NO_END = datetime(2099, 12, 31, 23, 59, 59, tzinfo=UTC)
"""The end of a phase that has none here, because EvalAI requires one."""
_FILES = ".json, .gz, .zip"
_LOGGER = logging.getLogger("reverie_eval.server")


class ChallengeConfig(NamedTuple):
    """A server's splits in the configuration of a challenge."""

    text: str
    """YAML, for ``challenge_config.yaml``."""
    left_out: Sequence[str]
    """A sentence on each thing that EvalAI cannot do."""


def export_evalai(settings: Settings) -> ChallengeConfig:
    """Write the phases, splits and leaderboards that the worker reports results for.

    Raises
    ------
    SettingsError, ReceiptError
        If the server cannot be opened.
    """
    with opened_server(settings) as state:
        with state.database.reading() as session:
            timetables = state.get(Schedules).read(session)
        boards = list(state.boards.values())
        schedules = {board.split: timetables[board.split].latest for board in boards}
        phases = [(board, phase) for board in boards for phase in schedules[board.split].phases]
        document = {
            "remote_evaluation": True,
            "leaderboard": [_leaderboard(i, board) for i, board in enumerate(boards, 1)],
            "dataset_splits": [
                {"id": i, "name": board.split, "codename": board.split}
                for i, board in enumerate(boards, 1)
            ],
            "challenge_phases": [
                _phase(i, board, phase, schedules[board.split], state.clock())
                for i, (board, phase) in enumerate(phases, 1)
            ],
            "challenge_phase_splits": [
                _phase_split(i, 1 + boards.index(board), board, schedules[board.split])
                for i, (board, _) in enumerate(phases, 1)
            ],
        }
    left_out = [each for board in boards for each in _left_out(board, schedules[board.split])]
    return ChallengeConfig(yaml.safe_dump(document, sort_keys=False, allow_unicode=True), left_out)


def _leaderboard(number: int, board: Board) -> Mapping[str, Any]:
    return {
        "id": number,
        "schema": {
            "labels": [metric.label for metric in board.headline],
            "default_order_by": board.primary.label,
            "metadata": {
                metric.label: {
                    "sort_ascending": metric.better != "higher",
                    "description": metric.definition,
                }
                for metric in board.headline
            },
        },
    }


def _phase(
    number: int, board: Board, phase: Phase, schedule: Schedule, now: datetime
) -> Mapping[str, Any]:
    quota, closes = board.settings.effective_quota, phase.closes or _NO_END
    return {
        "id": number,
        "name": f"{board.split}: {phase.name}",
        "description": f"templates/challenge_phase_{number}_description.html",
        "codename": f"{board.split}-{number}",  # evaluate() gets it
        "leaderboard_public": not schedule.holds_scores_back,
        "is_public": True,
        "is_submission_public": False,
        "is_restricted_to_select_one_submission": board.settings.one_per_team,
        "start_date": _time(phase.opens or min(now, closes)),
        "end_date": _time(closes),
        "max_submissions_per_day": quota.day,
        "max_submissions_per_month": quota.month,
        "max_submissions": quota.year,
        "allowed_submission_file_types": _FILES,
    }


def _phase_split(phase: int, split: int, board: Board, schedule: Schedule) -> Mapping[str, Any]:
    return {
        "challenge_phase_id": phase,
        "leaderboard_id": split,
        "dataset_split_id": split,
        "visibility": _ONLY_HOSTS if schedule.holds_scores_back else _EVERYBODY,
        "leaderboard_decimal_precision": 2,
        "is_leaderboard_order_descending": board.primary.better == "higher",
        "show_execution_time": False,
        "show_leaderboard_by_latest_submission": False,
        "show_scores_on_leaderboard": not schedule.holds_scores_back,
    }


def _left_out(board: Board, schedule: Schedule) -> Iterator[str]:
    """Yield a sentence on each of a split's rules that a challenge on EvalAI does not have."""
    quota = board.settings.effective_quota
    yield (
        f"{board.split}: quotas for any 24 hours, 30 and 365 days; EvalAI counts by calendar day "
        f"and month, and allows {quota.year:,} submissions in each phase"
    )
    if schedule.holds_scores_back:
        yield f"{board.split}: the date from which scores are shown; show them after the phase"
    if board.others:
        yield f"{board.split}: the other leaderboards {', '.join(board.others)}"


def _time(moment: datetime) -> datetime:
    """Return a time in UTC without its zone, as in EvalAI's files."""
    return moment.astimezone(UTC).replace(tzinfo=None, microsecond=0)


def evaluate(
    folder: str | PathLike[str], submission: str | PathLike[str], phase_codename: str
) -> Mapping[str, Any]:
    """Score a file that was sent to EvalAI, as the server would.

    Parameters
    ----------
    folder : path
        The server's folder. Its server need not run.
    submission : path
        The file.
    phase_codename : str
        The phase that it was sent to, as :func:`export_evalai` names it.

    Returns
    -------
    mapping
        ``result``: what EvalAI's leaderboard of the split displays, by its labels.

    Raises
    ------
    SubmissionError
        If the file is rejected. EvalAI shows the message to the participant.
    ReverieEvalError
        If the evaluation fails for another reason. It says no more, because the participant sees
        that message, too; the log has the reason.
    """
    try:
        with opened_server(load_settings(Path(folder))) as state:
            board = state.board(phase_codename.rpartition("-")[0])
            with state.database.reading() as session:
                schedule = state.get(Schedules).of_split(session, board.split).latest
            limit = state.settings.limits.unpacked_mebibytes << 20
            report = board.scored(unpack(Path(submission).read_bytes(), limit)).report
        scores = displayed_scores(report, [metric.key for metric in board.headline])
    except SubmissionError:
        raise
    except Exception:
        _LOGGER.exception("submission to EvalAI could not be scored")
        raise ReverieEvalError(
            "the evaluation failed, but not because of the file; the organisers can see why, and "
            "can run the submission again"
        ) from None
    result = {
        "split": board.split,
        "show_to_participant": not schedule.holds_scores_back,
        "accuracies": {CATALOGUE[key].label: value for key, value in scores.items()},
    }
    return {"result": [result]}
