"""How histograms divide a range."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting.charts import bin_edges, count_edges


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
