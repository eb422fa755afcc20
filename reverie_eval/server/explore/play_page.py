"""``/play``: a person walks an episode of an open split and sees how it is scored.

They see what an agent sees: the instruction, the connected viewpoints, and the visible objects, but
not which of them is the target. The walk is in the address of the page, so nothing is stored. The
address has the episode's number in the sample, because a REVERIE id contains the target's id.
"""

import math
import random
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any
from urllib.parse import quote, urlencode

import msgspec
import numpy as np
from fastapi import APIRouter, Depends, Path, Query, Response

from reverie_eval.analysis import Episode, VisibleObject
from reverie_eval.arrays import FloatArray
from reverie_eval.errors import ActionError
from reverie_eval.geometry import RoomView, level_view, view_angles
from reverie_eval.metrics import ABSTAINED
from reverie_eval.reporting.answer_svg import (
    ObjectLink,
    WayLink,
    ahead_svg,
    answer_svg,
    panorama_svg,
)
from reverie_eval.reporting.answers import answer_views, picture_of, seen_in, span_of
from reverie_eval.reporting.buildings import room_view_of
from reverie_eval.reporting.map_svg import map_key, map_svg, visited_svg
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.reporting.skyboxes import find_skybox
from reverie_eval.scoring import PreparedSubmission
from reverie_eval.server.errors import MalformedError, NotFoundError
from reverie_eval.server.explore.episodes import Browsing, EpisodeService, align_walks
from reverie_eval.server.http.callers import Visitor
from reverie_eval.server.http.rendering import drawn, page
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.store.paging import LARGEST
from reverie_eval.simulator import Answer, Candidate, Environment, Go, Observation, Stop

router = APIRouter()

NAME = "Your walk"
NOTHING = "none"
"""In place of an object, if the person points at none."""
MOST_SAMPLED = 500
_TURN = 30
"""Degrees, as an agent turns."""
MOST_STEPS = 200
"""Steps of a walk, at most; twenty times as many as annotated paths have."""


@dataclass(frozen=True, slots=True)
class Way:
    """A viewpoint that a person can move to from where they are."""

    number: int
    """The viewpoint's number in its scan."""
    heading: float
    """Radians."""
    elevation: float
    """Radians."""
    metres: float


@dataclass(frozen=True)
class HumanWalk:
    """The steps of a person through an episode so far."""

    board: Board
    instr_id: str
    steps: Sequence[int]
    """The viewpoints after the start, by their numbers in the scan."""
    visited: Sequence[str]
    """The viewpoints from the start on."""
    metres: float
    """The length of the walk so far."""
    seen: Observation
    """What the person sees from where they are."""
    _environment: Environment

    @classmethod
    def of(cls, browsing: Browsing, seed: int, number: int, steps: Sequence[int]) -> "HumanWalk":
        """Follow a person's steps through an episode, given by its number from 1 in a sample.

        Raises
        ------
        NotFoundError
            If the split has fewer episodes, or scores only answers.
        MalformedError
            If a step is not one of the ways on, or there are too many.
        """
        board = browsing.board
        if board.settings.track == "grounding":
            raise NotFoundError(f"{board.split} scores answers alone; there are no walks")
        drawn = sample(board, seed, number)
        if len(drawn) < number:
            raise NotFoundError(f"{board.split} has {len(drawn)} episodes")
        if len(steps) > MOST_STEPS:
            raise MalformedError(f"a walk has at most {MOST_STEPS} steps")
        environment = Environment(board.truth)
        seen = environment.reset(drawn[-1])
        visited, metres = [seen.viewpoint_id], 0.0
        scan = _viewpoints_of_scan(board, seen.viewpoint_id)
        for step in steps:
            if step >= len(scan):
                raise MalformedError("the walk has a step to a viewpoint that does not exist")
            distance = {each.viewpoint_id: each.distance for each in seen.neighbours}
            if scan[step] not in distance:
                raise MalformedError("the walk has a step to a viewpoint that is not connected")
            seen = environment.step(Go(scan[step]))
            visited.append(scan[step])
            metres += distance[scan[step]]
        return cls(board, drawn[-1], steps, visited, metres, seen, environment)

    @property
    def been(self) -> FloatArray:
        """Where the person has been, the start first: shape (n, 3), metres."""
        graph = self.board.truth.graph
        rows = [graph.index[viewpoint_id] for viewpoint_id in self.visited]
        return graph.viewpoint_position[rows]

    @property
    def ways(self) -> Sequence[Way]:
        """The viewpoints that the person can move to, by heading."""
        scan = _viewpoints_of_scan(self.board, self.seen.viewpoint_id)
        number = {viewpoint_id: index for index, viewpoint_id in enumerate(scan)}
        ways = [
            Way(
                number=number[each.viewpoint_id],
                heading=(self.seen.heading + each.relative_heading) % math.tau,
                elevation=self.seen.elevation + each.relative_elevation,
                metres=each.distance,
            )
            for each in self.seen.neighbours
        ]
        return sorted(ways, key=lambda way: way.heading)

    def end(self, object_id: int | None) -> tuple[Episode, Mapping[str, Any]]:
        """End the walk with an object, or none.

        Returns the episode, scored under the rules of the split, and its record in a submission.

        Raises
        ------
        MalformedError
            If no such object is visible.
        """
        try:
            self._environment.step(Stop() if object_id is None else Answer(object_id))
        except ActionError:
            message = f"object {object_id} is not visible from where the walk ends"
            raise MalformedError(message) from None
        (record,) = self._environment.submission()
        truth = self.board.truth
        viewpoints = [truth.graph.index[viewpoint_id] for viewpoint_id in self.visited]
        answer = ABSTAINED if object_id is None else object_id
        walks = align_walks(truth, {truth.row_of(self.instr_id): (viewpoints, answer)})
        scores = self.board.score(PreparedSubmission(walks, truth))
        return scores.episode(self.instr_id), record


