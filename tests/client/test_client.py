"""The client: whatever the network does, a submission is scored once and counted once."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import httpx
import pytest

from reverie_eval import SubmissionError
from reverie_eval import client as client_package
from reverie_eval.client import (
    Client,
    NotAServerError,
    QuotaSpentError,
    RefusedError,
    ServiceError,
    UnreachableError,
    sending,
)
from reverie_eval.client.sending import server_url
from reverie_eval.receipts import verify
from reverie_eval.schemas.service import Method, SubmissionChange
from tests.support.participants import (
    Fault,
    Proxy,
    RealServer,
    Script,
    answer,
    problem,
)
from tests.support.serving import BROKEN, GOOD, NO_TLS, PRIVATE, submission_for
from tests.support.waiting import PATIENCE

OURS = Method(name="Ours", description="Two lines\nof it & more = better? 漢", ensemble=True)
GATEWAY = answer("502 Bad Gateway", b"<html>bad gateway</html>")
BUSY = problem("503 Service Unavailable", "stopping", "the server is stopping", "Retry-After: 3")


@pytest.fixture(autouse=True)
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Wait for nothing, and return how long would have been waited."""
    waited: list[float] = []
    monkeypatch.setattr(sending, "sleep", waited.append)
    return waited


@contextmanager
def somebody_at(server: RealServer, *faults: Fault) -> Iterator[tuple[Client, Proxy]]:
    """Connect somebody new through a network that fails."""
    token = server.mint(server.newcomer())
    with Proxy(server.url, *faults) as proxy, Client(proxy.url, token) as client:
        assert client.me().role == "participant"
        yield client, proxy


def quota_of(client: Client) -> int:
    (left,) = [split.quota for split in client.splits() if split.name == "test"]
    assert left is not None
    return left.remaining


def stored_of(server: RealServer, client: Client) -> list[str]:
    """Return what a client's team has on the server, asked without the client."""
    headers = {"Authorization": client._sender._http.headers["Authorization"]}  # noqa: SLF001
    url = f"{server.url}/api/v1/submissions"
    reply = httpx.get(url, headers=headers, timeout=PATIENCE, verify=NO_TLS)
    assert reply.is_success
    found = reply.json()
    rows = found if isinstance(found, list) else found["submissions"]
    return [row["id"] for row in rows]


