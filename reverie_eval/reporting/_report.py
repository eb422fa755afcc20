"""The HTML report: one file that opens without a network, to read or to send to a colleague.

Needs Jinja2. Whatever is shown as markup was escaped where it was made; the template escapes all
the rest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reverie_eval.analysis import Comparison, Episode, check_comparable
from reverie_eval.analysis import _near_misses as failures
from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import CATALOGUE, PRIMARY_METRIC
from reverie_eval.reporting import _report_parts as report_parts
from reverie_eval.reporting._comparison import comparison_table, methods, sentences
from reverie_eval.reporting._map_svg import MAP_STYLE, map_element, map_key
from reverie_eval.reporting._maps import EpisodeMap
from reverie_eval.reporting._report_charts import report_charts
from reverie_eval.reporting.resources import as_markup, text_of
from reverie_eval.scoring import FEW_CLUSTERS, OUTCOMES, Clustering, Intervals, Scores
from reverie_eval.submissions import check_names
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from markupsafe import Markup


_TEMPLATE = "report.html.jinja"
_SHOWN_PARTS = 10
"""Rows of a slice; the rest is folded."""
_LISTED_CHANGES = 50


@dataclass(frozen=True)
class Card:
    """An episode's map, with what is said below it."""

    picture: "Markup"
    episode: Episode
    """As the first submission went through it."""
    captions: Mapping[str, str]
    """By submission."""


@dataclass(frozen=True)
class Change:
    """Episodes that only one of two submissions has right."""

    title: str
    instr_ids: Sequence[str]
    episodes: Sequence[tuple[Episode, Episode]]
    """The first few of them."""
    cards: Sequence[Card]


def report_html(scores: Mapping[str, Scores], by: Clustering = "target") -> str:
    """Write a report on a submission, beside another if there are two.

    Parameters
    ----------
    scores : mapping of Scores
        One or two by name, with intervals if these are to be shown, of parts of the episodes too.
        The report is about the first.
    by : "target" or "scan"
        What the comparison's episodes have in common. Where all of them are of one cluster, the
        two are not compared, and the report says so.

    Returns
    -------
    str
        A page of HTML; the same scores have the same page.

    Raises
    ------
    ProtocolError
        If the protocol or track scores no outcomes, the two do not compare, or it is not one or
        two that are given, by names that are texts.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    check_names(scores)
    if len(scores) not in (1, 2):
        raise ProtocolError(f"a report is about one submission, or two; got {len(scores)}")
    environment = Environment(
        loader=PackageLoader("reverie_eval.reporting", "resources"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    return environment.get_template(_TEMPLATE).render(_context(scores, by))


def _context(scores: Mapping[str, Scores], by: Clustering) -> dict[str, Any]:
    (name, first), *_ = scores.items()
    tables, slice_notes = report_parts.slice_tables(scores)
    return {
        "styles": [as_markup(text_of("report.css")), as_markup(MAP_STYLE)],
        "name": name,
        "names": list(scores),
        "scores": scores,
        "first": first,
        "score_rows": report_parts.score_rows(scores),
        "why_not": Intervals.why_not(first.ground_truth, by),
        "finding": report_parts.finding(first),
        "funnel": report_parts.funnel_lines(scores),
        "outcomes": report_parts.outcome_lines(scores),
        "passing_notes": report_parts.passing_notes(scores),
        "tables": tables,
        "slice_notes": slice_notes,
        "scans": report_parts.scans_from_the_worst(scores),
        "shown_parts": _SHOWN_PARTS,
        "few": report_parts.FEW,
        "few_targets": FEW_CLUSTERS,
        "success": CATALOGUE["success"],
        "primary": CATALOGUE[PRIMARY_METRIC],
        "charts": list(report_charts(scores)),
        "near_misses": [
            (kind, OUTCOMES[kind], [_card({name: first}, instr_id) for instr_id in chosen])
            for kind, chosen in failures.near_misses(first).items()
            if chosen
        ],
        "map_key": as_markup(map_key([""])),
        **(_compared(scores, by) if len(scores) > 1 else {"other_name": None, "sentences": []}),
    }


def _compared(scores: Mapping[str, Scores], by: Clustering) -> dict[str, Any]:
    """Say how the second differs from the first, and where."""
    check_comparable(scores)
    (name, first), (other_name, other) = scores.items()
    return {
        **_tested(scores, by),
        "outcome_names": list(report_parts.FROM_THE_BEST),
        "outcome_changes": report_parts.outcome_changes(first, other),
        "other_name": other_name,
        "changes": [
            _change(other_name, scores, failures.episodes_won(first, other)),
            _change(name, scores, failures.episodes_won(other, first)),
        ],
        "listed_changes": _LISTED_CHANGES,
        "both_key": as_markup(map_key(list(scores))),
    }


def _tested(scores: Mapping[str, Scores], by: Clustering) -> dict[str, Any]:
    """Say whether the difference is more than chance, if anything can be said of that."""
    first, _ = scores.values()
    why_not = Intervals.why_not(first.ground_truth, by)
    if why_not:
        return {"sentences": [], "comparison": None, "methods": [f"not compared: {why_not}"]}
    comparison = Comparison.of(scores, by)
    return {
        "sentences": sentences(comparison),
        "comparison": as_markup(comparison_table(comparison).to_html()),
        "methods": methods(comparison),
    }


def _change(only: str, scores: Mapping[str, Scores], instr_ids: Sequence[str]) -> Change:
    first, other = scores.values()
    listed = instr_ids[:_LISTED_CHANGES]
    shown = failures.with_different_routes(first, instr_ids)
    return Change(
        title=f"{count_text(len(instr_ids), 'episode')}: only {only} answers right",
        instr_ids=instr_ids,
        episodes=[(first.episode(each), other.episode(each)) for each in listed],
        cards=[_card(scores, each) for each in shown],
    )


def _card(scores: Mapping[str, Scores], instr_id: str) -> Card:
    episodes = {name: each.episode(instr_id) for name, each in scores.items()}
    shown = episodes if len(scores) > 1 else {"": next(iter(episodes.values()))}
    return Card(
        picture=as_markup(map_element(EpisodeMap.of(shown))),
        episode=next(iter(episodes.values())),
        captions={name: episode.caption for name, episode in shown.items()},
    )
