"""Breakdowns: groups of episodes, worked out by hand and compared with the whole."""

import re
from typing import get_args

import numpy as np
import pandas as pd
import pytest

from reverie_eval import GroundTruth, ProtocolError, Scores, evaluate
from reverie_eval.analysis import GROUPINGS, GroupingKey
from reverie_eval.analysis._breakdown import level_in
from reverie_eval.metrics.engine import IntervalEngine
from reverie_eval.scoring import clusters_of
from tests.conftest import SAMPLES
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.worlds import ground_truth_of

LAMP, SOFA, PLANT = 3, 4, 5
HOUSE = World(
    {
        "house": Scan(
            {
                "a": Viewpoint((0.0, 0.0, 0.0), views={LAMP: [12]}),
                "b": Viewpoint((3.0, 4.0, 0.0), views={LAMP: [12], SOFA: [1, 2]}),
                "c": Viewpoint((9.0, 4.0, 0.0), views={LAMP: [12], PLANT: []}),
                "d": Viewpoint((14.0, 4.0, 0.0), views={LAMP: [0]}),
            },
            frozenset({("a", "b"), ("b", "c"), ("c", "d")}),
        ),
        "hut": Scan(
            {"x": Viewpoint((0.0, 0.0, 0.0)), "y": Viewpoint((6.0, 0.0, 0.0), views={LAMP: [5]})},
            frozenset({("x", "y")}),
        ),
    },
    [
        Item("1_3", "house", ["a", "b", "c", "d"], LAMP, instructions=2),  # 16 m, seen from 4
        Item("2_4", "house", ["a", "b"], SOFA, instructions=1),  # 5 m, seen from 1
        Item("3_3", "hut", ["x", "y"], LAMP, instructions=1),  # 6 m, seen from 1
    ],
)
WALKS = {
    "1_3_0": (["a", "b", "c", "d"], LAMP),
    "1_3_1": (["a", "c"], LAMP),  # a jump
    "2_4_0": (["a"], SOFA),
    "3_3_0": (["x", "y"], -1),
}


@pytest.fixture(scope="module")
def scores() -> Scores:
    records = [
        {"instr_id": name, "trajectory": [[place, 0, 0] for place in walk], "predObjId": answer}
        for name, (walk, answer) in WALKS.items()
    ]
    return evaluate(records, split="val_unseen", ground_truth=ground_truth_of(HOUSE))


@pytest.mark.parametrize(
    ("by", "expected"),
    [
        pytest.param("scan", {"house": (3, 2 / 3, 1), "hut": (1, 1, 0)}, id="scan"),
        pytest.param(
            "length",
            {"below 6 m": (1, 0, 1), "6 to 8 m": (1, 1, 0), "15 or more m": (2, 1, 1)},
            id="length",
        ),
        pytest.param("visibility", {"1": (2, 0.5, 0.5), "4 to 5": (2, 1, 1)}, id="visibility"),
        pytest.param("jumps", {"no jump": (3, 2 / 3, 2 / 3), "jumps": (1, 1, 1)}, id="jumps"),
    ],
)
def test_breakdowns_worked_out_by_hand(
    by: str, expected: dict[str, tuple[int, float, float]], scores: Scores
) -> None:
    found = scores.breakdown(by)
    assert found.index.name == by
    assert list(found.columns) == ["episodes", *(metric.key for metric in scores.headline)]
    assert list(found.index) == list(expected)
    values = found[["episodes", "success", "rgs"]].to_numpy()
    assert values.tolist() == [pytest.approx(part) for part in expected.values()]


@pytest.mark.parametrize("by", GROUPINGS)
def test_means_of_groups_average_to_the_score(by: str) -> None:
    scores = evaluate(SAMPLES / "mediocre.json", split="val_unseen")
    found = scores.breakdown(by)
    assert found["episodes"].sum() == len(scores.instr_ids)
    for metric in scores.headline:
        whole = np.average(found[metric.key], weights=found["episodes"])
        assert whole == pytest.approx(scores[metric.key])


