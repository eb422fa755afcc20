"""What an evaluation server replies, as tables and lines: leaderboards, results, evidence."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import timedelta
from types import MappingProxyType
from typing import Any

from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import DEMO_DATASET
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.tables import (
    MISSING,
    Part,
    Table,
    cell_of,
    metric_cell,
    metric_cells,
)
from reverie_eval.schemas.organising import (
    EvidenceReport,
    SameFile,
    SubmissionEvidence,
    TeamEvidence,
)
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import (
    WINDOWS,
    Accepted,
    Leaderboard,
    LeaderboardRow,
    QuotaReport,
    Receipt,
    ScoredSubmission,
    Snapshot,
    WindowName,
)
from reverie_eval.scoring import task_of
from reverie_eval.tasks import Task
from reverie_eval.text import (
    count_text,
    earliest_time_text,
    printable,
    short_digest,
    time_text,
)

METHOD_FLAGS = {
    "extra_data": "extra data",
    "pre_exploration": "pre-exploration",
    "ground_truth_objects": "ground-truth objects",
    "ensemble": "ensemble",
    "navigation_only": "navigation only",
    "human": "human",
}
"""What a reader must know to compare a method with others."""
METHOD_COSTS = {
    "actions_per_episode": "actions",
    "seconds_per_episode": "seconds",
    "input_tokens_per_episode": "input tokens",
    "output_tokens_per_episode": "output tokens",
    "money_per_episode": "US dollars",
}
"""What an episode cost, as the team declares it."""
OBJECT_FLAGS = frozenset({"ground_truth_objects", "navigation_only"})
"""Flags that matter only if methods also predict objects."""
# Why a result is not ranked.
_STANDINGS = {
    "reported": "reported, not scored",
    "other-dataset": "reported on {dataset}, not scored",
    "other-rules": "scored under other rules",
    "disqualified": "disqualified",
}
_WARNINGS = ("flagged", "disqualified")


def flags_of(tasks: Sequence[Task], required: Collection[str] = ()) -> Mapping[str, str]:
    """Return the flags of methods for some tasks, and those that a server requires."""
    has_targets = any(task.has_targets for task in tasks)
    return {
        flag: words
        for flag, words in METHOD_FLAGS.items()
        if has_targets or flag not in OBJECT_FLAGS or flag in required
    }


def undeclared_of(method: Mapping[str, Any], flags: Mapping[str, str]) -> Sequence[str]:
    """Return what nobody has declared of a method, in words."""
    return [words for flag, words in flags.items() if method.get(flag) is None]


def leaderboard_table(board: Leaderboard) -> Table:
    """Return a leaderboard with its headline metrics and the one that it is sorted by.

    Reported results are among the others, without a rank; results that are not comparable come
    last.
    """
    metrics, flags = _metrics(board), _flags(board)
    columns = [metric.heading for metric in metrics]
    headings = ["rank", "team", "method", *columns, "entries", "published", "notes"]
    rows = [
        [
            cell_of(row.rank),
            *_names_of(row),
            *metric_cells(metrics, row.scores),
            cell_of(row.submissions),
            _date(row) or MISSING,
            ", ".join(_row_notes(row, flags)),
        ]
        for row in _all_rows(board)
    ]
    text_columns = frozenset({1, 2, len(headings) - 1})
    return Table(headings, rows, text_columns, notes=_board_notes(board))


def narrow_leaderboard_table(board: Leaderboard) -> Table:
    """Return a leaderboard with all text in the last column, which can be wrapped."""
    metrics, flags = _metrics(board), _flags(board)
    headings = ["rank", *(m.heading for m in metrics), "team: method"]
    rows = [
        [cell_of(row.rank), *metric_cells(metrics, row.scores), _description(row, flags)]
        for row in _all_rows(board)
    ]
    return Table(headings, rows, frozenset({len(headings) - 1}), notes=_board_notes(board))


def leaderboard_parts(board: Leaderboard) -> Sequence[Part]:
    """Return a leaderboard as it is printed, with all text in one column if that is narrow."""
    table = replace(leaderboard_table(board), narrow=narrow_leaderboard_table(board))
    return [Part([table])] if table.rows else [Part(note="\n".join(table.notes))]


def _board_notes(board: Leaderboard) -> Sequence[str]:
    """Return what the scores depend on, and the organiser's warnings."""
    metric = CATALOGUE.get(board.metric)
    label = metric.label if metric else board.metric
    data = short_digest(board.fingerprint)
    # There the agent was placed at the goal: a reader must not compare it with the full track.
    track = "track:grounding|" if "|track:grounding|" in board.signature else ""
    about = f"split:{board.split}|protocol:{board.protocol}|{track}data:{data}, sorted by {label}"
    empty = [] if _all_rows(board) else ["no results are published yet"]
    warnings = [
        printable(f"{review.verdict}: {row.method.name} ({review.reviewer}: {review.reason})")
        for row in _all_rows(board)
        for review in row.reviews
        if review.verdict in _WARNINGS
    ]
    return [printable(about), *empty, *warnings]


