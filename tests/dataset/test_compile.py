"""Compiling the published files: the content of bundles, and the problems in wrong files."""

import json
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

from fixtures.demo_world.episodes import Answer, episodes_of, submitted
from reverie_eval import DatasetError, GroundTruth, Problem, evaluate
from reverie_eval.dataset import DatasetFiles, compile_for_training, compile_split, origin_notes
from reverie_eval.dataset._reader import object_key
from reverie_eval.ground_truth import Bundle
from reverie_eval.tasks import find_task
from tests.support.oracle import Scan, Viewpoint, distances_from

T = TypeVar("T")

SPLIT = "val_unseen"
V1_VAL_UNSEEN = "4df35a0847e242df6db1794b1e0d8676fee0f2f2432a599311a643388550e63c"
DATA = Path("tasks", "REVERIE", "data")
ANNOTATIONS = DATA / f"REVERIE_{SPLIT}.json"
BOXES = DATA / "BBox"
CONNECTIVITY = Path("connectivity")
MANSION = CONNECTIVITY / "DemoMansion_connectivity.json"
RECTORY = CONNECTIVITY / "DemoRectory_connectivity.json"


def compiled(root: Path, split: str = SPLIT, **elsewhere: Path) -> Bundle:
    """Compile a split of the files below a folder."""
    return compile_split(DatasetFiles.find(root, split=split, task="reverie", **elsewhere), split)


@pytest.fixture(scope="module")
def bundle(demo_world: Path) -> Bundle:
    """Compile the demo world's val_unseen split."""
    return compiled(demo_world)


@pytest.fixture
def world(demo_world: Path, tmp_path: Path) -> Path:
    """Copy the part of the demo world that val_unseen needs, for tests to damage."""
    others = shutil.ignore_patterns("Demo[!MR]*")
    return shutil.copytree(demo_world, tmp_path / "world", ignore=others)


def read(path: Path) -> Any:
    """Return the content of a JSON file."""
    return json.loads(path.read_text())


def edit(path: Path, change: Callable[[Any], object]) -> None:
    """Change the content of a JSON file."""
    content = read(path)
    change(content)
    path.write_text(json.dumps(content))


# What a bundle holds.


def test_a_bundle_lists_the_episodes_of_its_split(bundle: Bundle) -> None:
    assert bundle.header.split == SPLIT
    assert bundle.arrays["scan_id"].tolist() == ["DemoMansion", "DemoRectory"]
    expected = [episode.instr_id for episode in episodes_of(SPLIT)]
    assert bundle.arrays["instr_id"].tolist() == expected


def test_a_bundle_knows_the_episodes_of_other_splits(bundle: Bundle) -> None:
    """Including those of the test split: its ids are public."""
    others = {split: ids.tolist() for split, ids in bundle.other_splits.items()}
    assert others == {
        split: [episode.instr_id for episode in episodes_of(split)]
        for split in ("test", "train", "val_seen")
    }


def test_another_split_that_cannot_be_read_is_left_out(world: Path) -> None:
    (world / DATA / "REVERIE_train.json").write_text("[")
    assert compiled(world).other_splits.keys() == {"test", "val_seen"}


@pytest.mark.parametrize(
    ("split", "numbers", "digest", "name"),
    [
        pytest.param("val_unseen", (1328, 3521), V1_VAL_UNSEEN, "REVERIE v1", id="as published"),
        pytest.param("val_unseen", (1328, 3521), "0" * 64, "REVERIE v1 (changed)", id="changed"),
        pytest.param("val_unseen", (1327, 3518), "0" * 64, None, id="another dataset"),
        pytest.param("test", (2304, 6292), "0" * 64, "REVERIE v1", id="its solution is private"),
    ],
)
def test_a_release_is_named_by_its_file(
    split: str, numbers: tuple[int, int], digest: str, name: str | None
) -> None:
    assert find_task("reverie").release(split, *numbers, digest) == name


@pytest.mark.dataset
def test_changed_annotations_of_a_release_are_called_so(published: Path, tmp_path: Path) -> None:
    changed = tmp_path / f"REVERIE_{SPLIT}.json"
    shutil.copyfile(published / "reverie-v1" / ANNOTATIONS, changed)
    edit(changed, lambda items: items[0].update(heading=0))
    header = compiled(published / "reverie-v1", annotations=changed).header
    assert header.dataset == "REVERIE v1 (changed)"
    (note,) = origin_notes(header)
    digest = sha256(changed.read_bytes()).hexdigest()
    assert note == f"the annotations are not a published file of REVERIE; their SHA-256 is {digest}"


