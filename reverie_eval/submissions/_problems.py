"""Everything that can be wrong with a submission, worded for the person who has to fix it.

There is one function per kind of problem, with its stable code. A message says what was found, what
was expected and what to do. No message may depend on the answers, because participants of private
splits see it.
"""

import math
import re
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from sys import maxsize
from typing import Any, NamedTuple

import numpy as np

from reverie_eval.arrays import LARGEST_OBJECT_ID
from reverie_eval.errors import SHOWN_PROBLEMS, Problem
from reverie_eval.tasks import DEFAULT_TASK, Task
from reverie_eval.text import count_text, first_few

MAX_PROBLEMS = 10_000
"""Checking stops after this many problems; fixing these nearly always fixes the rest."""

WHOLE_FILE = "file"
POSE_FORM = "[viewpoint_id, heading, elevation]"
TRAJECTORY_FORM = f"a list of poses {POSE_FORM}"
OBJECT_FORM = "an object id (an integer from 0), or -1 where the agent predicts no object"
BOX_FORM = "[x, y, width, height] in pixels from the upper left corner"
IMAGE_SIZE_FORM = "[width, height] of the image that predBox is in, at least 1 each"

POINT_FORM = "a number of turns, or null where the agent predicts no point"

_CONVERT = "reverie-eval convert"
_CONVERT_FOR_SPLIT = "reverie-eval convert --split"

PosePath = tuple[int, ...]
"""Where a viewpoint is in its trajectory: the index of the element, and the index within it."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A mistake with one cause that many records of a file share; it is reported once."""

    code: str
    what: str
    """What the records have; ``{example}`` is what the first of them has."""
    remedy: str
    convert: str = _CONVERT
    """The command that writes a corrected file; empty if the mistake does not say how."""

    def problem(
        self, count: int, where: str, position: tuple[int, ...], example: object
    ) -> Problem:
        """Return the one problem that reports the mistake of so many records."""
        subject = "has" if count == 1 else f"{count:,} records have"
        command = f", or let `{self.convert}` do it" if self.convert else ""
        message = f"{subject} {self._what(example)}; {self.remedy}{command}"
        return Problem(self.code, where, message, position)

    def fixed(self, count: int, where: str, example: object) -> str:
        """Return the note about a mistake that was corrected in so many records."""
        records = "" if where == WHOLE_FILE else f", in {count_text(count, 'record')}"
        return f"{self._what(example)}{records}"

    def _what(self, example: object) -> str:
        return self.what.format(example=_json(example))


