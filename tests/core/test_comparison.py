"""Comparisons: differences worked out by hand, intervals and tests, verdicts, and the command."""

import json
import re
import shutil
from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reverie_eval import (
    CATALOGUE,
    Comparison,
    GroundTruth,
    ProtocolError,
    Scores,
    compare,
    evaluate,
)
from reverie_eval.analysis import ComparedSubmissionsError, p_text
from reverie_eval.ground_truth import NavigationGraph
from reverie_eval.metrics.engine import IntervalEngine
from reverie_eval.metrics.uncertainty import holm, mcnemar_p, randomisation_p
from reverie_eval.scoring import Interval, Intervals, clusters_of
from tests.conftest import SAMPLES
from tests.support.flat_world import Run
from tests.support.metrics import BINARY_METRICS
from tests.support.terminals import ESCAPES, on_terminal

SPLIT = "val_unseen"
GOOD, MEDIOCRE, DRAWN, BROKEN = (
    str(SAMPLES / f"{name}.json") for name in ("good", "mediocre", "drawn", "broken")
)


def scores_of(sample: str, **how: str) -> Scores:
    return evaluate(sample, split=SPLIT, **how)  # type: ignore[arg-type]


def altered(scores: Scores, changes: Mapping[str, Mapping[int, float]]) -> Scores:
    """Return scores with other values in some episodes."""
    episodes = {key: column.copy() for key, column in scores.episodes.items()}
    for key, values in changes.items():
        episodes[key][list(values)] = list(values.values())
    return replace(scores, episodes=episodes)


def test_a_difference_by_hand() -> None:
    """Two episodes won and one lost of 84; 0.25 is a value that needs no rounding."""
    first = scores_of(GOOD)
    blank = altered(first, {"rgs": dict.fromkeys(range(84), 0.0), "rgspl": {0: 0.5}})
    a = altered(blank, {"rgs": {5: 1.0}})
    b = altered(blank, {"rgs": {7: 1.0, 70: 1.0}, "rgspl": {0: 0.75}})
    found = Comparison.of({"a": a, "b": b})["b"]
    assert found["rgs"].mean == pytest.approx(1 / 84)
    assert (found["rgs"].higher, found["rgs"].lower, found["rgs"].mcnemar_p) == (2, 1, 1.0)
    assert found["rgspl"].mean == pytest.approx(0.25 / 84)
    assert (found["rgspl"].higher, found["rgspl"].lower) == (1, 0)
    assert found["rgspl"].mcnemar_p is None
    assert found["rgspl"].p_value == 1.0  # one swap of two comes as far
    assert found["success"].mean == found["success"].interval.low == 0.0


def test_differences_are_of_paired_values() -> None:
    scores = {name: scores_of(file) for name, file in (("m", MEDIOCRE), ("g", GOOD), ("d", DRAWN))}
    comparison = Comparison.of(scores, "scan", seed=4)
    first = scores["m"]
    keys = [key for key in first if key in scores["d"]]
    cluster = clusters_of(first.ground_truth, "scan")
    changes = {
        name: np.column_stack([scores[name].episodes[key] - first.episodes[key] for key in keys])
        for name in ("g", "d")
    }
    p_value = holm(np.stack([randomisation_p(each, cluster, seed=4) for each in changes.values()]))
    for row, (name, change) in enumerate(changes.items()):
        columns = dict(zip(keys, change.T, strict=True))
        interval = Intervals.of_several(
            {name: columns},
            cluster,
            "scan",
            IntervalEngine(seed=4),
            attrgetter("difference_bounds"),
        )[name]
        assert list(comparison[name]) == keys
        for column, key in enumerate(keys):
            found = comparison[name][key]
            assert found.mean == change[:, column].mean()
            assert found.interval == interval[key]
            assert found.p_value == p_value[row, column]
            assert found.higher == (change[:, column] > 0).sum()
            assert (found.mcnemar_p is not None) == (key in BINARY_METRICS)


def test_the_seed_is_also_that_of_the_swaps() -> None:
    found = [compare(GOOD, DRAWN, split=SPLIT, seed=seed)["drawn"]["rgs"] for seed in (1, 2)]
    assert found[0].p_value != found[1].p_value


