"""Browser sessions: what begins them, what ends them, and which requests they count for."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select

from reverie_eval.server.accounts.tokens import revoke_token
from reverie_eval.server.http.callers import COOKIE
from reverie_eval.server.operations.keys import rotate_key
from reverie_eval.server.store.tables import BrowserSession
from tests.support.acting import NOON, create_token
from tests.support.description import Description
from tests.support.serving import GOOD, OPEN, ORGANISER, OWNER, OpenServer, Serving, settings_of

HERE = "http://server"
ELSEWHERE = "https://evil.example"


@dataclass(frozen=True)
class Browser:
    """Somebody's browser, which has signed in."""

    server: Serving
    cookie: str
    csrf_token: str

    def ask(self, method: str, path: str, **content: Any) -> httpx.Response:
        """Send a request as the browser would: with the cookie."""
        headers = {"Cookie": f"{COOKIE}={self.cookie}", **content.pop("headers", {})}
        return self.server.ask(None, method, path, headers=headers, **content)

    def change(self, method: str, path: str, **content: Any) -> httpx.Response:
        """Send a request as our own pages do: with the session's CSRF token too."""
        headers = {"X-CSRF-Token": self.csrf_token, **content.pop("headers", {})}
        return self.ask(method, path, headers=headers, **content)


SignIn = Callable[..., Browser]


def signed_in(server: Serving, token: str) -> Browser:
    reply = server.ask(None, "POST", "/session", json={"token": token})
    assert reply.status_code == 201
    server.client.cookies.clear()  # what a request carries, the tests say
    return Browser(server, reply.cookies[COOKIE], reply.json()["csrf_token"])


@pytest.fixture
def browser(server: Serving) -> Browser:
    """Return the owner's browser."""
    return signed_in(server, server.tokens[OWNER])


@pytest.fixture
def submission(server: Serving) -> str:
    """Return the id of a submission of the owner's."""
    accepted: dict[str, Any] = server.upload(OWNER).json()
    return str(accepted["submission"]["id"])


def created(server: Serving, **lifetime: float) -> tuple[str, str]:
    """Make a token of the owner's with a lifetime; return its text and what shows of it."""
    with server.acting() as transaction:
        made = create_token(transaction, OWNER, "access", NOON + timedelta(**lifetime))
    return made.token, made.hint


@pytest.mark.parametrize(("scheme", "is_secure"), [("http", False), ("https", True)])
def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(
    server: Serving, scheme: str, *, is_secure: bool
) -> None:
    url = f"{scheme}://server/api/v1/session"
    reply = server.client.post(url, json={"token": server.tokens[OWNER]})
    first, *attributes = reply.headers["set-cookie"].lower().split("; ")
    assert first.startswith(COOKIE)
    assert {"httponly", "samesite=strict", "path=/"} < set(attributes)
    assert ("secure" in attributes) is is_secure
    assert not any(attribute.startswith("domain") for attribute in attributes)


def test_a_session_says_whose_it_is_and_when_it_ends(server: Serving) -> None:
    reply = server.ask(None, "POST", "/session", json={"token": server.tokens[OWNER]})
    said = reply.json()
    token = said.pop("csrf_token")
    assert said == {
        "person": OWNER,
        "team": "Blue",
        "email": None,
        "role": "participant",
        "expires_at": "2026-03-03T00:00:00Z",
    }
    again = server.ask(None, "GET", "/session")  # httpx has kept the cookie
    assert again.json() == {**said, "csrf_token": token}


def test_a_session_ends_when_the_server_has_another_key(
    browser: Browser, folder: Path, open_server: OpenServer
) -> None:
    settings = settings_of(folder)
    assert browser.ask("GET", "/me").status_code == 200
    rotate_key(settings, "test", "stolen")
    restarted = replace(browser, server=open_server(settings, browser.server.tokens))
    assert restarted.ask("GET", "/me").status_code == 401


def test_a_session_can_do_what_its_person_can(browser: Browser) -> None:
    assert browser.ask("GET", "/me").json()["person"] == OWNER
    assert browser.ask("GET", f"/splits/{OPEN}").json()["quota"] is not None
    assert browser.ask("GET", "/organiser/audit").status_code == 403
    path, said = f"/splits/{OPEN}/submissions", {"name": "Walker"}
    assert browser.change("POST", path, content=GOOD, params=said).status_code == 201


