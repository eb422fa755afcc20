"""How histograms divide a range, and what charts of budgets draw."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from reverie_eval.analysis import BudgetCurve
from reverie_eval.arrays import FloatArray
from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.charts import bin_edges, budget_chart, count_edges


@pytest.mark.parametrize(
    ("divide", "values", "most", "edges"),
    [
        pytest.param(count_edges, [3, 5], 3, [2.5, 3.5, 4.5, 5.5], id="a bar for each count"),
        pytest.param(count_edges, [3, 5], 2, [2, 4, 6], id="two counts a bar"),
        pytest.param(count_edges, [7, 7], 9, [6.5, 7.5], id="one count"),
        pytest.param(count_edges, [0, 99], 20, range(0, 101, 5), id="steps of five"),
        pytest.param(bin_edges, [3.2, 5.0], 3, [3, 4, 5, 6], id="metres"),
        pytest.param(bin_edges, [3.0, 5.0], 3, [3, 4, 5, 6], id="metres that are whole"),
        pytest.param(bin_edges, [0.0, 0.0], 9, [0, 1], id="no metre"),
    ],
)
def test_bars(
    divide: Callable[[FloatArray, int], FloatArray],
    values: Sequence[float],
    most: int,
    edges: Sequence[float],
) -> None:
    assert divide(np.array(values, dtype=float), most).tolist() == list(edges)


def curve(budget: Sequence[float], share: Sequence[float]) -> BudgetCurve:
    """Return a curve whose intervals are 0.1 wide on either side."""
    shares = np.array(share)
    ends = shares - 0.1, shares + 0.1
    return BudgetCurve("money", CATALOGUE["success"], np.array(budget), shares, *ends, "95 %")


def test_a_budget_holds_until_the_next_one_and_the_last_until_the_end() -> None:
    chart = budget_chart({"a": curve([2, 4, 9], [0.2, 0.5, 0.5]), "b": curve([1, 6], [0.3, 0.3])})
    # Of a, all that are solved are at a budget of 4, and the axis goes a little further.
    assert [chart.low, chart.high, chart.top] == pytest.approx([0, 4.2, 63])
    rising, level = (np.vstack(chart.lines[f"curve series-{number}"]) for number in (1, 2))
    assert rising.tolist() == [[2, 0], [2, 20], [4, 20], [4, 50], [4.2, 50]]
    assert level.tolist() == [[1, 0], [1, 30], [4.2, 30]]
    band = np.vstack(chart.lines["band series-2"])
    assert band == pytest.approx(np.array([[1, 20], [4.2, 20], [4.2, 40], [1, 40]]))
    assert list(chart.lines) == [f"{kind} series-{n}" for kind in ("band", "curve") for n in (1, 2)]
    assert chart.key == {"curve series-1": "a", "curve series-2": "b"}


def test_more_runs_than_colours_are_all_drawn_and_named() -> None:
    chart = budget_chart({name: curve([1, 2], [0.1, 0.2]) for name in "abcdefg"})
    assert [len(chart.lines[f"{kind} series-1"]) for kind in ("band", "curve")] == [2, 2]
    assert [*chart.key.values()] == ["a, g", *"bcdef"]


@pytest.mark.parametrize(
    ("budget", "ticks"),
    [
        pytest.param(40, [0, 10, 20, 30, 40], id="many"),
        pytest.param(1, [0, 1], id="one"),
        pytest.param(0.02, [0, 0.005, 0.01, 0.015, 0.02], id="cents"),
    ],
)
def test_ticks_are_round_also_of_a_small_budget(budget: float, ticks: list[float]) -> None:
    chart = budget_chart({"": curve([budget], [0.5])})
    assert chart.x_ticks == pytest.approx(ticks)
    assert f">{ticks[1]:g}</text>" in chart.svg()
