"""Score a split's submissions again from the server's own machine, in several processes."""

import shutil
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from functools import cache, partial
from pathlib import Path
from typing import TypeAlias

from reverie_eval.files import staged_file
from reverie_eval.ground_truth import Bundle
from reverie_eval.processes import map_in_processes
from reverie_eval.schemas.organising import ResultChange
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.operations.checks import opened_server
from reverie_eval.server.service.boards import load_board, load_boards
from reverie_eval.server.service.rescoring import Job, Outcome, Scorer, changes, outdated
from reverie_eval.server.settings import Settings, Split
from reverie_eval.server.store.uploads import open_uploads

Progress: TypeAlias = Callable[[Iterable[tuple[Job, Outcome]], int], Iterable[tuple[Job, Outcome]]]
"""Shows progress while iterating over the outcomes; takes their number, too."""
FOR_ONE = 100
"""Submissions for each process: starting one takes as long as scoring about 80 of val_unseen."""


def preview(
    settings: Settings, split: str, bundle: Path | None, *, jobs: int, progress: Progress
) -> Sequence[ResultChange]:
    """Return how results would change if they were scored again; nothing is changed.

    With a bundle, this is the ground truth in place of the one that the settings name.

    Raises
    ------
    SettingsError
        If the ground truth cannot be used, or the database is not up to date.
    NotFoundError
        If the server has no such split.
    """
    if bundle is not None:
        settings = _with_bundle(settings, split, bundle)
    with opened_server(settings) as state:
        board = state.board(split)
        with state.database.reading() as session:
            found = outdated(session, board)
        with closing(_score(found, settings=settings, split=split, jobs=jobs)) as outcomes:
            scored = _collect(progress(zip(found, outcomes, strict=True), len(found)))
        with state.database.reading() as session:
            return changes(session, board, scored)


def rescore(
    settings: Settings, split: str, reason: str, *, actor: str, jobs: int, progress: Progress
) -> Sequence[ResultChange]:
    """Score all submissions again that were scored with other ground truth or rules.

    Returns how results changed, also those that an interrupted run replaced.

    Raises
    ------
    SettingsError, NotFoundError
        As :func:`preview`.
    """
    with opened_server(settings) as state:
        board = state.board(split)
        with state.database.reading() as session:
            found = outdated(session, board)
        with closing(_score(found, settings=settings, split=split, jobs=jobs)) as outcomes:
            replaced = state.rescoring.replace_results(actor, board, reason, found, outcomes)
            scored = _collect(progress(replaced, len(found)))
        with state.database.reading() as session:
            return changes(session, board, scored)


def _score(
    found: Sequence[Job], *, settings: Settings, split: str, jobs: int
) -> Generator[Outcome]:
    """Score many submissions in several processes, each of which loads the ground truth."""
    work = partial(_score_one, settings.folder, settings.uploads, split, settings.splits[split])
    return map_in_processes(work, found, min(jobs, 1 + len(found) // FOR_ONE))


def _score_one(folder: Path, uploads: str, split: str, rules: Split, job: Job) -> Outcome:
    return _scorer(folder, uploads, split, rules)(job)


@cache
def _scorer(folder: Path, uploads: str, split: str, rules: Split) -> Scorer:
    board = load_board(split, rules, folder / rules.bundle)
    return Scorer(board, open_uploads(uploads, folder))


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
        raise NotFoundError(
            f"there is no split {split!r} here; there are: {', '.join(settings.splits)}"
        )
    changed = settings.splits[split].model_copy(update={"bundle": str(bundle.absolute())})
    return settings.model_copy(update={"splits": {**settings.splits, split: changed}})
