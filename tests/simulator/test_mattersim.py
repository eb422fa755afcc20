"""``MatterSim`` in a made-up building: rules worked out by hand, both generations, and errors."""

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reverie_eval.simulator import MatterSim
from tests.support.buildings import forget_buildings

TURN = math.pi / 6
POSITIONS = {
    "centre": (0.0, 0.0, 1.5),
    "north": (0.0, 2.0, 1.5),
    "east": (3.0, 0.0, 5.5),
    "excluded": (0.0, 1.0, 1.5),
    "apart": (0.0, -2.0, 1.5),
    "above": (0.0, 0.0, 4.5),
}
NEAR = {"north", "east", "excluded", "above"}
"""What the centre has as unobstructed."""


def viewpoint(name: str) -> dict[str, Any]:
    x, y, z = POSITIONS[name]
    return {
        "image_id": name,
        "included": name != "excluded",
        "pose": [1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, y, 0.0, 0.0, 1.0, z, 0.0, 0.0, 0.0, 1.0],
        "unobstructed": [name == "centre" and other in NEAR for other in POSITIONS],
    }


@pytest.fixture
def graphs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write the building, for simulators that know no other one."""
    monkeypatch.setenv("MATTERSIM_CACHE", str(tmp_path / "cache"))
    forget_buildings(monkeypatch)
    (tmp_path / "scans.txt").write_text("house other\n")
    write(tmp_path, list(map(viewpoint, POSITIONS)))
    (tmp_path / "other_connectivity.json").write_text("[]")
    return tmp_path


def write(graphs: Path, content: object) -> None:
    (graphs / "house_connectivity.json").write_text(json.dumps(content))


def simulator(graphs: Path, *, discretized: bool = True, batch: int = 1) -> MatterSim.Simulator:
    new = MatterSim.Simulator()
    new.setNavGraphPath(str(graphs))
    new.setRenderingEnabled(False)
    new.setDiscretizedViewingAngles(discretized)
    new.setBatchSize(batch)
    new.setCameraResolution(640, 480)
    new.setCameraVFOV(math.radians(60))
    return new


def started(graphs: Path, heading: float = 0.0, **named: Any) -> MatterSim.Simulator:
    new = simulator(graphs, **named)
    new.initialize()
    new.newEpisode(["house"], ["centre"], [heading], [0.0])
    return new


def first(of: MatterSim.Simulator) -> MatterSim.SimState:
    state: MatterSim.SimState = of.getState()[0]
    return state


def names(state: MatterSim.SimState) -> list[str]:
    return [each.viewpointId for each in state.navigableLocations]


@pytest.mark.parametrize(
    ("degrees", "up", "index"),
    [
        pytest.param(0, 0, 12, id="ahead"),
        pytest.param(14.9, 0, 12, id="nearer to 0"),
        pytest.param(15, 0, 13, id="a half goes up"),
        pytest.param(345, 0, 12, id="twelve is nought"),
        pytest.param(-30, 0, 23, id="negative"),
        pytest.param(750, 0, 13, id="more than a turn"),
        pytest.param(0, 16, 24, id="up"),
        pytest.param(0, -90, 0, id="down, whatever the limits"),
        pytest.param(0, 14, 12, id="level"),
    ],
)
def test_discretized_angles(degrees: float, up: float, index: int, graphs: Path) -> None:
    new = simulator(graphs)
    new.initialize()
    new.newEpisode(["house"], ["centre"], [math.radians(degrees)], [math.radians(up)])
    state = first(new)
    assert state.viewIndex == index
    assert state.heading == index % 12 * (math.pi * 2 / 12)
    assert state.elevation == (index // 12 - 1) * TURN


def test_fifteen_degrees_up_are_level(graphs: Path) -> None:
    new = simulator(graphs)
    new.initialize()
    new.newEpisode(["house"], ["centre"], [0], [math.pi / 12])
    assert first(new).viewIndex == 12


def test_other_angles_are_kept_within_the_limits(graphs: Path) -> None:
    new = started(graphs, discretized=False)
    new.makeAction([0], [-0.1], [2.0])
    assert (first(new).heading, first(new).elevation) == (math.pi * 2 - 0.1, 0.94)
    assert not new.setElevationLimits(0.1, 0.5)
    assert not new.setElevationLimits(-2.0, 0.5)
    assert new.setElevationLimits(-0.2, 0.3)
    new.makeAction([0], [0.0], [0.0])
    assert first(new).elevation == 0.3
    assert first(new).viewIndex == 0


def test_only_the_sign_of_a_discretized_turn_counts(graphs: Path) -> None:
    new = started(graphs)
    for turn, tilt, index in [(0.001, 9, 25), (7, 1, 26), (-3, 0, 25), (0, -1, 13), (0, -1, 1)]:
        new.makeAction([0], [turn], [tilt])
        assert first(new).viewIndex == index
    assert first(new).step == 5


def test_where_one_can_go(graphs: Path) -> None:
    north, east = 0, math.pi / 2
    assert names(first(started(graphs, north))) == ["centre", "north"]
    assert names(first(started(graphs, east))) == ["centre", "east"]
    state = first(started(graphs, east))
    here, other = state.navigableLocations
    assert (other.ix, other.x, other.y, other.z) == (2, 3.0, 0.0, 5.5)
    assert other.rel_distance == 5.0
    assert other.rel_elevation == math.atan2(4.0, 3.0)
    assert other.rel_heading == pytest.approx(0, abs=1e-7)
    assert (here.rel_heading, here.rel_elevation, here.rel_distance) == (0, 0, 0)


def test_without_restriction_one_can_go_where_one_does_not_look(graphs: Path) -> None:
    new = simulator(graphs)
    new.setRestrictedNavigation(False)
    new.initialize()
    new.newEpisode(["house"], ["centre"], [math.pi], [0.0])
    above, east, north = (math.pi / 2, math.hypot(math.pi / 2, math.atan2(4, 3)), math.pi)
    assert above < east < north  # from the centre of the view
    assert names(first(new)) == ["centre", "above", "east", "north"]
    headings = [abs(each.rel_heading) for each in first(new).navigableLocations]
    assert headings == pytest.approx([0, 0, math.pi / 2, math.pi], abs=1e-6)


def test_the_field_of_view_can_change_at_any_time(graphs: Path) -> None:
    new = started(graphs, math.pi / 3)  # east is 30 degrees to the right, north 60 to the left
    assert names(first(new)) == ["centre", "east"]
    new.setCameraResolution(1280, 480)
    new.makeAction([0], [0], [0])
    assert names(first(new)) == ["centre", "north", "east"]
    new.setCameraVFOV(0.1)
    new.makeAction([0], [0], [0])
    assert names(first(new)) == ["centre"]


def test_states_of_the_second_generation_are_live(graphs: Path) -> None:
    new = started(graphs)
    state, kept = first(new), first(new).navigableLocations
    assert first(new) is state
    assert kept[0] is state.location
    assert kept[1].rel_distance == 2.0
    new.makeAction([1], [0], [0])
    assert state.location is kept[1]
    assert kept[1].rel_distance == 0.0
    assert names(state) == ["north"]
    with pytest.raises(AttributeError):
        state.heading = 1.0
    with pytest.raises(AttributeError):
        kept[0].ix = 3


def test_states_of_the_first_generation_are_copies(graphs: Path) -> None:
    new = simulator(graphs)
    new.init()
    new.newEpisode("house", "centre", 0, 0)
    before = new.getState()
    new.makeAction(1, 0.0, 0.0)
    after = new.getState()
    assert (before.step, before.location.viewpointId) == (0, "centre")
    assert before.navigableLocations[1].rel_distance == 2.0
    assert (after.step, after.location.viewpointId) == (1, "north")
    assert after.location.point == [0.0, 2.0, 1.5]


def test_the_first_generation_starts_anywhere_without_a_viewpoint(graphs: Path) -> None:
    starts = set()
    new = simulator(graphs)
    for seed in range(60):
        new.setSeed(seed)
        new.newEpisode("house")
        starts.add(new.getState().location.viewpointId)
    assert starts == POSITIONS.keys() - {"excluded"}


def test_the_second_generation_can_start_anywhere(graphs: Path) -> None:
    new = simulator(graphs, batch=2)
    new.newRandomEpisode(["house", "house"])
    places = [state.location.viewpointId for state in new.getState()]
    assert set(places) <= POSITIONS.keys() - {"excluded"}
    assert all(state.elevation == 0 for state in new.getState())


def test_arrays_are_lists(graphs: Path) -> None:
    new = started(graphs)
    new.makeAction(np.array([1]), np.array([0.0]), np.array([0.0], np.float32))
    assert first(new).location.viewpointId == "north"


def test_settings_after_initialization_are_ignored(graphs: Path) -> None:
    new = started(graphs)
    new.setDiscretizedViewingAngles(False)
    new.setRestrictedNavigation(False)
    new.setBatchSize(5)
    new.setNavGraphPath("/nowhere")
    new.makeAction([0], [0.1], [0.0])
    assert first(new).viewIndex == 13
    assert len(new.getState()) == 1


def test_all_simulators_of_the_second_generation_use_the_first_graphs(graphs: Path) -> None:
    started(graphs)
    other = simulator(graphs / "nowhere")
    other.newEpisode(["house"], ["centre"], [0], [0])
    assert names(first(other)) == ["centre", "north"]


def test_states_before_an_episode(graphs: Path) -> None:
    new = simulator(graphs, batch=3)
    new.initialize()
    assert [(s.scanId, s.location, s.navigableLocations) for s in new.getState()] == [
        ("", None, [])
    ] * 3
    assert first(new).rgb.shape == (480, 640, 3)
    assert first(new).depth.shape == (480, 640, 1)


Call = Callable[[MatterSim.Simulator], object]
OF_THE_SECOND: Sequence[Any] = [
    pytest.param(
        lambda s: s.newEpisode(["x"], ["centre"], [0], [0]), IndexError, "map::at", id="scan"
    ),
    pytest.param(
        lambda s: s.newEpisode(["house"], ["x"], [0], [0]), ValueError, "Could not find", id="name"
    ),
    pytest.param(
        lambda s: s.newEpisode(["house"], ["excluded"], [0], [0]), ValueError, "excluded", id="out"
    ),
    pytest.param(
        lambda s: s.newEpisode(["house"], ["centre"], [], [0]), IndexError, None, id="short"
    ),
    pytest.param(lambda s: s.newEpisode("house", "centre", 0, 0), TypeError, "list", id="scalars"),
    pytest.param(lambda s: s.makeAction([7], [0], [0]), ValueError, "index: 7 in env", id="index"),
    pytest.param(lambda s: s.makeAction([-1], [0], [0]), TypeError, "from 0", id="negative"),
    pytest.param(lambda s: s.makeAction([0.0], [0], [0]), TypeError, "float", id="float"),
    pytest.param(lambda s: s.makeAction(0, 0, 0), TypeError, "list", id="scalar action"),
    pytest.param(lambda s: s.makeAction([], [], []), IndexError, None, id="short action"),
]


@pytest.mark.parametrize(("call", "error", "message"), OF_THE_SECOND)
def test_errors_of_the_second_generation(
    call: Call, error: type[Exception], message: str | None, graphs: Path
) -> None:
    new = started(graphs)
    with pytest.raises(error, match=message):
        call(new)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        pytest.param(
            lambda s: s.newEpisode("x", "y", 0, 0), ValueError, "is scan id valid", id="scan"
        ),
        pytest.param(
            lambda s: s.newEpisode("house", "x", 0, 0), ValueError, "Could not", id="name"
        ),
        pytest.param(
            lambda s: s.newEpisode(["house"], ["centre"], [0], [0]), TypeError, None, id="lists"
        ),
        pytest.param(lambda s: s.makeAction(-1, 0, 0), ValueError, "index: -1$", id="negative"),
        pytest.param(lambda s: s.makeAction(4, 0, 0), ValueError, "index: 4$", id="index"),
        pytest.param(lambda s: s.makeAction("0", 0, 0), TypeError, None, id="text"),
    ],
)
def test_errors_of_the_first_generation(
    call: Call, error: type[Exception], message: str | None, graphs: Path
) -> None:
    new = simulator(graphs)
    new.init()
    with pytest.raises(error, match=message):
        call(new)


def test_acting_before_an_episode(graphs: Path) -> None:
    new = simulator(graphs)
    with pytest.raises(RuntimeError, match="newEpisode must be called before makeAction"):
        new.makeAction([0], [0], [0])
    new.initialize()
    with pytest.raises(ValueError, match="Invalid action index"):
        new.makeAction([0], [0], [0])


def test_what_came_before_an_error_has_happened(graphs: Path) -> None:
    new = simulator(graphs, batch=2)
    new.newEpisode(["house"] * 2, ["centre"] * 2, [0, 0], [0, 0])
    with pytest.raises(ValueError, match="index: 9 in environment 1 of 2"):
        new.makeAction([1, 9], [1, 1], [0, 0])
    moved, other = new.getState()
    assert (moved.location.viewpointId, moved.step, moved.heading) == ("north", 1, 0)
    assert (other.location.viewpointId, other.step) == ("centre", 0)
    with pytest.raises(IndexError):
        new.newEpisode(["nowhere", "house"], ["centre"] * 2, [TURN, TURN], [0, 0])
    assert (moved.scanId, moved.heading, other.scanId) == ("nowhere", TURN, "house")


def change(**fields: object) -> Callable[[list[Any]], object]:
    def changed(viewpoints: list[Any]) -> object:
        viewpoints[1].update(fields)
        return viewpoints

    return changed


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        pytest.param(lambda _: {}, "house_connectivity.json: it is not a list", id="no list"),
        pytest.param(lambda v: [3, *v], "viewpoint 0: it is not an object", id="no object"),
        pytest.param(lambda v: [{}, *v], "0: it has no image_id and no included", id="empty"),
        pytest.param(change(pose=[1.0]), r"1 \(north\): pose has no 16 numbers", id="pose"),
        pytest.param(change(pose=["1"] * 16), "pose has no 16 numbers", id="text"),
        pytest.param(change(unobstructed=[True]), "for each of 6 viewpoints", id="row"),
        pytest.param(change(image_id=7), "image_id is not a string", id="name"),
    ],
)
def test_a_broken_file_is_named_with_its_fault(
    damage: Callable[[list[Any]], object], message: str, graphs: Path
) -> None:
    write(graphs, damage(list(map(viewpoint, POSITIONS))))
    with pytest.raises(ValueError, match=message):
        started(graphs)


def test_a_file_that_is_cut_off(graphs: Path) -> None:
    (graphs / "house_connectivity.json").write_text('[{"image_id": "centre", "incl')
    with pytest.raises(ValueError, match=r"house_connectivity\.json: Unterminated"):
        started(graphs)


def test_files_that_are_not_there(graphs: Path) -> None:
    (graphs / "other_connectivity.json").unlink()
    with pytest.raises(ValueError, match=r"other_connectivity\.json, is path valid"):
        started(graphs)
    (graphs / "scans.txt").unlink()
    with pytest.raises(ValueError, match="list of scans"):
        started(graphs)


def test_a_file_is_read_again_only_when_it_has_changed(
    graphs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []
    parse = MatterSim._parse

    def counted(file: str) -> np.ndarray:
        read.append(file)
        return parse(file)

    def again() -> MatterSim.SimState:
        forget_buildings(monkeypatch)
        return first(started(graphs))

    monkeypatch.setattr(MatterSim, "_parse", counted)
    assert names(again()) == names(again()) == ["centre", "north"]
    assert len(read) == 1
    (table,) = (graphs / "cache").iterdir()
    table.write_bytes(table.read_bytes()[:-9])
    assert names(again()) == ["centre", "north"]
    assert len(read) == 2
    write(graphs, [{**viewpoint("centre"), "unobstructed": [False]}])
    assert names(again()) == ["centre"]
    assert len(read) == 3


def test_a_table_that_cannot_be_kept_leaves_no_file(
    graphs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first(started(graphs))
    (table,) = (graphs / "cache").iterdir()
    table.unlink()
    table.mkdir()
    forget_buildings(monkeypatch)
    assert names(first(started(graphs))) == ["centre", "north"]
    assert list((graphs / "cache").iterdir()) == [table]


def test_nothing_is_kept_where_nothing_can_be_written(
    graphs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("", str(graphs / "scans.txt" / "below")):
        monkeypatch.setenv("MATTERSIM_CACHE", place)
        forget_buildings(monkeypatch)
        assert names(first(started(graphs))) == ["centre", "north"]


@pytest.mark.parametrize(
    ("y", "x", "expected"),
    [
        # What atan2f of the GNU C library 2.36 returns, as hexadecimal floats.
        pytest.param(1.0, 1.0, "0x1.921fb60000000p-1", id="45 degrees"),
        pytest.param(1.0, 0.0, "0x1.921fb60000000p+0", id="90 degrees"),
        pytest.param(0.0, -1.0, "0x1.921fb60000000p+1", id="180 degrees"),
        pytest.param(-0.0, -1.0, "-0x1.921fb60000000p+1", id="the other way round"),
        pytest.param(0.0, 0.0, "0x0.0p+0", id="nowhere"),
        pytest.param(0.0, -0.0, "0x1.921fb60000000p+1", id="nowhere, negative"),
        pytest.param(0.25, 1.0, "0x1.f5b7600000000p-3", id="below 7/16"),
        pytest.param(0.5, 1.0, "0x1.dac6700000000p-2", id="below 11/16"),
        pytest.param(0.75, 1.0, "0x1.4978fa0000000p-1", id="below 19/16"),
        pytest.param(-1.5, 1.0, "-0x1.f730be0000000p-1", id="below 39/16"),
        pytest.param(3.0, -1.0, "0x1.e47df40000000p+0", id="above"),
        pytest.param(1e30, 1e-30, "0x1.921fb60000000p+0", id="beyond float32"),
        pytest.param(-1e-30, 1e30, "-0x0.0p+0", id="too small"),
        pytest.param(0.1, -0.7, "0x1.7ff6060000000p+1", id="behind"),
    ],
)
def test_arctangents_have_the_bits_of_the_original(y: float, x: float, expected: str) -> None:
    (angle,) = MatterSim._atan2f(np.array([y], np.float32), np.array([x], np.float32)).tolist()
    assert angle.hex() == float.fromhex(expected).hex()


def test_arctangents_are_right() -> None:
    around = np.linspace(-math.pi, math.pi, 10_001, dtype=np.float32)[1:-1]
    y, x = np.sin(around), np.cos(around)
    angles = MatterSim._atan2f(y, x)
    assert np.abs(angles - np.arctan2(y.astype(float), x.astype(float))).max() < 3e-7