def test_submissions_are_fetched_page_by_page(
    real_server: RealServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("reverie_eval.client._client._PAGE", 2)
    with Client(real_server.url, real_server.mint(real_server.newcomer())) as client:
        sent = [
            client.submit(split, file, Method(name="Ours")).submission.id
            for split, file in (
                ("test", submission_for(PRIVATE, seed=0)),
                ("test", submission_for(PRIVATE, seed=1)),
                ("val_unseen", GOOD),
            )
        ]
        assert [each.id for each in client.submissions()] == sent[::-1]


def test_the_names_of_the_package() -> None:
    assert client_package.__all__ == [
        "Client",
        "Method",
        "NotAServerError",
        "QuotaSpentError",
        "RefusedError",
        "ServiceError",
        "SubmissionChange",
        "UnreachableError",
    ]


# What goes wrong on the way.


@pytest.mark.parametrize(
    ("faults", "repeat"),
    [
        pytest.param([], False, id="nothing"),
        pytest.param(["before"], False, id="dropped before it arrives"),
        pytest.param(["upload"], False, id="dropped in the middle of the upload"),
        pytest.param(["reply"], True, id="reply lost after it was kept"),
        pytest.param(["half the reply"], True, id="half of the reply lost"),
        pytest.param([GATEWAY], False, id="gateway without a server"),
        pytest.param([BUSY], False, id="server stopping"),
        pytest.param(["upload", GATEWAY, "reply", "before", "reply"], True, id="five in a row"),
    ],
)
def test_a_submission_is_kept_and_counted_once(
    faults: list[Fault], *, repeat: bool, real_server: RealServer
) -> None:
    with somebody_at(real_server, *faults) as (client, proxy):
        accepted = client.submit("test", submission_for(PRIVATE), OURS)
        assert (accepted.is_repeat, accepted.quota.remaining) == (repeat, 1)
        assert stored_of(real_server, client) == [accepted.submission.id]
        assert accepted.submission.method == OURS
        assert len(proxy.uploads) == len(faults) + 1
        again = client.submit("test", submission_for(PRIVATE), OURS)
        assert (again.is_repeat, again.quota.remaining, quota_of(client)) == (True, 1, 1)
        assert again.submission.receipt == accepted.submission.receipt
        verify(again.submission.receipt, client.key())
        verify(again.submission.receipt, client.key().replace("\n", "\r\n"))


def test_what_is_sent_again_is_the_very_same(real_server: RealServer) -> None:
    with somebody_at(real_server, "upload", "before", "reply") as (client, proxy):
        client.submit("test", submission_for(PRIVATE), OURS)
    part, *whole = proxy.uploads
    assert len(set(whole)) == 1
    assert whole[0].startswith(part)
    assert len(part) < len(whole[0])
    assert whole[0].lower().count(b"idempotency-key: ") == 1


def test_each_submission_has_a_key_of_its_own(real_server: RealServer) -> None:
    with somebody_at(real_server) as (client, proxy):
        for seed in (0, 1):
            client.submit("test", submission_for(PRIVATE, seed=seed), OURS)
        keys = {upload.lower().partition(b"idempotency-key: ")[2][:32] for upload in proxy.uploads}
        assert (len(keys), quota_of(client)) == (2, 0)


def test_a_no_is_said_and_silence_is_not(real_server: RealServer) -> None:
    """An organiser may ask for an answer; that none was given is none."""
    with somebody_at(real_server) as (client, proxy):
        client.submit("test", submission_for(PRIVATE), Method(name="Ours", ensemble=False))
    (upload,) = proxy.uploads
    assert b'name="ensemble"\r\n\r\nFalse\r\n' in upload
    assert b"extra_data" not in upload


def test_a_slow_reply_is_asked_for_again(
    real_server: RealServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    with somebody_at(real_server, "late") as (client, _):
        http = client._sender._http  # noqa: SLF001
        patient = http.timeout
        assert patient == sending._TIMEOUT  # noqa: SLF001
        monkeypatch.setattr(sending, "sleep", lambda _: setattr(http, "timeout", patient))
        http.timeout = httpx.Timeout(PATIENCE, read=0.2)
        accepted = client.submit("test", submission_for(PRIVATE), OURS)
        assert (accepted.is_repeat, quota_of(client)) == (True, 1)


def test_a_server_that_says_nothing_is_given_up(
    real_server: RealServer, monkeypatch: pytest.MonkeyPatch, pauses: list[float]
) -> None:
    monkeypatch.setattr(sending, "PATIENCE", 0)
    with somebody_at(real_server, "late") as (client, proxy):
        client._sender._http.timeout = httpx.Timeout(PATIENCE, read=0.2)  # noqa: SLF001
        with pytest.raises(UnreachableError, match="no reply in time"):
            client.submit("test", submission_for(PRIVATE), OURS)
    assert len(proxy.uploads) == 1
    assert pauses == []


def test_a_network_that_stays_away_is_told_of(real_server: RealServer, pauses: list[float]) -> None:
    faults: list[Fault] = ["upload"] * 6
    with (
        somebody_at(real_server, *faults) as (client, proxy),
        pytest.raises(UnreachableError, match=r"dropped.*; send it again: it counts once"),
    ):
        client.submit("test", submission_for(PRIVATE), OURS)
    assert len(proxy.uploads) == 6
    assert pauses == [0.5, 1, 2, 4, 8]
    with somebody_at(real_server) as (client, _):
        assert quota_of(client) == 2


@pytest.mark.parametrize(
    ("reply", "waited"),
    [
        pytest.param(BUSY, [3], id="as long as the server says"),
        pytest.param(GATEWAY, [0.5], id="where it says nothing"),
        pytest.param(answer("503 No", b"", "text/html", "Retry-After: 60"), [60], id="a minute"),
        pytest.param(answer("504 No", b"", "text/html", "Retry-After: soon"), [0.5], id="no time"),
        pytest.param(
            answer("504 No", b"", "text/html", f"Retry-After: 1 Jan {10**30} 00:00:00 GMT"),
            [0.5],
            id="no possible year",
        ),
        pytest.param(
            problem("429 Too Many Requests", "too-many-requests", "slowly", "Retry-After: 7"),
            [7],
            id="too many requests",
        ),
    ],
)
def test_waiting(reply: bytes, waited: list[float], pauses: list[float]) -> None:
    told: list[str] = []
    with Script(reply, answer("200 OK", b"[]", "application/json")) as server:
        with Client(server.url, notice=told.append) as client:
            assert client.splits() == []
        assert pauses == waited
        assert [line.endswith(f"; retrying in {waited[0]:g} s") for line in told] == [True]


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        pytest.param(
            answer("503 No", b"", "text/html", "Retry-After: 61"), UnreachableError, id="long"
        ),
        pytest.param(answer("500 Oh"), UnreachableError, id="fault without a word"),
        pytest.param(problem("500 Oh", "internal", "we failed"), RefusedError, id="fault"),
        pytest.param(problem("429 No", "quota-spent", "none left"), QuotaSpentError, id="quota"),
        pytest.param(problem("409 No", "not-open", "closed"), RefusedError, id="closed"),
        pytest.param(answer("429 No", b"<html>"), NotAServerError, id="somebody else's limit"),
    ],
)
def test_what_is_not_waited_for(
    reply: bytes, error: type[ServiceError], pauses: list[float]
) -> None:
    with Script(reply) as server, Client(server.url) as client, pytest.raises(error):
        client.splits()
    assert (len(server.requests), pauses) == (1, [])


