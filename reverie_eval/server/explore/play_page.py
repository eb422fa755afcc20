"""``/play``: a person walks an episode of an open split and sees how it is scored.

The URL has the episode's number in the sample, because a REVERIE id contains the target's id.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any
from urllib.parse import quote, urlencode

import msgspec
import numpy as np
from fastapi import APIRouter, Depends, Path, Query
from fastapi.responses import Response

from reverie_eval.analysis import VisibleObject
from reverie_eval.geometry import level_view
from reverie_eval.reporting.answer_svg import (
    ObjectLink,
    WayLink,
    ahead_svg,
    answer_svg,
    panorama_svg,
)
from reverie_eval.reporting.answers import answer_views, seen_in, span_of
from reverie_eval.reporting.buildings import room_view_of
from reverie_eval.reporting.map_svg import map_key, map_svg, visited_svg
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.reporting.skyboxes import find_skybox
from reverie_eval.server.explore.episodes import Browsing, EpisodeService
from reverie_eval.server.explore.play import MOST_STEPS, HumanWalk, Rivals, sample
from reverie_eval.server.http.callers import Visitor
from reverie_eval.server.http.rendering import drawn, page
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.store.paging import LARGEST
from reverie_eval.simulator import Candidate

router = APIRouter()

NAME = "Your walk"
NOTHING = "none"
"""In place of an object, if the person points at none."""
MOST_SAMPLED = 500
_TURN = 30
"""Degrees, as an agent turns."""


@dataclass(frozen=True)
class Played:
    """The query of a page: the sample that is played, and the walk so far."""

    seed: Annotated[int, Query(ge=0, le=LARGEST)] = 0
    n: Annotated[int, Query(ge=1, le=MOST_SAMPLED)] = 20
    walk: Annotated[str, Query(pattern=r"^([0-9]+(\.[0-9]+)*)?$", max_length=6 * MOST_STEPS)] = ""
    """Numbers of viewpoints with dots between them."""
    answer: Annotated[str, Query(pattern=rf"^([0-9]+|{NOTHING})?$", max_length=9)] = ""
    """The object, or ``none``; empty while the walk goes on."""
    choice: Annotated[str, Query(pattern=r"^[0-9]*$", max_length=9)] = ""
    """The object that is chosen in the form, without scripts, and not yet the answer."""
    facing: Annotated[int | None, Query(ge=0, lt=360)] = None
    """Where the person has turned to, degrees; None if they look where they went."""

    @property
    def steps(self) -> list[int]:
        """The numbers of the viewpoints."""
        return [int(number) for number in self.walk.split(".") if number]

    @property
    def object_id(self) -> int | None:
        """The object that the person pointed at."""
        return int(self.answer) if self.answer.isdigit() else None

    def link(self, split: str, number: int = 0, **changes: str | int) -> str:
        """Return the address of the sample, or of an episode in it and a walk through that."""
        query = {"seed": self.seed, "n": self.n} | changes
        given = urlencode({key: value for key, value in query.items() if value != ""})
        place = quote(split, safe="") + (f"/{number}" if number else "")
        return f"/play/{place}?{given}"


Asked = Annotated[Played, Depends()]


@router.get("/play/{split}")
def show_sample(split: str, visitor: Visitor, played: Asked) -> Response:
    """List the episodes of a sample."""
    with visitor.reading() as reading:
        browsing = visitor.server.get(EpisodeService).browse(
            reading.session, reading.caller, split, []
        )
        ids = sample(browsing.board, played.seed, played.n)
        instructions = browsing.annotations.instruction or [""] * len(browsing.annotations.scan)
        return page(
            reading,
            "play-sample.html",
            split=split,
            task=browsing.board.task,
            own_name=browsing.board.truth.split,
            played=played,
            sampled={instr_id: instructions[browsing.row(instr_id)] for instr_id in ids},
            most=MOST_SAMPLED,
            count=len(browsing.board.truth.episodes.instr_ids),
        )


@router.get("/play/{split}/{number}")
def play(
    split: str,
    number: Annotated[int, Path(ge=1)],
    visitor: Visitor,
    played: Asked,
    _: ScoringTurn,
) -> Response:
    """Show what a person sees from where they are; or, after the answer, how it is scored."""
    with visitor.reading() as reading:
        browsing = visitor.server.get(EpisodeService).browse(
            reading.session, reading.caller, split, []
        )
        walk = HumanWalk.of(browsing, played.seed, number, played.steps)
        content: dict[str, Any] = {"split": split, "number": number, "walk": walk}
        content |= {"task": walk.board.task, "played": played}
        if played.answer:
            content |= _scored(browsing, walk, played)
            return page(reading, "play-scored.html", **content)
        content |= _seen(walk, number, played)
        return page(reading, "play.html", **content)


def _seen(walk: HumanWalk, number: int, played: Played) -> dict[str, Any]:
    """Return what can be done from here: as links in two pictures, and as a list and a form."""
    split, seen = walk.board.split, walk.seen
    ways = [
        WayLink(
            heading=float(np.rad2deg(way.heading)) % 360,
            elevation=float(np.rad2deg(way.elevation)),
            metres=way.metres,
            label=f"walk {way.metres:.1f} m, heading {np.rad2deg(way.heading) % 360:.0f}°",
            href=played.link(split, number, walk=".".join(map(str, [*walk.steps, way.number]))),
        )
        for way in walk.ways
    ]
    heading = np.rad2deg(seen.heading) if played.facing is None else played.facing
    facing = round(float(heading)) % 360
    visible = [_visible(each) for each in seen.candidates]
    here: dict[str, str | int] = {"walk": played.walk, "facing": facing}
    candidates = [
        _object_link(each, played.link(split, number, **here, choice=each.object_id), played)
        for each in visible
    ]
    objects = sorted(candidates, key=lambda each: (each.name, each.span.middle))
    skybox = find_skybox(walk.board.truth.graph, seen.viewpoint_id)
    return {
        "ahead": drawn(_ahead(walk, [*zip(candidates, visible, strict=True)], ways, facing)),
        "panorama": drawn(panorama_svg(objects, ways, facing, skybox)),
        "turns": {
            name: played.link(
                split, number, walk=played.walk, choice=played.choice, facing=(facing + by) % 360
            )
            for name, by in (("Turn left", -_TURN), ("Turn right", _TURN))
        },
        "facing": facing,
        "been": drawn(visited_svg(walk.been)),
        "ways": ways,
        "objects": objects,
        "nothing": NOTHING,
    }


def _ahead(
    walk: HumanWalk,
    candidates: Sequence[tuple[ObjectLink, VisibleObject]],
    ways: Sequence[WayLink],
    facing: int,
) -> str:
    """Draw the level view ahead, with the boxes that it shows."""
    truth, viewpoint_id = walk.board.truth, walk.seen.viewpoint_id
    view = level_view(np.deg2rad(facing))
    visible = [each for _, each in candidates]
    seen = seen_in(view, visible)
    return ahead_svg(
        [(link, xywh) for link, each in candidates for xywh in each.xywh[each.view == view]],
        ways,
        view,
        # A task without objects has no rooms.
        room_view_of(truth.graph, truth.require_solution(), viewpoint_id, view, seen)
        if walk.board.task.has_targets
        else None,
        find_skybox(truth.graph, viewpoint_id),
    )


def _visible(seen: Candidate) -> VisibleObject:
    views, boxes = zip(*seen.boxes, strict=True)
    return VisibleObject(seen.object_id, seen.name or "object", np.array(views), np.array(boxes))


def _object_link(seen: VisibleObject, href: str, played: Played) -> ObjectLink:
    """Link to the page on which an object is chosen: to point at it does not end the episode."""
    span = span_of(seen)
    label = f"{seen.name}, heading {span.middle:.0f}°"
    is_chosen = str(seen.object_id) == played.choice
    return ObjectLink(seen.object_id, span, seen.name, label, f"{href}#answer", is_chosen)


def _scored(browsing: Browsing, walk: HumanWalk, played: Played) -> dict[str, Any]:
    """Return how the walk is scored, and what was to be found."""
    scored, record = walk.end(played.object_id)
    shown = EpisodeMap.of({NAME: scored})
    return {
        "count": len(walk.board.truth.episodes.instr_ids),
        "scored": scored,
        "rivals": Rivals.of(browsing, scored),
        "map": drawn(map_svg(shown)),
        "key": drawn(map_key(shown)),
        "answers": [
            (name, drawn(answer_svg(view)), view.caption)
            for name, view in answer_views({NAME: scored})
            if walk.board.task.has_targets
        ],
        "headline": [metric.key for metric in walk.board.task.headline_metrics(scored.values)],
        "record": msgspec.json.encode(record).decode(),
    }
