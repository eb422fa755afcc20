"""Comparisons with published means: by hand, in worlds with known differences, and the command."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fixtures.clustered_worlds import RATE, simulated_against
from fixtures.published import published_folder
from reverie_eval import CATALOGUE, PROTOCOLS, ProtocolError, Runs, evaluate, published_results
from reverie_eval.analysis import against
from reverie_eval.metrics.engine import CrossedMeans
from reverie_eval.metrics.published import PublishedDifference, ResultSpread
from reverie_eval.tasks import find_task
from tests.conftest import SAMPLES, unavailable
from tests.support.flat_world import Run

SPLIT = "val_unseen"
GOOD, MEDIOCRE = (str(SAMPLES / f"{name}.json") for name in ("good", "mediocre"))


def of_rate(successes: int, n: int, published: float, n_published: int) -> PublishedDifference:
    """Compare a rate over episodes with a target each."""
    values = (np.arange(n) < successes).astype(float)[None, :, None]
    alone = np.arange(n)
    return PublishedDifference(
        means=CrossedMeans.of(values, alone),
        published=np.array([published]),
        n_published=n_published,
        spread=ResultSpread.of(values, alone, np.ones(10 * n, dtype=np.int64)),
        bounds=RATE,
    )


@pytest.mark.parametrize(
    ("cluster", "values", "sizes", "n", "expected"),
    [
        pytest.param([0, 0, 1, 1], [1, 1, 0, 0], [2] * 5, 10, (1, 5, 0), id="targets decide"),
        pytest.param([0, 0, 1, 1], [1, 0, 1, 0], [2] * 5, 10, (0, 10, 0), id="within targets"),
        pytest.param([0, 1, 2, 3], [1, 0, 1, 0], [2] * 5, 10, (1, 5, 0), id="no pairs: cautious"),
        pytest.param([0, 0, 1, 1], [1, 0, 1, 0], [2] * 5, 4, (0, 4, 0.6), id="a part, independent"),
        # 4 of 10 episodes have a third of another episode of their target each: 4 / (4 / 3).
        pytest.param([0, 0, 1, 1], [1, 1, 0, 0], [2] * 5, 4, (1, 3, 0.4), id="a part, dependent"),
        # Of three pairs of a target, one agrees: (1 - 1 - 1) / 9 / (2 / 9), which no target has.
        pytest.param([0, 0, 0], [1, 0, 0], [3], 3, (0, 3, 0), id="never below 0"),
    ],
)
def test_what_episodes_are_worth_by_hand(
    cluster: list[int], values: list[float], sizes: list[int], n: int, expected: tuple[float, ...]
) -> None:
    """The correlation within targets, how many independent episodes, and which part is left out."""
    column = np.array(values, dtype=float)[None, :, None]
    spread = ResultSpread.of(column, np.array(cluster), np.array(sizes))
    found = (spread.correlation[0], spread.independent(n)[0], spread.left_out(n)[0])
    assert found == pytest.approx(expected)


def test_an_interval_as_its_method_gives_it() -> None:
    """56/70 - 48/80, Newcombe's Table II (a), method 10; here it is wider by Student's t."""
    low, high = of_rate(56, 70, 48 / 80, 80).interval(0.95)[:, 0]
    assert 0.0524 - 0.004 < low < 0.0524
    assert 0.3339 < high < 0.3339 + 0.004


@pytest.mark.parametrize("published", [0.0, 0.3, 0.38, 0.41, 0.5, 0.6, 0.62, 1.0])
def test_p_is_small_if_and_only_if_the_interval_excludes_0(published: float) -> None:
    found = of_rate(50, 100, published, 200)
    p_value = found.p_value()[0]
    low, high = found.interval(1 - p_value)[:, 0]
    assert min(abs(low), abs(high)) < 1e-6 or p_value < 1e-11
    low, high = found.interval(0.95)[:, 0]
    assert bool(p_value < 0.05) is bool(low > 0 or high < 0)


def test_a_sample_of_all_episodes_has_no_error_on_the_split() -> None:
    whole = replace(of_rate(50, 100, 0.25, 1000), n_episodes=1000)
    assert whole.interval(0.95)[:, 0] == pytest.approx([0.25, 0.25])
    part = replace(of_rate(50, 100, 0.25, 1000), n_episodes=100)
    beyond = replace(part, n_published=10**9, n_episodes=None)
    # Nine tenths of the split are not in the sample.
    widths = [np.ptp(each.interval(0.95)) for each in (part, beyond)]
    assert widths[0] / widths[1] == pytest.approx(np.sqrt(0.9), abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "published_part", "published"),
    [(0.15, 1, 0.5), (0.15, 0.15, 0.3), (1, 0.15, 0.5), (0.15, 1, None)],
)
def test_intervals_contain_the_true_difference(
    part: float, published_part: float, published: float | None
) -> None:
    """95 % within what 400 worlds are exact to; more where related methods count as unrelated."""
    shares = simulated_against(400, 150, part, published_part, published)
    assert 0.925 <= shares.on_split <= 0.98
    assert 0.925 <= shares.beyond <= (0.98 if published else 1)


# Scores.


def test_several_runs_and_a_sample() -> None:
    good, mediocre = (evaluate(file, split=SPLIT) for file in (GOOD, MEDIOCRE))
    found = good.against({"success": 0.5, "rgs": 0.4})
    assert (list(found), found.on_split) == (["success", "rgs"], {})
    assert found["rgs"].mean == pytest.approx(good["rgs"] - 0.4)
    runs = against(Runs.of({"a": good, "b": mediocre}), {"rgs": 0.4}, 20)
    assert runs["rgs"].interval.low < 0 < found["rgs"].interval.low
    assert np.ptp([runs["rgs"].interval.low, runs["rgs"].interval.high]) > np.ptp(
        [runs.on_split["rgs"].interval.low, runs.on_split["rgs"].interval.high]
    )
    some = evaluate(GOOD, split=SPLIT, subset=good.instr_ids[::4])
    sample = some.against({"rgs": 0.4})
    assert (sample.n_split, len(some.instr_ids)) == (84, 21)
    assert "the 21 were drawn at random from its 84" in sample.assumptions[0]
    assert "difference" in sample._repr_html_()
    assert repr(sample).startswith("<Against: ")


@pytest.mark.parametrize(
    ("metric", "published", "told"),
    [
        ("rgs", 0.3, "Better than the published mean by 35.48 RGS, 95 % interval 2"),
        ("rgs", 0.95, "Worse than the published mean by 29.52 RGS, 95 % interval 1"),
        ("rgs", 0.65, "No significant difference from the published mean in RGS: difference 0.48"),
        ("navigation_error", 9.0, "Better than the published mean by 8.36 NE"),
        ("path_length", 30.0, "Lower than the published mean by 20.16 TL"),
    ],
)
def test_a_sentence_says_which_is_better(metric: str, published: float, told: str) -> None:
    found = evaluate(GOOD, split=SPLIT).against({metric: published})
    assert found.sentence.startswith(told)


def test_a_published_method_is_found_by_its_name() -> None:
    scores = evaluate(GOOD, split=SPLIT)
    header = replace(scores.ground_truth.header, dataset="REVERIE v1")
    truth = replace(scores.ground_truth, header=header)
    found = evaluate(GOOD, split=SPLIT, ground_truth=truth).against("fast-short")
    assert found.name == "FAST-Short (Qi et al., REVERIE, CVPR 2020)"
    assert found.published["rgs"] == 0.0624
    assert not found.is_n_assumed
    grounding = evaluate(GOOD, split=SPLIT, ground_truth=truth, track="grounding")
    assert grounding.against("MAttNet").published == {"rgs": 0.5663}
    with pytest.raises(ProtocolError, match="by official-v1 on demo; score by"):
        scores.against("FAST-Short")
    with pytest.raises(ProtocolError, match="scores are by duet on REVERIE v1"):
        evaluate(GOOD, split=SPLIT, ground_truth=truth, protocol="duet").against("RCM")


@pytest.mark.parametrize(
    ("published", "n", "told"),
    [
        ({"rgs": 41.2}, None, "rgs is 41.2; expected a fraction from 0 to 1"),
        ({"rg": 0.4}, None, "'rg' is not scored here; did you mean rgs"),
        ({"rgs": 0.4}, 85, "is over 85 episodes; expected 1 to 84, all of val_unseen"),
        ({}, 0, "no metric is given that these scores have; the published mean is over 0"),
        ("FAST", None, "nothing published of 'FAST' on val_unseen is known here; "),
    ],
)
def test_what_cannot_be_compared(
    published: dict[str, float] | str, n: int | None, told: str
) -> None:
    with pytest.raises(ProtocolError) as error:
        evaluate(GOOD, split=SPLIT).against(published, n)
    assert told in str(error.value)


# The command.


def test_the_command_prints_both_intervals_and_what_it_assumes(run: Run) -> None:
    words = ("compare", GOOD, "--split", SPLIT, "--against", "SR=46.98", "RGS=41.2", "--n", "60")
    status, out, err = run(*words)
    assert (status, err) == (0, "")
    lines = [line.split("  ")[0] for line in out.splitlines()]
    ends = ["95 % low", "95 % high", "p"]
    here = [f"{each} on val_unseen" for each in ends]
    assert lines[1:10] == ["good", "published", "", "difference", *ends, *here][:9]
    assert "Better than the published mean by 24.28 RGS, 95 % interval " in out
    assert "over 60 episodes of val_unseen, by official-v1; the 60 were drawn" in out
    report = json.loads(run(*words, "--format", "json").out)
    found = evaluate(GOOD, split=SPLIT).against({"success": 0.4698, "rgs": 0.412}, 60)
    assert report["differences"]["rgs"]["p_value"] == found["rgs"].p_value
    assert report["on_split"]["success"]["interval"]["low"] == (
        found.on_split["success"].interval.low
    )
    assert run(*words, "--format", "csv").out.startswith(",SR %,RGS %\ngood,80.95,65.48\n")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((GOOD, MEDIOCRE, "--against", "SR=4"), "--against compares one submission"),
        ((GOOD, "--against", "SR=4", "--baseline", "best"), "leave out --baseline"),
        ((GOOD, "--against", "SR=104"), "--against: SR %: 104 is not from 0 to 100"),
        ((GOOD, "--against", "SR=x"), "--against: SR: 'x' is not a number"),
        ((GOOD, "--against", "RSG=4"), "--against: no metric 'RSG'; did you mean RGS"),
        ((GOOD, "--against", "SR=4,SR=5"), "--against: SR is given twice"),
        ((GOOD, MEDIOCRE, "--n", "5"), "--n is the number of episodes of --against"),
    ],
)
def test_what_the_command_refuses(words: tuple[str, ...], told: str, run: Run) -> None:
    status, out, err = run("compare", *words, "--split", SPLIT)
    assert (status, out) == (2, "")
    assert told in err


# What ships.


def test_published_results_can_be_compared() -> None:
    for each in published_results():
        assert each.protocol in PROTOCOLS
        assert each.scores.keys() <= CATALOGUE.keys()
        assert each.source.startswith("https://")
        assert each.dataset in find_task(each.task).releases.values()
    methods = [(each.split, each.method, each.track) for each in published_results()]
    assert len(set(methods)) == len(methods) == 38


@pytest.mark.dataset
def test_published_results_are_those_of_the_paper() -> None:
    file = (published_folder() or SAMPLES) / "paper_results.json"
    if not file.is_file():
        unavailable("the published REVERIE files are not here (REVERIE_DATA names their folder)")
    paper = json.loads(file.read_text())
    splits = ("val_seen", "val_unseen", "test")
    printed = {
        (split, method, "full"): values
        for method, rows in paper["methods"].items()
        for split, values in rows.items()
    } | {
        (split, method, "grounding"): [value]
        for method, row in paper["grounding_only"].items()
        for split, value in zip(splits, row, strict=True)
        if method != "columns" and value is not None
    }
    ours = {
        (each.split, each.method, each.track): [
            value * 100 if CATALOGUE[key].unit == "fraction" else value
            for key, value in each.scores.items()
        ]
        for each in published_results()
    }
    assert ours.keys() == printed.keys()
    for key, values in printed.items():
        assert ours[key] == pytest.approx(values, abs=1e-9)
