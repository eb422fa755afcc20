"""What is refused, and how: each problem is a document with a code, and with its places."""

import re
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, NamedTuple

import pytest

from reverie_eval.server.errors import phrase_of
from tests.support.serving import BROKEN, GOOD, OPEN, ORGANISER, OWNER, Serving

JSON = {"Content-Type": "application/json"}
SUBMISSIONS = f"/splits/{OPEN}/submissions"
NOBODY = None
NUL_IN_HINT = "/organiser/tokens/rv_%001234567"


class Refused(NamedTuple):
    """A request, and what becomes of it."""

    who: str | None
    asks: str
    status: int
    code: str
    places: Sequence[str] | int = ()
    """Where its problems are; or how many there are."""
    content: Mapping[str, Any] = {}


def until(instant: str) -> Mapping[str, Any]:
    return {"json": {"anonymous_until": instant}}


def raw(content: bytes) -> Mapping[str, Any]:
    return {"content": content, "headers": JSON}


BAD = "malformed-request"
REFUSED = {
    "no such path": Refused(OWNER, "GET /nothing", 404, "not-found"),
    "no such method": Refused(OWNER, "PUT /me", 405, "method-not-allowed"),
    "no such split": Refused(OWNER, "GET /splits/nothing", 404, "not-found"),
    "a zero byte in a split": Refused(OWNER, "GET /splits/%00", 404, "not-found"),
    "a zero byte in an id": Refused(OWNER, "GET /submissions/%00", 404, "not-found"),
    "a path in an id": Refused(OWNER, "GET /submissions/..%2f..%2fkey/file", 404, "not-found"),
    "an empty file": Refused(
        OWNER, f"POST {SUBMISSIONS}?name=x", 422, "submission-rejected", 1, {"content": b""}
    ),
    "a broken file": Refused(
        OWNER, f"POST {SUBMISSIONS}?name=x", 422, "submission-rejected", 23, {"content": BROKEN}
    ),
    "a broken file to check": Refused(
        OWNER, f"POST /splits/{OPEN}/validate", 422, "submission-rejected", 23, {"content": BROKEN}
    ),
    "a file without a name": Refused(
        OWNER, f"POST {SUBMISSIONS}", 400, BAD, ["name"], {"content": GOOD}
    ),
    "a file for no split": Refused(
        OWNER, "POST /splits/no/validate", 404, "not-found", (), {"content": GOOD}
    ),
    "a form without the file": Refused(
        OWNER, f"POST {SUBMISSIONS}", 400, BAD, (), {"files": {"other": GOOD}}
    ),
    "an endless key": Refused(
        OWNER,
        f"POST {SUBMISSIONS}?name=x",
        400,
        BAD,
        ["idempotency-key"],
        {"content": GOOD, "headers": {"Idempotency-Key": "x" * 201}},
    ),
    "JSON that breaks off": Refused(OWNER, "PATCH {own}", 400, BAD, ["character 1"], raw(b"{")),
    "JSON without end": Refused(OWNER, "PATCH {own}", 400, BAD, [""], raw(b"[" * 100_000)),
    "a number without end": Refused(
        OWNER, "PATCH {own}", 400, BAD, [""], raw(b'{"published": %s}' % (b"9" * 5000))
    ),
    "JSON that says it is none": Refused(OWNER, "PATCH {own}", 400, BAD, [""], {"content": b"{}"}),
    "a list": Refused(OWNER, "PATCH {own}", 400, BAD, [""], {"json": []}),
    "another team": Refused(OWNER, "PATCH {own}", 400, BAD, ["team"], {"json": {"team": "Red"}}),
    "other scores": Refused(OWNER, "PATCH {own}", 400, BAD, ["scores"], {"json": {"scores": {}}}),
    "two things at once": Refused(
        OWNER, "PATCH {own}", 400, BAD, ["published", "id"], {"json": {"published": 7, "id": "x"}}
    ),
    "the end of time": Refused(
        OWNER, "PATCH {own}", 400, BAD, ["anonymous_until"], until("9999-12-31T23:59:59-12:00")
    ),
    "a time without a zone": Refused(
        OWNER, "PATCH {own}", 400, BAD, ["anonymous_until"], until("2027-01-01T00:00:00")
    ),
    "no invitation": Refused(NOBODY, "POST /tokens", 400, BAD, ["invitation"], {"json": {}}),
    "half a letter": Refused(
        NOBODY, "POST /tokens", 400, BAD, ["invitation"], raw(b'{"invitation": "\\ud800"}')
    ),
    "no letter": Refused(
        NOBODY, "POST /tokens", 400, BAD, ["byte 16"], raw(b'{"invitation": "\xff"}')
    ),
    "an empty invitation": Refused(
        NOBODY, "POST /tokens", 400, BAD, ["invitation"], {"json": {"invitation": ""}}
    ),
    "nothing of the log": Refused(ORGANISER, "GET /organiser/audit?limit=0", 400, BAD, ["limit"]),
    "more than a database can count": Refused(
        ORGANISER, f"GET /organiser/audit?after={10**30}", 400, BAD, ["after"]
    ),
    "no such token": Refused(ORGANISER, "DELETE /organiser/tokens/rv_12345678", 404, "not-found"),
    "a zero byte in a token": Refused(ORGANISER, f"DELETE {NUL_IN_HINT}", 400, BAD, ["hint"]),
}


