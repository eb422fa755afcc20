"""Score a split's submissions again from the server's own machine, in several processes."""

import shutil
import stat
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

from sqlalchemy.orm import Session

from reverie_eval.errors import ReverieEvalError, SubmissionError
from reverie_eval.files import staged_file
from reverie_eval.ground_truth import Bundle
from reverie_eval.progress import Progress, no_progress
from reverie_eval.schemas.organising import ResultChange
from reverie_eval.server.corrections.corrections import (
    Job,
    Outcome,
    changes,
    outdated,
    rejected,
    replace_at_once,
    replace_results,
    rescore_one,
)
from reverie_eval.server.errors import BusyError, no_split
from reverie_eval.server.opening import opened_server
from reverie_eval.server.scoring.boards import Board, load_boards
from reverie_eval.server.scoring.contexts import Scoring
from reverie_eval.server.scoring.processes import ScoringProcesses
from reverie_eval.server.scoring.rules import LastRules, append_rules, different, rules_of
from reverie_eval.server.settings import Settings
from reverie_eval.server.state import ServerState

FOR_ONE = 100
"""Submissions for each process: starting one takes as long as scoring some dozens of them."""
_SCORING = "scoring again"


class Replaced(NamedTuple):
    """How results changed when ground truth was replaced."""

    changes: Sequence[ResultChange]
    earlier: Path
    """Where the earlier ground truth is kept."""


