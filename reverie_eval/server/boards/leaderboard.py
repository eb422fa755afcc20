"""The leaderboard: published results, ranked by any metric, and which ranks they may have.

It can be exported as JSON, CSV, a LaTeX table, or BibTeX entries.

For the ranks that results may have, and the groups that they form, results on an open split are
compared on the same episodes: the sums of each result over clusters of episodes are stored when it
is published. On a private split, only the shown means are used, and the number of items, which is
known from the public instructions.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from math import inf
from threading import Lock
from typing import Any, Self, TypeAlias

import msgspec
import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.analysis import covariance_of_means, rank_intervals
from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.history import Timeline
from reverie_eval.reporting.results import methods_table
from reverie_eval.reporting.tables import latex_comments, latex_text
from reverie_eval.schemas.service import CorrectionReport, LeaderboardRow, ReportedMethod
from reverie_eval.scoring import Scores, clusters_of
from reverie_eval.server.boards.entries import BoardEntries, EntriesCache, Entry, Row, is_anonymous
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.csv_files import csv_text
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.damage import if_readable
from reverie_eval.server.store.tables import ClusterSums
from reverie_eval.tasks import Task

MOST_COMPARED = 100
"""Ranked results that are compared, at most; if there are more, none are."""
_FEWEST_COMPARED = 2
"""Results, and clusters that they are compared on, at least."""
_DIGITS = 6
"""Digits of the stored sums after the decimal point."""
_Means: TypeAlias = Mapping[str, float]
"""The values of results, by submission."""
Sums: TypeAlias = dict[str, list[float]]
"""Sums of a result over each cluster of episodes, by metric."""

_OF_RANK = ("rank_low", "rank_high", "group")
_ABOUT = ("rank", "submission_id", "team", "published_at", "submissions")
_OF_METHOD = tuple(name for name in ReportedMethod.model_fields if name != "description")
_STANDING = ("standing", "reviews", "source", "reported_date", "dataset", "signature")
_BRACES = {"{": r"\textbraceleft{}", "}": r"\textbraceright{}"}
"""BibTeX counts braces, even escaped ones."""
ANONYMOUS = "Anonymous"
"""Used in place of a team's name where a name is needed."""


@dataclass(frozen=True, slots=True)
class RankInterval:
    """The ranks that a result may have, and its group."""

    best: int
    worst: int
    group: int
    """The group's number, from 1. A group is a first result and those that follow it and are not
    significantly worse than it."""


@dataclass(frozen=True, slots=True)
class Ranking:
    """A leaderboard, ranked by a metric."""

    board: Board
    metric: str
    rows: Sequence[Row]
    """The best first: ranked results, and reported ones without a rank among them."""
    apart: Sequence[Row]
    """Results that are not comparable with the others, or disqualified."""
    metrics: frozenset[str]
    """All metrics of the results that are not apart."""
    now: datetime
    timelines: dict[str, tuple[str, Timeline | None]] = field(default_factory=dict)
    """Timelines of all results, shared by the rankings of the same :class:`BoardEntries`."""
    counts: Mapping[int, int] = field(default_factory=dict)
    """Number of submissions to the split, by team; empty if they were not counted."""
    rank_intervals: Mapping[str, RankInterval] = field(default_factory=dict)
    """The ranks that results may have, by submission; empty if they were not compared."""

    def rank_interval(self, row: Row) -> RankInterval | None:
        """Return the ranks that a result may have, and its group; None if it is not compared."""
        return self.rank_intervals.get(row.entry.submission_id or "")

    def team(self, entry: Entry) -> str:
        """Return the team of an entry; empty while it is anonymous."""
        return "" if is_anonymous(entry, self.now) else entry.team

    def submissions(self, entry: Entry) -> int | None:
        """Return the number of submissions that an entry's team has made to the split.

        This is shown even while the team is anonymous, or it could hide that a result is the best
        of many. None for reported results.
        """
        return None if entry.team_id is None else self.counts[entry.team_id]