JSON_LINES = Fault(
    "not-json",
    "one JSON object after another instead of one list",
    "write a list of records",
)
SEVERAL_LISTS = Fault(
    "not-json",
    "several lists one after another",
    "write one list",
)
ENCODED_TWICE = Fault(
    "not-json",
    "the JSON inside a string: it was encoded twice",
    "use json.dump alone, without json.dumps",
)
TRAILING_TEXT = Fault(
    "not-json",
    "text after the JSON: {example}",
    "remove it",
)
PYTHON_LITERAL = Fault(
    "not-json",
    "a list printed by Python instead of JSON",
    "write it with json.dump",
)
WRAPPED = Fault(
    "not-a-list",
    "the records under the key {example}",
    "write only the list of records",
)
WRAPPED_LISTS = Fault(
    "not-a-list",
    "lists of records under several keys, such as {example}",
    "write only the list of records of one split",
    _CONVERT_FOR_SPLIT,
)
NESTED_LISTS = Fault(
    "not-a-list",
    "lists of records inside the list",
    "write one flat list of records",
)
TABLE = Fault(
    "not-a-list",
    "a table of columns instead of records",
    'write a list of records (pandas: to_json(orient="records"))',
)
KEYED_BY_ROW = Fault(
    "not-a-list",
    "records keyed by row numbers, such as {example}",
    'write a list of records (pandas: to_json(orient="records"))',
)
DECIMAL_IDS = Fault(
    "wrong-type",
    "an object id written as a decimal, such as {example}",
    "write whole numbers",
)
DECIMAL_NUMBERS = Fault(
    "wrong-type",
    "the number of an episode written as a decimal, such as {example}",
    "write whole numbers",
)
DISAGREEING_ANSWERS = Fault(
    "two-answers",
    "different answers under two keys, such as {example}",
    "keep one of the keys",
    convert="",
)
NO_OBJECTS = Fault(
    "wrong-type",
    "{example} for no object",
    "write -1 where the agent predicts no object",
)
VIEWS_NOT_WHOLE = Fault(
    "wrong-view",
    "a view index that is not written as a whole number, such as {example}",
    "write whole numbers",
)
NULL_BOXES = Fault(
    "missing-field",
    "a null predBox and no object id",
    "write predObjId -1 where the agent predicts no object",
)
POSES_AS_OBJECTS = Fault(
    "wrong-type",
    "poses written as objects, such as {example}",
    f"write lists {POSE_FORM}",
)
ANGLES_AS_TEXT = Fault(
    "wrong-type",
    "angles written as text, such as {example}",
    "write numbers",
)
NULL_ANGLES = Fault(
    "wrong-type",
    "null for heading and elevation, such as {example}",
    "write numbers, or [viewpoint_id] alone",
)
NUMBERS_AS_TEXT = Fault(
    "wrong-type",
    "numbers written as text, such as {example}",
    "write numbers",
)
PRINTED_VALUES = Fault(
    "wrong-type",
    "a tensor, an array or a list printed as text, such as {example}",
    "write its value, by .item() or .tolist()",
)
LISTED_VALUES = Fault(
    "wrong-type",
    "a value in a list of one, such as {example}",
    "write the value alone",
)
ARRAYS_OF_ONE = Fault(
    "wrong-type",
    "a tensor or an array instead of its value, such as {example}",
    "use .item()",
    convert="",
)
PADDED_VALUES = Fault(
    "wrong-type",
    "spaces or a line end around a value, such as {example}",
    "remove them",
)
NUMBERED_IDS = Fault(
    "wrong-type",
    "a number for the id, such as {example}",
    "write the episode's id as text",
    convert="",
)
ITEMS_FOR_PATHS = Fault(
    "wrong-type",
    "a trajectory that is an object with a path, as in SOON, such as {example}",
    "write the path itself, a list of poses",
)
SEVERAL_PATHS = Fault(
    "wrong-type",
    "several trajectories, such as {example}",
    "write one list of poses for each episode",
    convert="",
)
PATHS_FOR_ITEMS = Fault(
    "wrong-type",
    "a trajectory that is a list of poses, such as {example}",
    "write a list of objects with path, obj_heading and obj_elevation, one for each start of the "
    "item",
    convert="",
)
FLAT_ITEMS = Fault(
    "wrong-type",
    "a trajectory beside its point, such as {example}",
    "write a list of objects, each with its path and its point",
)
NUMBERED_VIEWPOINTS = Fault(
    "wrong-type",
    "viewpoints given as numbers, such as {example}",
    "write the viewpoint ids of the connectivity files, not their positions in them",
    convert="",
)
PADDED_IDS = Fault(
    "unknown-episode",
    "spaces or a line end around the id, such as {example}",
    "remove them",
    _CONVERT_FOR_SPLIT,
)
PRINTED_IDS = Fault(
    "unknown-episode",
    "an id printed as a tensor, an array or a list, such as {example}",
    "write the id alone",
    _CONVERT_FOR_SPLIT,
)
PREFIXED_IDS = Fault(
    "unknown-episode",
    "a prefix before the id, such as {example}",
    "remove it",
    _CONVERT_FOR_SPLIT,
)
SUFFIXED_IDS = Fault(
    "unknown-episode",
    "something after the id, such as {example}",
    "remove it",
    _CONVERT_FOR_SPLIT,
)
REWRITTEN_IDS = Fault(
    "unknown-episode",
    "an id that is written otherwise, such as {example}",
    "write its numbers plainly, with underscores between them",
    _CONVERT_FOR_SPLIT,
)
REORDERED_IDS = Fault(
    "unknown-episode",
    "the parts of the id in another order, such as {example}",
    "write them in the order of the annotations' ids",
    _CONVERT_FOR_SPLIT,
)
IDS_FROM_ONE = Fault(
    "unknown-episode",
    "instructions numbered from 1, such as {example}",
    "number them from 0",
    _CONVERT_FOR_SPLIT,
)
PADDED_VIEWPOINTS = Fault(
    "unknown-viewpoint",
    "spaces or a line end around viewpoint ids, such as {example}",
    "remove them",
    _CONVERT_FOR_SPLIT,
)
PRINTED_VIEWPOINTS = Fault(
    "unknown-viewpoint",
    "viewpoint ids printed as arrays or lists, such as {example}",
    "write the viewpoint ids alone",
    _CONVERT_FOR_SPLIT,
)
SURROUNDED_VIEWPOINTS = Fault(
    "unknown-viewpoint",
    "viewpoint ids in capitals or with something beside them, such as {example}",
    "write the viewpoint ids alone",
    _CONVERT_FOR_SPLIT,
)
VIEWPOINTS_WITH_SCANS = Fault(
    "unknown-viewpoint",
    "the scan before viewpoint ids, such as {example}",
    "write the viewpoint ids alone",
    _CONVERT_FOR_SPLIT,
)
REPEATED_RECORDS = Fault(
    "duplicate-episode",
    "the same trajectory and answer as an earlier record, such as {example}",
    "remove the repeats",
)