def test_p_values_are_corrected_for_the_number_of_comparisons() -> None:
    pair = compare(MEDIOCRE, DRAWN, split=SPLIT)["drawn"]["rgs"]
    among_three = compare(MEDIOCRE, DRAWN, MEDIOCRE, split=SPLIT, names=["m", "drawn", "same"])
    assert among_three["drawn"]["rgs"].p_value == pytest.approx(2 * pair.p_value)
    assert among_three["drawn"]["rgs"].mcnemar_p == pytest.approx(
        2 * mcnemar_p(np.array([pair.higher]), np.array([pair.lower]))[0]
    )


def test_a_large_win_over_many_is_as_significant_as_over_one() -> None:
    """Times twelve by Holm's correction, p could not be below 0.001 with 10,000 swaps."""
    first = scores_of(GOOD)
    lost = altered(first, {"rgspl": dict.fromkeys(range(84), 0.0)})
    names = ["good", *(f"rival {number}" for number in range(12))]
    comparison = compare(first, *[lost] * 12, names=names)
    assert comparison.swaps == 12_000
    assert comparison["rival 11"]["rgspl"].p_value < 0.001
    assert comparison.sentence("rival 11").endswith("p < 0.001")


def test_the_smallest_p_value_is_stated_if_it_is_large(run: Run) -> None:
    copies = [MEDIOCRE] * 3
    out = run("compare", GOOD, *copies, "--split", SPLIT, "--cluster", "scan").out
    assert "with 2 scans and 3 comparisons, p is at least about 1\n" in out


def test_metrics_that_some_submissions_lack_are_left_out() -> None:
    comparison = compare(GOOD, DRAWN, split=SPLIT)
    assert "iou" in comparison.scores["drawn"]
    assert "iou" not in comparison["drawn"]


def test_metrics_of_some_episodes_only_are_left_out() -> None:
    """A predicted point has an error where the target is seen, which may be in other episodes."""
    soon = str(SAMPLES / "soon.json")
    comparison = compare(soon, soon, split=SPLIT, task="soon", names=["a", "b"])
    partial = {key for key in comparison.scores["b"] if CATALOGUE[key].is_partial}
    assert partial
    assert partial.isdisjoint(comparison["b"])


def test_a_submission_without_answers_is_compared_in_navigation() -> None:
    records = json.loads(Path(GOOD).read_bytes())
    walks = [{key: each[key] for key in ("instr_id", "trajectory")} for each in records]
    comparison = compare(GOOD, walks, split=SPLIT, names=["good", "walks"])
    assert "rgs" not in comparison["walks"]
    assert comparison.primary("walks").key == "spl"
    assert comparison.sentence("walks") == "walks and good navigate the same in every episode"
    best = compare(walks, GOOD, split=SPLIT, names=["walks", "good"], baseline="best")
    assert best.first == "good"


def test_a_comparison_shows_its_sentences() -> None:
    first = scores_of(GOOD)
    comparison = Comparison.of({"a": first, "b": first, "c": first})
    assert list(comparison) == ["b", "c"]
    assert len(comparison) == 2
    assert repr(comparison) == (
        "<Comparison: b and a score the same in every episode; c and a score the same in every "
        "episode>"
    )


def test_what_is_given_to_score_by(demo: GroundTruth) -> None:
    """By names, protocol, subset and ground truth; all of them are in the signature."""
    solution = demo.require_solution()
    others = replace(solution, target_object=solution.target_object + 1)
    how: dict[str, Any] = {
        "ground_truth": replace(demo, solution=others),
        "protocol": "duet",
        "subset": demo.episodes.instr_ids[:40],
    }
    comparison = compare(GOOD, MEDIOCRE, split=SPLIT, baseline="mediocre", **how)
    assert comparison.first == "mediocre"
    expected = evaluate(MEDIOCRE, split=SPLIT, **how)
    assert comparison.scores["mediocre"].signature == expected.signature
    assert comparison.scores["mediocre"].episodes["rgs"].tolist() == (
        expected.episodes["rgs"].tolist()
    )


def test_invalid_submissions_are_reported_together() -> None:
    with pytest.raises(ComparedSubmissionsError) as rejected:
        compare(BROKEN, GOOD, [], split=SPLIT, names=["broken", "good", "empty"])
    error = rejected.value
    assert list(error.errors) == ["broken", "empty"]
    assert str(error) == f"broken: {error.errors['broken']}\nempty: {error.errors['empty']}"
    assert len(error.problems) == len(error.errors["broken"].problems) + 1


