"""Several runs of a method: by hand, in worlds with known means, and on the command line."""

import csv
import io
import json
import shutil
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
import scipy
from hypothesis import example, given
from hypothesis import strategies as st

import reverie_eval as rv
from fixtures.clustered_worlds import DIFFERENCE, RATE, simulated_runs
from reverie_eval.arrays import FloatArray
from reverie_eval.metrics import CATALOGUE
from reverie_eval.metrics.engine import CrossedMeans
from reverie_eval.reporting import results_table
from reverie_eval.submissions import find_runs
from tests.conftest import SAMPLES
from tests.support.flat_world import Run

SPLIT = "val_unseen"
SEEDS = ("good", "mediocre", "drawn")


@pytest.fixture(scope="module")
def runs() -> rv.Runs:
    return rv.Runs.of({name: rv.evaluate(SAMPLES / f"{name}.json", split=SPLIT) for name in SEEDS})


@pytest.fixture
def seeds(tmp_path: Path) -> str:
    """Copy three runs of a method, and return the word that names them."""
    for number, name in enumerate(SEEDS):
        shutil.copy(SAMPLES / f"{name}.json", tmp_path / f"seed{number}.json")
    return f"ours={tmp_path}/seed*.json"


def values(*runs: list[float]) -> FloatArray:
    return np.array(runs, dtype=np.float64)[:, :, None]


def test_several_runs_are_explored_as_one_is(runs: rv.Runs) -> None:
    """Each count, mean and episode is that of the runs themselves."""
    each = list(runs.runs.values())
    assert runs.failure_modes.funnel == {
        stage: sum(scores.failure_modes.funnel[stage] for scores in each)
        for stage in each[0].failure_modes.funnel
    }
    by_scan, alone = runs.breakdown("scan"), [scores.breakdown("scan") for scores in each]
    assert by_scan["rgs"].tolist() == pytest.approx(sum(it["rgs"] for it in alone) / len(each))
    assert by_scan["episodes"].tolist() == alone[0].loc[by_scan.index, "episodes"].tolist()
    outcomes = np.array([scores.outcomes for scores in each])
    for outcome, episodes in runs.gallery().items():
        times = (outcomes == outcome).sum(axis=0)
        row = runs.ground_truth.episodes.index
        assert times[row[episodes[0].instr_id]] == times.max()
        assert {each.outcome for each in episodes} == {outcome}


# The arithmetic.


def test_variance_by_hand() -> None:
    """Two runs of four clusters of one episode.

    Run means 0.5 and 0.25, so the variance between runs is 1/32, over 2 runs 1/64. Without each
    cluster in turn, the mean of 0.375 moves by (0.375 - 1) / 3, 0.375 / 3 and (0.375 - 0.5) / 3.
    """
    means = CrossedMeans.of(values([1, 1, 0, 0], [1, 0, 0, 0]), np.arange(4))
    assert means.mean == pytest.approx([0.375])
    assert means.run_variance == pytest.approx(np.array([[1 / 64]]))
    moved = (0.625**2 + 0.125**2 + 2 * 0.375**2) / 9 * 3 / 4
    # The runs differ from their mean by 0.375 in one cluster and by 0.125 in three, both ways.
    noise = 2 * (0.375**2 + 3 * 0.125**2) / 9 * 3 / 4 / 2
    assert means.cluster_variance == pytest.approx([moved - noise])
    assert means.variance == pytest.approx([1 / 64 + moved - noise])
    assert means.run_share == pytest.approx([1 / 64 / (1 / 64 + moved - noise)])
    # Student's t beyond 2.5 %: 12.706 with one degree of freedom, 3.182 with three.
    critical = 3.1824 + (1 / 64 / (1 / 64 + moved - noise)) ** 1.35 * (12.7062 - 3.1824)
    assert means.critical(0.025) == pytest.approx([critical], rel=1e-4)


def test_each_metric_has_its_own_variance() -> None:
    one, other = values([1, 1, 0, 0], [1, 0, 0, 0]), values([3, 0, 3, 0], [0, 0, 3, 3])
    both = CrossedMeans.of(np.concatenate([one, other], axis=2), np.arange(4))
    alone = [CrossedMeans.of(each, np.arange(4)) for each in (one, other)]
    assert both.run_variance[0] == pytest.approx([each.run_variance.item() for each in alone])
    assert both.variance == pytest.approx([each.variance.item() for each in alone])


