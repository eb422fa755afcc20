"""Everything that can be wrong with a submission, worded for the person who has to mend it.

One function per kind, each with its stable code: where, what was found, what was expected, what to
do. Nothing here may carry an answer: problems are shown to participants of private splits.
"""

import reprlib
from collections.abc import Iterable, Sequence
from itertools import islice
from sys import maxsize

from reverie_eval.errors import Problem
from reverie_eval.limits import LARGEST_OBJECT_ID
from reverie_eval.reading.findings import Place, PosePath
from reverie_eval.wording import counted, some

WHOLE_FILE = "file"
POSE_FORM = "[viewpoint_id, heading, elevation]"
OBJECT_FORM = "an object id (a whole number from 0), or -1 where the agent names no object"

MAX_PROBLEMS = 10_000
"""That are looked for; whoever mends them, mends the fault that makes the others too."""

BOX_FORM = "[x, y, width, height] in pixels from the upper left corner"

_short = reprlib.Repr()
_short.maxstring = _short.maxother = 60
_short.maxlevel, _short.maxlist, _short.maxdict = 2, 4, 2


def _found(value: object) -> str:
    """Show a value as JSON would, cut to what fits a line."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    try:
        return _short.repr(value)
    except ValueError:  # a whole number of thousands of digits
        return "a whole number of thousands of digits"


def _in_row(code: str, place: Place, message: str, field: str = "") -> Problem:
    return Problem(code, f"{place}{field}", message, (place.number,))


def _in_pose(code: str, place: Place, path: PosePath, message: str) -> Problem:
    where = f"{place}.trajectory" + "".join(f"[{number}]" for number in path)
    return Problem(code, where, message, (place.number, *path))


def _in_file(code: str, message: str, where: str = WHOLE_FILE) -> Problem:
    return Problem(code, where, message)


def few_enough(problems: Iterable[Problem]) -> Sequence[Problem]:
    """Return the problems, or the first of them and that there are more."""
    first = list(islice(problems, MAX_PROBLEMS + 1))
    return first if len(first) <= MAX_PROBLEMS else [*first[:-1], too_many_problems(MAX_PROBLEMS)]


# The file as a whole.


def not_json(where: str, reason: str) -> Problem:
    """Build the problem for text that is no JSON."""
    return _in_file("not-json", f"{reason}; write the file with a JSON library", where)


def another_kind(kind: str) -> Problem:
    """Build the problem for a file that is something else than JSON."""
    return _in_file("not-json", f"is {kind}; send the result file itself, as JSON or gzipped JSON")


def too_many_records(found: int, limit: int) -> Problem:
    """Build the problem for a file with more records than any split has episodes."""
    return _in_file(
        "too-large", f"holds {found:,} records, more than the {limit:,} that any split could need"
    )


def too_many_values(found: int, limit: int) -> Problem:
    """Build the problem for a file that would unfold to gigabytes."""
    return _in_file(
        "too-large", f"holds some {found:,} values, more than the {limit:,} that can be read"
    )


def too_many_problems(limit: int) -> Problem:
    """Build the problem that stands behind all others where looking for more was given up."""
    message = f"has more than {limit:,} problems; mend these, the rest was not looked for"
    return Problem("too-many-problems", WHOLE_FILE, message, (maxsize,))


def too_many_poses(place: Place, found: int, limit: int) -> Problem:
    """Build the problem for a trajectory that no agent walks."""
    message = f"holds {found:,} elements, more than the {limit:,} that any agent could need"
    return _in_row("too-large", place, message, ".trajectory")


def endless_number() -> Problem:
    """Build the problem for a whole number that Python refuses to read."""
    return _in_file(
        "not-json",
        f"holds a whole number of thousands of digits; object ids go up to {LARGEST_OBJECT_ID:,}",
    )


def too_deep() -> Problem:
    """Build the problem for JSON that is nested beyond any submission's form."""
    return _in_file("too-deep", "is nested too deeply to be read; a submission has four levels")


def damaged_gzip(reason: str) -> Problem:
    """Build the problem for a gzip file that does not unpack."""
    return _in_file("damaged-gzip", f"does not unpack ({reason}); compress or copy it again")


def damaged_zip(reason: str) -> Problem:
    """Build the problem for a zip archive that does not unpack."""
    return _in_file("damaged-zip", f"does not unpack ({reason}); send the result file itself")


def not_one_file(names: Sequence[str]) -> Problem:
    """Build the problem for a zip archive that holds no file, or several."""
    listed = some(map(_found, names))
    found = f"{counted(len(names), 'file')}: {listed}" if names else "no file"
    return _in_file("several-files", f"is a zip archive with {found}; pack the result file alone")


