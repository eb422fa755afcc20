"""What is wrong with a value: a sentence of ours for whatever the framework may find."""

from datetime import date
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, TypeAdapter, ValidationError

from reverie_eval.schemas.service import Method, SubmissionChange
from reverie_eval.schemas.wire import Https, Instant, Name, wrong_value

LINK = "must be a link that begins with https://"
INSTANT = "must be a time with its time zone, such as 2027-06-01T12:00:00Z"
DATE = "must be a date, such as 2027-06-01"

WRONG = [
    pytest.param(Name, "", "must have 1 or more characters", id="empty"),
    pytest.param(Name, "x" * 101, "must have at most 100 characters", id="too long"),
    pytest.param(Name, 7, "must be text", id="no text"),
    pytest.param(Name, "a\nb", "must be one line without invisible characters", id="two lines"),
    pytest.param(Https, "http://x.org/", LINK, id="another scheme"),
    pytest.param(Https, "x", LINK, id="no link"),
    pytest.param(Https, 7, LINK, id="a number for a link"),
    pytest.param(
        Https, f"https://{'x' * 500}.org", "must have at most 500 characters", id="a long link"
    ),
    pytest.param(Literal["with", "without"], "x", "must be 'with' or 'without'", id="a choice"),
    pytest.param(bool, "x", "must be true or false", id="neither yes nor no"),
    pytest.param(int, "x", "must be a whole number", id="no number"),
    pytest.param(int, 1.5, "must be a whole number", id="a fraction"),
    pytest.param(float, "x", "must be a number", id="no number at all"),
    pytest.param(
        Annotated[int, Field(ge=1, le=10_000)], 0, "must be 1 or more", id="too small a number"
    ),
    pytest.param(
        Annotated[int, Field(ge=1, le=10_000)], 10**5, "must be 10,000 or less", id="too large"
    ),
    pytest.param(
        Annotated[int, Field(ge=0, lt=360)], 360, "must be less than 360", id="a full turn"
    ),
    pytest.param(date, "soon", DATE, id="no date"),
    pytest.param(date, "2027-06-31", DATE, id="no such day"),
    pytest.param(Instant, "soon", INSTANT, id="no instant"),
    pytest.param(Instant, "2027-06-01T12:00:00", INSTANT, id="no zone"),
    pytest.param(
        Instant,
        "1999-06-01T12:00:00Z",
        "must be in the years 2000 to 2999",
        id="another century",
    ),
    pytest.param(
        Annotated[list[int], Field(min_length=1)], [], "must have 1 or more entries", id="no entry"
    ),
    pytest.param(
        Annotated[dict[str, int], Field(max_length=1)],
        {"a": 1, "b": 2},
        "must have at most 1 entries",
        id="many entries",
    ),
    pytest.param(Method, {}, "required but missing", id="missing"),
    pytest.param(Method, [], "must be an object", id="a list for an object"),
    pytest.param(SubmissionChange, {"score": 1}, "unknown field; remove it", id="one too many"),
]


@pytest.mark.parametrize(("kind", "value", "expected"), WRONG)
def test_what_is_wrong_with_a_value(kind: Any, value: object, expected: str) -> None:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(kind).validate_python(value)
    (detail,) = caught.value.errors()
    assert wrong_value(detail).message == expected


WHERE = [
    pytest.param(("query", "metric"), "metric", id="of an address"),
    pytest.param(("body", "method", "name"), "method.name", id="of a document"),
    pytest.param(("method", "name"), "method.name", id="of a form"),
    pytest.param(("body",), "", id="the whole document"),
    pytest.param((), "", id="the whole form"),
]


@pytest.mark.parametrize(("loc", "expected"), WHERE)
def test_where_a_value_is(loc: tuple[str, ...], expected: str) -> None:
    found = wrong_value({"type": "missing", "loc": loc, "msg": "Field required"})
    assert found.where == expected
