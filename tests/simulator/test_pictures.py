"""Pictures are those of the original, which were recorded, and of skyboxes made by hand."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageColor

from fixtures.published import simulator_folder
from reverie_eval.arrays import Array
from reverie_eval.simulator import MatterSim
from tests.conftest import unavailable
from tests.support.buildings import forget_buildings

SIZE = 32
COLOURS = ["red", "lime", "blue", "yellow", "cyan", "magenta"]
"""The colours of the faces in a strip."""
QUARTER = math.pi / 2


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a building of one viewpoint, its skybox with a colour for each face, and depths."""
    monkeypatch.setenv("MATTERSIM_CACHE", "")
    forget_buildings(monkeypatch)
    (tmp_path / "scans.txt").write_text("house")
    upright = [1.0, 0, 0, 0, 0, 0, 1.0, 0, 0, -1.0, 0, 0, 0, 0, 0, 1.0]
    viewpoint = {"image_id": "here", "included": True, "pose": upright, "unobstructed": [False]}
    (tmp_path / "house_connectivity.json").write_text(json.dumps([viewpoint]))
    skyboxes = tmp_path / "house" / "matterport_skybox_images"
    skyboxes.mkdir(parents=True)
    strip = Image.new("RGB", (6 * SIZE, SIZE))
    depth = np.zeros((SIZE, 6 * SIZE), np.uint16)
    for number, colour in enumerate(COLOURS):
        strip.paste(colour, (number * SIZE, 0, (number + 1) * SIZE, SIZE))
        depth[:, number * SIZE : (number + 1) * SIZE] = 10_000 * (number + 1)
    strip.save(skyboxes / "here_skybox_small.jpg", quality=100, subsampling=0)
    Image.fromarray(depth).save(skyboxes / "here_skybox_depth_small.png")
    return tmp_path


def simulator(graphs: Path, skyboxes: Path, *, depth: bool = False) -> MatterSim.Simulator:
    new = MatterSim.Simulator()
    new.setNavGraphPath(str(graphs))
    new.setDatasetPath(str(skyboxes))
    new.setDepthEnabled(depth)
    new.setElevationLimits(-1.5, 1.5)
    return new


def looking(new: MatterSim.Simulator, heading: float, elevation: float) -> MatterSim.SimState:
    new.newEpisode(["house"], ["here"], [heading], [elevation])
    state: MatterSim.SimState = new.getState()[0]
    return state


def colour_of(bgr: Array) -> str:
    """Return which of the colours a pixel has."""
    return min(
        COLOURS, key=lambda name: np.abs(ImageColor.getrgb(name) - bgr[::-1].astype(int)).max()
    )


