"""The guide: how to submit, metrics, protocols, rules, the API and privacy."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.geometry import HEIGHT, WIDTH
from reverie_eval.schemas.service import Method
from reverie_eval.scoring import ALIASES, PROTOCOLS
from reverie_eval.server.errors import ERRORS
from reverie_eval.server.http.callers import Call, Visitor
from reverie_eval.server.http.examples import SUBMISSION
from reverie_eval.server.pages.rendering import address_of_site, page
from reverie_eval.server.service.attempts import DAYS_KEPT
from reverie_eval.server.service.keys import list_keys
from reverie_eval.server.service.tokens import LIFETIME
from reverie_eval.submissions import submission_schema

router = APIRouter(prefix="/guide")

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
def show_submitting(visitor: Visitor) -> Response:
    """Show how to submit; the fields come from the schema that submissions are checked with."""
    return _page(
        visitor,
        "guide/submitting.html",
        fields=fields_of(submission_schema()["$defs"]["Prediction"]),
        example=_example(),
        picture=(WIDTH, HEIGHT),
        limits=visitor.server.settings.limits,
        address=address_of_site(visitor.request),
        split=next(iter(visitor.server.boards)),
    )


@router.get("/metrics")
def show_metrics(visitor: Visitor) -> Response:
    """Show what each metric means."""
    return _page(visitor, "guide/metrics.html")


@router.get("/protocols")
def show_protocols(visitor: Visitor) -> Response:
    """Show the rules of the published evaluators."""
    boards = visitor.server.leaderboards
    aliases = {
        name: [alias for alias, canonical in ALIASES.items() if canonical == name]
        for name in PROTOCOLS
    }
    return _page(
        visitor, "guide/protocols.html", protocols=PROTOCOLS, boards=boards, aliases=aliases
    )


@router.get("/rules")
def show_rules(visitor: Visitor) -> Response:
    """Show this server's splits, quotas and phases."""
    server = visitor.server
    with visitor.snapshot() as snapshot:
        return page(
            visitor.request,
            "guide/rules.html",
            snapshot,
            boards=server.boards,
            schedules=server.schedules.in_effect(snapshot.session),
            now=snapshot.now,
            required=server.settings.required_metadata,
            method_fields=Method.model_fields,
        )


@router.get("/api")
def show_api(visitor: Visitor) -> Response:
    """Show how to use the API."""
    with visitor.snapshot() as snapshot:
        return page(
            visitor.request,
            "guide/api.html",
            snapshot,
            address=address_of_site(visitor.request),
            split=next(iter(visitor.server.boards)),
            errors=ERRORS,
            limits=visitor.server.settings.limits,
            keys=list_keys(snapshot.session),
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
    with visitor.snapshot() as snapshot:
        return page(visitor.request, template, snapshot, **content)


def _example() -> str:
    """Return the example submission as JSON with one field per line."""
    records = [
        ",\n   ".join(f"{json.dumps(name)}: {json.dumps(value)}" for name, value in record.items())
        for record in SUBMISSION
    ]
    return "[\n  {" + "},\n  {".join(records) + "}\n]"


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