@dataclass(frozen=True, slots=True)
class Rivals:
    """How methods did in an episode that a person has walked."""

    methods: int
    solved: int
    """How many of them solve it."""
    median: float | None
    """Metres that those walk, in the middle; None if there are none."""
    longer: int
    """How many of those walk farther than the person."""

    @classmethod
    def of(cls, browsing: Browsing, walked: Episode) -> "Rivals | None":
        """Compare a walk with those of methods that everyone may look at; None without any."""
        if browsing.methods is None:
            return None
        lengths = browsing.methods.lengths(browsing.row(walked.instr_id))
        own = walked.values["path_length"]
        return cls(
            methods=len(browsing.methods.methods),
            solved=len(lengths),
            median=float(np.median(lengths)) if lengths else None,
            longer=sum(each > own for each in lengths),
        )


def _viewpoints_of_scan(board: Board, viewpoint_id: str) -> Sequence[str]:
    """Return the viewpoints of a scan, in the order of their numbers."""
    graph = board.truth.graph
    scan = graph.viewpoint_scan[graph.index[viewpoint_id]]
    begin, end = np.searchsorted(graph.viewpoint_scan, [scan, scan + 1])
    return graph.viewpoint_ids[begin:end]


def sample(board: Board, seed: int, size: int) -> Sequence[str]:
    """Draw distinct episodes at random; the same seed draws the same ones in the same order.

    Every item has one instruction before any has a second, because a target is known once seen.
    """
    ids, items = board.truth.episodes.instr_ids, board.truth.episodes.item.tolist()
    shuffled = random.Random(seed).sample(range(len(ids)), len(ids))  # noqa: S311
    earlier: Counter[int] = Counter()
    turns = {}
    for row in shuffled:
        turns[row] = earlier[items[row]]
        earlier[items[row]] += 1
    return [ids[row] for row in sorted(shuffled, key=turns.__getitem__)[:size]]


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
        browsing = visitor.server.get(EpisodeService).browse(reading, reading.caller, split, [])
        ids = sample(browsing.board, played.seed, played.n)
        instructions = browsing.annotations.instruction
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
        browsing = visitor.server.get(EpisodeService).browse(reading, reading.caller, split, [])
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
    heading = seen.heading if played.facing is None else np.deg2rad(played.facing)
    # What is said is the direction of the view that is shown, the nearest of twelve.
    view = level_view(heading)
    facing = round(float(np.rad2deg(view_angles(np.array([view]))[0, 0])))
    visible = [_visible(each) for each in seen.candidates]
    here: dict[str, str | int] = {"walk": played.walk, "facing": facing}
    candidates = [
        _object_link(each, played.link(split, number, **here, choice=each.object_id), played)
        for each in visible
    ]
    objects = sorted(candidates, key=lambda each: (each.name, each.span.middle))
    room_view = _room_ahead(walk, view, visible)
    skybox = find_skybox(walk.board.truth.graph, seen.viewpoint_id)
    pointed_at = [*zip(candidates, visible, strict=True)]
    shown = picture_of(view, room_view, skybox)
    return {
        "ahead": drawn(ahead_svg(pointed_at, ways, view, room_view, skybox)),
        "panorama": drawn(panorama_svg(objects, ways, facing, shown, skybox)),
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


def _room_ahead(walk: HumanWalk, view: int, visible: Sequence[VisibleObject]) -> RoomView | None:
    """Return a drawing of what is ahead; None for a task without objects, which has no rooms."""
    if not walk.board.task.has_targets:
        return None
    truth, viewpoint_id = walk.board.truth, walk.seen.viewpoint_id
    seen = seen_in(view, visible)
    return room_view_of(truth.graph, truth.require_solution(), viewpoint_id, view, seen)


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
            for name, view in answer_views({NAME: scored}, "You")
            if walk.board.task.has_targets
        ],
        "headline": [metric.key for metric in walk.board.task.headline_metrics(scored.values)],
        "record": msgspec.json.encode(record).decode(),
    }
