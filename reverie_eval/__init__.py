"""Score submissions to the REVERIE benchmark.

>>> import reverie_eval as rv
>>> scores = rv.evaluate("demo/good.json", split="val_unseen")
>>> scores["rgspl"] <= scores["rgs"]
True
"""

from reverie_eval.analysis import Comparison, Runs, compare
from reverie_eval.errors import (
    DatasetError,
    GroundTruthError,
    Problem,
    ProtocolError,
    RejectedError,
    ReverieEvalError,
    SubmissionError,
    SubsetError,
)
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import CATALOGUE
from reverie_eval.scoring import (
    Evaluator,
    ScoredFiles,
    Scores,
    Validation,
    diagnose,
    evaluate,
    evaluate_many,
    evaluate_protocols,
    validate,
)
from reverie_eval.tasks import PROTOCOLS, published_results
from reverie_eval.version import __version__

__all__ = [
    "CATALOGUE",
    "PROTOCOLS",
    "Comparison",
    "DatasetError",
    "Evaluator",
    "GroundTruth",
    "GroundTruthError",
    "Problem",
    "ProtocolError",
    "RejectedError",
    "ReverieEvalError",
    "Runs",
    "ScoredFiles",
    "Scores",
    "SubmissionError",
    "SubsetError",
    "Validation",
    "__version__",
    "compare",
    "diagnose",
    "evaluate",
    "evaluate_many",
    "evaluate_protocols",
    "published_results",
    "validate",
]
