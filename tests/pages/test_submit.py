"""``/submit`` and the ways to it, without scripts: a file is checked, scored once, or refused."""

import json
import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from sqlalchemy import func, select

from reverie_eval.reporting.service import METHOD_COSTS, METHOD_FLAGS
from reverie_eval.schemas.organising import NewNotice
from reverie_eval.schemas.service import Phase
from reverie_eval.server.accounts.access import own_path
from reverie_eval.server.http.callers import COOKIE
from reverie_eval.server.messages.notices import post_notice
from reverie_eval.server.settings import Limits, Quota
from reverie_eval.server.store.tables import BrowserSession, Submission
from tests.support.acting import NOON, add_person, add_team, create_token
from tests.support.serving import (
    BROKEN,
    GOOD,
    MATE,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    broken_private,
    settings_of,
    submission_for,
)
from tests.support.visiting import Visitor, place_of, said, signed_in

TYPED = {
    "name": "<b>Bold</b> walker",
    "description": 'It says "</textarea><script>alert(1)</script>".',
    "paper": "https://example.org/?a=1&b=2",
    "code": "https://example.org/code",
    "ensemble": "true",
}


@pytest.fixture
def owner(server: Serving) -> Visitor:
    return signed_in(server, OWNER)


def kept(server: Serving) -> int:
    """Return how many submissions were stored; each used one of the quota."""
    with server.state.database.reading() as session:
        return session.scalar(select(func.count()).select_from(Submission)) or 0


def test_the_whole_way_without_scripts(server: Serving) -> None:
    nobody = Visitor(server)
    assert nobody.get("/submit").headers["location"] == "/sign-in?back=/submit"
    form = {"token": f" {server.tokens[OWNER]}\n", "back": "/submit"}
    reply = server.client.post("/sign-in", data=form)
    assert (reply.status_code, reply.headers["location"]) == (303, "/submit")
    owner = signed_in(server, OWNER)
    assert "23 problems in this file." in said(owner.upload(BROKEN, "check"))
    assert f"This file can be scored on {OPEN}." in said(owner.upload(GOOD, "check"))
    assert kept(server) == 0
    scored = owner.upload(**TYPED, input_class="views", money_per_episode="0.25")
    assert scored.status_code == 303
    assert scored.headers["location"] == f"/submissions/{place_of(scored)}?done=scored"
    page = owner.get(scored.headers["location"])
    assert "Scored. One submission was used." in said(page)
    published = owner.send(f"/submissions/{place_of(scored)}", {"published": "true"})
    assert "Saved. The submission is published" in said(owner.get(published.headers["location"]))
    board = server.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()
    assert board["rows"][0]["method"] == {
        **TYPED,
        "extra_data": None,
        "pre_exploration": None,
        "ground_truth_objects": None,
        "ensemble": True,
        "navigation_only": None,
        "human": None,
        **dict.fromkeys(("reference", "sample_size", *METHOD_COSTS)),
        "input_class": "views",
        "money_per_episode": 0.25,
    }
    assert owner.send("/sign-out", {}).headers["location"] == "/"
    assert owner.get("/team").headers["location"] == "/sign-in?back=/team"


@pytest.mark.parametrize(("what", "status"), [("check", 200), ("score", 422)])
def test_all_problems_are_shown_with_their_places(owner: Visitor, what: str, status: int) -> None:
    reply = owner.upload(BROKEN, what)
    page = said(reply)
    assert reply.status_code == status
    assert "23 problems in this file. Nothing was scored and no submission was used" in page
    assert "[4].trajectory is empty; an agent that does not move has one pose" in page
    assert "[86] has no instr_id; add it" in page
    assert reply.text.count("<tr><td><code>") == 23
    assert kept(owner.server) == 0


UNDECLARED = dict.fromkeys((*METHOD_FLAGS, "input_class"), "not declared")


@pytest.mark.parametrize("what", ["check", "score"])
def test_what_was_typed_is_kept_and_escaped(owner: Visitor, what: str) -> None:
    page = owner.upload(BROKEN, what, **TYPED).text
    assert 'value="&lt;b&gt;Bold&lt;/b&gt; walker"' in page
    assert "It says &#34;&lt;/textarea&gt;&lt;script&gt;alert(1)&lt;/script&gt;&#34;." in page
    assert 'value="https://example.org/?a=1&amp;b=2"' in page
    assert chosen(page) == {**UNDECLARED, "ensemble": "yes"}
    assert re.search(rf'name="split" value="{OPEN}" required checked', page)
    assert "<script>alert" not in page


