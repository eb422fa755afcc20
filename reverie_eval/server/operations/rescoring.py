"""Score a split's submissions again from the server's own machine, in several processes."""

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple, TypeAlias

from reverie_eval.files import staged_file
from reverie_eval.ground_truth import Bundle
from reverie_eval.processes import map_in_processes
from reverie_eval.schemas.organising import ResultChange
from reverie_eval.server.errors import no_split
from reverie_eval.server.operations.checks import opened_server
from reverie_eval.server.service.boards import Board, load_board, load_boards
from reverie_eval.server.service.rescoring import Job, Outcome, changes, outdated, score_again
from reverie_eval.server.service.scoring import Context
from reverie_eval.server.settings import Settings, Split
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.uploads import open_uploads

Progress: TypeAlias = Callable[[Iterable[tuple[Job, Outcome]], int], Iterable[tuple[Job, Outcome]]]
"""Shows progress while iterating over the outcomes; takes their number, too."""
FOR_ONE = 100
"""Submissions for each process: starting one takes as long as scoring about 80 of val_unseen."""


def preview(
    settings: Settings, split: str, bundle: Path | None, *, jobs: int, progress: Progress
) -> Sequence[ResultChange]:
    """Return how results would change if they were scored again; nothing is changed.

    Those on the split's own leaderboard come first, then those on each further one.

    If a bundle is given, it replaces the ground truth that the settings name.

    Raises
    ------
    SettingsError
        If the ground truth cannot be used, or the database is not up to date.
    NotFoundError
        If the server has no such split.
    """
    if bundle is not None:
        settings = _with_bundle(settings, split, bundle)
    found: list[ResultChange] = []
    with opened_server(settings) as state:
        for board in state.board(split).all:
            with _scoring(state, board, jobs) as (waiting, outcomes):
                scored = _collect(progress(zip(waiting, outcomes, strict=True), len(waiting)))
            with state.database.reading() as session:
                found += changes(session, board, scored)
    return found


def rescore(
    settings: Settings, split: str, reason: str, *, actor: str, jobs: int, progress: Progress
) -> Sequence[ResultChange]:
    """Score all submissions again that were scored with other ground truth or rules.

    Returns how results changed, including those that an interrupted run replaced.

    Raises
    ------
    SettingsError, NotFoundError
        As :func:`preview`.
    """
    found: list[ResultChange] = []
    with opened_server(settings) as state:
        for board in state.board(split).all:
            with _scoring(state, board, jobs) as (waiting, outcomes):
                replaced = state.rescoring.replace_results(actor, board, reason, waiting, outcomes)
                scored = _collect(progress(replaced, len(waiting)))
            new = {job.submission_id for job in waiting if not job.was_scored}
            with state.database.reading() as session:
                found += changes(session, board, scored, first_results=new)
    return found


@contextmanager
def _scoring(
    state: ServerState, board: Board, jobs: int
) -> Iterator[tuple[Sequence[Job], Iterable[Outcome]]]:
    """Score what is outdated on a leaderboard in processes that each load the ground truth."""
    with state.database.reading() as session:
        waiting = outdated(session, board)
    settings = state.settings
    rules = settings.splits[board.name].model_dump_json()
    source = _Source(settings.folder, settings.uploads, board.name, board.further, rules)
    processes = min(jobs, 1 + len(waiting) // FOR_ONE)
    with closing(map_in_processes(partial(_score_one, source), waiting, processes)) as outcomes:
        yield waiting, outcomes


class _Source(NamedTuple):
    """What a process needs to score; the key of a cache."""

    folder: Path
    uploads: str
    split: str
    further: str
    rules: str
    """The split's settings as JSON."""


def _score_one(source: _Source, job: Job) -> Outcome:
    return score_again(_context(source), source.split, source.further, job)


@cache
def _context(source: _Source) -> Context:
    rules = Split.model_validate_json(source.rules)
    board = load_board(source.split, rules, source.folder / rules.bundle)
    return Context({source.split: board}, open_uploads(source.uploads, source.folder))


def _collect(outcomes: Iterable[tuple[Job, Outcome]]) -> Mapping[str, Outcome]:
    return {job.submission_id: outcome for job, outcome in outcomes}


def install_bundle(settings: Settings, split: str, bundle: Path) -> Path:
    """Replace a split's ground truth; return where the earlier one is kept.

    Raises
    ------
    SettingsError
        If the server cannot start with it.
    NotFoundError
        If the server has no such split.
    """
    load_boards(_with_bundle(settings, split, bundle))
    place = settings.path(settings.splits[split].bundle)
    earlier = Bundle.load(place).header.fingerprint[:12]
    aside = place.with_name(f"{place.stem}.{earlier}{place.suffix}")
    shutil.copy2(place, aside)
    with staged_file(place) as file, bundle.open("rb") as new:
        shutil.copyfileobj(new, file)
    return aside


def _with_bundle(settings: Settings, split: str, bundle: Path) -> Settings:
    """Return settings with another bundle for a split."""
    if split not in settings.splits:
        raise no_split(split, settings.splits)
    changed = settings.splits[split].model_copy(update={"bundle": bundle.absolute()})
    return settings.model_copy(update={"splits": {**settings.splits, split: changed}})