@pytest.mark.dataset
def test_pictures_are_those_that_were_recorded(
    published: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = simulator_folder()
    if recorded is None:
        unavailable("what the original simulator gave is not here")
    monkeypatch.setenv("MATTERSIM_CACHE", str(tmp_path))
    forget_buildings(monkeypatch)
    folder = recorded / "render"
    views = json.loads((folder / "views.json").read_bytes())
    new = simulator(published / "reverie-v1" / "connectivity", folder / "scans")
    new.setCameraResolution(views["width"], views["height"])
    new.setCameraVFOV(views["vfov"])
    for view in views["views"]:
        named = (view[name] for name in ("scanId", "viewpointId", "heading", "elevation"))
        new.newEpisode(*([each] for each in named))
        expected = np.asarray(Image.open(folder / view["file"]).convert("RGB"))
        differences = np.abs(new.getState()[0].rgb[..., ::-1].astype(int) - expected)
        assert differences.mean() < 0.25
        assert np.quantile(differences, 0.9999) <= 4


@pytest.mark.parametrize(
    ("heading", "elevation", "colour"),
    [
        # A viewpoint whose pose is upright: by the rules of OpenGL's cube maps, worked out by hand.
        pytest.param(0, 0, "yellow", id="ahead"),
        pytest.param(QUARTER, 0, "cyan", id="right"),
        pytest.param(2 * QUARTER, 0, "lime", id="behind"),
        pytest.param(3 * QUARTER, 0, "blue", id="left"),
        pytest.param(0, 1.45, "red", id="up"),
        pytest.param(0, -1.45, "magenta", id="down"),
    ],
)
def test_where_the_faces_are(heading: float, elevation: float, colour: str, folder: Path) -> None:
    picture = looking(simulator(folder, folder), heading, elevation).rgb
    assert (picture.shape, picture.dtype) == ((240, 320, 3), np.uint8)
    assert colour_of(picture[120, 160]) == colour


def test_the_first_row_is_the_highest_and_the_last_column_is_on_the_right(folder: Path) -> None:
    new = simulator(folder, folder)
    new.setCameraVFOV(1.8)
    picture = looking(new, 0, 0).rgb
    edges = [picture[0, 160], picture[-1, 160], picture[120, 0], picture[120, -1]]
    assert list(map(colour_of, edges)) == ["red", "magenta", "blue", "cyan"]


def test_depth_is_along_the_axis(folder: Path) -> None:
    depth = looking(simulator(folder, folder, depth=True), 0, 0).depth
    assert (depth.shape, depth.dtype) == ((240, 320, 1), np.uint16)
    assert depth[120, 160] == pytest.approx(40_000, rel=1e-4)
    # A pixel near the corner: its ray is this much longer than its way along the axis.
    slope = math.tan(0.4)
    longer = math.hypot(1, slope * (1 - 1 / 240), slope * 320 / 240 * (1 - 1 / 320))
    assert depth[0, 0] == pytest.approx(40_000 / longer, abs=1)
    assert not looking(simulator(folder, folder), 0, 0).depth.any()


@pytest.fixture
def six_files(folder: Path) -> Path:
    """Write the faces as Matterport publishes them, for the first generation."""
    skyboxes = folder / "v1" / "scans" / "house" / "matterport_skybox_images"
    skyboxes.mkdir(parents=True)
    for number, colour in enumerate(COLOURS):
        face = Image.new("RGB", (SIZE, SIZE), colour)
        face.save(skyboxes / f"here_skybox{number}_sami.jpg", quality=100, subsampling=0)
    return skyboxes


def test_six_files_are_the_faces_of_a_strip(folder: Path, six_files: Path) -> None:
    new, strip = simulator(folder, folder), simulator(folder, folder)
    new.init()
    for heading, elevation in ((0.3, 0.2), (2.0, -1.2), (4.0, 1.2)):
        new.newEpisode("house", "here", heading, elevation)
        assert (new.getState().rgb == looking(strip, heading, elevation).rgb).all()


@pytest.mark.parametrize("generation", [1, 2])
def test_the_default_folder_is_another_one_in_each_generation(
    generation: int, folder: Path, six_files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scans = folder / "data" / "v1" / "scans"
    scans.parent.mkdir(parents=True)
    scans.symlink_to(folder / "v1" / "scans" if generation == 1 else folder)
    monkeypatch.chdir(folder)
    new = MatterSim.Simulator()
    new.setNavGraphPath(".")
    if generation == 1:
        new.init()
        new.newEpisode("house", "here", 0, 0)
        state = new.getState()
    else:
        state = looking(new, 0, 0)
    assert colour_of(state.rgb[120, 160]) == "yellow"


def test_six_files_must_be_there_and_of_one_size(folder: Path, six_files: Path) -> None:
    new = simulator(folder, folder)
    new.init()
    Image.new("RGB", (16, 16)).save(six_files / "here_skybox3_sami.jpg")
    with pytest.raises(
        ValueError, match="has 16 x 16 pixels; expected six square faces of one siz"
    ):
        new.newEpisode("house", "here", 0, 0)
    (six_files / "here_skybox3_sami.jpg").unlink()
    with pytest.raises(
        ValueError, match=r"Could not open skybox files at: .*here_skybox\*_sami\.jpg"
    ):
        new.newEpisode("house", "here", 0, 0)


def test_pictures_of_a_copied_state_stay(folder: Path, six_files: Path) -> None:
    new = simulator(folder, folder)
    new.init()
    new.newEpisode("house", "here", 0, 0)
    before = new.getState()
    new.makeAction(0, QUARTER, 0)
    assert colour_of(before.rgb[120, 160]) == "yellow"
    assert colour_of(new.getState().rgb[120, 160]) == "cyan"


def test_skyboxes_that_are_not_there(folder: Path) -> None:
    with pytest.raises(
        ValueError, match=r"skybox RGB files at: nowhere/house/.*/here_skybox_small"
    ):
        looking(simulator(folder, Path("nowhere")), 0, 0)
    (folder / "house" / "matterport_skybox_images" / "here_skybox_depth_small.png").unlink()
    with pytest.raises(ValueError, match="skybox depth files at"):
        looking(simulator(folder, folder, depth=True), 0, 0)


def test_a_picture_that_is_no_strip(folder: Path) -> None:
    skybox = folder / "house" / "matterport_skybox_images" / "here_skybox_small.jpg"
    Image.new("RGB", (SIZE, SIZE)).save(skybox)
    with pytest.raises(ValueError, match="has 32 x 32 pixels; expected six square faces"):
        looking(simulator(folder, folder), 0, 0)


def test_pictures_need_pillow(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(ImportError, match=r"pip install pillow.*setRenderingEnabled\(False\)"):
        looking(simulator(folder, folder), 0, 0)
