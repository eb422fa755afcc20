"""The comparison report: how submissions differ from the first of them."""

from pydantic import BaseModel, ConfigDict

from reverie_eval.schemas.report import ScoreReport


class _Reported(BaseModel):
    model_config = ConfigDict(
        frozen=True, use_attribute_docstrings=True, extra="forbid", from_attributes=True
    )


class IntervalBounds(_Reported):
    """A confidence interval."""

    low: float
    high: float


class DifferenceReport(_Reported):
    """How a submission differs from the first in one metric, in the metric's own unit."""

    mean: float
    """Of the submission's values less the first's."""
    interval: IntervalBounds
    p_value: float
    """Of the paired randomisation test over clusters, two-sided; corrected by Holm's method for
    the number of submissions that are compared with the first."""
    higher: int
    """Episodes in which the submission's value is the higher one."""
    lower: int
    """Episodes in which it is the lower one."""
    mcnemar_p: float | None
    """Of McNemar's exact test, corrected likewise; null where values are more than yes and no."""


class ComparisonReport(_Reported):
    """Several submissions, each but the first held against the first."""

    first: str
    """The name of the submission that the others are compared with."""
    submissions: dict[str, ScoreReport]
    """By name, the first among them."""
    intervals: dict[str, str]
    """How the intervals of the differences came about, by the names of the others."""
    differences: dict[str, dict[str, DifferenceReport]]
    """By the names of the others and the keys of the metrics."""
    sentences: dict[str, str]
    """In words whether each of the others is better, in the metric that the benchmark ranks by."""
