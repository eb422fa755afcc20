"""Running the server: what every reply has, and what the log and the metrics tell the organiser."""

import json
import logging
import re
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from fastapi.routing import iter_route_contexts
from prometheus_client.parser import text_string_to_metric_families
from starlette.routing import Mount

from reverie_eval.server.app import create_app, jobs_of
from reverie_eval.server.http.rendering import STATIC
from reverie_eval.server.http.runtime import RuntimeState
from reverie_eval.server.intake import routes as submissions
from reverie_eval.server.run import JsonLines
from reverie_eval.server.scoring.boards import Board
from tests.support.serving import (
    BROKEN,
    GOOD,
    MATE,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    Serving,
    submission_for,
)
from tests.support.visiting import signed_in

REQUESTS = "reverie_eval.server.requests"
SECRET = "1999999937"


def fail(*_: object, **__: object) -> None:
    raise RuntimeError(f"the target is {SECRET}")


HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "content-security-policy": "default-src 'none'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
    "x-frame-options": "DENY",
    "cache-control": "no-store",
}


@pytest.mark.parametrize(
    ("who", "method", "path", "status"),
    [
        pytest.param(OWNER, "GET", "/me", 200, id="a reply"),
        pytest.param(None, "GET", f"/splits/{OPEN}/leaderboard.csv", 200, id="a file"),
        pytest.param(None, "GET", "/me", 401, id="who is that"),
        pytest.param(OWNER, "GET", "/nothing", 404, id="nothing there"),
        pytest.param(OWNER, "PUT", "/me", 405, id="no such method"),
        pytest.param(OWNER, "POST", f"/splits/{OPEN}/validate", 422, id="rejected"),
        pytest.param(OWNER, "GET", "/submissions", 500, id="a fault"),
    ],
)
def test_every_reply_has_the_headers(
    *,
    who: str | None,
    method: str,
    path: str,
    status: int,
    server: Serving,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(submissions, "list_submissions", fail)
    reply = server.ask(who, method, path)
    assert reply.status_code == status
    assert {name: reply.headers.get_list(name) for name in HEADERS} == {
        name: [value] for name, value in HEADERS.items()
    }
    assert re.fullmatch(r"[0-9a-f]{16}", reply.headers["x-request-id"])


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/healthz", 200),
        ("/api/v1/splits", 200),
        (f"/splits/{OPEN}", 200),
        ("/static/style.css", 200),
        ("/submit", 303),
        ("/metrics", 401),
        ("/api/v1/nothing", 404),
        ("/api/v1/tokens", 405),
    ],
)
def test_head_is_get_without_a_body(path: str, status: int, server: Serving) -> None:
    got, head = server.client.get(path), server.client.head(path)
    assert (got.status_code, head.status_code, head.content) == (status, status, b"")
    del got.headers["x-request-id"], head.headers["x-request-id"]
    assert head.headers == got.headers


@pytest.mark.parametrize(("query", "is_kept"), [("", False), ("?", False), ("?0123456789ab", True)])
def test_only_a_file_at_the_address_of_its_content_is_kept(
    query: str,
    is_kept: bool,  # noqa: FBT001  # a column of the table
    server: Serving,
) -> None:
    reply = server.client.get(f"/static/style.css{query}")
    assert ("immutable" in reply.headers["cache-control"]) is is_kept


def test_a_method_that_is_not_allowed_says_which_are(server: Serving) -> None:
    assert server.ask(OWNER, "PUT", "/me").headers["allow"] == "GET"


def lines_of(caplog: pytest.LogCaptureFixture, logger: str = REQUESTS) -> list[dict[str, Any]]:
    """Return what a logger has said, as it would be written."""
    written = [JsonLines().format(record) for record in caplog.records if record.name == logger]
    assert not any("\n" in line for line in written)
    return [json.loads(line) for line in written]


@pytest.fixture
def log(caplog: pytest.LogCaptureFixture) -> Callable[..., list[dict[str, Any]]]:
    """Return what tells what has been logged."""
    caplog.set_level(logging.INFO, "reverie_eval.server")
    return lambda logger=REQUESTS: lines_of(caplog, logger)


