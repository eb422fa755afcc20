"""The metrics: pure functions from arrays to arrays, one row per episode."""

from reverie_eval.metrics.boxes import Overlap, box_iou, box_match, box_overlap
from reverie_eval.metrics.catalogue import (
    BINARY_METRICS,
    BOX_METRICS,
    CATALOGUE,
    PRIMARY_METRIC,
    Metric,
    primary_of,
    table_metrics,
    units_of,
)
from reverie_eval.metrics.fidelity import cls, dtw, ndtw, sdtw
from reverie_eval.metrics.grounding import ABSTAINED, candidate_match
from reverie_eval.metrics.navigation import (
    jumps,
    navigation_error,
    oracle_error,
    oracle_success,
    path_length,
    spl,
    steps,
    success,
)

__all__ = [
    "ABSTAINED",
    "BINARY_METRICS",
    "BOX_METRICS",
    "CATALOGUE",
    "PRIMARY_METRIC",
    "Metric",
    "Overlap",
    "box_iou",
    "box_match",
    "box_overlap",
    "candidate_match",
    "cls",
    "dtw",
    "jumps",
    "navigation_error",
    "ndtw",
    "oracle_error",
    "oracle_success",
    "path_length",
    "primary_of",
    "sdtw",
    "spl",
    "steps",
    "success",
    "table_metrics",
    "units_of",
]
