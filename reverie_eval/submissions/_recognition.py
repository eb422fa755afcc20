"""What a file is: decided in one place, by its form and by all of its ids, before any advice.

A file is one of the task if the split has its ids, or has them once a mistake that they share is
corrected. Only a file that is not can be advised to be scored as another task's, and only if its
form or its ids are that task's alone: numbers, for one, are ids in three of the tasks, and counts
in many other files.

A mistake in ids is corrected if it explains most of the unknown ones: a prefix, another order of
the parts, instructions counted from 1.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, permutations
from typing import Any, NamedTuple, TypeAlias

from reverie_eval.errors import SHOWN_PROBLEMS, Problem, SubmissionError
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._faults import Fault, ReadingLog
from reverie_eval.submissions._fields import unwrap
from reverie_eval.submissions._predictions import Signs
from reverie_eval.submissions._problems import RecordLocation
from reverie_eval.tasks import BUILT_IN, DEFAULT_TASK, ITEM_MARK, Task, find_task

Ids: TypeAlias = Sequence[str | None]
Known: TypeAlias = Container[object]
"""Ids that the ground truth has."""
Locate: TypeAlias = Callable[[int], tuple[RecordLocation, str]]
"""Returns the record of an id, and where in it the id is."""


# Returns what an id would be without a mistake, given the ids that are known.
_Correction: TypeAlias = Callable[[str, Known], str]
# What stands between the parts of an id.
_MARK = re.compile(r"[^A-Za-z0-9]+")
_INSTRUCTION = re.compile(r"\d{1,9}$")
_VIEWPOINT = re.compile(r"(?<![0-9a-f])[0-9a-f]{32}(?![0-9a-f])")
_DIGITS = re.compile(r"\d+")
_DECIMALS = re.compile(r"(\d+)(?:\.0+(?!\d))?")
# Longer ids are not compared; Python refuses to convert thousands of digits.
_LONGEST = 60
_MOST_PARTS = 3
# Share of unknown ids that must fit a split's ids without some of their parts.
_NEARLY_ALL = 0.9

_BETWEEN_PARTS = re.compile("[_-]")
# An id that tells nothing of its task.
_NUMBER_ID = re.compile(r"[\d#]+")


@dataclass(frozen=True)
class Recognition:
    """What the ids of a file are."""

    instr_ids: Ids
    """The ids that were meant; None for those that do not tell."""
    problem: Problem | None = None
    """Why the file as a whole is not one for the split."""
    others: Sequence[int] = ()
    """The rows of records of other splits."""
    is_unresolved: bool = False
    """Whether some ids do not tell their episode, so that it is open which episodes are missing."""


def recognise_task(ids: Ids, signs: Signs, task: Task, log: ReadingLog, locate: Locate) -> None:
    """Raise one SubmissionError for a file of another task, where no ground truth is known."""
    raw = _raw(ids)
    looks_ours = 2 * sum(map(task.has_id_like, raw)) >= len(raw)
    # Numbers look like those of several tasks, so they are looked at in any case.
    is_ours = looks_ours and not all(map(_NUMBER_ID.fullmatch, raw))
    other = None if is_ours else _other_task(raw, signs, task)
    if other is not None:
        raise SubmissionError([other])
    for row in sorted(signs.numbered):
        log.add_fault(faults.NUMBERED_IDS, *locate(row), ids[row])


def recognise(
    ids: Ids, signs: Signs, ground_truth: GroundTruth, log: ReadingLog, locate: Locate
) -> Recognition:
    """Return what the ids of a file are, and note the mistakes in them in the log."""
    known = _KnownIds(ground_truth)
    corrected = _correct_instr_ids(ids, known)
    raw, task, split = _raw(ids), ground_truth.task, ground_truth.split
    # Results without answers begin alike in several tasks.
    tells_paths = signs.has_answers and task.has_targets
    is_ours = _knows(corrected.ids, known) or (tells_paths and _knows_paths(raw, ground_truth))
    # Ids of the split count for more than any sign of another task: advice to score a file of this
    # one elsewhere would lead its owner astray.
    if not (is_ours and _has_form_of(task, raw, signs)):
        other = _other_task(raw, signs, task)
        if other is not None:
            return Recognition(ids, other)
    corrected.note(ids, log, locate)
    completed = _complete(corrected.ids, known, log, locate)
    meant = [each if each is None else known.own.get(each, each) for each in completed]
    of_split = _rows_by_split(meant, known)
    unknown, there = of_split.pop(None, []), {each for each in meant if each in known.own}
    numbered = [row for row in unknown if row in signs.numbered]
    strange = [row for row in unknown if row not in signs.numbered]
    # An id became unreadable here, not before: it may be any of the episodes that seem to be
    # missing.
    is_unresolved = completed.count(None) > ids.count(None)
    if not there and strange:  # then a few are ids of another split by chance
        strange = sorted([*strange, *(row for rows in of_split.values() for row in rows)])
        of_split = {}
    if not there and not is_unresolved:
        problem = _problem_of_all(ids, of_split, strange, ground_truth, locate)
        if problem is not None:
            return Recognition(ids, problem)
    expected = len(ground_truth.episodes.index)
    names = sorted(name for name in of_split if name is not None)
    others = sorted(row for rows in of_split.values() for row in rows)
    for fault, rows in (
        (faults.records_of_other_splits(names, len(there), expected, split), others),
        (faults.NUMBERED_IDS, numbered),
        # A few are told one by one.
        (faults.unknown_episodes(split, task), strange if len(strange) > SHOWN_PROBLEMS else ()),
    ):
        for row in rows:
            log.add_fault(fault, *locate(row), ids[row])
            # Reported once for all; left in, each of them would be an unknown episode once more.
            meant[row] = None
    is_unresolved |= bool(raw) and not there
    return Recognition(meant, None, others, is_unresolved)


def _rows_by_split(ids: Ids, known: "_KnownIds") -> dict[str | None, list[int]]:
    """Group the rows of ids that the split does not have by the split that has them, if any."""
    rows: defaultdict[str | None, list[int]] = defaultdict(list)
    for row, each in enumerate(ids):
        if each is not None and each not in known.own:
            rows[known.split_of.get(each)].append(row)
    return dict(rows)


class _KnownIds:
    """The ids of all episodes that the ground truth knows of."""

    def __init__(self, ground_truth: GroundTruth) -> None:
        episodes = ground_truth.episodes
        self.ground_truth = ground_truth
        short = episodes.by_short_id if ground_truth.task.has_short_ids else {}
        full = {each: each for each in episodes.index}
        self.own: Mapping[Any, str] = {**short, **full}
        """The episodes of the split by their ids."""
        self.split_of: Mapping[Any, str] = {
            each: split
            for split, instr_ids in ground_truth.other_splits.items()
            for each in instr_ids.tolist()
            if each not in self.own
        }
        """The other splits of the dataset by the ids of their episodes."""

    def __contains__(self, instr_id: object) -> bool:
        return instr_id in self.own or instr_id in self.split_of


def _problem_of_all(
    ids: Ids,
    of_split: Mapping[str | None, Sequence[int]],
    unknown: Sequence[int],
    ground_truth: GroundTruth,
    locate: Locate,
) -> Problem | None:
    """Return the one problem of a file without any episode of the split."""
    if of_split:
        counts = {str(other): len(rows) for other, rows in of_split.items()}
        row = min(rows[0] for rows in of_split.values())
        return problems.results_of_other_splits(
            counts, ground_truth.split, locate(row)[0], str(ids[row])
        )
    if unknown and ground_truth.is_demo and not _knows_paths(_raw(ids), ground_truth):
        first = str(ids[unknown[0]])
        return outside_demo(
            problems.IDS_OUTSIDE_DEMO, ground_truth, count=len(unknown), first=first
        )
    return None


def outside_demo(
    template: problems.Template, ground_truth: GroundTruth, **found: object
) -> Problem:
    """Return a problem that says how to score the task itself instead of the demo world."""
    task = ground_truth.task
    option = "" if task.name == DEFAULT_TASK else f"--task {task.name} "
    return template.of_file(split=ground_truth.split, task=task, option=option, **found)


def _raw(ids: Ids) -> Sequence[str]:
    """Return ids as the records have them: those of an item's trajectories have its own."""
    return [each.partition(ITEM_MARK)[0] for each in ids if each is not None]


