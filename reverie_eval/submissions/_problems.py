"""Everything that can be wrong with a submission, worded for the person who has to fix it.

A message says what was found, what was expected and what to do; each kind has a stable code. No
message may depend on the solution, because participants of private splits see it. Mistakes that
many records share are in ``_faults``.
"""

import math
import re
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from string import Formatter
from typing import Any, NamedTuple

import numpy as np

from reverie_eval.arrays import LARGEST_OBJECT_ID
from reverie_eval.errors import Problem
from reverie_eval.tasks import Task
from reverie_eval.text import count_text

WHOLE_FILE = "file"
POSE_FORM = "[viewpoint_id, heading, elevation]"
TRAJECTORY_FORM = f"a list of poses {POSE_FORM}"
OBJECT_FORM = "an object id (an integer from 0), or -1 where the agent predicts no object"
BOX_FORM = "[x, y, width, height] in pixels from the upper left corner"
IMAGE_SIZE_FORM = "[width, height] of the image that predBox is in, at least 1 each"

POINT_FORM = "a number of turns, or null where the agent predicts no point"

_ONLY_NEEDED = "a submission needs only instr_id, trajectory and predObjId: remove everything else"

PoseLocation = tuple[int, ...]
"""Where a viewpoint is in its trajectory: the index of the element, and the index within it."""


class RecordLocation(NamedTuple):
    """Where a record is in its file: ``[3]``, or ``["4774_267_1"]`` if keyed by id."""

    row: int
    key: str | None = None
    trajectory: int | None = None
    """The index of one of the record's trajectories; None if it has only one."""
    id_key: str = "instr_id"
    """The field with its id: ``inst_idx`` in NDH."""

    def __str__(self) -> str:
        return self.at("")

    def at(self, field: str) -> str:
        """Return where a field is; an item's trajectories have theirs: ``[3].trajectory[2].path``.

        >>> RecordLocation(3).at(".trajectory[5]")
        '[3].trajectory[5]'
        >>> RecordLocation(3, trajectory=2).at(".trajectory[5]")
        '[3].trajectory[2].path[5]'
        """
        record = f"[{self.row}]" if self.key is None else f'["{self.key}"]'
        if field == ".instr_id":
            return f"{record}.{self.id_key}"
        if self.trajectory is None:
            return f"{record}{field}"
        return f"{record}.trajectory[{self.trajectory}]{field.replace('.trajectory', '.path')}"


def pose_field(pose: PoseLocation) -> str:
    """Return where a pose is in its record."""
    return ".trajectory" + "".join(f"[{index}]" for index in pose)


class _Text(Formatter):
    """Fills in values as ``str.format`` does; ``{x!j}`` shows one as JSON, shortened to fit a line.

    ``{x!t}`` says how to turn the arrays or tensors in a value into what JSON would hold.
    """

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        """Convert a value by the letter after its name."""
        own = {"j": show, "t": _array_remedy}.get(conversion or "")
        return super().convert_field(value, conversion) if own is None else own(value)


_TEXT = _Text()


@dataclass(frozen=True, slots=True)
class Template:
    """A kind of problem: its stable code, and its message with the values to fill in."""

    code: str
    message: str
    field: str = ""
    """The field of the record that is wrong, if it is always the same."""

    def of_file(self, where: str = WHOLE_FILE, /, **values: object) -> Problem:
        """Return the problem of the file as a whole."""
        return Problem(self.code, where, self.text(**values))

    def of_record(self, location: RecordLocation, field: str = "", /, **values: object) -> Problem:
        """Return the problem of a record, or of one of its fields."""
        where = location.at(field or self.field)
        return Problem(self.code, where, self.text(**values), (location.row,))

    def of_pose(self, location: RecordLocation, pose: PoseLocation, /, **values: object) -> Problem:
        """Return the problem of a pose in the trajectory of a record."""
        where, position = location.at(pose_field(pose)), (location.row, *pose)
        return Problem(self.code, where, self.text(**values), position)

    def text(self, **values: object) -> str:
        """Return the message with its values."""
        return _TEXT.vformat(self.message, (), values)


# The file as a whole.

