"""Write the splits of a server as the phases and leaderboards of a challenge on EvalAI.

References
----------
EvalAI 0f0403929, ``apps/challenges/challenge_config_utils.py``.
"""

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

import yaml

from reverie_eval.schemas.service import Phase, Schedule
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.operations.checks import opened_server
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import Settings

_ONLY_HOSTS, _EVERYBODY = 1, 3
"""EvalAI's values for who sees a leaderboard."""
_NO_END = datetime(2099, 12, 31, 23, 59, 59, tzinfo=UTC)
"""The end of a phase that has none here, because EvalAI requires one."""
_FILES = ".json, .gz, .zip"


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
        "codename": f"{board.split}-{number}",
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
