"""Many uploads at once: what is decided on a quota and on repeats holds whoever comes first."""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

import httpx
import pytest
from sqlalchemy import select

from reverie_eval.receipts import verify
from reverie_eval.schemas.service import Envelope
from reverie_eval.server.audit.log import AuditLog, entries
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Submission
from tests.support.participants import RealServer
from tests.support.serving import MATE, OPEN, OWNER, PRIVATE, Serving, submission_for
from tests.support.signing import receipt_in
from tests.support.waiting import PATIENCE

MANY = 50
ALLOWED = 2
"""By default, in a day, on the private split."""


def at_once(send: Callable[[int], httpx.Response]) -> Sequence[httpx.Response]:
    """Send many requests, none before all are ready to go."""
    ready = Barrier(MANY)

    def go(number: int) -> httpx.Response:
        ready.wait()
        return send(number)

    with ThreadPoolExecutor(MANY) as pool:
        return list(pool.map(go, range(MANY)))


def statuses(replies: Sequence[httpx.Response]) -> dict[int, int]:
    return dict(Counter(reply.status_code for reply in replies))


def receipts(replies: Sequence[httpx.Response]) -> list[Any]:
    scored = (reply.json() for reply in replies if reply.status_code in {200, 201})
    return [accepted["submission"]["receipt"] for accepted in scored]


def kept(database: Database, audit_log: AuditLog, team: str) -> Sequence[str]:
    """Return a team's submissions, and see that each is in the audit log, which is whole."""
    with database.reading() as session:
        rows = [row.id for row in session.scalars(select(Submission)) if row.team.name == team]
        submitted = {each.subject for each in entries(session) if each.action == "submitted"}
        assert submitted >= set(rows)
        assert not list(audit_log.broken_links(session))
    return rows


@pytest.mark.parametrize("senders", [(OWNER,), (OWNER, MATE)], ids=["a person", "a team"])
def test_of_many_files_as_many_are_scored_as_the_quota_allows(
    server_on: Serving, senders: Sequence[str]
) -> None:
    files = [server_on.distinct(PRIVATE) for _ in range(MANY)]

    def send(number: int) -> httpx.Response:
        return server_on.upload(senders[number % len(senders)], files[number], PRIVATE)

    replies = at_once(send)
    assert statuses(replies) == {201: ALLOWED, 429: MANY - ALLOWED}
    for each in receipts(replies):
        verify(Envelope.model_validate(each), server_on.state.signer.public_pem)
    signed = [receipt_in(each) for each in receipts(replies)]
    assert sorted(receipt.quota.remaining for receipt in signed) == [0, 1]
    assert set(kept(server_on.state.database, server_on.state.audit_log, "Blue")) == {
        each.submission_id for each in signed
    }


@pytest.mark.parametrize("with_key", [False, True], ids=["the same file", "the same key"])
def test_of_the_same_upload_many_times_one_is_scored(server_on: Serving, *, with_key: bool) -> None:
    content, key = submission_for(PRIVATE), "one-and-the-same" if with_key else None
    replies = at_once(lambda _: server_on.upload(OWNER, content, PRIVATE, key=key))
    assert statuses(replies) == {201: 1, 200: MANY - 1}
    first, *others = receipts(replies)
    assert all(receipt == first for receipt in others)
    assert kept(server_on.state.database, server_on.state.audit_log, "Blue") == [
        receipt_in(first).submission_id
    ]
    assert {reply.json()["quota"]["remaining"] for reply in replies} == {ALLOWED - 1}


def test_of_one_key_with_many_files_one_is_scored(server_on: Serving) -> None:
    files = [server_on.distinct(OPEN) for _ in range(MANY)]
    replies = at_once(lambda number: server_on.upload(OWNER, files[number], key="mine"))
    assert statuses(replies) == {201: 1, 409: MANY - 1}
    assert len(kept(server_on.state.database, server_on.state.audit_log, "Blue")) == 1


def test_teams_do_not_take_each_others_turns(server_on: Serving) -> None:
    content = submission_for(PRIVATE)

    def send(number: int) -> httpx.Response:
        who = ("Ada", "Carl", "Olga")[number % 3]
        return server_on.upload(who, content, PRIVATE)

    assert statuses(at_once(send)) == {201: 3, 200: MANY - 3}


def test_a_real_process_scores_as_many_as_the_quota_allows(real_server: RealServer) -> None:
    name = real_server.newcomer()
    headers = {"Authorization": f"Bearer {real_server.mint(name)}"}
    content = submission_for(PRIVATE)
    address = f"{real_server.url}/api/v1/splits/{PRIVATE}/submissions?name=Walker"
    limits = httpx.Limits(max_connections=MANY)
    with httpx.Client(headers=headers, limits=limits, timeout=PATIENCE) as client:
        replies = at_once(lambda n: client.post(address, content=content + b" " * n))
        assert statuses(replies) == {201: ALLOWED, 429: MANY - ALLOWED}
        again = at_once(lambda _: client.post(address, content=content))
    assert len(kept(real_server.database, real_server.audit_log, f"Team of {name}")) == ALLOWED
    is_first_scored = any(reply.status_code == 201 for reply in replies[:1])
    assert statuses(again) == {200 if is_first_scored else 429: MANY}