def _knows(ids: Ids, known: _KnownIds) -> bool:
    """Whether most ids are known; a few may be by chance."""
    given = [each for each in ids if each is not None]
    return 2 * sum(each in known for each in given) >= len(given)


def _knows_paths(raw: Sequence[str], ground_truth: GroundTruth) -> bool:
    """Whether nearly all ids begin with a path of the split, though they may end otherwise."""
    paths, given = (
        [parts[0] for parts in map(_BETWEEN_PARTS.split, ids) if len(parts) > 1]
        for ids in (ground_truth.episodes.index, raw)
    )
    return sum(map(set(paths).__contains__, given)) > _NEARLY_ALL * len(raw)


def _has_form_of(task: Task, raw: Sequence[str], signs: Signs) -> bool:
    """Whether the form of a file is that of a task; ids that are not mere numbers tell more."""
    if not all(map(_NUMBER_ID.fullmatch, raw)):
        return True
    return signs.has_items == task.has_items or (signs.has_items and not signs.has_points)


def _other_task(raw: Sequence[str], signs: Signs, task: Task) -> Problem | None:
    """Return the problem of a file that is another task's, by its form or by all of its ids."""
    others = [find_task(name) for name in BUILT_IN if name != task.name]
    are_numbers = all(map(_NUMBER_ID.fullmatch, raw))
    looks_ours = bool(raw) and all(map(task.has_id_like, raw)) and not are_numbers
    for other in others if raw else ():
        if signs.has_items and other.has_items and not (task.has_items or looks_ours):
            sign = "their trajectories are objects with a path"
            return problems.RESULTS_OF_ANOTHER_TASK.of_file(task=task, other=other, sign=sign)
        if are_numbers and signs.id_key in set(other.id_field.names) - set(task.id_field.names):
            sign = f"their ids are in {signs.id_key!r}"
            return problems.RESULTS_OF_ANOTHER_TASK.of_file(task=task, other=other, sign=sign)
    found = [
        other
        for other in _tasks_with_such_ids(raw, task)
        if signs.has_items == other.has_items
        and (other.has_targets or not signs.has_answers)
        and (signs.id_key in other.id_field.names or signs.id_key not in task.id_field.names)
    ]
    return problems.ids_of_another_task(len(raw), raw[0], task, found) if found else None


