"""Pictures of answers as SVG: one view, and below it the whole panorama around the agent.

The panorama alone, with links to objects and moves, is for a person who plays an episode. Without
photographs, the view shows a drawn room with solids, and the panorama an empty one with a horizon.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from itertools import groupby
from operator import itemgetter
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np

from reverie_eval.analysis import VisibleObject
from reverie_eval.arrays import Array, FloatArray
from reverie_eval.geometry import Picture, RoomView, view_angles
from reverie_eval.reporting.answers import (
    AnswerView,
    Span,
    angles_of,
    box_span,
    directions_of,
    look,
    outlines_in,
    picture_of,
    span_of,
)
from reverie_eval.reporting.drawing import image_svg, line_data, path
from reverie_eval.reporting.resources import text_of
from reverie_eval.reporting.skyboxes import Skybox

ANSWER_STYLE = text_of("shared/answer.css")
"""The style sheet for pages with pictures of answers; :func:`answer_picture` includes it."""
WIDTH, HEIGHT = 400, 300
"""Size of the view, in units of the page."""
_GAP = 8
# Units of the page per degree of the panorama.
_DEGREE = WIDTH / 360
# Degrees above and below the horizon that views show.
_HIGHEST = 60
_STRIP_HEIGHT = 2 * _HIGHEST * _DEGREE
_TICKS_HEIGHT, _TICK_MARGIN, _ROLE_MARGIN, _ROLE_LINE = 16, 13, 25, 13
# Metres from the floor to a camera, about.
_EYES = 1.5
# Degrees between the lines of the grid.
_STEP = 30
# Width of a letter in a label by its role, in units of the page.
_LETTER: Mapping[str, float] = MappingProxyType({"other": 6.9, "target": 8.3, "answer": 8.3})
# Height of a line of labels, in units of the page.
_LINE = 15.0
# Units of the page: faces that are not so large are not drawn.
_TINY = 0.8
# Baselines of the highest and the lowest label, in units of the page.
_HIGHEST_LINE, _LOWEST_LINE = 12, HEIGHT - 4

Role = Literal["other", "target", "answer"]


class _Marks(NamedTuple):
    """Sizes of what can be pointed at in a picture, in units of the page."""

    radius: float
    """Radius of the circle of a way, which a finger hits on a phone."""
    letter: float
    """Width of a letter of objects' names."""
    line: float
    """Height of a line of them."""


_IN_PANORAMA, _IN_VIEW = _Marks(5.5, 3.0, 5.5), _Marks(12.0, 7.8, 16.0)


class ObjectLink(NamedTuple):
    """An object, and the address to which its link leads."""

    object_id: int
    span: Span
    name: str
    """Shown above it, if there is room."""
    label: str
    """Distinguishes it from other objects of the same name."""
    href: str
    is_chosen: bool = False
    """Whether it is the one that the person has chosen so far."""


class WayLink(NamedTuple):
    """A viewpoint that the person can move to, and the address to which its link leads."""

    heading: float
    """Degrees."""
    elevation: float
    """Degrees."""
    metres: float
    label: str
    href: str


def answer_svg(shown: AnswerView, number: int = 1) -> str:
    """Draw a picture for a page that includes ``ANSWER_STYLE``.

    The answer has the colour of the submission with this number on maps.
    """
    return _draw(shown, number)


def answer_picture(shown: AnswerView) -> str:
    """Draw a picture that includes its style sheet, for a file or any page."""
    return _draw(shown, 1, ANSWER_STYLE)


def answer_shapes(shown: AnswerView) -> tuple[str, float]:
    """Draw the view of an answer, or the panorama if no view shows it, and say how high it is."""
    if shown.picture is None:
        return "".join(_panorama(shown)), _STRIP_HEIGHT + _TICKS_HEIGHT
    return "".join(_view(shown, shown.picture)), HEIGHT


def view_svg(shown: AnswerView) -> str:
    """Draw the view of a step without the panorama, for a page that includes ``ANSWER_STYLE``."""
    shapes, height = answer_shapes(shown)
    return image_svg(answer_class(shapes, 1), (WIDTH, height), shapes, shown.caption)


def answer_class(shapes: str, number: int) -> str:
    """Return the class of the shapes of a submission's answer, which says how they look."""
    return f"answer-view route-{number}{_on(shapes)}"


