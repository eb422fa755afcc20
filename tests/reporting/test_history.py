"""Timelines and ranks over time: what they say, and where it is drawn."""

import re
from collections.abc import Sequence
from itertools import pairwise
from xml.etree import ElementTree as ET

import pytest

from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.history import PastResult, Timeline, rank_over_time, rank_svg

RESULTS = (
    PastResult("First", "2020-06", 0.10, "v1"),
    PastResult("Worse", "2021", 0.08, "v1"),
    PastResult("Same day, better", "2022-03-01", 0.30, "v1"),
    PastResult("Same day", "2022-03-01", 0.20, "v1"),
    PastResult("<b>Human</b>", "2020-06", 0.50, "v1", "human"),
    PastResult("Chance", "2020-06", 0.60, "v1", "reference"),
    PastResult("On v2", "2023-01", 0.40, "v2"),
)


def timeline(metric: str = "rgspl") -> Timeline:
    return Timeline(CATALOGUE[metric], RESULTS, "2024-01-01")


def drawn(picture: str) -> ET.Element:
    return ET.fromstring(picture)


def test_marks_are_in_the_same_order_in_every_process() -> None:
    dates = [f"20{year}" for year in range(10, 24)]
    results = [
        PastResult(date, date, int(date) / 10_000, version)
        for version in ("v1", "v2")
        for date in dates
    ]
    picture = drawn(Timeline(CATALOGUE["rgspl"], results, "2024-01-01").svg)
    groups = [group for group in picture.iter("g") if "best" in group.get("class", "")]
    assert [[mark.findtext("title", "")[:4] for mark in group] for group in groups] == [dates] * 2


@pytest.mark.parametrize(
    ("metric", "version", "best"),
    [
        pytest.param("rgspl", "v1", ["First", "Same day, better"], id="higher is better"),
        pytest.param("navigation_error", "v1", ["First", "Worse"], id="lower is better"),
        pytest.param("rgspl", "v2", ["On v2"], id="each version by itself"),
    ],
)
def test_the_best_so_far_are_methods_of_one_version(
    metric: str, version: str, best: Sequence[str]
) -> None:
    assert [each.name for each in timeline(metric).best_so_far[version]] == best


def test_a_timeline_has_a_mark_with_all_words_for_every_result() -> None:
    picture = drawn(timeline().svg)
    groups = list(picture.iter("g"))
    kinds = {
        mark.findtext("title", "").partition(":")[0]: group.get("class")
        for group in groups
        for mark in group
    }
    marks = {mark.findtext("title", ""): mark for group in groups for mark in group}
    assert marks.keys() == {
        f"{each.name}: {100 * each.value:.2f}, {each.date}, {each.version}" for each in RESULTS
    }
    assert kinds["First"] == "best series-2"
    assert kinds["Worse"] == "method series-2"
    assert kinds["On v2"] == "best series-1", "the version of the latest result is the first"
    assert kinds["Chance"] == "reference series-2"
    places = {
        name.partition(":")[0]: (float(mark.get("cx", "")[:-1]), float(mark.get("cy", "")))
        for name, mark in marks.items()
    }
    assert places["First"][0] < places["Worse"][0] < places["Same day"][0] < places["On v2"][0]
    assert places["On v2"][1] < places["Same day, better"][1] < places["Worse"][1]
    texts = [each.text for each in picture.iter("text")]
    assert "<b>Human</b> 50.00" in texts
    assert [each for each in texts if re.fullmatch(r"20\d\d", str(each))] == [
        *("2020", "2021", "2022", "2023", "2024")
    ]


def test_a_crowd_is_drawn_as_dots_where_its_circles_would_be() -> None:
    crowd = [PastResult(f"Method {n}", f"{2021 + n % 3}", n / 2000, "v1") for n in range(600)]
    best = PastResult("Best", "2020-07", 0.5, "v1")

    def picture(results: Sequence[PastResult]) -> ET.Element:
        return drawn(Timeline(CATALOGUE["rgspl"], [best, *results], "2024-01-01").svg)

    def circles(results: Sequence[PastResult]) -> set[tuple[str, str]]:
        marks = [*picture(results).iter("circle")]
        return {(mark.get("cx", ""), mark.get("cy", "")) for mark in marks}

    paths = [each.get("d", "") for each in picture(crowd).iter("path")]
    dots = [dot for path in paths for dot in re.findall(r"M([\d.]+) (\d+)h0", path)]
    in_parts = circles(crowd[:500]) | circles(crowd[500:])
    assert {(f"{x}%", y) for x, y in dots} == in_parts - circles([])
    assert len(dots) == len({*dots}) < len(crowd), "a place has one dot"
    assert circles(crowd) == circles([]), "the best keeps its mark"