def test_sources_are_named_by_their_digests(bundle: Bundle, world: Path) -> None:
    edit(world / ANNOTATIONS, lambda items: items[0].update(heading=0))
    sources, other = bundle.header.sources, compiled(world).header.sources
    assert sources.keys() == {"annotations", "boxes", "connectivity"}
    assert {kind for kind in sources if sources[kind] != other[kind]} == {"annotations"}


def test_progress_is_shown_over_the_files_to_read(demo_world: Path) -> None:
    seen: dict[str, int] = {}

    def progress(files: Iterable[T], description: str, total: int, /) -> Iterable[T]:
        seen[description] = total
        return files

    compile_split(DatasetFiles.find(demo_world, split=SPLIT), SPLIT, progress=progress)
    included = sum(
        place["included"] for file in (MANSION, RECTORY) for place in read(demo_world / file)
    )
    assert seen == {"connectivity": 2, "boxes": included}


# Distances.


def scan_of(connectivity: Path) -> Scan:
    """Read a navigation graph as the oracle takes it."""
    places = read(connectivity)
    viewpoints = {
        place["image_id"]: Viewpoint(
            position=(place["pose"][3], place["pose"][7], place["pose"][11]),
            included=place["included"],
        )
        for place in places
    }
    pairs = {
        (place["image_id"], other)
        for place in places
        for other, unobstructed in zip(viewpoints, place["unobstructed"], strict=True)
        if unobstructed
    }
    return Scan(viewpoints, frozenset(pairs))


@pytest.mark.parametrize("split", ["train", "val_seen", "val_unseen", "test"])
def test_distances_have_the_digits_of_dijkstra(split: str, demo_world: Path) -> None:
    graph = GroundTruth.from_bundle(compiled(demo_world, split)).graph
    for number, scan_id in enumerate(graph.scan_ids):
        scan = scan_of(demo_world / CONNECTIVITY / f"{scan_id}_connectivity.json")
        rows = np.flatnonzero(graph.viewpoint_scan == number)
        viewpoint_ids = [graph.viewpoint_ids[row] for row in rows]
        assert viewpoint_ids == [id_ for id_, place in scan.viewpoints.items() if place.included]
        for row, viewpoint_id in zip(rows, viewpoint_ids, strict=True):
            reached = distances_from(scan, viewpoint_id)
            distances = graph.distance_between(np.full_like(rows, row), rows)
            assert distances.tolist() == [reached.get(other, np.inf) for other in viewpoint_ids]


# Positions.


def test_viewpoints_are_where_their_poses_are(bundle: Bundle, demo_world: Path) -> None:
    graph = GroundTruth.from_bundle(bundle).graph
    places = {place["image_id"]: place["pose"] for place in read(demo_world / MANSION)}
    places |= {place["image_id"]: place["pose"] for place in read(demo_world / RECTORY)}
    expected = [[places[id_][at] for at in (3, 7, 11)] for id_ in graph.viewpoint_ids]
    assert graph.viewpoint_position.tolist() == expected


def centred(world: Path, centres: object, split: str = SPLIT) -> Bundle:
    """Compile the files below a folder with these object positions."""
    path = world / "centres.json"
    path.write_text(json.dumps(centres))
    return compiled(world, split, object_positions=path)


def test_candidates_are_measured_to_their_centres(world: Path) -> None:
    place = next(place for place in read(world / MANSION) if place["included"])
    boxes = world / BOXES / f"DemoMansion_{place['image_id']}.json"
    seen = {"visible_pos": [3], "bbox2d": [[0, 0, 9, 9]]}
    edit(boxes, lambda content: content[place["image_id"]].update({"801": seen, "802": seen}))
    x, y, z = (place["pose"][at] for at in (3, 7, 11))
    arrays = centred(world, {"DemoMansion": {"801": [x + 2, y - 6, z + 9]}}).arrays
    viewpoint = arrays["viewpoint_id"].tolist().index(place["image_id"])
    here = arrays["candidate_viewpoint"] == viewpoint
    metres = dict(
        zip(
            arrays["candidate_object"][here].tolist(),
            arrays["candidate_distance"][here].tolist(),
            strict=True,
        )
    )
    assert metres.pop(801) == pytest.approx(11.0, rel=1e-12)
    assert set(metres.values()) == {np.inf}


