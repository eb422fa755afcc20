"""``/submissions/{id}`` and ``/team``: what a team sees and does, and what everybody sees."""

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from reverie_eval.metrics import ABSTAINED
from reverie_eval.receipts import verify
from reverie_eval.schemas.service import Envelope
from reverie_eval.server.boards.reviews import lift_review
from reverie_eval.server.settings import Quota
from tests.conftest import SAMPLES
from tests.support.acting import add_person, add_team, create_token, review
from tests.support.entries import entered, named
from tests.support.serving import (
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
    settings_of,
    submission_for,
)
from tests.support.visiting import Visitor, said, signed_in

MARKUP = "<script>alert(1)</script>"


@pytest.fixture
def owner(server: Serving) -> Visitor:
    return signed_in(server, OWNER)


def sent(server: Serving, split: str = OPEN, **method: str) -> str:
    """Send a submission of the owner's and return its id."""
    reply = server.upload(OWNER, submission_for(split), split, **method)
    return str(reply.json()["submission"]["id"])


def changed(owner: Visitor, submission: str, **fields: str) -> str:
    """Send one of the page's small forms and return what the page says then."""
    reply = owner.send(f"/submissions/{submission}", fields)
    assert reply.status_code == 303
    return said(owner.get(reply.headers["location"]))


def test_the_team_sees_all_of_it(owner: Visitor) -> None:
    submission = sent(owner.server, description="Walks.", paper="https://example.org/p")
    report = owner.server.ask(OWNER, "GET", f"/submissions/{submission}").json()["report"]
    page = owner.get(f"/submissions/{submission}")
    words = said(page)
    assert page.status_code == 200
    assert "unpublished val_unseen, Blue, submitted by Ada 2026-03-02 12:00 UTC" in words
    assert f"RGSPL % {100 * report['scores']['rgspl']:.2f}" in words
    assert "Success rate: the target object is visible where the agent stops." in words
    assert report["signature"] in words
    assert f'"submission_id": "{submission}"' in words
    assert "199 of 200 per 24 hours; one more from 2026-03-03 12:00 UTC" in words
    assert '<a href="https://example.org/p" rel="nofollow noopener noreferrer">Paper' in page.text


def test_boxes_are_shown_beside_what_chance_would_have_done(owner: Visitor) -> None:
    content = (SAMPLES / "drawn.json").read_bytes()
    reply = owner.server.upload(OWNER, content, OPEN).json()
    words = said(owner.get(f"/submissions/{reply['submission']['id']}"))
    assert "Predicted boxes 81, of which 47 are correct Mean IoU 55.48 %" in words
    assert "A box around the whole image would be correct in 3.70 %" in words
    assert "Ambiguous views 0.00 % of the views that show the target" in words


def test_what_can_be_downloaded_is_what_was_sent_and_signed(owner: Visitor) -> None:
    submission = sent(owner.server)
    links = re.findall(
        r'href="(/api/v1/[^"]+)" download=', owner.get(f"/submissions/{submission}").text
    )
    receipt, file, episodes = (owner.get(link) for link in links)
    verify(Envelope.model_validate_json(receipt.text), owner.server.ask(None, "GET", "/key").text)
    assert file.content == GOOD
    assert len(episodes.text.splitlines()) == 85  # the header, and the split's 84 episodes


def test_of_a_private_split_no_episode_is_led_to(owner: Visitor) -> None:
    page = owner.get(f"/submissions/{sent(owner.server, PRIVATE)}").text
    assert "/episodes" not in page.partition("<h1")[2]


def test_a_warning_of_what_will_cost_points(owner: Visitor) -> None:
    records = [{**record, "predObjId": ABSTAINED} for record in json.loads(GOOD)]
    location = owner.upload(json.dumps(records).encode()).headers["location"]
    assert "no answer predicts an object: RGS will be 0" in said(owner.get(location))