def test_better_and_worse_submissions_have_positive_differences_in_the_verdict() -> None:
    comparison = compare(GOOD, MEDIOCRE, split=SPLIT)
    assert comparison.sentence("mediocre") == (
        "mediocre is worse than good by 22.70 RGSPL, 95 % interval 10.51 to 34.24, p < 0.001"
    )
    assert compare(MEDIOCRE, GOOD, split=SPLIT).sentence("good") == (
        "good is better than mediocre by 22.70 RGSPL, 95 % interval 10.51 to 34.24, p < 0.001"
    )


def test_a_reversed_difference() -> None:
    difference = compare(GOOD, MEDIOCRE, split=SPLIT)["mediocre"]["rgs"]
    turned = difference.reversed
    assert (turned.mean, turned.p_value) == (-difference.mean, difference.p_value)
    assert (turned.higher, turned.lower) == (difference.lower, difference.higher)
    assert (turned.interval.low, turned.interval.high) == (
        -difference.interval.high,
        -difference.interval.low,
    )


def test_a_difference_that_is_not_significant() -> None:
    first = scores_of(GOOD)
    other = altered(first, {"rgspl": {0: 0.0, 1: 0.0}})
    assert (
        compare(first, other, names=["a", "b"])
        .sentence("b")
        .startswith("No significant difference between b and a in RGSPL: difference -")
    )


def test_identical_submissions_are_reported_as_such() -> None:
    first = scores_of(GOOD)
    comparison = compare(first, GOOD, names=["good", "again"], split=SPLIT)
    assert comparison.sentence("again") == "again and good score the same in every episode"
    other = altered(first, {"steps": {0: 99.0}})
    sentence = compare(first, other, names=["good", "other"]).sentence("other")
    assert sentence == "other and good score the same RGSPL in every episode"


def test_differences_by_rounding_are_no_differences() -> None:
    """One file has a last bit more in every episode."""
    first = scores_of(GOOD)
    metres = first.episodes["path_length"]
    more = dict(enumerate(np.nextafter(metres, np.inf).tolist()))
    comparison = compare(first, altered(first, {"path_length": more}), names=["a", "b"])
    found = comparison["b"]["path_length"]
    assert (found.mean, found.interval, found.p_value) == (0.0, Interval(0.0, 0.0), 1.0)
    assert (found.higher, found.lower) == (0, 0)
    assert comparison.episodes("path_length").empty
    assert comparison.sentence("b") == "b and a score the same in every episode"


def test_loops_walked_in_opposite_directions_score_the_same(
    run: Run, demo: GroundTruth, tmp_path: Path
) -> None:
    """Around a triangle of viewpoints and back to the start, with a sound answer."""
    loops = [triangle(demo.graph, start) for start in demo.episodes.start.tolist()]
    files = []
    for name, step in (("clockwise", 1), ("counter-clockwise", -1)):
        walks = [[demo.graph.viewpoint_ids[place] for place in loop[::step]] for loop in loops]
        records = [
            {
                "instr_id": instr_id,
                "trajectory": [[place, 0, 0] for place in walk],
                "predObjId": int(target),
            }
            for instr_id, walk, target in zip(
                demo.episodes.instr_ids, walks, demo.require_solution().target_object, strict=True
            )
        ]
        files.append(tmp_path / f"{name}.json")
        files[-1].write_text(json.dumps(records))
    lengths = [evaluate(file, split=SPLIT).episodes["path_length"] for file in files]
    assert (lengths[0] != lengths[1]).any()
    status, out, err = run("compare", *map(str, files), "--split", SPLIT)
    assert (status, err) == (0, "")
    assert "counter-clockwise and clockwise score the same RGSPL in every episode." in out
    assert "-0.00" not in out
    assert "p < 0.001" not in out


def triangle(graph: NavigationGraph, start: int) -> list[int]:
    """Return a loop over three viewpoints from a start, or the start alone if there is none."""
    scan = np.flatnonzero(graph.viewpoint_scan == graph.viewpoint_scan[start])
    near = [place for place in scan.tolist() if place != start and joined(graph, start, place)]
    pairs = ((a, b) for a, b in combinations(near, 2) if joined(graph, a, b))
    return next(([start, a, b, start] for a, b in pairs), [start])


