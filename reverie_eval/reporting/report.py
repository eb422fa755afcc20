"""The HTML report: one file that opens without a network, to read or to send to a colleague.

Needs Jinja2. Markup that is inserted was escaped where it was built; the template escapes
everything else.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import TYPE_CHECKING, Any

from reverie_eval.analysis import (
    Comparison,
    Episode,
    check_comparable,
    episodes_won,
    near_misses,
    with_different_routes,
)
from reverie_eval.errors import ProtocolError, naming_missing_parts
from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting import report_sections as sections
from reverie_eval.reporting.answer_svg import answer_svg
from reverie_eval.reporting.answers import answer_views
from reverie_eval.reporting.building_svg import BUILDING_STYLE
from reverie_eval.reporting.comparisons import comparison_table, procedures, sentences
from reverie_eval.reporting.drawing import share_repeated
from reverie_eval.reporting.map_svg import map_key, map_svg, replay_html
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.reporting.resources import as_markup, text_of
from reverie_eval.scoring import FEW_CLUSTERS, OUTCOMES, Clustering, Intervals, Scores
from reverie_eval.submissions import check_names
from reverie_eval.text import count_text

with naming_missing_parts():
    from jinja2 import Environment, PackageLoader, StrictUndefined

if TYPE_CHECKING:
    from markupsafe import Markup

_TEMPLATE = "report.html.jinja"
_STYLES = text_of("report.css"), text_of("shared/charts.css"), BUILDING_STYLE
# Rows of a breakdown that are shown; the others are folded.
_SHOWN_GROUPS = 10
_LISTED_CHANGES = 50


@dataclass(frozen=True)
class Card:
    """An episode's map and the pictures of its answers, with captions."""

    picture: "Markup"
    answers: Sequence[tuple[str, "Markup", str]]
    """Name of the submission, picture and caption of each."""
    replays: Sequence["Markup"]
    """The steps of each submission whose run has a log."""
    map: EpisodeMap
    episode: Episode
    """The first submission's episode."""
    captions: Mapping[str, str]
    """Captions by submission."""


@dataclass(frozen=True)
class Change:
    """The episodes that only one of two submissions got right."""

    title: str
    total: int
    listed: Sequence[tuple[Episode, Episode]]
    """The first few of them, each as scored for both submissions."""
    cards: Sequence[Card]


