"""The organiser's desk, with scripts off: what it shows, and what its forms do."""

import re
import shutil
from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from sqlalchemy import update
from starlette.datastructures import UploadFile

from reverie_eval.ground_truth import Bundle
from reverie_eval.schemas.organising import NewSchedule
from reverie_eval.schemas.service import Phase
from reverie_eval.server.accounts.people import person_named, team_named
from reverie_eval.server.accounts.tokens import list_tokens
from reverie_eval.server.audit.log import entries
from reverie_eval.server.boards.reported import list_reported
from reverie_eval.server.boards.reviews import standing_reviews
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.http import desk as forms
from reverie_eval.server.http.callers import Call
from reverie_eval.server.intake.attempts import list_attempts
from reverie_eval.server.intake.quotas import list_grants
from reverie_eval.server.operations.health import Canary, UnhealthyError
from reverie_eval.server.store.paging import Page
from reverie_eval.server.store.tables import AuditEntry, StoredSnapshot
from tests.support.acting import NOON
from tests.support.correcting import rescored
from tests.support.serving import (
    BROKEN,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
    submission_for,
)
from tests.support.visiting import Visitor, said, signed_in
from tests.support.worlds import with_arrays

MARKUP = "<script>alert(1)</script>"
YES = {"confirmed": "yes"}
PAPER = "https://example.org/paper"
PAGES = (
    "/desk",
    "/desk/attempts",
    "/desk/reviews",
    "/desk/reported",
    "/desk/emailed-files",
    "/desk/corrections",
    "/desk/people",
    "/desk/requests",
    "/desk/quotas",
    "/desk/phases",
    "/desk/snapshots",
    "/desk/news",
    "/desk/notice",
    "/desk/audit",
)
RESULT = {"split": OPEN, "name": "Pointer", "team": "Qi et al.", "source": PAPER}


@pytest.fixture
def desk(server: Serving) -> Visitor:
    return signed_in(server, ORGANISER)


def sent(server: Serving, **method: str) -> str:
    return str(server.upload(OWNER, server.distinct(), **method).json()["submission"]["id"])


def sending(desk: Visitor, path: str, **fields: str) -> httpx.Response:
    return desk.send(path, fields)


def told(desk: Visitor, path: str, **fields: str) -> str:
    """Send a form that works, and return what the page says that it leads to."""
    reply = desk.send(path, fields)
    assert reply.status_code == 303, said(reply)
    return said(desk.get(reply.headers["location"]))


def hidden(reply: httpx.Response) -> Mapping[str, str]:
    """Return the fields of a form that asks again."""
    found = re.findall(r'type="hidden" name="(\w+)" value="([^"]*)"', reply.text)
    return {name: value for name, value in found if name != "csrf_token"}


@pytest.mark.parametrize("path", PAGES)
def test_the_desk_is_the_organiser_s(path: str, desk: Visitor) -> None:
    sent(desk.server, name=MARKUP)
    desk.server.upload(OWNER, BROKEN)
    page = desk.get(path)
    assert page.status_code == 200
    assert MARKUP not in page.text
    assert 'aria-current="page"' in page.text
    assert page.headers["cache-control"] == "no-store"
    assert signed_in(desk.server, OWNER).get(path).status_code == 403
    assert desk.server.client.get(path).headers["location"] == f"/sign-in?back={path}"


@pytest.mark.parametrize(
    "path",
    [
        "/desk/reviews",
        "/desk/reviews/1/lift",
        "/desk/reported",
        "/desk/reported/import",
        "/desk/reported/1",
        "/desk/reported/1/remove",
        "/desk/people",
        "/desk/people/1",
        "/desk/people/1/delete",
        "/desk/people/import",
        "/desk/requests",
        "/desk/emailed-files",
        "/desk/people/teams",
        "/desk/people/teams/rename",
        "/desk/people/teams/merge",
        "/desk/people/tokens",
        "/desk/people/tokens/rv_12345678/revoke",
        "/desk/quotas",
        "/desk/phases",
        "/desk/snapshots",
        "/desk/news",
        "/desk/news/1/remove",
        "/desk/notice",
    ],
)
def test_every_form_needs_its_token_and_the_organiser(path: str, desk: Visitor) -> None:
    with desk.server.state.database.reading() as session:
        before = len(entries(session))
    forged = desk.send(path, {"name": "Green", **YES}, csrf_token="x")
    assert forged.status_code == 403
    owner = signed_in(desk.server, OWNER)
    assert owner.send(path, {"name": "Green", **YES}).status_code == 403
    with desk.server.state.database.reading() as session:
        assert len(entries(session)) == before