def test_publishing_and_taking_back(owner: Visitor) -> None:
    submission, nobody = sent(owner.server), Visitor(owner.server)
    path = f"/submissions/{submission}"
    assert nobody.get(path).status_code == 404
    assert "The submission is published: see it on the leaderboard." in changed(
        owner, submission, published="true"
    )
    assert nobody.get(path).status_code == 200
    changed(owner, submission, published="false")
    assert nobody.get(path).status_code == 404
    changed(owner, submission, published="true")
    assert "The submission is withdrawn." in changed(owner, submission, withdrawn="true")
    assert nobody.get(path).status_code == 404
    assert "The submission is published" in changed(owner, submission, withdrawn="false")
    history = said(owner.get(path)).partition("History")[2]
    events = [
        "received and scored",
        "published",
        "unpublished",
        "published",
        "withdrawn",
        "restored",
    ]
    assert re.findall(r"UTC ([\w ]+), by Ada", history) == events


def test_a_withdrawn_submission_is_not_published(owner: Visitor) -> None:
    submission = sent(owner.server)
    changed(owner, submission, withdrawn="true")
    reply = owner.send(f"/submissions/{submission}", {"published": "true"})
    assert reply.status_code == 409
    assert "Nothing was changed. A withdrawn submission cannot be published" in said(reply)
    assert 'name="published"' not in reply.text


def test_what_everybody_sees_of_a_published_submission(owner: Visitor) -> None:
    submission = sent(
        owner.server, description="Walks.", code="https://example.org/c", extra_data="true"
    )
    owner.server.clock.turn(hours=1)
    changed(owner, submission, published="true")
    visitors: list[Visitor] = [Visitor(owner.server), signed_in(owner.server, OTHER)]
    for visitor in visitors:
        page = visitor.get(f"/submissions/{submission}")
        words = said(page).partition("Walker")[2]
        assert "Blue, on val_unseen, published 2026-03-02 13:00 UTC" in words
        assert "Walks." in words
        assert "Extra data Yes Trained on more than the benchmark's training split." in words
        assert "Ensemble Not declared Several models decide together." in words
        assert "split:val_unseen|protocol:official-v1|" in words
        assert "95 % confidence intervals by a bootstrap over 29 targets" in words
        assert 'href="https://example.org/c"' in page.text
        for own in (
            OWNER,
            "/episodes/",
            "payload",
            "receipt",
            "History",
            "submissions left",
            "Withdraw",
            "/api/v1/submissions",
        ):
            assert own not in words
            assert own not in page.text.partition("<h1")[2]


@pytest.mark.parametrize(("who", "status"), [(MATE, 200), (ORGANISER, 200), (OTHER, 404)], ids=str)
def test_whose_page_an_unpublished_submission_is(server: Serving, who: str, status: int) -> None:
    submission = sent(server)
    visitor = signed_in(server, who)
    reply = visitor.get(f"/submissions/{submission}")
    assert reply.status_code == status
    assert ("Walker" in reply.text) is (status == 200)
    assert ("/desk/reviews?" in reply.text) is (who == ORGANISER)
    change = visitor.send(f"/submissions/{submission}", {"published": "true"})
    assert change.status_code == (303 if status == 200 else 404)


@pytest.mark.parametrize("name", ["0000000000000000", "..%2F..%2Fetc", "%00", "é"])
def test_there_is_no_such_submission(owner: Visitor, name: str) -> None:
    for visitor in (owner, Visitor(owner.server)):
        assert visitor.get(f"/submissions/{name}").status_code == 404


def test_an_anonymous_team_is_nowhere_named(owner: Visitor) -> None:
    submission = sent(owner.server)
    page = changed(owner, submission, published="true", anonymous_until="2026-04-01")
    assert "Blue (hidden on the leaderboard)" in page
    assert "The leaderboard does not name your team until 2026-04-01 00:00 UTC" in page
    assert "published; team hidden until 2026-04-01, by Ada" in page
    owner.server.clock.turn(days=29, hours=12, seconds=-1)
    for visitor in (Visitor(owner.server), signed_in(owner.server, OTHER)):
        for path in (f"/submissions/{submission}", f"/splits/{OPEN}"):
            text = visitor.get(path).text
            assert "nonymous" in text
            assert not re.search(r"\b(Blue|Ada|Ben)\b", text)
    owner.server.clock.turn(seconds=1)
    for visitor in (Visitor(owner.server), signed_in(owner.server, OTHER)):
        assert "Blue, on val_unseen" in said(visitor.get(f"/submissions/{submission}"))


