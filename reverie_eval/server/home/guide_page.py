"""The guide: how to submit, metrics, protocols, rules, the API and privacy."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from fastapi import APIRouter, Response

from reverie_eval.geometry import HEIGHT, WIDTH
from reverie_eval.metrics import CATALOGUE
from reverie_eval.server.audit.signing import list_keys
from reverie_eval.server.boards.leaderboard import MOST_COMPARED
from reverie_eval.server.boards.reviews import VERDICTS
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.errors import ERRORS, NotFoundError
from reverie_eval.server.http.api import SUBMISSION
from reverie_eval.server.http.callers import Call, Visitor
from reverie_eval.server.http.rendering import address_of_site, page
from reverie_eval.server.identity import LIFETIME
from reverie_eval.server.intake.attempts import DAYS_KEPT
from reverie_eval.submissions import submission_schema
from reverie_eval.tasks import Task

router = APIRouter(prefix="/guide")

_OF_WALKS = ("instr_id", "trajectory")
"""The fields of a record in a task without target objects."""
_PLAIN = {
    "string": "text",
    "number": "number",
    "integer": "whole number",
    "boolean": "true or false",
}
_BOUNDS = {
    "minimum": "at least",
    "exclusiveMinimum": "above",
    "maximum": "at most",
    "exclusiveMaximum": "below",
}


@router.get("")
def show_guide(visitor: Visitor) -> Response:
    """Show the guide's table of contents."""
    return _page(visitor, "guide/index.html")


@router.get("/submitting")
@router.get("/submitting/{task}")
def show_submitting(visitor: Visitor, task: str = "") -> Response:
    """Show how to submit; the fields come from the schema that submissions are checked with."""
    shown, boards = _task(visitor, task), visitor.server.boards.values()
    schema = submission_schema()["$defs"]["Prediction"]
    return _page(
        visitor,
        "guide/submitting.html",
        task=shown,
        fields=[each for each in fields_of(schema) if shown.has_targets or each.name in _OF_WALKS],
        example=_example(shown),
        picture=(WIDTH, HEIGHT),
        limits=visitor.server.settings.limits,
        address=address_of_site(visitor.request),
        split=next(board.truth.split for board in boards if board.task is shown),
    )


@router.get("/metrics")
@router.get("/metrics/{task}")
def show_metrics(visitor: Visitor, task: str = "") -> Response:
    """Show what each metric of a task means."""
    shown = _task(visitor, task)
    other_metrics = [shown.metric(key) for key in shown.metrics if key not in shown.headline]
    return _page(
        visitor,
        "guide/metrics.html",
        task=shown,
        headline=shown.headline_metrics(CATALOGUE),
        other_metrics=other_metrics,
        most_compared=MOST_COMPARED,
    )


@router.get("/protocols")
@router.get("/protocols/{task}")
def show_protocols(visitor: Visitor, task: str = "") -> Response:
    """Show the rules of a task's published evaluators."""
    shown = _task(visitor, task)
    boards = [board for board in visitor.server.all_boards if board.task is shown]
    aliases = {
        protocol.name: [alias for alias, name in shown.aliases.items() if name == protocol.name]
        for protocol in shown.protocols
    }
    return _page(visitor, "guide/protocols.html", task=shown, boards=boards, aliases=aliases)


def _task(visitor: Call, name: str) -> Task:
    """Return one of the tasks that the splits are of; without a name, the first one."""
    known = {task.name: task for task in visitor.server.tasks}
    if name and name not in known:
        raise NotFoundError(
            f"there are no leaderboards of {name!r} here, only of {', '.join(known)}"
        )
    return known[name] if name else next(iter(known.values()))


@router.get("/rules")
def show_rules(visitor: Visitor) -> Response:
    """Show this server's splits, quotas and phases."""
    server = visitor.server
    with visitor.reading() as reading:
        return page(
            reading,
            "guide/rules.html",
            boards=server.boards,
            schedules=server.get(Schedules).in_effect(reading.session),
            required=server.settings.required_metadata,
            verdicts=VERDICTS,
        )


@router.get("/api")
def show_api(visitor: Visitor) -> Response:
    """Show how to use the API."""
    with visitor.reading() as reading:
        return page(
            reading,
            "guide/api.html",
            address=address_of_site(visitor.request),
            split=next(iter(visitor.server.boards)),
            errors=ERRORS,
            limits=visitor.server.settings.limits,
            keys=list_keys(reading.session),
        )


@router.get("/privacy")
def show_privacy(visitor: Visitor) -> Response:
    """Show what is stored, and who can see it."""
    return _page(
        visitor,
        "guide/privacy.html",
        boards=visitor.server.boards,
        hours=int(LIFETIME.total_seconds()) // 3600,
        days=DAYS_KEPT,
        keep_uploads_days=visitor.server.settings.keep_uploads_days,
    )


def _page(visitor: Call, template: str, **content: Any) -> Response:
    with visitor.reading() as reading:
        return page(reading, template, **content)


def _example(task: Task) -> str:
    """Return an example submission as JSON with one field per line."""
    (record,) = SUBMISSION
    fields = {**task.official_id(task.id_example), "trajectory": record["trajectory"]}
    if task.has_targets:
        fields = record
    lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in fields.items()]
    return "[\n  {" + ",\n   ".join(lines) + "}\n]"


class Field(NamedTuple):
    """A field of a submission, as a row of a table."""

    name: str
    takes: str
    is_required: bool
    meaning: str


def fields_of(schema: Mapping[str, Any]) -> Sequence[Field]:
    """Return the fields of an object's schema, in the schema's order."""
    required = schema.get("required", ())
    return [
        Field(name, in_words(field), name in required, field.get("description", ""))
        for name, field in schema["properties"].items()
    ]


def in_words(schema: Mapping[str, Any]) -> str:
    """Describe the values that a schema allows.

    >>> in_words({"type": "integer", "minimum": 0, "exclusiveMaximum": 36})
    'whole number, at least 0, below 36'
    >>> in_words({"type": "array", "prefixItems": [{"type": "string"}, {"type": "number"}]})
    'list of [text, number]'
    """
    if "anyOf" in schema:
        kinds = [kind for kind in schema["anyOf"] if kind.get("type") != "null"]
        return " or ".join(map(in_words, kinds))
    if schema["type"] == "array":
        return _list_in_words(schema)
    bounds = [f"{words} {schema[key]:,}" for key, words in _BOUNDS.items() if key in schema]
    return ", ".join([_PLAIN[schema["type"]], *bounds])


def _list_in_words(schema: Mapping[str, Any]) -> str:
    if "prefixItems" in schema:
        return f"list of [{', '.join(_PLAIN[item['type']] for item in schema['prefixItems'])}]"
    least = f"{schema['minItems']} or more of " if "minItems" in schema else ""
    return f"list of {least}{in_words(schema['items']).removeprefix('list of ')}"
