"""The report on a dataset's published files: what ``reverie-eval lint --format json`` prints."""

from typing import Literal

from pydantic import BaseModel, ConfigDict

_CONFIG = ConfigDict(
    frozen=True, use_attribute_docstrings=True, extra="forbid", from_attributes=True
)


class FoundReport(BaseModel):
    """How many there are."""

    model_config = _CONFIG

    number: int
    of: int | None
    """How many were looked at; null where that says nothing."""
    examples: list[str]
    """The first few by name."""


class CountReport(BaseModel):
    """One thing that was counted."""

    model_config = _CONFIG

    code: str
    """Stable, for programs."""
    kind: Literal["fact", "remark", "fault"]
    """Facts are for the record, remarks are worth knowing and not wrong, faults are wrong."""
    says: str
    """What is counted."""
    advice: str
    """What it means if there are any, and what to do; empty for a fact."""
    found: FoundReport


class SpreadReport(BaseModel):
    """How measured values are spread."""

    model_config = _CONFIG

    code: str
    """Stable, for programs."""
    says: str
    """What was measured."""
    unit: str
    number: int
    """How many values there are."""
    mean: float | None
    """Null if there are no values."""
    percentiles: dict[str, float]
    """Values by percentage, ``"0"`` the smallest and ``"100"`` the largest; empty if there are
    no values."""


class LintSection(BaseModel):
    """What was found in one kind of files."""

    model_config = _CONFIG

    title: str
    split: str | None = None
    """The split that the section is about."""
    counts: list[CountReport] = []
    spreads: list[SpreadReport] = []
    note: str = ""
    """What was left out, and why."""


class LintReport(BaseModel):
    """What is in the published files of a dataset, and what is wrong with them."""

    model_config = _CONFIG

    schema_version: Literal[1] = 1
    version: str
    """Version of reverie-eval that looked."""
    sound: bool
    """Whether no fault was found."""
    sections: list[LintSection]