def test_the_overview_says_that_all_is_well(desk: Visitor) -> None:
    sent(desk.server)
    desk.server.upload(OTHER, BROKEN)
    words = said(desk.get("/desk"))
    tested = re.search(r"All checks passed. Just tested: scoring \(([^)]*)\)", words)
    assert tested
    assert {OPEN, PRIVATE} <= set(tested[1].split(", "))
    assert "Uploads, 24 hours 2 Not scored 1" in words
    assert re.search(rf"{OPEN} open always open 1 Download 0 2026-03-02 12:00 UTC", words)
    assert "submission-rejected Carl, Red" in words
    assert re.search(r"Free disk space [\d.]+ \w+ of [\d.]+ \w+", words)


def test_the_overview_says_what_is_not(desk: Visitor, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise UnhealthyError

    monkeypatch.setattr(Canary, "_sign", fail)
    words = said(desk.get("/desk"))
    assert f"Failing: scoring of {PRIVATE}" in words
    assert "All checks passed" not in words


def test_uploads_are_paged(desk: Visitor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forms, "ON_A_PAGE", 2)
    for _ in range(3):
        desk.server.upload(OWNER, BROKEN)
    first = desk.get("/desk/attempts")
    assert first.text.count(">submission-rejected</span>") == 2
    (following,) = re.findall(r'rel="next" href="([^"]+)"', first.text)
    second = desk.get(f"/desk/attempts{following}")
    assert second.text.count(">submission-rejected</span>") == 1
    assert 'rel="next"' not in second.text


def test_a_submission_is_verified_at_once(desk: Visitor) -> None:
    submission_id = sent(desk.server, name="Walker")
    assert "Walker Team Blue (Ada)" in said(desk.get(f"/desk/reviews?submission={submission_id}"))
    form = {"submission_id": submission_id, "verdict": "verified", "reason": "we ran it"}
    words = told(desk, "/desk/reviews", **form)
    assert "Verified." in words
    assert f"Walker Blue, {OPEN} verified we ran it 2026-03-02 12:00 UTC" in words


@pytest.mark.parametrize("verdict", ["flagged", "disqualified"])
def test_what_does_harm_is_asked_for_twice(verdict: str, desk: Visitor) -> None:
    submission_id = sent(desk.server)
    form = {"submission_id": submission_id, "verdict": verdict, "reason": f"its answers {MARKUP}"}
    asked = sending(desk, "/desk/reviews", **form)
    assert "this submission?" in said(asked)
    assert MARKUP not in asked.text
    assert f"{verdict} its answers {MARKUP} (the organiser)" in said(asked)
    with desk.server.state.database.reading() as session:
        assert list(standing_reviews(session, submission_id)) == []
    assert hidden(asked).keys() == {"submission_id", "verdict", "reason", "confirmed"}
    words = told(desk, "/desk/reviews", **form, **YES)
    assert f"{verdict} its answers {MARKUP}" in words


@pytest.mark.parametrize(
    ("change", "shown"),
    [
        pytest.param(
            {"published": True},
            "Everyone who reads the leaderboard will see: disqualified",
            id="published",
        ),
        pytest.param(
            {"published": False},
            "The leaderboard does not show it now, because its team has not published it. Once it "
            "is shown, everyone will see: disqualified",
            id="not published",
        ),
        pytest.param(
            {"withdrawn": True},
            "because its team has withdrawn it. Once it is shown, everyone will see: disqualified",
            id="withdrawn",
        ),
    ],
)
def test_a_disqualification_says_who_will_see_it(
    change: Mapping[str, bool], shown: str, desk: Visitor
) -> None:
    submission = sent(desk.server)
    desk.server.ask(OWNER, "PATCH", f"/submissions/{submission}", json=change).raise_for_status()
    form = {"submission_id": submission, "verdict": "disqualified", "reason": "x"}
    assert shown in said(sending(desk, "/desk/reviews", **form))


def test_a_review_is_lifted_and_stays_on_record(desk: Visitor) -> None:
    submission_id = sent(desk.server)
    form = {"submission_id": submission_id, "verdict": "baseline", "reason": "to compare with"}
    told(desk, "/desk/reviews", **form)
    assert "Lift this review?" in said(sending(desk, "/desk/reviews/1/lift"))
    words = told(desk, "/desk/reviews/1/lift", **YES)
    assert "No reviews." in words
    assert "Lifted reviews" in words
    again = sending(desk, "/desk/reviews/1/lift", **YES)
    assert (again.status_code, "was already lifted" in said(again)) == (409, True)


def test_what_is_wrong_is_shown_beside_what_was_typed(desk: Visitor) -> None:
    submission_id = sent(desk.server)
    form = {"submission_id": submission_id, "verdict": "verified", "reason": "x" * 501}
    page = sending(desk, "/desk/reviews", **form)
    assert page.status_code == 400
    assert "Reason: must have at most 500 characters" in said(page)
    assert 'value="verified" required checked' in page.text
    assert "x" * 501 in page.text


def test_a_reported_result_is_entered_as_papers_print_it(desk: Visitor) -> None:
    scores = {"success": "11.53", "spl": "9.47 %", "path_length": "12.3", "rgs": ""}
    about = {"date": "2020-06", "dataset": "v1", "paper": PAPER}
    words = told(desk, "/desk/reported", **RESULT, **scores, **about, extra_data="true")
    assert "Pointer Qi et al. val_unseen, v1" in words
    assert "TL 12.30 SR 11.53 SPL 9.47 2020-06 example.org/paper 2026-03-02 12:00 UTC" in words
    with desk.server.state.database.reading() as session:
        (result,) = list_reported(session, Page()).rows
    assert result.scores == {"path_length": 12.3, "success": 0.1153, "spl": 0.0947}
    assert (result.method.extra_data, str(result.method.paper)) == (True, PAPER)
    assert result.method.ensemble is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        pytest.param({"success": "115.3"}, "SR %: 115.3 is not from 0 to 100", id="too much"),
        pytest.param({"success": "-1"}, "SR %: -1 is not from 0 to 100", id="too little"),
        pytest.param({"path_length": "-1"}, "TL m: -1 is not 0 or more", id="metres"),
        pytest.param({"success": "11,53"}, "'11,53' is not a number", id="no number"),
        pytest.param({"success": "nan"}, "nan is not from 0 to 100", id="not a number"),
        pytest.param({"success": "sNaN"}, "'sNaN' is not a number", id="not a number, loudly"),
        pytest.param({"path_length": "1e9999"}, "TL m: 1e9999 is", id="endless"),
        pytest.param({}, "Scores:", id="no score"),
        pytest.param({"success": "5", "source": "javascript:alert(1)"}, "Source:", id="no paper"),
        pytest.param({"success": "5", "name": ""}, "Method:", id="no name"),
    ],
)
def test_only_results_are_reported(changes: Mapping[str, str], message: str, desk: Visitor) -> None:
    page = desk.send("/desk/reported", {**RESULT, **changes})
    assert page.status_code == 400
    assert message in said(page)
    assert 'value="Qi et al."' in page.text


