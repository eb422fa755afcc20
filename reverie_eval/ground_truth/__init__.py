"""The ground truth of a split: compiled once by :mod:`reverie_eval.dataset`, then loaded fast."""

from reverie_eval.ground_truth._bundle import (
    CUSTOM_DATASET,
    Bundle,
    BundleHeader,
    bundle_name,
    pack_texts,
)
from reverie_eval.ground_truth._graph import NavigationGraph
from reverie_eval.ground_truth._ids import ID_LENGTH, InstrIdTable, ViewpointTable
from reverie_eval.ground_truth._solution import CandidateBoxes, Solution
from reverie_eval.ground_truth._truth import (
    DEMO_BUNDLES,
    DEMO_DATASET,
    DEMO_SAMPLES,
    GROUND_TRUTH_VARIABLE,
    Episodes,
    GroundTruth,
    bundle_folder,
    bundled_splits,
    draw_subset,
    find_ground_truth,
    find_words,
    read_episode_ids,
)

__all__ = [
    "CUSTOM_DATASET",
    "DEMO_BUNDLES",
    "DEMO_DATASET",
    "DEMO_SAMPLES",
    "GROUND_TRUTH_VARIABLE",
    "ID_LENGTH",
    "Bundle",
    "BundleHeader",
    "CandidateBoxes",
    "Episodes",
    "GroundTruth",
    "InstrIdTable",
    "NavigationGraph",
    "Solution",
    "ViewpointTable",
    "bundle_folder",
    "bundle_name",
    "bundled_splits",
    "draw_subset",
    "find_ground_truth",
    "find_words",
    "pack_texts",
    "read_episode_ids",
]
