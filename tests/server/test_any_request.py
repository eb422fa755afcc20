"""Whatever anybody sends to the API, the reply is one that its description declares.

No reply is a failure of the server, each has a declared status, media type and schema, and what the
description forbids is refused. Requests are made by schemathesis from the description itself: those
that it allows, and those that it forbids in one way or another. About half of the allowed ones name
what the server really has.
"""

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import timedelta
from http import HTTPStatus
from itertools import product
from typing import Any

import httpx
import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable
from schemathesis import Case, GenerationMode
from schemathesis.checks import CHECKS, load_all_checks
from schemathesis.core.failures import FailureGroup
from schemathesis.core.result import Ok

from tests.support.amounts import amount, is_evidence, tell
from tests.support.description import Description
from tests.support.serving import (
    ANYBODY,
    OPEN,
    ORGANISER,
    OWNER,
    PRIVATE,
    Serving,
    submission_for,
)
from tests.support.waiting import PATIENCE

ROLES = {"visitor": ANYBODY, "participant": OWNER, "organiser": ORGANISER}
REQUESTS_IN_SUITE = 1
"""For each operation, and for each of allowed and forbidden requests."""
load_all_checks()
EXPECTED: list[Any] = [
    check
    for check in CHECKS.get_all()
    if check.__name__
    in {
        "not_a_server_error",
        "status_code_conformance",
        "content_type_conformance",
        "response_headers_conformance",
        "response_schema_conformance",
        "negative_data_rejection",
    }
]


def known_to(server: Serving) -> Mapping[str, Any]:
    """Put something of everything on a server, and return what it is called by."""
    reply = server.upload(OWNER, submission_for(PRIVATE), PRIVATE).json()
    submission_id = reply["submission"]["id"]
    assert server.upload(OWNER).status_code == HTTPStatus.CREATED
    server.ask(OWNER, "PATCH", f"/submissions/{submission_id}", json={"published": True})
    return {"split": [PRIVATE, OPEN], "submission_id": [submission_id], "name": ["Blue", "Red"]}


def cases(operation: Any, mode: GenerationMode, known: Mapping[str, Any]) -> Any:
    """Return what makes requests of an operation; half of the allowed ones name known things."""

    def renamed(case: Case[Any], choice: int) -> Case[Any]:
        if mode is GenerationMode.POSITIVE and choice % 2:
            for name in case.path_parameters.keys() & known.keys():
                case.path_parameters[name] = known[name][choice // 2 % len(known[name])]
        return case

    return st.builds(renamed, operation.as_strategy(mode), st.integers(0, 3))


def send(server: Serving, who: str | None, case: Case[Any]) -> httpx.Response:
    """Send a request as somebody."""
    case.headers.pop("Authorization", None)
    prepared = requests.Request(**case.as_transport_kwargs("http://server")).prepare()
    headers = {name: value for name, value in prepared.headers.items() if name != "Content-Length"}
    headers |= {"Authorization": f"Bearer {server.tokens[who]}"} if who else {}
    server.client.cookies.clear()
    assert prepared.method is not None
    assert prepared.url is not None
    body: Any = prepared.body
    content = body.encode() if isinstance(body, str) else body
    raw = {name.encode(): _bytes(value) for name, value in headers.items()}
    begun = time.perf_counter()
    reply = server.client.request(
        prepared.method, prepared.url, headers=list(raw.items()), content=content
    )
    reply.elapsed = timedelta(seconds=time.perf_counter() - begun)
    return reply


def _bytes(value: str | bytes) -> bytes:
    return value if isinstance(value, bytes) else value.encode("latin-1", "replace")


def operations(server: Serving) -> Iterator[Any]:
    """Yield every operation of a server's API."""
    schema = schemathesis.openapi.from_dict(Description(server).document)
    for result in schema.get_all_operations():
        assert isinstance(result, Ok), result
        yield result.ok()


@pytest.mark.slow
def test_every_reply_is_as_declared(server: Serving) -> None:
    known, replies, slowest = known_to(server), Counter[str](), 0.0
    faults: list[str] = []

    def attempt(case: Case[Any], role: str) -> None:
        nonlocal slowest
        reply = send(server, ROLES[role], case)
        slowest = max(slowest, reply.elapsed.total_seconds())
        replies.update({role: 1, f"status {reply.status_code}": 1})
        if reply.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
            return  # another path than the operation's, by an odd character
        try:
            case.validate_response(reply, checks=EXPECTED)
        except FailureGroup as error:
            problems = "; ".join(str(each) for each in error.exceptions)
            faults.append(f"{role}: {case.method} {reply.request.url}: {reply.text}: {problems}")

    described = list(operations(server))
    for operation, mode in product(described, (GenerationMode.POSITIVE, GenerationMode.NEGATIVE)):
        run = settings(
            max_examples=amount(REQUESTS_IN_SUITE),
            derandomize=not is_evidence(),
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )(given(cases(operation, mode, known), st.sampled_from(list(ROLES)))(attempt))
        with suppress(Unsatisfiable):  # without parameters and body nothing is forbidden
            run()
    tell(**replies, slowest_reply=f"{slowest:.2f} s")
    assert not faults, f"{len(faults)} faults\n" + "\n\n".join(faults[:20])
    assert len(described) > 40
    assert slowest < PATIENCE