def test_intervals_of_a_group_use_its_episodes_only() -> None:
    """Compared with those of one group's values alone."""
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    found = scores.breakdown("level", intervals=True)
    plain = scores.breakdown("level")
    assert list(found.columns[: len(plain.columns)]) == list(plain.columns)
    rows = [
        row
        for row, instruction in enumerate(scores.ground_truth.episodes.instructions)
        if level_in(instruction) == "level 2"
    ]
    cluster = clusters_of(scores.ground_truth, "target")[rows]
    values, rate = scores.episodes["rgs"][rows][:, None], np.array([[0.0], [1.0]])
    low, high = IntervalEngine().of_means(values, cluster, rate).ends[:, 0]
    ends = found[["rgs_low", "rgs_high"]].to_dict("index")["level 2"]
    assert ends == pytest.approx({"rgs_low": low, "rgs_high": high})
    assert low < found["rgs"]["level 2"] < high
    narrow = scores.breakdown("level", intervals=True, confidence=0.5)["rgs_low"]["level 2"]
    assert low < narrow < found["rgs"]["level 2"]


@pytest.mark.parametrize("intervals", [False, True])
def test_a_breakdown_lists_the_units_of_its_columns(*, intervals: bool) -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    for by in ("scan", "length"):
        found = scores.breakdown(by, intervals=intervals)
        units = found.attrs["units"]
        assert set(units) == set(found.columns)
        assert (units["episodes"], units["path_length"], units["rgs"]) == (
            "count",
            "metres",
            "fraction",
        )
        assert units.get("path_length_low", "metres") == "metres"


# Groups of the reader's own.


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    """Return the episode table of the good sample."""
    return evaluate(SAMPLES / "good.json", split="val_unseen").to_pandas()


def test_several_groupings_and_a_column(frame: pd.DataFrame) -> None:
    """As pandas groups the table; rows in the order that each grouping has by itself."""
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    found = scores.breakdown(by=["level", frame["outcome"]], intervals=True)
    levels = np.array(GROUPINGS["level"].groups(scores))
    expected = frame.groupby([levels, frame["outcome"]])["rgs"].agg(["size", "mean"])
    assert found.index.names == ["level", "outcome"]
    assert found["episodes"].to_dict() == expected["size"].to_dict()
    assert found["rgs"].to_dict() == pytest.approx(expected["mean"].to_dict())
    assert [level for level, _ in found.index] == sorted(level for level, _ in found.index)
    alone = scores.breakdown(by="level", intervals=True)
    together = scores.breakdown(by=["level"], intervals=True)
    pd.testing.assert_frame_equal(alone, together)


def test_a_condition_on_the_instruction(frame: pd.DataFrame) -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    has_bed = frame["instruction"].str.contains("bed")
    # In any order, and of more episodes than were scored.
    found = scores.subset(scores.instr_ids[5:]).breakdown(by=has_bed[::-1])
    assert found.index.tolist() == [False, True]
    assert found["episodes"].sum() == len(scores.instr_ids) - 5
    assert found["rgs"][True] == frame["rgs"][5:][has_bed[5:]].mean()


def test_a_series_needs_one_group_for_each_episode(frame: pd.DataFrame) -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    outcome = frame["outcome"]
    for wrong, shown in (
        (outcome[:-1], outcome.index[-1]),
        (outcome.reset_index(drop=True), f"{', '.join(sorted(outcome.index)[:3])} and 81 more"),
        (pd.concat([outcome, outcome[:1]]), outcome.index[0]),
    ):
        with pytest.raises(ProtocolError) as refused:
            scores.breakdown(by=wrong)
        assert str(refused.value) == (
            f"the Series does not have one group for each episode, such as {shown}; index it by "
            "instr_id, as scores.to_pandas() is"
        )
    with pytest.raises(ProtocolError, match="break scores down by something, such as scan"):
        scores.breakdown(by=[])


@pytest.mark.parametrize(("name", "shown"), [("outcome", "outcome"), (None, "group")])
def test_a_series_names_its_groups(name: str | None, shown: str, frame: pd.DataFrame) -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    assert scores.breakdown(by=frame["outcome"].rename(name)).index.name == shown


def test_words_of_the_instruction(frame: pd.DataFrame) -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    chosen = frame["instruction"].str.contains(r"\bbed\b") & frame["instruction"].str.contains(
        r"\b[Ll]evel\b"
    )
    found = scores.with_words("Bed", "level")
    assert list(found.instr_ids) == frame.index[chosen].tolist()
    assert found["rgs"] == frame["rgs"][chosen].mean()
    with pytest.raises(ProtocolError, match="all the words 'bed zeppelin': zeppelin is in none"):
        scores.with_words("bed zeppelin")
    with pytest.raises(
        ProtocolError, match=r"^with_words needs a word that instructions may have$"
    ):
        scores.with_words("", "?")


