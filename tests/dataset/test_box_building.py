"""Boxes in the published layout from houses and poses: rules, files and the command."""

import json
import shutil
import subprocess
import sys
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reverie_eval import DatasetError, ReverieEvalError
from reverie_eval.dataset import (
    EXCLUDED_NAMES,
    BoxSettings,
    House,
    Occlusion,
    Scan,
    find_scans,
    list_objects,
    parse_house,
)
from reverie_eval.dataset import _box_building as build
from reverie_eval.dataset._box_building import exclude_names, is_hidden
from reverie_eval.dataset._reader import BOXES
from tests.conftest import REPOSITORY, SAMPLES
from tests.support.flat_world import Outcome, Run

EYE = np.zeros(3)
LARGE, MIDDLE, SMALL = [0, 0, 90, 90], [10, 10, 40, 40], [20, 20, 5, 5]


@pytest.mark.parametrize(
    ("boxes", "distances", "expected"),
    [
        pytest.param([LARGE, SMALL], [1, 2], [False, True], id="covered by what is nearer"),
        pytest.param([LARGE, SMALL], [2, 1], [False, False], id="before what is farther"),
        pytest.param([LARGE, SMALL], [1, 1], [False, False], id="equally near"),
        pytest.param([LARGE, LARGE], [1, 2], [False, True], id="equal boxes"),
        pytest.param([LARGE, LARGE], [1, 1], [False, False], id="equal boxes, equally near"),
        pytest.param([LARGE, [0, 0, 91, 5]], [1, 2], [False, False], id="one pixel too wide"),
        pytest.param([MIDDLE, [10, 9, 5, 5]], [1, 2], [False, False], id="one pixel too high"),
        pytest.param([MIDDLE, [45, 45, 5, 5]], [1, 2], [False, True], id="in the corner"),
        pytest.param(
            [SMALL, MIDDLE, LARGE], [3, 2, 1], [True, True, False], id="a hidden one hides too"
        ),
        pytest.param(
            [SMALL, MIDDLE, LARGE], [2, 1, 3], [True, False, False], id="the middle of three hides"
        ),
    ],
)
def test_what_is_hidden(
    boxes: list[list[int]], distances: list[float], expected: list[bool]
) -> None:
    """In any order, and whatever is in other views."""
    columns = list(zip(boxes, distances, expected, strict=True))
    for order in permutations([(12, *column) for column in columns]):
        view, box, distance, hidden = zip(*order, (13, LARGE, 0.1, False), strict=True)
        found = is_hidden(np.array(view), np.array(box), np.array(distance, dtype=float))
        assert found.tolist() == list(hidden)


NAMES = ("vase", "wall", "shower wall", "", "table")


def furnished(*things: tuple[str, tuple[float, float, float], float]) -> House:
    """Return a house with cubes: name, centre and half extent."""
    categories = [f"C {i} 0 {name.replace(' ', '#') or '-'} 0 -" for i, name in enumerate(NAMES)]
    objects = [
        f"O {i} -1 {NAMES.index(name)} {x} {y} {z} 1 0 0 0 1 0 {radius} {radius} {radius}"
        for i, (name, (x, y, z), radius) in enumerate(things)
    ]
    header = f"H x - 0 0 0 0 0 {len(objects)} {len(categories)} 0 0 0"
    return parse_house("\n".join(["ASCII 1.1", header, *categories, *objects]), "x")


@pytest.mark.parametrize(
    ("max_distance", "listed"),
    [
        pytest.param(3.0, [0, 1], id="exactly 3 m is too far"),
        pytest.param(3.0 + 1e-9, [0, 1, 2], id="a little more"),
        pytest.param(2.0, [0], id="v1"),
    ],
)
def test_only_nearer_objects_are_listed(max_distance: float, listed: list[int]) -> None:
    """In three dimensions, to the centre: 1, 2 (1.2 of it up), and 3 m."""
    house = furnished(
        ("vase", (0, 1, 0), 0.1), ("vase", (0, 1.6, 1.2), 0.1), ("vase", (1, 2, 2), 2)
    )
    assert list(list_objects(house, EYE, BoxSettings(max_distance=max_distance))) == listed


def test_listed_without_boxes() -> None:
    """An object may be hidden in every view, or straight below, where no view looks."""
    house = furnished(
        ("table", (0, 1, 0), 0.5), ("vase", (0, 2, 0), 0.1), ("vase", (0, 0, -1), 0.1)
    )
    seen = list_objects(house, EYE, BoxSettings(occlusion="paper"))
    assert [bool(boxes) for boxes in seen.values()] == [True, False, False]
    assert 12 in list_objects(house, EYE, BoxSettings())[1]


