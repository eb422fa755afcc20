"""Pictures of answers: what they show, as data and as SVG."""

import re
import runpy
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.analysis import Episode, PredictedBox, VisibleObject
from reverie_eval.reporting.answer_svg import answer_picture, answer_svg
from reverie_eval.reporting.answers import AnswerView, answer_views, box_span, span_of
from tests.conftest import REPOSITORY, SAMPLES
from tests.support.home_world import OTHER_WALKS, home_scores

MARKUP = '<script src="x">&amp;"\''


@pytest.fixture(scope="module")
def scores(tmp_path_factory: pytest.TempPathFactory) -> rv.Scores:
    """Score an episode of every outcome."""
    return home_scores(tmp_path_factory.mktemp("home"))


@pytest.fixture(scope="module")
def drawn() -> rv.Scores:
    """Score answers by box."""
    return rv.evaluate(SAMPLES / "drawn.json", split="val_unseen")


def seen(number: int, boxes: dict[int, list[int]], name: str = "lamp") -> VisibleObject:
    """Return an object by its boxes in views."""
    return VisibleObject(
        number, f"{name} {number}", np.array(list(boxes)), np.array(list(boxes.values()))
    )


def showing(*objects: VisibleObject, view: int | None = 12) -> AnswerView:
    """Return a picture of a target, an answer and others, in this order."""
    target, predicted, *_ = objects
    return AnswerView("here", objects, target, predicted, None, "", view, "the stop", "caption")


def boxes_of(svg: str, role: str) -> list[ET.Element]:
    """Return the outlines of a role, those in the view first."""
    return [each for each in ET.fromstring(svg).iter() if each.get("class") == f"box {role}"]


# What they show.


HIDDEN = "which is not visible from here."
FROM_30 = "Seen from the stop, heading 30°, level."
FROM_THE_END = "Seen from the end of the annotated path, heading 0°, level. The target is object"


@pytest.mark.parametrize(
    ("instr_id", "captions"),
    [
        pytest.param(
            "1_3_0",
            ["Seen from the stop, heading 0°, level. The answer is the target, object 3."],
            id="correct",
        ),
        pytest.param(
            "1_3_1",
            [f"{FROM_30} The answer is object 4, {HIDDEN} The target is object 3."],
            id="answer not visible",
        ),
        pytest.param(
            "1_3_2",
            [
                f"The answer is the target, object 3, {HIDDEN}",
                f"{FROM_THE_END} 3.",
            ],
            id="right answer from elsewhere",
        ),
        pytest.param(
            "2_4_0",
            [
                f"{FROM_30} The answer is object 3. The target, object 4, {HIDDEN[6:]}",
                f"{FROM_THE_END} 4.",
            ],
            id="target not visible",
        ),
        pytest.param(
            "2_4_1",
            [
                "The agent predicted no object. The target, object 4, is not visible from here.",
                f"{FROM_THE_END} 4.",
            ],
            id="no answer",
        ),
    ],
)
def test_captions(instr_id: str, captions: list[str], scores: rv.Scores) -> None:
    views = answer_views({"": scores.episode(instr_id)})
    assert [view.caption for _, view in views] == captions


def test_nothing_is_visible(tmp_path: Path) -> None:
    episode = home_scores(tmp_path, OTHER_WALKS | {"1_3_0": (["hall", "stairs"], 3)}).episode(
        "1_3_0"
    )
    view = AnswerView.at_stop(episode)
    assert view.caption == (
        "The answer is the target, object 3, which is not visible from here. No object is visible "
        "from here."
    )
    assert (view.view, view.heading, boxes_of(answer_svg(view), "other")) == (None, None, [])


def test_the_target_is_shown_once_for_two_submissions(scores: rv.Scores, tmp_path: Path) -> None:
    other = home_scores(tmp_path, OTHER_WALKS)

    def names(instr_id: str) -> list[str]:
        both = {"a": scores.episode(instr_id), "b": other.episode(instr_id)}
        return [name for name, _ in answer_views(both)]

    assert names("1_3_0") == ["a", "b", ""]  # the lamp is visible from one stop
    assert names("1_3_1") == ["a", "b"]


def test_objects_have_the_categories_of_the_dataset(drawn: rv.Scores) -> None:
    episode = drawn.episode("1196_0_0")
    names = [each.name for each in episode.visible_objects(episode.goal)]
    assert names[:3] == ["bed 0", "nightstand 1", "nightstand 2"]
    assert episode.object_name(0) == "bed 0"
    assert episode.object_name(99_999) == "object 99999"


def episode_with(drawn: rv.Scores, outcome: str) -> Episode:
    episode: Episode = drawn.episode(drawn.instr_ids[drawn.box_outcomes.index(outcome)])
    return episode