NOT_JSON = Template("not-json", "{reason}, got {found!j}; write the file with a JSON library")
CUT_SHORT = Template(
    "not-json", "the JSON ends in the middle, so the file was cut short; write or copy it again"
)
COMMA_AT_END = Template(
    "not-json",
    "there is a comma before the closing {bracket}; remove it, or write the file with a JSON "
    "library",
)
NOT_A_LITERAL = Template(
    "not-json",
    "looks printed by Python, but was cut short or holds more than lists, dictionaries, strings "
    "and plain numbers, such as nan or array(...); write it with json.dump",
)
ANOTHER_KIND = Template(
    "not-json", "is {kind}; send the result file itself, as JSON or gzipped JSON"
)
HUGE_NUMBER = Template(
    "not-json",
    f"holds an integer with thousands of digits; object ids go up to {LARGEST_OBJECT_ID:,}",
)
TOO_DEEP = Template("too-deep", "is nested too deeply to be read; a submission has four levels")
TOO_LARGE = Template("too-large", f"is larger than {{mebibytes}} MiB unpacked; {_ONLY_NEEDED}")
TOO_LARGE_FOR_NOW = replace(
    TOO_LARGE,
    message=f"{TOO_LARGE.message}; if it needs this size, set {{variable}} to the size in MiB",
)
TOO_MUCH_TIME = Template(
    "too-large",
    "takes more than {seconds} seconds of processor time to read, and a real file about one; "
    f"{_ONLY_NEEDED}",
)
TOO_MUCH_MEMORY = Template(
    "too-large", f"takes more than {{mebibytes:,}} MiB of memory to read; {_ONLY_NEEDED}"
)
TOO_MANY_RECORDS = Template(
    "too-large", "holds more than {limit:,} records; no split has that many episodes"
)
TOO_MANY_VALUES = Template(
    "too-large", "holds about {found:,} values, more than the limit of {limit:,}"
)
TOO_MANY_PROBLEMS = Template(
    "too-many-problems",
    "has more than {limit:,} problems; fix these first, because the rest was not checked",
)
DAMAGED_GZIP = Template("damaged-gzip", "cannot be unpacked ({reason}); compress or copy it again")
DAMAGED_ZIP = Template("damaged-zip", "cannot be unpacked ({reason}); send the result file itself")
NOT_ONE_FILE = Template("several-files", "is a zip archive with {found}; pack only the result file")
NOT_A_LIST = Template(
    "not-a-list", "holds {found!j}; expected a list of predictions: [{record}, ...]"
)
UNDECLARED_NAVIGATION_ONLY = Template(
    "navigation-only",
    "no record has an answer; if the agent only navigates, declare it: --navigation-only on the "
    'command line, navigation_only in the API, or "Navigation only" on the page',
)
DECLARED_NAVIGATION_ONLY = Template(
    "navigation-only",
    "has answers, but the method is declared navigation only; remove that declaration",
)
BOXES_OUTSIDE = Template(
    "wrong-scale",
    "{count:,} of its {total:,} boxes lie entirely outside the 640 x 480 image; predBox is [x, y, "
    "width, height] in pixels of that image, or of one with the size in predImageSize",
)
TINY_BOXES = Template(
    "wrong-scale",
    "{count:,} of its {total:,} boxes are at most two pixels wide and high; if they are fractions "
    'of the image, add "predImageSize": [1, 1]',
)
NO_ANSWERS = Template(
    "missing-field", "no record has an answer, and the grounding track scores nothing else"
)
NO_EPISODE_OF_SPLIT = Template(
    "missing-episode",
    "has no prediction for any of the {expected:,} episodes of {split}; each needs one",
)
MISSING_EPISODE = Template(
    "missing-episode",
    "episode {instr_id} has no prediction; every episode of {split} needs one; if the agent gave "
    "none, list a stop at the start {start} without an answer: it counts as a failure",
)
MISSING_EPISODES = Template(
    "missing-episode",
    "{count:,} of the {expected:,} episodes of {split} have no prediction, such as {examples}; "
    "merge all processes' files, list stops at the start ({points:.1f} points lost in all), "
    "or score a sample with reverie-eval --episodes-from",
)
IDS_OF_ANOTHER_TASK = Template(
    "other-task",
    "{ids_look} like {titles} ids, not like {task.title} ids ({task.id_example}); the first is "
    "{first!j}: score the file with --task {other.name}",
)
RESULTS_OF_ANOTHER_TASK = Template(
    "other-task",
    "holds results of {other.title}, not of {task.title}: {sign}; score the file with --task "
    "{other.name}",
)
_NOT_DEMO = (
    "to score {task.title} itself, clone {task.source}, run `reverie-eval compile {task.title} "
    "{option}--split {split} -o {split}.npz` once and pass --ground-truth {split}.npz"
)
IDS_OUTSIDE_DEMO = Template(
    "not-the-demo-world",
    "no instr_id is in the demo world that ships with this package ({count:,} are not, the first "
    "is {first!j}); " + _NOT_DEMO,
)
BUILDINGS_OUTSIDE_DEMO = Template(
    "not-the-demo-world",
    "{count:,} of {total:,} trajectories begin in no building of the demo world that ships with "
    "this package; " + _NOT_DEMO,
)
POSITIONS = Template(
    "continuous-environment",
    "{count:,} of its {paths} are positions, such as {example!j}, of a continuous environment "
    "(VLN-CE, RxR-Habitat); only viewpoints of the navigation graph can be scored",
)
OTHER_RELEASE = Template(
    "other-release",
    "has {found:,} records, as many as {release} has episodes of {split}, but the ground truth is "
    "{own}, with {expected:,}; name one of {release} by --ground-truth, or send the predictions "
    "for {own}",
)
OTHER_BUILDINGS = Template(
    "other-scan",
    "{count:,} of {total:,} trajectories begin in another building than the episode of {split} "
    "with their id; other splits and tasks number theirs alike: check --split and --task, and that "
    "trajectories and instr_ids were not mixed up",
)
REPEATED_KEY = Template("repeated-field", "has {key!j} twice; keep the right one")