def test_wrong_scores_and_other_fields_of_a_reported_result_are_told_at_once(
    desk: Visitor,
) -> None:
    wrong = {"success": "115.3", "spl": "x", "source": "javascript:alert(1)", "name": ""}
    page = said(desk.send("/desk/reported", {**RESULT, **wrong}))
    for message in ("115.3 is not from 0 to 100", "'x' is not a number", "Source:", "Method:"):
        assert message in page
    assert "Scores:" not in page


def test_a_reported_result_is_changed_in_place(desk: Visitor) -> None:
    scores = {"success": "11.531", "spl": "7", "path_length": "12.3"}
    told(desk, "/desk/reported", **RESULT, **scores, date="2020-06", ensemble="false")
    form = desk.get("/desk/reported/1").text
    fields = dict(re.findall(r'<input id="\w+" name="(\w+)"[^>]* value="([^"]*)"', form))
    assert {name: fields[name] for name in scores} == scores
    assert (fields["name"], fields["date"]) == ("Pointer", "2020-06")
    assert re.search(r'name="ensemble".*?<option value="false" selected>', form)
    changed = {**fields, "success": "11.6", "spl": "", "date": "", "ensemble": "false"}
    assert "Changed." in told(desk, "/desk/reported/1", **changed)
    with desk.server.state.database.reading() as session:
        (result,) = list_reported(session, Page()).rows
        details = entries(session)[-1].details
    assert (result.method.ensemble, result.date) == (False, None)
    assert details == {
        "before": {"scores": {"success": 0.11531, "spl": 0.07}, "date": "2020-06"},
        "after": {"scores": {"success": 0.116}, "date": None},
    }
    page = sending(desk, "/desk/reported/1", **changed | {"success": "116"})
    assert (page.status_code, "116 is not from 0 to 100" in said(page)) == (400, True)
    assert 'value="116"' in page.text
    assert sending(desk, "/desk/reported/2", **changed).status_code == 404