def misspelt(field: str, meant: str) -> Fault:
    """Return the fault of records that have a field under another name; one for each name."""
    what = f"the field {_json(field).replace('{', '{{').replace('}', '}}')}, which is not read"
    return Fault("misspelt-field", what, f"did you mean {meant}? Rename it")


def missing_in_all(field: str) -> Fault:
    """Return the fault of trajectories without a field that agents write for all or for none."""
    return Fault("missing-field", f"no {field}", "add it", convert="")


def incomplete_ids(lacking: Sequence[str], form: str, fitting: str) -> Fault:
    """Return the fault of ids that lack some of their parts.

    ``fitting`` says what keeps them from being completed; without it, each tells its episode.
    """
    lack = f"the {' and the '.join(lacking)}" if lacking else "the marks between its parts"
    what = f"an id without {lack}, such as {{example}}"
    remedy = f"write {form}" + (f"; {fitting}" if fitting else "")
    return Fault("unknown-episode", what, remedy, "" if fitting else _CONVERT_FOR_SPLIT)


def unknown_episodes(split: str, task: Task) -> Fault:
    """Return the fault of many ids that have nothing in common with those of the split."""
    what = f"an id that is not an episode of {split}, such as {{example}}"
    return Fault("unknown-episode", what, f"ids are {task.id_form}", convert="")


def records_of_other_splits(others: Sequence[str], found: int, expected: int, split: str) -> Fault:
    """Return the fault of records for other splits, beside those for the one that is scored."""
    there = f"all {expected:,}" if found == expected else f"{found:,} of the {expected:,}"
    return Fault(
        "other-split",
        f"an id of {' or '.join(others)}, such as {{example}}, beside {there} episodes of {split}",
        "remove these records",
        _CONVERT_FOR_SPLIT,
    )


class RecordLocation(NamedTuple):
    """Where a record is in its file: ``[3]``, or ``["4774_267_1"]`` if keyed by id."""

    row: int
    key: str | None = None
    place: int | None = None
    """Which trajectory of an item it is; None if the record is not one of an item's."""
    id_key: str = "instr_id"
    """The field with its id: ``inst_idx`` in NDH."""

    def __str__(self) -> str:
        return self.at("")

    def at(self, field: str) -> str:
        """Return where a field is; an item's trajectories have theirs: ``[3].trajectory[2].path``.

        >>> RecordLocation(3).at(".trajectory[5]"), RecordLocation(3, place=2).at(".trajectory[5]")
        ('[3].trajectory[5]', '[3].trajectory[2].path[5]')
        """
        record = f"[{self.row}]" if self.key is None else f'["{self.key}"]'
        if field == ".instr_id":
            return f"{record}.{self.id_key}"
        if self.place is None:
            return f"{record}{field}"
        return f"{record}.trajectory[{self.place}]{field.replace('.trajectory', '.path')}"


def record_form(task: Task) -> str:
    """Return what a record of a task's result is."""
    answer = ", trajectory and predObjId" if task.has_targets else " and trajectory"
    return f"an object with {task.id_keys[0]}{answer}"


def id_form(task: Task) -> str:
    """Return what the id of a task's episode is."""
    if task.id_example.isdecimal():
        return f"the number of the episode: {task.id_example}"
    return f'the episode\'s id as text: "{task.id_example}"'


_ANY_PLACE = re.compile(r"""^\["[^"]*"\]|\[\d+\]""")
"""The numbers of records and poses in the location of a problem, and the keys of records."""
_OF_FIELDS = (
    *("wrong-type", "missing-field", "not-finite", "empty-trajectory", "empty-box", "wrong-view"),
    *("two-answers", "wrong-camera", "unknown-viewpoint", "other-scan", "wrong-start"),
    *("unreachable", "duplicate-episode"),
)
"""The codes of problems with one field of one record."""


