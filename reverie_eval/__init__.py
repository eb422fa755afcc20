"""Score submissions to the REVERIE benchmark.

>>> import reverie_eval as rv
>>> scores = rv.evaluate("fixtures/submissions/good.json", split="val_unseen")
>>> scores["rgspl"] <= scores["rgs"]
True
"""

from reverie_eval.comparison import Comparison, compare
from reverie_eval.errors import (
    DatasetError,
    GroundTruthError,
    Problem,
    ProtocolError,
    RejectedError,
    ReverieEvalError,
    SubmissionError,
)
from reverie_eval.evaluation import diagnose, evaluate, evaluate_protocols, validate
from reverie_eval.evaluator import Evaluator
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import CATALOGUE
from reverie_eval.protocol import PROTOCOLS
from reverie_eval.scores import Scores, Validation
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
    "Scores",
    "SubmissionError",
    "Validation",
    "__version__",
    "compare",
    "diagnose",
    "evaluate",
    "evaluate_protocols",
    "validate",
]
