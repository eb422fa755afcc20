"""The metrics: pure functions from arrays to arrays, one row per episode."""

from reverie_eval.metrics._catalogue import (
    CATALOGUE,
    PRIMARY_METRIC,
    Metric,
    Need,
    units_of,
)
from reverie_eval.metrics._fidelity import FIDELITY_DISTANCE, cls, dtw, ndtw, sdtw
from reverie_eval.metrics._grounding import (
    ABSTAINED,
    IOU_THRESHOLD,
    LOOSE_IOU_THRESHOLD,
    STRICT_IOU_THRESHOLD,
    Overlap,
    box_iou,
    box_match,
    box_overlap,
    candidate_match,
)
from reverie_eval.metrics._navigation import (
    SUCCESS_DISTANCE,
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
    "CATALOGUE",
    "FIDELITY_DISTANCE",
    "IOU_THRESHOLD",
    "LOOSE_IOU_THRESHOLD",
    "PRIMARY_METRIC",
    "STRICT_IOU_THRESHOLD",
    "SUCCESS_DISTANCE",
    "Metric",
    "Need",
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
    "sdtw",
    "spl",
    "steps",
    "success",
    "units_of",
]
