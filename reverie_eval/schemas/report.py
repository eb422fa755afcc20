"""Reports: what ``--format json`` prints."""

from typing import Literal

from pydantic import BaseModel, ConfigDict


class BoxReport(BaseModel):
    """How the answers that are boxes did, and how much of it chance would have done."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True, extra="forbid")

    answers: int
    """Number of answers that are boxes."""
    correct: int
    """Number of them with an IoU of at least one half, wherever else the protocol looks."""
    mean_iou: float
    """Mean IoU over them; 0 where the view does not show the target."""
    whole_image: float
    """Share of them that would be right if the whole picture stood in their place."""
    ambiguous_views: float
    """Of those whose view shows the target, the share in which another object's box overlaps the
    target's with an IoU of at least one half."""
    misses: dict[str, int]
    """Number of them that are wrong, by reason: the box is another than the target's (low IoU),
    the view does not show the target, or no view does from where the agent stopped."""


class IntervalReport(BaseModel):
    """Confidence intervals of the means, by a bootstrap over clusters of episodes."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True, extra="forbid")

    by: Literal["target", "scan"]
    """What the episodes of a cluster have in common."""
    clusters: int
    """Number of clusters, from which each resample drew as many."""
    confidence: float
    """The share of such intervals that hold the true mean."""
    resamples: int
    seed: int
    intervals: dict[str, tuple[float, float]]
    """Low and high by metric key, in the units of the scores."""


class ScoreReport(BaseModel):
    """Scores of one submission, with everything needed to explain the numbers later."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True, extra="forbid")

    schema_version: Literal[1] = 1
    signature: str
    """Everything that the scores depend on, in one line; two equal signatures compare."""
    split: str
    protocol: str
    dataset: str
    """Name of the dataset release that the ground truth was compiled from."""
    fingerprint: str
    """SHA-256 of the ground truth's arrays, hexadecimal."""
    version: str
    """Version of reverie-eval that scored."""
    episodes: int
    """Number of episodes that the scores are means over."""
    scores: dict[str, float]
    """Means over episodes by metric key; fractions in [0, 1], lengths in metres, not rounded."""
    boxes: BoxReport | None = None
    """If some answers are boxes and the protocol scores grounding."""
    intervals: IntervalReport | None = None
    """If they were asked for."""
    notes: list[str] = []
    """What a reader of the numbers should know, a sentence each."""


class ProblemReport(BaseModel):
    """One thing that is wrong with a submission."""

    model_config = ConfigDict(
        frozen=True, use_attribute_docstrings=True, extra="forbid", from_attributes=True
    )

    code: str
    """What kind of problem it is; stable, for programs."""
    where: str
    """Its place in the submission: ``[3].trajectory[0]``."""
    message: str
    """What was found, what was expected, and what to do."""


class ValidationReport(BaseModel):
    """Whether a submission can be scored, and everything that is wrong if it cannot."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True, extra="forbid")

    schema_version: Literal[1] = 1
    split: str
    valid: bool
    problems: list[ProblemReport] = []
    notes: list[str] = []
    """What the participant should know before sending it, a sentence each."""
