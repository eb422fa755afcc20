"""Checking the published files: every error and warning, each in a dataset without another one."""

import json
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import TypeVar

import pytest

from reverie_eval import DatasetError
from reverie_eval.dataset import DatasetFiles, LintReport, compile_split, lint_dataset
from tests.support.broken_datasets import (
    ANNOTATIONS,
    BOX,
    DATA,
    DOOR,
    GRAPH,
    HALL,
    Spoil,
    all_round,
    annex,
    both,
    box,
    boxes_at,
    boxes_of,
    edited,
    empty_boxes,
    file,
    graph,
    items,
    listed,
    may_stay,
    no_way,
    shed,
    sofas,
    two_splits,
    unanswered,
    write_json,
    write_published_flat,
)
from tests.support.flat_world import FLAT, SINK, TUB
from tests.support.worlds import OBJECT_POSITIONS, SPLIT, write_world

T = TypeVar("T")


@pytest.fixture
def flat(tmp_path: Path) -> Path:
    """Write the flat as a folder of published files."""
    write_published_flat(tmp_path)
    return tmp_path


def linted(folder: Path, object_positions: Path | None = None) -> LintReport:
    """Check the dataset in a folder."""
    return lint_dataset(DatasetFiles.find(folder, object_positions=object_positions))


def found_in(report: LintReport, *severities: str) -> dict[str, int]:
    """Return how often each thing was found that was found at all, over all splits."""
    found: dict[str, int] = {}
    for count in chain.from_iterable(section.counts for section in report.sections):
        if count.severity in severities and count.found.number:
            found[count.code] = found.get(count.code, 0) + count.found.number
    return found


def test_a_sound_dataset_has_no_errors_and_no_warnings(flat: Path) -> None:
    report = linted(flat)
    assert report.sound
    assert found_in(report, "error", "warning") == {}


CHAIR = {"name": "chair", "visible_pos": [3], "bbox2d": [BOX]}
CHAIRS = json.dumps({"door": {str(SINK): CHAIR, str(SINK + 1): CHAIR}})

