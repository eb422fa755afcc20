"""The episode browser: the list of episodes, and each one on its map."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from typing import Annotated, Any
from urllib.parse import quote, urlencode

import numpy as np
from fastapi import APIRouter, Depends, Query, Response
from markupsafe import Markup

from reverie_eval.analysis import Episode, WalkOutcomes
from reverie_eval.errors import ProtocolError
from reverie_eval.geometry import level_view
from reverie_eval.reporting.answer_svg import answer_picture, answer_svg
from reverie_eval.reporting.answers import AnswerView, answer_views
from reverie_eval.reporting.map_svg import interactive_map_svg, map_key
from reverie_eval.reporting.maps import EpisodeMap, Step
from reverie_eval.reporting.outcomes import OPACITIES, STOPS, WalkFaults
from reverie_eval.reporting.report_sections import BEST_OUTCOME_FIRST, funnel_rows, outcome_rows
from reverie_eval.server.boards.leaderboard import make_distinct
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.explore.episodes import (
    Browsing,
    EpisodeFilter,
    EpisodeService,
    Run,
)
from reverie_eval.server.explore.side_by_side import DIFFICULTIES
from reverie_eval.server.http.callers import Call, CallReading, Visitor
from reverie_eval.server.http.rendering import drawn, page
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.store.damage import if_readable
from reverie_eval.text import category_text

router = APIRouter()

PER_PAGE = 50
MOST_CHOICES = 12
"""Submissions of a split that the list of splits shows."""
MOST_BUILDINGS = 12
"""Buildings that a split's page lists, at most."""
MOST_SOLVERS = 3
"""Methods that solve an episode and are named on its page, at most: the best."""
MOST_STEPS = 200
"""The longest list of steps that a page shows."""


@dataclass(frozen=True)
class Selection(EpisodeFilter):
    """The query of a page: which episodes, and the routes of which submissions."""

    submission: str = ""
    other: str = ""

    @property
    def submissions(self) -> Sequence[str]:
        """The ids of the chosen submissions: none, one or two."""
        return list(dict.fromkeys(filter(None, (self.submission, self.other))))

    def link(self, split: str, instr_id: str = "", **changes: str | int) -> str:
        """Return the address of the list, or of one episode, with some of the query changed."""
        query = {key: value for key, value in (asdict(self) | changes).items() if value}
        place = "/".join(quote(part, safe="") for part in (split, instr_id) if part)
        return f"/episodes/{place}?{urlencode(query)}".removesuffix("?")


Selected = Annotated[Selection, Depends()]


@dataclass(frozen=True, slots=True)
class Neighbours:
    """The episodes before and after one, among those that match the filter."""

    previous: str | None
    next: str | None
    number: int | None
    """The episode's own position among them, from 1; None if it does not match."""
    count: int


@dataclass(frozen=True, slots=True)
class AnswerPicture:
    """A picture of what is visible from a viewpoint."""

    name: str
    """The name of the submission; empty if only the target is shown."""
    picture: Markup
    caption: str


@dataclass(frozen=True, slots=True)
class Walk:
    """An agent's route through an episode, as a table shows it."""

    name: str
    run: Run
    episode: Episode
    details: str
    """The answer, the lengths and the levels."""
    steps: Sequence[Step]
    """At most MOST_STEPS."""
    unlisted: int
    """The number of further steps."""


@router.get("/episodes")
def show_splits(visitor: Visitor) -> Response:
    """List the open splits."""
    episodes = visitor.server.get(EpisodeService)
    with visitor.reading() as reading:
        choices = partial(episodes.choices, reading, reading.caller)
        splits = [
            (board, if_readable(board.label, partial(choices, board))) for board in episodes.boards
        ]
        return page(reading, "episodes.html", splits=splits, most=MOST_CHOICES)


