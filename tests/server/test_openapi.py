"""The description of the API: sound, complete, and its examples are what it says."""

from collections.abc import Iterator, Sequence
from typing import Any

import pytest
from openapi_spec_validator import validate

from reverie_eval.metrics import PRIMARY_METRIC
from reverie_eval.schemas.service import Method
from reverie_eval.server.errors import ERRORS, RequestError
from tests.support.description import Description
from tests.support.serving import Serving

BINARY = {"type": "string", "format": "binary"}


@pytest.fixture
def description(server: Serving) -> Description:
    """Return what a server says of itself."""
    return Description(server)


def bodies(operation: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Return every body of a request and of its replies that is not opaque."""
    for place in (operation.get("requestBody", {}), *operation["responses"].values()):
        for body in place.get("content", {}).values():
            if body.get("schema") != BINARY:
                yield body


def codes_of(body: dict[str, Any]) -> Sequence[str]:
    """Return the codes of the problems that a body may be; empty if it is not a problem."""
    codes: Sequence[str] = (
        body.get("schema", {}).get("properties", {}).get("code", {}).get("enum", ())
    )
    return codes


def test_it_is_openapi_3_1(description: Description) -> None:
    assert description.document["openapi"].startswith("3.1")
    validate(description.document)


def test_every_example_is_one(description: Description) -> None:
    examples: list[tuple[dict[str, Any], Any]] = []
    for _, operation in description.operations():
        for body in bodies(operation):
            whole = [example["value"] for example in body.get("examples", {}).values()]
            whole += [body["example"]] if "example" in body else []
            examples += [(body.get("schema", {}), each) for each in whole]
    for model in description.document["components"]["schemas"].values():
        for field in model.get("properties", {}).values():
            examples += [(field, each) for each in field.get("examples", ())]
    assert len(examples) > 200
    for schema, example in examples:
        description.check_value(schema, example)


REPORTS = ("GET /healthz", "GET /readyz")
"""Routes that have the same reply whether or not the server is well."""


def test_every_problem_has_its_status_and_its_media_type(description: Description) -> None:
    for name, operation in description.operations():
        for status, reply in operation["responses"].items():
            if int(status) < 400 or name in REPORTS:
                continue
            ((media_type, body),) = reply["content"].items()
            assert media_type == "application/problem+json", name
            for code in codes_of(body):
                assert ERRORS[code].status == int(status), name


def test_every_operation_can_fail_and_says_how(description: Description) -> None:
    for name, operation in description.operations():
        assert {"429", "500"} <= set(operation["responses"]), name
        assert ("security" not in operation) or "401" in operation["responses"], name


def test_every_code_of_a_request_s_problems_is_declared_somewhere(
    description: Description,
) -> None:
    declared = {
        code
        for _, operation in description.operations()
        for body in bodies(operation)
        for code in codes_of(body)
    }
    # The first is of no operation, the second of forms alone.
    assert declared == set(ERRORS) - {"method-not-allowed", "csrf"}


def test_every_error_has_its_own_code_and_heading() -> None:
    kinds = RequestError.__subclasses__()
    assert len(ERRORS) == len(kinds) == len({kind.heading for kind in kinds})
    assert all(kind.heading[0].isupper() for kind in kinds)


def test_what_changes_something_needs_the_csrf_token_beside_the_cookie(
    description: Description,
) -> None:
    for name, operation in description.operations():
        for way in operation.get("security", ()):
            is_change = not name.startswith("GET")
            assert ("csrf" in way) is ("APIKeyCookie" in way and is_change), name


def test_an_upload_s_parameters_are_the_fields_of_a_method(description: Description) -> None:
    upload = dict(description.operations())["POST /splits/{split}/submissions"]
    form = upload["requestBody"]["content"]["multipart/form-data"]["schema"]["properties"]
    query = [parameter["name"] for parameter in upload["parameters"] if parameter["in"] == "query"]
    assert query == list(Method.model_fields)
    assert list(form) == ["file", *Method.model_fields]
    assert "idempotency-key" in [parameter["name"] for parameter in upload["parameters"]]


def test_what_a_board_is_sorted_by_is_listed(description: Description) -> None:
    board = dict(description.operations())["GET /splits/{split}/leaderboard"]
    (metric,) = (part for part in board["parameters"] if part["name"] == "metric")
    assert PRIMARY_METRIC in metric["schema"]["enum"]
    assert "default" not in metric["schema"]  # it depends on what the split scores
    assert "path_length" not in metric["schema"]["enum"]
