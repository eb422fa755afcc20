"""Reports: what ``--format json`` prints."""

from typing import Literal

from pydantic import BaseModel, ConfigDict


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
