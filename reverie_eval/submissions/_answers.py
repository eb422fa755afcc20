"""Read an answer: an object id, under any key and of any type that codebases write, a box, a point.

A box belongs to an image: the view that ``predView`` gives, or else the image that the camera of
the last pose sees. If ``predImageSize`` gives another image size, the box is scaled to 640 x 480
pixels. Then it is cut to the image.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias, TypeGuard

import numpy as np

from reverie_eval.arrays import LARGEST_OBJECT_ID, FloatArray, IntArray
from reverie_eval.errors import Problem
from reverie_eval.geometry import (
    FAR_OFF,
    HEIGHT,
    N_VIEWS,
    WIDTH,
    degrees_off,
    is_on_grid,
    view_angles,
)
from reverie_eval.metrics import ABSTAINED
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._fields import (
    ANSWER_KEYS,
    BOX_KEY,
    IMAGE_SIZE_KEY,
    POINT_KEYS,
    VIEW_KEY,
    is_abstention,
    is_finite,
    is_integer,
    is_list,
    is_number,
    unwrap,
    unwrap_number,
    unwrap_numbers,
)
from reverie_eval.submissions._predictions import MOST, BoxAnswers
from reverie_eval.submissions._problems import RecordLocation
from reverie_eval.submissions._trajectories import Trajectory

STRAIGHT_UP = math.pi / 2
"""Radians. Beyond straight up or down, a camera is upside down."""
_NONE = "none"
# What libraries write where there is no value, as text in lower case.
_NOTHING = ("nan", "null")
_MOST_DIGITS = len(str(LARGEST_OBJECT_ID))
# Pixels by which rounding alone may push a scaled box beyond the image.
_SLACK = 1e-6
ENOUGH_BOXES = 20
"""Fewer boxes say nothing about how they were meant."""
# Pixels: fractions of an image reach no farther, as sides or as corners.
_TINY = 2

Camera: TypeAlias = tuple[float, float]
"""Heading and elevation, radians."""
Point: TypeAlias = tuple[float, float]
"""Heading and elevation in turns; NaN for none."""
NO_POINT: Point = (np.nan, np.nan)
_VIEW_CAMERAS: Sequence[Camera] = list(map(tuple, view_angles(np.arange(N_VIEWS)).tolist()))


class BoxAnswer(NamedTuple):
    """A box as its record gives it, and the camera of the image that it was predicted in."""

    xywh: tuple[float, float, float, float]
    """Left, top, width and height, pixels of its image."""
    image_size: tuple[float, float]
    """Width and height of that image, pixels."""
    camera: Camera
    fields: Mapping[str, Any]
    """The box, the view and the image size as the record gives them, as plain numbers."""


class Answer(NamedTuple):
    """The predicted object or box."""

    object_id: int
    """-1 if the agent predicts no object."""
    is_text: bool = False
    """Whether the id is written as text; one published evaluator never counts that as correct."""
    has_leading_zeros: bool = False
    """Whether that text has leading zeros; no published evaluator counts that as correct."""
    box: BoxAnswer | None = None


def has_answer(record: Mapping[str, Any]) -> bool:
    """Whether a record has an answer under any key."""
    return any(key in record for key in (*ANSWER_KEYS, BOX_KEY))


def predicts(record: Mapping[str, Any]) -> bool:
    """Whether a record predicts an object or a box."""
    keys = (*ANSWER_KEYS, BOX_KEY)
    return any(key in record and not is_abstention(record[key]) for key in keys)


def read_answer(
    location: RecordLocation,
    record: Mapping[str, Any],
    trajectory: Trajectory | None,
    log: ReadingLog,
) -> Answer:
    """Read a record's answer; an unreadable one is reported and becomes an abstention.

    ``trajectory`` is None if trajectories are not read.
    """
    answers = _answers_of(record, log)
    # A box comes first: a -1 beside it only says that no object is predicted.
    if record.get(BOX_KEY) is not None:
        for key, value in answers.items():
            if not is_abstention(value):
                log.problems.append(
                    problems.TWO_ANSWERS.of_record(location, f".{key}", found=value, key=key)
                )
        return Answer(ABSTAINED, box=_read_box(location, record, trajectory, log))
    if not answers and BOX_KEY in record:  # null, or it would have been read above
        log.add_fault(faults.NULL_BOXES, location, f".{BOX_KEY}", None)
        return Answer(ABSTAINED)
    if not answers:
        log.problems.append(problems.NO_ANSWER.of_record(location))
        return Answer(ABSTAINED)
    if len(answers) > 1 and disagree(answers.values()):
        log.add_fault(faults.DISAGREEING_ANSWERS, location, "", answers)
    key, value = next(iter(answers.items()))
    log.differences["other key"] += key != ANSWER_KEYS[0]
    return _read_object(location, key, value, log)


def _answers_of(record: Mapping[str, Any], log: ReadingLog) -> Mapping[str, Any]:
    """Return the object ids of a record by their keys, without null beside another answer."""
    answers = {key: record[key] for key in ANSWER_KEYS if key in record}
    nulls = [key for key, value in answers.items() if value is None or _is_nan(value)]
    if len(nulls) == len(answers) and record.get(BOX_KEY) is None:
        return answers
    log.differences.update(f"null {key}" for key in nulls)
    return {key: value for key, value in answers.items() if key not in nulls}


def disagree(answers: Iterable[Any]) -> bool:
    """Whether these are different answers."""
    # Compared as text, so that 3 and "3" are the same answer, and so are -1 and null.
    meant = [unwrap(value)[0] for value in answers]
    return len({_NONE if is_abstention(value) else str(value) for value in meant}) > 1


def _is_nan(value: Any) -> bool:
    """Whether this is NaN, which pandas makes of null in a column of numbers."""
    return isinstance(value, float) and math.isnan(value)


def _is_nothing(value: Any) -> bool:
    """Whether this is how libraries write that there is no value."""
    return _is_nan(value) or (isinstance(value, str) and value.lower() in _NOTHING)


def _read_object(location: RecordLocation, key: str, value: Any, log: ReadingLog) -> Answer:
    meant, fault = (value, None) if is_abstention(value) else unwrap(value)
    # pandas writes NaN for a missing number, and text columns then have "nan".
    if not is_abstention(meant) and _is_nothing(meant):
        meant, fault = None, faults.NO_OBJECTS
    # pandas makes 7.0 of 7 in a column in which a value is missing.
    if (isinstance(meant, float) and meant.is_integer()) or _is_decimal_text(meant):
        meant, fault = int(float(meant)), fault or faults.DECIMAL_IDS
    is_text = _is_digits(meant)
    object_id = int(meant) if is_text else meant
    is_object = is_integer(object_id) and ABSTAINED <= object_id <= LARGEST_OBJECT_ID
    if not (is_object or is_abstention(meant)):
        log.add_wrong_type(location, key, value, problems.OBJECT_FORM)
        return Answer(ABSTAINED)
    if fault is not None:
        log.add_fault(fault, location, f".{key}", value)
    if is_abstention(meant):
        log.differences["abstentions"] += not is_integer(meant)
        return Answer(ABSTAINED)
    has_leading_zeros = is_text and str(object_id) != meant
    log.differences["text ids"] += is_text
    log.differences["leading zeros"] += has_leading_zeros
    return Answer(int(object_id), is_text, has_leading_zeros)


def _is_decimal_text(value: Any) -> bool:
    if not isinstance(value, str):
        return False
    whole, point, zeros = value.partition(".")
    return bool(point) and not zeros.strip("0") and _is_digits(whole)


def _is_digits(value: Any) -> bool:
    # Longer text cannot be an object id, and Python refuses to convert thousands of digits.
    is_short = isinstance(value, str) and len(value) <= _MOST_DIGITS
    return is_short and value.isascii() and value.isdigit()


def _read_box(
    location: RecordLocation,
    record: Mapping[str, Any],
    trajectory: Trajectory | None,
    log: ReadingLog,
) -> BoxAnswer | None:
    """Read a record's box; report every problem with it."""
    camera = _read_camera(location, record, trajectory, log)
    size = _read_image_size(location, record, log)
    box = _read_xywh(location, record[BOX_KEY], log)
    if camera is None or size is None or box is None:
        return None
    fields = {
        BOX_KEY: list(box),
        **({} if record.get(VIEW_KEY) is None else {VIEW_KEY: _whole_view(record[VIEW_KEY])}),
        **({} if record.get(IMAGE_SIZE_KEY) is None else {IMAGE_SIZE_KEY: list(size)}),
    }
    return BoxAnswer(box, size, camera, fields)