def test_a_centre_counts_only_in_its_own_scan(world: Path) -> None:
    """Object ids are numbered within each scan."""
    everything = {str(object_id): [0.0, 0.0, 0.0] for object_id in range(1000)}
    bundle = centred(world, {"DemoRectory": everything, "ElsewhereHouse": everything})
    truth = GroundTruth.from_bundle(bundle)
    scans = [truth.graph.scan_of(row) for row in bundle.arrays["candidate_viewpoint"].tolist()]
    known = np.isfinite(bundle.arrays["candidate_distance"]).tolist()
    assert known == [scan == "DemoRectory" for scan in scans]


def test_the_target_of_each_item_has_its_centre_or_none(world: Path) -> None:
    records = read(world / "tasks" / "REVERIE" / "data" / f"REVERIE_{SPLIT}.json")
    first = records[0]
    centres = {first["scan"]: {str(first["objId"]): [1.0, 2.0, 3.0]}}
    found = centred(world, centres).arrays["target_position"].tolist()
    expected = [
        [1.0, 2.0, 3.0]
        if (it["scan"], it["objId"]) == (first["scan"], first["objId"])
        else [np.inf] * 3
        for it in records
    ]
    assert found == expected


def test_object_positions_are_not_searched_for(bundle: Bundle, demo_world: Path) -> None:
    """They are next to the demo world, but the fingerprint must not depend on that."""
    assert (demo_world / "objpos.json").is_file()
    assert not {"candidate_distance", "target_position"} & bundle.arrays.keys()


def test_object_positions_change_fingerprint_and_sources(bundle: Bundle, world: Path) -> None:
    measured = centred(world, {})
    assert measured.header.fingerprint != bundle.header.fingerprint
    assert measured.header.sources.keys() - bundle.header.sources.keys() == {"object_positions"}
    others = {name: array.tolist() for name, array in measured.arrays.items()}
    del others["candidate_distance"], others["target_position"]
    assert others == {name: array.tolist() for name, array in bundle.arrays.items()}


def test_a_public_bundle_is_not_changed_by_object_positions(demo_world: Path) -> None:
    positions = demo_world / "objpos.json"
    measured = compiled(demo_world, "test", object_positions=positions)
    assert measured.arrays.keys() == compiled(demo_world, "test").arrays.keys()
    assert measured.header.fingerprint == compiled(demo_world, "test").header.fingerprint


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        pytest.param("{", "not JSON", id="not JSON"),
        pytest.param("[]", "Input should be", id="list"),
        pytest.param('{"DemoMansion": {"3": [1, 2]}}', "DemoMansion.3", id="two coordinates"),
        pytest.param('{"DemoMansion": {"3": [1, 2, NaN]}}', "DemoMansion.3", id="NaN"),
        pytest.param('{"DemoMansion": {"3": [1, 2, 1e999]}}', "DemoMansion.3", id="infinite"),
        pytest.param(
            '{"DemoMansion": {"lamp": [1, 2, 3]}}', "DemoMansion.lamp", id="object by name"
        ),
    ],
)
def test_object_positions_that_are_none(content: str, fragment: str, world: Path) -> None:
    path = world / "centres.json"
    path.write_text(content)
    with pytest.raises(DatasetError) as rejected:
        compiled(world, object_positions=path)
    (problem,) = rejected.value.problems
    assert (problem.code, problem.where) == ("malformed-file", str(path))
    assert fragment in problem.message


def test_no_object_positions_where_they_are_pointed_at(world: Path) -> None:
    with pytest.raises(DatasetError) as rejected:
        compiled(world, object_positions=world / "none.json")
    (problem,) = rejected.value.problems
    assert (problem.code, problem.where) == ("missing-input", str(world / "none.json"))
    assert "--object-positions" in problem.message


# Where the files are.


def _in_the_published_layout(world: Path) -> DatasetFiles:
    return DatasetFiles.find(world, split=SPLIT)