@pytest.mark.parametrize(
    ("outcome", "said"),
    [
        ("correct", r"The predicted box has IoU [01]\.\d\d with the target's box\. The target is"),
        ("low IoU", r"The predicted box has IoU 0\.[0-4]\d with the target's box\. The target is"),
        ("wrong view", r"heading \d+°, level\. The target, .*, is visible from here, but not in"),
        ("target not visible", r"The target, .*, is not visible from here\."),
    ],
)
def test_a_box_is_shown_in_its_view(outcome: str, said: str, drawn: rv.Scores) -> None:
    episode = episode_with(drawn, outcome)
    view = AnswerView.at_stop(episode)
    assert episode.predicted_box is not None
    assert view.view == episode.predicted_box.view
    assert re.search(said, view.caption)
    assert [each.tag for each in boxes_of(answer_svg(view), "answer")] == ["polygon", "rect"]
    drawing = re.sub('href="data:[^"]*"', "", answer_svg(view))  # a photograph may spell anything
    assert ("IoU" in drawing) == (outcome in ("correct", "low IoU"))


def test_the_view_shows_answer_and_target_if_any_does(scores: rv.Scores) -> None:
    """Alone, the view with the largest box that is not cut is shown."""
    target = seen(1, {13: [600, 100, 40, 40]})
    answer = seen(2, {12: [100, 100, 300, 300], 13: [10, 100, 30, 30], 14: [0, 0, 640, 480]})
    episode = scores.episode("1_3_0")
    here = {"target_object": 1, "predicted_object": 2}
    for objects, view in (([target, answer], 13), ([answer], 12)):
        at = AnswerView.at_stop(_Sees(objects, replace(episode, **here)))  # type: ignore[arg-type]
        assert at.view == view


class _Sees:
    """An episode from which other objects are visible."""

    def __init__(self, objects: list[VisibleObject], episode: Episode) -> None:
        self._objects, self._episode = objects, episode

    def visible_objects(self, _: str) -> list[VisibleObject]:
        return self._objects

    def __getattr__(self, name: str) -> object:
        return getattr(self._episode, name)


# Geometry.


@pytest.mark.parametrize(
    ("view", "heading", "elevation"), [(12, 0, 0), (15, 90, 0), (3, 90, -30), (35, 330, 30)]
)
def test_a_box_in_the_middle_of_a_view_is_where_the_view_looks(
    view: int, heading: float, elevation: float
) -> None:
    span = span_of(seen(1, {view: [310, 230, 20, 20]}))
    assert span.middle == pytest.approx(heading, abs=1e-9)
    assert (span.low + span.high) / 2 == pytest.approx(elevation, abs=0.05)
    assert span.high - span.low == pytest.approx(2 * np.rad2deg(np.arctan(10 / 415.692)), abs=0.05)


def test_an_object_that_every_view_cuts_spans_all_of_them() -> None:
    """From the left edge of the view at 0 degrees to the right edge of that at 30."""
    span = span_of(seen(1, {12: [0, 200, 640, 80], 13: [0, 200, 640, 80]}))
    half = np.rad2deg(np.arctan(320 / 415.692))
    assert span.right - span.left == pytest.approx(2 * half + 30)
    whole = span_of(seen(1, {12: [0, 200, 640, 80], 13: [300, 200, 40, 40]}))
    assert whole.middle == pytest.approx(30)


def test_a_box_across_north_is_one_piece() -> None:
    span = box_span(np.array([[220, 230, 200, 20]]), np.zeros((1, 2)))
    assert span.right == -span.left == pytest.approx(np.rad2deg(np.arctan(100 / 415.692)))


# SVG.


def test_boxes_in_the_view_are_where_they_are_annotated() -> None:
    target, answer = seen(1, {12: [160, 80, 64, 32]}), seen(2, {13: [0, 0, 64, 64]})
    svg = answer_svg(showing(target, answer))
    in_view, in_panorama = boxes_of(svg, "target")
    place = [float(in_view.get(name, "")) for name in ("x", "y", "width", "height")]
    assert place == [100, 50, 40, 20]  # 400 units for 640 pixels
    assert in_panorama.findtext("title") == "lamp 1"
    assert len(boxes_of(svg, "answer")) == 1  # only in the panorama


def test_a_box_of_another_camera_is_carried_to_the_view() -> None:
    """A point right in front of a camera that looks 5 degrees to the right of the view."""
    camera = np.array([np.deg2rad(5), 0.0])
    box = PredictedBox(np.array([319.0, 239.0, 2.0, 2.0]), camera, 12)
    view = replace(showing(seen(1, {12: [0, 0, 9, 9]}), seen(2, {18: [0, 0, 9, 9]})), box=box)
    view = replace(view, predicted=None)
    (outline,) = (each for each in boxes_of(answer_svg(view), "answer") if each.tag == "polygon")
    points = np.array([pair.split(",") for pair in outline.get("points", "").split()], dtype=float)
    x, y = points.mean(axis=0) * 640 / 400
    assert x == pytest.approx(320 + 415.692 * np.tan(np.deg2rad(5)), abs=0.2)
    assert y == pytest.approx(240, abs=0.2)