# What a changing request shows, beside the cookie, and what becomes of it.
SHOWN = [
    pytest.param({}, 403, id="nothing"),
    pytest.param({"X-CSRF-Token": ""}, 403, id="an empty token"),
    pytest.param({"X-CSRF-Token": "é".encode()}, 403, id="what is no token"),
    pytest.param({"X-CSRF-Token": "{other}"}, 403, id="another session's"),
    pytest.param({"X-CSRF-Token": "{cookie}"}, 403, id="the cookie itself"),
    pytest.param({"X-CSRF-Token": "{own}"}, 200, id="its own"),
    pytest.param({"Authorization": "Bearer {token}"}, 200, id="a token of access"),
]


@pytest.mark.parametrize(("headers", "status"), SHOWN)
def test_what_changes_something_needs_the_csrf_token(
    browser: Browser, submission: str, headers: Mapping[str, str | bytes], status: int
) -> None:
    server = browser.server
    values = {
        "own": browser.csrf_token,
        "other": signed_in(server, server.tokens[OWNER]).csrf_token,
        "cookie": browser.cookie,
        "token": server.tokens[OWNER],
    }
    shown = {
        name: value.format(**values) if isinstance(value, str) else value
        for name, value in headers.items()
    }
    change = {"published": True}
    reply = browser.ask("PATCH", f"/submissions/{submission}", json=change, headers=shown)
    Description(server).check(reply)
    board = server.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()
    assert reply.status_code == status
    assert status == 200 or reply.json()["code"] == "csrf"
    assert len(board["rows"]) == (status == 200)


def test_an_upload_without_the_csrf_token_is_not_even_read(browser: Browser) -> None:
    reply = browser.ask("POST", f"/splits/{OPEN}/submissions?name=x", content=b"no submission")
    assert (reply.status_code, reply.json()["code"]) == (403, "csrf")


# What browsers say of where a request comes from, and whether the cookie counts then.
ORIGINS = [
    pytest.param({}, True, id="says nothing"),
    pytest.param({"Sec-Fetch-Site": "same-origin"}, True, id="our own page"),
    pytest.param({"Sec-Fetch-Site": "none"}, True, id="typed into the address bar"),
    pytest.param({"Sec-Fetch-Site": "same-site"}, False, id="a sister's page"),
    pytest.param({"Sec-Fetch-Site": "cross-site"}, False, id="another site's page"),
    pytest.param({"Sec-Fetch-Site": "cross-site", "Origin": HERE}, False, id="the first counts"),
    pytest.param({"Sec-Fetch-Site": "from-mars"}, False, id="nothing that we know"),
    pytest.param({"Origin": HERE}, True, id="an older browser, our own page"),
    pytest.param({"Origin": ELSEWHERE}, False, id="an older browser, another site's page"),
    pytest.param({"Origin": f"{HERE}:8080"}, False, id="another port"),
    pytest.param({"Origin": f"{HERE}.evil.example"}, False, id="a longer name"),
    pytest.param({"Origin": "null"}, False, id="a page without an origin"),
]


@pytest.mark.parametrize(("headers", "counts"), ORIGINS)
def test_a_cookie_counts_for_our_own_pages_only(
    browser: Browser, submission: str, headers: Mapping[str, str], *, counts: bool
) -> None:
    path, change = f"/submissions/{submission}", {"published": True}
    read = browser.ask("GET", path, headers=headers)
    changed = browser.change("PATCH", path, json=change, headers=headers)
    open_to_all = browser.ask("GET", f"/splits/{OPEN}", headers=headers)
    expected = 200 if counts else 401
    assert [read.status_code, changed.status_code] == [expected, expected]
    assert (open_to_all.json()["quota"] is not None) is counts


@pytest.mark.parametrize(("headers", "counts"), ORIGINS)
def test_nobody_is_signed_in_by_another_site(
    server: Serving, headers: Mapping[str, str], *, counts: bool
) -> None:
    content = {"token": server.tokens[OWNER]}
    reply = server.ask(None, "POST", "/session", json=content, headers=headers)
    assert reply.status_code == (201 if counts else 403)
    assert ("set-cookie" in reply.headers) is counts


def test_a_token_counts_wherever_the_request_comes_from(server: Serving) -> None:
    headers = {"Sec-Fetch-Site": "cross-site", "Origin": ELSEWHERE}
    assert server.ask(OWNER, "GET", "/me", headers=headers).status_code == 200


