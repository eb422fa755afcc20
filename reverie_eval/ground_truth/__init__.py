"""The ground truth: compiled once from the published files, loaded in milliseconds.

Compiling lives in :mod:`reverie_eval.ground_truth.compile` and is imported only when asked for.
"""

from reverie_eval.ground_truth.bundle import Bundle
from reverie_eval.ground_truth.graph import NavigationGraph
from reverie_eval.ground_truth.locate import bundle_name, find_ground_truth
from reverie_eval.ground_truth.truth import Answers, Episodes, GroundTruth

__all__ = [
    "Answers",
    "Bundle",
    "Episodes",
    "GroundTruth",
    "NavigationGraph",
    "bundle_name",
    "find_ground_truth",
]