def limit_problems(problems: Iterable[Problem]) -> Sequence[Problem]:
    """Return all problems, or the first of them and one that says that there are more.

    A mistake that more records share than fit a screen is one problem.
    """
    first = list(islice(problems, MAX_PROBLEMS + 1))
    if len(first) <= MAX_PROBLEMS:
        return _join_alike(first)
    message = (
        f"has more than {MAX_PROBLEMS:,} problems; fix these first, because the rest was not "
        "checked"
    )
    # Problems are sorted by position: the largest possible one comes last.
    return [*_join_alike(first[:-1]), Problem("too-many-problems", WHOLE_FILE, message, (maxsize,))]


def _join_alike(problems: Iterable[Problem]) -> Sequence[Problem]:
    """Return problems with one for each field that many records have wrong in the same way.

    Where values differ, so do the messages, though the mistake is one.
    """
    alike: dict[tuple[str, str], list[Problem]] = {}
    for problem in problems:
        field = _ANY_PLACE.sub("", problem.where) or problem.message
        alike.setdefault((problem.code, field), []).append(problem)
    return [each for found in alike.values() for each in _joined(found)]


def _joined(found: Sequence[Problem]) -> Sequence[Problem]:
    if len(found) <= SHOWN_PROBLEMS or found[0].code not in _OF_FIELDS:
        return found
    first = min(found, key=lambda problem: problem.position)
    return [replace(first, message=f"{first.message} ({len(found) - 1:,} more like it)")]


