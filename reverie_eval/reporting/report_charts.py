"""The distributions of a report: each a chart, with what is said below it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from reverie_eval.reporting.charts import farthest_shown, histogram_svg, walks_svg
from reverie_eval.reporting.distributions import Histogram, histogram_of
from reverie_eval.reporting.html_tables import as_markup
from reverie_eval.scores import Scores
from reverie_eval.wording import counted

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
    whose = f" of {name}" if len(scores) > 1 else ""
    yield Chart(
        as_markup(walks_svg(first)),
        f"Walked and shortest length{whose}",
        _about_walks(first),
    )
    stops = histogram_of(scores, "navigation_error")
    at_the_end = _percent((first.episodes["navigation_error"] == 0).mean())
    yield Chart(
        as_markup(histogram_svg(stops)),
        "Distance at stop",
        f"Metres from the stop to the end of the annotated path: {_medians(stops)}. {at_the_end} % "
        f"of episodes{whose} stop right there.",
    )
    if all("iou" in each for each in scores.values()):
        overlaps = histogram_of(scores, "iou")
        right = _percent(first.boxes.is_right.mean()) if first.boxes is not None else "-"
        yield Chart(
            as_markup(histogram_svg(overlaps)),
            "Overlap of boxes",
            f"IoU of answers by box with the target's box: {_medians(overlaps)}. {right} % of "
            f"{overlaps.count:,} boxes{whose} reach 50 % and are right.",
        )


def _about_walks(scores: Scores) -> str:
    walked, shortest = scores.episodes["path_length"], scores.episodes["shortest_length"]
    detours = _percent((walked > shortest + _MILLIMETRE).mean())
    outside = int((walked > farthest_shown(scores)).sum())
    farther = f" {counted(outside, 'episode')} went beyond the picture." if outside else ""
    return (
        "A dot for each episode, blue where the agent stopped at the goal. On the dashed line it "
        f"walked the shortest length; {detours} % are above.{farther}"
    )


def _medians(histogram: Histogram) -> str:
    metric = histogram.metric
    unit = metric.heading.removeprefix(metric.label)
    medians = {
        name: f"{metric.display(float(np.median(values)))}{unit}"
        for name, values in histogram.values.items()
    }
    if len(medians) == 1:
        return f"median {next(iter(medians.values()))}"
    return ", ".join(f"median of {name} {median}" for name, median in medians.items())


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"
