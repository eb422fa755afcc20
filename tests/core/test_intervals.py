"""Confidence intervals of scores: how they are computed, and where they are shown."""

import csv
import io
import json
from typing import get_args

import numpy as np
import pytest

from reverie_eval import GroundTruth, ProtocolError, compare, evaluate
from reverie_eval.metrics.uncertainty import bootstrap_means, interval
from reverie_eval.scoring import Clustering, Intervals, clusters_of
from tests.conftest import SAMPLES
from tests.support.flat import SCORE, Run

FEW = "only 2 scans: such intervals contain the true mean less often than 95 % of the time"
SAMPLE = (str(SAMPLES / "good.json"), "--split", "val_unseen")


def test_clusters_are_target_objects_or_scans(demo: GroundTruth) -> None:
    start, target = demo.episodes.start, demo.require_answers().target_object
    scans = [demo.graph.scan_of(viewpoint) for viewpoint in start]
    for by, shared in (
        ("target", list(zip(scans, target.tolist(), strict=True))),
        ("scan", scans),
    ):
        cluster = clusters_of(demo, by).tolist()  # type: ignore[arg-type]
        assert len(set(zip(cluster, shared, strict=True))) == len(set(cluster)) == len(set(shared))


@pytest.mark.parametrize(
    ("by", "clusters"),
    [("scan", f"2 scans, seed 7; {FEW}"), ("target", "29 targets, seed 7")],
)
def test_intervals_of_scores_equal_those_of_their_values(
    by: Clustering, clusters: str, demo: GroundTruth
) -> None:
    scores = evaluate(SAMPLE[0], split="val_unseen").with_intervals(by, resamples=500, seed=7)
    drawn = scores.intervals
    assert drawn is not None
    cluster = clusters_of(demo, by)
    for key in ("path_length", "rgspl"):
        means = bootstrap_means(scores.episodes[key][:, None], cluster, resamples=500, seed=7)
        low, high = interval(means, len(np.unique(cluster)))[:, 0]
        assert (drawn[key].low, drawn[key].high) == pytest.approx((low, high))
    assert list(drawn) == list(scores)
    assert drawn.caption == f"95 % intervals: 500 bootstrap resamples of {clusters}"


@pytest.mark.parametrize(("clusters", "is_cautious"), [(2, True), (4, True), (5, False)])
def test_few_clusters_have_a_caution(clusters: int, *, is_cautious: bool) -> None:
    drawn = Intervals("target", clusters, 0.9, {}, 500, 0)
    assert bool(drawn.caution) is is_cautious
    assert ("less often than 90 % of the time" in drawn.caption) is is_cautious


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
    assert lines[6] == "95 % intervals: 10,000 bootstrap resamples of 29 targets, seed 0"


def test_the_cluster_option_implies_intervals(run: Run) -> None:
    assert run(*SAMPLE, "--cluster", "scan") == run(*SAMPLE, "--cluster", "scan", "--ci")
    assert run(*SAMPLE, "--cluster", "target") == run(*SAMPLE, "--ci")


def test_every_protocol_has_its_own_intervals(run: Run) -> None:
    lines = run(*SAMPLE, "--ci", "--protocol", "all").out.splitlines()
    assert [line.split("  ")[0] for line in lines[19:22]] == ["r2r-style", "95 % low", "95 % high"]
    assert all(line.split()[-2:] == ["-", "-"] for line in lines[19:22])


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


def test_there_are_no_intervals_by_default(run: Run) -> None:
    assert json.loads(run(*SAMPLE, "--format", "json").out)["intervals"] is None
    assert "low" not in run(*SAMPLE, "--format", "csv").out
    assert next(iter(evaluate(SAMPLE[0], split="val_unseen").to_dict())) == "path_length"