def test_what_both_methods_count_twice_adds_up_in_their_difference() -> None:
    """As by hand above: the clusters of each method's runs differ by as much."""
    one = CrossedMeans.of(values([1, 1, 0, 0], [1, 0, 0, 0]), np.arange(4))
    noise = 2 * (0.375**2 + 3 * 0.125**2) / 9 * 3 / 4 / 2
    assert one.minus(one).noise == pytest.approx([2 * noise])


def test_a_difference_of_runs_that_are_alike_is_certain_of_nothing() -> None:
    alike = CrossedMeans.of(values([1, 0, 1], [1, 0, 1]), np.arange(3))
    same = alike.minus(alike)
    assert same.variance == pytest.approx([0])
    assert same.p_value(DIFFERENCE) == pytest.approx([1])
    assert same.interval(DIFFERENCE, 0.95)[:, 0].tolist() == [0, 0]


def test_clusters_of_different_sizes_count_for_fewer() -> None:
    """Six episodes in clusters of 4, 1 and 1: 36 / 18 = 2 effective clusters."""
    cluster = np.array([0, 0, 0, 0, 1, 2])
    means = CrossedMeans.of(values([1, 0, 1, 0, 1, 1], [1, 1, 1, 0, 0, 1]), cluster)
    assert means.cluster_freedom == pytest.approx(1)


def test_a_single_run_is_taken_as_it_is() -> None:
    alone = CrossedMeans.of(values([1, 0, 1, 0]), np.arange(4))
    assert alone.run_variance.tolist() == [[0.0]]
    assert alone.critical(0.025) == pytest.approx([3.1824], rel=1e-4)


LENGTH = np.array([[0.0], [np.inf]])
ANYTHING = np.array([[-np.inf], [np.inf]])


@pytest.mark.parametrize(
    ("bounds", "low", "high"),
    [
        # (x - 0.4)^2 = 0.96 / 0.24 x (1 - x), so 5 x^2 - 4.8 x + 0.16 = 0
        pytest.param(RATE, 0.0345789, 0.9254211, id="rate"),
        # (x - 0.4)^2 = 0.96 / 0.4 x
        pytest.param(LENGTH, 0.0508067, 3.1491933, id="length"),
        # 0.4 minus and plus the square root of 0.96
        pytest.param(ANYTHING, -0.5797959, 1.3797959, id="without bounds"),
        # (x - 0.4)^2 = 0.96 / 0.84 (1 - x^2)
        pytest.param(DIFFERENCE, -0.5158368, 0.8891701, id="difference"),
    ],
)
def test_ends_of_a_score_interval_by_hand(bounds: FloatArray, low: float, high: float) -> None:
    """Two runs of 0.4 and 0.4 of five clusters, with half the width of the t interval 0.96^0.5."""
    means = CrossedMeans.of(values([1, 1, 0, 0, 0]), np.arange(5))
    # Of five values with a variance of 0.3, so 0.06 of the mean: 4 standard errors.
    assert means.variance == pytest.approx([0.06])
    tail = float(scipy.special.stdtr(4, -4.0))
    assert means.interval(bounds, 1 - 2 * tail)[:, 0] == pytest.approx([low, high], abs=1e-6)