def _read_camera(
    location: RecordLocation,
    record: Mapping[str, Any],
    trajectory: Trajectory | None,
    log: ReadingLog,
) -> Camera | None:
    view = record.get(VIEW_KEY)
    if view is not None:
        whole = _whole_view(view)
        if whole is not None and not is_integer(view):
            fault = unwrap(view)[1] or faults.VIEWS_NOT_WHOLE
            log.add_fault(fault, location, f".{VIEW_KEY}", view)
        if whole is not None and 0 <= whole < N_VIEWS:
            return _VIEW_CAMERAS[whole]
        log.problems.append(problems.WRONG_VIEW.of_record(location, found=view))
        return None
    stop = None if trajectory is None else trajectory.stop
    if stop is not None and stop.heading is not None and stop.elevation is not None:
        if abs(stop.elevation) <= STRAIGHT_UP:
            return float(stop.heading), float(stop.elevation)
        found = problems.UPSIDE_DOWN.of_pose(location, stop.location[:1], elevation=stop.elevation)
        log.problems.append(found)
    elif trajectory is None or (stop is not None and not stop.is_reported):
        # An unreadable trajectory or pose was reported already: one problem is enough.
        missing = problems.NO_VIEW if trajectory is None else problems.NO_VIEW_NOR_POSE
        log.problems.append(missing.of_record(location))
    return None


