"""Scores in the formats of other collections: Every Eval Ever and the Hugging Face Hub.

References
----------
Every Eval Ever, schema 0.3.0: https://github.com/evaleval/every_eval_ever.

Model cards: https://huggingface.co/docs/hub/model-cards, with ``model-index`` as in
https://github.com/huggingface/hub-docs/blob/main/modelcard.md.

Evaluation results: https://huggingface.co/docs/hub/eval-results.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from math import isinf
from typing import Any

from reverie_eval.errors import ReverieEvalError
from reverie_eval.metrics import Metric
from reverie_eval.scoring import Scores
from reverie_eval.version import __version__

SCHEMA_VERSION = "0.3.0"
_LIBRARY = "reverie-eval"
# The split whose scores are exported rounded, without intervals and episodes, as a server does.
_PRIVATE_SPLIT = "test"
_UNITS = {"fraction": "proportion", "metres": "metres", "count": "count"}


@dataclass(frozen=True, slots=True)
class EvaluatedModel:
    """What was evaluated, and by whom."""

    developer: str
    name: str
    evaluator: str
    """The organisation that computed the scores; often the developer."""

    @property
    def id(self) -> str:
        """``DEVELOPER/NAME``."""
        return f"{self.developer}/{self.name}"


def every_eval_ever(scores: Scores, model: EvaluatedModel, at: datetime) -> Mapping[str, Any]:
    """Return the aggregate record of scores: each headline metric that has a better direction.

    Scores on the split test are rounded, and have no intervals.

    Parameters
    ----------
    scores : Scores
        With intervals, these are its uncertainty.
    model : EvaluatedModel
    at : datetime
        When they were computed.
    """
    timestamp = str(int(at.timestamp()))
    # The collection tells results of a model's makers from those of others.
    relationship = "first_party" if model.evaluator == model.developer else "third_party"
    return {
        "schema_version": SCHEMA_VERSION,
        "evaluation_id": f"{collection(scores)}/{model.developer}_{model.name}/{timestamp}",
        "evaluation_timestamp": timestamp,
        "retrieved_timestamp": timestamp,
        "source_metadata": {
            "source_name": _LIBRARY,
            "source_type": "evaluation_run",
            "source_organization_name": model.evaluator,
            "evaluator_relationship": relationship,
        },
        "model_info": {
            "name": model.name,
            "id": model.id,
            "developer": model.developer,
            "additional_details": {"deployment_type": "unknown", "model_availability": "unknown"},
        },
        "eval_library": {"name": _LIBRARY, "version": __version__},
        "evaluation_results": [_result(scores, metric) for metric in _exported(scores)],
    }


def instance_results(
    scores: Scores, records: Sequence[Mapping[str, Any]], aggregate: Mapping[str, Any]
) -> Iterator[Mapping[str, Any]]:
    """Yield the records of single episodes: one for each aggregate result of a binary metric.

    The schema requires that an instance is correct or not, and an SPL of 0.4 is neither.

    Parameters
    ----------
    scores : Scores
    records : sequence of mappings
        The submission in the official form, as :func:`reverie_eval.submissions.convert` returns it.
    aggregate : mapping
        What :func:`every_eval_ever` returned for these scores.

    Raises
    ------
    ReverieEvalError
        For the split test, whose episodes are never released.
    """
    if _is_private(scores):
        raise ReverieEvalError(
            f"values of single episodes of {_PRIVATE_SPLIT} are never released; export an open "
            "split, or the aggregate alone"
        )
    id_key = scores.ground_truth.task.id_field.name
    # Some tasks have numbers for ids; in scores they are text.
    raw = {str(record[id_key]): json.dumps(record) for record in records}
    shared = {
        "schema_version": SCHEMA_VERSION,
        "evaluation_id": aggregate["evaluation_id"],
        "model_id": aggregate["model_info"]["id"],
        "interaction_type": "single_turn",
    }
    samples = list(zip(scores.instr_ids, scores.ground_truth.episodes.instructions, strict=True))
    for metric in _exported(scores):
        if not metric.is_binary:
            continue
        names = {
            "evaluation_name": _evaluation_name(scores, metric),
            "evaluation_result_id": _result_id(scores, metric),
        }
        values = scores.episodes[metric.key].tolist()
        for (instr_id, instruction), value in zip(samples, values, strict=True):
            yield {
                **shared,
                **names,
                "sample_id": instr_id,
                "input": {"raw": instruction, "reference": []},
                "output": {"raw": [raw[instr_id]]},
                "messages": None,
                "answer_attribution": [],
                "evaluation": {"score": value, "is_correct": value == 1.0},
            }


def collection(scores: Scores) -> str:
    """Return the folder of the collection that scores belong to: the dataset's name."""
    return re.sub(r"\W+", "-", scores.ground_truth.header.dataset, flags=re.ASCII).strip("-")


def _is_private(scores: Scores) -> bool:
    return scores.split == _PRIVATE_SPLIT


def _exported(scores: Scores) -> Sequence[Metric]:
    """Return the headline metrics, apart from those that have no better direction."""
    return [metric for metric in scores.headline if metric.better != "neither"]


def _result(scores: Scores, metric: Metric) -> Mapping[str, Any]:
    score = scores[metric.key]
    return {
        "evaluation_result_id": _result_id(scores, metric),
        "evaluation_name": _evaluation_name(scores, metric),
        "source_data": _source(scores),
        "metric_config": {
            "evaluation_description": metric.definition,
            "metric_id": f"{scores.ground_truth.task.name}.{metric.key}",
            "metric_name": metric.name,
            "metric_unit": _UNITS[metric.unit],
            "lower_is_better": metric.better == "lower",
            "score_type": "continuous",
            "min_score": _bound(metric.lower_bound),
            "max_score": _bound(metric.upper_bound),
        },
        "score_details": {
            "score": metric.rounded(score) if _is_private(scores) else score,
            "details": {"signature": scores.signature},
            "uncertainty": _uncertainty(scores, metric),
        },
    }


def _uncertainty(scores: Scores, metric: Metric) -> Mapping[str, Any]:
    counted: Mapping[str, Any] = {"num_samples": len(scores.instr_ids)}
    intervals = scores.intervals
    if intervals is None or _is_private(scores):
        return counted
    interval = intervals[metric.key]
    return {
        **counted,
        "confidence_interval": {
            "lower": interval.low,
            "upper": interval.high,
            "confidence_level": intervals.confidence,
            "method": intervals.procedure,
        },
        "num_bootstrap_samples": intervals.resamples,
    }


def _source(scores: Scores) -> Mapping[str, Any]:
    truth = scores.ground_truth
    details = {
        "split": truth.split,
        "protocol": scores.protocol.name,
        "fingerprint": truth.fingerprint,
    }
    name = {"dataset_name": truth.header.dataset, "additional_details": details}
    # The demo world is made up, and nowhere to be fetched.
    if truth.is_demo:
        return {**name, "source_type": "other"}
    return {**name, "source_type": "url", "url": [f"https://{truth.task.source}"]}


def _evaluation_name(scores: Scores, metric: Metric) -> str:
    return f"{scores.ground_truth.header.dataset} {scores.split} {metric.label}"


def _result_id(scores: Scores, metric: Metric) -> str:
    return f"{scores.signature}|{metric.key}"


def _bound(value: float) -> float | str:
    """Return a bound as the schema writes it: infinity is a word."""
    return ("Infinity" if value > 0 else "-Infinity") if isinf(value) else value


# The Hugging Face Hub.


# The Hub's kind of task that is closest to walking through buildings.
_TASK_TYPE = "robotics"


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
