"""Near misses, and episodes that one of two submissions got right."""

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.analysis import episodes_won, gallery, near_misses
from reverie_eval.runner import run_agent
from tests.conftest import SAMPLES
from tests.support.home_world import OTHER_WALKS, WALKS, home_scores

SPLIT = "val_unseen"


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> tuple[rv.Scores, rv.Scores]:
    """Score two submissions that each have an episode right that the other has not."""
    folders = [tmp_path_factory.mktemp(name) for name in ("first", "other")]
    return home_scores(folders[0], WALKS), home_scores(folders[1], OTHER_WALKS)


def test_a_gallery_has_the_failed_episodes(home: tuple[rv.Scores, rv.Scores]) -> None:
    shown = gallery(home[0])
    assert {name: [each.instr_id for each in shown[name]] for name in shown} == {
        "correct object at the wrong stop": ["1_3_2"],
        "wrong object": ["1_3_1"],
        "overshot": ["2_4_0"],
        "never reached": ["2_4_1"],
    }
    assert len(shown) == 4
    assert repr(shown) == f"<Gallery of near misses: {', '.join(f'1 {name}' for name in shown)}>"


@pytest.mark.parametrize(
    ("outcome", "metric", "sign"),
    [
        pytest.param("never reached", "oracle_error", 1, id="closest on its way"),
        pytest.param("overshot", "navigation_error", 1, id="closest at its stop"),
        pytest.param("wrong object", "spl", -1, id="shortest route"),
    ],
)
@pytest.mark.parametrize("agent", ["mediocre", "random"])
def test_the_closest_are_first(
    outcome: str, metric: str, sign: int, agent: str, demo: rv.GroundTruth
) -> None:
    is_random = agent == "random"  # it comes closest elsewhere than where it stops
    submission = run_agent(agent, demo) if is_random else SAMPLES / f"{agent}.json"
    scores = rv.evaluate(submission, split=SPLIT)
    listed = [
        name
        for name, each in zip(scores.instr_ids, scores.outcomes, strict=True)
        if each == outcome
    ]
    values = dict(zip(scores.instr_ids, (sign * scores.episodes[metric]).tolist(), strict=True))
    chosen = near_misses(scores)[outcome]
    assert 1 <= len(chosen) <= 3
    assert values[chosen[0]] == min(values[name] for name in listed)
    assert [values[name] for name in chosen] == sorted(values[name] for name in chosen)


def test_a_wrong_box_is_as_close_as_its_overlap(demo: rv.GroundTruth) -> None:
    """Where no box overlaps the target, the shortest route comes first."""
    scores = rv.evaluate(SAMPLES / "drawn.json", split=SPLIT)
    ious, spl = (scores.episodes[metric].tolist() for metric in ("iou", "spl"))
    episodes, goal = demo.episodes, demo.require_solution().goal
    wrong = [row for row, outcome in enumerate(scores.outcomes) if outcome == "wrong object"]
    first_of_route: dict[tuple[int, int], str] = {}
    for row in sorted(wrong, key=lambda row: (-ious[row], -spl[row])):
        route = int(episodes.start[row]), int(goal[row])
        first_of_route.setdefault(route, scores.instr_ids[row])
    assert near_misses(scores)["wrong object"] == list(first_of_route.values())[:3]


def test_episodes_that_only_the_other_got_right(home: tuple[rv.Scores, rv.Scores]) -> None:
    first, other = home
    assert episodes_won(first, other) == ["2_4_1"]
    assert episodes_won(other, first) == ["1_3_0"]


def test_without_answers_the_right_stop_counts() -> None:
    """The largest difference in SPL is first."""
    scores = {
        name: rv.evaluate(SAMPLES / f"{name}.json", split=SPLIT, protocol="r2r-style")
        for name in ("mediocre", "good")
    }
    first, other = scores["mediocre"], scores["good"]
    assert "rgs" not in other
    won = episodes_won(first, other)
    is_won = other.episodes["success"] > first.episodes["success"]
    assert set(won) == {name for name, each in zip(first.instr_ids, is_won, strict=True) if each}
    change = dict(zip(first.instr_ids, other.episodes["spl"] - first.episodes["spl"], strict=True))
    assert [change[name] for name in won] == sorted((change[name] for name in won), reverse=True)
    assert np.ptp([change[name] for name in won]) > 0