def _whole_view(view: Any) -> int | None:
    """Return the number of a view, also from 12.0, "12", "12.0" or [12]; None if it tells none."""
    view, _ = unwrap(view)
    if is_integer(view) or (isinstance(view, float) and view.is_integer()):
        return int(view)
    is_text = _is_digits(view) or _is_decimal_text(view)
    return int(float(view)) if is_text else None


def _read_image_size(
    location: RecordLocation, record: Mapping[str, Any], log: ReadingLog
) -> tuple[float, float] | None:
    """Return width and height of the image that the box was predicted in."""
    size = record.get(IMAGE_SIZE_KEY)
    if size is None:
        return WIDTH, HEIGHT
    meant, fault = unwrap_numbers(size)
    if _are_numbers(meant, 2) and all(is_finite(side) and side >= 1 for side in meant):
        if fault is not None:
            log.add_fault(fault, location, f".{IMAGE_SIZE_KEY}", size)
        return float(meant[0]), float(meant[1])
    log.add_wrong_type(location, IMAGE_SIZE_KEY, size, problems.IMAGE_SIZE_FORM)
    return None


def _read_xywh(
    location: RecordLocation, box: Any, log: ReadingLog
) -> tuple[float, float, float, float] | None:
    """Return left, top, width and height in the image that the box was predicted in."""
    meant, fault = unwrap_numbers(box)
    if not _are_numbers(meant, 4):
        log.add_wrong_type(location, BOX_KEY, box, problems.BOX_FORM)
        return None
    if fault is not None:
        log.add_fault(fault, location, f".{BOX_KEY}", box)
    box = meant
    if not all(map(is_finite, box)):
        log.problems.append(problems.BOX_NOT_FINITE.of_record(location, found=list(box)))
        return None
    x, y, width, height = map(float, box)
    if width <= 0 or height <= 0:
        log.problems.append(problems.EMPTY_BOX.of_record(location, found=list(box)))
        return None
    return x, y, width, height


def _are_numbers(value: Any, count: int) -> TypeGuard[Sequence[float]]:
    return is_list(value) and len(value) == count and all(map(is_number, value))


def read_point(location: RecordLocation, record: Mapping[str, Any], log: ReadingLog) -> Point:
    """Read a trajectory's point; an unreadable one is reported and becomes none."""
    values: list[float | None] = []
    for key in POINT_KEYS:
        if key not in record:
            log.add_fault(faults.missing_in_all(key), location, "", None)
            return NO_POINT
        value = record[key]
        listed = value
        while is_list(value) and len(value) == 1:
            (value,) = value
        log.differences["listed angles"] += value is not listed
        meant, fault = (value, None) if value is None else unwrap_number(value)
        if meant is not None and not (is_number(meant) and is_finite(meant)):
            log.add_wrong_type(location, key, value, problems.POINT_FORM)
            return NO_POINT
        if fault is not None:
            log.add_fault(fault, location, f".{key}", value)
        values.append(meant)
    heading, elevation = values
    if heading is not None and elevation is not None:
        return float(heading), float(elevation)
    if heading is elevation is None:
        log.differences["no point"] += 1
    else:
        log.problems.append(problems.HALF_A_POINT.of_record(location))
    return NO_POINT