CASES = [
    pytest.param(file(GRAPH, "["), {"malformed-file": 1}, id="no JSON"),
    pytest.param(file(GRAPH, "[" * 100_000), {"malformed-file": 1}, id="nested without end"),
    pytest.param(file(GRAPH, "{}"), {"malformed-file": 1}, id="no graph"),
    pytest.param(boxes_at("door", "[]"), {"malformed-file": 1, "missing-boxes": 1}, id="no boxes"),
    pytest.param(
        file(GRAPH, "[]"),
        {"boxes-of-unknown-viewpoint": 3, "unknown-viewpoint": 1},
        id="graph without viewpoints",
    ),
    pytest.param(
        graph(lambda places: places[HALL]["pose"].__setitem__(3, 1e300)),
        {"malformed-file": 1},
        id="pose out of this world",
    ),
    pytest.param(file(ANNOTATIONS, "[]"), {"malformed-file": 1}, id="no items"),
    pytest.param(
        empty_boxes, {"missing-boxes": 3, "target-not-listed": 1}, id="folder without boxes"
    ),
    pytest.param(file(ANNOTATIONS, "7"), {"malformed-file": 1}, id="no annotations"),
    pytest.param(
        boxes_at("door", '{"door": {}, "door": {}}'), {"duplicate-key": 1}, id="key twice"
    ),
    pytest.param(
        graph(lambda places: places[HALL]["unobstructed"].pop()),
        {"malformed-graph": 1},
        id="unobstructed too short",
    ),
    pytest.param(
        graph(lambda places: [place.update(image_id="hall") for place in places[:2]]),
        {
            "duplicate-viewpoint": 1,
            "boxes-of-unknown-viewpoint": 1,
            "unknown-viewpoint": 1,
        },
        id="viewpoint twice in a scan",
    ),
    pytest.param(
        annex,
        {"duplicate-viewpoint": 1, "isolated-viewpoint": 1, "missing-boxes": 1},
        id="viewpoint id in two scans",
    ),
    pytest.param(
        both(annex, file(DATA / "BBox" / "annex_door.json", CHAIRS)),
        {"duplicate-viewpoint": 1, "isolated-viewpoint": 1},
        id="object id in two scans",
    ),
    pytest.param(
        both(annex, may_stay),
        {"duplicate-viewpoint": 1, "isolated-viewpoint": 1, "missing-boxes": 1},
        id="edges from viewpoints to themselves",
    ),
    pytest.param(no_way(HALL, DOOR), {"asymmetric-edge": 1}, id="one way, back"),
    pytest.param(
        no_way(DOOR, HALL),
        {"asymmetric-edge": 1, "path-off-edges": 1},
        id="one way, on the path",
    ),
    pytest.param(
        both(no_way(HALL, DOOR), no_way(DOOR, HALL)),
        {
            "isolated-viewpoint": 1,
            "graph-in-parts": 1,
            "unreachable-goal": 1,
            "path-off-edges": 1,
        },
        id="door shut",
    ),
    pytest.param(
        lambda folder: boxes_of(folder, "door").unlink(), {"missing-boxes": 1}, id="no box file"
    ),
    pytest.param(
        boxes_at("attic", '{"attic": {}}'),
        {"boxes-of-unknown-viewpoint": 1},
        id="boxes of an unknown viewpoint",
    ),
    pytest.param(shed, {}, id="viewpoint not included"),
    pytest.param(
        both(shed, boxes_at("shed", '{"shed": {}}')),
        {"boxes-of-excluded-viewpoint": 1},
        id="boxes of a viewpoint that is not included",
    ),
    pytest.param(
        boxes_at("door", '{"door": {}, "hall": {}}'), {"misnamed-boxes": 1}, id="two in a file"
    ),
    pytest.param(
        boxes_at("door", '{"porch": {}}'),
        {"misnamed-boxes": 1, "missing-boxes": 1, "boxes-of-unknown-viewpoint": 1},
        id="another than the file's name",
    ),
    pytest.param(listed(visible_pos="13"), {"malformed-entry": 1}, id="views as text"),
    pytest.param(listed(visible_pos=[True]), {"malformed-entry": 1}, id="view that is no number"),
    pytest.param(listed(bbox2d=[[1, 2, 30]]), {"malformed-entry": 1}, id="three numbers"),
    pytest.param(box(1, 2, 30.5, 40), {"malformed-entry": 1}, id="half a pixel"),
    pytest.param(box(1, 2, float("nan"), 40), {"malformed-entry": 1}, id="no number"),
    pytest.param(box(1, 2, 2**31, 40), {"malformed-entry": 1}, id="beyond any picture"),
    pytest.param(listed(key="07"), {"malformed-entry": 1}, id="object id with a leading zero"),
    pytest.param(listed(key=2**31), {"malformed-entry": 1}, id="object id beyond 32 bits"),
    pytest.param(listed(visible_pos=[13, 14]), {"unequal-lists": 1}, id="view without a box"),
    pytest.param(listed(bbox2d=[BOX, BOX]), {"unequal-lists": 1}, id="box without a view"),
    pytest.param(
        listed(visible_pos=[13, 13], bbox2d=[BOX, BOX]), {"duplicate-view": 1}, id="view twice"
    ),
    pytest.param(
        listed(visible_pos=[20, 13], bbox2d=[BOX, BOX]), {"unsorted-views": 1}, id="unsorted"
    ),
    pytest.param(
        both(listed(name="sink"), listed("hall", name="basin")),
        {"several-names": 1},
        id="names",
    ),
    pytest.param(
        sofas(51, 49),
        {"hidden-name": 1, "listed-not-visible": 51, "never-visible": 51},
        id="name that is mostly not visible",
    ),
    pytest.param(
        sofas(50, 50), {"listed-not-visible": 50, "never-visible": 50}, id="name half visible"
    ),
    pytest.param(
        sofas(99, 0),
        {"listed-not-visible": 99, "never-visible": 99},
        id="name not often listed",
    ),
    pytest.param(listed(visible_pos=[35]), {}, id="last view"),
    pytest.param(listed(visible_pos=[36]), {"view-out-of-range": 1}, id="view 36"),
    pytest.param(listed(visible_pos=[-1]), {"view-out-of-range": 1}, id="view -1"),
    pytest.param(box(1, 2, 0, 40), {"box-without-area": 1, "sliver": 1, "speck": 1}, id="no width"),
    pytest.param(
        box(1, 2, 30, -1),
        {"box-without-area": 1, "sliver": 1, "speck": 1},
        id="negative height",
    ),
    pytest.param(box(610, 440, 30, 40), {}, id="in the lower right corner"),
    pytest.param(box(611, 440, 30, 40), {"box-outside": 1}, id="beyond the right border"),
    pytest.param(box(610, 441, 30, 40), {"box-outside": 1}, id="beyond the lower border"),
    pytest.param(box(-1, 2, 30, 40), {"box-outside": 1}, id="beyond the left border"),
    pytest.param(box(0, 0, 640, 480), {"full-image": 1}, id="whole picture"),
    pytest.param(box(0, 0, 640, 479), {}, id="nearly the whole picture"),
    pytest.param(box(1, 2, 5, 21), {}, id="five pixels wide, 105 in all"),
    pytest.param(box(1, 2, 4, 40), {"sliver": 1}, id="four pixels wide"),
    pytest.param(box(1, 2, 10, 10), {"speck": 1}, id="a hundred pixels"),
    pytest.param(
        box(1, 2, 1, 1),
        {"sliver": 1, "speck": 1},
        id="one pixel",
    ),
    pytest.param(
        listed(visible_pos=[], bbox2d=[]),
        {"listed-not-visible": 1, "never-visible": 1},
        id="not visible",
    ),
    pytest.param(
        listed("hall", visible_pos=[], bbox2d=[]),
        {"listed-not-visible": 1},
        id="not visible from here",
    ),
    pytest.param(
        listed(visible_pos=list(range(35)), bbox2d=[BOX] * 35),
        {"edges-apart": 12},
        id="all round but for a view",
    ),
    pytest.param(all_round(SINK), {"in-all-views": 1, "edges-apart": 12}, id="all round"),
    pytest.param(
        both(all_round(SINK), all_round(TUB)),
        {"in-all-views": 2, "edges-apart": 24, "views-disagree": 24},
        id="most neighbouring views disagree",
    ),
    pytest.param(items(lambda content: content.append({})), {"malformed-item": 1}, id="no item"),
    pytest.param(
        items(lambda content: content.append(content[0])), {"duplicate-episode": 5}, id="twice"
    ),
    pytest.param(two_splits, {"shared-episode": 10}, id="two splits with the same items"),
    pytest.param(
        items(lambda content: content[0].update(scan="barn")), {"missing-scan": 1}, id="scan"
    ),
    pytest.param(
        items(lambda content: content[0]["path"].insert(1, "attic")),
        {"unknown-viewpoint": 1},
        id="unknown viewpoint on the path",
    ),
    pytest.param(
        both(shed, items(lambda content: content[0]["path"].insert(1, "shed"))),
        {"unknown-viewpoint": 1},
        id="viewpoint on the path that is not included",
    ),
    pytest.param(
        items(lambda content: content[0]["path"].pop(HALL)), {"path-off-edges": 1}, id="no edge"
    ),
    pytest.param(
        items(lambda content: content[0]["path"].insert(1, "hall")), {}, id="a step on the spot"
    ),
    pytest.param(items(unanswered), {"missing-solution": 1}, id="item without a target"),
    pytest.param(items(lambda content: content[0].pop("objId")), {}, id="no item with a target"),
    pytest.param(
        items(lambda content: content[0].update(objId=9)), {"target-not-listed": 1}, id="target"
    ),
    pytest.param(
        listed(key=TUB, visible_pos=[], bbox2d=[]),
        {"target-not-visible": 1, "listed-not-visible": 1, "never-visible": 1},
        id="target not visible",
    ),
    pytest.param(listed("door", key=TUB), {"target-at-start": 1}, id="target at the start"),
    pytest.param(
        listed("door", key=TUB, visible_pos=[], bbox2d=[]),
        {"listed-not-visible": 1},
        id="target listed at the start",
    ),
]