def _tasks_with_such_ids(raw: Sequence[str], task: Task) -> Sequence[Task]:
    """Return the tasks whose ids look most like all of these; none if this task's do."""
    if all(map(_NUMBER_ID.fullmatch, raw)):
        return []
    known = [task, *(find_task(name) for name in BUILT_IN if name != task.name)]
    alike = [each for each in known if all(map(each.has_id_like, raw))]
    # Of two tasks, the ids of one may all look like the other's: RxR's as R2R's, but not R2R's as
    # RxR's. The narrower form says more.
    narrow = [each for each in alike if not any(_is_wider(each, other) for other in alike)]
    # An id that looks ours is no reason to advise another task, whatever else it looks like.
    return [] if task in narrow else narrow


def _is_wider(task: Task, other: Task) -> bool:
    return task.has_id_like(other.id_example) and not other.has_id_like(task.id_example)


# Ids without some of their parts.


def _complete(ids: Ids, known: _KnownIds, log: ReadingLog, locate: Locate) -> list[str | None]:
    """Return ids with the parts that they lack, or None where several episodes fit."""
    completed = list(ids)
    foreign = [row for row, each in enumerate(ids) if each is not None and each not in known.own]
    unknown = [row for row in foreign if ids[row] not in known]
    # Without its object, an id of a path may be one of another split by chance.
    for rows in (foreign, unknown) if unknown else ():
        found = _find_parts({row: str(ids[row]) for row in rows}, known.ground_truth)
        if found is None:
            continue
        lacking, fitting = found
        count = Counter(each for fits in fitting.values() for each in fits)
        several = [row for row, fits in fitting.items() if len(fits) > 1 or count[fits[0]] > 1]
        reason = ""
        if several:
            fit = (
                "1 of these ids fits" if len(several) == 1 else f"{len(several):,} of these ids fit"
            )
            reason = f"{fit} several episodes, so the file does not tell which is meant"
        fault = faults.incomplete_ids(lacking, _form_of_ids(known.ground_truth), reason)
        for row, fits in fitting.items():
            log.add_fault(fault, *locate(row), ids[row])
            completed[row] = None if several else fits[0]
        break
    return completed


