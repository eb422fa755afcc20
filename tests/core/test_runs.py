"""Several runs of a method: by hand, in worlds with known means, and on the command line."""

import csv
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import reverie_eval as rv
from fixtures.clustered_worlds import simulated_runs
from reverie_eval.arrays import FloatArray
from reverie_eval.metrics.runs import CrossedMeans
from reverie_eval.reporting import results_table
from reverie_eval.submissions import find_runs
from tests.conftest import SAMPLES
from tests.support.flat import Run

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
    freedom = (1 / 64 + moved - noise) ** 2 / ((1 / 64) ** 2 / 1 + (moved - noise) ** 2 / 3)
    assert means.freedom == pytest.approx([freedom])


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
    assert same.p_value == pytest.approx([1])
    assert same.interval()[:, 0].tolist() == [0, 0]


def test_clusters_of_different_sizes_count_for_fewer() -> None:
    """Six episodes in clusters of 4, 1 and 1: 36 / 18 = 2 effective clusters."""
    cluster = np.array([0, 0, 0, 0, 1, 2])
    means = CrossedMeans.of(values([1, 0, 1, 0, 1, 1], [1, 1, 1, 0, 0, 1]), cluster)
    assert means.cluster_freedom == pytest.approx(1)


def test_a_single_run_is_taken_as_it_is() -> None:
    alone = CrossedMeans.of(values([1, 0, 1, 0]), np.arange(4))
    assert alone.run_variance.tolist() == [[0.0]]
    assert alone.freedom == pytest.approx([3])


@pytest.mark.parametrize("n_runs", [3, 5, 10])
def test_intervals_contain_the_truth_as_often_as_they_claim(n_runs: int) -> None:
    """A short form of ``benchmarks/runs.py``."""
    shares = simulated_runs(400, n_runs, 100, 0.2)
    assert 0.925 <= shares.held <= 0.975
    assert 0.925 <= shares.held_difference <= 0.985


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
    assert comparison.intervals["c"].method == (
        "95 % intervals: Student's t, by the variance among 1 and 3 runs and among 29 targets"
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
    half = 100 * (runs.intervals["rgspl"].high - runs["rgspl"])
    assert table.rows[0][-1] == f"{100 * runs['rgspl']:.2f} ± {half:.2f}"
    assert table.rows[1][-1] == "57.22"
    assert rf"\textpm{{}} {half:.2f}" in table.to_latex()
    assert "half the width of 95 % intervals: Student's t, by the variance among 3 runs" in (
        table.caption
    )


# On the command line.


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
    assert rows["mean"]["iou"] == ""
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
        (["a={good},{good}.gz", "--split", SPLIT, "--episodes", "x"], "need a single file"),
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