def chosen(page: str) -> dict[str, str]:
    """Return what the form says of each declaration; the first option counts if none is chosen."""
    selects = re.findall(r'<select id="\w+" name="(\w+)".*?>(<option.*?)</select>', page, re.DOTALL)
    options = {
        name: re.findall(r'<option value="\w*"( selected)?>([^<]*)<', text)
        for name, text in selects
    }
    return {
        name: next((label for is_chosen, label in some if is_chosen), some[0][1])
        for name, some in options.items()
    }


@pytest.mark.parametrize(
    ("typed", "declared"),
    [
        pytest.param("true", True, id="yes"),
        pytest.param("false", False, id="no"),
        pytest.param("", None, id="not declared"),
        pytest.param(None, None, id="no field"),
    ],
)
def test_a_form_declares_yes_no_or_nothing_and_can_take_it_back(
    owner: Visitor, typed: str | None, *, declared: bool | None
) -> None:
    fields = {} if typed is None else {"ensemble": typed}
    place = place_of(owner.upload(**TYPED | {"ensemble": "", **fields}))

    def kept() -> bool | None:
        method = owner.server.ask(OWNER, "GET", f"/submissions/{place}").json()["method"]
        value: bool | None = method["ensemble"]
        return value

    assert kept() is declared
    page = owner.get(f"/submissions/{place}")
    words = {True: "yes", False: "no", None: "not declared"}
    assert chosen(page.text)["ensemble"] == words[declared]
    assert f"Ensemble {words[declared].capitalize()} Several models decide" in said(page)
    for answer, value in {"true": True, "false": False, "": None}.items():
        owner.send(f"/submissions/{place}", {"name": "Walker", "ensemble": answer})
        assert kept() is value


NOTHING_CHOSEN = (
    '--x\r\nContent-Disposition: form-data; name="file"; filename=""\r\n'
    "Content-Type: application/octet-stream\r\n\r\n\r\n--x--\r\n"
)
"""As browsers send a field of a file that was left empty."""


@pytest.mark.parametrize("what", ["check", "score"])
def test_where_no_file_was_chosen_that_is_what_is_said(owner: Visitor, what: str) -> None:
    fields = {"csrf_token": owner.csrf_token(), "split": OPEN, "what": what, **TYPED}
    part = '--x\r\nContent-Disposition: form-data; name="{}"\r\n\r\n{}\r\n'
    body = "".join(part.format(*field) for field in fields.items()) + NOTHING_CHOSEN
    headers = {
        "Cookie": f"{COOKIE}={owner.cookie}",
        "Content-Type": "multipart/form-data; boundary=x",
    }
    reply = owner.server.client.post("/submit", content=body.encode(), headers=headers)
    assert reply.status_code == 400
    assert "Choose a file first." in said(reply)
    assert "problem in this file" not in said(reply)
    assert 'value="&lt;b&gt;Bold&lt;/b&gt; walker"' in reply.text
    assert "1 problem in this file." in said(owner.upload(b"", what))  # it was chosen, and is empty


def test_who_has_no_scripts_is_told_to_choose_the_file_again(owner: Visitor) -> None:
    checked = owner.upload(GOOD, "check")
    assert "<noscript> Choose the file again before scoring" in checked.text


def test_what_is_wrong_with_a_field_is_said_in_words_of_ours(owner: Visitor) -> None:
    page = owner.upload(name="x" * 101, paper="http://example.org/")
    assert page.status_code == 400
    assert "Must have at most 100 characters." in said(page)
    assert "Must be a link that begins with https://." in said(page)


def test_what_a_file_says_is_escaped(owner: Visitor) -> None:
    records = json.loads(GOOD)
    records[0]["instr_id"] = "<img src=x onerror=alert(1)>"
    page = owner.upload(json.dumps(records).encode(), "check")
    assert "<img src=x" not in page.text
    assert "<img src=x onerror=alert(1)>" in said(page)


def test_of_a_private_split_no_problem_tells_of_answers(owner: Visitor) -> None:
    reply = owner.upload(broken_private(), "score", split=PRIVATE)
    api = owner.server.upload(OWNER, broken_private(), PRIVATE).json()
    assert reply.text.count("<tr><td><code>") == len(api["problems"])


