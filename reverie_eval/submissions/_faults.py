"""Mistakes and differences that many records of a file share, and the log that counts them.

A mistake with one cause is reported once, however many records have it. A difference from the
official form that does not change the meaning is read, and mentioned.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from sys import maxsize
from types import MappingProxyType

from reverie_eval.errors import SHOWN_PROBLEMS, Problem
from reverie_eval.geometry import FAR_OFF
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._problems import (
    POSE_FORM,
    WHOLE_FILE,
    RecordLocation,
    show,
)
from reverie_eval.tasks import Task
from reverie_eval.text import count_text

_CONVERT = "reverie-eval convert"
_CONVERT_FOR_SPLIT = "reverie-eval convert --split"


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
        return self.what.format(example=show(example))


_not_json = partial(Fault, "not-json")
_not_a_list = partial(Fault, "not-a-list")
_wrong_type = partial(Fault, "wrong-type")
_wrong_id = partial(Fault, "unknown-episode", convert=_CONVERT_FOR_SPLIT)
_wrong_viewpoint = partial(Fault, "unknown-viewpoint", convert=_CONVERT_FOR_SPLIT)

SEVERAL_LISTS = _not_json("several lists one after another", "write one list")
ENCODED_TWICE = _not_json(
    "the JSON inside a string: it was encoded twice", "use json.dump alone, without json.dumps"
)
ENCODED_RECORDS = _not_json(
    "records within texts, such as {example}",
    "write the list by one json.dump, without json.dumps of each record",
)
NO_BRACKETS = _not_json(
    "records without the brackets of a list", "put [ before the first and ] after the last"
)
TRAILING_TEXT = _not_json("text after the JSON: {example}", "remove it")
PYTHON_LITERAL = _not_json("a list printed by Python instead of JSON", "write it with json.dump")
WRAPPED = _not_a_list("the records under the key {example}", "write only the list of records")
WRAPPED_LISTS = _not_a_list(
    "lists of records under several keys, such as {example}",
    "write only the list of records of one split",
    _CONVERT_FOR_SPLIT,
)
NESTED_LISTS = _not_a_list("lists of records inside the list", "write one flat list of records")
TABLE = _not_a_list(
    "a table of columns instead of records",
    'write a list of records (pandas: to_json(orient="records"))',
)
KEYED_BY_ROW = _not_a_list(
    "records keyed by row numbers, such as {example}",
    'write a list of records (pandas: to_json(orient="records"))',
)
DECIMAL_IDS = _wrong_type(
    "an object id written as a decimal, such as {example}", "write whole numbers"
)
DECIMAL_NUMBERS = _wrong_type(
    "the number of an episode written as a decimal, such as {example}", "write whole numbers"
)
DISAGREEING_ANSWERS = Fault(
    "two-answers",
    "different answers under two keys, such as {example}",
    "keep one of the keys",
    convert="",
)
NO_OBJECTS = _wrong_type("{example} for no object", "write -1 where the agent predicts no object")
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
POSES_AS_OBJECTS = _wrong_type(
    "poses written as objects, such as {example}", f"write lists {POSE_FORM}"
)
ANGLES_AS_TEXT = _wrong_type("angles written as text, such as {example}", "write numbers")
NULL_ANGLES = _wrong_type(
    "null for heading and elevation, such as {example}", "write numbers, or [viewpoint_id] alone"
)
NUMBERS_AS_TEXT = _wrong_type("numbers written as text, such as {example}", "write numbers")
PRINTED_VALUES = _wrong_type(
    "a tensor, an array or a list printed as text, such as {example}",
    "write its value, by .item() or .tolist()",
)
LISTED_VALUES = _wrong_type("a value in a list of one, such as {example}", "write the value alone")
ARRAYS_OF_ONE = _wrong_type(
    "a tensor or an array instead of its value, such as {example}", "use .item()", convert=""
)
PADDED_VALUES = _wrong_type("spaces or a line end around a value, such as {example}", "remove them")
NUMBERED_IDS = _wrong_type(
    "a number for the id, such as {example}", "write the episode's id as text", convert=""
)
ITEMS_FOR_PATHS = _wrong_type(
    "a trajectory that is an object with a path, as in SOON, such as {example}",
    "write the path itself, a list of poses",
)
SEVERAL_PATHS = _wrong_type(
    "several trajectories, such as {example}",
    "write one list of poses for each episode",
    convert="",
)
PATHS_FOR_ITEMS = _wrong_type(
    "a trajectory that is a list of poses, such as {example}",
    "write a list of objects with path, obj_heading and obj_elevation, one for each start of the "
    "item",
    convert="",
)
FLAT_ITEMS = _wrong_type(
    "a trajectory beside its point, such as {example}",
    "write a list of objects, each with its path and its point",
)
NUMBERED_VIEWPOINTS = _wrong_type(
    "viewpoints given as numbers, such as {example}",
    "write the viewpoint ids of the connectivity files, not their positions in them",
    convert="",
)
PADDED_IDS = _wrong_id("spaces or a line end around the id, such as {example}", "remove them")
PRINTED_IDS = _wrong_id(
    "an id printed as a tensor, an array or a list, such as {example}", "write the id alone"
)
PREFIXED_IDS = _wrong_id("a prefix before the id, such as {example}", "remove it")
SUFFIXED_IDS = _wrong_id("something after the id, such as {example}", "remove it")
REWRITTEN_IDS = _wrong_id(
    "an id that is written otherwise, such as {example}",
    "write its numbers plainly, with underscores between them",
)
REORDERED_IDS = _wrong_id(
    "the parts of the id in another order, such as {example}",
    "write them in the order of the annotations' ids",
)
IDS_FROM_ONE = _wrong_id("instructions numbered from 1, such as {example}", "number them from 0")
PADDED_VIEWPOINTS = _wrong_viewpoint(
    "spaces or a line end around viewpoint ids, such as {example}", "remove them"
)
PRINTED_VIEWPOINTS = _wrong_viewpoint(
    "viewpoint ids printed as arrays or lists, such as {example}", "write the viewpoint ids alone"
)
SURROUNDED_VIEWPOINTS = _wrong_viewpoint(
    "viewpoint ids in capitals or with something beside them, such as {example}",
    "write the viewpoint ids alone",
)
VIEWPOINTS_WITH_SCANS = _wrong_viewpoint(
    "the scan before viewpoint ids, such as {example}", "write the viewpoint ids alone"
)
REPEATED_RECORDS = Fault(
    "duplicate-episode",
    "the same trajectory and answer as an earlier record, such as {example}",
    "remove the repeats",
)


def misspelt(field: str, meant: str) -> Fault:
    """Return the fault of records that have a field under another name; one for each name."""
    what = f"the field {show(field).replace('{', '{{').replace('}', '}}')}, which is not read"
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


MAX_PROBLEMS = 10_000
"""Checking stops after this many problems; fixing these nearly always fixes the rest."""
# The numbers of records and poses in the location of a problem, and the keys of records.
_ANY_INDEX = re.compile(r"""^\["[^"]*"\]|\[\d+\]""")
# The codes of problems with one field of one record.
_OF_FIELDS = (
    *("wrong-type", "missing-field", "not-finite", "empty-trajectory", "empty-box", "wrong-view"),
    *("two-answers", "wrong-camera", "unknown-viewpoint", "other-scan", "wrong-start"),
    *("unreachable", "duplicate-episode"),
)


