"""Reading Matterport's ``.house`` files."""

from pathlib import Path

import numpy as np
import pytest

from fixtures.demo_world.floor_plans import BLUEPRINTS
from fixtures.demo_world.houses import house_text
from fixtures.demo_world.world import demo_world
from reverie_eval import DatasetError
from reverie_eval.dataset import House, parse_house, read_house

H = "H demo - 0 1 0 0 0 4 2 1 1 1 0 0 0 0 0 -5 -5 0 5 5 3 0 0 0 0 0"
LINES = [
    "ASCII 1.1",
    H,
    "L 0 1 - 0 0 1 -5 -5 0 5 5 3 0 0 0 0 0",
    "R 0 0 0 0 d 0 0 1 -5 -5 0 5 5 3 2.8 0 0 0 0",
    "P 0 0 1 - 0 0 0 1 1 2 0 0 0 0",
    "P 0123456789abcdef 0 0 0 0 0 1.5 0 0 0 0 0",
    "C 0 12 dining#room#chair 3 chair 0 0 0 0 0",
    "C 1 7 - 41 unlabeled 0 0 0 0 0",
    "O  3 -1 -1  1 2 3  0 0 1  1 0 0  .9 .5 .2  0 0 0 0 0 0 0 0",
    "O  0 0 0  0.5 0 0.25  2 0 0  0 3 0  1 0.5 0.25  0 0 0 0 0 0 0 0",
    "O  1 0 0  0 0 0  1 0 0  0 1 0  -1 -1 -1  0 0 0 0 0 0 0 0",
    "O  2 0 1  0 0 0  1 0 0  0 1 0  1 1 0  0 0 0 0 0 0 0 0",
]
"""A chair with id 0; 1 has no faces, 2 has no name and is flat, 3 has no category nor region."""


def house(lines: list[str] = LINES) -> House:
    return parse_house("\n".join(lines), "x.house")


def spoiled(line: int, text: str) -> list[str]:
    """Return the file with another line in the place of one, which counts from 1."""
    return [*LINES[: line - 1], text, *LINES[line:]]


def problems(lines: list[str]) -> list[tuple[str, str]]:
    with pytest.raises(DatasetError) as rejected:
        house(lines)
    assert {problem.code for problem in rejected.value.problems} == {"malformed-house"}
    return [(problem.where, problem.message) for problem in rejected.value.problems]


def test_objects_come_in_the_order_of_their_ids() -> None:
    assert house().object_id.tolist() == [0, 2, 3]


def test_names_are_raw_categories_with_spaces() -> None:
    assert house().names == ("dining room chair", "", "")