# What is typed besides a sound file, and what the page says of it.
WRONG = [
    pytest.param({"name": ""}, "Name", "Required but missing.", id="no name"),
    pytest.param({"name": "x" * 101}, "Name", "at most 100 characters", id="a long name"),
    pytest.param({"paper": "http://example.org"}, "Paper", "https://", id="another scheme"),
    pytest.param({"code": "javascript:alert(1)"}, "Code", "https://", id="a script"),
    pytest.param({"name": "a\u202eb"}, "Name", "invisible characters", id="hidden letters"),
]


@pytest.mark.parametrize(("typed", "label", "fault"), WRONG)
def test_what_is_wrong_is_said_beside_the_field(
    owner: Visitor, typed: Mapping[str, str], label: str, fault: str
) -> None:
    reply = owner.upload(**typed)
    name = label.lower()
    wrong = re.search(rf'<span class="wrong" id="{name}-wrong">([^<]*)</span>', reply.text)
    assert reply.status_code == 400
    assert wrong
    assert fault in wrong[1].replace("&#39;", "'")
    assert f'aria-describedby="{name}-hint {name}-wrong" aria-invalid="true"' in reply.text
    assert reply.text.count('aria-invalid="true"') == 1
    assert kept(owner.server) == 0


def test_what_the_organiser_asks_for_has_to_be_said(open_server: OpenServer, folder: Path) -> None:
    asked = settings_of(folder).model_copy(update={"required_metadata": ("paper", "extra_data")})
    owner = signed_in(open_server(asked), OWNER)
    form = owner.get("/submit").text
    assert re.search(r'id="paper"[^>]* required ', form)
    assert re.search(r'<select id="extra_data" name="extra_data" required ', form)
    assert chosen(form) == {**UNDECLARED, "extra_data": "choose"}
    assert "about the method is missing: paper, extra data" in said(owner.upload())
    complete = owner.upload(paper="https://example.org/", extra_data="false")
    assert complete.status_code == 303


def test_no_file_and_no_such_split(owner: Visitor) -> None:
    without = owner.send("/submit", {"split": OPEN, "what": "score", "name": "Kept name"}, file=b"")
    assert without.status_code == 422
    assert 'value="Kept name"' in without.text
    assert owner.upload(split="train").status_code == 404
    assert "There is no split 'train' here" in said(owner.upload(split="train"))
    urlencoded = owner.send("/submit", {"split": OPEN, "what": "score"})
    assert urlencoded.status_code == 403  # no form of ours: its token is not looked for
    assert kept(owner.server) == 0


@pytest.mark.parametrize("token", ["", "é", "{other}"], ids=["none", "nonsense", "another's"])
@pytest.mark.parametrize("what", ["check", "score"])
def test_without_the_csrf_token_nothing_is_done(owner: Visitor, token: str, what: str) -> None:
    other = signed_in(owner.server, MATE).csrf_token()
    fields = {"split": OPEN, "what": what, "name": "Walker"}
    shown = token.format(other=other)
    reply = owner.send("/submit", fields, csrf_token=shown, file=GOOD)
    assert (reply.status_code, kept(owner.server)) == (403, 0)
    assert "Nothing was scored" in said(reply)


# What browsers say of a form that another site's page sends.
ELSEWHERE = [
    pytest.param({"Sec-Fetch-Site": "cross-site"}, id="another site"),
    pytest.param({"Sec-Fetch-Site": "same-site"}, id="another host of the site"),
    pytest.param({"Origin": "https://evil.example"}, id="an old browser"),
]


@pytest.mark.parametrize("headers", ELSEWHERE)
def test_another_site_has_no_session_even_with_the_token(
    owner: Visitor, headers: Mapping[str, str]
) -> None:
    fields = {"split": OPEN, "what": "score", "name": "Walker"}
    reply = owner.send("/submit", fields, file=GOOD, headers=headers)
    assert reply.status_code == 303
    assert reply.headers["location"].startswith("/sign-in")
    assert kept(owner.server) == 0
    signing = owner.server.client.post(
        "/sign-in", data={"token": owner.server.tokens[OTHER]}, headers=headers
    )
    assert (signing.status_code, "set-cookie" in signing.headers) == (403, False)


def test_who_was_signed_out_meanwhile_comes_back_to_the_form(server: Serving) -> None:
    headers = {"Referer": "http://server/submit?split=test"}
    reply = Visitor(server).send("/submit", {}, csrf_token="", file=GOOD, headers=headers)
    assert reply.headers["location"] == "/sign-in?back=/submit&form=kept"
    assert "go back to the form" in said(Visitor(server).get(reply.headers["location"]))