# A record.

WRONG_TYPE = Template("wrong-type", "got {found!j}; expected {expected}{found!t}")
REPEATED_FIELD = Template("repeated-field", "has {field} twice; keep the right one")
MISSING_FIELD = Template("missing-field", "has no {field}; add it")
DUETS_EPISODES = Template(
    "unknown-episode",
    "{instr_id!j} is an episode id of DUET's own files, which does not identify the item; write "
    "the item's instr_id, with its trajectories in the order of its paths",
    ".instr_id",
)
KEY_MISMATCH = Template(
    "key-mismatch", "is {instr_id!j} under the key {key!j}; make them equal", ".instr_id"
)
UNKNOWN_EPISODE = Template(
    "unknown-episode",
    "{instr_id!j} is not an episode of {split}; ids are {task.id_form}",
    ".instr_id",
)
OTHER_SPLIT = Template(
    "other-split",
    "holds {found}, and no episode of {split}; the first is {instr_id!j}: {score}send the "
    "predictions for {split}",
    ".instr_id",
)
DUPLICATE_EPISODE = Template(
    "duplicate-episode",
    "{instr_id} already has a prediction in {first}; keep one per episode",
    ".instr_id",
)
CHANGED_PREDICTION = Template(
    "duplicate-episode",
    "{instr_id} already has a different prediction; keep one per episode, and call reset() before "
    "the next epoch",
    ".instr_id",
)
EMPTY_TRAJECTORY = Template(
    "empty-trajectory",
    "is empty; an agent that does not move has one pose, its start viewpoint",
    ".trajectory",
)
TOO_MANY_POSES = Template(
    "too-large",
    "holds {found:,} elements, more than the {limit:,} that any agent could need",
    ".trajectory",
)

# An answer.

NO_ANSWER = Template("missing-field", "has neither predObjId nor predBox; add one")
TWO_ANSWERS = Template(
    "two-answers",
    "got {found!j} together with predBox; an episode has one answer: remove one, or set {key} to "
    "-1",
)
BOX_NOT_FINITE = Template(
    "not-finite", f"got {{found!j}}; expected {BOX_FORM}, finite numbers", ".predBox"
)
EMPTY_BOX = Template(
    "empty-box", f"got {{found!j}}; expected {BOX_FORM}, with positive width and height", ".predBox"
)
WRONG_VIEW = Template(
    "wrong-view",
    "got {found!j}; expected a view index, an integer from 0 to 35: 0-11 look down, 12-23 are "
    "level, 24-35 look up, each row turning right from heading 0{found!t}",
    ".predView",
)
NO_VIEW = Template(
    "missing-field", "has a predBox but no predView; add the index of the view it is in (0-35)"
)
NO_VIEW_NOR_POSE = replace(
    NO_VIEW, message=f"{NO_VIEW.message}, or give heading and elevation in the last pose"
)
UPSIDE_DOWN = Template(
    "wrong-camera",
    "the camera of the box has an elevation of {elevation!j}, beyond straight up or down (pi / 2); "
    "give radians, or the view index in predView (0-35)",
)
HALF_A_POINT = Template(
    "wrong-type",
    "has only one of obj_heading and obj_elevation, the other is null; give both or neither",
)

# A pose.