def too_large(limit: int) -> Problem:
    """Build the problem for a file that is too large to be a submission."""
    return _in_file(
        "too-large",
        f"is larger than {limit >> 20} MiB unpacked; a submission holds instr_id, trajectory and "
        "predObjId, leave everything else out",
    )


def not_a_list(found: object) -> Problem:
    """Build the problem for a document that is no list of predictions."""
    return _in_file(
        "not-a-list",
        f"holds {_found(found)}; expected a list of predictions: "
        f'[{{"instr_id": ..., "trajectory": [{POSE_FORM}, ...], "predObjId": ...}}, ...]',
    )


def no_prediction_at_all(split: str, expected: int) -> Problem:
    """Build the problem for a file without a single episode of the split."""
    return _in_file(
        "missing-episode",
        f"has no prediction for any of the {expected:,} episodes of {split}; every one needs one",
    )


def missing_episode(instr_id: str, split: str) -> Problem:
    """Build the problem for an episode without a prediction."""
    return _in_file(
        "missing-episode",
        f"episode {instr_id} has no prediction; every episode of {split} needs one",
    )


def ids_of_another_split(
    count: int, other: str, split: str, place: Place, instr_id: str
) -> Problem:
    """Build the problem for predictions that belong to another split."""
    look = "1 id looks" if count == 1 else f"{count:,} ids look"
    return _in_row(
        "other-split",
        place,
        f"{look} like {other} ids, the first is {instr_id}; score them as {other}, or "
        f"send the predictions for {split}",
        ".instr_id",
    )


def ids_outside_demo(count: int, split: str) -> Problem:
    """Build the problem for real predictions that are held against the demo world."""
    return _in_file(
        "not-the-demo-world",
        f"none of its {counted(count, 'episode')} is in the demo world that ships with this "
        "package; to score REVERIE itself, clone github.com/YuankaiQi/REVERIE, run `reverie-eval "
        f"compile REVERIE --split {split} -o {split}.npz` once and give --ground-truth "
        f"{split}.npz",
    )


# A record.


def not_an_object(place: Place, found: object) -> Problem:
    """Build the problem for a record that is no JSON object."""
    return _in_row(
        "wrong-type",
        place,
        f"got {_found(found)}; expected an object with instr_id, trajectory and predObjId",
    )


def repeated_field(place: Place, field: str) -> Problem:
    """Build the problem for a record that holds a field twice."""
    return _in_row("repeated-field", place, f"has {field} twice; keep the one that is meant")


def repeated_key(key: str) -> Problem:
    """Build the problem for a file keyed by id that holds an id twice."""
    return _in_file("repeated-field", f"has {_found(key)} twice; keep the one that is meant")


def key_contradicts(place: Place, instr_id: str) -> Problem:
    """Build the problem for a record whose own id is not the one it is filed under."""
    message = f"is {_found(instr_id)} under the key {_found(place.key)}; make them the same"
    return _in_row("key-mismatch", place, message, ".instr_id")


def missing_field(place: Place, field: str) -> Problem:
    """Build the problem for a record that lacks a field."""
    return _in_row("missing-field", place, f"has no {field}; add it")


def no_answer(place: Place, object_key: str, box_key: str) -> Problem:
    """Build the problem for a record without an answer, in a file where others have one."""
    return _in_row("missing-field", place, f"has neither {object_key} nor {box_key}; add one")


def wrong_instr_id(place: Place, found: object) -> Problem:
    """Build the problem for an instr_id that is no text."""
    return _in_row(
        "wrong-type",
        place,
        f'got {_found(found)}; expected the episode\'s id as text: "4774_267_1"',
        ".instr_id",
    )


def wrong_object(place: Place, key: str, found: object) -> Problem:
    """Build the problem for an answer that is no object id."""
    return _in_row("wrong-type", place, f"got {_found(found)}; expected {OBJECT_FORM}", f".{key}")


def two_answers(place: Place, key: str, found: object) -> Problem:
    """Build the problem for a record that names an object and draws a box."""
    return _in_row(
        "two-answers",
        place,
        f"got {_found(found)} beside predBox; an episode has one answer: leave one out, or write "
        f"{key} -1",
        f".{key}",
    )


def wrong_box(place: Place, key: str, found: object) -> Problem:
    """Build the problem for a box that is no four numbers."""
    return _in_row("wrong-type", place, f"got {_found(found)}; expected {BOX_FORM}", f".{key}")


def box_not_finite(place: Place, key: str, found: Sequence[object]) -> Problem:
    """Build the problem for a box with NaN or an infinity in it."""
    message = f"got {_found(list(found))}; expected {BOX_FORM}, finite numbers"
    return _in_row("not-finite", place, message, f".{key}")


def empty_box(place: Place, key: str, found: Sequence[object]) -> Problem:
    """Build the problem for a box without width or height."""
    message = f"got {_found(list(found))}; expected {BOX_FORM}, with positive width and height"
    return _in_row("empty-box", place, message, f".{key}")