def _each_pointed_at(world: Path) -> DatasetFiles:
    apart = world.parent
    (world / ANNOTATIONS).rename(apart / "annotations.json")
    (world / BOXES).rename(apart / "objects")
    (world / CONNECTIVITY).rename(apart / "graphs")
    return DatasetFiles.find(
        split=SPLIT,
        annotations=apart / "annotations.json",
        boxes=apart / "objects",
        connectivity=apart / "graphs",
    )


def _one_pointed_at(world: Path) -> DatasetFiles:
    (world / CONNECTIVITY).rename(world.parent / "graphs")
    return DatasetFiles.find(world, split=SPLIT, connectivity=world.parent / "graphs")


def _annotations_by_their_folder(world: Path) -> DatasetFiles:
    (world / DATA).rename(world.parent / "data")
    data = world.parent / "data"
    return DatasetFiles.find(world, split=SPLIT, annotations=data, boxes=data / "BBox")


def _boxes_in_one_file(world: Path) -> DatasetFiles:
    boxes = {path.stem: read(path)[_viewpoint(path)] for path in (world / BOXES).iterdir()}
    (world / DATA / "BBoxes.json").write_text(json.dumps(boxes))
    shutil.rmtree(world / BOXES)
    return DatasetFiles.find(world, split=SPLIT)


def _boxes_in_one_file_without_empty_viewpoints(world: Path) -> DatasetFiles:
    files = _boxes_in_one_file(world)
    assert files.boxes is not None
    edit(files.boxes, lambda boxes: [boxes.pop(key) for key in list(boxes) if not boxes[key]])
    return files


def _viewpoint(boxes: Path) -> str:
    return boxes.stem.partition("_")[2]


@pytest.mark.parametrize(
    "files",
    [
        _in_the_published_layout,
        _each_pointed_at,
        _one_pointed_at,
        _annotations_by_their_folder,
        _boxes_in_one_file,
        _boxes_in_one_file_without_empty_viewpoints,
    ],
    ids=lambda files: files.__name__.strip("_").replace("_", " "),
)
def test_the_same_files_anywhere_give_the_same_fingerprint(
    files: Callable[[Path], DatasetFiles], world: Path, bundle: Bundle
) -> None:
    found = compile_split(files(world), SPLIT)
    assert found.header.fingerprint == bundle.header.fingerprint


# Test splits.


def test_the_published_test_file_gives_a_public_bundle(demo_world: Path) -> None:
    bundle = compiled(demo_world, "test")
    assert bundle.is_public
    assert bundle.header.sources.keys() == {"annotations", "connectivity"}


def test_a_private_file_s_bundle_knows_the_other_splits_of_the_clone(demo_world: Path) -> None:
    bundle = compiled(demo_world, "test", annotations=demo_world / "private")
    assert bundle.other_splits.keys() == {"train", "val_seen", "val_unseen"}


def test_a_private_test_file_gives_a_bundle_that_scores(demo_world: Path) -> None:
    truth = GroundTruth.from_bundle(
        compiled(demo_world, "test", annotations=demo_world / "private")
    )
    perfect = [
        submitted(episode, Answer(episode.item.path, episode.item.target))
        for episode in episodes_of("test")
    ]
    scores = evaluate(perfect, split="test", ground_truth=truth)
    assert (scores["success"], scores["rgs"], scores["navigation_error"]) == (1, 1, 0)


# What can be wrong.


def _items(change: Callable[[Any], object]) -> Callable[[Path], None]:
    return lambda world: edit(world / ANNOTATIONS, change)


def _mansion(change: Callable[[Any], object]) -> Callable[[Path], None]:
    return lambda world: edit(world / MANSION, change)


def _block_one_way(places: Any) -> None:
    """Wall up the first passage from the first viewpoint, from one side only."""
    unobstructed = places[0]["unobstructed"]
    unobstructed[unobstructed.index(True)] = False


def _name_as_in_the_rectory(world: Path) -> None:
    name = read(world / RECTORY)[0]["image_id"]
    edit(world / MANSION, lambda places: places[0].update(image_id=name))


def _boxes_at_first_goal(world: Path) -> Path:
    item = read(world / ANNOTATIONS)[0]
    return world / BOXES / f"{item['scan']}_{item['path'][-1]}.json"


def _hide_first_target(world: Path) -> None:
    """Take the first item's target out of all views from its goal."""
    path, target = _boxes_at_first_goal(world), str(read(world / ANNOTATIONS)[0]["objId"])
    hidden: Mapping[str, Sequence[int]] = {"visible_pos": [], "bbox2d": []}
    edit(path, lambda boxes: boxes[_viewpoint(path)][target].update(hidden))