def test_all_words_of_an_instruction_find_it(frame: pd.DataFrame) -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    instr_id, text = frame.index[3], frame["instruction"].iloc[3]
    assert instr_id in scores.with_words(text).instr_ids


def test_the_keys_of_groupings_are_typed() -> None:
    assert get_args(GroupingKey) == tuple(GROUPINGS)


def test_groups_with_few_targets_have_no_intervals() -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    found = scores.breakdown("category", intervals=True)
    cluster = clusters_of(scores.ground_truth, "target")
    truth = scores.ground_truth
    categories = [truth.require_solution().target_categories[item] for item in truth.episodes.item]
    targets = {
        part: len({cluster[row] for row, name in enumerate(categories) if name == part})
        for part in found.index
    }
    assert {part: number >= 5 for part, number in targets.items()} == {
        part: bool(known) for part, known in found["spl_low"].notna().items()
    }
    assert set(targets.values()) & {4, 5}
    assert found["spl_low"].dtype == np.float64


def test_five_targets_have_intervals_and_four_have_none() -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    _, target = np.unique(clusters_of(scores.ground_truth, "target"), return_inverse=True)
    groups = np.select([target < 5, target < 9], ["five", "four"], "others")
    found = scores.breakdown(
        pd.Series(groups.tolist(), index=list(scores.instr_ids)), intervals=True
    )
    assert found["spl_low"].notna().to_dict() == {"five": True, "four": False, "others": True}


def test_groups_by_words_and_category_in_the_demo_world(demo: GroundTruth) -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen", ground_truth=demo)
    lengths = [len(re.findall(r"\w+", text)) for text in demo.episodes.instructions]
    words = scores.breakdown("words")["episodes"]
    assert words["1 to 11 words"] == sum(length <= 11 for length in lengths)
    assert words["12 to 15 words"] == sum(12 <= length <= 15 for length in lengths)
    categories = scores.breakdown("category")["episodes"]
    named = [demo.require_solution().target_categories[item] for item in demo.episodes.item]
    assert categories.to_dict() == {name: named.count(name) for name in set(named)}
    assert list(categories) == sorted(categories, reverse=True)


def test_levels_are_in_order() -> None:
    """Not by size, as most instructions give no level."""
    found = evaluate(SAMPLES / "good.json", split="val_unseen").breakdown("level")["episodes"]
    assert found.to_dict() == {"level 1": 25, "level 2": 14, "no level": 45}
    assert list(found.index) == ["level 1", "level 2", "no level"]


def test_spellings_of_a_category_are_one_group(
    scores: Scores, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Upper case and ``#`` for a space make no difference."""
    spelt = ("end#table", "End table", " ")
    monkeypatch.setattr(type(scores.ground_truth.require_solution()), "target_categories", spelt)
    found = scores.breakdown("category")["episodes"]
    assert found.to_dict() == {"end table": 3, "unnamed": 1}


@pytest.mark.parametrize(
    ("instruction", "level"),
    [
        ("Go to the bedroom on level 2 with the red door", "level 2"),
        ("Go to Level 1", "level 1"),
        ("water the plant on floor three", "level 3"),
        ("the first level bathroom", "level 1"),
        ("the 3rd floor office", "level 3"),
        ("the third  level bathroom", "level 3"),
        ("the bathroom on level\n2", "level 2"),
        ("sweep the floor of the second bedroom", "no level"),
        ("the lamp on the top floor", "no level"),
        ("level the picture", "no level"),
        ("floor 12 is no house's", "no level"),
    ],
)
def test_the_level_that_an_instruction_gives(instruction: str, level: str) -> None:
    assert level_in(instruction) == level


def test_groupings_that_are_not_possible(scores: Scores) -> None:
    with pytest.raises(ProtocolError, match="unknown grouping 'room'; choose one of: scan, length"):
        scores.breakdown("room")
    with pytest.raises(ProtocolError, match="unknown grouping 'words2'; did you mean words"):
        scores.breakdown("words2")
    grounding = evaluate(SAMPLES / "good.json", split="val_unseen", track="grounding")
    with pytest.raises(
        ProtocolError, match=r"^this track ignores trajectories, so there are no jumps$"
    ):
        grounding.breakdown("jumps")