def test_boxes_have_the_centres_axes_and_half_extents_of_the_file() -> None:
    boxes = house().boxes
    assert boxes.centre.tolist() == [[0.5, 0, 0.25], [0, 0, 0], [1, 2, 3]]
    assert boxes.axes[0].tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert boxes.axes[2].tolist() == [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    assert boxes.radii.tolist() == [[1, 0.5, 0.25], [1, 1, 0], [0.9, 0.5, 0.2]]


def test_a_portal_with_the_letter_of_regions() -> None:
    """Matterport's own viewer writes it so."""
    viewer = spoiled(5, LINES[4].replace("P", "R", 1))
    assert house(viewer).object_id.tolist() == house().object_id.tolist()


def test_spaces_blank_lines_and_windows_line_ends_mean_nothing() -> None:
    text = "\r\n\r\n".join(line.replace(" ", "   ") for line in LINES[1:])
    assert parse_house(f"ASCII 1.1\r\n{text}\r\n", "x").names == house().names


def test_a_file_without_objects() -> None:
    empty = [LINES[0], H.replace("0 1 0 0 0 4 2 1 1 1", "0 0 0 0 0 0 0 0 0 0")]
    assert [len(house(empty).boxes), *house(empty).object_id] == [0]


@pytest.mark.parametrize(
    ("first", "message"),
    [
        pytest.param(
            "ASCII 1.0", "found version '1.0', expected '1.1'; fetch the file again", id="version"
        ),
        pytest.param("{", "found '{', expected 'ASCII 1.1'; this is not a .house file", id="text"),
        pytest.param("", "found '', expected 'ASCII 1.1'; this is not a .house file", id="empty"),
    ],
)
def test_files_that_are_not_of_this_version(first: str, message: str) -> None:
    assert problems([first, *LINES[1:]]) == [("x.house:1", message)]


@pytest.mark.parametrize(
    ("line", "text", "message"),
    [
        pytest.param(
            3,
            "Q 0",
            "no line begins with 'Q'; expected one of H L R P S V I C O E",
            id="unknown letter",
        ),
        pytest.param(
            4,
            LINES[3] + " 0",
            "a R line of 21 words; a region has 20, a portal 15",
            id="neither region nor portal",
        ),
        pytest.param(
            7,
            "C zero 12 chair 3 chair",
            "category index 'zero' (word 2); expected a whole number",
            id="index of a category",
        ),
        pytest.param(7, "C 0 12", "3 words; the name is word 4: the line is cut off", id="cut C"),
        pytest.param(
            9,
            "O 3 -1 -2 1 2 3 0 0 1 1 0 0 1 1 1",
            "category index '-2' (word 4); expected a whole number",
            id="negative category",
        ),
        pytest.param(
            9,
            "O 3 -1 -1 1 2 3 0 0 1 1 0 0 1 1",
            "15 words; the radii is word 16: the line is cut off",
            id="cut O",
        ),
        pytest.param(
            9,
            "O 3 -1 -1 1 nan 3 0 0 1 1 0 0 1 1 1",
            "centre '1 nan 3' (words 5 to 7); expected three numbers",
            id="NaN",
        ),
        pytest.param(
            9,
            "O 3 -1 -1 1 2 x 0 0 1 1 0 0 1 1 1",
            "centre '1 2 x' (words 5 to 7); expected three numbers",
            id="no number",
        ),
        pytest.param(
            9,
            "O 3 -1 -1 1 2 3 0 0 1 0 0 -2 1 1 1",
            "axes (0.0, 0.0, 1.0) and (0.0, 0.0, -2.0); expected two at right angles",
            id="parallel axes",
        ),
        pytest.param(
            9,
            "O 3 -1 -1 1 2 3 0 0 0 0 0 1 1 1 1",
            "axes (0.0, 0.0, 0.0) and (0.0, 0.0, 1.0); expected two at right angles",
            id="no axis",
        ),
        pytest.param(
            9,
            "O 3 -1 -1 1 2 3 0 0 1 9e-4 0 1 1 1 1",
            "axes (0.0, 0.0, 1.0) and (0.0009, 0.0, 1.0); expected two at right angles",
            id="almost parallel axes",
        ),
        pytest.param(
            9,
            "O 3 -1 -1 1 2 3 0 0 1e200 0 0 2e200 1 1 1",
            "axes (0.0, 0.0, 1e+200) and (0.0, 0.0, 2e+200); expected two at right angles",
            id="endless parallel axes",
        ),
        pytest.param(
            9,
            "O 3 -1 -1 1 -1000000.5 3 0 0 1 1 0 0 1 1 1",
            "centre '1 -1000000.5 3' (words 5 to 7); expected at most 1,000,000 metres",
            id="centre out of this world",
        ),
        pytest.param(
            9,
            "O 3 -1 -1 1 2 3 0 0 1 1 0 0 1 1 1e300",
            "radii '1 1 1e300' (words 14 to 16); expected at most 1,000,000 metres",
            id="object as large as the world",
        ),
        pytest.param(
            9,
            "O 2147483648 -1 -1 1 2 3 0 0 1 1 0 0 1 1 1",
            "object index '2147483648' (word 2); expected a whole number of at most 2,147,483,647",
            id="object id beyond 32 bits",
        ),
        pytest.param(
            9,
            "O 3 -1 5 1 2 3 0 0 1 1 0 0 1 1 1",
            "category 5 of object 3 has no C line",
            id="unknown category",
        ),
        pytest.param(
            10,
            "O 3 -1 -1 1 2 3 0 0 1 1 0 0 1 1 1",
            "object 3 already has line 9",
            id="object twice",
        ),
        pytest.param(
            8,
            "C 0 7 table 41 unlabeled 0 0 0 0 0",
            "category 0 already has line 7",
            id="category twice",
        ),
        pytest.param(
            2,
            H.replace("4 2", "5 2"),
            "the header announces 5 object lines, the file has 4; fetch it again",
            id="count",
        ),
        pytest.param(
            2,
            H.replace("0 0 0 4", "0 0 x 4"),
            "number of segment lines 'x' (word 8); expected a whole number",
            id="count that is no number",
        ),
        pytest.param(2, "", "0 H lines in the file; expected one", id="no header"),
    ],
)
def test_a_malformed_line(line: int, text: str, message: str) -> None:
    assert problems(spoiled(line, text)) == [(f"x.house:{line}", message)]


def test_an_object_without_faces_needs_no_axes() -> None:
    faceless = "O  1 0 0  0 0 0  0 0 0  0 0 0  -1 -1 -1  0 0 0 0 0 0 0 0"
    assert house(spoiled(11, faceless)).object_id.tolist() == [0, 2, 3]


def test_an_object_with_one_negative_half_extent_has_no_size() -> None:
    hollow = "O  1 0 0  0 0 0  1 0 0  0 1 0  .5 -1 .5  0 0 0 0 0 0 0 0"
    assert house(spoiled(11, hollow)).object_id.tolist() == [0, 2, 3]


@pytest.mark.parametrize("size", ["1e-200", "1e-3", "1e6", "1e200", "1.7e308"])
def test_axes_of_any_length(size: str) -> None:
    """Only their directions matter, and no length of theirs is squared."""
    long = f"O  1 0 0  0 0 0  0 {size} 0  -{size} 0 0  1 2 3  0 0 0 0 0 0 0 0"
    assert house(spoiled(11, long)).boxes.axes[1].tolist() == [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]


def test_axes_that_are_far_from_right_angles_are_turned() -> None:
    askew = "O  1 0 0  0 0 0  0 0 1  0.0011 0 1  1 2 3  0 0 0 0 0 0 0 0"
    assert house(spoiled(11, askew)).boxes.axes[1].round(9).tolist() == [
        [0, 0, 1],
        [1, 0, 0],
        [0, 1, 0],
    ]


def test_numbers_at_their_limits() -> None:
    last = "O  2147483647 0 0  1e6 -1e6 0  1 0 0  0 1 0  1e6 1 1  0 0 0 0 0 0 0 0"
    found = house(spoiled(11, last))
    assert found.object_id.tolist() == [0, 2, 3, 2147483647]
    assert found.boxes.centre[3].tolist() == [1e6, -1e6, 0]


def test_every_malformed_line_is_named_in_order() -> None:
    places = [2, 4, 7, 9, 12]
    cut = [line[:5] if number in places else line for number, line in enumerate(LINES, start=1)]
    assert [where for where, _ in problems(cut)] == [f"x.house:{place}" for place in places]


def test_a_file_that_ends_early_lacks_objects(tmp_path: Path) -> None:
    file = tmp_path / "x.house"
    file.write_text("\n".join(LINES[:-2]))
    with pytest.raises(DatasetError, match="the header announces 4 object lines, the file has 2"):
        read_house(file)


@pytest.mark.parametrize("scan_id", [blueprint.scan_id for blueprint in BLUEPRINTS])
def test_the_houses_of_the_demo_world(scan_id: str) -> None:
    """What is read is what was built, up to the six digits of the file."""
    site = demo_world().sites[scan_id]
    found = parse_house(house_text(site.building, site.things), scan_id)
    assert found.object_id.tolist() == [thing.object_id for thing in site.things]
    assert found.names == tuple(thing.name for thing in site.things)
    assert found.boxes.centre.tolist() == [list(thing.solid.centre) for thing in site.things]
    corners = np.sort(found.boxes.corners().round(4), axis=1)
    built = [sorted(thing.solid.corners()) for thing in site.things]
    assert corners == pytest.approx(np.sort(np.array(built).round(4), axis=1), abs=2e-4)
