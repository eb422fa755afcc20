"""The task of a dataset, described by the draft vocabulary Croissant Tasks.

References
----------
Benjelloun et al., "Croissant Tasks: A Metadata Format for Reproducible Machine Learning
Evaluations", arXiv:2605.29786, 2026. The vocabulary is tasks/croissant-tasks.ttl of
https://github.com/mlcommons/croissant: `MetricSpec`, `expectedMetric` and `lowerIsBetter` as
proposed in 0e1dbc3, the rest as in the main branch, 833fe78.
"""

from collections.abc import Iterable, Iterator, Mapping
from math import isinf
from typing import Any

from reverie_eval.metrics import Metric
from reverie_eval.tasks import DEFAULT_PROTOCOL, Task

_OUTPUT = "submission"
_EVALUATION = "evaluation"
_TRAINING = "train"
"""The split that agents learn from, which is no problem to solve."""
_POSES = {"cr:isArray": True, "cr:arrayShape": "-1,3"}


def task_problem(task: Task, splits: Iterable[str]) -> Mapping[str, Any]:
    """Return what a submission answers and how it is scored: a problem, and a part for each split.

    Its inputs are parts of the dataset's description. Scoring is by the task's default protocol,
    with the metrics of a score table that have a better direction. ``splits`` are those that the
    dataset has, which are also the ids of their record sets.
    """
    unit = "item" if task.has_items else "episode"
    return {
        "@type": "cr:TaskProblem",
        "@id": "task",
        "name": task.title,
        "description": "One trajectory for each episode. "
        f"An episode is a success if {task.metric('success').definition}.",
        "cr:input": {"@id": "navigation-graphs"},
        "cr:output": {
            "@type": "cr:OutputSpec",
            "@id": _OUTPUT,
            "name": "submission",
            "description": f"A JSON file: a list of one record for each {unit} of a split. "
            f"Ids of episodes are {task.id_form}, such as {task.id_example}.",
            "cr:schema": {
                "@type": "cr:RecordSet",
                "@id": f"{_OUTPUT}/records",
                "name": "records",
                "cr:field": list(_fields(task)),
            },
        },
        "cr:evaluation": _evaluation(task),
        "cr:subTask": [
            {
                "@type": "cr:TaskProblem",
                "@id": f"task/{split}",
                "name": f"{task.title}, {split}",
                "cr:input": {"@id": split},
                "cr:output": {"@id": _OUTPUT},
                "cr:evaluation": {"@id": _EVALUATION},
            }
            for split in splits
            if split != _TRAINING
        ],
    }


def _fields(task: Task) -> Iterator[Mapping[str, Any]]:
    """Yield the fields of a result's record that the official form requires."""
    ((id_key, example),) = task.id_field(task.id_example.partition("#")[0]).items()
    yield _field(id_key, "sc:Text" if isinstance(example, str) else "sc:Integer", "Whose it is.")
    poses = "From the start to the stop: viewpoint id, heading and elevation in radians."
    if task.has_items:
        about = "One for each start of the item, in the order of the annotations."
        point = "Of the point where the agent sees the target, in turns."
        yield {
            **_field("trajectory", "", about),
            "cr:isArray": True,
            "cr:subField": [
                {**_field("trajectory/path", "sc:Text", poses), **_POSES},
                _field("trajectory/obj_heading", "sc:Float", point),
                _field("trajectory/obj_elevation", "sc:Float", point),
            ],
        }
    else:
        yield {**_field("trajectory", "sc:Text", poses), **_POSES}
    if task.has_targets:
        about = "The predicted object's id within the building; -1 for none."
        yield _field("predObjId", "sc:Integer", about)


def _field(place: str, data_type: str, description: str) -> Mapping[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"{_OUTPUT}/records/{place}",
        "name": place.rpartition("/")[2],
        "description": description,
        **({"dataType": data_type} if data_type else {}),
    }


def _evaluation(task: Task) -> Mapping[str, Any]:
    rules = task.protocol(DEFAULT_PROTOCOL)
    metrics = [task.metric(key) for key in task.headline]
    ranking = task.metric(task.ranking[0])
    return {
        "@type": "cr:EvaluationSpec",
        "@id": _EVALUATION,
        "name": rules.name,
        "description": f"{rules.summary}. Submissions are ranked by {ranking.label}.",
        "citation": rules.source,
        "cr:expectedMetric": [_metric(each) for each in metrics if each.better != "neither"],
    }


def _metric(metric: Metric) -> Mapping[str, Any]:
    bounds = {"minValue": metric.lower_bound, "maxValue": metric.upper_bound}
    return {
        "@type": "cr:MetricSpec",
        "@id": f"{_EVALUATION}/{metric.key}",
        "name": metric.label,
        "description": f"{metric.name}: {metric.definition}",
        "cr:lowerIsBetter": metric.better == "lower",
        **{name: bound for name, bound in bounds.items() if not isinf(bound)},
        "unitText": metric.unit,
    }