def _box_at_first_goal(**fields: object) -> Callable[[Path], None]:
    """Return the fault of a box with these fields at the first item's goal."""

    def spoil(world: Path) -> None:
        path = _boxes_at_first_goal(world)
        box = {"visible_pos": [3], "bbox2d": [[0, 0, 9, 9]], **fields}
        edit(path, lambda boxes: boxes[_viewpoint(path)].update({"999": box}))

    return spoil


def _end_on_the_balcony(world: Path) -> None:
    """Move the last item's goal, with all that is seen there, to where no route leads."""
    goal = read(world / ANNOTATIONS)[-1]["path"][-1]
    rectory = scan_of(world / RECTORY)
    balcony = next(
        name
        for name, place in rectory.viewpoints.items()
        if place.included and len(distances_from(rectory, name)) == 1
    )
    edit(
        world / ANNOTATIONS, lambda items: items[-1].update(path=[*items[-1]["path"][:-1], balcony])
    )
    seen = read(world / BOXES / f"DemoRectory_{goal}.json")[goal]
    (world / BOXES / f"DemoRectory_{balcony}.json").write_text(json.dumps({balcony: seen}))


def _remove_boxes_of_a_viewpoint_that_lists_nothing(world: Path) -> None:
    empty = [
        path for path in (world / BOXES).glob("DemoMansion_*") if read(path)[_viewpoint(path)] == {}
    ]
    empty[0].unlink()


def problems_of(world: Path) -> Sequence[Problem]:
    """Return everything that is wrong with the files."""
    with pytest.raises(DatasetError) as rejected:
        compiled(world)
    return rejected.value.problems