@pytest.mark.parametrize(
    ("date", "anchor"),
    [
        pytest.param("2020-02-01", "start", id="no room to the left"),
        pytest.param("2023-06-01", "start", id="no room beside the values of the axis"),
        pytest.param("2023-09-01", "end", id="to the left"),
    ],
)
def test_the_leader_s_name_stays_on_a_phone(date: str, anchor: str) -> None:
    results = [PastResult("A method with a name", date, 0.4, "v1")]
    picture = drawn(Timeline(CATALOGUE["rgspl"], results, "2024-01-01").svg)
    (name,) = (each for each in picture.iter("text") if each.get("class") == "leader")
    assert name.get("text-anchor") == anchor


def test_a_short_history_ends_today() -> None:
    results = [PastResult("New", "2024-01-08", 0.4, "v1")]
    picture = drawn(Timeline(CATALOGUE["rgspl"], results, "2024-01-20").svg)
    months = [
        each.text or "" for each in picture.iter("text") if each.get("text-anchor") == "middle"
    ]
    assert months[0].startswith("2023-")
    assert months[-1] == "2024-01"


def test_names_never_overlap() -> None:
    crowd = [PastResult(f"Method {n}", f"2020-{n:02}", n / 100, "v1") for n in range(1, 13)]
    picture = drawn(Timeline(CATALOGUE["rgspl"], crowd, "2026-01-01").svg)
    names = [each for each in picture.iter("text") if each.get("class") in ("leader", "was-best")]
    assert [each.text for each in names if each.get("class") == "leader"] == ["Method 12"]
    heights = sorted(float(each.get("y", "")) for each in names)
    assert all(high - low >= 16 for low, high in pairwise(heights))


@pytest.mark.parametrize(
    ("results", "own", "expected"),
    [
        pytest.param([], [], [], id="nothing"),
        pytest.param(
            [(1, 5), (2, 4), (3, 9)], [(1, 5)], [(1, 1, 1), (2, 2, 2), (3, 2, 3)], id="overtaken"
        ),
        pytest.param(
            [(1, 5), (2, 7), (3, 1)],
            [(2, 7), (3, 1)],
            [(2, 2, 2), (3, 1, 3)],
            id="the best of several",
        ),
        pytest.param([(1, 5), (1, 5), (1, 4)], [(1, 5)], [(1, 2, 3)], id="equal ones share a rank"),
    ],
)
def test_ranks_over_time(
    results: list[tuple[float, float]],
    own: list[tuple[float, float]],
    expected: list[tuple[float, int, int]],
) -> None:
    assert [tuple(each) for each in rank_over_time(results, own)] == expected


def test_a_rank_is_drawn_from_the_top() -> None:
    ranks = rank_over_time([(2024.0, 5.0), (2024.5, 4.0)], [(2024.0, 5.0)])
    picture = drawn(rank_svg(ranks, 2025.0, "Rank of Blue"))
    assert picture.findtext("title") == "Rank of Blue"
    own = next(each for each in picture.iter("path") if "curve" in str(each.get("class")))
    start, after = re.findall(r"[ V]([\d.]+)", own.get("d", ""))
    assert float(start) < float(after)
    assert "2 of 2" in [each.text for each in picture.iter("text")]


@pytest.mark.parametrize(
    ("costs", "is_below"),
    [
        pytest.param([5.0, 4.0], True, id="others overtook it"),
        pytest.param([5.0, 6.0], False, id="the first all the time"),
    ],
)
def test_a_rank_is_told_where_its_line_does_not_come_down(
    costs: list[float],
    is_below: bool,  # noqa: FBT001  # as the table has it
) -> None:
    results = [(2024.9 + 0.099 * number, cost) for number, cost in enumerate(costs)]
    picture = drawn(rank_svg(rank_over_time(results, results[:1]), 2025.0, "Rank of Blue"))
    own = next(each for each in picture.iter("path") if "curve" in str(each.get("class")))
    *_, end = re.findall(r"[ V]([\d.]+)", own.get("d", ""))
    (told,) = (each.get("y", "") for each in picture.iter("text") if each.get("class") == "leader")
    assert (float(told) > float(end)) is is_below
