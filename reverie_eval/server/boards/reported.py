"""Results that papers and other leaderboards report and this server has not scored.

The organiser enters them one by one or imports a file. Leaderboards show them among the others,
marked as reported, without a rank; those on another version of the dataset are shown separately.
Removed results stay in the database but are not shown.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from math import isfinite
from typing import Any, NamedTuple

from pydantic import ValidationError
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.errors import Problem
from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.organising import (
    ImportReport,
    NewImport,
    NewReported,
    ReportedChange,
    ReportedEntry,
)
from reverie_eval.schemas.wire import wrong_value
from reverie_eval.server.audit.transactions import Transaction, difference
from reverie_eval.server.boards.reported_files import FileRow, read_results
from reverie_eval.server.errors import (
    ConflictError,
    MalformedError,
    NotFoundError,
    TableError,
    no_split,
)
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import ReportedResult, read_stored
from reverie_eval.tasks import Task, name_on_server
from reverie_eval.text import did_you_mean

_SHOWN = 60
"""Characters of a wrong value that an error shows, at most."""


class _Identity(NamedTuple):
    """The fields that identify a reported result of a split."""

    team: str
    method: str
    date: str | None

    def __str__(self) -> str:
        return ", ".join(filter(None, (repr(self.method), f"by {self.team!r}", self.date)))


def add_reported(
    transaction: Transaction, new: NewReported, tasks: Mapping[str, Task]
) -> ReportedEntry:
    """Add a reported result to the leaderboard of a split.

    ``tasks`` are those of the server's splits, by the split's name.

    Raises
    ------
    MalformedError
        If the split's task has no such metric, or a score is out of its bounds.
    NotFoundError
        If there is no such split.
    ConflictError
        If a result of that team, method and date is already on the leaderboard.
    """
    _check_scores(new.scores, _task_of(new.split, tasks).metrics)
    _check_is_only(transaction.session, new)
    return ReportedEntry.model_validate(_insert(transaction, new))


def change_reported(
    transaction: Transaction, result_id: int, change: ReportedChange, tasks: Mapping[str, Task]
) -> ReportedEntry:
    """Change a reported result in place; the audit log keeps the earlier values.

    Raises
    ------
    NotFoundError
        If it is not on a leaderboard.
    MalformedError
        As for :func:`add_reported`, or if it would have no score.
    ConflictError
        If another result has that team, method and date.
    """
    result = _result_of(transaction.session, result_id)
    old = read_stored(NewReported, result)
    before = old.model_dump(mode="json")
    after = _merged(before, change.model_dump(mode="json", exclude_unset=True))
    task = tasks.get(old.split)  # a split may have been removed from the settings
    _check_scores(after["scores"], [*CATALOGUE] if task is None else task.metrics)
    new = NewReported.model_validate(after)
    _check_is_only(transaction.session, new, result_id)
    details = difference(before, after)
    if details:
        for name, value in after.items():
            setattr(result, name, value)
        transaction.record("reported result changed", result, old.method.name, **details)
    return read_stored(ReportedEntry, result)


def remove_reported(transaction: Transaction, result_id: int) -> ReportedEntry:
    """Remove a reported result from its leaderboard. Raises NotFoundError if it is not on one."""
    result = _result_of(transaction.session, result_id)
    result.removed_at = transaction.now
    name = result.method["name"]
    transaction.record("reported result removed", result, name, split=result.split)
    return read_stored(ReportedEntry, result)


def import_reported(
    transaction: Transaction, new: NewImport, tasks: Mapping[str, Task]
) -> ImportReport:
    """Add the results of a file to the leaderboard of a split; if there is a problem, add none.

    Results that are on the leaderboard with the same scores stay as they are, so importing a file
    again changes nothing.

    Raises
    ------
    NotFoundError
        If there is no such split.
    TableError
        If anything is wrong with the file, or the file or the leaderboard also has a result with
        other scores; lists everything.
    """
    task = _task_of(new.split, tasks)
    # A file of another server names the split without the task.
    own_name = new.split.removeprefix(name_on_server(task.name, ""))
    read = read_results(new.text, own_name, new.rates, task.metrics)
    problems = [*read.problems, *_unknown_names(read.rows, new)]
    known = _known(transaction.session, new.split)
    first: dict[_Identity, tuple[FileRow, NewReported]] = {}
    count, repeated = 0, []
    for row in read.rows:
        found, wrong = _checked(row, new)
        problems += [Problem("wrong-value", row.where, told, (row.place,)) for told in wrong]
        if found is None:
            continue
        key = _identity(found)
        if key in known:
            count += 1
            if known[key].scores != found.scores:
                told = f"{key} is on the leaderboard with other scores; change it there"
                problems.append(Problem("other-scores", row.where, told, (row.place,)))
        elif key not in first:
            first[key] = row, found
        elif first[key][1].scores == found.scores:
            repeated.append(f"{row.where} repeats {first[key][0].where}")
        else:
            told = f"{key} has other scores in {first[key][0].where}; rename one or remove it"
            problems.append(Problem("other-scores", row.where, told, (row.place,)))
    if problems:
        raise TableError(problems)
    added = [found for _, found in first.values()]
    if not new.dry_run:
        for found in added:
            _insert(transaction, found)
    return ImportReport(
        rows=len(read.rows), added=added, known=count, repeated=repeated, unread=list(read.unread)
    )


def list_reported(session: Session, page: Page) -> Listed[ReportedEntry]:
    """List the reported results on all leaderboards, the latest first."""
    rows = select(ReportedResult).where(ReportedResult.removed_at.is_(None))
    report = partial(read_stored, ReportedEntry)
    return list_page(session, rows, ReportedResult.id, page, report, newest_first=True)


def find_reported(session: Session, result_id: int) -> ReportedEntry:
    """Return a reported result. Raises NotFoundError if it is not on a leaderboard."""
    return read_stored(ReportedEntry, _result_of(session, result_id))


def reported_of(session: Session, split: str) -> Sequence[ReportedResult]:
    """Return the reported results of a split, in the order in which they were added."""
    chosen = select(ReportedResult).where(ReportedResult.split == split)
    current = chosen.where(ReportedResult.removed_at.is_(None))
    return session.scalars(current.order_by(ReportedResult.id)).all()


def _insert(transaction: Transaction, new: NewReported) -> ReportedResult:
    result = ReportedResult(**new.model_dump(mode="json"), created_at=transaction.now)
    name, about = new.method.name, new.model_dump(mode="json")
    transaction.record("reported result added", result, name, **about)
    return result


def _result_of(session: Session, result_id: int) -> ReportedResult:
    result = session.get(ReportedResult, result_id)
    if result is None or result.removed_at is not None:
        raise NotFoundError(f"there is no reported result {result_id} on any leaderboard")
    return result


def _identity(result: NewReported) -> _Identity:
    return _Identity(result.team, result.method.name, result.date)


def _known(session: Session, split: str) -> Mapping[_Identity, ReportedEntry]:
    entries = map(partial(read_stored, ReportedEntry), reported_of(session, split))
    return {_identity(entry): entry for entry in entries}


def _merged(before: Mapping[str, Any], changed: Mapping[str, Any]) -> dict[str, Any]:
    """Return all fields of a result after some were changed."""
    scores = {**before["scores"], **changed.get("scores", {})}
    return {
        **before,
        **changed,
        "method": {**before["method"], **(changed.get("method") or {})},
        "scores": {key: value for key, value in scores.items() if value is not None},
    }


def _task_of(split: str, tasks: Mapping[str, Task]) -> Task:
    if split not in tasks:
        raise no_split(split, tasks)
    return tasks[split]


def _check_scores(scores: Mapping[str, float], known: Sequence[str]) -> None:
    if not scores:
        raise MalformedError("no score would be left; remove the result instead")
    for key, value in scores.items():
        if key not in known:
            raise MalformedError(f"there is no metric {key!r}{did_you_mean(key, known)}")
        metric = CATALOGUE[key]
        if not isfinite(value) or not metric.lower_bound <= value <= metric.upper_bound:
            expected = "a fraction from 0 to 1" if metric.unit == "fraction" else "0 or more"
            raise MalformedError(
                f"{key} is {value}; expected {'a number' if metric.is_signed else expected}"
            )


def _check_is_only(session: Session, new: NewReported, but: int | None = None) -> None:
    key = _identity(new)
    other = _known(session, new.split).get(key)
    if other is not None and other.id != but:
        raise ConflictError(
            f"{key} is already on the leaderboard of {new.split}; change that result, or give this "
            "one another date or name"
        )


def _checked(row: FileRow, new: NewImport) -> tuple[NewReported | None, Sequence[str]]:
    """Return a row of a file as a request to add it, or everything that is wrong with it.

    If a row lacks the method or the team, the other name stands for both, as on leaderboards that
    have a single column for both.
    """
    about: dict[str, Any] = dict(row.about)
    team, name = about.pop("team", None), about.pop("method", None)
    if team is None and name is None:
        return None, ["has neither a team nor a method"]
    fields = {
        "split": new.split,
        "source": about.pop("source", new.source),
        "dataset": about.pop("dataset", new.dataset),
        "date": about.pop("date", new.date),
        "team": name if team is None else team,
        "scores": row.scores,
        "method": {"name": _name_of(row), **_marks(row, new), **about},
    }
    try:
        return NewReported.model_validate(fields), ()
    except ValidationError as error:
        # Scores were already checked as printed in the file.
        return None, [_wrong(each) for each in error.errors() if each["loc"] != ("scores",)]


def _marks(row: FileRow, new: NewImport) -> Mapping[str, bool]:
    """Return what the import says of a row's method, besides what the row itself says."""
    marks = {"human": new.human, "reference": new.reference}
    return {what: True for what, names in marks.items() if _name_of(row) in names}


def _unknown_names(rows: Sequence[FileRow], new: NewImport) -> Iterator[Problem]:
    """Report methods that are said to be human or a reference, and are not in the file."""
    names = dict.fromkeys(map(_name_of, rows))  # a set would list them in another order each time
    for what in ("human", "reference"):
        for name in getattr(new, what):
            if name not in names:
                told = f"no row is of the method {name!r}{did_you_mean(name, filter(None, names))}"
                yield Problem("unknown-method", what, told)


def _name_of(row: FileRow) -> str | None:
    """Return the method of a row; the team, if the row has a single name."""
    name: str | None = row.about.get("method", row.about.get("team"))
    return name


def _wrong(detail: Mapping[str, Any]) -> str:
    problem = wrong_value(detail)
    column = problem.where.replace("method.name", "method").removeprefix("method.")
    return f"{column}: {problem.message}; found {repr(detail['input'])[:_SHOWN]}"