def preview(
    settings: Settings, split: str, bundle: Path | None, *, jobs: int, progress: Progress
) -> Sequence[ResultChange]:
    """Return how results would change if they were scored again; nothing is changed.

    Those on the split's main leaderboard come first, then those on each other one.

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
            outcomes = _score(state, board, _outdated(state, board), jobs, progress)
            with state.database.reading() as session:
                found += changes(session, board, _named(outcomes))
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
            waiting = _outdated(state, board)
            with _scoring(state, board, waiting, jobs) as outcomes:
                replaced = replace_results(
                    state.transactions, board, waiting, outcomes, actor=actor, reason=reason
                )
                scored = dict(progress(replaced, _SCORING, len(waiting)))
            with state.database.reading() as session:
                found += changes(session, board, _named(scored), first_results=_first(waiting))
    return found


def replace_ground_truth(
    settings: Settings,
    split: str,
    bundle: Path,
    reason: str,
    *,
    actor: str,
    jobs: int,
    progress: Progress,
) -> Replaced:
    """Replace a split's ground truth, and with it all results, at once.

    Submissions are scored while servers still use the earlier ground truth. Then one transaction
    replaces the file, records the new rules, which running servers follow, and stores all results,
    so nobody sees a leaderboard of some old and some new ones. If it fails or is interrupted,
    nothing has changed.

    Raises
    ------
    SettingsError
        If the server cannot start with the bundle, or the database is not up to date.
    NotFoundError
        If the server has no such split.
    """
    corrected = _with_bundle(settings, split, bundle)
    load_boards(corrected)
    # The earlier ground truth is needed until the end: a snapshot of a phase that ends meanwhile
    # shows the earlier results.
    with opened_server(settings) as earlier, opened_server(corrected) as state:
        boards = state.board(split).all
        outcomes: dict[str, dict[Job, Outcome]] = {board.name: {} for board in boards}
        while True:
            with state.database.reading() as session:
                missing = _missing(session, boards, outcomes)
            if not missing:
                break
            for board, waiting in missing:
                found = _score(state, board, waiting, jobs, progress)
                outcomes[board.name] = _updated(outcomes[board.name], found)
        with (
            _replacement(settings, split, bundle) as replacement,
            earlier.transactions.begin(actor) as transaction,
        ):
            # Uploads that came since the last look; there is hardly ever one.
            for board, waiting in _missing(transaction.session, boards, outcomes):
                found = _score(state, board, waiting, 1, no_progress)
                outcomes[board.name] = _updated(outcomes[board.name], found)
            before, after = (rules_of({split: each.boards[split]}) for each in (earlier, state))
            replaced = {name: before[name] for name in different(after, before)}
            # Another correction may have replaced those of other splits meanwhile.
            recorded = LastRules().read(transaction.session)
            known = {name: recorded.get(name, own) for name, own in rules_of(state.boards).items()}
            append_rules(transaction, {**known, **after}, replaced)
            for board in boards:
                replace_at_once(transaction, board, reason, outcomes[board.name])
            replacement.install()  # last, so that nobody finds it long before the new results
    changed: list[ResultChange] = []
    with opened_server(settings) as state, state.database.reading() as session:
        for board in state.board(split).all:
            of_board = outcomes[board.name]
            named = _named(of_board)
            changed += changes(session, board, named, first_results=_first(of_board))
    return Replaced(changed, replacement.aside)


def _missing(
    session: Session, boards: Sequence[Board], outcomes: Mapping[str, Mapping[Job, Outcome]]
) -> Sequence[tuple[Board, Sequence[Job]]]:
    """Return what is still to be scored on each leaderboard, if anything is."""
    found = [
        (board, [job for job in outdated(session, board) if job not in outcomes[board.name]])
        for board in boards
    ]
    return [(board, waiting) for board, waiting in found if waiting]


def _updated(known: Mapping[Job, Outcome], found: Mapping[Job, Outcome]) -> dict[Job, Outcome]:
    """Add outcomes, also of submissions that were published since they were scored again."""
    again = {job.submission_id for job in found}
    rest = {job: outcome for job, outcome in known.items() if job.submission_id not in again}
    return {**rest, **found}


def _outdated(state: ServerState, board: Board) -> Sequence[Job]:
    with state.database.reading() as session:
        return outdated(session, board)


def _score(
    state: ServerState, board: Board, waiting: Sequence[Job], jobs: int, progress: Progress
) -> dict[Job, Outcome]:
    with _scoring(state, board, waiting, jobs) as outcomes:
        scored = zip(waiting, outcomes, strict=True)
        return dict(progress(scored, _SCORING, len(waiting)))


@contextmanager
def _scoring(
    state: ServerState, board: Board, waiting: Sequence[Job], jobs: int
) -> Iterator[Iterable[Outcome]]:
    """Score submissions, many of them in several processes; yield the outcomes in their order."""
    number = min(jobs, 1 + len(waiting) // FOR_ONE)
    here = state.scoring
    with (
        here if number == 1 else ScoringProcesses(state.settings, state.boards, number) as scoring,
        ThreadPoolExecutor(number) as threads,
    ):
        try:
            yield threads.map(partial(_rescore, scoring, board), waiting)
        finally:
            threads.shutdown(cancel_futures=True)  # after an error, nothing more is scored


def _rescore(scoring: Scoring, board: Board, job: Job) -> Outcome:
    try:
        return scoring.run(rescore_one, board.split, board.name, job)
    except SubmissionError as error:  # it needs more than a process may use
        return rejected(error)
    except BusyError:
        raise ReverieEvalError(
            "a process that scored was killed, perhaps for lack of memory, or the ground truth was "
            "replaced meanwhile; run the command again, with fewer --jobs if it was memory"
        ) from None


def _named(outcomes: Mapping[Job, Outcome]) -> Mapping[str, Outcome]:
    return {job.submission_id: outcome for job, outcome in outcomes.items()}


def _first(jobs: Iterable[Job]) -> Collection[str]:
    """Return the submissions that had no result before."""
    return {job.submission_id for job in jobs if not job.was_scored}


class _Replacement(NamedTuple):
    """Another bundle for a split, and where the earlier one is kept."""

    bundle: Path
    place: Path
    aside: Path

    def install(self) -> None:
        """Put the bundle in its place."""
        _copy(self.bundle, self.place)


@contextmanager
def _replacement(settings: Settings, split: str, bundle: Path) -> Iterator[_Replacement]:
    """Keep a split's bundle, so that another one can be installed; put it back after an error."""
    place = settings.path(settings.splits[split].bundle)
    earlier = Bundle.load(place).header.fingerprint[:12]
    aside = place.with_name(f"{place.stem}.{earlier}{place.suffix}")
    _copy(place, aside)
    try:
        yield _Replacement(bundle, place, aside)
    except BaseException:
        _copy(aside, place)
        raise


def _copy(source: Path, target: Path) -> None:
    """Copy a file; a new one never has more readers than its source."""
    mode = stat.S_IMODE(source.stat().st_mode)
    with staged_file(target, mode=mode) as file, source.open("rb") as content:
        shutil.copyfileobj(content, file)


def _with_bundle(settings: Settings, split: str, bundle: Path) -> Settings:
    """Return settings with another bundle for a split."""
    if split not in settings.splits:
        raise no_split(split, settings.splits)
    changed = settings.splits[split].model_copy(update={"bundle": bundle.absolute()})
    return settings.model_copy(update={"splits": {**settings.splits, split: changed}})
