"""Scoring: from an aligned submission and a protocol to scores."""

from reverie_eval.scoring._episode_table import (
    CORRECT,
    OUTCOME_METRICS,
    OUTCOMES,
    EpisodeTable,
    FailureModes,
    Track,
    failure_modes,
    outcome_indices,
    qualifier_of,
    scored_metrics,
)
from reverie_eval.scoring._evaluation import (
    PreparedSubmission,
    Validation,
    diagnose,
    evaluate,
    evaluate_protocols,
    validate,
    why_not,
)
from reverie_eval.scoring._evaluator import (
    TABLE_KEYS,
    Evaluator,
    Executor,
    Failure,
    ScoredFiles,
    evaluate_many,
    score_files,
)
from reverie_eval.scoring._intervals import (
    FEW_CLUSTERS,
    Clustering,
    ClusterIntervals,
    Interval,
    Intervals,
    bounds_of,
    clusters_of,
)
from reverie_eval.scoring._lookups import BOX_OUTCOMES, BoxScores, Lookups, is_goal
from reverie_eval.scoring._scored import Scored, signature_of, task_of
from reverie_eval.scoring._scores import Scores
from reverie_eval.tasks import DEFAULT_PROTOCOL, Protocol

__all__ = [
    "BOX_OUTCOMES",
    "CORRECT",
    "DEFAULT_PROTOCOL",
    "FEW_CLUSTERS",
    "OUTCOMES",
    "OUTCOME_METRICS",
    "TABLE_KEYS",
    "BoxScores",
    "ClusterIntervals",
    "Clustering",
    "EpisodeTable",
    "Evaluator",
    "Executor",
    "Failure",
    "FailureModes",
    "Interval",
    "Intervals",
    "Lookups",
    "PreparedSubmission",
    "Protocol",
    "Scored",
    "ScoredFiles",
    "Scores",
    "Track",
    "Validation",
    "bounds_of",
    "clusters_of",
    "diagnose",
    "evaluate",
    "evaluate_many",
    "evaluate_protocols",
    "failure_modes",
    "is_goal",
    "outcome_indices",
    "qualifier_of",
    "score_files",
    "scored_metrics",
    "signature_of",
    "task_of",
    "validate",
    "why_not",
]