OF_THE_FRAMEWORK = re.compile("should|Input|Field|Extra|Value error")


@pytest.mark.parametrize("refused", REFUSED.values(), ids=list(REFUSED))
def test_problem_documents(server: Serving, refused: Refused) -> None:
    own = f"/submissions/{server.upload(OWNER).json()['submission']['id']}"
    method, path = refused.asks.split()
    reply = server.ask(refused.who, method, path.format(own=own), **refused.content)
    said = reply.json()
    assert reply.headers["content-type"] == "application/problem+json"
    assert (reply.status_code, said["status"], said["code"]) == (
        refused.status,
        refused.status,
        refused.code,
    )
    assert said["detail"]
    assert not [each for each in said["problems"] if OF_THE_FRAMEWORK.search(each["message"])]
    found = [problem["where"] for problem in said["problems"]]
    expected = refused.places
    assert len(found) == expected if isinstance(expected, int) else found == [*expected]


def test_who_is_not_signed_in_is_told_how(server: Serving) -> None:
    reply = server.ask(NOBODY, "GET", "/me")
    assert reply.headers["www-authenticate"] == "Bearer"
    assert "Authorization: Bearer" in reply.json()["detail"]


@pytest.mark.parametrize("shown", ["rv_", "Ada", "rv_" + 43 * "é", 1000 * "x"])
def test_what_is_no_token_is_not_told_again(server: Serving, shown: str) -> None:
    headers = {b"Authorization": f"Bearer {shown}".encode()}
    reply = server.client.get("/api/v1/splits", headers=headers)
    assert (reply.status_code, reply.json()["code"]) == (401, "not-signed-in")
    assert shown not in reply.text


def test_another_key_for_another_file(server: Serving) -> None:
    server.upload(OWNER, key="one")
    reply = server.upload(OWNER, server.distinct(), key="one")
    assert (reply.status_code, reply.json()["code"]) == (409, "conflict")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        pytest.param(b"[" * 100_000, "nested too deeply", id="deep"),
        pytest.param(b"9" * 5000, "contains a number with too many digits", id="long"),
        pytest.param(b"\xff", "invalid UTF-8 from here", id="other letters"),
    ],
)
def test_json_that_cannot_be_read(server: Serving, content: bytes, said: str) -> None:
    reply = server.ask(NOBODY, "POST", "/tokens", **raw(content)).json()
    assert reply["detail"] == "the body cannot be read as JSON"
    assert [problem["message"] for problem in reply["problems"]] == [said]


def test_where_a_document_is_not_json(server: Serving) -> None:
    (problem,) = server.ask(NOBODY, "POST", "/tokens", **raw(b'{"person": x}')).json()["problems"]
    assert (problem["where"], problem["message"]) == ("character 11", "invalid JSON from here")


@pytest.mark.parametrize(
    ("status", "title"),
    [(422, "Unprocessable Content"), (413, "Content Too Large"), (404, "Not Found")],
)
def test_titles_are_the_same_with_every_version_of_python(status: int, title: str) -> None:
    assert phrase_of(HTTPStatus(status)) == title


@pytest.mark.parametrize("path", ["/sign-in", f"/api/v1{SUBMISSIONS}"])
def test_a_form_that_cannot_be_read(server: Serving, path: str) -> None:
    headers = {
        "Content-Type": "multipart/form-data",
        "Authorization": f"Bearer {server.tokens[OWNER]}",
    }
    reply = server.client.post(path, content=b"--x", headers=headers)
    assert reply.status_code == 400
    assert "form cannot be read: " in reply.text