def test_an_anonymous_team_is_named_when_it_wants_to_be(owner: Visitor) -> None:
    submission = sent(owner.server)
    changed(owner, submission, published="true", anonymous_until="2026-04-01")
    assert "The leaderboard names your team." in changed(owner, submission, anonymous_until="")
    assert "Blue, on val_unseen" in said(Visitor(owner.server).get(f"/submissions/{submission}"))


def test_renaming_and_editing(owner: Visitor) -> None:
    submission = sent(owner.server, paper="https://example.org/p", ensemble="true")
    fields = {"name": "Runner", "description": "Runs.", "paper": "", "ensemble": "false"}
    assert "Runner" in changed(owner, submission, **fields)
    method = owner.server.ask(OWNER, "GET", f"/submissions/{submission}").json()["method"]
    assert (method["name"], method["description"]) == ("Runner", "Runs.")
    assert (method["paper"], method["ensemble"]) == (None, False)
    page = said(owner.get(f"/submissions/{submission}"))
    assert "edited: name, description, paper, ensemble, by Ada" in page


# What a form may send that comes to nothing, and what the page says of it.
WRONG = [
    pytest.param(
        {"name": "", "description": "kept"}, "Name: must have 1 or more characters", id="no name"
    ),
    pytest.param(
        {"name": "x", "paper": "ftp://a", "description": "kept"},
        "Paper: must be a link",
        id="a link",
    ),
    pytest.param({"anonymous_until": "soon"}, "Hide the team until: must be a time", id="no date"),
    pytest.param({"anonymous_until": "9999-01-01"}, "in the years 2000 to 2999", id="a far date"),
    pytest.param({"published": "perhaps"}, "Published: must be true or false", id="no switch"),
]


@pytest.mark.parametrize(("fields", "fault"), WRONG)
def test_what_is_wrong_changes_nothing_and_is_kept(
    owner: Visitor, fields: Mapping[str, str], fault: str
) -> None:
    submission = sent(owner.server)
    before = owner.server.ask(OWNER, "GET", f"/submissions/{submission}").json()
    reply = owner.send(f"/submissions/{submission}", fields)
    assert reply.status_code == 400
    assert "Nothing was changed." in said(reply)
    assert fault in said(reply)
    assert (">kept</textarea>" in reply.text) is ("description" in fields)
    assert owner.server.ask(OWNER, "GET", f"/submissions/{submission}").json() == before


@pytest.mark.parametrize(
    ("token", "headers", "status"),
    [
        pytest.param("", {}, 403, id="no token"),
        pytest.param("other", {}, 403, id="another's token"),
        pytest.param(None, {"Sec-Fetch-Site": "cross-site"}, 303, id="another site"),
    ],
)
def test_a_forged_form_changes_nothing(
    owner: Visitor, token: str | None, headers: Mapping[str, str], status: int
) -> None:
    submission = sent(owner.server)
    shown = signed_in(owner.server, MATE).csrf_token() if token == "other" else token
    reply = owner.send(
        f"/submissions/{submission}", {"published": "true"}, csrf_token=shown, headers=headers
    )
    assert reply.status_code == status
    assert "done=changed" not in reply.headers.get("location", "")
    assert Visitor(owner.server).get(f"/submissions/{submission}").status_code == 404


def test_what_people_wrote_is_escaped(owner: Visitor) -> None:
    server = owner.server
    with server.acting() as transaction:
        add_team(transaction, MARKUP)
        add_person(transaction, MARKUP, f"Eve {MARKUP}")
        token = create_token(transaction, f"Eve {MARKUP}").token
    visitor = signed_in(replace(server, tokens={"Eve": token}), "Eve")
    location = visitor.upload(name=MARKUP, description=MARKUP).headers["location"]
    submission = location.partition("?")[0]
    visitor.send(submission, {"published": "true"})
    with server.acting(f"Olga {MARKUP}") as transaction:
        review(transaction, submission.rpartition("/")[2], "flagged", MARKUP)
    for page in (visitor.get(location), visitor.get("/team"), Visitor(server).get(submission)):
        assert page.status_code == 200
        assert MARKUP not in page.text
        assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page.text