def joined(graph: NavigationGraph, a: int, b: int) -> bool:
    return bool(graph.has_edge(np.array(a), np.array(b)))


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        pytest.param("rgspl", -0.00004, "0.00", id="rounds to zero from below"),
        pytest.param("rgspl", -0.00006, "-0.01", id="rounds to a hundredth"),
        pytest.param("path_length", -0.0, "0.00", id="negative zero"),
    ],
)
def test_no_value_is_printed_as_minus_zero(key: str, value: float, text: str) -> None:
    assert CATALOGUE[key].display(value) == text


@pytest.mark.parametrize(
    ("how", "metric"), [({"track": "grounding"}, "RGS"), ({"protocol": "r2r-style"}, "SPL")]
)
def test_the_verdict_uses_another_metric_if_rgspl_is_not_scored(
    how: dict[str, str], metric: str
) -> None:
    scores = [scores_of(sample, **how) for sample in (GOOD, MEDIOCRE)]
    comparison = compare(*scores)
    assert f" {metric}, 95 % interval" in comparison.sentence("submission 2")


def test_significance_needs_both_interval_and_test() -> None:
    comparison = compare(MEDIOCRE, GOOD, split=SPLIT)
    difference = comparison["good"]["rgspl"]
    assert comparison.is_significant("good")
    for changed in (
        replace(difference, p_value=0.05),
        replace(difference, interval=replace(difference.interval, low=0.0)),
        replace(difference, interval=Interval(-0.1, 0.0)),
    ):
        other = replace(comparison, differences={"good": {"rgspl": changed}})
        assert not other.is_significant("good")


def test_episodes_with_different_values() -> None:
    comparison = compare(GOOD, MEDIOCRE, split=SPLIT)
    frame, difference = comparison.episodes("success"), comparison["mediocre"]["success"]
    assert list(frame.columns) == ["good", "mediocre"]
    assert frame.index.name == "instr_id"
    assert len(frame) == difference.higher + difference.lower
    assert (frame["good"] - frame["mediocre"]).abs().eq(1).all()
    assert frame.attrs["units"] == {"good": "fraction", "mediocre": "fraction"}
    assert comparison.episodes("steps").attrs["units"]["good"] == "count"
    first = scores_of(GOOD).to_pandas()["success"]
    pd.testing.assert_series_equal(frame["good"], first[frame.index], check_names=False)


@pytest.mark.parametrize(
    ("how", "key"),
    [({"track": "grounding"}, "rgs"), ({"protocol": "r2r-style"}, "success"), ({}, "rgs")],
)
def test_episodes_are_compared_by_correctness_by_default(how: dict[str, str], key: str) -> None:
    comparison = compare(*(scores_of(sample, **how) for sample in (GOOD, MEDIOCRE)))
    difference = comparison["submission 2"][key]
    assert len(comparison.episodes()) == difference.higher + difference.lower > 0


def test_a_frame_has_a_row_per_submission_and_metric() -> None:
    frame = compare(GOOD, MEDIOCRE, DRAWN, split=SPLIT).to_pandas()
    assert list(frame.index.names) == ["submission", "metric"]
    assert list(frame.columns) == [
        *("first", "value", "difference", "low", "high", "p_value", "higher", "lower"),
        *("mcnemar_p", "caution"),
    ]
    row = frame.xs("drawn").loc["rgs"].to_dict()
    assert row["value"] - row["first"] == pytest.approx(row["difference"])
    assert row["low"] < row["difference"] < row["high"]
    assert set(frame.index.get_level_values("submission")) == {"mediocre", "drawn"}
    assert set(frame.attrs["units"]) == set(frame.index.get_level_values("metric"))
    assert frame.attrs["units"]["path_length"] == "metres"