SUBMIT = "/api/v1/splits/{split}/submissions"


def test_a_request_is_a_line(server: Serving, log: Callable[..., list[dict[str, Any]]]) -> None:
    reply = server.upload(OWNER, key="my-own-key", description="my-own-words")
    (line,) = log()
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}\+00:00", line.pop("time"))
    assert 0 < line.pop("milliseconds") < 60_000
    assert line == {
        "level": "info",
        "logger": REQUESTS,
        "event": "request",
        "id": reply.headers["x-request-id"],
        "method": "POST",
        "route": SUBMIT,
        "status": 201,
        "received": len(GOOD),
        "sent": len(reply.content),
        "outcome": "ok",
        "caller": "participant, token",
        "split": OPEN,
        "team": server.person(OWNER).team_id,
        "submission": reply.json()["submission"]["id"],
        "token": server.tokens[OWNER][:11],
    }


WHO = ("caller", "split", "team", "submission", "outcome")


def test_the_line_of_an_upload_says_who_and_what(
    server: Serving, log: Callable[..., list[dict[str, Any]]]
) -> None:
    """By numbers and ids: names of people and teams are nowhere in the log."""
    submission = server.upload(OWNER).json()["submission"]["id"]
    server.upload(OWNER)
    server.upload(OWNER, BROKEN)
    server.ask(OWNER, "POST", f"/splits/{PRIVATE}/validate", content=GOOD)
    server.ask(None, "POST", f"/splits/{OPEN}/submissions", content=GOOD)
    server.upload(OTHER, split="none-of-ours")
    mate, desk = signed_in(server, MATE), signed_in(server, ORGANISER)
    mate.upload()
    mate.upload(GOOD, "check")
    received = {"person": "1", "received_at": "2026-03-02T11:00:00Z", "name": "Walker"}
    desk.send("/desk/emailed-files", {"split": OPEN, **received}, file=GOOD)
    teams = [server.person(who).team_id for who in (OWNER, OTHER, ORGANISER)]
    sent = [line for line in log() if line["method"] == "POST" and line["route"] != "/sign-in"]
    own, other, organiser = teams
    assert [tuple(line.get(name) for name in WHO) for line in sent] == [
        ("participant, token", OPEN, own, submission, "ok"),
        ("participant, token", OPEN, own, submission, "ok"),
        ("participant, token", OPEN, own, None, "submission-rejected"),
        ("participant, token", PRIVATE, own, None, "submission-rejected"),
        ("anonymous", OPEN, None, None, "not-signed-in"),
        ("participant, token", None, other, None, "not-found"),
        ("participant, session", OPEN, own, submission, "ok"),
        ("participant, session", OPEN, own, None, "ok"),
        ("organiser, session", OPEN, organiser, submission, "ok"),
    ]
    names = (OWNER, MATE, OTHER, ORGANISER, "Blue", "Red", "Walker")
    assert not [name for name in names if f'"{name}"' in json.dumps(sent)]


@pytest.mark.parametrize(
    ("asks", "status", "outcome", "route"),
    [
        ("GET /me", 200, "ok", "/api/v1/me"),
        ("HEAD /me", 200, "ok", "/api/v1/me"),
        ("GET /splits/none", 404, "not-found", "/api/v1/splits/{split}"),
        ("GET /no/such", 404, "not-found", "unmatched"),
        ("BREW /me", 405, "method-not-allowed", "/api/v1/me"),
        ("GET /splits/test/leaderboard?metric=x", 400, "malformed-request", None),
        ("POST /tokens", 400, "malformed-request", "/api/v1/tokens"),
    ],
)
def test_a_line_names_what_it_came_to(
    *,
    asks: str,
    status: int,
    outcome: str,
    route: str | None,
    server: Serving,
    log: Callable[..., list[dict[str, Any]]],
) -> None:
    method, path = asks.split(" ")
    server.ask(OWNER, method, path)
    (line,) = log()
    assert (line["status"], line["outcome"]) == (status, outcome)
    assert line["route"] == (route or "/api/v1/splits/{split}/leaderboard")
    assert line["method"] == ("other" if method == "BREW" else method)


