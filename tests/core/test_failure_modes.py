"""Outcomes: for every combination of values, and compared with the scores they add up to."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reverie_eval import PROTOCOLS, ProtocolError, evaluate
from reverie_eval.arrays import FloatArray
from reverie_eval.scoring import OUTCOMES
from reverie_eval.scoring._episode_table import failure_modes, outcome_indices
from tests.conftest import SAMPLES

COMBINATIONS = {
    # reached the goal, stopped at the goal, predicted the target
    (0, 0, 0): "never reached",
    (1, 0, 0): "overshot",
    (1, 1, 0): "wrong object",
    (0, 0, 1): "correct object at the wrong stop",
    (1, 0, 1): "correct object at the wrong stop",
    (1, 1, 1): "correct",
}
episode = st.sampled_from(sorted(COMBINATIONS))


def table(episodes: list[tuple[int, int, int]]) -> dict[str, FloatArray]:
    reached, stopped, predicted = np.array(episodes, dtype=np.float64).reshape(-1, 3).T
    return {"success": stopped, "oracle_success": reached, "rgs": predicted}


def test_the_outcome_of_every_possible_combination() -> None:
    possible = set(product((0, 1), repeat=3))
    assert possible - set(COMBINATIONS) == {(0, 1, 0), (0, 1, 1)}  # stopped where it never was
    outcomes = outcome_indices(table(list(COMBINATIONS)))
    assert [list(OUTCOMES)[number] for number in outcomes] == list(COMBINATIONS.values())


def test_outcomes_that_do_not_occur_are_counted_too() -> None:
    modes = failure_modes(table([(0, 0, 0), (1, 0, 0)]))
    assert list(modes.counts.values()) == [1, 1, 0, 0, 0]


@given(st.lists(episode, min_size=1))
def test_every_episode_has_one_outcome_and_counts_match_the_scores(
    episodes: list[tuple[int, int, int]],
) -> None:
    scores, modes = table(episodes), failure_modes(table(episodes))
    counts = modes.counts
    assert sum(counts.values()) == len(episodes)
    assert counts["wrong object"] + counts["correct"] == scores["success"].sum()
    assert counts["correct object at the wrong stop"] + counts["correct"] == scores["rgs"].sum()
    reached = len(episodes) - counts["never reached"] - counts["correct object at the wrong stop"]
    assert reached + modes.wrong_stops_after_reaching == scores["oracle_success"].sum()
    assert list(modes.funnel.values()) == [
        len(episodes),
        scores["oracle_success"].sum(),
        scores["success"].sum(),
        counts["correct"],
    ]


@pytest.mark.parametrize(
    "protocol", [name for name, it in PROTOCOLS.items() if it.grounding != "not scored"]
)
def test_outcome_counts_of_a_sample_match_its_scores(protocol: str) -> None:
    scores = evaluate(SAMPLES / "mediocre.json", split="val_unseen", protocol=protocol)
    count, total = scores.failure_modes.counts, len(scores.instr_ids)
    assert (count["wrong object"] + count["correct"]) / total == scores["success"]
    assert (count["correct object at the wrong stop"] + count["correct"]) / total == scores["rgs"]
    assert scores.failure_modes.funnel["reached the goal"] / total == scores["oracle_success"]
    assert [scores.outcomes.count(name) for name in OUTCOMES] == list(count.values())


@pytest.mark.parametrize("how", [{"track": "grounding"}, {"protocol": "r2r-style"}], ids=str)
def test_outcomes_need_all_three_metrics(how: dict[str, str]) -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen", **how)  # type: ignore[arg-type]
    with pytest.raises(ProtocolError, match="choose another protocol, or the full track"):
        _ = scores.failure_modes