class _Short(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        """Refuse integers with thousands of digits as Python does, also from Python 3.14 on."""
        repr(x)  # where reprlib shows an address in memory
        return super().repr_int(x, level)


_short = _Short()
_short.maxstring = _short.maxother = 60
_short.maxlevel, _short.maxlist, _short.maxdict = 2, 4, 2


def _json(value: object) -> str:
    """Show a value as JSON would, shortened to fit a line."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    try:
        return _short.repr(value)
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


def _record_problem(code: str, location: RecordLocation, message: str, field: str = "") -> Problem:
    return Problem(code, location.at(field), message, (location.row,))


def pose_field(path: PosePath) -> str:
    """Return where a pose is in its record."""
    return ".trajectory" + "".join(f"[{index}]" for index in path)


def _pose_problem(code: str, location: RecordLocation, path: PosePath, message: str) -> Problem:
    return Problem(code, location.at(pose_field(path)), message, (location.row, *path))


# The file as a whole.


def not_json(where: str, reason: str) -> Problem:
    return Problem("not-json", where, f"{reason}; write the file with a JSON library")


def cut_short(where: str) -> Problem:
    message = "the JSON ends in the middle, so the file was cut short; write or copy it again"
    return Problem("not-json", where, message)


def not_a_literal() -> Problem:
    message = (
        "looks printed by Python, but was cut short or holds more than lists, dictionaries, "
        "strings and plain numbers, such as nan or array(...); write it with json.dump"
    )
    return Problem("not-json", WHOLE_FILE, message)


def another_kind(kind: str) -> Problem:
    message = f"is {kind}; send the result file itself, as JSON or gzipped JSON"
    return Problem("not-json", WHOLE_FILE, message)


def huge_number() -> Problem:
    message = (
        f"holds an integer with thousands of digits; object ids go up to {LARGEST_OBJECT_ID:,}"
    )
    return Problem("not-json", WHOLE_FILE, message)


def too_deep() -> Problem:
    message = "is nested too deeply to be read; a submission has four levels"
    return Problem("too-deep", WHOLE_FILE, message)


_ONLY_NEEDED = "a submission needs only instr_id, trajectory and predObjId: remove everything else"


def too_large(limit: int, variable: str | None) -> Problem:
    message = f"is larger than {limit >> 20} MiB unpacked; {_ONLY_NEEDED}"
    if variable:
        message += f"; if it needs this size, set {variable} to the size in MiB"
    return Problem("too-large", WHOLE_FILE, message)


def too_much_time(seconds: int) -> Problem:
    message = (
        f"takes more than {seconds} seconds of processor time to read, and a real file about one; "
        f"{_ONLY_NEEDED}"
    )
    return Problem("too-large", WHOLE_FILE, message)


def too_much_memory(mebibytes: int) -> Problem:
    message = f"takes more than {mebibytes:,} MiB of memory to read; {_ONLY_NEEDED}"
    return Problem("too-large", WHOLE_FILE, message)


def too_many_records(limit: int) -> Problem:
    message = f"holds more than {limit:,} records; no split has that many episodes"
    return Problem("too-large", WHOLE_FILE, message)


def too_many_values(found: int, limit: int) -> Problem:
    message = f"holds about {found:,} values, more than the limit of {limit:,}"
    return Problem("too-large", WHOLE_FILE, message)


def damaged_gzip(reason: str) -> Problem:
    message = f"cannot be unpacked ({reason}); compress or copy it again"
    return Problem("damaged-gzip", WHOLE_FILE, message)


def damaged_zip(reason: str) -> Problem:
    message = f"cannot be unpacked ({reason}); send the result file itself"
    return Problem("damaged-zip", WHOLE_FILE, message)


def not_one_file(names: Sequence[str]) -> Problem:
    listed = first_few(map(_json, names))
    found = f"{count_text(len(names), 'file')}: {listed}" if names else "no file"
    message = f"is a zip archive with {found}; pack only the result file"
    return Problem("several-files", WHOLE_FILE, message)


def not_a_list(found: object, task: Task) -> Problem:
    trajectory = f"[{POSE_FORM}, ...]"
    if task.has_items:
        trajectory = f'[{{"path": {trajectory}, "obj_heading": ..., "obj_elevation": ...}}, ...]'
    answer = ', "predObjId": ...' if task.has_targets else ""
    message = (
        f"holds {_json(found)}; expected a list of predictions: "
        f'[{{"{task.id_keys[0]}": ..., "trajectory": {trajectory}{answer}}}, ...]'
    )
    return Problem("not-a-list", WHOLE_FILE, message)


def undeclared_navigation_only() -> Problem:
    message = (
        "no record has an answer; if the agent only navigates, declare it: --navigation-only on "
        'the command line, navigation_only in the API, or "Navigation only" on the page'
    )
    return Problem("navigation-only", WHOLE_FILE, message)


def declared_navigation_only() -> Problem:
    message = "has answers, but the method is declared navigation only; remove that declaration"
    return Problem("navigation-only", WHOLE_FILE, message)


def boxes_outside(count: int, total: int) -> Problem:
    message = (
        f"{count:,} of its {total:,} boxes lie entirely outside the 640 x 480 image; predBox is "
        "[x, y, width, height] in pixels of that image, or of one with the size in predImageSize"
    )
    return Problem("wrong-scale", WHOLE_FILE, message)


def tiny_boxes(count: int, total: int) -> Problem:
    message = (
        f"{count:,} of its {total:,} boxes are at most two pixels wide and high; if they are "
        'fractions of the image, add "predImageSize": [1, 1]'
    )
    return Problem("wrong-scale", WHOLE_FILE, message)


def no_answers() -> Problem:
    message = "no record has an answer, and the grounding track scores nothing else"
    return Problem("missing-field", WHOLE_FILE, message)


def no_episode_of_split(split: str, expected: int) -> Problem:
    message = f"has no prediction for any of the {expected:,} episodes of {split}; each needs one"
    return Problem("missing-episode", WHOLE_FILE, message)


def missing_episode(instr_id: str, split: str) -> Problem:
    message = f"episode {instr_id} has no prediction; every episode of {split} needs one"
    return Problem("missing-episode", WHOLE_FILE, message)


def missing_episodes(missing: Sequence[str], expected: int, split: str) -> Problem:
    message = (
        f"{len(missing):,} of the {expected:,} episodes of {split} have no prediction, such as "
        f"{first_few(missing)}; every episode needs one: check that the file holds the results of "
        "all processes and was not cut short"
    )
    return Problem("missing-episode", WHOLE_FILE, message)


def ids_of_another_task(count: int, first: str, task: Task, others: Sequence[Task]) -> Problem:
    titles = " or ".join(each.title for each in others)
    ids_look = "1 id looks" if count == 1 else f"{count:,} ids look"
    message = (
        f"{ids_look} like {titles} ids, not like {task.title} ids ({task.id_example}); the first "
        f"is {_json(first)}: score the file with --task {others[0].name}"
    )
    return Problem("other-task", WHOLE_FILE, message)


def results_of_another_task(task: Task, other: Task, sign: str) -> Problem:
    message = (
        f"holds results of {other.title}, not of {task.title}: {sign}; score the file with --task "
        f"{other.name}"
    )
    return Problem("other-task", WHOLE_FILE, message)


def ids_outside_demo(count: int, first: str, split: str, task: Task) -> Problem:
    of_task = "" if task.name == DEFAULT_TASK else f"--task {task.name} "
    message = (
        f"no instr_id is in the demo world that ships with this package ({count:,} are not, the "
        f"first is {_json(first)}); to score {task.title} itself, clone "
        f"{task.source}, run `reverie-eval compile {task.title} {of_task}--split {split} "
        f"-o {split}.npz` once and pass --ground-truth {split}.npz"
    )
    return Problem("not-the-demo-world", WHOLE_FILE, message)


def results_of_other_splits(
    counts: Mapping[str, int], split: str, location: RecordLocation, instr_id: str
) -> Problem:
    found = " and ".join(f"{name} ({count_text(n, 'record')})" for name, n in counts.items())
    score = f"score the file as {next(iter(counts))}, or " if len(counts) == 1 else ""
    message = (
        f"holds {found}, and no episode of {split}; the first is {_json(instr_id)}: {score}send "
        f"the predictions for {split}"
    )
    only = next(iter(counts)) if len(counts) == 1 else None
    return replace(_record_problem("other-split", location, message, ".instr_id"), split=only)


def positions(count: int, total: int, example: object) -> Problem:
    message = (
        f"{count:,} of its {count_text(total, 'path')} are positions, such as {_json(example)}, "
        "of a continuous environment (VLN-CE, RxR-Habitat); only viewpoints of the navigation "
        "graph can be scored"
    )
    return Problem("continuous-environment", WHOLE_FILE, message)


def repeated_key(key: str) -> Problem:
    return Problem("repeated-field", WHOLE_FILE, f"has {_json(key)} twice; keep the right one")


# A record.


def wrong_type(
    location: RecordLocation, found: object, expected: str, field: str | None = None
) -> Problem:
    message = f"got {_json(found)}; expected {expected}{_array_remedy(found)}"
    return _record_problem("wrong-type", location, message, f".{field}" if field else "")


def repeated_field(location: RecordLocation, field: str) -> Problem:
    return _record_problem("repeated-field", location, f"has {field} twice; keep the right one")


def duets_episodes(location: RecordLocation, instr_id: str) -> Problem:
    message = (
        f"{_json(instr_id)} is an episode id of DUET's own files, which does not identify the "
        "item; write the item's instr_id, with its trajectories in the order of its paths"
    )
    return _record_problem("unknown-episode", location, message, ".instr_id")


def key_mismatch(location: RecordLocation, instr_id: str) -> Problem:
    message = f"is {_json(instr_id)} under the key {_json(location.key)}; make them equal"
    return _record_problem("key-mismatch", location, message, ".instr_id")


def missing_field(location: RecordLocation, field: str) -> Problem:
    return _record_problem("missing-field", location, f"has no {field}; add it")


def unknown_episode(location: RecordLocation, instr_id: str, split: str, task: Task) -> Problem:
    message = f"{_json(instr_id)} is not an episode of {split}; ids are {task.id_form}"
    return _record_problem("unknown-episode", location, message, ".instr_id")


def duplicate_episode(location: RecordLocation, instr_id: str, first: RecordLocation) -> Problem:
    message = f"{instr_id} already has a prediction in {first}; keep one per episode"
    return _record_problem("duplicate-episode", location, message, ".instr_id")


def changed_prediction(location: RecordLocation, instr_id: str) -> Problem:
    message = (
        f"{instr_id} already has a different prediction; keep one per episode, and call reset() "
        "before the next epoch"
    )
    return _record_problem("duplicate-episode", location, message, ".instr_id")


def empty_trajectory(location: RecordLocation) -> Problem:
    message = "is empty; an agent that does not move has one pose, its start viewpoint"
    return _record_problem("empty-trajectory", location, message, ".trajectory")


def too_many_poses(location: RecordLocation, found: int, limit: int) -> Problem:
    message = f"holds {found:,} elements, more than the {limit:,} that any agent could need"
    return _record_problem("too-large", location, message, ".trajectory")


# An answer.


def no_answer(location: RecordLocation, object_key: str, box_key: str) -> Problem:
    message = f"has neither {object_key} nor {box_key}; add one"
    return _record_problem("missing-field", location, message)


def two_answers(location: RecordLocation, key: str, found: object) -> Problem:
    message = (
        f"got {_json(found)} together with predBox; an episode has one answer: remove one, or "
        f"set {key} to -1"
    )
    return _record_problem("two-answers", location, message, f".{key}")


def box_not_finite(location: RecordLocation, key: str, found: Sequence[object]) -> Problem:
    message = f"got {_json(list(found))}; expected {BOX_FORM}, finite numbers"
    return _record_problem("not-finite", location, message, f".{key}")


def empty_box(location: RecordLocation, key: str, found: Sequence[object]) -> Problem:
    message = f"got {_json(list(found))}; expected {BOX_FORM}, with positive width and height"
    return _record_problem("empty-box", location, message, f".{key}")


def wrong_view(location: RecordLocation, key: str, found: object) -> Problem:
    message = (
        f"got {_json(found)}; expected a view index, an integer from 0 to 35: 0-11 look down, "
        "12-23 are level, 24-35 look up, each row turning right from heading 0"
        f"{_array_remedy(found)}"
    )
    return _record_problem("wrong-view", location, message, f".{key}")


def no_view(location: RecordLocation, key: str, *, has_poses: bool) -> Problem:
    pose = ", or give heading and elevation in the last pose" if has_poses else ""
    message = f"has a predBox but no {key}; add the index of the view it is in (0-35){pose}"
    return _record_problem("missing-field", location, message)


def upside_down(location: RecordLocation, path: PosePath, elevation: float, key: str) -> Problem:
    message = (
        f"the camera of the box has an elevation of {_json(elevation)}, beyond straight up or "
        f"down (pi / 2); give radians, or the view index in {key} (0-35)"
    )
    return _pose_problem("wrong-camera", location, path, message)


def half_a_point(location: RecordLocation, keys: Sequence[str]) -> Problem:
    message = f"has only one of {' and '.join(keys)}, the other is null; give both or neither"
    return _record_problem("wrong-type", location, message)


# A pose.


def wrong_pose(location: RecordLocation, path: PosePath, found: object) -> Problem:
    message = f"got {_json(found)}; expected {POSE_FORM}{_array_remedy(found)}"
    return _pose_problem("wrong-type", location, path, message)


def not_finite(location: RecordLocation, path: PosePath, found: Sequence[object]) -> Problem:
    message = f"got {_json(list(found))}; heading and elevation are finite numbers of radians"
    return _pose_problem("not-finite", location, path, message)


def unknown_viewpoint(
    location: RecordLocation, path: PosePath, viewpoint_id: str, scan: str
) -> Problem:
    message = (
        f"viewpoint {_json(viewpoint_id)} is not in the navigation graph of scan {scan}; use the "
        "viewpoint ids of the connectivity files"
    )
    return _pose_problem("unknown-viewpoint", location, path, message)


def viewpoint_of_another_scan(
    location: RecordLocation, path: PosePath, viewpoint_id: str, scan: str, other_scan: str
) -> Problem:
    message = (
        f"viewpoint {viewpoint_id} belongs to scan {other_scan}, but the episode is in scan {scan};"
        " check that trajectories and instr_ids were not mixed up"
    )
    return _pose_problem("other-scan", location, path, message)


def other_buildings(count: int, total: int, split: str) -> Problem:
    message = (
        f"{count:,} of {total:,} trajectories begin in another building than the episode of "
        f"{split} with their id; other splits and tasks number theirs alike: check --split and "
        "--task, and that trajectories and instr_ids were not mixed up"
    )
    return Problem("other-scan", WHOLE_FILE, message)


def wrong_start(location: RecordLocation, instr_id: str, expected: str, found: str) -> Problem:
    remedy = "list the start viewpoint as the first pose"
    if location.place is not None:
        remedy = "list the trajectories in the order of the item's paths, each from its start"
    message = f"episode {instr_id} starts at viewpoint {expected}, got {found}; {remedy}"
    return _pose_problem("wrong-start", location, (0,), message)


def unreachable(location: RecordLocation, path: PosePath, viewpoint_id: str) -> Problem:
    message = (
        f"viewpoint {viewpoint_id} cannot be reached from the start; a jump counts at "
        "shortest-path distance, so there must be a route"
    )
    return _pose_problem("unreachable", location, path, message)