@pytest.mark.parametrize(("spoil", "expected"), CASES)
def test_an_error_or_warning_is_counted_and_nothing_else(
    spoil: Spoil, expected: dict[str, int], flat: Path
) -> None:
    spoil(flat)
    report = linted(flat)
    assert found_in(report, "error", "warning") == expected
    assert report.sound == (found_in(report, "error") == {})


@pytest.mark.parametrize(("spoil", "expected"), CASES)
def test_compiling_refuses_exactly_what_is_an_error(
    spoil: Spoil, expected: dict[str, int], flat: Path
) -> None:
    spoil(flat)
    errors = found_in(linted(flat), "error")
    if (flat / "connectivity" / "annex_connectivity.json").exists():
        errors = {}  # no item is in the annex, so it is not read
    refused = []
    try:
        compile_split(DatasetFiles.find(flat, split=SPLIT), SPLIT)
    except DatasetError as error:
        refused = [problem.code for problem in error.problems]
    assert sorted(refused) == sorted(errors)


@pytest.mark.parametrize(
    ("height", "expected"),
    [
        pytest.param(1.999, {}, id="within reach"),
        pytest.param(2.0, {"beyond-reach": 1}, id="two metres"),
        pytest.param(3.0, {"beyond-reach": 1}, id="three metres"),
        pytest.param(3.001, {"beyond-reach": 1, "beyond-success": 1}, id="more than three"),
    ],
)
def test_distances_from_the_camera_to_the_centre(
    height: float, expected: dict[str, int], flat: Path
) -> None:
    """The camera is at (8, 6, 0); nobody knows where the sink is."""
    centres = flat / OBJECT_POSITIONS
    write_json(centres, {"flat": {str(TUB): [8.0, 6.0, height]}})
    report = linted(flat, object_positions=centres)
    assert found_in(report, "warning") == {"unknown-centre": 1, **expected}
    assert report.sound
    objects, targets = report.sections[-1].spreads
    assert (objects.number, objects.mean, targets.number, targets.mean) == (1, height, 1, height)