def is_alive(browser: Browser) -> bool:
    """Tell whether a session counts; one that does not is nobody's, and no error."""
    assert browser.ask("GET", "/splits").status_code == 200
    return browser.ask("GET", "/me").status_code == 200


@pytest.mark.parametrize(
    ("hours", "expected"), [(12 - 1 / 3600, True), (12, False), (1000, False), (-1, True)]
)
def test_a_session_ends_after_half_a_day(browser: Browser, hours: float, *, expected: bool) -> None:
    browser.server.clock.turn(hours=hours)
    assert is_alive(browser) is expected


@pytest.mark.parametrize(("minutes", "expected"), [(59.9, True), (60, False)])
def test_a_session_ends_with_its_token(server: Serving, minutes: float, *, expected: bool) -> None:
    token, _ = created(server, hours=1)
    browser = signed_in(server, token)
    said = browser.ask("GET", "/session").json()
    assert said["expires_at"] == "2026-03-02T13:00:00Z"
    server.clock.turn(minutes=minutes)
    assert is_alive(browser) is expected


def test_to_revoke_a_token_ends_its_sessions_and_no_others(server: Serving) -> None:
    token, hint = created(server, days=1)
    one, other = signed_in(server, token), signed_in(server, server.tokens[OWNER])
    with server.acting() as transaction:
        revoke_token(transaction, hint)
    assert [is_alive(one), is_alive(other)] == [False, True]


def test_to_sign_out_ends_the_session_for_a_copy_of_the_cookie_too(browser: Browser) -> None:
    copy = Browser(browser.server, browser.cookie, browser.csrf_token)
    other = signed_in(browser.server, browser.server.tokens[OWNER])
    reply = browser.change("DELETE", "/session")
    assert (reply.status_code, reply.content) == (204, b"")
    assert f'{COOKIE}=""' in reply.headers["set-cookie"]
    assert [is_alive(copy), is_alive(other)] == [False, True]
    assert copy.change("DELETE", "/session").status_code == 401


def test_to_sign_out_needs_the_csrf_token(browser: Browser) -> None:
    assert browser.ask("DELETE", "/session").status_code == 403
    assert is_alive(browser)


@pytest.mark.parametrize(
    "forge",
    [
        pytest.param(lambda _: "", id="empty"),
        pytest.param(lambda _: "rv_nothing", id="nothing of ours"),
        pytest.param(lambda cookie: cookie.partition(".")[0], id="unsigned"),
        pytest.param(lambda cookie: cookie[:-45].swapcase() + cookie[-45:], id="another name"),
        pytest.param(lambda cookie: cookie[:-1] + "!", id="another signature"),
        pytest.param(lambda cookie: f"{cookie}.{cookie}", id="twice"),
    ],
)
def test_a_forged_cookie_is_nobody_s(browser: Browser, forge: Callable[[str], str]) -> None:
    forged = forge(browser.cookie)
    assert forged != browser.cookie
    assert not is_alive(Browser(browser.server, forged, browser.csrf_token))


def test_the_csrf_token_makes_no_cookie(browser: Browser) -> None:
    name = browser.cookie.partition(".")[0]
    forged = f"{name}.{browser.csrf_token}"
    assert not is_alive(Browser(browser.server, forged, browser.csrf_token))


def test_another_process_of_the_server_knows_the_session(
    browser: Browser, open_server: OpenServer, folder: Any
) -> None:
    replica = open_server(settings_of(folder), browser.server.tokens)
    assert is_alive(Browser(replica, browser.cookie, browser.csrf_token))
    assert Browser(replica, browser.cookie, browser.csrf_token).ask("GET", "/me").is_success


def test_sessions_that_are_over_are_forgotten(server: Serving) -> None:
    for _ in range(3):
        signed_in(server, server.tokens[OWNER])
    server.clock.turn(hours=12)
    signed_in(server, server.tokens[ORGANISER])
    with server.state.database.reading() as session:
        assert session.scalar(select(func.count()).select_from(BrowserSession)) == 1


def test_the_database_has_nothing_to_make_a_cookie_of(browser: Browser) -> None:
    with browser.server.state.database.reading() as session:
        (row,) = session.scalars(select(BrowserSession))
        kept = " ".join(str(value) for value in vars(row).values())
    assert browser.cookie not in kept
    assert browser.csrf_token not in kept