def limit_problems(given: Iterable[Problem]) -> Sequence[Problem]:
    """Return all problems, or the first of them and one that says that there are more.

    A mistake that more records share than fit a screen is one problem.
    """
    first = list(islice(given, MAX_PROBLEMS + 1))
    if len(first) <= MAX_PROBLEMS:
        return _join_alike(first)
    # Problems are sorted by position: the largest possible one comes last.
    last = replace(problems.TOO_MANY_PROBLEMS.of_file(limit=MAX_PROBLEMS), position=(maxsize,))
    return [*_join_alike(first[:-1]), last]


def _join_alike(given: Iterable[Problem]) -> Sequence[Problem]:
    """Return problems with one for each field that many records have wrong in the same way.

    Where values differ, so do the messages, though the mistake is one.
    """
    alike: dict[tuple[str, str], list[Problem]] = {}
    for problem in given:
        field = _ANY_INDEX.sub("", problem.where)
        # Of a whole record, the message tells which mistake it is, unless it shows the record.
        if not field and problem.code != "wrong-type":
            field = problem.message
        alike.setdefault((problem.code, field), []).append(problem)
    return [each for found in alike.values() for each in _joined(found)]


def _joined(found: Sequence[Problem]) -> Sequence[Problem]:
    if len(found) <= SHOWN_PROBLEMS or found[0].code not in _OF_FIELDS:
        return found
    first = min(found, key=lambda problem: problem.position)
    return [replace(first, message=f"{first.message} ({len(found) - 1:,} more like it)")]