def official_point(point: Point) -> Mapping[str, float | None]:
    """Return the fields of a point in the official form; null for none."""
    values = [None if np.isnan(value) else value for value in point]
    return dict(zip(POINT_KEYS, values, strict=True))


class GivenBoxes(NamedTuple):
    """Boxes as a file gives them, one row each."""

    row: IntArray
    """Shape (n_boxes,): the record of each box, ascending."""
    xywh: FloatArray
    """Shape (n_boxes, 4): pixels of the image that each was predicted in."""
    image_size: FloatArray
    """Shape (n_boxes, 2): width and height of that image, pixels."""
    camera: FloatArray
    """Shape (n_boxes, 2): as in :class:`BoxAnswers`."""
    stop_angles: FloatArray
    """Shape (n_boxes, 2): as in :class:`BoxAnswers`."""


def box_columns(given: GivenBoxes, log: ReadingLog) -> BoxAnswers:
    """Scale boxes to an image of 640 x 480 pixels and cut them to it.

    Differences from the official form, and problems that most boxes have, are noted in the log.
    """
    # With each column by itself in memory; otherwise numpy would work in steps of two or four.
    xywh, image_size, camera, stop_angles = map(np.asfortranarray, given[1:])
    whole = np.array([WIDTH, HEIGHT])
    # Below, `any(axis=1)` would take twenty times as long as the same by `logical_or`.
    # Each side has a scale of its own: models that take squares distort an image of 640 x 480.
    scale = whole / image_size
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers that hardly fit a float
        begin, end = xywh[:, :2] * scale, (xywh[:, :2] + xywh[:, 2:]) * scale
        cut_begin, cut_end = begin.clip(0, whole), end.clip(0, whole)
        # By rounding, a box as wide as its scaled image may end beyond 640.
        is_cut = np.logical_or(*(np.maximum(cut_begin - begin, end - cut_end) > _SLACK).T)
        uncut_xywh = np.hstack([begin, end - begin])
    is_outside = np.logical_or(*(cut_end <= cut_begin).T)
    # Matterport's views are wider than tall, so this is probably [height, width], as numpy has it.
    is_upright = image_size[:, 0] < image_size[:, 1]
    off_grid = camera[~is_on_grid(camera)]
    log.differences.update(
        {
            "scaled boxes": int(np.logical_or(*(image_size != whole).T).sum()),
            "upright images": int(is_upright.sum()),
            "cut boxes": int((is_cut & ~is_outside).sum()),
            "boxes outside": int(is_outside.sum()),
            "cameras off the grid": len(off_grid),
            "far cameras": int((degrees_off(off_grid) > FAR_OFF).sum()),
        }
    )
    cut_xywh = np.hstack([cut_begin, cut_end - cut_begin])
    boxes = BoxAnswers(given.row, cut_xywh, camera, is_cut, uncut_xywh, stop_angles)
    log.problems.extend(box_scale_problems(boxes))
    return boxes


def box_scale_problems(boxes: BoxAnswers) -> Iterator[Problem]:
    """Yield a problem if most boxes cannot match anything, so that their scale must be wrong."""
    if len(boxes.row) < ENOUGH_BOXES:
        return
    is_outside = np.logical_or(*(boxes.xywh[:, 2:] == 0).T)
    is_tiny = np.logical_and(*(boxes.uncut_xywh[:, 2:] <= _TINY).T)
    for is_wrong, problem in (
        (is_outside, problems.BOXES_OUTSIDE),
        (is_tiny & ~is_outside, problems.TINY_BOXES),
    ):
        # One box outside is a miss; most of them outside are fractions, or pixels of another image.
        if is_wrong.mean() > MOST:
            yield problem.of_file(count=int(is_wrong.sum()), total=len(is_wrong))