@given(
    st.lists(
        st.lists(st.sampled_from([0.0, 0.3, 1.0]), min_size=6, max_size=6), min_size=1, max_size=4
    ),
    st.floats(0.01, 0.999),
)
def test_no_end_is_beyond_a_bound(runs: list[list[float]], confidence: float) -> None:
    means = CrossedMeans.of(values(*runs), np.arange(6) // 2)
    low, high = means.interval(RATE, confidence)[:, 0]
    assert 0 <= low <= means.mean[0] + 1e-12
    assert means.mean[0] - 1e-12 <= high <= 1
    assert low < high


@given(
    st.lists(
        st.lists(st.sampled_from([0.0, 0.3, 1.0]), min_size=8, max_size=8), min_size=1, max_size=3
    ),
    st.lists(
        st.lists(st.sampled_from([0.0, 0.3, 1.0]), min_size=8, max_size=8), min_size=1, max_size=3
    ),
)
@example(  # a search through tails that SciPy has no quantile for
    ours=[
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.3, 0.3, 0.3],
        [0.0, 0.0, 0.3, 0.3, 0.3, 0.3, 1.0, 1.0],
        [0.0, 0.0, 0.3, 0.3, 1.0, 1.0, 1.0, 1.0],
    ],
    theirs=[
        [0.0, 0.0, 0.0, 0.0, 0.3, 1.0, 1.0, 1.0],
        [0.0, 0.3, 0.3, 1.0, 0.3, 0.3, 1.0, 1.0],
    ],
)
def test_the_interval_of_a_confidence_of_one_minus_p_ends_at_0(
    ours: list[list[float]], theirs: list[list[float]]
) -> None:
    one, other = (CrossedMeans.of(values(*runs), np.arange(8) // 2) for runs in (ours, theirs))
    means = one.minus(other)
    for bounds in (DIFFERENCE, ANYTHING):
        p_value = float(means.p_value(bounds)[0])
        if not 1e-6 < p_value < 1 - 1e-6:
            continue
        ends = means.interval(bounds, 1 - p_value)[:, 0]
        assert np.abs(ends).min() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("value", "low", "high"),
    [
        # Of 20 clusters, at most 16.8 % have another mean: 0.832^20 = 0.025.
        pytest.param(0.0, 0.0, 0.168433, id="never"),
        pytest.param(1.0, 0.831567, 1.0, id="always"),
        pytest.param(0.5, 0.415783, 0.584217, id="half in every cluster"),
    ],
)
@pytest.mark.parametrize("n_runs", [1, 2])
def test_means_that_are_alike_in_all_clusters(
    value: float, low: float, high: float, n_runs: int
) -> None:
    """Clopper and Pearson's exact interval of no success in 20 trials: 0 to 0.168433."""
    means = CrossedMeans.of(np.full((n_runs, 40, 1), value), np.arange(40) // 2)
    assert means.interval(RATE, 0.95)[:, 0] == pytest.approx([low, high], abs=1e-6)


def test_a_difference_that_is_alike_in_all_clusters() -> None:
    """All swaps but two of 2^20 are less extreme; and at most 16.8 % of clusters are lost."""
    one, other = (CrossedMeans.of(np.full((2, 20, 1), value), np.arange(20)) for value in (1, 0))
    means = one.minus(other)
    assert means.interval(DIFFERENCE, 0.95)[:, 0] == pytest.approx([1 - 2 * 0.168433, 1], abs=1e-6)
    assert means.p_value(DIFFERENCE) == pytest.approx([2.0**-19])
    assert means.p_value(ANYTHING) == pytest.approx([1])


def test_copies_weigh_in_the_mean_but_are_no_evidence() -> None:
    """By hand: runs of 0.5, 0.5 and 0.25. The two different ones have a variance of 1/32.

    Their weights are 2/3 and 1/3, and the sum of their squares is 5/9.
    """
    runs = values([1, 1, 0, 0], [1, 0, 0, 0])
    means = CrossedMeans.of(runs, np.arange(4), np.array([2 / 3, 1 / 3]))
    assert means.mean == pytest.approx([5 / 12])
    assert means.run_variance == pytest.approx(np.array([[5 / 9 / 32]]))
    assert means.run_freedom.tolist() == [[1.0]]


@pytest.mark.parametrize("n_runs", [2, 3, 5, 10])
def test_intervals_contain_the_truth_as_often_as_they_claim(n_runs: int) -> None:
    """A short form of ``benchmarks/runs.py``."""
    shares = simulated_runs(400, n_runs, 100, 0.2)
    assert 0.925 <= shares.held <= 0.985
    assert 0.925 <= shares.held_difference <= 0.99


# In the library.


def test_runs_are_means_of_scores(runs: rv.Runs) -> None:
    scores = list(runs.runs.values())
    assert runs["rgspl"] == pytest.approx(np.mean([each["rgspl"] for each in scores]))
    assert "iou" not in runs  # only one of them has boxes
    interval = runs.intervals["rgspl"]
    assert interval.low < runs["rgspl"] < interval.high
    assert interval.high - interval.low > 0.3  # a mean of 0.57, 0.49 and 0.35 is very uncertain
    assert 0 < runs.intervals.run_shares["rgspl"] < 1
    assert runs.signature == scores[0].signature
    assert "<th scope=" in runs._repr_html_()
    assert repr(runs).startswith("<Runs of 3: TL m ")
    assert ", SR % " in repr(runs)
    assert runs.deviation("rgspl") == pytest.approx(np.std([s["rgspl"] for s in scores], ddof=1))


def test_what_are_not_runs_of_one_method(runs: rv.Runs) -> None:
    good, *_ = runs.runs.values()
    with pytest.raises(rv.ProtocolError, match="1 run given; the variance between runs needs two"):
        rv.Runs.of({"a": good})
    other = rv.evaluate(SAMPLES / "good.json", split=SPLIT, protocol="duet")
    with pytest.raises(
        rv.ProtocolError, match=r"not comparable: split:\S+protocol:duet\S+, split:\S+$"
    ):
        rv.Runs.of({"a": good, "b": other})
    alone = rv.evaluate(SAMPLES / "good.json", split=SPLIT, subset=good.instr_ids[:1])
    with pytest.raises(rv.ProtocolError, match="all episodes share one target"):
        rv.Runs.of({"a": alone, "b": alone})


def test_runs_are_compared_with_runs_and_with_single_files(runs: rv.Runs) -> None:
    turned = rv.Runs.of({name: runs.runs[name] for name in reversed(SEEDS)})
    comparison = rv.compare(runs, turned, SAMPLES / "good.json", names=["a", "b", "c"], split=SPLIT)
    same, single = comparison["b"]["rgspl"], comparison["c"]["rgspl"]
    assert (same.mean, same.p_value, same.higher, same.lower) == (0, 1, 0, 0)
    metres = runs.runs["good"].episodes["path_length"] - runs.episodes["path_length"]
    walked = comparison["c"]["path_length"]
    assert (walked.higher, walked.lower) == ((metres > 1e-9).sum(), (metres < -1e-9).sum())
    assert single.mean == pytest.approx(runs.runs["good"]["rgspl"] - runs["rgspl"])
    assert single.interval.low < 0 < single.mean < single.interval.high
    assert single.mcnemar_p is None
    assert not comparison.is_significant("c")
    assert comparison.intervals["c"].procedure == (
        "95 % intervals: Student's t within the bounds of each metric, by the variance among 1 and "
        "3 runs and among 29 targets"
    )
    # Student's t needs no swaps, and its p-values may be as small as they come.
    assert (comparison.pairs, comparison.swaps, comparison.smallest_p) == (None, 0, 0.0)


def test_the_best_of_several_methods_is_tested_for_all_pairs(runs: rv.Runs) -> None:
    given = (runs, SAMPLES / "mediocre.json", SAMPLES / "good.json")
    named, chosen = (
        rv.compare(*given, names=["a", "b", "c"], split=SPLIT, baseline=baseline)
        for baseline in ("c", "best")
    )
    assert (chosen.first, chosen.pairs) == ("c", 3)
    p_values = [(named["a"][key].p_value, chosen["a"][key].p_value) for key in named["a"]]
    assert all(p <= corrected for p, corrected in p_values)
    assert any(p < corrected for p, corrected in p_values)


def test_a_results_table_has_the_intervals(runs: rv.Runs) -> None:
    table = results_table({"ours": runs, "one": runs.runs["good"]})
    low, high = (100 * end for end in astuple(runs.intervals["rgspl"]))
    assert table.rows[0][-1] == f"{100 * runs['rgspl']:.2f} ({low:.2f} to {high:.2f})"
    assert table.rows[1][-1].startswith("57.22 (")  # every row has one, if any has
    assert f"\\scriptsize ({low:.2f},\\\\ \\scriptsize {high:.2f})" in table.to_latex()
    assert f"{SPLIT}: {runs.intervals.caption}" in table.notes


TWO = "only 2 runs: too few to show how much runs differ"


def test_runs_that_are_equal_are_named_and_count_as_one(runs: rv.Runs) -> None:
    good, mediocre, _ = runs.runs.values()
    copied = rv.Runs.of({"a": good, "b": mediocre, "c": good})
    pair = rv.Runs.of({"a": good, "b": mediocre})
    assert copied["rgspl"] == pytest.approx((2 * good["rgspl"] + mediocre["rgspl"]) / 3)
    assert (copied.intervals.n_runs, copied.intervals.copies) == ([2], [["a", "c"]])
    assert copied.intervals.caution == (
        "a and c have the same values in every episode (a copy?): they count as one run; "
        f"{pair.intervals.caution}"
    )
    assert pair.intervals.caution.startswith(TWO)


def test_copies_alone_have_the_interval_of_one_run(runs: rv.Runs) -> None:
    good = runs.runs["good"]
    copied = rv.Runs.of({"a": good, "b": good, "c": good})
    known = rv.Runs.of({"a": good, "b": runs.runs["mediocre"]}).intervals["rgspl"]
    found = copied.intervals["rgspl"]
    assert copied.intervals.run_shares["rgspl"] == 0
    assert found.high - found.low < known.high - known.low
    assert "a and b and c have the same values in every episode (a copy?)" in (
        copied.intervals.caution
    )
    assert copied.intervals.caution.endswith(
        "nothing shows how much other runs would differ, so these intervals are about the choice "
        "of episodes alone"
    )
    comparison = rv.compare(copied, runs, names=["copied", "ours"])
    assert "among 3 and 1 runs" in comparison.intervals["ours"].procedure
    assert "(a copy?)" in comparison.intervals["ours"].caption


# On the command line.


def test_every_output_warns_about_two_runs(run: Run, runs: rv.Runs) -> None:
    two = f"ours={SAMPLES / 'good.json'},{SAMPLES / 'mediocre.json'}"
    single = str(SAMPLES / "drawn.json")
    for layout in ("table", "json", "csv", "markdown", "latex"):
        options = ("--split", SPLIT, "--format", layout)
        assert TWO in run(two, *options).out
        assert TWO in run("compare", two, single, *options).out
    pair = rv.Runs.of({name: runs.runs[name] for name in SEEDS[:2]})
    assert TWO in pair._repr_html_()
    assert TWO in rv.compare(pair, single, split=SPLIT, names=["a", "b"])._repr_html_()


def test_two_runs_have_no_end_beyond_a_bound(run: Run, tmp_path: Path) -> None:
    """No answer of the second run predicts an object: RGS is 65.48 and 0 %."""
    entries = json.loads(SAMPLES.joinpath("good.json").read_text())
    blank = [{**entry, "predObjId": None} for entry in entries]
    (tmp_path / "blank.json").write_text(json.dumps(blank))
    two = f"ours={SAMPLES / 'good.json'},{tmp_path / 'blank.json'}"
    options = ("--split", SPLIT, "--format", "json")
    report = json.loads(run(two, *options).out)
    for key, (low, high) in report["intervals"].items():
        least, most = CATALOGUE[key].bounds
        assert least <= low <= report["scores"][key] <= high <= most
    compared = json.loads(run("compare", str(SAMPLES / "good.json"), two, *options).out)
    for key, found in compared["differences"]["ours"].items():
        least, most = CATALOGUE[key].difference_bounds
        assert least <= found["interval"]["low"] <= found["interval"]["high"] <= most


def test_the_table_of_runs(seeds: str, run: Run, runs: rv.Runs) -> None:
    status, out, err = run(seeds, "--split", SPLIT)
    assert (status, err) == (0, "")
    rows = {line[:18].strip(): line[18:].split() for line in out.splitlines()[1:10]}
    assert list(rows) == [
        "seed0",
        "seed1",
        "seed2",
        "",
        "mean",
        "95 % low",
        "95 % high",
        "standard deviation",
        "due to runs",
    ]
    assert rows["seed0"][-1] == "57.22"
    assert rows["mean"][-1] == f"{100 * runs['rgspl']:.2f}"
    assert rows["95 % high"][-1] == f"{100 * runs.intervals['rgspl'].high:.2f}"
    assert rows["standard deviation"][-1] == f"{100 * runs.deviation('rgspl'):.2f}"
    assert rows["due to runs"][-2:] == [f"{100 * runs.intervals.run_shares['rgspl']:.0f}", "%"]
    assert "among 3 runs and among 29 targets" in out


def test_runs_as_json_csv_and_latex(seeds: str, run: Run, runs: rv.Runs) -> None:
    options = (seeds, "--split", SPLIT, "--format")
    report = json.loads(run(*options, "json").out)
    assert report["scores"] == dict(runs)
    assert list(report["runs"]) == ["seed0", "seed1", "seed2"]
    assert report["intervals"]["spl"][1] == runs.intervals["spl"].high
    rows = {row["run"]: row for row in csv.DictReader(io.StringIO(run(*options, "csv").out))}
    assert float(rows["mean"]["rgspl"]) == runs["rgspl"]
    assert rows["mean"]["iou"] == rows["mean"]["caution"] == ""
    assert rows["mean"]["signature"] == runs.signature
    assert r"ours & " in run(*options, "latex").out
    assert "| mean |" in run(*options, "markdown").out


def test_methods_are_compared_over_their_runs(seeds: str, run: Run) -> None:
    good = str(SAMPLES / "good.json")
    theirs = f"theirs={good},{SAMPLES / 'drawn.json'}"
    status, out, err = run("compare", seeds, theirs, "--split", SPLIT)
    assert (status, err) == (0, "")
    assert "theirs - ours" in out
    assert "McNemar" not in out
    assert "No significant difference between theirs and ours in RGSPL" in out
    assert "among 2 and 3 runs and among 29 targets" in out
    out = run("compare", good, seeds, "--split", SPLIT, "--format", "json").out
    assert json.loads(out)["submissions"]["ours"]["clusters"] == 29
    out = run("compare", good, seeds, "--split", SPLIT).out
    assert "good: one run, without variance between runs" in out


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["a={good}", "--split", SPLIT], "1 run given"),
        (["a={good},{good}.gz", "{good}", "--split", SPLIT], "give NAME=FILES alone"),
        (["a={good},{good}", "--split", SPLIT], "good.json is named twice; name each run once"),
        (["compare", "a={good},{good}", "{good}", "--split", SPLIT], "is named twice"),
        (["a={good},,none.json", "--split", SPLIT], "a comma has no file before or after it"),
        (["a={good},{folder}/../submissions/good.json", "--split", SPLIT], "is named twice"),
        (["a={folder}/goo*.json,{good}", "--split", SPLIT], "good.json is named twice"),
        (["a={good},", "--split", SPLIT], "a comma has no file before or after it"),
        (["a={good},none.json", "--split", SPLIT], "none.json: No such file"),
        (["a=*.nothing", "--split", SPLIT], "*.nothing: no submission found"),
        (["compare", "a={good}", "a={good}", "--split", SPLIT], "two methods are named a"),
        (["a={good},{good}.gz", "--split", SPLIT, "--episodes", "x"], "--episodes cannot be"),
    ],
)
def test_what_are_no_runs(line: list[str], said: str, run: Run) -> None:
    status, out, err = run(
        *(word.format(good=SAMPLES / "good.json", folder=SAMPLES) for word in line)
    )
    assert (status, out) == (2, "")
    assert said in err


def test_a_file_with_an_equals_sign_is_a_file(run: Run, here: Path) -> None:
    shutil.copy(SAMPLES / "good.json", here / "lr=1.json")
    assert "57.22" in run("lr=1.json", "--split", SPLIT).out


def test_a_pattern_searches_folders_for_runs(run: Run, here: Path) -> None:
    for seed in "12":
        (here / "seeds" / seed).mkdir(parents=True)
        shutil.copy(SAMPLES / "good.json", here / "seeds" / seed / "a=b.json")
    for files in ("seeds/**/*.json", "seeds/1,seeds/2", "seeds/?/a=b.json"):
        assert find_runs(f"ours={files}") == ("ours", ["seeds/1/a=b.json", "seeds/2/a=b.json"])
    for word in ("seeds/1/a=b.json", "ours=", "=seeds/1", "*=seeds", "ours"):
        assert find_runs(word) is None
    shutil.copy(SAMPLES / "good.json", here / "1,2.json")
    assert find_runs("ours=1,2.json") == ("ours", ["1,2.json"])