def _on(shapes: str) -> str:
    """Return the class that says on what boxes and texts lie."""
    return " on-photograph" if "<image" in shapes else " in-room" if "<g" in shapes else ""


def _draw(shown: AnswerView, number: int, style: str = "") -> str:
    top = 0 if shown.picture is None else HEIGHT + _GAP
    view = "" if shown.picture is None else "".join(_view(shown, shown.picture))
    shapes = f'{view}<g transform="translate(0 {top})">{"".join(_panorama(shown))}</g>'
    return image_svg(
        answer_class(shapes, number),
        (WIDTH, top + _STRIP_HEIGHT + _TICKS_HEIGHT),
        shapes,
        f"What is visible from viewpoint {shown.viewpoint_id}",
        description=shown.description,
        style=style,
    )


def panorama_svg(
    objects: Sequence[ObjectLink],
    ways: Sequence[WayLink],
    heading: float,
    ahead: Picture,
    skybox: Skybox | None = None,
) -> str:
    """Draw a panorama with links, to play an episode, for a page that includes ``ANSWER_STYLE``.

    ``heading``, in degrees, is in the middle; a frame has what the picture ``ahead`` shows, and
    ``skybox`` has the photographs, if there are any. Ways are numbered from 1. What is smaller lies
    on top, so that no large box covers it; not what is nearer, because a box is more than its
    object: that of a near rug covers a desk behind it. The links are for pointers, and out of the
    order of the tab key: the page has lists of them.
    """
    height = _STRIP_HEIGHT + _TICKS_HEIGHT
    photograph = skybox.panorama(heading, _HIGHEST) if skybox else ""
    links = [
        _Link(
            each,
            "".join(_on_panorama("other", each.span, heading, each.label)),
            _DEGREE**2 * (each.span.right - each.span.left) * (each.span.high - each.span.low),
            *_position(np.array([each.span.middle, each.span.high]), heading).tolist(),
        )
        for each in objects
    ]
    points = [_position(np.array([way.heading, way.elevation]), heading) for way in ways]
    ground = "".join(_grid(heading, photograph))
    return (
        f'<svg class="answer-view panorama{_on(ground)}" viewBox="0 0 {WIDTH} {height:.0f}">'
        f"<title>Panorama, with heading {heading % 360:.0f}° in the middle</title>{ground}"
        f"{_linked(links, _numbered(ways, points), _IN_PANORAMA)}"
        f"{_frame(ahead, heading)}</svg>"
    )


def ahead_svg(
    objects: Sequence[tuple[ObjectLink, VisibleObject]],
    ways: Sequence[WayLink],
    view: int,
    room_view: RoomView | None,
    skybox: Skybox | None = None,
) -> str:
    """Draw a level view with links, as :func:`panorama_svg` does with the panorama.

    Each object has its box in the view, shape (4,): that is where it can be pointed at. Ways lie on
    the floor, or at the lower edge if they begin below it.
    """
    picture = picture_of(view, room_view, skybox)
    if room_view and picture == room_view.picture:
        ground = room_shapes(room_view)
    else:
        ground = _background(skybox.view(view) if skybox else "", HEIGHT, HEIGHT / 2)
    heading = float(np.rad2deg(view_angles(np.array([view]))[0, 0]))
    links = [
        _link_to(link, outline) for link, each in objects for outline in _outlines(picture, each)
    ]
    shown = _numbered(ways, [_on_floor(way, picture) for way in ways])
    return (
        f'<svg class="answer-view ahead{_on(ground)}" viewBox="0 0 {WIDTH} {HEIGHT}">'
        f"<title>The view ahead, heading {heading:.0f}°</title>{ground}"
        f"{_linked(links, shown, _IN_VIEW)}</svg>"
    )


def _outlined(shown: AnswerView) -> Iterator[tuple[Role, VisibleObject]]:
    """Yield the objects with their roles, the most important last; an object may have two."""
    yield from (("other", each) for each in shown.objects)
    if shown.target:
        yield "target", shown.target
    if shown.predicted:
        yield "answer", shown.predicted


# The view.


