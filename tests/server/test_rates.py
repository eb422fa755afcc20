"""How often one may ask, and whose address it is that asks."""

from collections.abc import Callable
from ipaddress import ip_network
from pathlib import Path
from typing import Any

import httpx
import pytest

from reverie_eval.server.boards.schedules import View
from reverie_eval.server.http.callers import COOKIE
from reverie_eval.server.http.middleware import FAILED_COST, site_of
from reverie_eval.server.intake.submissions import list_submissions
from reverie_eval.server.settings import Limits
from reverie_eval.server.state import Reading
from reverie_eval.server.store.paging import Page
from tests.support.serving import GOOD, OPEN, OTHER, OWNER, OpenServer, Serving, settings_of

PER_MINUTE = 30
PROXY = "127.0.0.1"
"""From where all requests of these tests come."""


pytestmark = pytest.mark.usefixtures("within_a_minute")


@pytest.fixture
def limited(folder: Path, open_server: OpenServer) -> Callable[..., Serving]:
    """Return what opens a server that answers few requests, and believes these proxies."""

    def open_limited(*proxies: str) -> Serving:
        changes = {
            "limits": Limits(requests_per_minute=PER_MINUTE),
            "trusted_proxies": tuple(ip_network(proxy) for proxy in proxies),
        }
        return open_server(settings_of(folder).model_copy(update=changes))

    return open_limited


def me(server: Serving, who: str | None, address: str | None = None) -> httpx.Response:
    """Ask who one is, as from an address."""
    headers = {"X-Forwarded-For": address} if address else {}
    return server.ask(who, "GET", "/me", headers=headers)


def test_one_address_has_so_many_requests(limited: Callable[..., Serving]) -> None:
    server = limited()
    replies = [server.ask(None, "GET", "/splits") for _ in range(PER_MINUTE + 1)]
    assert [reply.status_code for reply in replies] == [200] * PER_MINUTE + [429]
    refused = replies[-1]
    assert refused.json()["code"] == "too-many-requests"
    assert 1 <= int(refused.headers["retry-after"]) <= 60
    assert refused.headers["x-request-id"]
    assert refused.headers["cache-control"] == "no-store"


def test_one_token_has_so_many_requests_from_all_addresses(
    limited: Callable[..., Serving],
) -> None:
    server = limited(PROXY)
    statuses = [me(server, OWNER, f"192.0.2.{n}").status_code for n in range(PER_MINUTE + 1)]
    assert statuses == [200] * PER_MINUTE + [429]
    assert me(server, OTHER, "192.0.2.99").status_code == 200


def test_one_token_is_one_however_it_is_written(limited: Callable[..., Serving]) -> None:
    server = limited(PROXY)
    schemes = ("Bearer ", "bearer ", "BEARER ", "Bearer   ")
    for n in range(PER_MINUTE):
        shown = schemes[n % len(schemes)] + server.tokens[OWNER]
        headers = {"Authorization": shown, "X-Forwarded-For": f"192.0.2.{n}"}
        assert server.ask(None, "GET", "/me", headers=headers).status_code == 200
    assert me(server, OWNER, "192.0.2.99").status_code == 429


def test_one_browser_session_has_so_many_requests_however_its_cookie_is_written(
    limited: Callable[..., Serving],
) -> None:
    server = limited(PROXY)
    ada, carl = (sign_in(server, who) for who in (OWNER, OTHER))

    def status(cookie: str, n: int) -> int:
        headers = {"Cookie": f"{COOKIE}={cookie}", "X-Forwarded-For": f"192.0.2.{n}"}
        return server.ask(None, "GET", "/me", headers=headers).status_code

    spellings = (ada, f"{ada}=", f"{ada}====")
    statuses = [status(spellings[n % 3], n) for n in range(PER_MINUTE + 1)]
    assert statuses == [200] * PER_MINUTE + [429]
    assert status(carl, 99) == 200


def sign_in(server: Serving, who: str) -> str:
    """Begin a session of somebody's and return its cookie."""
    reply = server.client.post("/sign-in", data={"token": server.tokens[who]})
    server.client.cookies.clear()
    return reply.cookies[COOKIE]


