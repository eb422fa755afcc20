"""Score a split's submissions again from the server's own machine, in several processes."""

import os
import shutil
import stat
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeAlias

from sqlalchemy.orm import Session

from reverie_eval.errors import ReverieEvalError, SubmissionError
from reverie_eval.files import staged_file
from reverie_eval.processes import Progress, no_progress
from reverie_eval.schemas.organising import ResultChange
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.corrections.corrections import (
    Outcome,
    Outdated,
    changes,
    count_outdated,
    outdated,
    rejected,
    replace_results,
    rescore_one,
)
from reverie_eval.server.errors import BusyError, no_split
from reverie_eval.server.opening import opened_server
from reverie_eval.server.scoring.boards import Board, load_boards, rules_of, waiting_beside
from reverie_eval.server.scoring.contexts import Scoring
from reverie_eval.server.scoring.processes import ScoringProcesses
from reverie_eval.server.scoring.rules import LastRules, append_rules, different
from reverie_eval.server.settings import Settings
from reverie_eval.server.state import ServerState
from reverie_eval.text import short_digest

FOR_ONE = 100
"""Submissions for each process: starting one takes as long as scoring some dozens of them."""
_SCORING = "scoring again"
Outcomes: TypeAlias = dict[str, dict[Outdated, Outcome]]
"""The outcomes of submissions that were scored again, by the names of leaderboards."""


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
    with opened_server(settings) as state:
        boards = state.board(split).all
        with _processes(state, split, jobs) as scoring:
            outcomes = _score_all(state, scoring, boards, progress)
        return _changes(state, boards, outcomes)