def room_shapes(room_view: RoomView) -> str:
    """Draw a room and its solids."""
    shapes = (
        path(
            kind,
            "".join(
                line_data(outline) + "z"
                for face in same
                for outline in (_on_page(room_view.picture, each) for each in face.outlines)
                if np.ptp(outline, axis=0).max() >= _TINY
            ),
        )
        for kind, same in groupby(room_view.faces(), key=lambda face: face.kind)
    )
    size = f'width="{WIDTH}" height="{HEIGHT}"'
    return (
        f'<g class="solids"><rect class="wall dim" {size}/>{"".join(shapes)}'
        f'<rect class="dusk" {size}/></g>'
    )


def _on_page(picture: Picture, pixels: Array) -> FloatArray:
    """Return where pixels of a picture, shape (..., 2), are on the page."""
    return np.asarray((pixels - (picture.left, picture.top)) * (WIDTH / picture.width))


def _outlines(picture: Picture, seen: VisibleObject) -> Sequence[FloatArray]:
    """Return the outlines of an object on the page."""
    return [_on_page(picture, outline) for outline in outlines_in(picture, seen)]


def _view(shown: AnswerView, picture: Picture) -> Iterator[str]:
    """Draw the boxes in a view."""
    # The lower row of views ends at the horizon, and the upper one begins there.
    horizon = picture.view // 12 * HEIGHT / 2
    yield f'<svg width="{WIDTH}" height="{HEIGHT}">'
    headings = list(_meridians(picture, horizon))
    if shown.room_view and not shown.photograph:
        yield room_shapes(shown.room_view)
    else:
        yield _background(shown.photograph, HEIGHT, horizon)
        yield from (line for line, *_ in headings)
    for role, each in _outlined(shown):
        for outline in _outlines(picture, each):
            yield _outlined_shape(role, outline, each.name)
    for outline in _predicted_outline(shown, picture):
        yield _polygon("answer", outline, "predicted box")
    headings = [each for each in headings if _TICK_MARGIN <= each[1] <= WIDTH - _TICK_MARGIN]
    for _, x, y, text in headings:
        yield _text("heading", x, y, text)
    yield from _labels(
        shown, picture, [(x - _TICK_MARGIN, x + _TICK_MARGIN, y) for _, x, y, _ in headings]
    )
    yield "</svg>"


def _meridians(picture: Picture, horizon: float) -> Iterator[tuple[str, float, float, str]]:
    """Draw the headings of a view as lines; with each, say where at an edge its degrees belong."""
    heading, elevation = np.rad2deg(view_angles(np.array([picture.view]))[0])
    y = HEIGHT - 4 if horizon == HEIGHT else 12
    for offset in (-_STEP, 0, _STEP):
        turn = np.deg2rad(heading + offset)
        ends = np.deg2rad(elevation + np.array([-40.0, 40.0]))
        along = np.stack([np.sin(turn) * np.cos(ends), np.cos(turn) * np.cos(ends), np.sin(ends)])
        start, end = _on_page(picture, look(picture, along.T))
        line = f'<path class="grid" d="M{start[0]:.1f} {start[1]:.1f}L{end[0]:.1f} {end[1]:.1f}"/>'
        share = (y - start[1]) / (end[1] - start[1])
        x = float(start[0] + share * (end[0] - start[0]))
        yield line, x, y, f"{round(heading + offset) % 360}°"


def _predicted_outline(shown: AnswerView, picture: Picture) -> Sequence[FloatArray]:
    """Return the outline of the predicted box; empty if none is in front of the camera."""
    if shown.box is None:
        return []
    outline = look(picture, directions_of(shown.box.xywh, shown.box.camera))
    return [_on_page(picture, outline)] if len(outline) else []


def _labels(
    shown: AnswerView, picture: Picture, taken: Sequence[tuple[float, float, float]]
) -> Iterator[str]:
    """Label the answer and the target in a view, and other objects where there is room.

    ``taken`` has the left and right ends and the baselines of other texts.
    """
    for role, text, box in _named_boxes(shown, picture):
        width = _LETTER[role] * len(text)
        start = min(max(box[0] + 4, 3), WIDTH - width - 3)
        free = [
            line
            for line in [*_lines(box, width), *_lines_nearby(role, box)]
            if _HIGHEST_LINE <= line <= _LOWEST_LINE
            and not any(
                abs(line - other) < _LINE and start < end and begin < start + width
                for begin, end, other in taken
            )
        ]
        if not free and role == "other":
            continue
        line = free[0] if free else min(max(box[1], _HIGHEST_LINE), _LOWEST_LINE)
        taken = [*taken, (start, start + width, line)]
        yield _text(f"label {role}", start, line, text)


