"""REVERIE's objects in the states of ``MatterSim``, from each form of the files."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reverie_eval.simulator import MatterSim
from tests.support.buildings import forget_buildings

LEFT, RIGHT, ROUND = [0, 10, 20, 30], [600, 10, 40, 30], [300, 200, 50, 60]
LISTED = {
    "12": {"name": "end#table", "visible_pos": [12, 13], "bbox2d": [RIGHT, LEFT]},
    "7": {"name": "vase", "visible_pos": [13], "bbox2d": [ROUND]},
    "9": {"name": "hidden", "visible_pos": [], "bbox2d": []},
}
VASE = MatterSim.Candidate(7, "vase", [13], [ROUND])
TABLE = MatterSim.Candidate(12, "end#table", [12, 13], [RIGHT, LEFT])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a building of two viewpoints, where objects are listed at the first."""
    monkeypatch.setenv("MATTERSIM_CACHE", "")
    forget_buildings(monkeypatch)
    (tmp_path / "scans.txt").write_text("house")
    records: list[dict[str, Any]] = [
        {"image_id": name, "included": True, "unobstructed": [name != "here", name == "here"]}
        for name in ("here", "there")
    ]
    for y, record in enumerate(records):
        record["pose"] = [1, 0, 0, 0, 0, 1, 0, y, 0, 0, 1, 0, 0, 0, 0, 1]
    (tmp_path / "house_connectivity.json").write_text(json.dumps(records))
    (tmp_path / "BBox").mkdir()
    (tmp_path / "BBox" / "house_here.json").write_text(json.dumps({"here": LISTED}))
    (tmp_path / "BBoxes.json").write_text(json.dumps({"house_here": LISTED}))
    np.savez(
        tmp_path / "bundle.npz",
        allow_pickle=False,
        scan_id=np.array(["attic", "house"]),
        viewpoint_id=np.array(["elsewhere", "here", "there"]),
        viewpoint_scan=np.array([0, 1, 1]),
        candidate_viewpoint=np.array([1, 1]),
        candidate_object=np.array([7, 12]),
        box_candidate=np.array([0, 1, 1]),
        box_view=np.array([13, 12, 13]),
        box_xywh=np.array([ROUND, RIGHT, LEFT]),
        **{"text/candidate_category": np.frombuffer(b'["vase", "end#table"]', np.uint8)},
    )
    return tmp_path


def simulator(folder: Path, objects: str = "", *, discretized: bool = True) -> MatterSim.Simulator:
    new = MatterSim.Simulator()
    new.setNavGraphPath(str(folder))
    new.setRenderingEnabled(False)
    new.setDiscretizedViewingAngles(discretized)
    new.setRestrictedNavigation(False)
    if objects:
        new.setObjectsPath(str(folder / objects))
    return new


@pytest.mark.parametrize("form", ["BBox", "BBoxes.json", "bundle.npz"])
def test_objects_are_those_of_the_view_and_candidates_those_of_the_viewpoint(
    form: str, folder: Path
) -> None:
    new = simulator(folder, form)
    new.newEpisode(["house"], ["here"], [0.0], [0.0])
    (state,) = new.getState()
    assert state.candidates == [VASE, TABLE]
    assert state.objects == [(12, "end#table", RIGHT)]
    new.makeAction([0], [1.0], [0.0])
    assert [(it.objectId, it.name, it.bbox2d) for it in state.objects] == [
        (7, "vase", ROUND),
        (12, "end#table", LEFT),
    ]
    new.makeAction([0], [1.0], [1.0])
    assert (state.viewIndex, state.objects, len(state.candidates)) == (26, [], 2)
    new.makeAction([1], [0.0], [0.0])
    assert (state.objects, state.candidates) == ([], [])


def test_without_objects_there_are_none(folder: Path) -> None:
    new = simulator(folder)
    new.newEpisode(["house"], ["here"], [0.0], [0.0])
    (state,) = new.getState()
    assert (state.objects, state.candidates) == ([], [])


def test_angles_that_are_not_discretized_are_no_view(folder: Path) -> None:
    new = simulator(folder, "BBox", discretized=False)
    new.newEpisode(["house"], ["here"], [math.radians(30)], [0.0])
    (state,) = new.getState()
    assert (state.objects, state.candidates) == ([], [VASE, TABLE])


def test_a_copied_state_keeps_its_objects(folder: Path) -> None:
    new = simulator(folder, "BBox")
    new.init()
    new.newEpisode("house", "here", 0.0, 0.0)
    before = new.getState()
    new.makeAction(1, 0.0, 0.0)
    assert (before.candidates, new.getState().candidates) == ([VASE, TABLE], [])


def test_the_path_counts_before_initialization_only(folder: Path) -> None:
    new = simulator(folder)
    new.initialize()
    new.setObjectsPath(str(folder / "BBox"))
    new.newEpisode(["house"], ["here"], [0.0], [0.0])
    assert new.getState()[0].candidates == []


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        pytest.param("none.json", None, r"Could not open objects at: .*none\.json", id="no file"),
        pytest.param("none.npz", None, r"Could not open objects at: .*none\.npz", id="no bundle"),
        pytest.param("cut.json", b'{"house_here": {', r"cut\.json: Expecting", id="cut off"),
        pytest.param(
            "list.json", b"[]", r"list\.json: it is not an object with a key", id="a list"
        ),
        pytest.param(
            "text.npz", b"text", "it is not a bundle with the solution", id="not a bundle"
        ),
        pytest.param(
            "cut.npz", b"PK\3\4", "it is not a bundle with the solution", id="a bundle, cut off"
        ),
    ],
)
def test_a_file_that_has_no_objects_is_named(
    name: str, content: bytes | None, says: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=f"^MatterSim: .*{says}"):
        MatterSim.Simulator().setObjectsPath(str(tmp_path / name))


def test_a_folder_of_something_else_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"it has no file of a viewpoint's objects$"):
        MatterSim.Objects(str(tmp_path))


def test_a_public_bundle_has_no_objects(tmp_path: Path) -> None:
    np.savez(tmp_path / "public.npz", viewpoint_id=np.array(["here"]))
    with pytest.raises(ValueError, match=r"public\.npz: it is not a bundle with the solution$"):
        MatterSim.Objects(str(tmp_path / "public.npz"))


@pytest.mark.parametrize(
    "listed",
    [
        pytest.param({"twelve": LISTED["7"]}, id="an id that is no number"),
        pytest.param({"7": {"name": "vase", "visible_pos": [13]}}, id="no boxes"),
        pytest.param(
            {"7": {"visible_pos": [12, 13], "bbox2d": [ROUND]}}, id="one box for two views"
        ),
        pytest.param({"7": []}, id="a list"),
        pytest.param([], id="a list of objects"),
    ],
)
def test_the_viewpoint_of_a_broken_object_is_named(listed: object, tmp_path: Path) -> None:
    (tmp_path / "BBoxes.json").write_text(json.dumps({"house_here": listed}))
    objects = MatterSim.Objects(str(tmp_path / "BBoxes.json"))
    with pytest.raises(ValueError, match="an object of house_here has not an id, and as many"):
        objects.visible_from("house", "here")
    assert objects.visible_from("house", "there") == []


def test_the_path_is_a_text() -> None:
    with pytest.raises(TypeError, match="expected a string, not 5"):
        MatterSim.Simulator().setObjectsPath(5)  # type: ignore[arg-type]