def leaderboard(board: Board, found: BoardEntries, metric: str, now: datetime) -> Ranking:
    """Rank the published submissions of a split, and sort reported results among them.

    Another leaderboard has only the submissions that have a result there.

    Equal values share a rank, and the next rank counts all submissions before it: 1, 2, 2, 4.
    Results without a value for the metric have no rank and come last. Equal results are in the
    order of publication, reported ones after submissions. Reported results never have a rank.

    Raises
    ------
    MalformedError
        If there is no such metric, or it has no better direction.
    """
    if metric not in board.sortable:
        known = ", ".join(board.sortable)
        raise MalformedError(f"cannot sort by {metric!r}; choose one of: {known}")
    if metric not in found.ranked:
        found.ranked[metric] = _ranked(found.entries, CATALOGUE[metric])
    return Ranking(
        board=board,
        metric=metric,
        rows=found.ranked[metric],
        apart=found.apart,
        metrics=found.metrics,
        now=now,
        timelines=found.timelines,
    )


def _ranked(entries: Sequence[Entry], metric: Metric) -> Sequence[Row]:
    """Sort entries, and rank those that this server has scored."""
    scored = [entry.scores.get(metric.key) if entry.is_ranked else None for entry in entries]
    return sort_by(list(map(Row, ranks(scored, metric), entries)), metric)


def sort_by(rows: Sequence[Row], metric: Metric) -> Sequence[Row]:
    """Sort rows, the best or, without a better direction, the lowest value first."""
    return sorted(rows, key=lambda row: _cost(row.entry.scores.get(metric.key), metric))


def ranks(values: Sequence[float | None], metric: Metric) -> Sequence[int | None]:
    """Return the rank of each value, as in :func:`leaderboard`; None for a missing value."""
    ordered = sorted(_cost(value, metric) for value in values)
    return [
        None if value is None else 1 + bisect_left(ordered, _cost(value, metric))
        for value in values
    ]


def _cost(value: float | None, metric: Metric) -> float:
    """Return a number that is lowest for the best value, and highest for a missing one."""
    if value is None:
        return inf
    return -value if metric.better == "higher" else value


def as_json(ranking: Ranking, corrections: Sequence[CorrectionReport], organiser: str) -> bytes:
    """Return a leaderboard as JSON, as :class:`~reverie_eval.schemas.service.Leaderboard`.

    ``organiser`` is the public name of who made the reviews.
    """
    content = _content(ranking)
    for row in (*content["rows"], *content["apart"]):
        row["reviews"] = [{**asdict(each), "reviewer": organiser} for each in row["reviews"]]
    content["corrections"] = [each.model_dump() for each in corrections]
    return msgspec.json.encode(content)


def _content(ranking: Ranking) -> dict[str, Any]:
    board = ranking.board
    return {
        "split": board.split,
        "board": board.name,
        "protocol": board.settings.protocol,
        "metric": ranking.metric,
        "fingerprint": board.truth.fingerprint,
        "signature": board.signature,
        "rows": [_row_json(ranking, row) for row in ranking.rows],
        "apart": [_row_json(ranking, row) for row in ranking.apart],
    }


def _row_json(ranking: Ranking, row: Row) -> dict[str, Any]:
    entry, found = row.entry, ranking.rank_interval(row)
    own = {
        "rank": row.rank,
        "rank_interval": None if found is None else (found.best, found.worst),
        "group": None if found is None else found.group,
        "team": ranking.team(entry),
        "submissions": ranking.submissions(entry),
    }
    return {
        name: own[name] if name in own else getattr(entry, name)
        for name in LeaderboardRow.model_fields
    }


def as_csv(ranking: Ranking) -> str:
    """Return a leaderboard as CSV; see :func:`csv_of`."""
    return csv_of(msgspec.to_builtins(_content(ranking)))


def csv_of(leaderboard: Mapping[str, Any]) -> str:
    """Return the JSON of a leaderboard as CSV: a row per result, as :func:`flat_rows`.

    A cell that a spreadsheet would read as a formula begins with an apostrophe.

    References
    ----------
    OWASP, "CSV Injection".
    """
    rows = flat_rows(leaderboard)
    columns = columns_of(rows)
    return csv_text(columns, ([row.get(name) for name in columns] for row in rows))