def test_a_pasted_table_is_looked_at_before_it_is_imported(desk: Visitor) -> None:
    text = f"team,SR,date\n{MARKUP},59.64,01/2026\nBlue,6,2025\nBlue,6,2025\nRed,7,\n"
    form = {"split": OPEN, "source": "An old leaderboard", "rates": "percent", "text": text}
    form["date"] = "06/2020"
    asked = sending(desk, "/desk/reported/import", **form)
    assert f"{MARKUP} {MARKUP} 2026-01 SR 59.64" in said(asked)
    assert "Red Red 2020-06 SR 7.00" in said(asked)
    assert "Line 4 repeats line 3." in said(asked)
    assert MARKUP not in asked.text
    with desk.server.state.database.reading() as session:
        assert list_reported(session, Page()).rows == []
    assert hidden(asked).keys() == {*form, "confirmed"}
    words = told(desk, "/desk/reported/import", **form, **YES)
    assert "Imported: 3 results added. Method" in words
    assert f"{MARKUP} {MARKUP} {OPEN} SR 59.64 2026-01" in words
    again = said(sending(desk, "/desk/reported/import", **form))
    assert f"Add 0 results to {OPEN}? The file has 4 results, of which 4 are on" in again


def test_problems_of_a_pasted_table_are_shown_beside_it(desk: Visitor) -> None:
    form = {"split": OPEN, "source": "Old", "rates": "percent", "text": "team,SR\nBlue,200\n,1"}
    form["date"] = ""  # a browser sends an empty field, too
    page = sending(desk, "/desk/reported/import", **form)
    assert page.status_code == 400
    assert "2 problems; nothing was changed." in said(page)
    assert "line 2: SR %: 200 is not from 0 to 100" in said(page)
    assert "Blue,200" in page.text


def test_a_reported_result_is_removed(desk: Visitor) -> None:
    told(desk, "/desk/reported", **RESULT, success="5")
    assert "from the leaderboard?" in said(sending(desk, "/desk/reported/1/remove"))
    assert "No reported results." in told(desk, "/desk/reported/1/remove", **YES)
    assert sending(desk, "/desk/reported/1/remove", **YES).status_code == 404
    assert sending(desk, f"/desk/reported/{2**40}/remove", **YES).status_code == 400