def _find_parts(
    given: Mapping[int, str], ground_truth: GroundTruth
) -> tuple[Sequence[str], Mapping[int, Sequence[str]]] | None:
    """Return the names of the parts that nearly all ids lack, and the episodes that each fits."""
    full = {each: _BETWEEN_PARTS.split(each) for each in ground_truth.episodes.index}
    names = _names_of_parts(ground_truth)
    # In the order of the combinations: the parts that people leave out most often come first, and
    # later ones must explain more.
    best, most = None, _NEARLY_ALL * len(given)
    for lacking in _combinations(len(names)):
        by_rest: defaultdict[str, list[str]] = defaultdict(list)
        for instr_id, parts in full.items():
            rest = [part for index, part in enumerate(parts) if index not in lacking]
            by_rest["_".join(rest) if lacking else "".join(rest)].append(instr_id)
        fitting = {
            row: by_rest[key]
            for row, each in given.items()
            if (key := _BETWEEN_PARTS.sub("_", each)) in by_rest
        }
        if len(fitting) > most or (best is None and len(fitting) >= most):
            best, most = ([names[index] for index in lacking], fitting), len(fitting)
    return best


def _combinations(number: int) -> Iterator[Sequence[int]]:
    """Yield the indexes of parts that may be left out, the last part first; none are the marks."""
    if number > 1:
        yield ()
    for count in range(1, number):
        yield from sorted(combinations(range(number), count), reverse=True)


def _names_of_parts(ground_truth: GroundTruth) -> Sequence[str]:
    """Return the names of the parts of a split's ids; REVERIE's of test have a part less."""
    counts = {len(_BETWEEN_PARTS.split(each)) for each in ground_truth.episodes.index}
    names = ground_truth.task.id_parts
    if counts == {len(names)}:
        return names
    return ("item id", names[-1]) if counts == {2} and names else ()


def _form_of_ids(ground_truth: GroundTruth) -> str:
    return "_".join(f"<{name}>" for name in _names_of_parts(ground_truth))


class Corrected(NamedTuple):
    """Ids without the mistake that unknown ones have in common."""

    ids: Ids
    fault: Fault | None = None
    """None if no mistake explains at least half of the unknown ids."""

    def note(self, given: Ids, log: ReadingLog, locate: Locate) -> None:
        """Note the mistake of each id that was corrected."""
        if self.fault is not None:
            for row, (each, meant) in enumerate(zip(given, self.ids, strict=True)):
                if each != meant:
                    log.add_fault(self.fault, *locate(row), each)


def _stripped(instr_id: str, _: Known) -> str:
    item, mark, start = instr_id.partition(ITEM_MARK)
    return f"{item.strip()}{mark}{start}"


def _unprinted(instr_id: str, __: Known) -> str:
    item, mark, start = instr_id.partition(ITEM_MARK)
    meant, _ = unwrap(item)
    text = int(meant) if isinstance(meant, float) and meant.is_integer() else meant
    return f"{text}{mark}{start}"


def _without_prefix(instr_id: str, known: Known) -> str:
    """Return an id without what is before a known one: NaviLLM's ``cvdn_0_1196`` is 1196 [1]_.

    References
    ----------
    .. [1] zd11024/NaviLLM a221f42, tasks/datasets/cvdn.py, load_data
    """
    # From the left: the longest known ending is the id.
    ends = (instr_id[mark.end() :] for mark in _MARK.finditer(instr_id))
    return next((end for end in ends if end in known), instr_id)


def _without_suffix(instr_id: str, known: Known) -> str:
    item, mark, start = instr_id.partition(ITEM_MARK)
    ends = [found.start() for found in _MARK.finditer(item)]
    # From the right: the longest known beginning is the id.
    cut = (f"{item[:end]}{mark}{start}" for end in reversed(ends))
    return next((each for each in cut if each in known), instr_id)