def test_only_equal_names_are_excluded() -> None:
    house = furnished(*[(name, (0, 1, 0), 0.1) for name in NAMES])
    assert exclude_names(house).names == ("vase", "shower wall", "", "table")


def test_excluded_objects_hide_nothing() -> None:
    house = exclude_names(furnished(("wall", (0, 1, 0), 0.5), ("vase", (0, 2, 0), 0.1)))
    assert 12 in list_objects(house, EYE, BoxSettings(occlusion="paper"))[1]


def test_walls_are_excluded_and_doorways_are_not() -> None:
    assert {"wall", "door", "ceiling", "floor", "stairs"} < EXCLUDED_NAMES
    assert not {"doorway", "garage door", "shower wall", ""} & EXCLUDED_NAMES


@pytest.fixture
def house_folder(demo_world: Path, tmp_path: Path) -> Path:
    """Lay the demo world's houses out as Matterport does, one of them a level deeper."""
    for file in (demo_world / "houses").iterdir():
        scan = file.stem
        inner = Path(scan, scan) if scan == "DemoMansion" else Path(scan)
        folder = tmp_path / "matterport" / inner / "house_segmentations"
        folder.mkdir(parents=True)
        shutil.copy(file, folder)
    return tmp_path / "matterport"


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def scans(demo_world: Path) -> tuple[Scan, ...]:
    return find_scans(demo_world / "houses", demo_world / "connectivity").complete


@pytest.fixture(scope="module")
def built(
    scans: tuple[Scan, ...], tmp_path_factory: pytest.TempPathFactory
) -> dict[Occlusion, Path]:
    """Build the boxes of the demo world by both rules."""
    folder = tmp_path_factory.mktemp("boxes")
    rules: tuple[Occlusion, ...] = ("none", "paper")
    for occlusion in rules:
        build.build_boxes(scans, folder / occlusion, BoxSettings(occlusion=occlusion))
    return {occlusion: folder / occlusion for occlusion in rules}


def test_every_included_viewpoint_gets_a_file(
    built: dict[Occlusion, Path], demo_world: Path
) -> None:
    published = contents(demo_world / "tasks" / "REVERIE" / "data" / "BBox")
    assert contents(built["none"]).keys() == published.keys()


def test_files_have_the_published_form(built: dict[Occlusion, Path]) -> None:
    for path in built["none"].iterdir():
        (viewpoint_id,) = BOXES.validate_json(path.read_bytes())
        assert path.stem.rpartition("_")[2] == viewpoint_id


def test_a_viewpoint_where_nothing_is_listed(
    built: dict[Occlusion, Path], scans: tuple[Scan, ...], tmp_path: Path
) -> None:
    build.build_boxes(scans, tmp_path / "near", BoxSettings(max_distance=0.001))
    files = contents(tmp_path / "near")
    assert files.keys() == contents(built["none"]).keys()
    assert all(list(json.loads(file).values()) == [{}] for file in files.values())


def boxes_of(folder: Path) -> dict[tuple[str, str, int], list[int]]:
    """Read boxes by viewpoint, object and view."""
    return {
        (viewpoint, key, view): box
        for path in folder.iterdir()
        for viewpoint, objects in json.loads(path.read_bytes()).items()
        for key, thing in objects.items()
        for view, box in zip(thing["visible_pos"], thing["bbox2d"], strict=True)
    }


def listed_in(folder: Path) -> dict[tuple[str, str], tuple[str, bool]]:
    """Read names, and whether a box is there, by viewpoint and object."""
    return {
        (viewpoint, key): (thing["name"], bool(thing["bbox2d"]))
        for path in folder.iterdir()
        for viewpoint, objects in json.loads(path.read_bytes()).items()
        for key, thing in objects.items()
    }


def test_the_demo_worlds_boxes_are_built_by_the_command(
    built: dict[Occlusion, Path], demo_world: Path
) -> None:
    """Except for objects behind walls, which are not listed, and behind others, without a box."""
    published = demo_world / "tasks" / "REVERIE" / "data" / "BBox"
    listed, visible = listed_in(published), listed_in(built["paper"])
    assert listed.items() <= visible.items() | {
        (pair, (name, False)) for pair, (name, _) in visible.items()
    }
    shown = {pair for pair, (_, has_boxes) in listed.items() if has_boxes}
    made = boxes_of(built["paper"])
    assert boxes_of(published) == {key: made[key] for key in made if key[:2] in shown}
    assert 0 < len(shown) < len(listed) < len(visible)


def test_the_demo_world_is_the_same_in_every_process(demo_world: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "fixtures.demo_world", str(tmp_path)]
    subprocess.run(command, cwd=REPOSITORY, check=True)
    files = [path.relative_to(demo_world) for path in demo_world.rglob("*") if path.is_file()]
    assert [(tmp_path / file).read_bytes() for file in files] == [
        (demo_world / file).read_bytes() for file in files
    ]
    assert contents(tmp_path / "submissions") == contents(SAMPLES)