def report_html(scores: Mapping[str, Scores], cluster: Clustering = "target") -> str:
    """Write a report on a submission, compared with others if they are given.

    Parameters
    ----------
    scores : mapping of Scores
        One or more by name; the report is about the first. With intervals, the report shows them.
        Of more than two, the others are in the scores, the comparison and the costs.
    cluster : "target" or "scan"
        Episodes with the same one are not treated as independent in the comparison. If all
        episodes have the same one, the report says that they are not compared.

    Returns
    -------
    str
        A page of HTML; the same scores give the same page.

    Raises
    ------
    ProtocolError
        If there is none, they cannot be compared, or a name is not text.
    """
    check_names(scores)
    if not scores:
        raise ProtocolError("a report is about one submission or more; got none")
    environment = Environment(
        loader=PackageLoader("reverie_eval.reporting", "resources"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        # A name that the template misspells is an error, not an empty place.
        undefined=StrictUndefined,
    )
    return share_repeated(environment.get_template(_TEMPLATE).render(_context(scores, cluster)))


def _context(every: Mapping[str, Scores], cluster: Clustering) -> dict[str, Any]:
    (name, first), *others = every.items()
    # Columns, colours and captions of outcomes, groups and maps are those of one or a pair.
    scores = every if len(others) < 2 else {name: first}
    breakdowns, notes = sections.breakdowns(scores)
    why_not = Intervals.why_not(first.ground_truth, cluster)
    if others:
        check_comparable(every)
    # A report of a small split still shows who won which episodes.
    comparison = Comparison.of(every, cluster) if others and not why_not else None
    return {
        "styles": [as_markup(style) for style in _STYLES],
        "name": name,
        "names": list(scores),
        "all_names": list(every),
        "scores": every,
        "first": first,
        "score_rows": sections.score_rows(every),
        "why_not": why_not,
        "sentences": sentences(comparison) if comparison else [],
        "comparison": _differences(comparison) if comparison else None,
        "procedures": procedures(comparison) if comparison else [f"not compared: {why_not}"],
        "costs": sections.costs(every, comparison, cluster),
        "main_finding": sections.main_finding(first),
        "has_walks": sections.has_walks(scores),
        "has_outcomes": sections.has_outcomes(scores),
        "breakdowns": breakdowns,
        "breakdown_notes": notes,
        "scans": sections.scans_worst_first(scores),
        "shown_groups": _SHOWN_GROUPS,
        "few_episodes": sections.FEW_EPISODES,
        "few_targets": FEW_CLUSTERS,
        "success": CATALOGUE["success"] if sections.has_walks(scores) else None,
        "primary": sections.shared_primary(scores),
        "charts": list(sections.charts(scores)),
        **(_outcomes(scores) if sections.has_outcomes(scores) else {}),
        **(_changes(scores) if len(scores) > 1 else {"other_name": None}),
    }


def _outcomes(scores: Mapping[str, Scores]) -> dict[str, Any]:
    """Return what a report says about outcomes, which need navigation and answers."""
    (name, first), *_ = scores.items()
    misses = [
        (failure, OUTCOMES[failure], [_card({name: first}, each) for each in instr_ids])
        for failure, instr_ids in near_misses(first).items()
        if instr_ids
    ]
    modes = [each.failure_modes for each in scores.values()]
    return {
        "funnel": sections.funnel_rows(modes),
        "outcomes": sections.outcome_rows(modes),
        "goal_reached_notes": sections.goal_reached_notes(scores),
        "near_misses": misses,
        "map_key": as_markup(map_key(*(card.map for _, _, cards in misses for card in cards))),
    }


def _changes(scores: Mapping[str, Scores]) -> dict[str, Any]:
    """Say on which episodes the second submission differs from the first."""
    (name, first), (other_name, other) = scores.items()
    changes = [
        _change(other_name, scores, episodes_won(first, other)),
        _change(name, scores, episodes_won(other, first)),
    ]
    return {
        "other_name": other_name,
        "outcome_names": list(sections.BEST_OUTCOME_FIRST),
        "outcome_changes": sections.outcome_changes(first, other)
        if sections.has_outcomes(scores)
        else [],
        "changes": changes,
        "both_key": as_markup(map_key(*(card.map for each in changes for card in each.cards))),
    }


def _differences(comparison: Comparison) -> "Markup":
    """Show the table of a comparison alone; the report has its sentences and notes elsewhere."""
    return as_markup(replace(comparison_table(comparison), findings=(), notes=()).to_html())


def _change(winner: str, scores: Mapping[str, Scores], instr_ids: Sequence[str]) -> Change:
    first, other = scores.values()
    # Without walks there is nothing to draw.
    drawn = with_different_routes(first, instr_ids) if sections.has_walks(scores) else []
    return Change(
        title=f"{count_text(len(instr_ids), 'episode')} that only {winner} got right",
        total=len(instr_ids),
        listed=[(first.episode(id_), other.episode(id_)) for id_ in instr_ids[:_LISTED_CHANGES]],
        cards=[_card(scores, id_) for id_ in drawn],
    )


def _card(scores: Mapping[str, Scores], instr_id: str) -> Card:
    episodes = {name: each.episode(instr_id) for name, each in scores.items()}
    first = next(iter(episodes.values()))
    shown = episodes if len(scores) > 1 else {"": first}
    episode_map = EpisodeMap.of(shown)
    captions = {
        name: "; ".join(filter(None, [episode.caption, level_note]))
        for (name, episode), level_note in zip(shown.items(), episode_map.level_notes, strict=True)
    }
    answers = [
        (name, as_markup(answer_svg(view, number)), view.caption)
        for number, (name, view) in enumerate(answer_views(shown), 1)
    ]
    replays = [
        as_markup(f"{escape(name)} {replay}")
        for name, episode in shown.items()
        if (replay := replay_html(episode, episode_map))
    ]
    return Card(as_markup(map_svg(episode_map)), answers, replays, episode_map, first, captions)
