"""Describing a dataset: counted by hand, as a table and as JSON."""

import json
from collections.abc import Mapping
from pathlib import Path

import pytest
from pydantic import TypeAdapter

from reverie_eval import __version__
from reverie_eval.dataset import DatasetDescription, DatasetFiles, describe_dataset
from tests.conftest import REPOSITORY
from tests.support.described import SEEN, SPLITS, TABLE, Record, item, listed, write_dataset
from tests.support.flat_world import Run
from tests.support.terminals import on_terminal


@pytest.fixture
def dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with the dataset, `dataset`."""
    monkeypatch.chdir(tmp_path)
    return write_dataset(Path("dataset"))


def describe(root: Path) -> DatasetDescription:
    """Describe what is below a clone's root."""
    return describe_dataset(DatasetFiles.find(root))


# Numbers.


def test_the_table_in_a_pipe(dataset: Path, run: Run) -> None:
    assert run("describe", "dataset") == (0, TABLE, "")


def test_json(dataset: Path, run: Run) -> None:
    status, out, err = run("describe", "dataset", "--format", "json")
    report = json.loads(out)
    assert (status, err) == (0, "")
    assert list(report["splits"]) == ["val_seen", "val_unseen", "test"]
    assert report["splits"]["val_unseen"] == {
        "splits": ["val_unseen"],
        "items": 2,
        "instructions": 2,
        "scans": 1,
        "viewpoints": 3,
        "words": spread(2, 2, 2, 2, {"2": 2}),
        "vocabulary": 4,
        "frequent_vocabulary": 0,
        "targets": {
            "items": 2,
            "hidden_targets": 1,
            "target_objects": 2,
            "target_categories": 2,
            "category_counts": {"lamp": 1, "rug": 1},
            "path_steps": spread(1.5, 1.5, 1, 2, {"1": 1, "2": 1}),
            "path_length": spread(11, 11, 5, 17, {"5": 1, "17": 1}),
            "goal_objects": spread(1.5, 1.5, 1, 2, {"1": 1, "2": 1}),
            "goal_boxes": spread(3.5, 3.5, 3, 4, {"3": 1, "4": 1}),
        },
    }
    assert report["splits"]["test"]["targets"] is None
    assert report["total"]["targets"]["category_counts"] == {"lamp": 2, "coffee table": 1, "rug": 1}
    assert report["paper"][2] == {
        "quantity": "instructions",
        "splits": ["train", "val_seen", "val_unseen", "test"],
        "covered": ["val_seen", "val_unseen", "test"],
        "here": 7,
        "paper": 21702,
    }
    others = {key: report[key] for key in ("schema_version", "version", "buildings", "viewpoints")}
    assert others == {
        "schema_version": 1,
        "version": __version__,
        "buildings": 3,
        "viewpoints": 6,
    }


def spread(
    mean: float, median: float, minimum: float, maximum: float, counts: Mapping[str, int]
) -> Record:
    """Write a distribution as it is reported."""
    return {
        "mean": mean,
        "median": median,
        "minimum": minimum,
        "maximum": maximum,
        "counts": counts,
    }


@pytest.mark.parametrize("columns", [40, 80, 120])
def test_no_number_is_cut_off_on_a_terminal(columns: int, dataset: Path) -> None:
    shown = on_terminal(columns, "describe", "dataset", "--connectivity", "dataset/connectivity")
    for number in ("11.3", "3.1", "21,702", "without train, test"):
        assert number in shown


@pytest.mark.parametrize(
    "given",
    ["dataset/tasks/REVERIE/data/REVERIE_val_seen.json", "elsewhere"],
    ids=["file", "folder"],
)
def test_one_split_alone_needs_no_column_for_all(given: str, dataset: Path, run: Run) -> None:
    Path("elsewhere").mkdir()
    Path("elsewhere", "REVERIE_val_seen.json").write_text(json.dumps(SPLITS["val_seen"]))
    status, out, err = run("describe", "dataset", "--annotations", given)
    assert (status, err) == (0, "")
    assert out.splitlines()[:2] == [
        "                       val_seen",
        "items                         3",
    ]


def test_splits_come_in_their_usual_order(tmp_path: Path) -> None:
    names = ["aug", "test", "train", "val_seen", "val_unseen"]
    write_dataset(tmp_path, dict.fromkeys(names, SPLITS["val_seen"]))
    assert list(DatasetFiles.find(tmp_path).annotations) == [
        "train",
        "val_seen",
        "val_unseen",
        "test",
        "aug",
    ]


def test_boxes_in_one_file_may_leave_out_who_sees_nothing(dataset: Path, tmp_path: Path) -> None:
    to_json = TypeAdapter(DatasetDescription).dump_json
    expected = to_json(describe(dataset))
    content = {
        f"hut_{viewpoint}": {key: listed(*it) for key, it in objects.items()}
        for viewpoint, objects in SEEN.items()
    }
    Path("BBoxes.json").write_text(json.dumps(content))
    found = describe_dataset(DatasetFiles.find(dataset, boxes=Path("BBoxes.json")))
    assert to_json(found) == expected


def test_a_target_that_is_listed_nowhere_has_no_category(tmp_path: Path) -> None:
    root = write_dataset(tmp_path, {"train": [item("1_7", "hut-a hut-b", 7, "go")]})
    described = describe(root).total.targets
    assert described is not None
    assert (described.target_objects, described.hidden_targets) == (1, 1)
    assert described.category_counts == {}


