"""Reports: what ``--format json`` prints."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

# The examples of fields make up those of whole messages in the API's description.
SplitName = Annotated[str, Field(examples=["test"])]
DatasetName = Annotated[str, Field(examples=["reverie-v1"])]
Fingerprint = Annotated[
    str,
    Field(examples=["b29e8e6d06f66c1d8e0a2b4c5d7f9e1032547698badcfe10f0e1d2c3b4a59687"]),
]
"""SHA-256 of a ground truth's arrays, hexadecimal."""


class Report(BaseModel):
    """Base of all reports: immutable, without undeclared fields."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True, extra="forbid")


class BoxReport(Report):
    """The results of answers by box, and how much of them chance could explain."""

    answers: int
    """Number of answers that are boxes."""
    correct: int
    """Number of them with an IoU of at least one half, whatever else the protocol requires."""
    mean_iou: float
    """Mean IoU over them; 0 where the view does not show the target."""
    whole_image: float
    """Share of them that would be correct if each were the whole image."""
    ambiguous_views: float
    """Share of views that show the target in which another object's box has an IoU of at least one
    half with the target's."""
    misses: dict[str, int]
    """Number of wrong boxes by reason: the IoU with the target's box is too low, the view does not
    show the target, or no view does at the viewpoint where the agent stopped."""


class IntervalReport(Report):
    """Confidence intervals of the means, by a bootstrap over clusters of episodes."""

    by: Literal["target", "scan"]
    """What the episodes of a cluster share."""
    clusters: int
    """Number of clusters; each resample draws as many."""
    confidence: float
    """The share of such intervals that contain the true mean."""
    resamples: int
    seed: int
    intervals: dict[str, tuple[float, float]]
    """Low and high by metric key, in the units of the scores."""


class ScoreReport(Report):
    """Scores of one submission, with everything needed to explain the numbers later."""

    schema_version: Literal[1] = 1
    signature: str
    """Everything that the scores depend on, in one line; equal signatures mean comparable
    scores."""
    split: SplitName
    protocol: str
    dataset: DatasetName
    """Name of the dataset release that the ground truth was compiled from."""
    fingerprint: Fingerprint
    """SHA-256 of the ground truth's arrays, hexadecimal."""
    version: str
    """Version of reverie-eval that scored."""
    episodes: int = Field(examples=[6292])
    """Number of episodes that the scores are means over."""
    scores: dict[str, float]
    """Means over episodes by metric key; fractions in [0, 1], lengths in metres, not rounded."""
    boxes: BoxReport | None = None
    """Present if some answers are boxes and the protocol scores grounding."""
    intervals: IntervalReport | None = None
    """Present if requested."""
    costs: dict[str, float | None] | None = Field(None, exclude_if=lambda costs: costs is None)
    """What an episode cost on average, as its run logged it; null is unknown. Left out if there is
    no log."""
    notes: list[str] = []
    """What readers of the numbers should know, a sentence each."""


class RunsReport(Report):
    """The mean of several runs of a method, with its uncertainty over runs and episodes."""

    schema_version: Literal[1] = 1
    signature: str
    """The signature of all runs."""
    scores: dict[str, float]
    """Means over runs and episodes by metric key, in the units of the runs' scores."""
    by: Literal["target", "scan"]
    """What the episodes of a cluster share."""
    clusters: int
    confidence: float
    """The share of such intervals that contain the true mean."""
    intervals: dict[str, tuple[float, float]]
    """Low and high by metric key: other runs and other episodes would give other means."""
    deviations: dict[str, float]
    """Standard deviations between the runs by metric key."""
    run_shares: dict[str, float]
    """The part of each mean's variance that more runs would reduce, in [0, 1], by metric key."""
    runs: dict[str, ScoreReport]
    """The report of each run, by its name."""
    notes: list[str] = []
    """What makes the intervals less certain than they look, such as only two runs, or copies."""


class ProblemReport(Report):
    """One thing that is wrong with a submission."""

    model_config = ConfigDict(from_attributes=True)

    code: str = Field(examples=["unknown-viewpoint"])
    """What kind of problem it is; stable, for programs."""
    where: str = Field(examples=["[3].trajectory[0]"])
    """The problem's location in the submission: ``[3].trajectory[0]``."""
    message: str = Field(examples=["there is no viewpoint 0c0f3d11 in this building"])
    """What was found, what was expected, and what to do."""
    split: SplitName | None = Field(None, exclude_if=lambda split: split is None)
    """The split that the whole submission seems to be for, if it is another one; else left out."""


class ValidationReport(Report):
    """Whether a submission can be scored, and if not, everything that is wrong."""

    schema_version: Literal[1] = 1
    split: SplitName
    valid: bool = Field(examples=[True])
    problems: list[ProblemReport] = []
    notes: list[str] = Field([], examples=[["3 jumps between viewpoints"]])
    """What the participant should know before submitting, a sentence each."""
