"""The published dataset: checked, compiled, described, and built from Matterport's files."""

from reverie_eval.dataset._box_builder import build_boxes, find_scans
from reverie_eval.dataset._compile import compile_split, origin_notes
from reverie_eval.dataset._describe import DatasetDescription, describe_dataset
from reverie_eval.dataset._description import Distribution, SplitDescription, TargetDescription
from reverie_eval.dataset._files import DatasetFiles
from reverie_eval.dataset._lint import LintReport, LintSection, lint_dataset
from reverie_eval.dataset._object_boxes import BoxRules
from reverie_eval.dataset._paper import PaperComparison
from reverie_eval.dataset._rules import Count, Finding, Spread

__all__ = [
    "BoxRules",
    "Count",
    "DatasetDescription",
    "DatasetFiles",
    "Distribution",
    "Finding",
    "LintReport",
    "LintSection",
    "PaperComparison",
    "SplitDescription",
    "Spread",
    "TargetDescription",
    "build_boxes",
    "compile_split",
    "describe_dataset",
    "find_scans",
    "lint_dataset",
    "origin_notes",
]