def test_reviews_stand_with_who_when_and_why(owner: Visitor) -> None:
    submission = sent(owner.server)
    changed(owner, submission, published="true")
    owner.server.clock.turn(hours=2)
    with owner.server.acting(ORGANISER) as transaction:
        review(transaction, submission, "verified", "We ran its code.")
        lift_review(transaction, review(transaction, submission, "baseline", "Not so.").id)
    for visitor in (owner, Visitor(owner.server)):
        page = said(visitor.get(f"/submissions/{submission}"))
        assert "verified We ran its code. The organiser, 2026-03-02 14:00 UTC" in page
        assert "baseline Not so." not in page
    history = said(owner.get(f"/submissions/{submission}"))
    assert "verified, by the organiser: We ran its code." in history
    assert "no longer baseline, by the organiser" in history


def test_a_disqualified_submission_cannot_be_taken_off_the_board(owner: Visitor) -> None:
    submission = sent(owner.server)
    changed(owner, submission, published="true")
    with owner.server.acting(ORGANISER) as transaction:
        review(transaction, submission, "disqualified", "Copied.")
    page = owner.get(f"/submissions/{submission}")
    assert "it cannot be unpublished or withdrawn" in said(page)
    assert 'name="withdrawn"' not in page.text
    assert 'name="published"' not in page.text
    for field in ({"withdrawn": "true"}, {"published": "false"}):
        reply = owner.send(f"/submissions/{submission}", field)
        assert reply.status_code == 409
        assert "it cannot be unpublished or withdrawn" in said(reply)


def test_the_team_s_page(open_server: OpenServer, folder: Path) -> None:
    tight = adjusted(settings_of(folder), quota=Quota(day=1))
    server = open_server(tight)
    sent(server, PRIVATE, name="Private walker")
    server.clock.turn(hours=1)
    sent(server, name="Open walker")
    page = said(signed_in(server, MATE).get("/team"))
    assert "Blue Ada, Ben (you)" in page
    assert page.index("Open walker") < page.index("Private walker")
    assert (
        "test 0 submissions left 0 of 1 per 24 hours; one more from 2026-03-03 12:00 UTC "
        "9 of 10 per 30 days" in page
    )
    assert server.tokens[MATE][:11] in page
    assert server.tokens[MATE] not in page
    assert server.tokens[OWNER][:11] not in page
    assert "valid (this session)" in page
    other = said(signed_in(server, OTHER).get("/team"))
    assert "No submissions yet." in other
    assert "walker" not in other


def test_the_team_s_submissions_are_drawn_over_time(server: Serving) -> None:
    team = signed_in(server, OWNER)
    sent(server, name="O'Hara's <first>")
    sent(server, PRIVATE)
    assert "Over time" not in said(team.get("/team"))  # one submission a split is no course
    server.clock.turn(hours=1)
    server.upload(OWNER, submission_for(PRIVATE, "shortest"), PRIVATE, name="<b>Better</b>")
    page = team.get("/team")
    marks = re.findall(r"<circle [^>]*><title>([^:]*):", page.text)
    assert sorted(marks) == ["&lt;b&gt;Better&lt;/b&gt;", "Walker"]
    assert f"RGSPL % of each submission to {PRIVATE}" in said(page)


def test_a_new_result_says_where_it_would_be(server: Serving) -> None:
    submission = server.upload(OWNER, server.distinct()).json()["submission"]
    own = 100 * submission["report"]["scores"]["rgspl"]
    assert 10 < own < 71.89
    visitor, path = signed_in(server, OWNER), f"/submissions/{submission['id']}"
    alone = "On the leaderboard, this would be the only result with a rank."
    assert alone in said(visitor.get(path))
    entered(server, {"rgspl": 0.7189}, OTHER, **named("Ant"))
    entered(server, {"rgspl": 0.1}, OTHER, **named("Bee"))
    page = said(visitor.get(path))
    ranked = "this would be 2nd of 3 by RGSPL; the best of the others has 71.89."
    assert f"On the leaderboard, {ranked}" in page
    assert page.index("would be 2nd") < page.index("Publish") < page.index("Submissions left")
    visitor.send(path, {"published": "true"})
    assert "would be" not in said(visitor.get(path))