def _lines(box: FloatArray, width: float) -> Sequence[float]:
    """Return possible baselines of a label, the best first: inside the box if it fits there."""
    _, top, box_width, height = box
    within, beside = [top + 13, top + height - 4], [top - 4, top + height + 13]
    fits = width + 8 <= box_width and height >= _LINE
    return [*within, *beside, top + 28] if fits else [*beside, *within]


def _lines_nearby(role: Role, box: FloatArray) -> Sequence[float]:
    """Return further baselines, the nearest first, for what has to have a label."""
    lines = [] if role == "other" else np.arange(_HIGHEST_LINE, _LOWEST_LINE, _LINE).tolist()
    return sorted(lines, key=lambda line: abs(line - float(box[1])))


def _named_boxes(shown: AnswerView, picture: Picture) -> Iterator[tuple[Role, str, FloatArray]]:
    """Yield role, label and box, in units of the page, of everything that a view shows."""
    for outline in _predicted_outline(shown, picture):
        text = ", ".join(filter(None, ["predicted box", shown.iou]))
        yield "answer", text, _bounds(outline)
    left_out = shown.room_view.left_out if shown.room_view and not shown.photograph else ()
    others = [
        each
        for each in shown.objects
        if each not in (shown.predicted, shown.target) and each.object_id not in left_out
    ]
    named: list[tuple[Role, str, VisibleObject | None]] = [
        ("answer", "answer and target: " if shown.is_target else "answer: ", shown.predicted),
        ("target", "target: ", None if shown.is_target else shown.target),
        *(("other", "", each) for each in others),
    ]
    for role, title, each in named:
        if each:
            for outline in _outlines(picture, each):
                yield role, f"{title}{each.name}", _bounds(outline)


# The panorama.


def _panorama(shown: AnswerView) -> Iterator[str]:
    """Draw everything that is visible from the viewpoint, with the view in the middle."""
    middle = 180.0 if shown.heading is None else float(np.rad2deg(shown.heading))
    photograph = shown.skybox.panorama(middle, _HIGHEST) if shown.skybox else ""
    yield from _grid(middle, photograph)
    if not shown.objects and not photograph:
        yield _text("tick", WIDTH / 2, _STRIP_HEIGHT / 2 - 8, "no object is visible from here")
    spans: list[tuple[Role, Span, str]] = [
        (role, span_of(each), each.name) for role, each in _outlined(shown)
    ]
    if shown.box:
        span = box_span(shown.box.xywh[None], shown.box.camera[None])
        spans.append(("answer", span, "predicted box"))
    # Cameras may look farther up and down than views; boxes in their pictures are clipped here.
    yield f'<svg width="{WIDTH}" height="{_STRIP_HEIGHT:.1f}">'
    for role, span, title in spans:
        yield from _on_panorama(role, span, middle, title)
    yield from _role_labels([(role, span) for role, span, _ in spans if role != "other"], middle)
    if shown.picture:
        yield _frame(shown.picture, middle)
    yield "</svg>"


def _frame(picture: Picture, middle: float) -> str:
    camera = view_angles(np.array([picture.view]))[0]
    around = np.rad2deg(angles_of(directions_of(np.array(picture[1:]), camera)))
    return _polygon("frame", _position(around, middle), "the view above")


def _grid(middle: float, photograph: str = "") -> Iterator[str]:
    """Draw a photograph, or an empty room, with lines every 30 degrees and the headings below."""
    yield _background(photograph, _STRIP_HEIGHT, _STRIP_HEIGHT / 2)
    angles = np.array([(heading, 0.0) for heading in range(0, 360, _STEP)])
    across = _position(angles, middle)[:, 0].tolist()
    lines = [f"M{x:.1f} 0V{_STRIP_HEIGHT:.1f}" for x in across]
    lines += [f"M0 {(_HIGHEST - elevation) * _DEGREE:.1f}H{WIDTH}" for elevation in (-_STEP, _STEP)]
    yield f'<path class="grid" d="{"".join(lines)}"/>'
    for heading, x in zip(range(0, 360, _STEP), across, strict=True):
        if _TICK_MARGIN <= x <= WIDTH - _TICK_MARGIN:
            yield _text("tick", x, _STRIP_HEIGHT + 12, f"{heading}°")