def _rewritten(instr_id: str, known: Known) -> str:
    """Return an id by its numbers: ``4774-267-1``, ``(4774, 267, 1)`` and ``4774_0267.0_1``."""
    item, mark, start = instr_id.partition(ITEM_MARK)
    for pattern in (_DIGITS, _DECIMALS) if len(item) <= _LONGEST else ():
        rewritten = "_".join(str(int(number)) for number in pattern.findall(item))
        if f"{rewritten}{mark}{start}" in known:
            return f"{rewritten}{mark}{start}"
    return instr_id


def _reordered(order: Sequence[int], instr_id: str, _: Known) -> str:
    parts = instr_id.split("_")
    return "_".join(map(parts.__getitem__, order)) if len(parts) == len(order) else instr_id


def _counted_from_zero(instr_id: str, _: Known) -> str:
    return _INSTRUCTION.sub(lambda index: str(int(index[0]) - 1), instr_id)


def _without_scan(viewpoint_id: str, _: Known) -> str:
    return viewpoint_id.rpartition("_")[2]


def _bare_viewpoint(viewpoint_id: str, _: Known) -> str:
    """Return the one viewpoint id in a text such as ``4BC2...AB71`` or ``4bc2...ab71_12.jpg``."""
    found = _VIEWPOINT.findall(viewpoint_id.lower())
    return found[0] if len(found) == 1 else viewpoint_id


_INSTR_ID_CAUSES: Sequence[tuple[Fault, _Correction]] = (
    (faults.PADDED_IDS, _stripped),
    (faults.PRINTED_IDS, _unprinted),
    (faults.PREFIXED_IDS, _without_prefix),
    (faults.IDS_FROM_ONE, _counted_from_zero),
    *(
        (faults.REORDERED_IDS, partial(_reordered, order))
        for count in range(2, _MOST_PARTS + 1)
        for order in list(permutations(range(count)))[1:]
    ),
    (faults.SUFFIXED_IDS, _without_suffix),
    (faults.REWRITTEN_IDS, _rewritten),
)
_VIEWPOINT_CAUSES: Sequence[tuple[Fault, _Correction]] = (
    (faults.PADDED_VIEWPOINTS, _stripped),
    (faults.PRINTED_VIEWPOINTS, _unprinted),
    (faults.VIEWPOINTS_WITH_SCANS, _without_scan),
    (faults.SURROUNDED_VIEWPOINTS, _bare_viewpoint),
)


def is_viewpoint_id(text: str | None) -> bool:
    """Whether a text has the form of Matterport3D's viewpoint ids."""
    return text is not None and _VIEWPOINT.fullmatch(text) is not None


def _correct_instr_ids(ids: Ids, known: Known) -> Corrected:
    """Return ids without the mistake that unknown ones have in common, if there is one.

    Different ids stay different: where they do not, the mistake is another one.
    """
    return _correct(ids, known, _INSTR_ID_CAUSES, count=len(set(ids)))


def fix_viewpoint_ids(ids: Ids, ground_truth: GroundTruth, log: ReadingLog, locate: Locate) -> Ids:
    """Return viewpoint ids without the mistake that unknown ones have in common, and note it."""
    corrected = _correct(ids, ground_truth.graph.index, _VIEWPOINT_CAUSES)
    corrected.note(ids, log, locate)
    return corrected.ids


def _correct(
    ids: Ids, known: Known, causes: Sequence[tuple[Fault, _Correction]], count: int = 0
) -> Corrected:
    """Return ids without the first mistake that explains them, of which so many stay different."""
    unknown = _count_unknown(ids, known)
    for fault, correct in causes if unknown else ():
        # In a file whose instructions are counted from 1, most ids are known: of other episodes.
        is_right = known if fault is not faults.IDS_FROM_ONE else ()
        fixed = [each if each is None or each in is_right else correct(each, known) for each in ids]
        # At least half must be explained: a cause that helps a few ids is a coincidence. If
        # different ids became equal, predictions of different episodes would be taken for one.
        if 2 * _count_unknown(fixed, known) <= unknown and len(set(fixed)) >= count:
            return Corrected(fixed, fault)
    return Corrected(ids)


def _count_unknown(ids: Ids, known: Known) -> int:
    """Return how many ids are not known."""
    return sum(each is not None and each not in known for each in ids)