def test_every_route_is_logged_by_its_whole_path(
    server: Serving, log: Callable[..., list[dict[str, Any]]]
) -> None:
    app = create_app(server.state)
    routes = [
        (method, route.path or "")
        for route in iter_route_contexts(app.routes)
        for method in sorted(route.methods or ())
    ]
    assert {"/splits/{split}/chart", "/api/v1/join", "/desk/people"} <= {path for _, path in routes}
    for method, path in routes:
        server.client.request(method, re.sub(r"\{\w+\}", "1", path))
    assert [(line["method"], line["route"]) for line in log()] == routes
    assert not any(isinstance(route, Mount) and route.path != STATIC for route in app.routes)


@pytest.mark.parametrize(
    ("path", "status", "route"),
    [
        pytest.param("/splits/test", 200, "/splits/{split}", id="a leaderboard"),
        pytest.param("/splits/test/latex", 200, "/splits/{split}/latex", id="its table"),
        pytest.param("/splits/test/feed.atom", 200, "/splits/{split}/feed.atom", id="its feed"),
        pytest.param("/feed.atom", 200, "/feed.atom", id="the feed of all"),
        pytest.param("/static/board.js", 200, "/static", id="a static file"),
        pytest.param("/static/none.js", 404, "/static", id="no such static file"),
        pytest.param("/staticboard.js", 404, "unmatched", id="no such page"),
    ],
)
def test_pages_are_logged_and_counted_by_their_routes(
    *,
    path: str,
    status: int,
    route: str,
    server: Serving,
    log: Callable[..., list[dict[str, Any]]],
) -> None:
    assert server.client.get(path).status_code == status
    (line,) = log()
    assert (line["status"], line["route"]) == (status, route)
    counted = metrics_of(server)["reverie_eval_requests_total", "GET", route, str(status)]
    assert counted == 1


