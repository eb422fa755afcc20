"""Plans: which differences a split, or a sample of it, can show, before anything is run."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, cast

import numpy as np

from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import GroundTruth, draw_subset, find_ground_truth
from reverie_eval.scoring import Clustering, clusters_of
from reverie_eval.tasks import KnownSplit
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from reverie_eval.metrics.power import Design, PublishedDesign

DISCORDANCE = 0.5
"""By default, methods disagree in as many episodes as unrelated ones with rates of one half."""
CORRELATION = 0.3
"""By default, results of episodes with the same target are correlated as a trained agent's are,
as docs/explanation/uncertainty.md measures."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What a comparison of two methods in SR or RGS can show; differences are fractions.

    A split shows a difference if it is significant, at 5 %, in 80 % of comparisons.
    """

    design: "Design | PublishedDesign"
    effect: float
    """The true difference to be shown."""
    split: str
    n_split: int
    """The number of episodes of the split, of which the design may have a sample."""
    cluster: Clustering

    @cached_property
    def power(self) -> float:
        """The probability that the difference is significant."""
        return self.design.power(self.effect)

    @cached_property
    def smallest_effect(self) -> float | None:
        """The smallest difference that is shown; None if no difference is."""
        return self.design.smallest_effect()

    @cached_property
    def episodes_needed(self) -> int | None:
        """How many such episodes show the difference; None if ten million do not."""
        return self.design.episodes_needed(self.effect)

    @cached_property
    def runs_needed(self) -> int | None:
        """How many runs of each method show the difference; None if a thousand do not."""
        return cast("Design", self.design).runs_needed(self.effect)

    @property
    def sentence(self) -> str:
        """Whether the difference can be shown."""
        from reverie_eval.metrics.power import POWER, PublishedDesign

        which = self.split
        if self.design.n_episodes < self.n_split:
            which = f"{count_text(self.design.n_episodes, 'episode')} of {self.split}"
        verb = "can" if self.power >= POWER else "cannot"
        difference = f"a difference of {100 * self.effect:g} points"
        if isinstance(self.design, PublishedDesign):
            difference = f"{100 * self.effect:g} points above {100 * self.design.published:g} %"
        return f"{which} {verb} show {difference}: found in {100 * self.power:.0f} % of comparisons"

    @property
    def assumptions(self) -> str:
        """What the plan assumes."""
        from reverie_eval.metrics.power import PublishedDesign

        design = self.design
        size = f"{design.n_episodes:,} episodes, {count_text(design.n_clusters, self.cluster)}"
        correlation = f"correlation {design.correlation:g}"
        if isinstance(design, PublishedDesign):
            return (
                f"assumed: {size}, {correlation}; the published mean is over all "
                f"{self.n_split:,}, unpaired"
            )
        runs = count_text(design.n_runs, "run")
        deviation = f", deviation {100 * design.run_deviation:g} points" * bool(
            design.run_deviation
        )
        return (
            f"assumed: {size}; discordance {100 * design.discordance:g} %, {correlation}; "
            f"{runs} of each method{deviation}"
        )

    @property
    def _episodes_text(self) -> str:
        from reverie_eval.metrics.power import PublishedDesign

        needed = self.episodes_needed
        if needed is None:
            if isinstance(self.design, PublishedDesign):
                return "no number is enough: the published mean is uncertain too"
            return "over 10,000,000"
        has_fewer = f"; {self.split} has {self.n_split:,}" * (needed > self.n_split)
        return f"{needed:,}{has_fewer}"

    def __str__(self) -> str:
        points = f"{100 * self.effect:g} points"
        smallest = self.smallest_effect
        rows = {
            "smallest difference at 80 % power": (
                "none" if smallest is None else f"{100 * smallest:.2f} points"
            ),
            f"episodes for {points}": self._episodes_text,
        }
        if getattr(self.design, "run_deviation", 0):
            runs = self.runs_needed
            rows[f"runs of each method for {points}"] = (
                "no number is enough: there are too few episodes" if runs is None else f"{runs:,}"
            )
        width = max(map(len, rows))
        lines = [f"{name:{width}}  {value}" for name, value in rows.items()]
        return "\n".join([self.sentence, *lines, self.assumptions])

    def __repr__(self) -> str:
        return f"<Plan: {self.sentence}>"


def plan(
    *,
    split: KnownSplit | str,
    effect: float = 0.02,
    n: int | None = None,
    subset: Iterable[str] | None = None,
    against: float | None = None,
    discordance: float = DISCORDANCE,
    correlation: float | None = None,
    runs: int = 1,
    run_deviation: float = 0.0,
    cluster: Clustering = "target",
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    task: str | None = None,
) -> Plan:
    """Plan a comparison of two methods: whether a split shows a difference in SR or RGS.

    Rates and differences are fractions.

    Parameters
    ----------
    split, subset, ground_truth, task
        As for :func:`reverie_eval.evaluate`.
    effect : float
        The true difference, in (0, 1].
    n : int, optional
        Plan a random sample of this many episodes, as ``reverie-eval subset --n`` draws it.
    against : float, optional
        Plan a comparison with a published rate over the whole split, without its results.
    discordance : float
        Share of episodes that one method gets right and the other wrong, in (0, 1]; two unrelated
        methods have one half. Not used with ``against``.
    correlation : float
        In [0, 1]: of the differences of two episodes in a cluster, by default 0; with ``against``,
        of their results, by default 0.3.
    runs, run_deviation : int, float
        Runs of each method, and the standard deviation of its rate between them.
    cluster : "target" or "scan"
        What dependent episodes share.

    Raises
    ------
    ProtocolError
        If something is out of range, or the effect is impossible.
    GroundTruthError, SubsetError
        As :func:`reverie_eval.evaluate` does.

    Examples
    --------
    >>> plan(split="val_unseen", effect=0.1, against=0.412)
    <Plan: val_unseen cannot show 10 points above 41.2 %: found in 15 % of comparisons>
    """
    from reverie_eval.metrics.power import Design, PublishedDesign

    if n is not None and subset is not None:
        raise ProtocolError("n and subset both choose episodes; give one of them")
    truth = find_ground_truth(ground_truth, split, task, subset)
    whole = truth.whole
    if n is not None:
        every = dict.fromkeys(truth.episodes.instr_ids, "")
        truth = truth.subset(draw_subset(every, n, 0, truth.split))
    clusters = clusters_of(truth, cluster)
    design: Design | PublishedDesign
    if against is None:
        design = Design.of(clusters, discordance, correlation or 0.0)
        design = replace(design, n_runs=runs, run_deviation=run_deviation)
    else:
        sizes, of_split = (
            np.unique(each, return_counts=True)[1]
            for each in (clusters, clusters_of(whole, cluster))
        )
        alike = CORRELATION if correlation is None else correlation
        design = PublishedDesign(sizes, of_split, against, alike)
    return Plan(design, effect, whole.split, len(whole.episodes.instr_ids), cluster)
