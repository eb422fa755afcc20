"""Check a dataset's published files against all rules, or only against those that are errors."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from os.path import commonpath
from pathlib import Path
from typing import ClassVar, Literal

from pydantic import ConfigDict

from reverie_eval.dataset import _agreement_rules as agreement
from reverie_eval.dataset._boxes import (
    BOX_RULES,
    SIZE_RULES,
    VISIBILITY_RULES,
    Boxes,
    size_spreads,
    visibility_spreads,
)
from reverie_eval.dataset._dataset import (
    ITEM_RULES,
    TARGET_RULES,
    Centres,
    Dataset,
    DatasetFiles,
    Items,
    Split,
    Targets,
    read_dataset,
    target_spreads,
)
from reverie_eval.dataset._graphs import GRAPH_RULES, graph_spreads
from reverie_eval.dataset._reader import FILE_RULES, Reader
from reverie_eval.dataset._rules import Finding, Purpose, Rule, S, Spread, find_problems
from reverie_eval.errors import DatasetError, Problem
from reverie_eval.processes import Progress, no_progress
from reverie_eval.tasks import Task
from reverie_eval.version import __version__

_BOX_SECTIONS: Sequence[tuple[str, Sequence[Rule[Boxes]], Callable[[Boxes], list[Spread]]]] = (
    ("boxes", BOX_RULES, lambda _: []),
    ("visibility", VISIBILITY_RULES, visibility_spreads),
    ("box sizes", SIZE_RULES, size_spreads),
    ("neighbouring views", agreement.VIEW_RULES, agreement.view_spreads),
)
_NO_CENTRES = "left out: give the centres of the objects with --object-positions objpos.json"
_NO_SOLUTION = "targets left out: the items have no solution, as in the published test file"


@dataclass(frozen=True, slots=True)
class LintSection:
    """What was found in one kind of file."""

    title: str
    split: str | None = None
    """The split that the section is about."""
    counts: Sequence[Finding] = ()
    spreads: Sequence[Spread] = ()
    note: str = ""
    """What was left out, and why."""


@dataclass(frozen=True, slots=True)
class LintReport:
    """What a dataset's published files contain, and what is wrong with them."""

    __pydantic_config__: ClassVar = ConfigDict(use_attribute_docstrings=True, extra="forbid")

    version: str
    """Version of reverie-eval that checked the files."""
    sound: bool
    """Whether no rule found an error."""
    sections: Sequence[LintSection]
    schema_version: Literal[1] = 1


def lint_dataset(files: DatasetFiles, *, progress: Progress = no_progress) -> LintReport:
    """Check all published files: all splits and all scans, with or without items.

    Parameters
    ----------
    files : DatasetFiles
        Where the files are.
    progress : callable, optional
        Shows progress; called with the files about to be read, a description and their number.

    Returns
    -------
    LintReport
        Information, warnings and errors by section; ``sound`` if there are no errors.
    """
    dataset = read_dataset(files, progress)
    # By name: a report must not depend on the order of a folder.
    splits = sorted(dataset.splits, key=lambda split: split.name)
    items = [Items(split, dataset.graphs, _other_splits(split, splits)) for split in splits]
    boxes = dataset.boxes
    # A section without anything to count would look like one that passed.
    box_sections = _BOX_SECTIONS if files.boxes else ()
    sections = [
        _section("files", FILE_RULES, dataset.reader),
        _section("navigation graphs", GRAPH_RULES, dataset.graphs, graph_spreads(dataset.graphs)),
        *(_section(title, rules, boxes, of(boxes)) for title, rules, of in box_sections),
        *(_annotations(each, boxes, files.task) for each in items),
        *([_distances(boxes, dataset.centres, items)] if files.boxes else []),
    ]
    findings = [finding for section in sections for finding in section.counts]
    is_sound = not any(each.severity == "error" and each.found.number for each in findings)
    return LintReport(__version__, is_sound, sections)


def check_sound(dataset: Dataset, purpose: Purpose) -> None:
    """Raise DatasetError with the errors for a purpose that :func:`lint_dataset` finds too."""
    files, graphs, boxes = dataset.files, dataset.graphs, dataset.boxes
    found = [
        *file_problems(dataset.reader, purpose),
        *find_problems(GRAPH_RULES, graphs, files.connectivity, purpose),
    ]
    # Boxes are used with the solution alone.
    if dataset.has_solution and files.boxes:
        for _, rules, _ in _BOX_SECTIONS:
            found += find_problems(rules, boxes, files.boxes, purpose)
    for split in dataset.splits:
        # Without other splits: episodes that two of them share are for lint to find.
        items = Items(split, graphs)
        found += find_problems(ITEM_RULES, items, split.path, purpose)
        if split.has_solution and files.boxes:
            targets = Targets(split, items.with_target, boxes)
            found += find_problems(TARGET_RULES, targets, split.path, purpose)
    if found:
        raise DatasetError(found)


def file_problems(reader: Reader, purpose: Purpose) -> Iterator[Problem]:
    """Find the files that cannot be read, or that repeat keys."""
    paths = [path for path, _ in reader.unreadable]
    return find_problems(FILE_RULES, reader, Path(commonpath(paths) if paths else ""), purpose)


def _other_splits(split: Split, splits: Sequence[Split]) -> Mapping[str, str]:
    """Return the split of each episode that is not in this split."""
    return {
        instr_id: other.name
        for other in splits
        if other is not split
        for instr_id in other.instr_ids
    }


def _annotations(items: Items, boxes: Boxes, task: Task) -> LintSection:
    split = items.split
    counts = [rule.check(items) for rule in ITEM_RULES]
    if not task.has_targets:
        return LintSection("annotations", split.name, counts)
    # The published test file is sound without one.
    if not split.has_solution:
        return LintSection("annotations", split.name, counts, note=_NO_SOLUTION)
    targets = Targets(split, items.with_target, boxes)
    counts += [rule.check(targets) for rule in TARGET_RULES]
    return LintSection("annotations", split.name, counts, target_spreads(targets))


def _distances(boxes: Boxes, centres: Centres | None, items: Sequence[Items]) -> LintSection:
    if centres is None:
        return LintSection("distances", note=_NO_CENTRES)
    with_target = [item for each in items for item in each.with_target]
    distances = agreement.Distances(boxes, centres, with_target)
    return _section(
        "distances", agreement.DISTANCE_RULES, distances, agreement.distance_spreads(distances)
    )


def _section(
    title: str, rules: Sequence[Rule[S]], subject: S, spreads: Sequence[Spread] = ()
) -> LintSection:
    counts = [rule.check(subject) for rule in rules]
    return LintSection(title, counts=counts, spreads=spreads)