def _on_panorama(role: Role, span: Span, middle: float, title: str) -> Iterator[str]:
    """Draw a part of the panorama, twice if it crosses an end of the panorama."""
    x, _ = _position(np.array([span.heading, 0.0]), middle)
    left, right = x + span.left * _DEGREE, x + span.right * _DEGREE
    top, height = (_HIGHEST - span.high) * _DEGREE, (span.high - span.low) * _DEGREE
    for shift in (-WIDTH, 0, WIDTH):
        if left + shift < WIDTH and right + shift > 0:
            yield _rect(role, np.array([left + shift, top, right - left, height]), title)


def _role_labels(spans: Sequence[tuple[Role, Span]], middle: float) -> Iterator[str]:
    """Name the target above its position in the panorama, and the answer below; never over another.

    What would be over another is nearer to the middle.
    """
    taken: list[tuple[float, float]] = []
    for role, span in spans:
        x, _ = _position(np.array([span.middle, 0.0]), middle)
        above, below = (_HIGHEST - span.high) * _DEGREE - 3, (_HIGHEST - span.low) * _DEGREE + 11
        y = max(above, 10) if role == "target" else min(below, _STRIP_HEIGHT - 3)
        x = min(max(x, _ROLE_MARGIN), WIDTH - _ROLE_MARGIN)
        step = 1 if y < _STRIP_HEIGHT / 2 else -1
        while any(
            abs(x - its_x) < 2 * _ROLE_MARGIN and abs(y - its_y) < _ROLE_LINE
            for its_x, its_y in taken
        ):
            y += step
        taken.append((x, y))
        yield _text(f"label role {role}", x, y, role)


def _position(angles: FloatArray, middle: float) -> FloatArray:
    """Return where headings and elevations, degrees, shape (..., 2), are on the panorama."""
    offset = np.mod(angles[..., 0] - middle + 180, 360) - 180
    x, y = WIDTH / 2 + offset * _DEGREE, (_HIGHEST - angles[..., 1]) * _DEGREE
    return np.stack([x, y], axis=-1)


# Links.


class _Link(NamedTuple):
    """An object in a picture."""

    link: ObjectLink
    shapes: str
    area: float
    x: float
    """The middle of its upper edge."""
    y: float


class _Way(NamedTuple):
    """A way in a picture."""

    number: int
    way: WayLink
    point: FloatArray


def _link_to(link: ObjectLink, outline: FloatArray) -> _Link:
    """Return a link to an object by its outline in a picture; its name is where it is seen."""
    area = float(np.ptp(outline, axis=0).prod())
    left, top, width, _ = _bounds(np.clip(outline, 0, (WIDTH, HEIGHT)))
    return _Link(link, _outlined_shape("other", outline, link.label), area, left + width / 2, top)


def _numbered(ways: Sequence[WayLink], points: Sequence[FloatArray | None]) -> Sequence[_Way]:
    """Return the ways with their numbers, without those that are not in the picture."""
    pairs = enumerate(zip(ways, points, strict=True), 1)
    return [_Way(number, way, at) for number, (way, at) in pairs if at is not None]


def _on_floor(way: WayLink, picture: Picture) -> FloatArray | None:
    """Return where a way ends on the floor in a level view, or below it; None if beside it."""
    heading, elevation = np.deg2rad([way.heading, way.elevation])
    flat = way.metres * np.cos(elevation)
    down = way.metres * np.sin(elevation) - _EYES
    end = np.array([flat * np.sin(heading), flat * np.cos(heading), down])
    found = _on_page(picture, look(picture, end[None]))  # none if it is behind the camera
    if not len(found) or not 0 <= found[0, 0] <= WIDTH:
        return None
    margin = _IN_VIEW.radius
    return np.asarray(np.clip(found[0], margin, np.array([WIDTH, HEIGHT]) - margin))