def test_a_notice_is_looked_at_before_it_is_posted(desk: Visitor) -> None:
    form = {"banner": f"Down {MARKUP}", "paused": "true"}
    asked = sending(desk, "/desk/notice", **form)
    assert MARKUP not in asked.text
    assert "Submissions will be paused." in said(asked)
    assert not desk.server.ask(None, "GET", "/server").json()["paused"]
    words = told(desk, "/desk/notice", **form, **YES)
    assert f"Down {MARKUP}" in words
    assert "Submissions are paused; this was posted 2026-03-02 12:00 UTC" in words
    assert "Submissions are paused." in said(desk.get("/desk"))
    assert f"Down {MARKUP}" in said(desk.server.client.get("/sign-in"))
    lifted = said(sending(desk, "/desk/notice", banner=""))
    assert "No page will have a banner Submissions will be accepted again." in lifted
    assert "Everyone will see this" not in lifted
    assert "Submissions are accepted" in told(desk, "/desk/notice", banner="", **YES)


def test_phases_are_looked_at_before_they_are_changed(desk: Visitor) -> None:
    form = {"split": PRIVATE, "release_scores": "phase-end"}
    form |= {"name-0": "always", "opens-0": "", "closes-0": "2026-04-01"}
    form |= {"name-1": MARKUP, "opens-1": "2026-05-01", "closes-1": "2026-06-01"}
    asked = sending(desk, "/desk/phases", **form)
    assert MARKUP not in asked.text
    assert "Scores that are shown now stay visible." in said(asked)
    assert "will be shown at once" not in said(asked)
    words = told(desk, "/desk/phases", **form, **YES)
    assert f"{MARKUP}: from 2026-05-01 00:00 UTC until 2026-06-01 23:59 UTC" in words
    assert "always: until 2026-04-01 23:59 UTC open" in words
    again = sending(desk, "/desk/phases", split=PRIVATE, **{"name-0": "a", "closes-0": "soon"})
    assert again.status_code == 400
    assert 'value="soon"' in again.text
    assert "is paused" not in said(desk.get("/desk"))
    for what, outcome in {
        "pause": "always: until 2026-04-01 23:59 UTC paused",
        "resume": "always: until 2026-04-01 23:59 UTC open",
        "close": "always: until 2026-03-02 11:59 UTC",  # noon itself is too late
        "reset": "test always not changed always open",
    }.items():
        assert outcome in told(desk, "/desk/phases", split=PRIVATE, what=what, **YES)


