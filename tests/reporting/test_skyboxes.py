"""Photographs under pictures of answers."""

import os
import re
from base64 import b64decode
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import reverie_eval as rv
from fixtures.demo_world.panoramas import FACES, SCANS, colour_of, draw_skybox
from fixtures.demo_world.world import demo_world
from reverie_eval.analysis import Episode
from reverie_eval.geometry import pixels_of
from reverie_eval.reporting.answer_svg import answer_svg
from reverie_eval.reporting.answers import AnswerView
from reverie_eval.reporting.skyboxes import (
    DEMO_PANORAMAS,
    PANORAMAS_VARIABLE,
    Skybox,
    find_skybox,
    warn_once,
)
from reverie_eval.simulator import colours_of_skybox
from tests.conftest import SAMPLES

BEDROOM = "1196_0_0"
"""An episode of the demo world whose goal sees eleven objects."""

IN_FRONT = frozenset({"lamp", "picture", "window"})
"""Objects that nothing hides."""
SLIVER = 30
"""Pixels of a box in which JPEG mixes the colour with those around."""


@pytest.fixture(scope="module")
def episode() -> Episode:
    scores = rv.evaluate(SAMPLES / "good.json", split="val_unseen")
    found: Episode = scores.episode(BEDROOM)
    return found


@pytest.fixture
def path(episode: Episode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where the photograph of the goal is expected."""
    warn_once.cache_clear()
    monkeypatch.setenv(PANORAMAS_VARIABLE, str(tmp_path))
    folder = tmp_path / episode.scan / "matterport_skybox_images"
    folder.mkdir(parents=True)
    return folder / f"{episode.goal}_skybox_small.jpg"


def pixels(address: str) -> np.ndarray:
    """Decode a picture."""
    kind, _, encoded = address.partition(",")
    assert kind == "data:image/jpeg;base64"
    return np.asarray(Image.open(BytesIO(b64decode(encoded)))).astype(float)


@pytest.fixture
def skybox(episode: Episode, path: Path, drawn: bytes) -> Skybox:
    """Return the drawn photograph of the goal."""
    path.write_bytes(drawn)
    found = find_skybox(episode.graph, episode.goal)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def drawn(episode: Episode) -> bytes:
    """Draw what is around the goal."""
    site, written = demo_world().sites[episode.scan], BytesIO()
    viewpoint = next(v for v in site.building.viewpoints if v.viewpoint_id == episode.goal)
    Image.fromarray(draw_skybox(site, viewpoint)).save(written, "JPEG", quality=95)
    return written.getvalue()


@pytest.mark.parametrize("face", range(6))
def test_faces_are_where_the_simulator_has_them(face: int) -> None:
    """Each pixel of the strip has its face, row and column as its colour."""
    number, row, column = np.meshgrid(range(6), range(100), range(100), indexing="ij")
    strip = np.concatenate(np.stack([number, row, column], axis=-1).astype(np.uint8), axis=1)
    forward, right, lower = np.array(FACES[face], dtype=float)
    around = np.array([[forward, forward + 0.9 * right], [forward, forward + 0.9 * lower]])
    shown = colours_of_skybox(strip, around).astype(int)
    expected = [[[face, 50, 50], [face, 50, 95]], [[face, 50, 50], [face, 95, 50]]]
    assert np.abs(shown - expected).max() <= 1
    assert (shown[..., 0] == face).all()


def test_objects_are_where_their_boxes_are(episode: Episode, skybox: Skybox) -> None:
    """The colour of what hangs on a wall or stands on top is in the middle of its box."""
    things = demo_world().sites[episode.scan].things
    pictures = {view: pixels(skybox.view(view)) for view in (2, 3, 9, 14, 15, 28)}
    fits = []
    for seen in episode.visible_objects(episode.goal):
        if seen.name.split()[0] not in IN_FRONT:
            continue
        colour = colour_of(things[seen.object_id])
        for view, (x, y, width, height) in zip(seen.view.tolist(), seen.xywh.tolist(), strict=True):
            if view in pictures and min(width, height) > SLIVER:
                row, column = 0.625 * (y + height / 2), 0.625 * (x + width / 2)
                shown = pictures[view][int(row), int(column)]
                shade = (shown @ colour) / (colour @ colour)
                fits.append(np.abs(shown - shade * colour).max() < 20 and 0.6 < shade < 1.1)
    assert len(fits) > 8
    assert all(fits)


def test_the_panorama_shows_what_the_views_show(skybox: Skybox) -> None:
    panorama, view = pixels(skybox.panorama(90, 60)), pixels(skybox.view(15))
    rows, columns, _ = panorama.shape
    across = panorama[rows // 2, columns // 2 - 40 : columns // 2 + 41]
    turns = np.deg2rad((np.arange(-40, 41) + 0.5) * 360 / columns)
    rays = np.stack([np.tan(turns), 0 * turns, 1 + 0 * turns], axis=-1)
    x = 0.625 * pixels_of(rays)[:, 0]
    along = view[len(view) // 2, x.astype(int)]
    assert np.median(np.abs(across - along)) < 8


def test_a_picture_has_the_photograph_below_its_boxes(episode: Episode, path: Path) -> None:
    Image.new("RGB", (6 * 8, 8), "red").save(path)
    view = AnswerView.at_path_end(episode)
    assert view is not None
    svg = answer_svg(view)
    assert svg.count("<image ") == 2
    assert not re.findall("wall|floor", svg)
    assert svg.index("<image ") < svg.index('class="box ')
    picture = re.search(r'href="(data:[^"]*)"', svg)
    assert picture is not None
    assert pixels(picture[1]).mean(axis=(0, 1)) == pytest.approx([254, 0, 0], abs=2)


def test_a_picture_is_drawn_again_only_if_its_photograph_has_changed(
    skybox: Skybox, path: Path
) -> None:
    before = skybox.view(15)
    assert skybox.view(15) is before
    assert skybox.view(14) != before
    Image.new("RGB", (6 * 8, 8), "red").save(path)
    os.utime(path, ns=(0, 0))
    assert pixels(skybox.view(15)).mean(axis=(0, 1)) == pytest.approx([254, 0, 0], abs=2)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        pytest.param(b"no picture", "cannot identify image file", id="no picture"),
        pytest.param((40, 8), "40 x 8 pixels, expected six squares", id="five squares"),
        pytest.param(None, "", id="no file"),
    ],
)
def test_a_photograph_that_cannot_be_used_is_left_out(
    content: bytes | tuple[int, int] | None,
    said: str,
    episode: Episode,
    path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    if isinstance(content, tuple):
        Image.new("RGB", content).save(path)
    elif content is not None:
        path.write_bytes(content)
    view = AnswerView.at_path_end(episode)
    assert view is not None
    svg = answer_svg(view)
    assert "<image " not in svg
    assert 'class="wall"' in svg
    assert len(caplog.records) == bool(said)
    assert said in caplog.text


def test_a_folder_that_is_not_there(
    episode: Episode, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    warn_once.cache_clear()
    monkeypatch.setenv(PANORAMAS_VARIABLE, "/nowhere")
    assert [find_skybox(episode.graph, episode.goal) for _ in range(2)] == [None, None]
    assert [record.message for record in caplog.records] == [
        "REVERIE_EVAL_PANORAMAS=/nowhere is not a folder; pictures have no photographs"
    ]


def test_the_demo_world_has_drawn_photographs_of_its_own(
    episode: Episode, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(PANORAMAS_VARIABLE, raising=False)
    found = find_skybox(episode.graph, episode.goal)
    assert found is not None
    sites = demo_world().sites
    viewpoints = {
        each.viewpoint_id: (sites[scan], each)
        for scan in SCANS
        for each in sites[scan].building.viewpoints
    }
    shipped = [*DEMO_PANORAMAS.rglob("*.webp")]
    assert {path.stem for path in shipped} == viewpoints.keys()
    with Image.open(found.path) as picture:
        assert np.array_equal(np.asarray(picture), draw_skybox(*viewpoints[episode.goal]))