# Faults.


def test_errors_of_all_splits_are_reported_at_once(dataset: Path, run: Run) -> None:
    data = dataset / "tasks" / "REVERIE" / "data"
    (data / "REVERIE_val_seen.json").write_text(json.dumps([item("1_1", "hut-a hut-z", 1, "go")]))
    (data / "REVERIE_test.json").write_text(json.dumps([*SPLITS["test"], *SPLITS["test"]]))
    (data / "BBox" / "hut_hut-c.json").unlink()
    status, out, err = run("describe", "dataset")
    assert (status, out) == (1, "")
    assert err.splitlines() == [
        "reverie-eval: dataset rejected, 3 problems",
        (
            f"{data}/BBox: 1 of 6 included viewpoints without a box file: hut_hut-c. A viewpoint "
            "that sees no object has an empty file: copy the whole box folder."
        ),
        (
            f"{data}/REVERIE_val_seen.json: 1 of 1 items with a viewpoint on their path that is "
            "not in their scan's graph: 1_1. Annotations and connectivity files belong to "
            "different datasets."
        ),
        (
            f"{data}/REVERIE_test.json: 1 of 1 instr_ids used by more than one episode: 9_0. A "
            "submission has one prediction per instr_id: give every item its own id."
        ),
    ]


def test_a_file_that_cannot_be_read_is_reported_once(dataset: Path, run: Run) -> None:
    hut = dataset / "connectivity" / "hut_connectivity.json"
    hut.write_text("{}")
    status, out, err = run("describe", "dataset")
    assert (status, out) == (1, "")
    (problem,) = err.splitlines()[1:]
    assert problem.startswith(f"{hut}: 1 of ")
    assert "hut_connectivity.json: Input should be a valid list" in problem


def test_all_files_that_cannot_be_read_are_reported(dataset: Path, run: Run) -> None:
    data = dataset / "tasks" / "REVERIE" / "data"
    for split in ("val_seen", "test"):
        (data / f"REVERIE_{split}.json").write_text("[]")
    status, out, err = run("describe", "dataset")
    assert (status, out) == (1, "")
    assert err.count("List should have at least 1 item") == 2


def test_a_folder_without_a_dataset_is_told(tmp_path: Path, run: Run) -> None:
    status, out, err = run("describe", str(tmp_path))
    assert (status, out) == (1, "")
    assert err.startswith("reverie-eval: dataset rejected, 3 problems\n")


# The published files.


@pytest.fixture(scope="module")
def published_description(published: Path) -> DatasetDescription:
    """Describe REVERIE v1, as far as it is public."""
    return describe(published / "reverie-v1")


@pytest.mark.dataset
@pytest.mark.parametrize(
    ("split", "expected"),
    [
        pytest.param("val_seen", (515, 1423, 46, 6062, 892, 327), id="val_seen"),
        pytest.param("val_unseen", (1328, 3521, 10, 921, 1616, 634), id="val_unseen"),
        pytest.param("test", (2304, 6292, 16, 1764, 2198, 837), id="test"),
    ],
)
def test_what_is_counted_in_v1(
    split: str, expected: tuple[int, ...], published_description: DatasetDescription
) -> None:
    part = published_description.splits[split]
    counted = (part.items, part.instructions, part.scans, part.viewpoints)
    assert (*counted, part.vocabulary, part.frequent_vocabulary) == expected


@pytest.mark.dataset
@pytest.mark.parametrize(
    ("split", "targets", "means"),
    [
        pytest.param("val_seen", (440, 127), (8.254, 53.299, 5.202, 10.557), id="val_seen"),
        pytest.param("val_unseen", (513, 158), (7.301, 53.834, 4.949, 9.491), id="val_unseen"),
    ],
)
def test_targets_goals_and_paths_of_v1(
    split: str,
    targets: tuple[int, int],
    means: tuple[float, ...],
    published_description: DatasetDescription,
) -> None:
    described = published_description.splits[split].targets
    assert described is not None
    assert (described.target_objects, described.target_categories) == targets
    spreads = (
        described.goal_objects,
        described.goal_boxes,
        described.path_steps,
        described.path_length,
    )
    assert tuple(round(values.mean, 3) for values in spreads) == means
    assert described.hidden_targets == 0


@pytest.mark.dataset
@pytest.mark.parametrize(
    ("quantity", "splits"),
    [
        ("buildings", ()),
        ("viewpoints", ()),
        ("instructions", ("val_seen", "val_unseen")),
        ("instructions", ("test",)),
        ("scans", ("val_unseen",)),
        ("scans", ("test",)),
        ("target objects", ("val_seen", "val_unseen")),
    ],
)
def test_v1_agrees_with_the_paper(
    quantity: str, splits: tuple[str, ...], published_description: DatasetDescription
) -> None:
    (row,) = (
        row
        for row in published_description.paper
        if (row.quantity, row.splits) == (quantity, splits)
    )
    assert row.here == row.paper


@pytest.mark.dataset
def test_the_documented_table_is_the_one_of_v1(published: Path, run: Run) -> None:
    status, out, _ = run("describe", str(published / "reverie-v1"))
    page = (REPOSITORY / "docs" / "how-to" / "describe-a-dataset.md").read_text()
    assert status == 0
    assert f"$ reverie-eval describe REVERIE\n{out}```\n" in page