def rescore(
    settings: Settings, split: str, reason: str, *, actor: str, jobs: int, progress: Progress
) -> Sequence[ResultChange]:
    """Score all submissions again that were scored with other ground truth or rules.

    One transaction stores all results. If it fails or is interrupted, nothing has changed.

    Raises
    ------
    SettingsError, NotFoundError
        As :func:`preview`.
    """
    with opened_server(settings) as state:
        boards = state.board(split).all
        with _processes(state, split, jobs) as scoring:
            outcomes = _score_all(state, scoring, boards, progress)
            if any(outcomes.values()):
                with state.transactions.begin(actor) as transaction:
                    _replace_all(transaction, scoring, boards, outcomes, reason)
        return _changes(state, boards, outcomes)


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
    records the new rules, which running servers follow, and stores all results, so nobody sees a
    leaderboard of some earlier and some new ones. The new file waits beside its place from before
    the commit, so whatever is killed when: either nothing has changed, or what loads the ground
    truth next finds the new one.

    Raises
    ------
    SettingsError
        If the server cannot start with the bundle, or the database is not up to date.
    NotFoundError
        If the server has no such split.
    ReverieEvalError
        If another correction of the split was made meanwhile.
    """
    corrected = _with_bundle(settings, split, bundle)
    load_boards(corrected)
    # The earlier ground truth is needed until the end: a snapshot of a phase that ends meanwhile
    # shows the earlier results.
    with (
        opened_server(settings) as earlier,
        opened_server(corrected) as state,
        _processes(state, split, jobs) as scoring,
    ):
        with earlier.database.reading() as session:
            earlier.rules.follow(session)
        boards = state.board(split).all
        outcomes = _score_all(state, scoring, boards, progress)
        place = settings.path(settings.splits[split].bundle)
        fingerprint = short_digest(earlier.boards[split].truth.fingerprint)
        aside = place.with_name(f"{place.stem}.{fingerprint}{place.suffix}")
        with earlier.transactions.begin(actor) as transaction:
            before, after = (rules_of({split: each.boards[split]}) for each in (earlier, state))
            replaced = {name: before[name] for name in different(after, before)}
            # Another correction may have replaced those of other splits meanwhile.
            recorded = LastRules().read(transaction.session)
            if before.keys() & different(recorded, earlier.rules.recorded):
                raise ReverieEvalError(
                    f"another correction of {split} was made meanwhile; run the command again"
                )
            known = {name: recorded.get(name, own) for name, own in rules_of(state.boards).items()}
            append_rules(transaction, {**known, **after}, replaced)
            _copy(place, aside, like=place)
            _replace_all(transaction, scoring, boards, outcomes, reason)
            _copy(bundle, waiting_beside(place), like=place)
        # If this does not happen any more, whatever loads the ground truth next does it. A server
        # that runs may have done it already.
        with suppress(FileNotFoundError):
            waiting_beside(place).replace(place)
        return Replaced(_changes(state, boards, outcomes), aside)


def _processes(state: ServerState, split: str, jobs: int) -> ScoringProcesses:
    """Return processes that score a split's submissions again, several for many submissions.

    They are started once: uploads could come faster than processes start.
    """
    with state.database.reading() as session:
        most = max(count_outdated(session, board) for board in state.board(split).all)
    # The ground truth of other splits would only take time and memory.
    only = {split: state.settings.splits[split]}
    settings = state.settings.model_copy(update={"splits": only})
    return ScoringProcesses(settings, {split: state.boards[split]}, min(jobs, 1 + most // FOR_ONE))


def _score_all(
    state: ServerState, scoring: ScoringProcesses, boards: Sequence[Board], progress: Progress
) -> Outcomes:
    """Score all outdated results of leaderboards, also those that come meanwhile."""
    outcomes: Outcomes = {board.name: {} for board in boards}
    while True:
        with state.database.reading() as session:
            missing = _missing(session, boards, outcomes)
        if not missing:
            return outcomes
        for board, waiting in missing:
            _update(outcomes[board.name], _score(scoring, board, waiting, progress))


def _replace_all(
    transaction: Transaction,
    scoring: ScoringProcesses,
    boards: Sequence[Board],
    outcomes: Outcomes,
    reason: str,
) -> None:
    """Replace the results of leaderboards."""
    # Uploads that came since the last look; there is hardly ever one.
    for board, waiting in _missing(transaction.session, boards, outcomes):
        _update(outcomes[board.name], _score(scoring, board, waiting, no_progress))
    for board in boards:
        replace_results(transaction, board, reason, outcomes[board.name])


def _changes(
    state: ServerState, boards: Sequence[Board], outcomes: Outcomes
) -> Sequence[ResultChange]:
    """Return how results changed or would change, leaderboard by leaderboard."""
    found: list[ResultChange] = []
    with state.database.reading() as session:
        for board in boards:
            named = {old.submission_id: outcome for old, outcome in outcomes[board.name].items()}
            first = {old.submission_id for old in outcomes[board.name] if not old.was_scored}
            found += changes(session, board, named, first_results=first)
    return found


def _missing(
    session: Session, boards: Sequence[Board], outcomes: Mapping[str, Mapping[Outdated, Outcome]]
) -> Sequence[tuple[Board, Sequence[Outdated]]]:
    """Return what is still to be scored on each leaderboard, if anything is."""
    found = [
        (board, [old for old in outdated(session, board) if old not in outcomes[board.name]])
        for board in boards
    ]
    return [(board, waiting) for board, waiting in found if waiting]


def _update(known: dict[Outdated, Outcome], found: Mapping[Outdated, Outcome]) -> None:
    """Add outcomes, also of submissions that were published since they were scored again."""
    again = {old.submission_id for old in found}
    for old in [old for old in known if old.submission_id in again]:
        del known[old]
    known.update(found)


def _score(
    scoring: ScoringProcesses, board: Board, waiting: Sequence[Outdated], progress: Progress
) -> Mapping[Outdated, Outcome]:
    with ThreadPoolExecutor(scoring.number) as threads:
        try:
            outcomes = threads.map(partial(_rescore, scoring, board), waiting)
            scored = zip(waiting, outcomes, strict=True)
            return dict(progress(scored, _SCORING, len(waiting)))
        finally:
            threads.shutdown(cancel_futures=True)  # after an error, nothing more is scored


def _rescore(scoring: Scoring, board: Board, old: Outdated) -> Outcome:
    try:
        return scoring.run(rescore_one, board.split, board.name, old)
    except SubmissionError as error:  # it needs more than a process may use
        return rejected(error)
    except BusyError:
        raise ReverieEvalError(
            "a process that scored was killed, perhaps for lack of memory, or the ground truth was "
            "replaced meanwhile; run the command again, with fewer --jobs if it was memory"
        ) from None


def _copy(source: Path, target: Path, *, like: Path) -> None:
    """Copy a file, through to the disk; nobody else may use the new one than may use another."""
    status = like.stat()
    mode = stat.S_IMODE(status.st_mode)
    with staged_file(target, mode=mode) as file, source.open("rb") as content:
        os.fchmod(file.fileno(), mode)
        with suppress(PermissionError):  # an administrator may write for a service
            os.fchown(file.fileno(), status.st_uid, status.st_gid)
        shutil.copyfileobj(content, file)
        file.flush()
        os.fsync(file.fileno())


def _with_bundle(settings: Settings, split: str, bundle: Path) -> Settings:
    """Return settings with another bundle for a split."""
    if split not in settings.splits:
        raise no_split(split, settings.splits)
    changed = settings.splits[split].model_copy(update={"bundle": bundle.absolute()})
    return settings.model_copy(update={"splits": {**settings.splits, split: changed}})