WRONG_POSE = Template("wrong-type", f"got {{found!j}}; expected {POSE_FORM}{{found!t}}")
NOT_FINITE = Template(
    "not-finite", "got {found!j}; heading and elevation are finite numbers of radians"
)
UNKNOWN_VIEWPOINT = Template(
    "unknown-viewpoint",
    "viewpoint {viewpoint_id!j} is not in the navigation graph of scan {scan}; use the viewpoint "
    "ids of the connectivity files",
)
VIEWPOINT_OF_ANOTHER_SCAN = Template(
    "other-scan",
    "viewpoint {viewpoint_id} belongs to scan {other_scan}, but the episode is in scan {scan}; "
    "check that trajectories and instr_ids were not mixed up",
)
WRONG_START = Template(
    "wrong-start",
    "episode {instr_id} starts at viewpoint {expected}, got {found}; list the start viewpoint as "
    "the first pose",
)
WRONG_START_OF_ITEM = Template(
    "wrong-start",
    "episode {instr_id} starts at viewpoint {expected}, got {found}; list the trajectories in the "
    "order of the item's paths, each from its start",
)
UNREACHABLE = Template(
    "unreachable",
    "viewpoint {viewpoint_id} cannot be reached from the start; a jump counts at shortest-path "
    "distance, so there must be a route",
)


def official_form(task: Task) -> str:
    """Return a record of the official form of a task's results, with its values left out."""
    trajectory = f"[{POSE_FORM}, ...]"
    if task.has_items:
        trajectory = f'[{{"path": {trajectory}, "obj_heading": ..., "obj_elevation": ...}}, ...]'
    answer = ', "predObjId": ...' if task.has_targets else ""
    return f'{{"{task.id_field.name}": ..., "trajectory": {trajectory}{answer}}}'


def ids_of_another_task(count: int, first: str, task: Task, others: Sequence[Task]) -> Problem:
    """Return the problem of a file whose ids look like those of other tasks."""
    return IDS_OF_ANOTHER_TASK.of_file(
        ids_look="1 id looks" if count == 1 else f"{count:,} ids look",
        titles=" or ".join(each.title for each in others),
        task=task,
        first=first,
        other=others[0],
    )


def results_of_other_splits(
    counts: Mapping[str, int], split: str, location: RecordLocation, instr_id: str
) -> Problem:
    """Return the problem of a file with records of other splits alone, as many as are given."""
    only = next(iter(counts)) if len(counts) == 1 else None
    problem = OTHER_SPLIT.of_record(
        location,
        found=" and ".join(f"{name} ({count_text(n, 'record')})" for name, n in counts.items()),
        split=split,
        instr_id=instr_id,
        score="" if only is None else f"score the file as {only}, or ",
    )
    return replace(problem, split=only)


def record_form(task: Task) -> str:
    """Return what a record of a task's result is."""
    answer = ", trajectory and predObjId" if task.has_targets else " and trajectory"
    return f"an object with {task.id_field.name}{answer}"


def id_form(task: Task) -> str:
    """Return what the id of a task's episode is."""
    if task.id_example.isdecimal():
        return f"the number of the episode: {task.id_example}"
    return f'the episode\'s id as text: "{task.id_example}"'


class _Short(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        """Refuse integers with thousands of digits as Python does, also from Python 3.14 on."""
        repr(x)  # where reprlib shows an address in memory
        return super().repr_int(x, level)


_LINE_END = re.compile(r"\s*\n\s*")
_short = _Short()
_short.maxstring = _short.maxother = 60
_short.maxlevel, _short.maxlist, _short.maxdict = 2, 4, 2


def show(value: object) -> str:
    """Show a value as JSON would, shortened to fit a line."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    try:
        return _LINE_END.sub(" ", _short.repr(value))  # arrays and tensors are shown in lines
    except ValueError:  # Python refuses to print integers with thousands of digits.
        return "an integer with thousands of digits"


def size_of_array(value: Any) -> int | None:
    """Return the number of values in an array or a tensor; None for anything else."""
    is_array = hasattr(value, "tolist") and not isinstance(value, np.generic)
    return math.prod(np.shape(value)) if is_array else None


def _array_remedy(found: object) -> str:
    """Say how to turn the arrays or tensors in a value into what JSON would hold."""
    parts = [found, *(found if isinstance(found, list | tuple) else ())]
    sizes = {size for size in map(size_of_array, parts) if size is not None}
    if not sizes:
        return ""
    return "; use .item()" if sizes == {1} else "; use .tolist()"