DIFFERENCES: Mapping[str, str] = MappingProxyType(
    {
        "keyed": "{:,} records keyed by their id",
        "prefixed": '{:,} instr_ids with the prefix "reverie_"',
        "hops": "{:,} trajectories of nested hops",
        "long hops": "{:,} hops with more than one viewpoint, every viewpoint counted",
        "bare viewpoints": "{:,} poses that are bare viewpoint ids",
        "no angles": "{:,} poses without heading and elevation",
        "extra numbers": "{:,} poses with extra numbers after heading and elevation, ignored",
        "other key": "{:,} answers under a key other than predObjId",
        "text ids": "{:,} object ids written as text",
        "leading zeros": "{:,} of these with leading zeros, which no published evaluator counts "
        "as correct",
        "abstentions": "{:,} answers that predict no object, not written as -1",
        "null predObjId": "{:,} records with null under predObjId, beside an answer",
        "null pred_objid": "{:,} records with null under pred_objid, beside an answer",
        "null pred_obj_id": "{:,} records with null under pred_obj_id, beside an answer",
        "navigation only": "{:,} records, none with an answer: navigation only",
        "scaled boxes": "{:,} boxes scaled from another image size to 640 x 480",
        "upright images": "{:,} of these from images taller than wide; predImageSize is [width, "
        "height]",
        "cut boxes": "{:,} boxes that reach beyond the image, cut to it",
        "boxes outside": "{:,} boxes entirely outside the image, which match nothing",
        "cameras off the grid": "{:,} boxes from cameras that are not one of the 36 views, warped "
        "to the nearest view",
        "far cameras": f"{{:,}} of these warped by more than {FAR_OFF:g} degrees, where exact "
        "boxes fail more often",
        "single trajectories": "{:,} records with a single trajectory instead of a list",
        "listed angles": "{:,} angles in lists of one",
        "no point": "{:,} trajectories without a point",
    }
)
"""How a file may differ from the official form without changing its meaning, in the order in which
differences are listed; each text is formatted with its count."""


@dataclass(slots=True)
class _Occurrences:
    """Where a mistake that many records share is."""

    where: str
    row: int
    example: object
    rows: set[int] = field(default_factory=set)

    @property
    def count(self) -> int:
        """How many records have it."""
        return max(len(self.rows), 1)


@dataclass(frozen=True, slots=True)
class ReadingLog:
    """What is noted while a submission is read."""

    problems: list[Problem] = field(default_factory=list)
    """Problems of single records."""
    differences: Counter[str] = field(default_factory=Counter)
    """How often each key of ``DIFFERENCES`` occurs; also "empty hops", which are not listed."""
    ignored_fields: Counter[str] = field(default_factory=Counter)
    """How many records have each of the fields that are not read."""
    _faults: dict[Fault, _Occurrences] = field(default_factory=dict)

    def add_wrong_type(
        self, location: RecordLocation, field: str, found: object, expected: str
    ) -> None:
        """Note that a record, or the field with this name, is not what was expected."""
        where = f".{field}" if field else ""
        problem = problems.WRONG_TYPE.of_record(location, where, found=found, expected=expected)
        self.problems.append(problem)

    def add_fault(
        self, fault: Fault, location: RecordLocation, field: str, example: object
    ) -> None:
        """Note that a record has a mistake which others may share; only the first is shown."""
        occurrences = self._faults.get(fault)
        if occurrences is None:
            occurrences = _Occurrences(location.at(field), location.row, example)
            self._faults[fault] = occurrences
        occurrences.rows.add(location.row)

    def add_whole_file_fault(self, fault: Fault, example: object) -> None:
        """Note a mistake that the file as a whole has."""
        self._faults[fault] = _Occurrences(WHOLE_FILE, -1, example)

    def all_problems(self) -> Sequence[Problem]:
        """Return the problems of single records, and one for each mistake that records share."""
        faults = [
            fault.problem(found.count, found.where, (found.row,), found.example)
            for fault, found in self._faults.items()
        ]
        return [*self.problems, *faults]

    @property
    def unknown_fields(self) -> int:
        """An upper bound of how many fields were found that the official form does not have."""
        return len(self.ignored_fields) + len(self._faults)

    @property
    def has_unfixable(self) -> bool:
        """Whether some mistake does not have a clear meaning."""
        return bool(self.problems) or not all(fault.convert for fault in self._faults)

    def fixed(self) -> Sequence[str]:
        """Return the mistakes whose meaning is clear, a phrase each."""
        return [
            fault.fixed(found.count, found.where, found.example)
            for fault, found in self._faults.items()
            if fault.convert
        ]

    def read_as(self) -> Sequence[str]:
        """Return the differences from the official form, a phrase each."""
        return [
            text.format(self.differences[key])
            for key, text in DIFFERENCES.items()
            if self.differences[key]
        ]
