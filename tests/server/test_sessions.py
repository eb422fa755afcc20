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
from reverie_eval.server.identity import Sessions, name_in
from reverie_eval.server.operations.keys import rotate_key
from reverie_eval.server.store.tables import BrowserSession
from tests.support.acting import NOON, create_token
from tests.support.description import Description
from tests.support.serving import OPEN, ORGANISER, OWNER, OpenServer, Serving, settings_of

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

    def send(self, path: str, headers: Mapping[str, str], **fields: str) -> httpx.Response:
        """Send a form as our own pages do: with the session's CSRF token too."""
        cookie = {"Cookie": f"{COOKIE}={self.cookie}"}
        data = {"csrf_token": self.csrf_token, **fields}
        return self.server.client.post(path, headers={**cookie, **headers}, data=data)


SignIn = Callable[..., Browser]


def signed_in(server: Serving, token: str) -> Browser:
    reply = server.client.post("/sign-in", data={"token": token})
    assert reply.status_code == 303
    server.client.cookies.clear()  # what a request carries, the tests say
    cookie = reply.cookies[COOKIE]
    return Browser(server, cookie, server.state.get(Sessions).csrf_token(name_in(cookie)))


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
    reply = server.client.post(f"{scheme}://server/sign-in", data={"token": server.tokens[OWNER]})
    first, *attributes = reply.headers["set-cookie"].lower().split("; ")
    assert first.startswith(COOKIE)
    assert {"httponly", "samesite=strict", "path=/"} < set(attributes)
    assert ("secure" in attributes) is is_secure
    assert not any(attribute.startswith("domain") for attribute in attributes)


def test_a_session_ends_when_the_server_has_another_key(
    browser: Browser, folder: Path, open_server: OpenServer
) -> None:
    settings = settings_of(folder)
    assert browser.ask("GET", "/me").status_code == 200
    rotate_key(settings, "test", "stolen")
    restarted = replace(browser, server=open_server(settings, browser.server.tokens))
    assert restarted.ask("GET", "/me").status_code == 401


def test_a_session_reads_what_its_person_may(browser: Browser) -> None:
    assert browser.ask("GET", "/me").json()["person"] == OWNER
    assert browser.ask("GET", f"/splits/{OPEN}").json()["quota"] is not None
    assert browser.ask("GET", "/organiser/audit").status_code == 403


def test_the_api_changes_nothing_for_a_session(browser: Browser, submission: str) -> None:
    csrf_token = {"X-CSRF-Token": browser.csrf_token}
    path, change = f"/submissions/{submission}", {"published": True}
    reply = browser.ask("PATCH", path, json=change, headers=csrf_token)
    Description(browser.server).check(reply)
    assert reply.status_code == 401
    assert browser.ask("GET", path).json()["status"] == "unpublished"


def test_an_upload_with_a_session_alone_is_not_even_read(browser: Browser) -> None:
    reply = browser.ask("POST", f"/splits/{OPEN}/submissions?name=x", content=b"no submission")
    assert reply.status_code == 401


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
    path = f"/submissions/{submission}"
    read = browser.ask("GET", path, headers=headers)
    changed = browser.send(path, headers, published="true")
    open_to_all = browser.ask("GET", f"/splits/{OPEN}", headers=headers)
    assert read.status_code == (200 if counts else 401)
    assert changed.headers["location"].startswith(path if counts else "/sign-in?")
    assert (open_to_all.json()["quota"] is not None) is counts


@pytest.mark.parametrize(("headers", "counts"), ORIGINS)
def test_nobody_is_signed_in_by_another_site(
    server: Serving, headers: Mapping[str, str], *, counts: bool
) -> None:
    content = {"token": server.tokens[OWNER]}
    reply = server.client.post("/sign-in", data=content, headers=headers)
    assert reply.status_code == (303 if counts else 403)
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
    reply = browser.send("/sign-out", {})
    assert (reply.status_code, reply.headers["location"]) == (303, "/")
    assert f'{COOKIE}=""' in reply.headers["set-cookie"]
    assert [is_alive(copy), is_alive(other)] == [False, True]


def test_to_sign_out_needs_the_csrf_token(browser: Browser) -> None:
    assert browser.send("/sign-out", {}, csrf_token="none").status_code == 403
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