def test_submissions_that_are_not_comparable() -> None:
    official, other = scores_of(GOOD), scores_of(GOOD, protocol="duet")
    with pytest.raises(ProtocolError) as refused:
        compare(official, other)
    assert str(refused.value) == (
        f"these scores are not comparable: {other.signature}, {official.signature}"
    )
    with pytest.raises(
        ProtocolError, match=r"^a comparison needs two or more submissions with different names$"
    ):
        compare(official)
    with pytest.raises(ProtocolError, match="a name of its own; got x, x"):
        compare(official, official, names=["x", "x"])
    with pytest.raises(ProtocolError, match="a name of its own; got 1"):
        compare(official, official, names=[1])  # type: ignore[list-item]
    with pytest.raises(ProtocolError, match="names of submissions must be text; got 2"):
        compare(official, official, names=["1", 2])  # type: ignore[list-item]
    with pytest.raises(ProtocolError, match=r"^give the split of the submissions: split=\.\.\.$"):
        compare(official, GOOD)
    with pytest.raises(ProtocolError, match="choose one of: target, scan"):
        compare(GOOD, GOOD, split=SPLIT, cluster="room")  # type: ignore[arg-type]
    with pytest.raises(ProtocolError, match="a seed of 0 or more"):
        compare(GOOD, GOOD, split=SPLIT, seed=-1)


@pytest.mark.parametrize(
    ("p_value", "text"), [(0.0009, "p < 0.001"), (0.001, "p = 0.001"), (1.0, "p = 1.000")]
)
def test_p_values_as_papers_write_them(p_value: float, text: str) -> None:
    assert p_text(p_value) == text


TABLE = """\
                      TL m     SR %    OSR %    SPL %    RGS %  RGSPL %
good                  9.84    80.95    88.10    72.88    65.48    57.22
mediocre              8.72    41.67    55.95    35.89    40.48    34.52

mediocre - good      -1.12   -39.29   -32.14   -36.99   -25.00   -22.70
"""


def test_the_command_prints_scores_differences_and_a_sentence(run: Run) -> None:
    status, out, err = run("compare", GOOD, MEDIOCRE, "--split", SPLIT)
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert [line.split() for line in lines[:5]] == [line.split() for line in TABLE.splitlines()]
    rows = {line.split("  ")[0]: line for line in lines[5:10]}
    assert list(rows) == ["95 % low", "95 % high", "p", "won : lost", "McNemar's p"]
    assert rows["won : lost"].split("  ")[-1].strip() == "-"
    assert "4 : 37" in rows["won : lost"]
    assert "mediocre is worse than good by 22.70 RGSPL" in out
    assert scores_of(GOOD).signature in out
    assert "29 targets, seed 0" in out
    assert "note on mediocre: 3 jumps in 3 episodes" in out


@pytest.mark.parametrize("columns", [40, 80, 100])
def test_no_number_is_truncated_on_a_terminal(columns: int, tmp_path: Path) -> None:
    """The column of names is truncated instead, for names of 20 letters."""
    files = [tmp_path / f"{letter * 20}.json" for letter in "ab"]
    for sample, file in zip((GOOD, MEDIOCRE), files, strict=True):
        shutil.copy(sample, file)
    given = ("compare", *map(str, files), "--split", SPLIT)
    table, _, rest = ESCAPES.sub("", on_terminal(columns, *given)).partition("b" * 20 + " is worse")
    comparison = compare(*files, split=SPLIT)
    metrics = comparison.scores[comparison.first].headline
    for metric in metrics:
        shown = (each[metric.key] for each in comparison.scores.values())
        assert all(metric.display(value) in table for value in shown)
        assert metric.display(comparison["b" * 20][metric.key].mean) in table
        assert metric.heading in table
    assert rest
    if columns >= 80:
        assert max(map(len, table.splitlines())) <= columns
        assert re.search(r"p +0\.\d{3}( +(0\.\d{3}|< 0\.001)){5}", table)


RANKED = """\
          TL m   SR %  OSR %  SPL %  RGS %  RGSPL %   diff.     low    high      p   verdict
good      9.84  80.95  88.10  72.88  65.48    57.22       -       -       -      -  baseline
drawn     9.84  80.95  88.10  72.88  57.14    48.90   -8.33  -14.45   -2.50  0.031     worse
mediocre  8.72  41.67  55.95  35.89  40.48    34.52  -22.70  -34.24  -10.51  0.001     worse
"""


def test_several_submissions_have_a_row_each_best_first(run: Run, tmp_path: Path) -> None:
    status, out, err = run("compare", MEDIOCRE, DRAWN, GOOD, "--baseline", GOOD, "--split", SPLIT)
    assert (status, err) == (0, "")
    assert out.startswith(RANKED)
    assert "RGSPL minus that of good" in out


