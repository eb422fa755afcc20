"""Figures of scores with matplotlib: what is drawn, and where."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon, Rectangle

import reverie_eval as rv
from reverie_eval.analysis import near_misses
from reverie_eval.reporting import plot_curve
from reverie_eval.reporting.charts import Histogram
from tests.conftest import SAMPLES
from tests.support.forms import FORMS
from tests.support.home_world import home_scores, perfect

mpl.use("agg")


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    """Close what was drawn."""
    yield
    plt.close("all")


def bars(axes: Axes) -> list[Rectangle]:
    return [patch for patch in axes.patches if isinstance(patch, Rectangle)]


def segments(axes: Axes) -> list[Any]:
    """Return the lines of each collection of lines."""
    return [it.get_segments() for it in axes.collections if isinstance(it, LineCollection)]


def explained(axes: Axes) -> list[str]:
    """Return the texts of the legend."""
    legend = axes.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]


@pytest.fixture(scope="module")
def scores(tmp_path_factory: pytest.TempPathFactory) -> rv.Scores:
    """Score an episode of every outcome."""
    return home_scores(tmp_path_factory.mktemp("home"))


def widths(axes: Axes) -> list[float]:
    """Return how long the bars are."""
    return [bar.get_width() for bar in bars(axes)]


def test_the_funnel(scores: rv.Scores) -> None:
    axes = scores.plot.funnel()
    assert widths(axes) == [5, 3, 2, 1]
    stages = [label.get_text() for label in axes.get_yticklabels()]
    assert stages == [
        "all episodes",
        "reached the goal",
        "stopped at the goal",
        "predicted the target",
    ]
    assert [text.get_text() for text in axes.texts] == [
        "5  (100.0 %)",
        "3  (60.0 %)",
        "2  (40.0 %)",
        "1  (20.0 %)",
    ]
    assert axes.get_xlabel() == "episodes  (percent of all episodes)"


def test_a_breakdown(scores: rv.Scores) -> None:
    """Two of three episodes with 6 m to go stop at the goal, and two answer right."""
    axes = scores.plot.breakdown("length")
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == ["6 to 8 m  (n = 3)", "10 to 12 m  (n = 2)"]
    success, rgspl = np.split(np.array(widths(axes)), 2)
    assert success.tolist() == pytest.approx([200 / 3, 0])
    assert rgspl.tolist() == pytest.approx([200 / 3, 0])
    assert explained(axes) == ["SR", "RGSPL"]
    assert not axes.collections  # a part of one target has no interval


def test_intervals_of_a_breakdown_are_those_of_the_breakdown() -> None:
    scores = rv.evaluate(SAMPLES / "good.json", split="val_unseen")
    axes = scores.plot.breakdown("level")
    table = scores.breakdown("level", intervals=True)
    (drawn,) = segments(axes)
    ends = np.array(drawn)
    expected = 100 * table[["rgspl_low", "rgspl_high"]].to_numpy()
    assert ends[:, :, 0].tolist() == pytest.approx(expected[~np.isnan(expected[:, 0])])
    rgspl = [bar.get_y() + bar.get_height() / 2 for bar in bars(axes)[len(table) :]]
    assert ends[:, 0, 1].tolist() == pytest.approx(rgspl)


@pytest.mark.parametrize(
    ("how", "drawn"),
    [
        pytest.param({"track": "grounding"}, ["RGS"], id="grounding"),
        pytest.param({"protocol": "r2r-style"}, ["SR", "SPL"], id="navigation"),
    ],
)
def test_breakdowns_of_what_is_scored(how: dict[str, str], drawn: list[str]) -> None:
    scores = rv.evaluate(SAMPLES / "good.json", split="val_unseen", **how)  # type: ignore[arg-type]
    shown = explained(scores.plot.breakdown("scan"))
    assert [each for each in shown if "%" not in each] == drawn


def test_a_distribution_in_bars(scores: rv.Scores) -> None:
    """Stops are 0, 4.005, 6, 10.005 and 10.005 m from the end."""
    axes = scores.plot.distribution("navigation_error")
    corners = [each.get_xy() for each in axes.patches if isinstance(each, Polygon)]
    heights = {round(bar[:, 0].min()): bar[:, 1].max() for bar in corners}
    assert heights == pytest.approx({0: 20, 4: 20, 6: 20, 10: 40})
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "navigation error (m)",
        "share of episodes (%)",
    )


def test_no_distance_is_below_zero() -> None:
    scores = rv.evaluate(perfect(), split="val_unseen")
    axes = scores.plot.distribution("navigation_error")
    assert axes.get_xlim() == (0, 1)


@pytest.mark.parametrize("metric", ["steps", "jumps"])
def test_counts_are_marked_by_whole_numbers(metric: str, scores: rv.Scores) -> None:
    axes = scores.plot.distribution(metric)
    low, high = axes.get_xlim()
    ticks = [tick for tick in axes.get_xticks() if low <= tick <= high]
    assert 0 in ticks
    assert all(tick == int(tick) for tick in ticks)


def test_walked_over_shortest(scores: rv.Scores) -> None:
    axes = scores.plot.distribution("path_length")
    points = [np.asarray(line.get_xydata()) for line in axes.lines if line.get_marker() == "o"]
    dots = [each[~np.isnan(each).any(axis=1)] for each in points]
    assert [len(each) for each in dots] == [3, 2]
    assert sorted(dots[1][:, 0].tolist()) == [6, 6]
    assert sorted(dots[1][:, 1].tolist()) == pytest.approx([6, 6 + np.sqrt(16.04)])


def test_the_distribution_of_boxes_leaves_out_other_answers() -> None:
    scores = rv.evaluate(SAMPLES / "drawn.json", split="val_unseen")
    assert scores.boxes is not None
    histogram = Histogram.of({"": scores}, "iou")
    assert len(histogram.values[""]) == len(scores.boxes) == 81
    assert histogram.values[""].mean() == pytest.approx(scores.boxes.mean_iou)
    assert histogram.share[""].sum() == pytest.approx(100)
    axes = scores.plot.distribution("iou")
    assert axes.get_title(loc="left") == "IoU %: mean 55.48 of 81 boxes"
    assert axes.get_ylabel() == "share of boxes (%)"


def test_submissions_share_their_bars(scores: rv.Scores) -> None:
    other = rv.evaluate(SAMPLES / "good.json", split="val_unseen")
    histogram = Histogram.of({"a": scores, "b": other}, "navigation_error")
    for name, each in (("a", scores), ("b", other)):
        values = each.episodes["navigation_error"]
        counts = [
            100 * ((values >= low) & (values < high)).mean()
            for low, high in zip(histogram.edges, histogram.edges[1:], strict=False)
        ]
        assert histogram.share[name].tolist() == pytest.approx(counts)


# Training and comparison.


@pytest.fixture(scope="module")
def checkpoints() -> dict[float, rv.Scores]:
    """Score three checkpoints, the last one first."""
    evaluator = rv.Evaluator(split="val_unseen")
    samples = {300: "good", 100: "mediocre", 200: "drawn"}
    return {step: evaluator(SAMPLES / f"{name}.json") for step, name in samples.items()}


def test_a_curve(checkpoints: dict[float, rv.Scores]) -> None:
    lines = {line.get_label(): line for line in plot_curve(checkpoints).get_lines()}
    assert list(lines) == ["SR", "RGSPL"]
    assert np.asarray(lines["RGSPL"].get_xdata()).tolist() == [100, 200, 300]
    assert np.asarray(lines["RGSPL"].get_ydata()).tolist() == [
        100 * checkpoints[step]["rgspl"] for step in (100, 200, 300)
    ]


def test_a_curve_with_intervals(checkpoints: dict[float, rv.Scores]) -> None:
    sure = {step: each.with_intervals(resamples=200) for step, each in checkpoints.items()}
    axes = plot_curve(sure, ["spl"])
    (band,) = axes.collections
    heights = np.asarray(band.get_paths()[0].vertices)[:, 1]
    intervals = [each.intervals["spl"] for each in sure.values() if each.intervals]
    ends = [100 * end for interval in intervals for end in (interval.low, interval.high)]
    assert set(ends) <= set(heights.tolist())
    assert [line.get_label() for line in axes.get_lines()] == ["SPL"]


def test_curves_that_cannot_be_drawn(checkpoints: dict[float, rv.Scores]) -> None:
    other = rv.evaluate(SAMPLES / "good.json", split="val_unseen", protocol="paper")
    wrong: Mapping[str, Any] = {
        "there are no scores": {},
        "steps are numbers, such as epochs; got 'last'": {"last": checkpoints[100]},
        "not comparable": checkpoints | {400: other},
    }
    for says, given in wrong.items():
        with pytest.raises(rv.ProtocolError, match=says):
            plot_curve(given)
    with pytest.raises(rv.ProtocolError, match="spl, path_length have different units; draw each"):
        plot_curve(checkpoints, ["spl", "path_length"])
    with pytest.raises(KeyError, match="did you mean spl"):
        plot_curve(checkpoints, ["spll"])


def test_a_comparison(checkpoints: dict[float, rv.Scores]) -> None:
    named = {"good": checkpoints[300], "mediocre": checkpoints[100], "drawn": checkpoints[200]}
    comparison = rv.Comparison.of(named)
    axes = comparison.plot()
    drawn = {line.get_label(): line for line in axes.get_lines()}
    rows = [label.get_text() for label in axes.get_yticklabels()]
    assert rows == ["SR", "OSR", "SPL", "RGS", "RGSPL"]
    for name in comparison:
        keys = ("success", "oracle_success", "spl", "rgs", "rgspl")
        means = [100 * comparison[name][key].mean for key in keys]
        assert np.asarray(drawn[name].get_xdata()).tolist() == means
    (low, _), (high, _) = segments(axes)[0][-1]
    interval = comparison["mediocre"]["rgspl"].interval
    assert (low, high) == (100 * interval.low, 100 * interval.high)


def test_a_comparison_with_navigation_alone(checkpoints: dict[float, rv.Scores]) -> None:
    """Only metrics that both have are drawn."""
    file = next(form for name, form in FORMS.items() if "NavGPT" in name).bytes()
    walked = rv.evaluate(file, split="val_unseen")
    axes = rv.Comparison.of({"ours": checkpoints[300], "walked": walked}).plot()
    assert [label.get_text() for label in axes.get_yticklabels()] == ["SR", "OSR", "SPL"]


def test_a_gallery(scores: rv.Scores) -> None:
    """Near misses of every outcome, with the maps and answers that episodes show by themselves."""
    gallery = scores.gallery()
    assert {outcome: [each.instr_id for each in shown] for outcome, shown in gallery.items()} == {
        outcome: list(ids) for outcome, ids in near_misses(scores).items() if ids
    }
    html = gallery._repr_html_()
    for outcome, shown in gallery.items():
        assert f"<h4>{outcome.capitalize()}</h4>" in html
        assert all(episode._repr_html_() in html for episode in shown)
    assert repr(gallery).startswith("<Gallery of near misses: 1 never reached, 1 overshot")


@pytest.mark.parametrize("draw", ["funnel", "breakdown", "distribution"])
def test_axes_that_are_given_are_drawn_on(draw: str, scores: rv.Scores) -> None:
    figure, given = plt.subplots()
    drawn = {
        "funnel": lambda: scores.plot.funnel(ax=given),
        "breakdown": lambda: scores.plot.breakdown("scan", ax=given),
        "distribution": lambda: scores.plot.distribution("success", ax=given),
    }[draw]()
    assert drawn is given
    assert given.has_data()
    assert plt.get_fignums() == [figure.number]


def test_a_metric_that_is_not_scored(scores: rv.Scores) -> None:
    with pytest.raises(KeyError, match="not scored; the scored metrics are path_length, success"):
        scores.plot.distribution("iou")


def test_a_metric_without_a_value_is_not_drawn() -> None:
    records = json.loads((SAMPLES / "soon.json").read_bytes())
    for record in records:
        for trajectory in record["trajectory"]:
            trajectory |= {"obj_heading": None, "obj_elevation": None}
    scores = rv.evaluate(records, split="val_unseen", task="soon")
    with pytest.raises(rv.ProtocolError, match=r"^point_error has no value in any episode"):
        scores.plot.distribution("point_error")


def test_an_unknown_grouping(scores: rv.Scores) -> None:
    with pytest.raises(rv.ProtocolError, match="unknown grouping 'room'"):
        scores.plot.breakdown("room")
