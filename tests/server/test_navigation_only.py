"""A file without answers costs no submission unless its team says that it is meant."""

import json

import pytest

from tests.conftest import SAMPLES
from tests.support.serving import OPEN, OWNER, Serving

GOOD = (SAMPLES / "good.json").read_bytes()
SILENT = json.dumps(
    [{key: record[key] for key in ("instr_id", "trajectory")} for record in json.loads(GOOD)]
).encode()


def left(server: Serving) -> int:
    """Return the submissions left on the open split."""
    remaining: int = server.ask(OWNER, "GET", f"/splits/{OPEN}").json()["quota"]["remaining"]
    return remaining


@pytest.mark.parametrize(
    ("content", "fields", "message"),
    [
        pytest.param(
            SILENT,
            {},
            "no record has an answer; if the agent only navigates, declare it: --navigation-only "
            'on the command line, navigation_only in the API, or "Navigation only" on the page',
            id="undeclared",
        ),
        pytest.param(
            SILENT,
            {"navigation_only": "false"},
            "no record has an answer; if the agent only navigates, declare it: --navigation-only "
            'on the command line, navigation_only in the API, or "Navigation only" on the page',
            id="declared not to be so, without answers",
        ),
        pytest.param(
            GOOD,
            {"navigation_only": "true"},
            "has answers, but the method is declared navigation only; remove that declaration",
            id="declared, with answers",
        ),
    ],
)
def test_what_is_not_as_declared_costs_nothing(
    content: bytes, fields: dict[str, str], message: str, server: Serving
) -> None:
    before = left(server)
    reply = server.upload(OWNER, content, **fields)
    assert reply.status_code == 422
    (problem,) = reply.json()["problems"]
    assert (problem["code"], problem["where"]) == ("navigation-only", "file")
    assert problem["message"] == message
    assert left(server) == before


def test_what_is_declared_is_scored_without_answers(server: Serving) -> None:
    accepted = server.upload(OWNER, SILENT, navigation_only="true").json()["submission"]
    assert accepted["report"]["scores"]["success"] > 0.8
    assert "rgs" not in accepted["report"]["scores"]
    assert accepted["method"]["navigation_only"]


def test_the_same_file_again_need_not_be_declared_again(server: Serving) -> None:
    first = server.upload(OWNER, SILENT, navigation_only="true")
    again = server.upload(OWNER, SILENT)
    assert (first.status_code, again.status_code) == (201, 200)
    assert again.json()["submission"]["id"] == first.json()["submission"]["id"]


@pytest.mark.parametrize(
    ("content", "sent", "change", "status"),
    [
        pytest.param(SILENT, "true", False, 409, id="without answers, declared not to be so"),
        pytest.param(SILENT, "true", None, 409, id="without answers, no longer declared"),
        pytest.param(GOOD, "", True, 409, id="with answers, declared to be so"),
        pytest.param(GOOD, "", False, 200, id="with answers, declared not to be so"),
        pytest.param(GOOD, "false", None, 200, id="with answers, no longer declared"),
    ],
)
def test_it_follows_from_the_file(
    content: bytes, sent: str, status: int, server: Serving, *, change: bool | None
) -> None:
    submission = server.upload(OWNER, content, navigation_only=sent).json()["submission"]
    body = {"method": {"navigation_only": change}}
    reply = server.ask(OWNER, "PATCH", f"/submissions/{submission['id']}", json=body)
    assert reply.status_code == status
    assert status != 200 or reply.json()["method"]["navigation_only"] is change


def test_it_cannot_be_changed(server: Serving) -> None:
    submission = server.upload(OWNER, SILENT, navigation_only="true").json()["submission"]
    path = f"/submissions/{submission['id']}"
    kept = server.ask(OWNER, "PATCH", path, json={"method": {"ensemble": True}}).json()["method"]
    assert (kept["navigation_only"], kept["ensemble"]) == (True, True)


def test_it_is_on_the_leaderboard_without_a_rank_by_answers(server: Serving) -> None:
    for content, fields in ((SILENT, {"navigation_only": "true"}), (GOOD, {})):
        submission = server.upload(OWNER, content, **fields).json()["submission"]
        server.ask(OWNER, "PATCH", f"/submissions/{submission['id']}", json={"published": True})
    ranks = {
        metric: {
            (row["rank"], row["method"]["navigation_only"])
            for row in server.ask(
                None, "GET", f"/splits/{OPEN}/leaderboard", params={"metric": metric}
            ).json()["rows"]
        }
        for metric in ("rgspl", "spl")
    }
    assert ranks == {"rgspl": {(1, None), (None, True)}, "spl": {(1, True), (1, None)}}


def test_checking_it_is_free_and_tells(server: Serving) -> None:
    reply = server.ask(OWNER, "POST", f"/splits/{OPEN}/validate", content=SILENT)
    assert reply.json()["valid"]
    assert "read as: 84 records, none with an answer: navigation only" in reply.json()["notes"]