def test_object_positions_that_cannot_be_read(flat: Path) -> None:
    centres = flat / OBJECT_POSITIONS
    write_json(centres, {"flat": {"x": [8.0, 6.0, 0.0]}})
    report = linted(flat, object_positions=centres)
    assert found_in(report, "error") == {"malformed-file": 1}


def test_without_object_positions_distances_are_left_out_and_it_is_said(flat: Path) -> None:
    distances = linted(flat).sections[-1]
    assert (distances.title, distances.counts, distances.spreads) == ("distances", (), ())
    assert "--object-positions" in distances.note


def test_one_file_with_all_boxes_may_leave_viewpoints_out(tmp_path: Path) -> None:
    write_world(FLAT, tmp_path)
    assert found_in(linted(tmp_path), "error", "warning") == {}
    edited(DATA / "BBoxes.json", lambda content: content.pop("flat_door"))(tmp_path)
    report = linted(tmp_path)
    assert found_in(report, "error", "warning") == {"left-out-of-boxes": 1}
    assert report.sound


def test_facts_of_a_flat(flat: Path) -> None:
    """Two edges, of 8 and 6 m; a tub in one view, a sink in two and once in the corner."""
    both(
        shed,
        listed(visible_pos=[13, 20], bbox2d=[[0, 440, 30, 40], BOX]),
        listed("hall", key=TUB, visible_pos=[], bbox2d=[]),
    )(flat)
    report = linted(flat)
    assert found_in(report, "info") == {
        "files": 5,
        "scans": 1,
        "viewpoints": 4,
        "included-viewpoints": 3,
        "edges": 2,
        "viewpoints-with-boxes": 3,
        "listed": 3,
        "boxes": 3,
        "listing-viewpoints": 2,
        "seeing-viewpoints": 1,
        "objects": 2,
        "visible-objects": 2,
        "visible": 2,
        "seen-once": 2,
        "items": 1,
        "episodes": 5,
        "item-scans": 1,
        "targets": 1,
        "single-goal": 1,
    }
    spreads = {spread.code: spread for section in report.sections for spread in section.spreads}
    edges = spreads["edge-length"]
    assert (edges.number, edges.mean, edges.percentiles["0"], edges.percentiles["100"]) == (
        2,
        7,
        6,
        8,
    )
    assert spreads["box-right"].percentiles["100"] == 31
    assert spreads["target-area"].mean == 1200
    assert (spreads["objects-at-goal"].mean, spreads["boxes-at-goal"].mean) == (2, 3)
    assert spreads["left-edge-agreement"].number == 0


def test_examples_are_named_up_to_forty(flat: Path) -> None:
    both(*(listed("hall", key=key, visible_pos=[36]) for key in range(10, 60)))(flat)
    (outside,) = [
        count.found
        for section in linted(flat).sections
        for count in section.counts
        if count.code == "view-out-of-range"
    ]
    assert (outside.number, outside.of, len(outside.examples)) == (50, 52, 40)
    assert outside.examples[0] == "flat_hall object 10 view 36 [1, 2, 30, 40]"


def test_progress_is_shown_over_the_files_to_read(flat: Path) -> None:
    seen: dict[str, int] = {}

    def progress(files: Iterable[T], description: str, total: int, /) -> Iterable[T]:
        seen[description] = total
        return files

    lint_dataset(DatasetFiles.find(flat), progress=progress)
    assert seen == {"connectivity": 1, "boxes": 3}


def test_the_demo_world_is_sound(demo_world: Path) -> None:
    assert linted(demo_world, object_positions=demo_world / OBJECT_POSITIONS).sound