def _all_rows(board: Leaderboard) -> Sequence[LeaderboardRow]:
    return [*board.rows, *board.apart]


def _metrics(board: Leaderboard) -> Sequence[Metric]:
    present: set[str] = set().union(*(row.scores for row in _all_rows(board)))
    shown = list(headline_of(board.signature, present))
    sorted_by = CATALOGUE.get(board.metric)
    # An order that nobody can see would look like an error.
    if sorted_by and sorted_by.key in present and sorted_by not in shown:
        shown.append(sorted_by)
    return shown


def _flags(board: Leaderboard) -> Mapping[str, str]:
    """Return the flags that matter on a leaderboard; all of them if its task is not installed."""
    task = known_task(board.signature)
    return METHOD_FLAGS if task is None else flags_of([task])


def _date(row: LeaderboardRow) -> str:
    """Return when a result was published, or reported; empty if that is not known."""
    # A reported result was never submitted: its date is what its paper says.
    if row.submission_id is None:
        return row.reported_date or ""
    return f"{row.published_at:%Y-%m-%d}"


def _names_of(row: LeaderboardRow) -> tuple[str, str]:
    # Strangers write these names; they must not control the terminal.
    return printable(row.team) or "(anonymous)", printable(row.method.name)


def _row_notes(row: LeaderboardRow, flags: Mapping[str, str]) -> Sequence[str]:
    """Return why a result is not ranked, the organiser's verdicts, and what its method declares.

    What was not declared comes last, because it may be a list of its own.
    """
    standing = [] if row.standing == "ranked" else [_STANDINGS[row.standing]]
    standing = [text.format(dataset=printable(row.dataset)) for text in standing]
    # "disqualified" is a verdict and a standing; it is said once.
    verdicts = [review.verdict for review in row.reviews if review.verdict not in standing]
    method = row.method.model_dump()
    declared = [words for flag, words in flags.items() if method[flag]]
    undeclared = undeclared_of(method, flags)
    # One phrase for all: a list of everything would push the notes out of sight.
    if len(undeclared) == len(flags):
        return [*standing, *verdicts, "nothing declared"]
    missing = [f"not declared: {', '.join(undeclared)}"] if undeclared else []
    return [*standing, *verdicts, *declared, *missing]


def _description(row: LeaderboardRow, flags: Mapping[str, str]) -> str:
    team, method = _names_of(row)
    entries = [] if row.submissions is None else [count_text(row.submissions, "entry", "entries")]
    about = [*entries, *filter(None, [_date(row)]), *_row_notes(row, flags)]
    return f"{team}: {method} ({', '.join(about)})"


# Replies to a submission.