@pytest.mark.parametrize(
    ("spoil", "code", "where", "fragment"),
    [
        pytest.param(
            lambda world: (world / ANNOTATIONS).unlink(),
            "missing-input",
            ANNOTATIONS,
            "the folder has REVERIE_test.json, REVERIE_train.json, REVERIE_val_seen.json; name",
            id="no annotations",
        ),
        pytest.param(
            lambda world: shutil.rmtree(world / BOXES),
            "missing-input",
            BOXES,
            "or the path with --boxes",
            id="no boxes",
        ),
        pytest.param(
            lambda world: shutil.rmtree(world / CONNECTIVITY),
            "missing-input",
            CONNECTIVITY,
            "or the path with --connectivity",
            id="no graphs",
        ),
        pytest.param(
            lambda world: (world / ANNOTATIONS).write_text('[{"scan": }]'),
            "malformed-file",
            ANNOTATIONS,
            "not JSON: Expecting value",
            id="annotations are no JSON",
        ),
        pytest.param(
            lambda world: (world / ANNOTATIONS).write_text("[]"),
            "malformed-file",
            ANNOTATIONS,
            "at least 1 item",
            id="no item",
        ),
        pytest.param(
            _items(lambda items: items[1].update(objId="lamp")),
            "malformed-item",
            ANNOTATIONS,
            "[1]: objId: Expected `int | null`, got `str`",
            id="target is a text",
        ),
        pytest.param(
            _items(lambda items: items[1].update(path=[])),
            "malformed-item",
            ANNOTATIONS,
            "[1]: path: Expected `array` of length >= 1",
            id="empty path",
        ),
        pytest.param(
            _items(lambda items: [item.pop("instructions") for item in items[:5]]),
            "malformed-item",
            ANNOTATIONS,
            "5 of 32 records that do not have the published form: [0]: instructions is missing, "
            "[1]: instructions is missing, [2]: instructions is missing and 2 more. All other",
            id="instructions missing",
        ),
        pytest.param(
            _items(lambda items: items[1].update(scan="", path=["a", 3], objId=-1)),
            "malformed-item",
            ANNOTATIONS,
            "[1]: scan: Expected `str` of length >= 1, path: Expected `str`, got `int` - at "
            "`$[1]`, objId: Expected `int` >= 0",
            id="several fields of one record",
        ),
        pytest.param(
            _items(lambda items: [item.pop("objId") for item in items[1:3]]),
            "missing-solution",
            ANNOTATIONS,
            "2 of 32 items without a solution in a file where others have one",
            id="targets missing in part",
        ),
        pytest.param(
            _items(lambda items: items.append(items[0])),
            "duplicate-episode",
            ANNOTATIONS,
            "instr_ids used by more than one episode",
            id="item given twice",
        ),
        pytest.param(
            _items(lambda items: [items[row]["path"].insert(1, "0ff1ce") for row in (0, 1)]),
            "unknown-viewpoint",
            ANNOTATIONS,
            "2 of 32 items with a viewpoint on their path that is not in their scan's graph",
            id="path through an unknown viewpoint",
        ),
        pytest.param(
            _items(lambda items: items[0]["path"].insert(1, items[-1]["path"][0])),
            "unknown-viewpoint",
            ANNOTATIONS,
            "1 of 32 items with a viewpoint on their path that is not in their scan's graph",
            id="path through another scan",
        ),
        pytest.param(
            _end_on_the_balcony,
            "unreachable-goal",
            ANNOTATIONS,
            "1 of 32 items with a viewpoint on their path that cannot be reached",
            id="goal that cannot be reached",
        ),
        pytest.param(
            _items(lambda items: [item.update(objId=999) for item in items[:4]]),
            "target-not-listed",
            ANNOTATIONS,
            "4 of 32 items whose target is not listed where the path ends",
            id="target not listed at the goal",
        ),
        pytest.param(
            _hide_first_target,
            "target-not-visible",
            ANNOTATIONS,
            "Annotations and boxes are probably from different releases",
            id="target listed and not visible",
        ),
        pytest.param(
            lambda world: (world / MANSION).unlink(),
            "missing-scan",
            ANNOTATIONS,
            "items in a scan without a connectivity file",
            id="scan missing",
        ),
        pytest.param(
            _mansion(lambda places: places[0]["pose"].pop()),
            "malformed-file",
            MANSION,
            "[0].pose: List should have at least 16 items",
            id="pose of fifteen numbers",
        ),
        pytest.param(
            _mansion(lambda places: places[0].update(pose=[float("nan")] * 16)),
            "malformed-file",
            MANSION,
            "[0].pose[0]: Input should be a finite number",
            id="pose of NaN",
        ),
        pytest.param(
            _mansion(lambda places: places[0]["pose"].__setitem__(3, 1e300)),
            "malformed-file",
            MANSION,
            "[0].pose[3]: Input should be less than or equal to 1000000",
            id="pose out of this world",
        ),
        pytest.param(
            _mansion(_block_one_way),
            "asymmetric-edge",
            CONNECTIVITY,
            "pairs of included viewpoints unobstructed one way only: DemoMansion: ",
            id="passage in one direction",
        ),
        pytest.param(
            _mansion(lambda places: [place["unobstructed"].pop() for place in places[:2]]),
            "malformed-graph",
            CONNECTIVITY,
            "1 of 2 scans whose unobstructed lists do not have one entry for each viewpoint: "
            "DemoMansion. ",
            id="ragged graph",
        ),
        pytest.param(
            lambda world: (world / MANSION).write_text("[]"),
            "unknown-viewpoint",
            ANNOTATIONS,
            "items with a viewpoint on their path that is not in their scan's graph",
            id="graph without viewpoints",
        ),
        pytest.param(
            _mansion(lambda places: [place.update(included=False) for place in places]),
            "unknown-viewpoint",
            ANNOTATIONS,
            "items with a viewpoint on their path that is not in their scan's graph",
            id="graph of excluded viewpoints",
        ),
        pytest.param(
            _name_as_in_the_rectory,
            "duplicate-viewpoint",
            CONNECTIVITY,
            "1 of 49 ids used by more than one included viewpoint",
            id="viewpoint id in two scans",
        ),
        pytest.param(
            _remove_boxes_of_a_viewpoint_that_lists_nothing,
            "missing-boxes",
            BOXES,
            "1 of 50 included viewpoints without a box file",
            id="box file missing",
        ),
        pytest.param(
            _box_at_first_goal(visible_pos=[36]),
            "view-out-of-range",
            BOXES,
            "object 999 view 36 [0, 0, 9, 9]",
            id="thirty-seventh view",
        ),
        pytest.param(
            _box_at_first_goal(visible_pos=[3, 4]),
            "unequal-lists",
            BOXES,
            "listed objects with different numbers of views and boxes",
            id="view without a box",
        ),
        pytest.param(
            _box_at_first_goal(visible_pos=[3, 3], bbox2d=[[0, 0, 9, 9]] * 2),
            "duplicate-view",
            BOXES,
            "two boxes in one view",
            id="view given twice",
        ),
        pytest.param(
            _box_at_first_goal(bbox2d=[[0, 0, 0, 9]]),
            "box-without-area",
            BOXES,
            "view 3 [0, 0, 0, 9]",
            id="box without width",
        ),
        pytest.param(
            _box_at_first_goal(bbox2d=[[632, 0, 9, 9]]),
            "box-outside",
            BOXES,
            "boxes that reach beyond the 640 x 480 image",
            id="box beyond the right border",
        ),
        pytest.param(
            _box_at_first_goal(bbox2d=[[0, 472, 9, 9]]),
            "box-outside",
            BOXES,
            "view 3 [0, 472, 9, 9]",
            id="box beyond the lower border",
        ),
    ],
)
def test_a_fault_in_the_files(
    spoil: Callable[[Path], object], code: str, where: Path, fragment: str, world: Path
) -> None:
    spoil(world)
    fitting = [problem for problem in problems_of(world) if problem.code == code]
    assert len(fitting) == 1
    assert fitting[0].where.startswith(str(world / where))
    assert fragment in fitting[0].message


