"""Scores in the formats of other collections: one module for each format."""

from reverie_eval.exports._every_eval_ever import (
    EvaluatedModel,
    collection,
    every_eval_ever,
    instance_results,
)
from reverie_eval.exports._hugging_face import evaluation_results, model_index

__all__ = [
    "EvaluatedModel",
    "collection",
    "evaluation_results",
    "every_eval_ever",
    "instance_results",
    "model_index",
]
