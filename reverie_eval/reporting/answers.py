"""The objects visible where an agent answered, as data: in one view and in the whole panorama.

The pose of an agent at its stop is not scored, so a view is chosen: that of the predicted box, or
one that shows the predicted object, together with the target if a view shows both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.analysis import Episode, PredictedBox, VisibleObject
from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray
from reverie_eval.geometry import (
    HEIGHT,
    VIEW_AXES,
    WIDTH,
    Picture,
    RoomView,
    Seen,
    axes,
    clip_at_depth,
    pixels_of,
    rays_of,
    view_angles,
)
from reverie_eval.reporting.buildings import room_view_of
from reverie_eval.reporting.skyboxes import Skybox, find_skybox
from reverie_eval.text import count_text

# Points on each edge of a box: enough for a curve, as straight edges are curved in a panorama.
_POINTS = 9
# Directions whose depth is less than this fraction of their length are clipped.
_MIN_DEPTH = 0.05
_STOP, _PATH_END, _STEP = "the stop", "the end of the annotated path", "a step"
_ELEVATIONS = {-30: "30° down", 0: "level", 30: "30° up"}


@dataclass(frozen=True, eq=False)
class AnswerView:
    """The objects that are visible from a viewpoint of an episode."""

    viewpoint_id: str
    objects: Sequence[VisibleObject]
    target: VisibleObject | None
    """None if it is not visible from here."""
    predicted: VisibleObject | None
    """None if the agent predicted no object, or one that is not visible from here."""
    box: PredictedBox | None
    iou: str
    """IoU of the predicted box with the target's; empty if the view does not show the target."""
    view: int | None
    """The view to show, 0 to 35: a level one if it is drawn. None if none shows an answer or the
    target."""
    where: str
    """Where the viewpoint is: ``the stop``, ``the end of the annotated path`` or ``a step``."""
    caption: str
    skybox: Skybox | None = None
    """The photographs from here, if the reader has them."""
    room_view: RoomView | None = None
    """The room in the view, which is drawn without photographs; None without a view."""

    @classmethod
    def at_stop(cls, episode: Episode, who: str = "The agent") -> "AnswerView":
        """Show the answer from where the agent stopped; the caption calls it as ``who`` says."""
        objects = episode.visible_objects(episode.stop)
        target = _find(objects, episode.target_object)
        predicted = _find(objects, episode.predicted_object)
        box, main = episode.predicted_box, predicted or target
        view = box.view if box else _best_view(main, target) if main else None
        shown = cls._seen(episode, episode.stop, objects, view, _STOP, predicted=predicted, box=box)
        return _captioned(
            shown,
            _answer_sentence(episode, predicted, who),
            _target_sentence(episode, predicted, target, shown.picture),
            "" if objects else "No object is visible from here.",
        )

    @classmethod
    def at_path_end(cls, episode: Episode) -> "AnswerView | None":
        """Show the target from the end of the annotated path; None if it is not visible there."""
        objects = episode.visible_objects(episode.goal)
        target = _find(objects, episode.target_object)
        if target is None:
            return None
        view = _best_view(target, target)
        shown = cls._seen(episode, episode.goal, objects, view, _PATH_END)
        return _captioned(shown, f"The target is {target.name}.")

    @classmethod
    def at_step(cls, episode: Episode, viewpoint_id: str, view: int) -> "AnswerView":
        """Show what the agent sees on its way: a view from a viewpoint of the scan."""
        objects = episode.visible_objects(viewpoint_id)
        shown = cls._seen(episode, viewpoint_id, objects, view, _STEP)
        target = shown.target
        told = _target_sentence(episode, None, target, shown.picture) if target else ""
        return _captioned(shown, told)

    @classmethod
    def _seen(
        cls,
        episode: Episode,
        viewpoint_id: str,
        objects: Sequence[VisibleObject],
        view: int | None,
        where: str,
        *,
        predicted: VisibleObject | None = None,
        box: PredictedBox | None = None,
    ) -> Self:
        """Look from a viewpoint of an episode; without a view, there are only photographs."""
        target = _find(objects, episode.target_object)
        skybox, room_view = find_skybox(episode.graph, viewpoint_id), None
        if view is not None:
            seen, ids = seen_in(view, objects), [it.object_id for it in (predicted, target) if it]
            at = episode.graph, episode.solution, viewpoint_id, view
            room_view = room_view_of(*at, seen, important=ids)
            view = picture_of(view, room_view, skybox).view
        return cls(
            viewpoint_id=viewpoint_id,
            objects=objects,
            target=target,
            predicted=predicted,
            box=box,
            iou=_iou_text(episode) if box else "",
            view=view,
            where=where,
            caption="",
            skybox=skybox,
            room_view=room_view,
        )

    @property
    def is_target(self) -> bool:
        """Whether the predicted object is visible from here and is the target."""
        return self.predicted is not None and self.predicted is self.target

    @property
    def shows_target(self) -> bool:
        """Whether the target is in the picture, or in the panorama if no view is shown."""
        return self.target is not None and (
            self.picture is None or bool(outlines_in(self.picture, self.target))
        )

    @property
    def photograph(self) -> str:
        """The photograph of the view; empty if there is none."""
        return _photograph(self.skybox, self.view)

    @property
    def picture(self) -> Picture | None:
        """What is shown of the view, or around it if it is drawn; None without a view."""
        return None if self.view is None else picture_of(self.view, self.room_view, self.skybox)

    @property
    def heading(self) -> float | None:
        """The heading of the view, radians; None without a view."""
        return None if self.view is None else float(view_angles(np.array([self.view]))[0, 0])

    @property
    def description(self) -> str:
        """What the picture shows, for readers who cannot see it."""
        if not self.objects:
            return self.caption
        around = ", ".join(
            f"{each.name} at heading {span_of(each).middle:.0f}°" for each in self.objects
        )
        count = count_text(len(self.objects), "object")
        are = "is" if len(self.objects) == 1 else "are"
        return f"{self.caption} {count} {are} visible from here: {around}."


