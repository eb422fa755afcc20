"""Look through all published files of a dataset, and say what is in them and what is wrong."""

from collections.abc import Sequence

from reverie_eval.ground_truth.dataset import DatasetFiles, Track, untracked
from reverie_eval.linting.annotations import Split, read_splits
from reverie_eval.linting.box_form_checks import box_form_counts
from reverie_eval.linting.box_size_checks import box_size_counts, box_size_spreads
from reverie_eval.linting.boxes import Boxes, read_boxes
from reverie_eval.linting.distance_checks import (
    Centres,
    distance_counts,
    distance_spreads,
    read_centres,
)
from reverie_eval.linting.graph_checks import graph_counts, graph_spreads
from reverie_eval.linting.graphs import Graphs, read_graphs
from reverie_eval.linting.reader import Reader
from reverie_eval.linting.rows import Count, Spread
from reverie_eval.linting.target_checks import target_counts, target_spreads, targets_of
from reverie_eval.linting.task_checks import task_counts
from reverie_eval.linting.view_checks import view_counts, view_spreads
from reverie_eval.linting.visibility_checks import visibility_counts, visibility_spreads
from reverie_eval.schemas.lint import CountReport, LintReport, LintSection, SpreadReport
from reverie_eval.version import __version__

_NO_CENTRES = "left out: the centres of the objects are not given (--object-positions objpos.json)"
_NO_ANSWERS = "targets left out: the tasks name none, as in the published test file"


def lint_dataset(files: DatasetFiles, *, track: Track = untracked) -> LintReport:
    """Count what is in the published files: all splits, all scans, used by a task or not.

    Parameters
    ----------
    files : DatasetFiles
        Where the files are. Annotations of other splits next to the named ones are read too.
    track : callable, optional
        Shows progress; called with the files about to be read and a description.

    Returns
    -------
    LintReport
        Facts, remarks and faults by section. ``sound`` if there is no fault.
    """
    reader = Reader(track)
    graphs = read_graphs(reader, files.connectivity)
    splits = read_splits(reader, files.all_annotations(), graphs)
    boxes = read_boxes(reader, files.boxes)
    centres = read_centres(reader, files.object_positions) if files.object_positions else None
    sections = [
        _section("files", reader.counts()),
        _section("navigation graphs", graph_counts(graphs), graph_spreads(graphs)),
        _section("boxes", box_form_counts(boxes, graphs)),
        _section("visibility", visibility_counts(boxes), visibility_spreads(boxes)),
        _section("box sizes", box_size_counts(boxes), box_size_spreads(boxes)),
        _section("neighbouring views", view_counts(boxes), view_spreads(boxes)),
        *(_annotations(split, splits, boxes) for split in splits),
        _distances(boxes, graphs, centres, splits),
    ]
    counts = [count for section in sections for count in section.counts]
    is_sound = not any(count.kind == "fault" and count.found.number for count in counts)
    return LintReport(version=__version__, sound=is_sound, sections=sections)


def _annotations(split: Split, splits: Sequence[Split], boxes: Boxes) -> LintSection:
    elsewhere = {other.name: other.episodes for other in splits if other is not split}
    tasks = task_counts(split, elsewhere)
    if not split.has_answers:
        return _section("annotations", tasks, split=split.name, note=_NO_ANSWERS)
    targets = targets_of(split, boxes)
    counts = [*tasks, *target_counts(split, targets)]
    return _section("annotations", counts, target_spreads(targets), split=split.name)


def _distances(
    boxes: Boxes, graphs: Graphs, centres: Centres | None, splits: Sequence[Split]
) -> LintSection:
    if centres is None:
        return _section("distances", note=_NO_CENTRES)
    counts = distance_counts(boxes, graphs, centres)
    return _section("distances", counts, distance_spreads(boxes, graphs, centres, splits))


def _section(
    title: str,
    counts: Sequence[Count] = (),
    spreads: Sequence[Spread] = (),
    *,
    split: str | None = None,
    note: str = "",
) -> LintSection:
    return LintSection(
        title=title,
        split=split,
        counts=[CountReport.model_validate(count) for count in counts],
        spreads=[SpreadReport.model_validate(spread) for spread in spreads],
        note=note,
    )