@pytest.mark.parametrize("what", ["pause", "resume"])
def test_phases_that_are_set_meanwhile_stay(
    what: str, desk: Visitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    server, perform, paused = desk.server, Call.perform, what == "pause"
    new = NewSchedule(phases=(Phase(name="late"),), release_scores="at-once", paused=not paused)

    def perform_late(call: Call, *given: Any) -> Any:
        with server.acting() as transaction:
            server.state.get(Schedules).set(transaction, PRIVATE, new)
        return perform(call, *given)

    monkeypatch.setattr(Call, "perform", perform_late)
    told(desk, "/desk/phases", split=PRIVATE, what=what, **YES)
    with server.state.database.reading() as session:
        latest = server.state.get(Schedules).of_split(session, PRIVATE).latest
    assert ([phase.name for phase in latest.phases], latest.paused) == (["late"], paused)


def test_it_is_said_that_scores_will_be_shown(desk: Visitor) -> None:
    server = desk.server
    with server.acting() as transaction:
        until = Phase(name="a", closes=NOON + timedelta(days=1))
        new = NewSchedule(phases=(until,), release_scores="phase-end")
        server.state.get(Schedules).set(transaction, PRIVATE, new)
    server.upload(OWNER, submission_for(PRIVATE), PRIVATE)
    asked = said(sending(desk, "/desk/phases", split=PRIVATE, what="reset"))
    assert "The scores of 1 submission will be shown at once. This cannot be undone." in asked


def test_a_snapshot_is_taken_after_a_question(desk: Visitor) -> None:
    form = {"split": OPEN, "title": f"CVPR {MARKUP}"}
    asked = sending(desk, "/desk/snapshots", **form)
    assert "can be neither changed nor removed" in said(asked)
    words = told(desk, "/desk/snapshots", **form, **YES)
    assert f"{OPEN} 1 CVPR {MARKUP} 2026-03-02 12:00 UTC" in words
    assert f"CVPR {MARKUP}, as of" in said(desk.get(f"/splits/{OPEN}"))
    shown = desk.server.client.get(f"/splits/{OPEN}/snapshots/1")
    assert MARKUP not in shown.text
    assert "Nothing had been published." in said(shown)
    assert sending(desk, "/desk/snapshots", split="none", title="x").status_code == 404


def test_a_team_and_its_people_are_added(desk: Visitor) -> None:
    assert "Team added." in told(desk, "/desk/people/teams", name=MARKUP)
    person = {"name": "Dora", "team": MARKUP, "role": "participant"}
    assert f"{MARKUP} Dora" in told(desk, "/desk/people", **person)
    twice = sending(desk, "/desk/people", **person)
    assert twice.status_code == 409
    assert f"The team {MARKUP!r} already has a person 'Dora'" in said(twice)


def test_an_organiser_is_added_once_it_was_asked_twice(desk: Visitor) -> None:
    person = {"name": "Dora", "team": "Red", "role": "organiser"}
    assert "Make Dora an organiser?" in said(sending(desk, "/desk/people", **person))
    told(desk, "/desk/people", **person, **YES)
    with desk.server.state.database.reading() as session:
        assert person_named(session, "Dora").role == "organiser"


def test_a_team_is_renamed(desk: Visitor) -> None:
    words = told(desk, "/desk/people/teams/rename", team="Red", name=MARKUP)
    assert "Team renamed. Receipts keep the old name." in words
    assert MARKUP in words
    taken = sending(desk, "/desk/people/teams/rename", team="Blue", name=MARKUP)
    assert (taken.status_code, 'id="new-name"' in taken.text) == (409, True)


@pytest.mark.parametrize("kind", ["invite", "access"])
def test_a_token_is_shown_once(kind: str, desk: Visitor) -> None:
    form = {"person": "1", "kind": kind, "expires_at": "2026-03-31"}
    page = sending(desk, "/desk/people/tokens", **form)
    (text,) = set(re.findall(r"rv_[\w-]{43}", page.text))
    assert (page.status_code, page.headers["cache-control"]) == (200, "no-store")
    assert "It expires 2026-03-31 23:59 UTC." in said(page)
    assert "at http://server/sign-in" in said(page)
    with desk.server.state.database.reading() as session:
        token = list_tokens(session, Page()).rows[0]
    assert (token.kind, token.hint) == (kind, text[:11])
    assert text not in desk.get("/desk/people").text
    assert text[:11] in desk.get("/desk/people").text


def test_a_person_is_not_said_to_have_been_in_a_team_before_they_were(desk: Visitor) -> None:
    sending(desk, "/desk/people/1", name="Ada", team="Red")
    words = said(desk.get("/desk/people/1"))
    assert re.search(r"Participant in Red, added [-\d]+ [:\d]+ UTC\.", words)


@pytest.mark.parametrize("until", ["yesterday", "2026-02-30"])
def test_a_date_is_a_date(until: str, desk: Visitor) -> None:
    form = {"person": "1", "kind": "invite", "expires_at": until}
    page = sending(desk, "/desk/people/tokens", **form)
    told = f"'{until}' is not a day; write it as 2027-06-01"
    assert (page.status_code, told in said(page)) == (400, True)


def test_phases_that_overlap_are_shown_again_with_what_to_change(desk: Visitor) -> None:
    form = {"split": PRIVATE, "name-0": "always", "name-1": "next", "opens-1": "2026-05-01"}
    page = sending(desk, "/desk/phases", **form)
    told = "'always' must close before 'next' opens; change it at /desk/phases or with"
    assert (page.status_code, told in said(page)) == (409, True)
    assert 'value="2026-05-01"' in page.text


def test_a_phase_has_a_name(desk: Visitor) -> None:
    page = sending(desk, "/desk/phases", split=OPEN, **{"name-0": "", "opens-0": "2026-05-01"})
    told = "Phase 1, name: required but missing"
    assert (page.status_code, told in said(page)) == (400, True)


def test_a_phase_that_closes_before_it_opens_is_named_as_on_the_page(desk: Visitor) -> None:
    times = {"name-0": "a", "opens-0": "2026-05-02", "closes-0": "2026-05-01"}
    page = sending(desk, "/desk/phases", split=OPEN, **times)
    told = "Phase 1: a phase must open before it closes"
    assert (page.status_code, told in said(page)) == (400, True)


def test_an_invitation_is_not_over_before_it_is_made(desk: Visitor) -> None:
    form = {"person": "1", "kind": "invite", "expires_at": "2026-03-01"}
    page = sending(desk, "/desk/people/tokens", **form)
    assert page.status_code == 400
    assert "The expiry time is in the past; choose a later time" in said(page)
    for path in ("/desk/people", "/desk/quotas"):
        assert 'name="expires_at" type="date" min="2026-03-02"' in desk.get(path).text


def test_a_token_is_revoked_once_it_was_asked_twice(desk: Visitor) -> None:
    hint = desk.server.tokens[OWNER][:11]
    path = f"/desk/people/tokens/{hint}/revoke"
    assert f"Revoke the token that begins with {hint}?" in said(sending(desk, path))
    assert desk.server.ask(OWNER, "GET", "/me").status_code == 200
    assert "Token revoked." in told(desk, path, **YES)
    assert desk.server.ask(OWNER, "GET", "/me").status_code == 401
    nobodys = "/desk/people/tokens/rv_12345678/revoke"
    assert sending(desk, nobodys, **YES).status_code == 404


@pytest.mark.parametrize(
    ("csrf_token", "status"),
    [pytest.param(None, 200, id="read"), pytest.param("x", 403, id="refused")],
)
def test_the_file_of_a_form_is_closed(
    csrf_token: str | None, status: int, desk: Visitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = []
    close = UploadFile.close

    async def note(file: UploadFile) -> None:
        closed.append(file.filename)
        await close(file)

    monkeypatch.setattr(UploadFile, "close", note)
    people = b"team,person\nGreen,Dora\n"
    reply = desk.send("/desk/people/import", {}, csrf_token=csrf_token, file=people)
    assert (reply.status_code, closed) == (status, ["answers.json"])


def test_uploads_are_drawn_if_there_are_any(desk: Visitor) -> None:
    assert "No uploads in the last 24 hours." in said(desk.get("/desk"))
    sent(desk.server)
    page = desk.get("/desk")
    assert 'class="hours"' in page.text
    assert "No uploads" not in said(page)


def test_snapshots_are_paged(desk: Visitor) -> None:
    with desk.server.acting() as transaction:
        for number in range(1, forms.ON_A_PAGE + 2):
            snapshot = StoredSnapshot(
                split=OPEN,
                number=number,
                title=f"State {number}",
                as_of=NOON,
                envelope={},
                created_at=NOON,
            )
            transaction.session.add(snapshot)
    first = desk.get("/desk/snapshots")
    assert first.text.count(">State ") == forms.ON_A_PAGE
    (following,) = re.findall(r'rel="next" href="([^"]+)"', first.text)
    second = desk.get(f"/desk/snapshots{following}")
    assert re.findall(r">(State \d+)<", second.text) == ["State 1"]
    assert 'rel="next"' not in second.text


def test_more_is_given_with_the_reason_on_record(desk: Visitor) -> None:
    form = {"team": "Blue", "split": PRIVATE, "extra": "2", "reason": "our disk was full"}
    assert f'<option value="{PRIVATE}"' in desk.get("/desk/quotas").text
    words = told(desk, "/desk/quotas", **form, expires_at="2026-03-31")
    assert f"Blue {PRIVATE} 2 our disk was full 2026-03-02 12:00 UTC 2026-03-31 23:59 UTC" in words
    for until, status in {"2026-03-01": 400, "": 400}.items():
        page = sending(desk, "/desk/quotas", **form, expires_at=until)
        assert (page.status_code, 'value="our disk was full"' in page.text) == (status, True)
    with desk.server.state.database.reading() as session:
        assert len(list_grants(session, Page()).rows) == 1


def test_the_audit_log_is_paged_and_searched(desk: Visitor) -> None:
    with desk.server.acting("Zoe") as transaction:
        team = team_named(transaction.session, "Blue")
        for number in range(forms.ENTRIES_ON_A_PAGE):
            transaction.record("did", team, f"thing {number}", found={"a": MARKUP})
    first = desk.get("/desk/audit?actor=Zoe")
    assert first.text.count(">did</td>") == forms.ENTRIES_ON_A_PAGE
    assert 'rel="next"' not in first.text
    assert MARKUP not in first.text
    assert said(desk.get("/desk/audit?subject=thing%207")).count("thing 7") == 1
    assert 'rel="next"' in desk.get("/desk/audit").text
    assert desk.get("/desk/audit?actor=%00").status_code == 200


def test_the_audit_log_says_whether_it_is_whole(desk: Visitor) -> None:
    assert "The entries on this page are unchanged." in said(desk.get("/desk/audit"))
    assert "The chain is unbroken." in said(desk.get("/desk/audit?whole=yes"))
    with desk.server.state.database.writing() as session:
        session.execute(update(AuditEntry).where(AuditEntry.id == 2).values(actor="nobody"))
    for query in ("", "?whole=yes"):
        words = said(desk.get(f"/desk/audit{query}"))
        assert "1 entry cannot be verified, first entry 2:" in words
        assert "unbroken" not in words


def test_what_is_on_another_page_of_the_log_is_checked_with_the_whole(desk: Visitor) -> None:
    with desk.server.acting("Zoe") as transaction:
        team = team_named(transaction.session, "Blue")
        for number in range(forms.ENTRIES_ON_A_PAGE):
            transaction.record("did", team, f"thing {number}")
        transaction.session.execute(
            update(AuditEntry).where(AuditEntry.id == 2).values(actor="nobody")
        )
    assert "are unchanged" in said(desk.get("/desk/audit"))
    assert "first entry 2:" in said(desk.get("/desk/audit?whole=yes"))


def test_the_desk_warns_of_a_disk_that_is_nearly_full(
    desk: Visitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    for free, is_told in (((1 << 30) - 1, True), (1 << 30, False)):
        usage = SimpleNamespace(free=free, total=1 << 40)
        monkeypatch.setattr(shutil, "disk_usage", lambda _, usage=usage: usage)
        assert ("Free some space before uploads fail." in said(desk.get("/desk"))) == is_told


def test_an_upload_on_the_page_is_noted_too(server: Serving) -> None:
    signed_in(server, OWNER).upload()
    with server.state.database.reading() as session:
        assert [each.outcome for each in list_attempts(session, Page()).rows] == ["scored"]


# Corrections.


def test_the_desk_says_what_has_to_be_scored_again(
    server: Serving, folder: Path, open_server: OpenServer
) -> None:
    name = sent(server)
    bundle = Bundle.load(folder / "bundles" / f"{OPEN}.npz")
    changed = with_arrays(bundle, task_target=bundle.arrays["task_target"] + 1)
    changed.save(folder / "bundles" / "changed.npz")
    settings = adjusted(settings_of(folder), OPEN, bundle="bundles/changed.npz")
    later = open_server(settings, server.tokens)
    desk = signed_in(later, ORGANISER)
    page = said(desk.get("/desk/corrections"))
    assert "reverie-eval server rescore FOLDER SPLIT --bundle corrected.npz" in page
    assert "1 result to be scored again" in page
    assert f"reverie-eval server rescore FOLDER {OPEN} --reason" in page
    rescored(later, reason=MARKUP)
    answer = desk.get("/desk/corrections")
    assert "All submissions were scored with the current ground truth" in said(answer)
    assert MARKUP in said(answer), "its text, not its effect"
    assert MARKUP not in answer.text
    assert "Earlier results" in said(signed_in(later, OWNER).get(f"/submissions/{name}"))