def answer_views(
    episodes: Mapping[str, Episode], who: str = "The agent"
) -> Sequence[tuple[str, AnswerView]]:
    """Show the answers of submissions to an episode from their stops.

    ``episodes`` has the same episode, by the names of the submissions; captions call the one that
    walked as ``who`` says. The last picture shows the
    target from the end of the annotated path, under an empty name, unless it is visible from every
    stop.
    """
    views = [(name, AnswerView.at_stop(episode, who)) for name, episode in episodes.items()]
    if all(view.target for _, view in views):
        return views
    first, *_ = episodes.values()
    at_end = AnswerView.at_path_end(first)
    return [*views, ("", at_end)] if at_end else views


def _photograph(skybox: Skybox | None, view: int | None) -> str:
    return "" if skybox is None or view is None else skybox.view(view)


def picture_of(view: int, room_view: RoomView | None, skybox: Skybox | None) -> Picture:
    """Return what is shown of a view: its photograph if there is one, or around it in a drawing."""
    if room_view is None or _photograph(skybox, view):
        return Picture(view)
    return room_view.picture


class Span(NamedTuple):
    """The part of a panorama that something takes up, in degrees."""

    heading: float
    """In [0, 360), near the middle of the span."""
    left: float
    """Degrees from ``heading`` to the left end, at most 0."""
    right: float
    """Degrees from ``heading`` to the right end, at least 0."""
    low: float
    """The lowest elevation."""
    high: float
    """The highest elevation."""

    @property
    def middle(self) -> float:
        """The heading of the middle of the span, in [0, 360)."""
        return (self.heading + (self.left + self.right) / 2) % 360


