"""Scores for the Hugging Face Hub: the block of a model card, and a benchmark's results file.

References
----------
Model cards: https://huggingface.co/docs/hub/model-cards, with ``model-index`` as in
https://github.com/huggingface/hub-docs/blob/main/modelcard.md.
Evaluation results: https://huggingface.co/docs/hub/eval-results.
"""

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from reverie_eval.scoring import Scores

_TASK_TYPE = "robotics"
"""The Hub's kind of task that is closest to walking through buildings."""


def model_index(scores: Scores, model: str) -> Mapping[str, Any]:
    """Return the metadata of a model card: the headline metrics with names, units and signature.

    Fractions are percentages, as everywhere on the Hub.
    """
    truth = scores.ground_truth
    result = {
        "task": {"type": _TASK_TYPE, "name": "Vision-and-language navigation"},
        "dataset": {
            "type": truth.task.name,
            "name": f"{truth.header.dataset} {truth.split}",
            "split": truth.split,
        },
        "metrics": [
            {
                "type": metric.key,
                "name": metric.heading,
                "value": float(metric.display(scores[metric.key])),
                "args": {"signature": scores.signature},
            }
            for metric in scores.headline
        ],
    }
    return {"model-index": [{"name": model, "results": [result]}]}


def evaluation_results(
    scores: Scores, benchmark: str, task_id: str, at: datetime
) -> Sequence[Mapping[str, Any]]:
    """Return the content of a file in ``.eval_results/``: the metric that ranks submissions.

    Parameters
    ----------
    scores : Scores
    benchmark : str
        The Hub's id of the benchmark's dataset: ``OWNER/NAME``.
    task_id : str
        The task as the benchmark's ``eval.yaml`` names it.
    at : datetime
        When the scores were computed.
    """
    primary = scores.ground_truth.task.primary_metric(scores)
    return [
        {
            "dataset": {"id": benchmark, "task_id": task_id},
            "value": float(primary.display(scores[primary.key])),
            "date": at.isoformat(timespec="seconds"),
            "notes": f"{primary.heading}, {scores.signature}",
        }
    ]
