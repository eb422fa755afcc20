"""Confidence intervals of scores: how they are computed, and where they are shown."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from reverie_eval import GroundTruth, ProtocolError, compare, evaluate
from reverie_eval.metrics import CATALOGUE
from reverie_eval.metrics.engine import IntervalEngine
from reverie_eval.scoring import Clustering, Intervals, clusters_of
from tests.conftest import SAMPLES
from tests.support.flat_world import SCORE, Run

FEW = "only 2 scans: too few to show how much scans differ, so these intervals are very wide"
OTHER = str(SAMPLES / "mediocre.json")
RARE = "; score method where few targets succeed or few fail"
SAMPLE = (str(SAMPLES / "good.json"), "--split", "val_unseen")


def test_clusters_are_target_objects_or_scans(demo: GroundTruth) -> None:
    start, target = demo.episodes.start, demo.require_solution().target_object
    scans = [demo.graph.scan_of(viewpoint) for viewpoint in start]
    for by, shared in (
        ("target", list(zip(scans, target.tolist(), strict=True))),
        ("scan", scans),
    ):
        cluster = clusters_of(demo, by).tolist()  # type: ignore[arg-type]
        assert len(set(zip(cluster, shared, strict=True))) == len(set(cluster)) == len(set(shared))


@pytest.mark.parametrize(
    ("by", "clusters"),
    [
        ("scan", f"score method, over 2 scans; {FEW}"),
        ("target", f"500 bootstrap resamples of 29 targets, seed 7{RARE}"),
    ],
)
def test_intervals_of_scores_equal_those_of_their_values(
    by: Clustering, clusters: str, demo: GroundTruth
) -> None:
    scores = evaluate(SAMPLE[0], split="val_unseen").with_intervals(by, resamples=500, seed=7)
    drawn = scores.intervals
    assert drawn is not None
    cluster = clusters_of(demo, by)
    for key in ("path_length", "rgspl"):
        values, bounds = scores.episodes[key][:, None], CATALOGUE[key].bounds
        engine = IntervalEngine(resamples=500, seed=7)
        low, high = engine.of_means(values, cluster, np.array([bounds]).T).ends[:, 0]
        assert (drawn[key].low, drawn[key].high) == pytest.approx((low, high))
    assert list(drawn) == list(scores)
    assert drawn.caption == f"95 % intervals: {clusters}"


@pytest.mark.parametrize(("clusters", "is_cautious"), [(2, True), (4, True), (5, False)])
def test_few_clusters_have_a_caution(clusters: int, *, is_cautious: bool) -> None:
    drawn = Intervals("target", clusters, 0.9, {}, 500, 0)
    assert bool(drawn.caution) is is_cautious
    assert ("too few to show how much targets differ" in drawn.caption) is is_cautious


def test_every_output_with_intervals_warns_about_few_clusters(run: Run) -> None:
    other = str(SAMPLES / "mediocre.json")
    by_scan = ("--cluster", "scan", *SAMPLE[1:])
    for shown in (
        run(SAMPLE[0], "--ci", *by_scan).out,
        run("compare", SAMPLE[0], other, *by_scan).out,
        run("compare", SAMPLE[0], other, *by_scan, "--format", "json").out,
        run("report", SAMPLE[0], *by_scan).out,
        evaluate(SAMPLE[0], split="val_unseen").with_intervals("scan")._repr_html_(),
        compare(SAMPLE[0], other, split="val_unseen", cluster="scan")._repr_html_(),
    ):
        assert FEW in shown
    report = run("report", SAMPLE[0], other, *by_scan).out
    assert report.count(FEW) == 2  # of the scores, and of their differences


@pytest.mark.parametrize(
    ("by", "least"),
    [("scan", "; with 2 scans, p is at least about 0.5\n"), ("target", "targets, seed 0\n")],
)
def test_few_clusters_cannot_have_a_small_p_value(by: str, least: str, run: Run) -> None:
    files = (SAMPLE[0], str(SAMPLES / "mediocre.json"))
    assert least in run("compare", *files, *SAMPLE[1:], "--cluster", by).out


def test_higher_confidence_gives_wider_intervals() -> None:
    scores = evaluate(SAMPLE[0], split="val_unseen")
    narrow, wide = (
        scores.with_intervals(confidence=confidence).intervals for confidence in (0.5, 0.99)
    )
    assert narrow is not None
    assert wide is not None
    assert wide["rgs"].low < narrow["rgs"].low < scores["rgs"] < narrow["rgs"].high
    assert (narrow.label, wide.label) == ("50 %", "99 %")


@pytest.mark.parametrize(
    "options",
    [
        {"confidence": 1.0},
        {"confidence": 0},
        {"confidence": 95},
        {"resamples": 0},
        {"seed": -1},
    ],
    ids=str,
)
def test_settings_out_of_range_are_refused(options: dict[str, float]) -> None:
    scores = evaluate(SAMPLE[0], split="val_unseen")
    expected = (
        "expected a confidence between 0 and 1, at least one resample, and a seed of 0 or more"
    )
    with pytest.raises(ProtocolError, match=f"; {expected}$"):
        scores.with_intervals(**options)  # type: ignore[arg-type]


def test_a_single_resample_is_allowed() -> None:
    drawn = evaluate(SAMPLE[0], split="val_unseen").with_intervals(resamples=1).intervals
    assert drawn is not None
    assert drawn["rgs"].low == drawn["rgs"].high


def test_a_misspelt_clustering_is_refused_with_a_guess() -> None:
    scores = evaluate(SAMPLE[0], split="val_unseen")
    with pytest.raises(ProtocolError, match="by 'targets'; did you mean target"):
        scores.with_intervals("targets")  # type: ignore[arg-type]


@pytest.mark.usefixtures("here")
def test_episodes_of_a_single_target_have_no_intervals(run: Run) -> None:
    status, out, err = run(*SCORE, "--ci")
    assert (status, out) == (2, "")
    assert "all episodes share one target" in err
    assert "all episodes share one scan" in run(*SCORE, "--ci", "--cluster", "scan").err
    truth = GroundTruth.load("full.npz")
    for by in get_args(Clustering):
        reason = f"all episodes share one {by}, so there is nothing to resample"
        assert Intervals.why_not(truth, by) == reason


def test_the_table_has_a_row_for_each_end(run: Run) -> None:
    lines = run(*SAMPLE, "--ci").out.splitlines()
    means, low, high = (line.split()[-6:] for line in lines[1:4])
    assert lines[2].startswith("95 % low ")
    assert lines[3].startswith("95 % high ")
    for below, mean, above in zip(low, means, high, strict=True):
        assert float(below) < float(mean) < float(above)
    assert lines[6] == f"95 % intervals: 10,000 bootstrap resamples of 29 targets, seed 0{RARE}"


def test_the_cluster_option_implies_intervals(run: Run) -> None:
    assert run(*SAMPLE, "--cluster", "scan") == run(*SAMPLE, "--cluster", "scan", "--ci")
    assert run(*SAMPLE, "--cluster", "target") == run(*SAMPLE, "--ci")


def test_every_protocol_has_its_own_intervals(run: Run) -> None:
    lines = run(*SAMPLE, "--ci", "--protocol", "all").out.splitlines()
    assert [line.split("  ")[0] for line in lines[22:25]] == ["r2r-style", "95 % low", "95 % high"]
    assert all(line.split()[-2:] == ["-", "-"] for line in lines[22:25])


def test_json_and_csv_have_the_same_intervals(run: Run) -> None:
    scores = evaluate(SAMPLE[0], split="val_unseen").with_intervals("scan")
    assert isinstance(scores.intervals, Intervals)
    ends = {key: (each.low, each.high) for key, each in scores.intervals.items()}
    options = (*SAMPLE, "--ci", "--cluster", "scan", "--format")
    report = json.loads(run(*options, "json").out)["intervals"]
    assert {key: tuple(each) for key, each in report.pop("intervals").items()} == ends
    assert report == {
        "by": "scan",
        "clusters": 2,
        "confidence": 0.95,
        "resamples": 10_000,
        "seed": 0,
    }
    (row,) = csv.DictReader(io.StringIO(run(*options, "csv").out))
    assert {key: (float(row[f"{key}_low"]), float(row[f"{key}_high"])) for key in ends} == ends
    flat = scores.to_dict()
    assert flat["rgspl"] == scores["rgspl"]
    assert (flat["rgspl_low"], flat["rgspl_high"]) == ends["rgspl"]


@pytest.mark.parametrize("value", [0.0, 1.0])
@pytest.mark.parametrize("by", get_args(Clustering))
def test_a_rate_of_0_or_100_percent_has_an_interval(value: float, by: Clustering) -> None:
    """By hand: of n clusters, at most a share u has another mean, with (1 - u)^n = 0.025.

    n is the effective number of clusters, which differ in size.
    """
    scores = evaluate(SAMPLE[0], split="val_unseen")
    whole = dict.fromkeys(("rgs", "rgspl"), np.full(84, value))
    known = replace(scores, episodes={**scores.episodes, **whole}).with_intervals(by).intervals
    assert known is not None
    _, sizes = np.unique(clusters_of(scores.ground_truth, by), return_counts=True)
    unseen = 1 - 0.025 ** ((sizes**2).sum() / 84**2)
    for key in whole:
        ends = (0.0, unseen) if value == 0 else (1 - unseen, 1.0)
        assert (known[key].low, known[key].high) == pytest.approx(ends)


def test_a_file_without_answers_has_an_interval_of_its_rgs(run: Run, tmp_path: Path) -> None:
    entries = json.loads(SAMPLES.joinpath("good.json").read_text())
    file = tmp_path / "in.json"
    file.write_text(json.dumps([{**entry, "predObjId": None} for entry in entries]))
    rows = [line.split() for line in run(str(file), *SAMPLE[1:], "--ci").out.splitlines()[1:4]]
    assert [row[-2] for row in rows] == ["0.00", "0.00", "13.44"]


def test_more_successes_never_lower_an_end() -> None:
    """From none to all of 30 clusters succeed: through exact, score and bootstrap intervals."""
    rate, cluster = np.array([[0.0], [1.0]]), np.arange(30)
    ends = np.array(
        [
            IntervalEngine(resamples=2000)
            .of_means((cluster < n)[:, None].astype(np.float64), cluster, rate)
            .ends
            for n in range(31)
        ]
    )
    assert (np.diff(ends[:, :, 0], axis=0) >= 0).all()
    assert (ends[:, 0, 0] < ends[:, 1, 0]).all()


@pytest.mark.parametrize(
    "words", [[SAMPLE[0]], [f"ours={SAMPLE[0]},{OTHER}"]], ids=["file", "runs"]
)
def test_confidence_on_the_command_line(words: list[str], run: Run) -> None:
    """It has the same meaning for files and runs, and is that of the library."""
    by_confidence = [
        run(*words, *SAMPLE[1:], "--confidence", level).out for level in ("0.5", "0.95")
    ]
    ends = [
        {
            row[:9]: float(row.split()[-1])
            for row in out.splitlines()
            if row[3:8] in {"% low", "% hig"}
        }
        for out in by_confidence
    ]
    assert "50 % intervals: " in by_confidence[0]
    assert ends[1]["95 % low "] < ends[0]["50 % low "] < ends[0]["50 % high"] < ends[1]["95 % high"]
    assert by_confidence[1] == run(*words, *SAMPLE[1:], "--ci").out


def test_confidence_decides_what_is_significant(run: Run) -> None:
    words = ("compare", SAMPLE[0], str(SAMPLES / "drawn.json"), *SAMPLE[1:])
    sure, surer = (run(*words, "--confidence", level).out for level in ("0.9", "0.999"))
    assert "drawn is worse than good" in sure
    assert "90 % low" in sure
    assert "No significant difference between drawn and good" in surer
    assert "99.9 % low" in surer


@pytest.mark.parametrize("level", ["0", "1", "95", "-0.5", "nan", "high"])
@pytest.mark.parametrize("command", ["score", "compare"])
def test_a_confidence_out_of_range_is_refused(command: str, level: str, run: Run) -> None:
    status, out, err = run(command, SAMPLE[0], OTHER, *SAMPLE[1:], "--confidence", level)
    assert (status, out) == (2, "")
    assert "Invalid value for '--confidence'" in err
    assert ("write 0.95 for 95 %" in err) is (level == "95")


def test_only_scoring_takes_all_protocols(run: Run) -> None:
    status, out, err = run("compare", SAMPLE[0], OTHER, *SAMPLE[1:], "--protocol", "all")
    assert (status, out) == (2, "")
    assert "only `reverie-eval FILE` takes --protocol all; choose one here: official-v1, " in err


def test_there_are_no_intervals_by_default(run: Run) -> None:
    assert json.loads(run(*SAMPLE, "--format", "json").out)["intervals"] is None
    assert "low" not in run(*SAMPLE, "--format", "csv").out
    assert next(iter(evaluate(SAMPLE[0], split="val_unseen").to_dict())) == "path_length"