def test_the_papers_rule_only_removes_boxes(built: dict[Occlusion, Path]) -> None:
    everything, left = boxes_of(built["none"]), boxes_of(built["paper"])
    assert left.items() < everything.items()
    assert listed_in(built["none"]).keys() == listed_in(built["paper"]).keys()


def test_files_do_not_depend_on_the_number_of_processes(
    built: dict[Occlusion, Path], scans: tuple[Scan, ...], tmp_path: Path
) -> None:
    folder = tmp_path / "boxes"
    counts = build.build_boxes(scans, folder, BoxSettings(), jobs=2)
    assert contents(folder) == contents(built["none"])
    assert counts == build.build_boxes(scans, tmp_path / "again", BoxSettings())
    assert counts.boxes == len(boxes_of(folder))
    assert counts[:2] == (len(contents(folder)), len(listed_in(folder)))


def test_an_empty_folder_is_filled_in_place(
    scans: tuple[Scan, ...],
    built: dict[Occlusion, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Even if it is the working folder of the shell."""
    monkeypatch.chdir(tmp_path)
    build.build_boxes(scans, Path(), BoxSettings())
    assert contents(Path.cwd()) == contents(built["none"])


def test_the_folder_has_the_usual_permissions(built: dict[Occlusion, Path], tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    assert built["none"].stat().st_mode == (tmp_path / "other").stat().st_mode


def test_every_problem_of_every_scan_and_nothing_written(demo_world: Path, tmp_path: Path) -> None:
    for kind in ("houses", "connectivity"):
        shutil.copytree(demo_world / kind, tmp_path / kind)
    (tmp_path / "houses" / "DemoTerrace.house").write_text("ASCII 1.0")
    (tmp_path / "houses" / "DemoCottage.house").write_text("ASCII 1.1\nQ\nC")
    (tmp_path / "connectivity" / "DemoTerrace_connectivity.json").write_text("{}")
    no_file, no_target = (
        tmp_path / "houses" / f"Demo{name}.house" for name in ("Deanery", "Palazzo")
    )
    for house in (no_file, no_target):
        house.unlink()
    no_file.mkdir()
    no_target.symlink_to("elsewhere")
    scans = find_scans(tmp_path / "houses", tmp_path / "connectivity").complete
    with pytest.raises(DatasetError) as rejected:
        build.build_boxes(scans, tmp_path / "boxes", BoxSettings(), jobs=2)
    places = [(Path(problem.where).name, problem.code) for problem in rejected.value.problems]
    assert places == [
        ("DemoCottage.house:2", "malformed-house"),
        ("DemoCottage.house:3", "malformed-house"),
        ("DemoDeanery.house", "unreadable-file"),
        ("DemoPalazzo.house", "unreadable-file"),
        ("DemoTerrace_connectivity.json", "malformed-file"),
        ("DemoTerrace.house:1", "malformed-house"),
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["connectivity", "houses"]


def test_a_repeated_viewpoint(demo_world: Path, tmp_path: Path) -> None:
    places = json.loads(next((demo_world / "connectivity").iterdir()).read_text())
    places[0]["included"] = places[1]["included"] = True
    places[1]["image_id"] = places[0]["image_id"]
    file = tmp_path / "x_connectivity.json"
    file.write_text(json.dumps(places))
    scan = Scan("x", next((demo_world / "houses").rglob("*.house")), file)
    with pytest.raises(DatasetError) as rejected:
        build.build_boxes([scan], tmp_path / "boxes", BoxSettings())
    (problem,) = rejected.value.problems
    assert (problem.code, problem.where) == ("duplicate-viewpoint", str(file))
    repeated = f"ids used by more than one included viewpoint: {places[0]['image_id']}. "
    assert repeated in problem.message
    places[1]["included"] = False
    file.write_text(json.dumps(places))
    build.build_boxes([scan], tmp_path / "boxes", BoxSettings())
    assert (tmp_path / "boxes" / f"x_{places[0]['image_id']}.json").is_file()


@pytest.mark.parametrize("image_id", ["", "../hall", "up\\stairs"])
def test_a_viewpoint_id_that_cannot_be_a_file_name(
    image_id: str, demo_world: Path, tmp_path: Path
) -> None:
    place = {"image_id": image_id, "pose": [0.0] * 16, "included": True, "unobstructed": [False]}
    file = tmp_path / "x_connectivity.json"
    file.write_text(json.dumps([place]))
    scan = Scan("x", next((demo_world / "houses").rglob("*.house")), file)
    with pytest.raises(DatasetError, match=r"\[0\].image_id"):
        build.build_boxes([scan], tmp_path / "boxes", BoxSettings())


def test_a_folder_with_content_is_left_alone(scans: tuple[Scan, ...], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").touch()
    with pytest.raises(ReverieEvalError, match="is not an empty folder; choose another, or remove"):
        build.build_boxes(scans, tmp_path, BoxSettings())
    with pytest.raises(ReverieEvalError, match="is not an empty folder"):
        build.build_boxes(scans, tmp_path / "notes.txt", BoxSettings())
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_an_interrupted_build_leaves_nothing_behind(
    scans: tuple[Scan, ...], tmp_path: Path
) -> None:
    def interrupted(outcomes: Any, description: str, total: int, /) -> Any:
        next(iter(outcomes))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build.build_boxes(scans, tmp_path / "boxes", BoxSettings(), progress=interrupted)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def command(house_folder: Path, demo_world: Path, tmp_path: Path, run: Run) -> Any:
    """Return a function that runs the command on the demo world."""

    def command(*words: str) -> Outcome:
        where = (str(house_folder), str(demo_world / "connectivity"), "-o", str(tmp_path / "out"))
        return run("boxes", *where, "--jobs", "1", *words)

    return command


def test_the_command(command: Run, built: dict[Occlusion, Path], tmp_path: Path) -> None:
    status, out, err = command("--occlusion", "paper")
    assert (status, err) == (0, "")
    first, second = out.splitlines()
    counts = "7 scans, 206 viewpoints, 2,720 listed objects, 17,888 boxes"
    assert first == f"{tmp_path / 'out'}: {counts}"
    assert second.endswith(
        "4.9 % of the boxes there do not contain their object's centre (documentation: "
        "Build boxes from Matterport's files)"
    )
    assert contents(tmp_path / "out") == contents(built["paper"])


def test_options_of_the_command(command: Run, built: dict[Occlusion, Path], tmp_path: Path) -> None:
    status, _, _ = command("--max-distance", "1.5", "--scan", "DemoCottage")
    listed, everything = listed_in(tmp_path / "out"), listed_in(built["none"])
    assert status == 0
    assert listed.items() < everything.items()
    assert {path.name.partition("_")[0] for path in (tmp_path / "out").iterdir()} == {"DemoCottage"}


def test_scans_with_files_of_one_kind_are_named(
    command: Run, house_folder: Path, tmp_path: Path
) -> None:
    shutil.rmtree(house_folder / "DemoCottage")
    (house_folder / "Elsewhere.house").touch()
    status, _, err = command()
    assert status == 0
    assert err.splitlines() == [
        "note: no .house file for 1 scan, left out: DemoCottage",
        "note: no connectivity file for 1 scan, left out: Elsewhere",
    ]
    assert not list((tmp_path / "out").glob("DemoCottage*"))


def test_a_requested_scan_must_exist(command: Run, house_folder: Path) -> None:
    status, out, err = command("--scan", "DemoCottage", "--scan", "Elsewhere")
    assert (status, out) == (1, "")
    assert f"{house_folder}: no SCAN.house for 1 scan: Elsewhere" in err
    assert "no SCAN_connectivity.json for 1 scan: Elsewhere" in err


def test_two_houses_of_a_scan(command: Run, house_folder: Path, tmp_path: Path) -> None:
    shutil.copytree(house_folder / "DemoCottage", house_folder / "copy")
    status, _, err = command()
    assert status == 1
    assert "the scan also has the file" in err
    assert not (tmp_path / "out").exists()


def test_folders_without_any_file(run: Run, tmp_path: Path) -> None:
    status, _, err = run("boxes", str(tmp_path), str(tmp_path), "-o", str(tmp_path / "out"))
    assert (status, list(tmp_path.iterdir())) == (1, [])
    assert "there is no SCAN.house" in err
    assert "there is no SCAN_connectivity.json" in err


def test_missing_folders(run: Run, tmp_path: Path) -> None:
    houses, connectivity = tmp_path / "houses", tmp_path / "connectivity"
    connectivity.touch()
    status, _, err = run("boxes", str(houses), str(connectivity), "-o", str(tmp_path / "out"))
    assert status == 1
    assert err.splitlines()[1:] == [
        f"{houses}: there is no such folder",
        f"{connectivity}: there is no such folder",
    ]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--max-distance", "0"), "0.0 is not in the range x>0"),
        (("--max-distance", "nan"), "nan is not a finite number"),
        (("--max-distance", "abc"), "'abc' is not a valid number"),
        (("--jobs", "0"), "0 is not in the range x>=1"),
        (("--jobs", "x"), "'x' is not a valid whole number"),
        (("--occlusion", "some"), "unknown value 'some'"),
    ],
)
def test_invalid_options(command: Run, words: tuple[str, ...], reason: str) -> None:
    status, out, err = command(*words)
    assert (status, out) == (2, "")
    assert reason in err