def test_an_invitation_is_never_sent_twice(real_server: RealServer) -> None:
    invitation = real_server.mint(real_server.newcomer(), "invite")
    with Script(GATEWAY) as server, Client(server.url) as client:
        with pytest.raises(UnreachableError, match="ask the organiser for another"):
            client.accept(invitation)
        assert len(server.requests) == 1


def test_a_server_that_was_never_reached_is_not_waited_for(pauses: list[float]) -> None:
    with Script(b"") as server:
        gone = server.url
    with (
        Client(gone) as client,
        pytest.raises(UnreachableError, match="connection refused; no server"),
    ):
        client.splits()
    assert pauses == []


# What a notebook does.


def test_a_file_of_any_kind_can_be_sent(real_server: RealServer, tmp_path: Path) -> None:
    file = tmp_path / "submit.json"
    file.write_bytes(submission_for(PRIVATE))
    with somebody_at(real_server) as (client, _):
        assert client.validate("test", file).valid
        sent: list[tuple[int, int]] = []
        accepted = client.submit("test", file, OURS, lambda *done: sent.append(done))
        with file.open("rb") as opened:
            assert client.submit("test", opened, OURS).is_repeat
        size = sent[-1][1]
        assert sent == sorted(sent)
        assert sent[-1] == (size, size)
        assert accepted.submission.report.scores["path_length"] > 0


def test_a_submission_is_published_and_renamed(real_server: RealServer) -> None:
    with somebody_at(real_server) as (client, _):
        sent = client.submit("test", submission_for(PRIVATE), OURS).submission
        published = client.change(sent.id, SubmissionChange(published=True))
        assert (published.status, published.method) == ("published", OURS)
        renamed = client.change(sent.id, SubmissionChange(method=Method(name="Theirs")))
        assert (renamed.status, renamed.method.name) == ("published", "Theirs")
        names = {row.submission_id: row.method.name for row in client.leaderboard("test").rows}
        assert names[sent.id] == "Theirs"
        assert sent.id in client.leaderboard_csv("test", "spl")