@router.get("/episodes/{split}")
def show_episodes(
    split: str,
    visitor: Visitor,
    selection: Selected,
    _: ScoringTurn,
    number: Annotated[int, Query(alias="page", ge=1)] = 1,
) -> Response:
    """List the episodes of an open split, with their outcomes."""
    with visitor.reading() as reading:
        browsing = _browsing(visitor, reading, split, selection)
        rows = browsing.rows(selection)
        has_outcomes = all(run.outcome for run in browsing.runs)
        failures = [browsing.failure_modes(run, selection) for run in browsing.runs if has_outcomes]
        pages = max(1, -(-len(rows) // PER_PAGE))
        number = min(number, pages)
        return page(
            reading,
            "episodes-list.html",
            browsing=browsing,
            selection=selection,
            names=_names(browsing.runs),
            rows=rows[(number - 1) * PER_PAGE : number * PER_PAGE].tolist(),
            count=len(rows),
            number=number,
            pages=pages,
            funnel=funnel_rows(failures) if failures else (),
            parts=outcome_rows(failures) if failures else (),
            outcomes=BEST_OUTCOME_FIRST,
            scans=sorted(set(browsing.annotations.scan)),
            categories={
                name: category_text(name) for name in sorted(set(browsing.annotations.category))
            },
            difficulties=DIFFICULTIES,
            matrix=_matrix(browsing, selection),
            opacities=OPACITIES,
            storeys=[(name, drawn(it)) for name, it in _faults(browsing, selection.scan)],
            stops=STOPS,
            most_buildings=MOST_BUILDINGS,
        )


@router.get("/episodes/{split}/{instr_id}")
def show_episode(
    split: str, instr_id: str, visitor: Visitor, selection: Selected, _: ScoringTurn
) -> Response:
    """Show an episode on the map of its scan, with the routes of up to two submissions."""
    with visitor.reading() as reading:
        browsing = _browsing(visitor, reading, split, selection)
        service = visitor.server.get(EpisodeService)
        headings = [service.headings(browsing.board, run, instr_id) for run in browsing.runs]
        content = _episode_content(browsing, selection, instr_id, headings)
        return page(reading, "episode.html", **content)


@router.get("/episodes/{split}/{instr_id}/view")
def show_view(
    split: str,
    instr_id: str,
    viewpoint: str,
    heading: Annotated[int, Query(ge=0, lt=360)],
    visitor: Visitor,
    _: ScoringTurn,
) -> Response:
    """Draw what is seen from a viewpoint, in the level view nearest to a heading, degrees."""
    with visitor.reading() as reading:
        episode = _browsing(visitor, reading, split, Selection()).episode(instr_id)
    row = episode.graph.index.get(viewpoint)
    if row is None or episode.graph.scan_of(row) != episode.scan:
        raise NotFoundError(f"there is no viewpoint {viewpoint!r} in scan {episode.scan}")
    view = level_view(np.deg2rad(heading))
    drawing = answer_picture(AnswerView.at_step(episode, viewpoint, view))
    # A replay shows the same views again.
    kept = {"Cache-Control": "private, max-age=600"}
    return Response(drawing, media_type="image/svg+xml", headers=kept)


def _matrix(browsing: Browsing, selection: Selection) -> Markup | None:
    """Return the picture of all methods on all episodes, if nothing is chosen yet."""
    methods = browsing.methods if selection == Selection() else None
    return None if methods is None else drawn(methods.matrix)


def _faults(browsing: Browsing, scan: str) -> Sequence[tuple[str, str]]:
    """Return the storeys of a scan with where the chosen walks end, or those of all methods."""
    if scan not in browsing.board.truth.graph.scan_ids:
        return ()
    if not browsing.runs:
        return browsing.methods.faults(scan) if browsing.methods else ()
    try:
        walks = [WalkOutcomes.of(run.scores) for run in browsing.runs]
    except ProtocolError:
        return ()
    return WalkFaults.of(browsing.board.truth, scan, walks).pictures()


def _browsing(visitor: Call, reading: CallReading, split: str, selection: Selection) -> Browsing:
    """Return the requested episodes and submissions, if the visitor may see them."""
    episodes, submissions = visitor.server.get(EpisodeService), selection.submissions
    return episodes.browse(reading, reading.caller, split, submissions)


def _episode_content(
    browsing: Browsing,
    selection: Selection,
    instr_id: str,
    headings: Sequence[Sequence[float | None]],
) -> Mapping[str, Any]:
    episode = browsing.episode(instr_id)
    names = _names(browsing.runs)
    keys = list(browsing.runs[0].scores if browsing.runs else ())
    walked = {
        name: run.scores.episode(instr_id) for name, run in zip(names, browsing.runs, strict=True)
    }
    shown = EpisodeMap.of(walked) if walked else EpisodeMap.of({"": episode}).without_routes()
    return {
        "browsing": browsing,
        "selection": selection,
        "episode": episode,
        "map": shown,
        "picture": drawn(interactive_map_svg(shown)),
        "key": drawn(map_key(shown)),
        "answers": _answers(episode, walked) if browsing.board.task.has_targets else (),
        "walks": _walks(browsing.runs, walked, shown, headings),
        "neighbours": _neighbours(browsing, selection, instr_id),
        "solvers": browsing.methods and browsing.methods.solvers(browsing.row(instr_id)),
        "most_solvers": MOST_SOLVERS,
        "goals": _goals(episode, shown),
        # Where the episode is on several, all of them are drawn.
        "levels": () if shown.leaves_level else range(1, int(shown.storey.max()) + 2),
        "outcomes": BEST_OUTCOME_FIRST,
        "headline": [key for key in keys if key in browsing.board.task.headline],
        "other_metrics": [key for key in keys if key not in browsing.board.task.headline],
        "filters": {field.name: getattr(selection, field.name) for field in fields(EpisodeFilter)},
    }


def _answers(episode: Episode, walked: Mapping[str, Episode]) -> Sequence[AnswerPicture]:
    """Draw the answers; without a submission, the target."""
    at_end = AnswerView.at_path_end(episode)
    views = answer_views(walked) if walked else [("", at_end)] if at_end else []
    return [
        AnswerPicture(name, drawn(answer_svg(view, number)), view.caption)
        for number, (name, view) in enumerate(views, 1)
    ]


def _names(runs: Sequence[Run]) -> Sequence[str]:
    """Name submissions by their methods, with their ids if the methods have the same name."""
    choices = [run.choice for run in runs]
    return make_distinct([each.method for each in choices], [each.id for each in choices])


def _neighbours(browsing: Browsing, selection: Selection, instr_id: str) -> Neighbours:
    rows, row = browsing.rows(selection), browsing.row(instr_id)
    ids = browsing.annotations.scores.instr_ids
    before, after = rows[rows < row], rows[rows > row]
    return Neighbours(
        previous=ids[before[-1]] if len(before) else None,
        next=ids[after[0]] if len(after) else None,
        number=len(before) + 1 if (rows == row).any() else None,
        count=len(rows),
    )


def _walks(
    runs: Sequence[Run],
    walked: Mapping[str, Episode],
    shown: EpisodeMap,
    headings: Sequence[Sequence[float | None]],
) -> Sequence[Walk]:
    walks = []
    columns = zip(runs, shown.routes, walked.items(), headings, strict=True)
    for run, route, (name, episode), looks in columns:
        steps = shown.steps(route, looks)
        listed = steps[:MOST_STEPS]
        caption = episode.caption.removeprefix(f"{episode.outcome}: ")
        details = "; ".join(filter(None, [caption, shown.level_note(route)]))
        walks.append(Walk(name, run, episode, details, listed, len(steps) - len(listed)))
    return walks


def _goals(episode: Episode, shown: EpisodeMap) -> Sequence[tuple[str, int, float]]:
    """List the goal viewpoints, each with its level and the metres to the path's end."""
    levels = shown.storey[shown.goal_viewpoints] + 1
    metres = shown.to_path_end(shown.goal_viewpoints)
    listed = zip(episode.goal_viewpoints, levels.tolist(), metres.tolist(), strict=True)
    return sorted(listed, key=lambda goal: goal[2])