_DAY = timedelta(days=1)
WINDOW_LENGTHS: Mapping[WindowName, str] = MappingProxyType(
    {
        name: count_text(length // timedelta(hours=1), "hour")
        if length <= _DAY
        else count_text(length // _DAY, "day")
        for name, length in WINDOWS.items()
    }
)
"""The lengths of the windows of quotas in words: "24 hours"."""


def headline_of(signature: str, scored: Collection[str]) -> Sequence[Metric]:
    """Return the headline metrics that a result has values for.

    The task decides which they are; if it is not installed here, all known metrics are returned.
    """
    task = known_task(signature)
    # A newer server may have a task that is not installed here.
    if task is None:
        return [metric for key, metric in CATALOGUE.items() if key in scored]
    return task.headline_metrics(scored)


def known_task(signature: str) -> Task | None:
    """Return the task that a signature names; None if it is not installed here."""
    try:
        return task_of(signature)
    except ProtocolError:
        return None


def submission_table(report: ScoreReport, server: str) -> Table:
    """Return the scores that a server gave."""
    task = known_task(report.signature)
    provenance = (
        f"the synthetic demo world, not {task.title}"
        if task and report.dataset == DEMO_DATASET
        else f"on {server} ({report.dataset})"
    )
    metrics = (
        task.table_metrics(report.scores) if task else headline_of(report.signature, report.scores)
    )
    notes = [report.signature, f"ground truth: {provenance}", *map("note: {}".format, report.notes)]
    return Table(
        headings=[metric.heading for metric in metrics],
        rows=[metric_cells(metrics, report.scores)],
        notes=list(map(printable, notes)),
    )


def result_tables(submission: ScoredSubmission, server: str) -> Mapping[str, Table]:
    """Return the scores on each leaderboard of the split by its name; empty while held back.

    The name of the split's own leaderboard is "".
    """
    # Held back by a phase: an empty table would look like a score of 0.
    if submission.scores_held_until is not None:
        return {}
    return {
        board: submission_table(result.report, server)
        for board, result in submission.results.items()
    }


def submission_lines(accepted: Accepted, *, to_publish: str, to_change: str) -> Iterator[str]:
    """Yield which submission it is, its status, and what to do to publish or change it."""
    submission = accepted.submission
    about = f"submission {submission.id} of {submission.team}: {submission.method.name}"
    yield printable(f"{about}, received {time_text(submission.received_at)}")
    if accepted.is_repeat:
        yield "this file was already scored; no submission was used"
    if accepted.ignored:
        words = ", ".join(name.replace("_", " ") for name in accepted.ignored)
        yield f"ignored, because the first upload said otherwise: {words}; {to_change}"
    for result in submission.earlier:
        scores = ", ".join(
            f"{metric.label} {metric.display(result.report.scores[metric.key])}"
            for metric in headline_of(result.report.signature, result.report.scores)
        )
        again = f"scored again at {time_text(result.replaced_at)}: {result.reason}"
        yield printable(f"{again}; before, it had {scores}")
    if submission.scores_held_until is not None:
        ends = time_text(submission.scores_held_until)
        yield f"scores are published when the phase ends at {ends}"
    if submission.status == "unpublished":
        yield f"not published: {to_publish}"
    else:
        yield submission.status


def quota_lines(quota: QuotaReport, split: str) -> Iterator[str]:
    """Yield how many submissions are left, and when there will be more."""
    when = f"; next possible at {earliest_time_text(quota.next_at)}" if quota.next_at else ""
    yield f"submissions left on {split}: {quota.remaining}{when}"
    for window in quota.windows:
        reset = f"; one more at {earliest_time_text(window.resets_at)}" if window.resets_at else ""
        yield f"  {window.remaining} of {window.limit} per {WINDOW_LENGTHS[window.name]}{reset}"


def receipt_lines(receipt: Receipt) -> Iterator[str]:
    """Yield what a receipt proves."""
    about = f"received a file from {receipt.team} at {time_text(receipt.received_at)}"
    given = "gave it these scores" if receipt.scores else "held its scores back"
    yield printable(f"proven: the server {about} and {given}")
    for metric in headline_of(receipt.signature, receipt.scores):
        yield f"  {metric.heading:8}{metric.display(receipt.scores[metric.key]):>7}"
    yield printable(receipt.signature)
    yield printable(f"submission {receipt.submission_id}, file sha256 {receipt.sha256}")


def snapshot_lines(snapshot: Snapshot) -> Iterator[str]:
    """Yield what a snapshot proves."""
    board = snapshot.leaderboard
    state = f"as of {time_text(snapshot.as_of)}: {snapshot.title}"
    yield printable(f"proven: the server's leaderboard of {snapshot.split} {state}")
    metric = CATALOGUE.get(board.metric)
    for row in board.rows:
        rank, score = cell_of(row.rank), metric_cell(metric, row.scores) if metric else MISSING
        yield printable(f"  {rank:>3}  {score:>6}  {row.method.name}, {row.team or 'anonymous'}")
    yield printable(board.signature)


# Evidence, for organisers.


def teams_table(teams: Iterable[TeamEvidence]) -> Table:
    """Return a row per team: how its files differ from each other."""
    headings = [
        *("team", "submissions", "changed (median)"),
        *("spread", "+-", "p", "most jumps"),
    ]
    rows = [
        [
            each.team,
            f"{each.submissions:,}",
            cell_of(each.median_changed, "{:,.0f}".format),
            *(
                (MISSING, MISSING, MISSING)
                if each.spread is None
                else (
                    f"{each.spread.value:.2f}",
                    f"{each.spread.standard_error:.2f}",
                    f"{each.spread.p_value:.2g}",
                )
            ),
            f"{each.jumps:,}",
        ]
        for each in teams
    ]
    return Table(headings, rows, frozenset({0}))


def pairs_table(report: EvidenceReport) -> Table:
    """Return a row per pair of teams: the shares of episodes in which their files are equal."""
    headings = ["team", "submission", "other team", "submission"]
    shares = ["answer and stop %", "answer %", "stop %", "path %"]
    usual = report.usual_similarity
    rows = [
        [
            *(each.first.team, each.first.id, each.second.team, each.second.id),
            _percent(each.equal),
            _percent(each.equal_answers),
            _percent(each.equal_stops),
            _percent(each.equal_paths),
        ]
        for each in report.similar
    ]
    return Table(
        [*headings, *shares],
        rows,
        frozenset(range(len(headings))),
        notes=[] if usual is None else [f"usual between two teams: {_percent(usual)} %"],
    )


def same_files_table(found: Iterable[SameFile]) -> Table:
    """Return a row per submission of a file that several teams have sent."""
    rows = [
        [short_digest(each.sha256), named.team, named.id, named.method]
        for each in found
        for named in each.submissions
    ]
    return Table(["file", "team", "submission", "method"], rows, frozenset(range(4)))


def history_table(history: Iterable[SubmissionEvidence]) -> Table:
    """Return a row per submission of a team."""
    headings = [
        *("submission", "received (UTC)", "method", "nearest earlier", "changed"),
        *("jumps", "in episodes", "longest jump m"),
        *("viewpoints", "most", "longest walk m", "exact stops %", "by chance %"),
    ]
    rows = [
        [
            each.id,
            f"{each.received_at:%Y-%m-%d %H:%M}",
            each.method,
            each.nearest or MISSING,
            cell_of(each.changed, "{:,}".format),
            f"{each.walks.jumps:,}",
            f"{each.walks.episodes_with_jumps:,}",
            f"{each.walks.longest_jump:.1f}",
            f"{each.walks.mean_viewpoints:.1f}",
            f"{each.walks.most_viewpoints:,}",
            f"{each.walks.longest_walk:.1f}",
            _percent(each.walks.exact_stops),
            _percent(each.walks.exact_by_chance),
        ]
        for each in history
    ]
    return Table(headings, rows, frozenset({0, 1, 2, 3}))


def _percent(share: float | None) -> str:
    return cell_of(share, lambda share: f"{100 * share:.2f}")