def test_a_form_of_an_earlier_session_keeps_what_was_typed(server: Serving) -> None:
    before = signed_in(server, OWNER)
    token = before.csrf_token()
    owner = signed_in(server, OWNER)
    typed = {"split": OPEN, "what": "score", "name": "Late", "description": "Typed for an hour."}
    reply = owner.send("/submit", typed, csrf_token=token, file=GOOD)
    assert reply.status_code == 403
    assert "what you typed is below" in said(reply)
    for text in ('value="Late"', "Typed for an hour."):
        assert text in reply.text
    assert kept(server) == 0


def test_the_same_file_leads_to_the_same_page_and_spends_once(owner: Visitor) -> None:
    first = owner.upload()
    again = owner.upload(name="Another name")
    mate = signed_in(owner.server, MATE).upload()
    assert place_of(first) == place_of(again) == place_of(mate)
    assert again.headers["location"].endswith("?done=again&ignored=name")
    page = said(owner.get(again.headers["location"]))
    assert "This file was scored before." in page
    assert "What you entered this time for name was not saved; you can edit it here." in page
    assert "not saved" not in said(owner.get(mate.headers["location"]))
    made_up = owner.get(f"/submissions/{place_of(first)}?done=again&ignored=<b>&ignored=x")
    assert "not saved" not in said(made_up)
    assert "no submission was used" in page
    assert "Another name" not in page
    assert kept(owner.server) == 1


def test_a_double_click_spends_once(owner: Visitor) -> None:
    token = owner.csrf_token()
    fields = {"split": OPEN, "what": "score", "name": "Walker"}
    with ThreadPoolExecutor(4) as pool:
        sent = [
            pool.submit(owner.send, "/submit", fields, csrf_token=token, file=GOOD)
            for _ in range(4)
        ]
    assert len({place_of(reply.result()) for reply in sent}) == 1
    assert kept(owner.server) == 1


def test_the_form_promises_one_more_only_when_more_are_left_then(
    open_server: OpenServer, folder: Path
) -> None:
    """After a day, all of that day's are left; that the month has one more then changes nothing."""
    server = open_server(adjusted(settings_of(folder), quota=Quota(day=2)))
    owner = signed_in(server, OWNER)
    content = submission_for(PRIVATE, "random", 1)
    assert owner.upload(content, split=PRIVATE).status_code == 303
    left = "1 submission left: 1 of 2 per 24 hours, 9 of 10 per 30 days, 39 of 40 per 365 days."
    assert f"{left} One more from 2026-03-03 12:00 UTC." in said(owner.get("/submit"))
    server.clock.turn(hours=24)
    left = "2 submissions left: 2 of 2 per 24 hours, 9 of 10 per 30 days, 39 of 40 per 365 days."
    form = said(signed_in(server, OWNER).get("/submit"))
    assert left in form
    assert "One more from" not in form


def test_a_spent_quota_says_when_the_next_is(open_server: OpenServer, folder: Path) -> None:
    tight = adjusted(settings_of(folder), quota=Quota(day=1))
    owner = signed_in(open_server(tight), OWNER)
    assert "1 submission left: 1 of 1 per 24 hours" in said(owner.get("/submit"))
    first, second = (submission_for(PRIVATE, "random", seed) for seed in (1, 2))
    assert owner.upload(first, split=PRIVATE).status_code == 303
    reply = owner.upload(second, split=PRIVATE, name="Kept name")
    page = said(reply)
    assert reply.status_code == 429
    assert "No submissions left: 0 of 1 per 24 hours, 9 of 10 per 30 days" in page
    assert "Next possible at 2026-03-03 12:00 UTC" in page
    assert '<time datetime="2026-03-03T12:00:00+00:00">' in reply.text
    assert 'value="Kept name"' in reply.text
    assert owner.upload(second, "check", split=PRIVATE).status_code == 200
    assert owner.upload(first, split=PRIVATE).headers["location"].endswith("?done=again")


def test_while_paused_files_are_checked_and_not_scored(owner: Visitor) -> None:
    with owner.server.acting(ORGANISER) as transaction:
        new = NewNotice(banner="The disk is full.", paused=True)
        post_notice(transaction, new)
    assert "The organiser has paused submissions." in said(owner.get("/submit"))
    assert owner.upload(what="check").status_code == 200
    reply = owner.upload()
    assert (reply.status_code, kept(owner.server)) == (409, 0)
    assert "The organiser has paused submissions" in said(reply)