def test_a_box_behind_the_view_of_its_camera_is_in_the_panorama_alone() -> None:
    """A camera that looks straight up shows at its upper edge what is behind it."""
    box = PredictedBox(np.array([300.0, 0.0, 40.0, 5.0]), np.array([0.0, np.pi / 2]), 24)
    view = showing(seen(1, {24: [0, 0, 9, 9]}), seen(2, {18: [0, 0, 9, 9]}), view=24)
    answers = boxes_of(answer_svg(replace(view, box=box, predicted=None)), "answer")
    assert {each.tag for each in answers} == {"rect"}
    assert "predicted box" not in answer_svg(replace(view, predicted=None))


def test_what_lies_behind_is_at_both_ends_of_the_panorama() -> None:
    behind = seen(1, {18: [300, 200, 40, 40]})
    svg = answer_svg(showing(behind, seen(2, {12: [300, 200, 40, 40]})))
    left, right = (float(each.get("x", "")) for each in boxes_of(svg, "target"))
    assert right - left == pytest.approx(400)
    assert left < 0 < right < 400


def test_every_place_of_a_label_is_free() -> None:
    """Labels that matter are always there; others only where there is room."""
    same = {12: [100, 100, 200, 150]}
    crowd = [seen(number, same) for number in range(20)]
    root = ET.fromstring(answer_svg(showing(*crowd)))
    labels = [
        (each.get("class", "").split()[1], float(each.get("y", "")))
        for each in root.iter("text")
        if each.get("class", "").startswith("label ") and "role" not in each.get("class", "")
    ]
    assert [role for role, _ in labels[:2]] == ["answer", "target"]
    assert 2 < len(labels) < 20
    assert all(abs(one - other) >= 15 for (_, one), (_, other) in combinations(labels, 2))


def test_roles_differ_without_colour(scores: rv.Scores) -> None:
    svg = answer_picture(AnswerView.at_stop(scores.episode("1_3_0")))
    assert "answer and target: object 3" in svg
    rules = {
        role: "".join(re.findall(rf"\n\.answer-view \.box\.{role} {{(.*?)}}", svg))
        for role in ("other", "target", "answer")
    }
    looks = [re.sub(r"stroke: var.*?;", "", rule).strip() for rule in rules.values()]
    assert len(set(looks)) == 3
    assert "stroke-dasharray" in rules["answer"]


def test_the_picture_in_the_docs_is_drawn_by_this_code() -> None:
    pictures = REPOSITORY / "docs" / "pictures"
    drawn = runpy.run_path(str(pictures / "answer.py"))["picture"]()
    assert (pictures / "answer.svg").read_text() == drawn


def test_it_says_what_it_shows_and_escapes_it() -> None:
    objects = [replace(seen(number, {12: [9, 9, 9, 9]}), name=MARKUP) for number in (1, 2)]
    root = ET.fromstring(answer_svg(replace(showing(*objects), viewpoint_id=MARKUP)))
    assert root.get("role") == "img"
    assert root.findtext("title") == f"What is visible from viewpoint {MARKUP}"
    description = root.findtext("desc")
    assert description is not None
    assert description.startswith("caption 2 objects are visible from here: ")
    assert MARKUP in description
    assert not list(root.iter("script"))
    assert not any("style" in each.attrib for each in root.iter())


def drawn_room(view: AnswerView) -> ET.Element | None:
    return ET.fromstring(answer_svg(view)).find(".//g[@class='solids']")


def test_a_view_without_photographs_shows_a_room(drawn: rv.Scores) -> None:
    """The target is drawn after all that could hide it; boxes are outlined above the room."""
    view = replace(AnswerView.at_stop(drawn.episode("1196_0_0")), skybox=None)
    room = drawn_room(view)
    assert room is not None
    kinds = [each.get("class") for each in room]
    assert {"floor", "skirting", "opening", "wood top", "cloth top"} <= set(kinds)
    assert view.room_view
    assert view.target
    faces = view.room_view.faces()
    assert faces[-1].object_id == view.target.object_id
    shown = [each.get("class") for each in ET.fromstring(answer_svg(view))[2]]
    assert shown.index("solids") < shown.index("box target")


def test_what_is_left_out_has_no_label(drawn: rv.Scores) -> None:
    view = replace(AnswerView.at_stop(drawn.episode("1196_0_0")), skybox=None)
    assert view.room_view

    def labels() -> set[str | None]:
        texts = ET.fromstring(answer_svg(view)).iter("text")
        return {each.text for each in texts if each.get("class") == "label other"}

    shown = [each for each in view.objects if each.name in labels()]
    assert shown
    view.room_view.left_out = {each.object_id for each in shown}
    assert not labels()


def test_a_photograph_takes_the_place_of_the_room(drawn: rv.Scores) -> None:
    view = AnswerView.at_stop(drawn.episode("1196_0_0"))
    assert (view.skybox is not None, drawn_room(view)) == (True, None)
