"""Score submissions to the REVERIE benchmark.

>>> import reverie_eval as rv
>>> scores = rv.evaluate("demo/good.json", split="val_unseen")
>>> scores["rgspl"] <= scores["rgs"]
True
"""

from importlib import import_module
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from reverie_eval.analysis import Comparison, Runs, Sweep, compare, plan, sweep

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
    "Sweep",
    "Validation",
    "__version__",
    "compare",
    "diagnose",
    "evaluate",
    "evaluate_many",
    "evaluate_protocols",
    "plan",
    "published_results",
    "sweep",
    "validate",
]


def __dir__() -> list[str]:
    # A notebook's completion offers what is used, not what was imported to define it.
    return __all__


if not TYPE_CHECKING:  # else a type checker would take each misspelt name for an object

    def __getattr__(name: str) -> object:
        # Scoring a file needs none of them, and they take a fifth of all other imports.
        if name in {"Comparison", "Runs", "Sweep", "compare", "plan", "sweep"}:
            return getattr(import_module("reverie_eval.analysis"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