def test_of_a_folder_the_best_is_the_baseline(run: Run, tmp_path: Path) -> None:
    for file in (MEDIOCRE, DRAWN, GOOD):
        shutil.copy(file, tmp_path)
    folder = run("compare", str(tmp_path), "--split", SPLIT).out
    assert "corrected by Holm's method for all 3 pairs, among which the best was chosen" in folder
    best = run("compare", MEDIOCRE, DRAWN, GOOD, "--baseline", "best", "--split", SPLIT).out
    assert folder.splitlines()[:4] == best.splitlines()[:4]
    named = compare(DRAWN, MEDIOCRE, GOOD, split=SPLIT, baseline="good")
    chosen = compare(DRAWN, MEDIOCRE, GOOD, split=SPLIT, baseline="best")
    assert (named.first, chosen.first) == ("good", "good")
    assert (named.pairs, chosen.pairs) == (None, 3)
    # The smallest of the p-values, times two comparisons or three pairs.
    smallest = [each["mediocre"]["success"].mcnemar_p for each in (named, chosen)]
    assert smallest[1] == pytest.approx(1.5 * float(smallest[0] or 0))
    p_values = [each["drawn"]["rgs"].p_value for each in (named, chosen)]
    assert p_values[1] == pytest.approx(p_values[0] * 3 / 2, rel=0.5)
    assert p_values[1] > p_values[0]
    with pytest.raises(ProtocolError, match="no submission is named 'god'; did you mean good"):
        compare(DRAWN, GOOD, split=SPLIT, baseline="god")


def test_names_are_not_folded_on_a_terminal_where_the_numbers_fit(tmp_path: Path) -> None:
    """Other metrics than the primary one are left out instead."""
    names = [f"{letter * 20}" for letter in "abc"]
    for name, file in zip(names, (MEDIOCRE, DRAWN, GOOD), strict=True):
        shutil.copy(file, tmp_path / f"{name}.json")
    shown = ESCAPES.sub("", on_terminal(80, "compare", str(tmp_path), "--split", SPLIT))
    table = [line for line in shown.splitlines() if line.strip().startswith(tuple("abc"))]
    assert [line.split()[0] for line in table] == names[::-1]
    assert table[2].split()[1:] == ["34.52", "-22.70", "-34.24", "-10.51", "0.002", "worse"]


def test_the_command_writes_json_and_csv(run: Run, tmp_path: object) -> None:
    comparison = compare(GOOD, MEDIOCRE, split=SPLIT, cluster="scan")
    options = ("compare", GOOD, MEDIOCRE, "--split", SPLIT, "--cluster", "scan")
    report = json.loads(run(*options, "--format", "json").out)
    difference = comparison["mediocre"]["rgspl"]
    assert report["differences"]["mediocre"]["rgspl"]["interval"] == {
        "low": difference.interval.low,
        "high": difference.interval.high,
    }
    assert report["sentences"] == {"mediocre": comparison.sentence("mediocre")}
    assert report["submissions"]["good"]["scores"] == dict(comparison.scores["good"])
    rows = run(*options, "--format", "csv").out.splitlines()
    assert len(rows) == 1 + len(comparison["mediocre"])
    assert rows[1].startswith(f"mediocre,path_length,{comparison.scores['good']['path_length']!r},")


def test_the_command_writes_the_episodes_with_different_values(run: Run, tmp_path: object) -> None:
    file = f"{tmp_path}/differ.csv"
    assert run("compare", GOOD, MEDIOCRE, "--split", SPLIT, "--episodes", file).status == 0
    written = pd.read_csv(file, index_col="instr_id")
    pd.testing.assert_frame_equal(written, compare(GOOD, MEDIOCRE, split=SPLIT).episodes())


def test_the_command_writes_the_episodes_with_different_success(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "differ.csv"
    options = ("--split", SPLIT, "--protocol", "r2r-style", "--episodes", str(file))
    assert run("compare", GOOD, MEDIOCRE, *options).err == ""
    difference = compare(GOOD, MEDIOCRE, split=SPLIT, protocol="r2r-style")["mediocre"]["success"]
    assert len(pd.read_csv(file)) == difference.higher + difference.lower


def test_all_invalid_files_are_reported_and_nothing_is_compared(run: Run) -> None:
    status, out, err = run("compare", BROKEN, GOOD, BROKEN, "--split", SPLIT)
    assert (status, out) == (1, "")
    assert err.count(f"{BROKEN}: submission rejected, 23 problems") == 2