def test_a_closed_split_says_when_it_opens(open_server: OpenServer, folder: Path) -> None:
    later = (Phase(name="spring", opens=NOON.replace(month=4)),)
    owner = signed_in(open_server(adjusted(settings_of(folder), phases=later)), OWNER)
    assert "Accepts no submissions now; opens 2026-04-02 12:00 UTC" in said(owner.get("/submit"))
    assert owner.upload(submission_for(PRIVATE), split=PRIVATE).status_code == 409


def test_a_file_that_is_too_large(open_server: OpenServer, folder: Path) -> None:
    small = settings_of(folder).model_copy(update={"limits": Limits(upload_mebibytes=1)})
    owner = signed_in(open_server(small), OWNER)
    reply = owner.upload(GOOD + b" " * (2 << 20), "check")
    assert reply.status_code == 413
    assert "larger than 1 MiB" in said(reply)


# Where a link may lead whoever has signed in, and where it does.
BACK = [
    pytest.param("/submit?split=test", "/submit?split=test", id="a page"),
    pytest.param("https://evil.example/", "/team", id="another host"),
    pytest.param("//evil.example/", "/team", id="another host by two slashes"),
    pytest.param("/\\evil.example/", "/team", id="another host by a backslash"),
    pytest.param("/\r\nSet-Cookie: a=b", "/team", id="another header"),
]


@pytest.mark.parametrize(("link", "target"), BACK)
def test_signing_in_leads_back_to_this_server_only(link: str, target: str) -> None:
    assert own_path(link) == target


@pytest.mark.parametrize(
    ("token", "told"),
    [
        ("", "unknown token; ask the organiser for another"),
        ("rv_none", "unknown token; ask the organiser for another"),
        ("{invitation}", "this is an invitation, not a token; exchange it for a token first"),
    ],
)
def test_a_wrong_token_is_refused_in_place(server: Serving, token: str, told: str) -> None:
    shown = token.format(invitation=invitation(server))
    reply = server.client.post("/sign-in", data={"token": shown, "back": "/submit"})
    assert (reply.status_code, "set-cookie" in reply.headers) == (401, False)
    assert told in said(reply)
    assert 'name="back" value="/submit"' in reply.text


def test_an_invitation_becomes_a_token_once(server: Serving) -> None:
    sent = {"invitation": invitation(server), "back": "/submit"}
    reply = server.client.post("/sign-in/invitation", data=sent)
    token = re.search(r'<code id="secret">(rv_[\w-]+)</code>', reply.text)
    assert token
    assert reply.headers["cache-control"] == "no-store"
    assert "Welcome, Dora" in said(reply)
    assert "Dora" in server.client.get("/team").text  # the client has kept the cookie
    server.client.cookies.clear()
    me = server.client.get("/api/v1/me", headers={"Authorization": f"Bearer {token[1]}"}).json()
    assert (me["person"], me["team"]) == ("Dora", "Green")
    again = server.client.post("/sign-in/invitation", data=sent)
    assert (again.status_code, "set-cookie" in again.headers) == (401, False)
    assert "this invitation was used or revoked" in said(again)


def invitation(server: Serving) -> str:
    """Invite Dora."""
    with server.acting() as transaction:
        add_team(transaction, "Green")
        add_person(transaction, "Green", "Dora")
        return create_token(transaction, "Dora", "invite").token


def test_signing_out_ends_the_session(owner: Visitor) -> None:
    forged = owner.send("/sign-out", {}, csrf_token="none")
    assert (forged.status_code, owner.get("/team").status_code) == (403, 200)
    owner.send("/sign-out", {})
    with owner.server.state.database.reading() as session:
        assert session.scalar(select(func.count()).select_from(BrowserSession)) == 0


def test_a_file_for_another_split_can_be_checked_as_that(owner: Visitor) -> None:
    page = owner.upload(submission_for(PRIVATE), "check").text
    assert re.search(
        rf'<button type="button"[^>]* data-split="{PRIVATE}">Check as {PRIVATE}<', page
    )
    # One of its ids is of val_seen, most are of the split that was chosen.
    assert "data-split" not in owner.upload(BROKEN, "check").text
