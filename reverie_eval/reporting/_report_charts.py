"""The distributions of a report: each a chart, with what is said below it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from reverie_eval.reporting._charts import farthest_shown, histogram_svg, walks_svg
from reverie_eval.reporting._distributions import Histogram, histogram_of
from reverie_eval.reporting.resources import as_markup
from reverie_eval.scoring import Scores
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from markupsafe import Markup


_MILLIMETRE = 1e-3


@dataclass(frozen=True)
class Chart:
    """A distribution, with what is said below it."""

    picture: "Markup"
    title: str
    caption: str


def report_charts(scores: Mapping[str, Scores]) -> Iterator[Chart]:
    """Draw lengths and distances, and overlaps of boxes where there are some."""
    (name, first), *_ = scores.items()
    yield Chart(
        as_markup(walks_svg(first)),
        f"Walked and shortest length{_of(name, scores)}",
        _about_walks(first),
    )
    stops = histogram_of(scores, "navigation_error")
    right_there = _percent((first.episodes["navigation_error"] == 0).mean())
    yield Chart(
        as_markup(histogram_svg(stops, list(scores))),
        "Distance at stop",
        f"Metres from the stop to the end of the annotated path: {_medians(stops, scores)}. "
        f"{right_there} % of episodes{_of(name, scores)} stop right there.",
    )
    drawn = {name: each.boxes for name, each in scores.items() if each.boxes is not None}
    if drawn:
        overlaps = histogram_of({name: scores[name] for name in drawn}, "iou")
        right = [
            f"{_percent(boxes.is_correct.mean())} % of {len(boxes):,} boxes{_of(name, scores)}"
            for name, boxes in drawn.items()
        ]
        yield Chart(
            as_markup(histogram_svg(overlaps, list(scores))),
            "Overlap of boxes",
            f"IoU of answers by box with the target's box: {_medians(overlaps, scores)}. "
            f"{' and '.join(right)} reach 50 % and are right.",
        )


def _of(name: str, scores: Mapping[str, Scores]) -> str:
    """Say whose something is, where there are several."""
    return f" of {name}" if len(scores) > 1 else ""


def _about_walks(scores: Scores) -> str:
    walked, shortest = scores.episodes["path_length"], scores.episodes["shortest_length"]
    detours = _percent((walked > shortest + _MILLIMETRE).mean())
    outside = int((walked > farthest_shown(scores)).sum())
    farther = f" {count_text(outside, 'episode')} went beyond the picture." if outside else ""
    return (
        "A dot for each episode, blue where the agent stopped at the goal. On the dashed line it "
        f"walked the shortest length; {detours} % are above.{farther}"
    )


def _medians(histogram: Histogram, scores: Mapping[str, Scores]) -> str:
    metric = histogram.metric
    unit = metric.heading.removeprefix(metric.label)
    return ", ".join(
        f"median{_of(name, scores)} {metric.display(float(np.median(values)))}{unit}"
        for name, values in histogram.values.items()
    )


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"