def flat_rows(leaderboard: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """Return the results in the JSON of a leaderboard, each with a value for each column.

    Results that are not ranked come last.
    """
    return [_flat(row) for row in (*leaderboard["rows"], *leaderboard["apart"])]


def _flat(row: Mapping[str, Any]) -> Mapping[str, Any]:
    ends = {
        f"{key}_{end}": value
        for key, interval in row["intervals"].items()
        for end, value in zip(("low", "high"), interval, strict=True)
    }
    best, worst = row["rank_interval"] or (None, None)
    method = {**row["method"], "method": row["method"]["name"]}
    reviews = "; ".join(f"{each['verdict']}: {each['reason']}" for each in row["reviews"])
    own = {"reviews": reviews, "rank_low": best, "rank_high": worst}
    return {**row, **method, **row["scores"], **ends, **own}


def columns_of(rows: Sequence[Mapping[str, Any]]) -> Sequence[str]:
    """Return the columns of :func:`flat_rows`, but for descriptions of methods.

    Metrics that no result has are left out. Then come the ends of intervals, in the unit of their
    metric, and the ranks that a result may have.
    """
    present: set[str] = set().union(*rows)
    ends = [f"{key}_{end}" for key in CATALOGUE for end in ("low", "high")]
    measured = [name for name in (*CATALOGUE, *ends) if name in present]
    headings = ["method" if name == "name" else name for name in _OF_METHOD]
    return [*_ABOUT, *headings, *_STANDING, *measured, *_OF_RANK]


def as_latex(ranking: Ranking, rows: Sequence[Row], metrics: Sequence[Metric], address: str) -> str:
    """Return the rows as a table for LaTeX's booktabs package, the best of each column in bold.

    Without rows or metrics, it is only a comment: LaTeX does not allow tables without columns.
    """
    board = ranking.board
    if not metrics:
        nothing = f"No result of {board.label} is shown at {address}"
        return "\n".join(latex_comments([nothing])) + "\n"
    methods = {
        name: row.entry.scores for name, row in zip(method_names(ranking, rows), rows, strict=True)
    }
    caption = f"{board.full_title}: {board.signature}. {address}"
    return methods_table(methods, board.label, metrics, caption).to_latex() + "\n"


def method_names(ranking: Ranking, rows: Sequence[Row]) -> Sequence[str]:
    """Return distinct names: the method, with its team and then its id added if necessary."""
    methods = [row.entry.method["name"] for row in rows]
    named = make_distinct(methods, [ranking.team(row.entry) or ANONYMOUS.lower() for row in rows])
    return make_distinct(named, [row.entry.submission_id or str(row.rank) for row in rows])


def make_distinct(names: Sequence[str], by: Sequence[str]) -> Sequence[str]:
    """Return the names, with a further text in brackets behind each that occurs more than once."""
    counts = Counter(names)
    return [
        f"{name} ({more})" if counts[name] > 1 else name
        for name, more in zip(names, by, strict=True)
    ]


def as_bibtex(ranking: Ranking, rows: Sequence[Row], title: str, site: str, address: str) -> str:
    """Return the dataset's paper, an entry for the leaderboard as it is now, and one for each row.

    The entry for a row links the method's paper and, in its note, the result; without a paper, only
    the result. ``title`` and ``site`` are those of the server, ``address`` is the leaderboard's.
    """
    board, today = ranking.board, ranking.now.astimezone(UTC)
    task = board.task
    of_board = _bibtex_entry(
        f"{task.name}-{board.label.removeprefix(f'{task.name}-')}-{today:%Y-%m-%d}",
        author=title,
        title=board.full_title,
        address=address,
        at=today,
        note=f"{board.signature}, as of {today:%Y-%m-%d}",
    )
    of_rows = [
        _bibtex_entry(
            f"{task.name}-{entry.submission_id}",
            author=ranking.team(entry) or ANONYMOUS,
            title=entry.method["name"],
            address=entry.method.get("paper") or f"{site}/submissions/{entry.submission_id}",
            at=entry.published_at,
            note=f"{title}, {entry.signature}",
            result=f"{site}/submissions/{entry.submission_id}",
        )
        for entry in (row.entry for row in rows)
    ]
    return "\n".join([paper_of(task), of_board, *of_rows])


def paper_of(task: Task) -> str:
    """Return what to cite for a task's dataset, in BibTeX."""
    if task.paper is not None:
        return task.paper.bibtex
    lines = [
        f"@misc{{{_bibtex_key(task.name)},",
        f"  title = {{{{{_bibtex_text(task.title)}}}}},",
        f"  howpublished = {{\\url{{https://{task.source}}}}},",
        f"  note = {{{_bibtex_text(task.citation)}}},",
        "}",
    ]
    return "\n".join(lines) + "\n"


def _bibtex_entry(
    key: str, *, author: str, title: str, address: str, at: datetime, note: str, result: str = ""
) -> str:
    """Write an entry; ``result`` is the address of the numbers, if ``address`` is a paper's."""
    numbers = f", \\url{{{result}}}" if result not in ("", address) else ""
    lines = [
        f"@misc{{{_bibtex_key(key)},",
        f"  author = {{{{{_bibtex_text(author)}}}}},",
        f"  title = {{{{{_bibtex_text(title)}}}}},",
        f"  year = {{{at:%Y}}},",
        f"  howpublished = {{\\url{{{address}}}}},",
        f"  note = {{{_bibtex_text(note)}{numbers}}},",
        "}",
    ]
    return "\n".join(lines) + "\n"


def _bibtex_key(text: str) -> str:
    """Replace characters that some versions of BibTeX do not allow in keys."""
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in text)


