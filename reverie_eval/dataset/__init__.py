"""The published dataset: checked, compiled, described, and built from Matterport's files."""

from reverie_eval.dataset._box_building import (
    EXCLUDED_NAMES,
    MAX_DISTANCE,
    BoxSettings,
    Occlusion,
    Scan,
    Xywh,
    build_boxes,
    find_scans,
    list_objects,
)
from reverie_eval.dataset._compile import compile_for_training, compile_split, origin_notes
from reverie_eval.dataset._dataset import DatasetFiles, scans_of
from reverie_eval.dataset._description import (
    DatasetDescription,
    Distribution,
    PaperComparison,
    SplitDescription,
    TargetDescription,
    describe_dataset,
    of_targets,
)
from reverie_eval.dataset._houses import House, parse_house, read_house
from reverie_eval.dataset._lint import LintReport, LintSection, lint_dataset
from reverie_eval.dataset._rules import Count, Finding, Spread

__all__ = [
    "EXCLUDED_NAMES",
    "MAX_DISTANCE",
    "BoxSettings",
    "Count",
    "DatasetDescription",
    "DatasetFiles",
    "Distribution",
    "Finding",
    "House",
    "LintReport",
    "LintSection",
    "Occlusion",
    "PaperComparison",
    "Scan",
    "SplitDescription",
    "Spread",
    "TargetDescription",
    "Xywh",
    "build_boxes",
    "compile_for_training",
    "compile_split",
    "describe_dataset",
    "find_scans",
    "lint_dataset",
    "list_objects",
    "of_targets",
    "origin_notes",
    "parse_house",
    "read_house",
    "scans_of",
]
