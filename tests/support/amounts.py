"""How much a test tries: little in the suite, as much as asked for by ``scripts/evidence``."""

import os
import sys
from pathlib import Path

AMOUNT = "REVERIE_EVIDENCE"
"""The environment variable with the number of inputs to try."""
FINDINGS = "REVERIE_EVIDENCE_REPORT"
"""The environment variable with the file that figures are written to."""


def amount(in_suite: int) -> int:
    """Return how many inputs to try."""
    return int(os.environ.get(AMOUNT, in_suite))


def tell(**figures: object) -> None:
    """Report what was tried and measured; nothing happens within the suite."""
    if file := os.environ.get(FINDINGS):
        with Path(file).open("a", encoding="utf-8") as report:
            for name, value in figures.items():
                print(f"{name.replace('_', ' ')}: {value}", file=report)
        sys.stdout.flush()


def is_evidence() -> bool:
    """Whether more is tried than in the suite."""
    return AMOUNT in os.environ