def _linked(objects: Sequence[_Link], ways: Sequence[_Way], marks: _Marks) -> str:
    """Draw links to objects and to ways, the smallest last."""
    named = _with_room(objects, marks)
    links = [(each.area, _object_link(each, marks, is_named=each in named)) for each in objects]
    circle = math.pi * marks.radius**2
    links += [(circle, _way_link(each, marks)) for each in _apart(ways, marks)]
    return "".join(link for _, link in sorted(links, key=itemgetter(0), reverse=True))


def _with_room(objects: Sequence[_Link], marks: _Marks) -> Sequence[_Link]:
    """Return the objects with room for their names, which no other name overlaps; small ones first.

    The others show their names when they are pointed at.
    """
    taken: list[tuple[float, float, float]] = []
    shown = []
    for each in sorted(objects, key=lambda it: it.area):
        x, y = _name_position(each, marks)
        reach = marks.letter * len(each.link.name) / 2
        if all(
            abs(y - other_y) > marks.line or abs(x - other_x) > reach + other_reach
            for other_x, other_y, other_reach in taken
        ):
            taken.append((x, y, reach))
            shown.append(each)
    return shown


def _name_position(target: _Link, marks: _Marks) -> tuple[float, float]:
    """Return the middle of the baseline of an object's name: on its box, in the picture."""
    reach = marks.letter * len(target.link.name) / 2
    return min(max(target.x, reach), WIDTH - reach), max(target.y - 1, marks.line)


def _object_link(target: _Link, marks: _Marks, *, is_named: bool) -> str:
    link, (x, y) = target.link, _name_position(target, marks)
    chosen = ' class="chosen"' if link.is_chosen else ""
    return (
        f'<a href="{escape(link.href)}" aria-label="{escape(link.label)}" tabindex="-1"'
        f' data-object="{link.object_id}"{chosen}>{target.shapes}'
        f"{_text('name' if is_named else 'name spare', x, y, link.name)}</a>"
    )


def _apart(ways: Sequence[_Way], marks: _Marks) -> Iterator[_Way]:
    """Yield the ways; one whose circle would cover another's is higher."""
    taken: list[FloatArray] = []
    for each in ways:
        x, y = each.point
        while any(math.dist((x, y), other) < 2 * marks.radius for other in taken):
            y -= 1
        taken.append(np.array([x, y]))
        yield each._replace(point=taken[-1])


def _way_link(mark: _Way, marks: _Marks) -> str:
    number, link, (x, y) = mark
    circle = f'cx="{x:.1f}" cy="{y:.1f}" r="{marks.radius}"'
    return (
        f'<a href="{escape(link.href)}" aria-label="{number}: {escape(link.label)}" tabindex="-1"'
        f' data-way="{number}" data-heading="{link.heading:.0f}">'
        f'<circle class="way" {circle}><title>{escape(link.label)}</title></circle>'
        f"{_text('way-number', x, y + 0.36 * marks.radius, str(number))}</a>"
    )


# Elements.


def _background(photograph: str, height: float, horizon: float) -> str:
    """Show a photograph or, without one, an empty room with its horizon."""
    size = f'width="{WIDTH}" height="{height:.1f}"'
    if photograph:
        return f'<image {size} preserveAspectRatio="none" href="{photograph}"/>'
    below = f'y="{horizon:.1f}" width="{WIDTH}" height="{height - horizon:.1f}"'
    return f'<rect class="wall" {size}/><rect class="floor" {below}/>'


def _outlined_shape(kind: str, outline: FloatArray, title: str) -> str:
    """Draw the outline of a box of the view, which has four corners, or of another one."""
    if len(outline) == 4:
        return _rect(kind, _bounds(outline), title)
    return _polygon(kind, outline, title)


def _bounds(points: FloatArray) -> FloatArray:
    """Return left, top, width and height of what is around points."""
    return np.concatenate([points.min(axis=0), np.ptp(points, axis=0)])


def _rect(kind: str, xywh: Array, title: str) -> str:
    x, y, width, height = xywh
    size = f'x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"'
    return f'<rect class="box {kind}" {size}><title>{escape(title)}</title></rect>'


def _polygon(kind: str, points: FloatArray, title: str) -> str:
    data = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polygon class="box {kind}" points="{data}"><title>{escape(title)}</title></polygon>'


def _text(kind: str, x: float, y: float, text: str) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{escape(text)}</text>'