def _bibtex_text(text: str) -> str:
    """Escape a text for BibTeX and LaTeX."""
    return "".join(_BRACES.get(letter) or latex_text(letter) for letter in text)


def cluster_sums(scores: Scores) -> Sums:
    """Return the sums of a result over clusters of episodes, as they are stored."""
    _, cluster = np.unique(clusters_of(scores.ground_truth, "target"), return_inverse=True)
    return {
        metric.key: np.bincount(cluster, weights=scores.episodes[metric.key])
        .round(_DIGITS)
        .tolist()
        for metric in scores.headline
        if metric.better != "neither"
    }


def store_sums(session: Session, submission_id: str, sums: Mapping[str, Sums]) -> None:
    """Store the sums by which a published result is compared, by the names of leaderboards."""
    if not sums:
        return
    chosen = select(ClusterSums).where(ClusterSums.submission_id == submission_id)
    with session.no_autoflush:  # what else was changed is written with them
        known = {row.board: row for row in session.scalars(chosen)}
    for name, of_board in sums.items():
        if name in known:
            known[name].sums = of_board
        else:
            row = ClusterSums(submission_id=submission_id, board=name, sums=of_board)
            session.add(row)


@dataclass(frozen=True)
class RankIntervals:
    """The rank intervals of all results, computed again only when the results have changed."""

    _found: dict[tuple[str, str, str], tuple[_Means, Mapping[str, RankInterval]]] = field(
        default_factory=dict
    )
    """By signature, leaderboard and metric: the values that were compared, and their intervals."""
    _lock: Lock = field(default_factory=Lock)
    """Makes concurrent requests compute them only once."""

    def compute(
        self, session: Session, board: Board, metric: str, rows: Iterable[Row]
    ) -> Mapping[str, RankInterval]:
        """Return the intervals of the ranked results of a leaderboard that is ranked by a metric.

        They are by the ids of the results; empty if these are not compared. A result without
        stored sums has none, and may have any rank.
        """
        means = {
            row.entry.submission_id: row.entry.scores[metric]
            for row in rows
            if row.rank is not None and row.entry.submission_id is not None
        }
        if not _is_compared(board, CATALOGUE[metric], len(means)):
            return {}
        with self._lock:
            compared, found = self._found.get((board.signature, board.path, metric), ({}, {}))
            if [*compared.items()] != [*means.items()]:  # in the same order, too
                found = _compare(session, board, CATALOGUE[metric], means)
                self._found[board.signature, board.path, metric] = means, found
            return found