def test_what_is_wrong_with_a_file_costs_nothing(real_server: RealServer) -> None:
    with somebody_at(real_server) as (client, _):
        found = []
        for ask in (client.validate, partial(client.submit, method=OURS)):
            with pytest.raises(SubmissionError) as caught:
                ask("val_unseen", BROKEN)
            found.append([(p.code, p.where, p.message) for p in caught.value.problems])
        assert found[0] == found[1]
        assert len(found[0]) > 20
        assert stored_of(real_server, client) == []


def test_a_spent_quota_says_when_it_is_not(real_server: RealServer) -> None:
    with somebody_at(real_server) as (client, _):
        for seed in (0, 1):
            client.submit("test", submission_for(PRIVATE, seed=seed), OURS)
        with pytest.raises(QuotaSpentError, match=r"next possible at \d{4}-.* UTC") as spent:
            client.submit("test", submission_for(PRIVATE, seed=2), OURS)
        assert spent.value.document.quota is not None
        assert spent.value.document.quota.remaining == 0


def test_a_newer_server_may_say_more() -> None:
    me = {"person": "Ada", "team": "Blue", "role": "participant", "since": 1843}
    with (
        Script(answer("200 OK", json.dumps(me).encode(), "application/json")) as server,
        Client(server.url) as client,
    ):
        assert client.me().team == "Blue"


# Where servers are.


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("https://x.org", "https://x.org"),
        ("https://x.org/", "https://x.org"),
        (" HTTPS://X.org/reverie/api/v1 ", "https://x.org/reverie"),
        ("http://[::1]:8000?a#b", "http://[::1]:8000"),
    ],
)
def test_a_server_has_one_url(text: str, expected: str) -> None:
    assert server_url(text) == expected


@pytest.mark.parametrize(
    "text", ["", "x.org", "localhost:8000", "ftp://x.org", "https://a:b@x.org"]
)
def test_what_is_no_url(text: str) -> None:
    with pytest.raises(ServiceError, match="write it as https://HOST"):
        Client(text)


@pytest.mark.parametrize(
    ("url", "is_private"),
    [
        ("https://x.org", True),
        ("http://localhost:8000", True),
        ("http://127.1.2.3", True),
        ("http://[::1]", True),
        ("http://0.0.0.0:8000", True),
        ("http://x.org", False),
        ("http://192.168.1.7", False),
        ("http://localhost.example.org", False),
    ],
)
def test_nothing_goes_to_another_machine_unencrypted(url: str, *, is_private: bool) -> None:
    Client(url, plain_http=True).close()
    if is_private:
        Client(url).close()
    else:
        with pytest.raises(ServiceError, match="--plain-http"):
            Client(url)


@pytest.mark.parametrize("token", ["", " ", "rv_\n", "rv_é", "rv_\x1b[2J"])
def test_a_token_that_is_none_is_not_shown(token: str) -> None:
    with pytest.raises(ServiceError) as caught:
        Client("http://localhost", token)
    assert str(caught.value) == "invalid token: a token is one line of letters and digits"


def test_no_proxy_leads_to_this_machine(
    real_server: RealServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Script(b"") as gone:
        monkeypatch.setenv("HTTP_PROXY", gone.url)
    with Client(real_server.url) as client:
        assert client.splits()


@pytest.mark.parametrize(
    ("variable", "value"),
    [("ALL_PROXY", "socks5://127.0.0.1:7890"), ("HTTPS_PROXY", "ham://x"), ("SSL_CERT_FILE", "no")],
)
def test_an_environment_that_cannot_be_used_is_named(
    variable: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, value)
    with pytest.raises(ServiceError, match=f"sets a proxy or certificates .*{variable}"):
        Client("https://x.org")