def test_a_line_quotes_nothing_that_was_sent(
    server: Serving, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    server.upload(OWNER, BROKEN, name="my-own-name", key="my-own-key")
    server.ask(None, "GET", "/me", headers={"Authorization": "Bearer hunter2"})
    server.ask(None, "GET", "/me", headers={"Authorization": f"Bearer rv_{'x' * 43}"})
    server.ask(None, "GET", f"/splits/my-own-name?{server.tokens[OWNER]}")
    server.client.post("/sign-in", data={"token": server.tokens[OWNER]})
    written = "\n".join(
        JsonLines().format(record)
        for record in caplog.records
        if record.name.startswith(("reverie_eval", "uvicorn"))
    )
    trajectory = json.loads(GOOD)[0]["instr_id"]
    for sent in (server.tokens[OWNER], "my-own", "hunter2", "xxx", trajectory):
        assert sent not in written


def test_who_tries_tokens_leaves_an_address(
    server: Serving, log: Callable[..., list[dict[str, Any]]]
) -> None:
    server.ask(None, "GET", "/me", headers={"Authorization": "Bearer rv_wrong"})
    server.ask(OWNER, "GET", "/me")
    assert [(line.get("address"), "token" in line) for line in log()] == [
        ("127.0.0.1", False),
        (None, True),
    ]


@pytest.mark.parametrize(
    ("error", "said"),
    [
        pytest.param(RuntimeError(f"the target is {SECRET}"), "", id="anything"),
        pytest.param(OSError(5, "Input/output error"), "output error", id="the system's"),
    ],
)
def test_the_organiser_finds_a_fault_by_its_id(
    error: Exception,
    said: str,
    server: Serving,
    log: Callable[..., list[dict[str, Any]]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def break_down(*_: object) -> None:
        raise error

    monkeypatch.setattr(Board, "score", break_down)
    reply = server.upload(OWNER, submission_for(PRIVATE), PRIVATE)
    told = reply.json()
    assert told["code"] == "internal"
    assert told["request_id"] == reply.headers["x-request-id"]
    assert told["request_id"] in told["detail"]
    (fault,) = log("reverie_eval.server")
    assert fault["id"] == told["request_id"]
    assert "break_down" in fault["fault"][-1]["frames"][-1]
    assert said in fault["fault"][-1]["said"]
    assert SECRET not in json.dumps(fault) + reply.text
    (line,) = log()
    assert (line["status"], line["outcome"]) == (500, "internal")


def test_what_led_to_a_fault_is_told_too(caplog: pytest.LogCaptureFixture) -> None:
    fault = ConnectionError("the store is away")
    fault.__cause__ = KeyError(SECRET)
    logging.getLogger(REQUESTS).error("line one\nline two", exc_info=fault)
    (line,) = lines_of(caplog)
    assert line["event"] == "line one\nline two"
    assert [(told["kind"], told["said"]) for told in line["fault"]] == [
        ("builtins.KeyError", ""),
        ("builtins.ConnectionError", "the store is away"),
    ]


Samples = Mapping[tuple[str, ...], float]


def metrics_of(server: Serving, who: str | None = ORGANISER) -> Samples:
    """Return the values of ``/metrics`` by name and labels."""
    headers = {"Authorization": f"Bearer {server.tokens[who]}"} if who else {}
    reply = server.client.get("/metrics", headers=headers)
    assert reply.status_code == 200, reply.text
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(reply.text)
        for sample in family.samples
    }


def test_metrics_count_what_was_answered(server: Serving) -> None:
    server.upload(OWNER)
    server.upload(OWNER)
    server.upload(OWNER, BROKEN)
    server.upload(OTHER, submission_for(PRIVATE), PRIVATE)
    server.upload(OTHER, split="none-of-ours")
    server.ask(None, "GET", "/no-such/path")
    samples = metrics_of(server)
    assert uploads_of(samples) == {
        ("scored", OPEN): 1,
        ("repeated", OPEN): 1,
        ("submission-rejected", OPEN): 1,
        ("scored", PRIVATE): 1,
        ("not-found", "unknown"): 1,
    }
    assert samples["reverie_eval_requests_total", "POST", SUBMIT, "201"] == 2
    assert samples["reverie_eval_requests_total", "GET", "unmatched", "404"] == 1
    assert samples["reverie_eval_request_seconds_count", "POST", SUBMIT] == 5
    assert samples["reverie_eval_request_seconds_sum", "POST", SUBMIT] > 0
    assert samples[("reverie_eval_requests_in_flight",)] == 1
    assert samples[("reverie_eval_uploads_waiting",)] == 0


def uploads_of(samples: Samples) -> Samples:
    """Return how many uploads there were, by what they came to and their split."""
    name = "reverie_eval_uploads_total"
    return {labels[1:]: count for labels, count in samples.items() if labels[0] == name}


def test_metrics_count_what_was_uploaded_with_a_form(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner = signed_in(server, OWNER)
    owner.upload(GOOD)
    owner.upload(GOOD)
    owner.upload(BROKEN)
    owner.upload(GOOD, "check")
    owner.upload(BROKEN, "check")
    owner.upload(GOOD, split="none-of-ours")
    owner.upload(b" " * (33 << 20))
    monkeypatch.setattr(Board, "score", fail)
    owner.upload(server.distinct())
    assert uploads_of(metrics_of(server)) == {
        ("scored", OPEN): 1,
        ("repeated", OPEN): 1,
        ("submission-rejected", OPEN): 1,
        ("not-found", "unknown"): 1,
        ("too-large", "unknown"): 1,
        ("internal", OPEN): 1,
    }


def test_metrics_tell_of_nobody(server: Serving) -> None:
    server.upload(OWNER, submission_for(PRIVATE), PRIVATE)
    headers = {"Authorization": f"Bearer {server.tokens[ORGANISER]}"}
    text = server.client.get("/metrics", headers=headers).text
    for name in (*server.tokens, "Blue", "Red", "rv_"):
        assert name not in text


def test_applications_in_one_process_count_for_themselves(server: Serving) -> None:
    other = RuntimeState.of(server.state, jobs_of(server.state))
    server.ask(OWNER, "GET", "/me")
    assert ("reverie_eval_requests_total", "GET", "/api/v1/me", "200") in metrics_of(server)
    assert b"/api/v1/me" not in other.metrics.text()