def span_of(seen: VisibleObject) -> Span:
    """Return the part of the panorama that an object takes up.

    Uses its largest box that the edge of the view does not cut, or all boxes if all are cut.
    """
    row = _best_last(seen)[-1:] if _is_whole(seen).any() else slice(None)
    return box_span(seen.xywh[row], view_angles(seen.view[row]))


def seen_in(view: int, objects: Sequence[VisibleObject]) -> Seen:
    """Choose a box of each object, as :func:`box_for` does."""
    rows = [(each, box_for(view, each)) for each in objects]
    return Seen(
        object_id=np.array([each.object_id for each, _ in rows], dtype=np.int64),
        view=np.array([each.view[box] for each, box in rows], dtype=np.int64),
        xywh=np.array([each.xywh[box] for each, box in rows], dtype=np.int64).reshape(-1, 4),
    )


def outlines_in(picture: Picture, seen: VisibleObject) -> Sequence[FloatArray]:
    """Return the outlines of an object in a picture, in its pixels, each of shape (n, 2).

    Those of a view are its boxes there, with four corners. In a picture of more than a view, it is
    that of :func:`box_for`; that of a box in another view has many points.
    """
    rows = np.flatnonzero(seen.view == picture.view)
    if picture != Picture(picture.view):
        rows = np.array([box_for(picture.view, seen)])
    found = []
    for row in rows.tolist():
        if seen.view[row] == picture.view:
            left, top, width, height = seen.xywh[row].astype(np.float64)
            right, bottom = left + width, top + height
            outline = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
        else:
            camera = view_angles(seen.view[row : row + 1])[0]
            outline = look(picture, directions_of(seen.xywh[row], camera))
        low = np.array([picture.left, picture.top])
        if (
            len(outline)
            and (outline.max(axis=0) > low).all()
            and (outline.min(axis=0) < low + picture[3:]).all()
        ):
            found.append(outline)
    return found


def look(picture: Picture, directions: FloatArray) -> FloatArray:
    """Project directions to the pixels of a picture; those behind the camera are clipped."""
    return pixels_of(clip_at_depth(directions @ VIEW_AXES[picture.view].T, _MIN_DEPTH))


def box_for(view: int, seen: VisibleObject) -> int:
    """Choose a box of an object: that in the view, or the largest of all if that is cut."""
    return int(_best_last(seen, _is_whole(seen) & (seen.view == view))[-1])


def box_span(xywh: Array, camera: FloatArray) -> Span:
    """Return the part of the panorama that boxes take up together.

    Parameters
    ----------
    xywh : array, shape (n, 4)
        Each box, as :func:`directions_of` takes it.
    camera : float array, shape (n, 2)
        The camera that each box was drawn in.
    """
    directions = np.concatenate([directions_of(*each) for each in zip(xywh, camera, strict=True)])
    heading, elevation = np.rad2deg(angles_of(directions)).T
    middle = np.rad2deg(angles_of(directions[: 4 * _POINTS].mean(axis=0)))[0]
    # Headings are compared with the middle of the first box, or a box across heading 0 would seem
    # to take up the whole panorama.
    offset = np.mod(heading - middle + 180, 360) - 180
    return Span(
        heading=float(middle % 360),
        left=float(offset.min()),
        right=float(offset.max()),
        low=float(elevation.min()),
        high=float(elevation.max()),
    )


def directions_of(xywh: Array, camera: FloatArray) -> FloatArray:
    """Return the directions along the edges of a box, in order around it.

    Parameters
    ----------
    xywh : float or int array of shape (4,)
        Left, top, width and height in pixels of the camera's picture.
    camera : float array of shape (2,)
        Heading and elevation, radians.

    Returns
    -------
    float array of shape (n, 3)
        In the world, with a component of 1 in the direction of the camera.
    """
    left, top, width, height = xywh.astype(np.float64)
    along = np.linspace(0, 1, _POINTS)
    zero, one = np.zeros(_POINTS), np.ones(_POINTS)
    x = np.concatenate([along, one, along[::-1], zero])
    y = np.concatenate([zero, along, one, along[::-1]])
    pixels = np.column_stack([left + width * x, top + height * y])
    return np.asarray(rays_of(pixels) @ axes(camera[None])[0])


