"""The picture of many methods' outcomes in every episode."""

import base64
from io import BytesIO
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from reverie_eval.reporting.outcomes import outcome_matrix

Image = pytest.importorskip("PIL.Image")

NEVER, WRONG_OBJECT, CORRECT = 0, 2, 4
GREEN, ORANGE, GREY, NOTHING = (0, 158, 115, 255), (230, 159, 0, 112), (125, 135, 145, 80), (0,) * 4


def test_episodes_are_arranged_by_building_and_by_how_many_solve_them() -> None:
    # Building b is harder than a. Within a, the first episode is solved by both methods.
    scans = ["a", "b", "a", "b"]
    outcome = np.array(
        [
            [CORRECT, NEVER, CORRECT, WRONG_OBJECT],
            [CORRECT, WRONG_OBJECT, NEVER, CORRECT],
        ]
    )
    picture = ET.fromstring(outcome_matrix(outcome, scans))
    assert [each.text for each in picture.iter("text")] == ["b", "a"]
    image = next(picture.iter("image"))
    assert image.get("image-rendering") == "pixelated"
    address = image.get("href", "")
    kind, _, content = address.partition(",")
    assert kind == "data:image/webp;base64"
    pixels = np.array(Image.open(BytesIO(base64.b64decode(content))).convert("RGBA"))
    assert [[tuple(pixel) for pixel in row] for row in pixels.tolist()] == [
        [GREY, ORANGE, NOTHING, GREEN, GREEN],
        [ORANGE, GREEN, NOTHING, GREY, GREEN],
    ]


def test_only_buildings_with_room_are_named() -> None:
    scans = ["small"] + ["large"] * 40
    picture = ET.fromstring(outcome_matrix(np.zeros((1, 41), dtype=int), scans))
    assert [each.text for each in picture.iter("text")] == ["large"]


def test_the_largest_picture_leaves_room_for_its_page() -> None:
    """60 methods on val_unseen, whose outcomes have nothing in common: a page may weigh 300 kB."""
    outcome = np.random.default_rng(0).integers(5, size=(60, 3521))
    assert len(outcome_matrix(outcome, ["scan"] * 3521)) < 120_000