def test_wrong_tokens_throttle_wrong_tokens_alone(limited: Callable[..., Serving]) -> None:
    server = limited()
    wrong = [
        server.ask(None, "GET", "/me", headers={"Authorization": f"Bearer rv_{n}"}).status_code
        for n in range(PER_MINUTE // FAILED_COST + 1)
    ]
    assert wrong == [401] * (PER_MINUTE // FAILED_COST) + [429]
    assert me(server, OWNER).status_code == 200
    assert server.client.post("/sign-in", data={"token": server.tokens[OWNER]}).is_redirect
    server.client.cookies.clear()
    assert server.ask(None, "GET", f"/splits/{OPEN}/leaderboard").status_code == 200


def test_a_stale_token_locks_out_nobody_else(limited: Callable[..., Serving]) -> None:
    server = limited()
    stale = {"Authorization": "Bearer rv_stale"}
    statuses = [
        server.ask(None, "GET", "/me", headers=stale).status_code for _ in range(3 * PER_MINUTE)
    ]
    assert statuses == [401] * 3 + [429] * (3 * PER_MINUTE - 3)
    assert me(server, OWNER).status_code == 200
    assert server.ask(None, "GET", f"/splits/{OPEN}/leaderboard").status_code == 200


def test_who_is_throttled_is_told_until_when(limited: Callable[..., Serving]) -> None:
    server = limited()
    shown = [{"Authorization": f"Bearer rv_{number}"} for number in range(4)]
    *_, reply = [server.ask(None, "GET", "/me", headers=headers) for headers in shown]
    assert reply.json()["code"] == "too-many-requests"
    assert 1 <= int(reply.headers["retry-after"]) <= 60
    assert "www-authenticate" not in reply.headers


@pytest.mark.parametrize(
    ("path", "body"),
    [
        pytest.param("/api/v1/tokens", {"json": {"invitation": "rv_wrong"}}, id="invitations"),
        pytest.param("/sign-in", {"data": {"token": "rv_wrong"}}, id="signing in"),
    ],
)
def test_so_does_trying_by_other_ways(
    path: str, body: dict[str, Any], limited: Callable[..., Serving]
) -> None:
    server = limited()
    statuses = [server.client.post(path, **body).status_code for _ in range(4)]
    assert statuses == [401, 401, 401, 429]


def test_to_come_without_a_token_is_no_attempt(limited: Callable[..., Serving]) -> None:
    server = limited()
    statuses = {me(server, None).status_code for _ in range(PER_MINUTE)}
    assert statuses == {401}


def test_who_is_sent_away_is_not_even_read(limited: Callable[..., Serving]) -> None:
    server = limited()
    for _ in range(PER_MINUTE):
        me(server, OWNER)
    assert server.upload(OWNER).status_code == 429
    with server.state.database.reading() as session:
        view = View.of(Reading(server.state, session, server.clock()))
        assert list_submissions(session, server.person(OWNER), Page(), view).rows == []


def test_health_may_be_asked_always(limited: Callable[..., Serving]) -> None:
    server = limited()
    asked = [server.client.get("/healthz").status_code for _ in range(2 * PER_MINUTE)]
    assert set(asked) == {200}


def test_metrics_may_be_asked_for_so_often(limited: Callable[..., Serving]) -> None:
    server = limited()
    asked = [server.client.get("/metrics").status_code for _ in range(PER_MINUTE + 1)]
    assert asked == [401] * PER_MINUTE + [429]


@pytest.mark.parametrize(
    ("proxies", "forwarded", "is_believed"),
    [
        pytest.param((), "192.0.2.{}", False, id="nobody is trusted"),
        pytest.param(("10.0.0.0/8",), "192.0.2.{}", False, id="another is trusted"),
        pytest.param((PROXY,), "192.0.2.{}", True, id="the proxy is trusted"),
        pytest.param(("127.0.0.0/8", "10.0.0.0/8"), "192.0.2.{}, 10.1.1.1", True, id="two proxies"),
        pytest.param((PROXY,), "192.0.2.{}, 198.51.100.7", False, id="what a client has made up"),
    ],
)
def test_the_address_is_what_a_trusted_proxy_says(
    proxies: tuple[str, ...],
    forwarded: str,
    is_believed: bool,  # noqa: FBT001  # a column of the table
    limited: Callable[..., Serving],
) -> None:
    server = limited(*proxies)
    replies = [me(server, None, forwarded.format(n)) for n in range(PER_MINUTE + 1)]
    assert replies[-1].status_code == (401 if is_believed else 429)


@pytest.mark.parametrize(
    ("address", "site"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2:ffff::", "2001:db8:1:2::/64"),
        ("2001:db8:1:3::", "2001:db8:1:3::/64"),
        ("unknown", "unknown"),
    ],
)
def test_of_ipv6_a_customer_s_network_counts(address: str, site: str) -> None:
    assert site_of(address) == site


def test_an_upload_counts_once(limited: Callable[..., Serving]) -> None:
    server = limited()
    statuses = [server.upload(OWNER, GOOD, OPEN).status_code for _ in range(PER_MINUTE + 1)]
    assert statuses == [201] + [200] * (PER_MINUTE - 1) + [429]
