"""Evidence about submissions as tables: of teams, of similar files, of one team's submissions."""

from collections.abc import Iterable

from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting._table import MISSING, Table, cell_of
from reverie_eval.schemas.evidence import (
    EvidenceReport,
    GapReport,
    SameFile,
    SimilarPair,
    SubmissionEvidence,
    TeamEvidence,
)


def teams_table(teams: Iterable[TeamEvidence]) -> Table:
    """Return a row per team: how its files differ from each other."""
    headings = [
        *("team", "submissions", "changed (median)", "spread", "+-", "p"),
        *("open - secret half %", "+-", "growth %", "+-", "most jumps"),
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
            *_gap(each.gap),
            *_gap(each.gap_growth),
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
    return Table(
        [*headings, *shares],
        [[*_names(pair), *map(_percent, _shares(pair))] for pair in report.similar],
        frozenset(range(len(headings))),
        notes=[] if usual is None else [f"usual between two teams: {_percent(usual)} %"],
    )


def same_files_table(found: Iterable[SameFile]) -> Table:
    """Return a row per submission of a file that several teams have sent."""
    rows = [
        [each.sha256[:12], named.team, named.id, named.method]
        for each in found
        for named in each.submissions
    ]
    return Table(["file", "team", "submission", "method"], rows, frozenset(range(4)))


def history_table(history: Iterable[SubmissionEvidence]) -> Table:
    """Return a row per submission of a team."""
    headings = [
        *("submission", "received (UTC)", "method", "nearest earlier", "changed"),
        *("open - secret half %", "+-", "jumps", "in episodes", "longest jump m"),
        *("viewpoints", "most", "longest walk m", "exact stops %", "by chance %"),
    ]
    rows = [
        [
            each.id,
            f"{each.received_at:%Y-%m-%d %H:%M}",
            each.method,
            each.nearest or MISSING,
            cell_of(each.changed, "{:,}".format),
            *_gap(each.gap),
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


def _names(pair: SimilarPair) -> tuple[str, ...]:
    return pair.first.team, pair.first.id, pair.second.team, pair.second.id


def _shares(pair: SimilarPair) -> tuple[float, ...]:
    return pair.equal, pair.equal_answers, pair.equal_stops, pair.equal_paths


def _gap(gap: GapReport | None) -> tuple[str, str]:
    if gap is None:
        return MISSING, MISSING
    label = CATALOGUE[gap.metric].label
    return f"{label} {100 * gap.value:+.2f}", _percent(gap.standard_error)


def _percent(share: float | None) -> str:
    return cell_of(share, lambda share: f"{100 * share:.2f}")