def angles_of(direction: FloatArray) -> FloatArray:
    """Return heading and elevation, radians, of directions of shape (..., 3) in the world."""
    # As in MatterSim: heading 0 looks along y, and turning right it grows towards x.
    x, y, z = np.moveaxis(direction, -1, 0)
    return np.stack([np.arctan2(x, y), np.arctan2(z, np.hypot(x, y))], axis=-1)


def view_text(view: int) -> str:
    """Name a view by its direction: ``heading 30°, level``."""
    heading, elevation = np.rad2deg(view_angles(np.array([view])))[0].round().astype(int).tolist()
    return f"heading {heading}°, {_ELEVATIONS[elevation]}"


def _find(objects: Sequence[VisibleObject], object_id: int | None) -> VisibleObject | None:
    return next((each for each in objects if each.object_id == object_id), None)


def _best_view(seen: VisibleObject, target: VisibleObject | None) -> int:
    """Return the view that shows most of an object, and the target as well if any does."""
    has_target = np.isin(seen.view, [] if target is None else target.view)
    return int(seen.view[_best_last(seen, has_target)[-1]])


def _best_last(seen: VisibleObject, *preferred: BoolArray) -> IntArray:
    """Order an object's boxes: uncut ones come after cut ones, large ones after small ones."""
    area = seen.xywh[:, 2].astype(np.int64) * seen.xywh[:, 3]
    # The last key counts most.
    return np.lexsort((area, _is_whole(seen), *preferred))


def _is_whole(seen: VisibleObject) -> BoolArray:
    """Return whether each box, shape (n_boxes,), is clear of the edges of its view."""
    x, y, width, height = seen.xywh.T
    is_cut: BoolArray = (x == 0) | (y == 0) | (x + width == WIDTH) | (y + height == HEIGHT)
    return ~is_cut


def _captioned(shown: AnswerView, *sentences: str) -> AnswerView:
    """Return a view with a caption: where it is from, and what is to be said of it."""
    at = "" if shown.view is None else f"Seen from {shown.where}, {view_text(shown.view)}."
    return replace(shown, caption=" ".join(filter(None, [at, *sentences])))


def _iou_text(episode: Episode) -> str:
    """Return the IoU of the predicted box; empty if its view does not show the target."""
    is_compared = episode.box_outcome in ("correct", "low IoU") and "iou" in episode.values
    return f"IoU {episode.values['iou']:.2f}" if is_compared else ""


def _answer_sentence(episode: Episode, predicted: VisibleObject | None, who: str) -> str:
    if episode.predicted_box:
        iou = _iou_text(episode)
        return f"The predicted box has {iou} with the target's box." if iou else ""
    if episode.predicted_object is None:
        return f"{who} predicted no object." if episode.target_object is not None else ""
    name = episode.object_name(episode.predicted_object)
    if episode.predicted_object == episode.target_object:
        name = f"the target, {name}"
    if predicted is None:
        return f"The answer is {name}, which is not visible from here."
    return f"The answer is {name}."


def _target_sentence(
    episode: Episode,
    predicted: VisibleObject | None,
    target: VisibleObject | None,
    picture: Picture | None,
) -> str:
    if episode.target_object is None or episode.predicted_object == episode.target_object:
        return ""
    name = episode.object_name(episode.target_object)
    if target is None:
        is_answer_visible = predicted is not None or episode.predicted_object is None
        return (
            f"The target, {name}, is not visible from here."
            if is_answer_visible
            else f"Nor is the target, {name}."
        )
    if picture is None or not outlines_in(picture, target):
        return f"The target, {name}, is visible from here, but not in this view."
    return f"The target is {name}."
