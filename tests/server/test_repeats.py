"""Repeats: the same file, or the same Idempotency-Key, gets the earlier receipt, come what may."""

from pathlib import Path
from typing import Any

import pytest

from reverie_eval.ground_truth import Bundle
from tests.support.serving import (
    BROKEN,
    GOOD,
    MATE,
    OPEN,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
)
from tests.support.signing import receipt_in
from tests.support.worlds import with_arrays


def accepted(server: Serving, content: bytes, split: str = OPEN, **said: str) -> dict[str, Any]:
    reply = server.upload(OWNER, content, split, **said)
    assert reply.status_code == 201, reply.text
    submission: dict[str, Any] = reply.json()["submission"]
    return submission


@pytest.mark.parametrize(
    ("first_key", "second_key"),
    [(None, None), ("a", "a"), ("a", "b"), ("a", None), (None, "a")],
)
def test_the_same_file_gets_the_earlier_receipt(
    server: Serving, first_key: str | None, second_key: str | None
) -> None:
    first = server.upload(OWNER, key=first_key)
    second = server.upload(OWNER, key=second_key)
    assert (first.status_code, second.status_code) == (201, 200)
    assert second.json()["submission"] == first.json()["submission"]
    assert len(server.ask(OWNER, "GET", "/submissions").json()) == 1


def test_a_team_mates_file_too(server: Serving) -> None:
    first = accepted(server, GOOD)
    again = server.upload(MATE)
    assert (again.status_code, again.json()["submission"]) == (200, first)


def test_another_teams_file_is_a_submission_of_its_own(server: Serving) -> None:
    first = accepted(server, GOOD)
    other = server.upload(OTHER)
    assert other.status_code == 201
    assert other.json()["submission"]["id"] != first["id"]


def test_what_is_said_of_the_method_does_not_make_it_another(server: Serving) -> None:
    first = accepted(server, GOOD, name="Walker")
    again = server.upload(OWNER, GOOD, name="Runner")
    assert again.json()["submission"] == first


def test_a_key_is_a_persons(server: Serving) -> None:
    server.upload(OWNER, key="a")
    mates = server.upload(MATE, server.distinct(), key="a")
    others = server.upload(OTHER, server.distinct(), key="a")
    assert (mates.status_code, others.status_code) == (201, 201)


@pytest.mark.parametrize("split", [OPEN, PRIVATE])
def test_a_key_is_of_one_file_and_split(server: Serving, split: str) -> None:
    server.upload(OWNER, key="a")
    reply = server.upload(OWNER, server.distinct(split), split, key="a")
    assert (reply.status_code, reply.json()["code"]) == (409, "conflict")
    assert reply.json()["detail"] == (
        "the Idempotency-Key 'a' was used for another file or split; use a new one for each "
        "submission"
    )
    assert len(server.ask(OWNER, "GET", "/submissions").json()) == 1


def test_a_key_does_not_bring_a_file_to_another_split(server: Serving) -> None:
    server.upload(OWNER, GOOD, key="a")
    assert server.upload(OWNER, GOOD, PRIVATE, key="a").status_code == 409


def test_a_key_of_a_rejected_file_may_be_used_again(server: Serving) -> None:
    assert server.upload(OWNER, BROKEN, key="a").status_code == 422
    assert server.upload(OWNER, GOOD, key="a").status_code == 201


def test_it_does_when_the_quota_is_spent(server: Serving) -> None:
    files = [server.distinct(PRIVATE) for _ in range(3)]
    first = accepted(server, files[0], PRIVATE)
    accepted(server, files[1], PRIVATE)
    assert server.upload(OWNER, files[2], PRIVATE).status_code == 429
    again = server.upload(OWNER, files[0], PRIVATE)
    assert (again.status_code, again.json()["submission"]) == (200, first)
    assert again.json()["quota"]["remaining"] == 0


def test_it_does_when_it_was_withdrawn(server: Serving) -> None:
    first = accepted(server, GOOD)
    server.ask(OWNER, "PATCH", f"/submissions/{first['id']}", json={"withdrawn": True})
    again = server.upload(OWNER)
    assert (again.status_code, again.json()["submission"]["status"]) == (200, "withdrawn")
    assert again.json()["submission"]["receipt"] == first["receipt"]


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"protocol": "r2r-style"}, id="another protocol"),
        pytest.param({"bundle": "bundles/changed.npz"}, id="other ground truth"),
        pytest.param({"phases": ()}, id="closed"),
    ],
)
def test_it_does_when_the_server_has_changed(
    server: Serving, changes: dict[str, Any], folder: Path, open_server: OpenServer
) -> None:
    first = accepted(server, GOOD)
    bundle = Bundle.load(folder / "bundles" / f"{OPEN}.npz")
    other = with_arrays(bundle, task_target=bundle.arrays["task_target"] + 1)
    other.save(folder / "bundles" / "changed.npz")
    later = open_server(adjusted(settings_of(folder), OPEN, **changes), server.tokens)
    again = later.upload(OWNER)
    assert (again.status_code, again.json()["submission"]) == (200, first)
    assert f"|data:{first['report']['fingerprint'][:8]}" in receipt_in(first["receipt"]).signature
    table = later.ask(OWNER, "GET", f"/submissions/{first['id']}/episodes")
    assert table.status_code == (200 if changes == {"phases": ()} else 404)
