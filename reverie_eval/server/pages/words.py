"""What there is to read: how to submit, what is measured, by which rules, and what is kept."""

import json

from fastapi import APIRouter, Request
from fastapi.responses import Response

from reverie_eval.geometry import HEIGHT, WIDTH
from reverie_eval.schemas.service import Method
from reverie_eval.scoring import ALIASES, PROTOCOLS
from reverie_eval.server.callers import Server
from reverie_eval.server.errors import ERRORS
from reverie_eval.server.examples import SUBMISSION
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.pages.schema_words import fields_of
from reverie_eval.server.pages.visitors import Visitor
from reverie_eval.server.service.attempts import DAYS_KEPT
from reverie_eval.server.service.sessions import LIFETIME
from reverie_eval.submissions import submission_schema

router = APIRouter(prefix="/words")


@router.get("")
def show_words(request: Request, visitor: Visitor) -> Response:
    """List what there is to read."""
    return page(request, "words/index.html", visitor)


@router.get("/submitting")
def show_submitting(request: Request, server: Server, visitor: Visitor) -> Response:
    """Tell how a submission is made, from the very schema that it is checked by."""
    return page(
        request,
        "words/submitting.html",
        visitor,
        fields=fields_of(submission_schema()["$defs"]["Prediction"]),
        example=_example(),
        picture=(WIDTH, HEIGHT),
        limits=server.settings.limits,
        address=_address(request),
        split=next(iter(server.boards)),
    )


@router.get("/metrics")
def show_metrics(request: Request, visitor: Visitor) -> Response:
    """Tell what each metric means."""
    return page(request, "words/metrics.html", visitor)


@router.get("/protocols")
def show_protocols(request: Request, server: Server, visitor: Visitor) -> Response:
    """Tell the rules that published evaluators score by."""
    used = {name: board.split.protocol for name, board in server.boards.items()}
    aliases = {
        name: [alias for alias, canonical in ALIASES.items() if canonical == name]
        for name in PROTOCOLS
    }
    return page(
        request, "words/protocols.html", visitor, protocols=PROTOCOLS, used=used, aliases=aliases
    )


@router.get("/rules")
def show_rules(request: Request, server: Server, visitor: Visitor) -> Response:
    """Tell this server's splits, quotas and phases."""
    return page(
        request,
        "words/rules.html",
        visitor,
        boards=server.boards,
        now=server.clock(),
        required=server.settings.required_metadata,
        said=Method.model_fields,
    )


@router.get("/api")
def show_api(request: Request, server: Server, visitor: Visitor) -> Response:
    """Tell how programs ask."""
    return page(
        request,
        "words/api.html",
        visitor,
        address=_address(request),
        split=next(iter(server.boards)),
        errors=ERRORS,
        limits=server.settings.limits,
        key_id=server.signer.key_id,
    )


@router.get("/privacy")
def show_privacy(request: Request, server: Server, visitor: Visitor) -> Response:
    """Tell what is kept, and who sees it."""
    return page(
        request,
        "words/privacy.html",
        visitor,
        boards=server.boards,
        hours=int(LIFETIME.total_seconds()) // 3600,
        days=DAYS_KEPT,
    )


def _example() -> str:
    """Return the example, a field a line, as people would write it."""
    records = [
        ",\n   ".join(f"{json.dumps(name)}: {json.dumps(value)}" for name, value in record.items())
        for record in SUBMISSION
    ]
    return "[\n  {" + "},\n  {".join(records) + "}\n]"


def _address(request: Request) -> str:
    return str(request.base_url).rstrip("/")
