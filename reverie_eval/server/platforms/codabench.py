"""Write a split of a server as a competition on Codabench, for the organisers to upload there.

References
----------
Codabench c7dbc756, ``src/apps/competitions/unpackers/v2.py`` and ``compute_worker``.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import yaml

from reverie_eval.files import staged_file
from reverie_eval.schemas.service import Schedule
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.opening import opened_server
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import Settings
from reverie_eval.server.state import ServerState

_PROGRAM, _REFERENCE = "scoring_program", "reference_data"
_IMAGE = "logo.png"
_COMMAND = "python3 /app/program/scoring.py /app/input/ /app/output/"
_SECONDS_TO_SCORE = 600
_OWNER_ALONE = 0o600
"""Permissions of the file: it contains the solution."""


def export_codabench(settings: Settings, split: str, image: str, output: Path) -> Sequence[str]:
    """Write a competition bundle, and return a sentence on each thing that Codabench cannot do.

    Parameters
    ----------
    settings : Settings
        Settings of the server.
    split : str
    image : str
        A container image that has reverie-eval.
    output : Path
        The zip archive to write. It contains the solution of the split.

    Raises
    ------
    SettingsError, ReceiptError
        If the server cannot be opened.
    NotFoundError
        If there is no such split.
    OSError
        If the file cannot be written.
    """
    with opened_server(settings) as state:
        board = state.board(split)
        with state.database.reading() as session:
            schedule = state.get(Schedules).of_split(session, split).latest
        contents: Mapping[str, str | bytes] = {
            "competition.yaml": _yaml(_competition(state, board, schedule, image)),
            "pages/overview.md": _overview(board),
            "pages/terms.md": _terms(board),
            f"{_PROGRAM}/metadata.yaml": _yaml({"command": _COMMAND}),
            f"{_PROGRAM}/scoring.py": _source("platforms", "codabench_program.py"),
            _IMAGE: _source("http", "static", "preview.png"),
            f"{_REFERENCE}/rules.json": json.dumps(_rules(board)),
            f"{_REFERENCE}/bundle.npz": settings.path(board.settings.bundle).read_bytes(),
        }
        with (
            staged_file(output, mode=_OWNER_ALONE) as file,
            ZipFile(file, "w", ZIP_DEFLATED) as archive,
        ):
            for name, content in contents.items():
                archive.writestr(name, content)
        return list(_left_out(board, schedule))


def _competition(
    state: ServerState, board: Board, schedule: Schedule, image: str
) -> Mapping[str, Any]:
    return {
        "version": 2,
        "title": f"{state.settings.title}: {board.split}",
        "description": f"{board.truth.task.title}, {board.split}",
        "image": _IMAGE,
        "terms": "pages/terms.md",
        "docker_image": image,
        "registration_auto_approve": False,
        "enable_detailed_results": False,
        "can_participants_make_submissions_public": False,
        "make_programs_available": False,
        "make_input_data_available": False,
        **({"contact_email": state.settings.contact} if "@" in state.settings.contact else {}),
        "pages": [{"title": "Overview", "file": "pages/overview.md"}],
        "tasks": [
            {
                "index": 0,
                "name": board.split,
                "description": board.signature,
                "scoring_program": f"{_PROGRAM}/",
                "reference_data": f"{_REFERENCE}/",
            }
        ],
        "phases": [
            {
                "index": index,
                "name": phase.name,
                "description": f"Submissions to {board.split}",
                "start": _time(phase.opens or state.clock()),
                **({"end": _time(phase.closes)} if phase.closes else {}),
                "tasks": [0],
                "max_submissions_per_day": board.settings.effective_quota.day,
                "max_submissions": board.settings.effective_quota.year,
                "execution_time_limit": _SECONDS_TO_SCORE,
                "hide_prediction_output": True,
                "hide_score_output": schedule.holds_scores_back,
            }
            for index, phase in enumerate(schedule.phases)
        ],
        "leaderboards": [
            {
                "title": "Results",
                "key": "main",
                "submission_rule": "Add_And_Delete"
                if board.settings.one_per_team
                else "Add_And_Delete_Multiple",
                "hidden": schedule.holds_scores_back,
                "primary_index": board.headline.index(board.primary),
                "columns": [
                    {
                        "title": metric.heading,
                        "key": metric.key,
                        "index": index,
                        "sorting": "desc" if metric.better == "higher" else "asc",
                        "precision": 2,
                    }
                    for index, metric in enumerate(board.headline)
                ],
            }
        ],
    }


def _rules(board: Board) -> Mapping[str, Any]:
    return {
        "split": board.split,
        "protocol": board.settings.protocol,
        "track": board.settings.track,
        "metrics": [metric.key for metric in board.headline],
    }


def _overview(board: Board) -> str:
    task, episodes = board.truth.task, len(board.truth.episodes.instr_ids)
    rows = "\n".join(f"| {metric.heading} | {metric.definition} |" for metric in board.headline)
    return f"""# {task.title}, {board.split}

{task.citation}

Send a zip archive with one JSON file: the results of all {episodes:,} episodes of {board.split}.
Check it first: `reverie-eval validate submit.json --split {board.split}` uses no submission. A file
with mistakes is rejected, and the output of the scoring program lists them.

Scores have the signature `{board.signature}`.

| | |
|---|---|
{rows}
"""


def _terms(board: Board) -> str:
    task = board.truth.task
    return f"""The annotations are published under the {task.licence}.

Results that you put on the leaderboard are public, with the name that you give them. The submitted
file is kept by the platform and can be seen by the organisers.
"""


def _left_out(board: Board, schedule: Schedule) -> Iterator[str]:
    """Yield a sentence on each rule that a competition on Codabench does not have."""
    quota = board.settings.effective_quota
    yield f"the limit of {quota.month:,} submissions in 30 days"
    yield f"the window of 365 days: {quota.year:,} submissions are the limit of each phase"
    if schedule.holds_scores_back:
        yield "scores are hidden; show them yourself when the phase has ended"
    if board.others:
        yield f"the other leaderboards: {', '.join(board.others)}"


def _time(moment: datetime) -> str:
    """Return a time in UTC as text, because YAML's own times lose the hours there."""
    return moment.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S")


def _yaml(document: Mapping[str, Any]) -> str:
    text: str = yaml.safe_dump(document, sort_keys=False, allow_unicode=True)
    return text


def _source(*names: str) -> bytes:
    return resources.files("reverie_eval.server").joinpath(*names).read_bytes()