def _is_compared(board: Board, metric: Metric, results: int) -> bool:
    """Whether this number of results is compared by a metric.

    On a private split, only by rates: a mean in metres does not show how much its values vary.
    """
    return (
        metric.key in board.task.headline
        and metric.better != "neither"
        and (metric.unit == "fraction" or not board.is_private)
        and _FEWEST_COMPARED <= results <= MOST_COMPARED
    )


def _stored_sums(
    session: Session, board: Board, metric: Metric, means: _Means
) -> Mapping[str, Sequence[float]]:
    """Return stored sums of a metric, by submission in the order of their values."""
    chosen = select(ClusterSums).where(
        ClusterSums.submission_id.in_(means), ClusterSums.board == board.name
    )
    stored = {row.submission_id: row.sums for row in session.scalars(chosen)}
    return {name: stored[name][metric.key] for name in means if metric.key in stored.get(name, {})}


def _compare(
    session: Session, board: Board, metric: Metric, ranked: _Means
) -> Mapping[str, RankInterval]:
    means = ranked
    if board.is_private:
        covariance, n_clusters = (
            _covariance_of_shown_means(board, np.array([*means.values()])),
            np.inf,
        )
    else:
        sums = _stored_sums(session, board, metric, ranked)
        means = {name: ranked[name] for name in sums}
        _, sizes = np.unique(clusters_of(board.truth, "target"), return_counts=True)
        n_clusters = len(sizes)
        if len(means) < _FEWEST_COMPARED or n_clusters < _FEWEST_COMPARED:
            return {}
        table = np.column_stack([*sums.values()])
        covariance = covariance_of_means(table, sizes.astype(np.float64))
    values = np.array([*means.values()])
    found = rank_intervals(-values if metric.better == "higher" else values, covariance, n_clusters)
    others = len(ranked) - len(means)
    columns: tuple[IntArray, ...] = (found.low, found.high + others, found.group)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return {name: RankInterval(*row) for name, row in zip(means, rows, strict=True)}


def _covariance_of_shown_means(board: Board, means: FloatArray) -> FloatArray:
    """Bound the covariance of means between 0 and 1 by what everyone can see.

    A mean of values between 0 and 1 varies at most as much as a rate with the same mean. The
    instructions of an item count as one, as if all had the same outcome, and results count as
    independent: in fact, results on the same episodes tend to succeed and fail together, which
    makes differences more certain.
    """
    n_items = len(np.unique(board.truth.episodes.item))
    return np.diag(means * (1 - means) / n_items)


class Rankings:
    """The leaderboards of a server as they are now."""

    def __init__(self, server: ServerState) -> None:
        self._server = server
        self._entries, self._rank_intervals = EntriesCache(server.get(Schedules)), RankIntervals()

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return the leaderboards of a server."""
        return cls(server)

    def ranking(self, session: Session, board: Board, metric: str | None = None) -> Ranking:
        """Return a leaderboard; raises the errors of :func:`leaderboard`.

        Without a metric, it is ranked by its primary one.
        """
        server = self._server
        now = server.clock()
        server.rules.follow(session)
        board = server.board(board.split, board.name)
        found = self._entries.entries(session, board, now)
        return leaderboard(board, found, board.primary.key if metric is None else metric, now)

    def rankings(self, session: Session, boards: Sequence[Board]) -> Sequence[Ranking | None]:
        """Return several leaderboards; None for each whose rows are damaged."""
        return [if_readable(board.label, partial(self.ranking, session, board)) for board in boards]

    def detailed(self, session: Session, board: Board, metric: str | None = None) -> Ranking:
        """Return a leaderboard with counts of submissions, and the ranks that results may have.

        Raises the errors of :func:`leaderboard`.
        """
        ranking = self.with_rank_intervals(session, self.ranking(session, board, metric))
        counts = self._entries.submissions_of_teams(session, ranking.board.split)
        return replace(ranking, counts=counts)

    def with_rank_intervals(self, session: Session, ranking: Ranking) -> Ranking:
        """Add which ranks each result may have."""
        found = self._rank_intervals.compute(session, ranking.board, ranking.metric, ranking.rows)
        return replace(ranking, rank_intervals=found)