def test_boxes_may_reach_the_border(world: Path) -> None:
    _box_at_first_goal(bbox2d=[[631, 471, 9, 9]])(world)
    assert [631, 471, 9, 9] in compiled(world).arrays["box_xywh"].tolist()


@pytest.mark.parametrize("key", ["0", "9", "10", "2147483647"])
def test_a_key_that_is_an_object_id(key: str) -> None:
    assert object_key(key) == key


@pytest.mark.parametrize("key", ["", "-1", "+1", "07", "1.0", "1_0", "\u0661", "2147483648"])
def test_a_key_that_is_no_object_id(key: str) -> None:
    with pytest.raises(ValueError, match="whole number from 0 to 2,147,483,647"):
        object_key(key)


def test_all_faults_are_reported_at_once(world: Path) -> None:
    _end_on_the_balcony(world)
    _hide_first_target(world)
    _items(lambda items: items.append(items[0]))(world)
    _remove_boxes_of_a_viewpoint_that_lists_nothing(world)
    assert {problem.code for problem in problems_of(world)} == {
        "duplicate-episode",
        "unreachable-goal",
        "target-not-visible",
        "missing-boxes",
    }


def test_all_missing_inputs_are_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as rejected:
        DatasetFiles.find(tmp_path, split=SPLIT)
    assert [problem.where for problem in rejected.value.problems] == [
        str(tmp_path / place) for place in (ANNOTATIONS, BOXES, CONNECTIVITY)
    ]


def test_nothing_given_at_all() -> None:
    with pytest.raises(DatasetError) as rejected:
        DatasetFiles.find(split=SPLIT)
    assert [problem.where for problem in rejected.value.problems] == [
        "annotations",
        "boxes",
        "connectivity",
    ]


# To train on.


def test_items_without_a_visible_target_are_not_trained_on(bundle: Bundle, world: Path) -> None:
    items = read(world / ANNOTATIONS)
    lost, hidden = items[1], items[4]
    edit(world / ANNOTATIONS, lambda items: items[1].update(objId=987654))
    goal = world / BOXES / f"{hidden['scan']}_{hidden['path'][-1]}.json"
    edit(
        goal,
        lambda listed: listed[hidden["path"][-1]][str(hidden["objId"])].update(
            visible_pos=[], bbox2d=[]
        ),
    )
    trained, left_out = compile_for_training(DatasetFiles.find(world, split=SPLIT), SPLIT)
    left = {item["id"] for item in items} - {
        instr_id.rpartition("_")[0] for instr_id in trained.arrays["instr_id"].tolist()
    }
    # Others may share the hidden target and its goal.
    also = {
        item["id"]
        for item in items
        if (item["scan"], item["path"][-1], item["objId"])
        == (hidden["scan"], hidden["path"][-1], hidden["objId"])
    }
    assert left == {lost["id"], *also}
    assert left_out == len(left)
    assert len(trained.arrays["path_offsets"]) == len(bundle.arrays["path_offsets"]) - left_out