def wrong_view(place: Place, key: str, found: object) -> Problem:
    """Build the problem for something that is none of the 36 views."""
    message = (
        f"got {_found(found)}; expected a view, a whole number from 0 to 35: 0-11 look down, 12-23 "
        "are level, 24-35 look up, each row turning right from heading 0"
    )
    return _in_row("wrong-view", place, message, f".{key}")


def no_view(place: Place, key: str, *, may_be_posed: bool) -> Problem:
    """Build the problem for a box that is in no known picture."""
    pose = ", or give heading and elevation in the last pose" if may_be_posed else ""
    return _in_row(
        "missing-field",
        place,
        f"has a predBox and no {key}; add the view that it is drawn in (0-35){pose}",
    )


def upside_down(place: Place, path: PosePath, elevation: float, key: str) -> Problem:
    """Build the problem for a box by a camera that is turned beyond straight up or down."""
    return _in_pose(
        "wrong-camera",
        place,
        path,
        f"the box was drawn by a camera with an elevation of {_found(elevation)}, beyond straight "
        f"up or down (pi / 2); give radians, or the view in {key} (0-35)",
    )


def wrong_image_size(place: Place, key: str, found: object) -> Problem:
    """Build the problem for something that is no size of a picture."""
    message = (
        f"got {_found(found)}; expected [width, height] of the picture that predBox is drawn in, "
        "at least 1 each"
    )
    return _in_row("wrong-type", place, message, f".{key}")


def wrong_trajectory(place: Place, found: object) -> Problem:
    """Build the problem for a trajectory that is no list."""
    return _in_row(
        "wrong-type",
        place,
        f"got {_found(found)}; expected a list of poses {POSE_FORM}",
        ".trajectory",
    )


def empty_trajectory(place: Place) -> Problem:
    """Build the problem for a trajectory without a pose."""
    return _in_row(
        "empty-trajectory",
        place,
        "is empty; an agent that does not move has one pose, its start viewpoint",
        ".trajectory",
    )


def unknown_episode(place: Place, instr_id: str, split: str) -> Problem:
    """Build the problem for an id that no episode has."""
    return _in_row(
        "unknown-episode",
        place,
        f"{_found(instr_id)} is no episode of {split}; ids are <task id>_<instruction's number>, "
        "counted from 0",
        ".instr_id",
    )


def duplicate_episode(place: Place, instr_id: str, first: Place) -> Problem:
    """Build the problem for a second prediction of an episode."""
    return _in_row(
        "duplicate-episode",
        place,
        f"{instr_id} was predicted in {first} already; keep one prediction per episode",
        ".instr_id",
    )


# A pose.


def wrong_pose(place: Place, path: PosePath, found: object) -> Problem:
    """Build the problem for something that is no pose."""
    return _in_pose("wrong-type", place, path, f"got {_found(found)}; expected {POSE_FORM}")


def not_finite(place: Place, path: PosePath, found: Sequence[object]) -> Problem:
    """Build the problem for a pose with NaN or an infinity in it."""
    return _in_pose(
        "not-finite",
        place,
        path,
        f"got {_found(list(found))}; heading and elevation are finite numbers of radians",
    )


def unknown_viewpoint(place: Place, path: PosePath, viewpoint_id: str, scan: str) -> Problem:
    """Build the problem for a viewpoint that no navigation graph holds."""
    return _in_pose(
        "unknown-viewpoint",
        place,
        path,
        f"viewpoint {_found(viewpoint_id)} is not in the navigation graph of scan {scan}; use the "
        "viewpoint ids of the connectivity files",
    )


def viewpoint_of_another_scan(
    place: Place, path: PosePath, viewpoint_id: str, scan: str, found_scan: str
) -> Problem:
    """Build the problem for a viewpoint of another building."""
    return _in_pose(
        "other-scan",
        place,
        path,
        f"viewpoint {viewpoint_id} belongs to scan {found_scan}, but the episode is in scan {scan};"
        " check that trajectories and instr_ids were not mixed up",
    )


def wrong_start(place: Place, instr_id: str, expected: str, found: str) -> Problem:
    """Build the problem for a trajectory that begins away from the episode's start."""
    return _in_pose(
        "wrong-start",
        place,
        (0,),
        f"episode {instr_id} starts at viewpoint {expected}, got {found}; list the start "
        "viewpoint as the first pose",
    )


def unreachable(place: Place, path: PosePath, viewpoint_id: str) -> Problem:
    """Build the problem for a viewpoint that no route leads to."""
    return _in_pose(
        "unreachable",
        place,
        path,
        f"no route leads from the start to viewpoint {viewpoint_id}; a jump is priced at the "
        "shortest route, so there must be one",
    )
