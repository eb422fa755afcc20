"""What the organiser says of submissions, and results that papers report."""

from collections.abc import Mapping, Sequence
from typing import Any

import httpx
import pytest
from pydantic import ValidationError

from reverie_eval.schemas.organising import NewReported
from reverie_eval.schemas.service import Verdict
from reverie_eval.schemas.wire import LONGEST_LINE
from reverie_eval.server.audit.log import audit_reports, entries
from reverie_eval.server.boards.reported import reported_of
from reverie_eval.server.boards.reviews import (
    is_disqualified,
    latest_submissions,
    lift_review,
    list_reviews,
    review_rows,
    standing_reviews,
)
from reverie_eval.server.errors import ConflictError, NotFoundError
from reverie_eval.server.store.paging import Page
from tests.support.acting import review
from tests.support.serving import OPEN, ORGANISER, OWNER, PRIVATE, Serving

WHY = "we ran its code"
PAPER = "https://example.org/paper"


def sent(server: Serving, split: str = OPEN) -> str:
    """Send a submission of the owner's and return its id."""
    reply = server.upload(OWNER, server.distinct(split), split)
    return str(reply.json()["submission"]["id"])


def say(server: Serving, submission_id: str, verdict: Verdict, reason: str = WHY) -> int:
    """Say something of a submission and return the review's number."""
    with server.acting(ORGANISER) as transaction:
        return review(transaction, submission_id, verdict, reason).id


def standing(server: Serving, submission_id: str) -> Sequence[str]:
    with server.state.database.reading() as session:
        return [said.verdict for said in standing_reviews(session, submission_id)]


def logged(server: Serving, subject: str) -> Sequence[tuple[str, str, Mapping[str, Any]]]:
    with server.state.database.reading() as session:
        assert list(server.state.audit_log.broken_links(session)) == []
        return [
            (entry.actor, entry.action, entry.details)
            for entry in audit_reports(session, entries(session))
            if entry.subject == subject
        ]


@pytest.mark.parametrize(
    ("verdicts", "expected"),
    [
        pytest.param(["verified"], ["verified"], id="one"),
        pytest.param(["verified", "verified"], ["verified"], id="once more"),
        pytest.param(["verified", "flagged"], ["flagged"], id="a doubt"),
        pytest.param(["flagged", "disqualified"], ["disqualified"], id="a doubt that was right"),
        pytest.param(["disqualified", "verified"], ["verified"], id="that was wrong"),
        pytest.param(["baseline", "verified"], ["baseline", "verified"], id="a verified baseline"),
        pytest.param(["flagged", "baseline"], ["flagged", "baseline"], id="a doubtful baseline"),
        pytest.param(["baseline", "baseline"], ["baseline"], id="a baseline twice"),
    ],
)
def test_one_judgement_stands_and_a_baseline_beside_it(
    verdicts: Sequence[Verdict], expected: Sequence[Verdict], server: Serving
) -> None:
    submission_id = sent(server)
    for verdict in verdicts:
        say(server, submission_id, verdict)
    assert standing(server, submission_id) == expected


def test_a_lifted_review_does_not_stand_and_is_not_lifted_twice(server: Serving) -> None:
    submission_id = sent(server)
    number = say(server, submission_id, "flagged")
    server.clock.turn(hours=1)
    with server.acting(ORGANISER) as transaction:
        assert lift_review(transaction, number).lifted_at == server.clock()
    assert standing(server, submission_id) == []
    twice = f"^review {number} was already lifted$"
    with pytest.raises(ConflictError, match=twice), server.acting() as transaction:
        lift_review(transaction, number)
    missing = f"^there is no review {number + 1};"
    with pytest.raises(NotFoundError, match=missing), server.acting() as transaction:
        lift_review(transaction, number + 1)


def test_lists_of_reviews_and_submissions_begin_with_the_latest(server: Serving) -> None:
    early = sent(server)
    server.clock.turn(hours=1)
    late = sent(server)
    doubt = say(server, early, "flagged")
    proof = say(server, early, "disqualified")
    praise = say(server, late, "verified")
    baseline = say(server, late, "baseline")
    with server.state.database.reading() as session:
        everything = [baseline, praise, proof, doubt]
        assert [each.id for each in list_reviews(session, Page()).rows] == everything
        assert [each.id for each in list_reviews(session, Page(limit=1)).rows] == [baseline]
        current = review_rows(session, Page(), standing=True).rows
        lifted = review_rows(session, Page(), standing=False).rows
        assert [each.id for each in current] == [baseline, praise, proof]
        assert [each.id for each in lifted] == [doubt]
        assert [each.submission.id for each in current] == [late, late, early]
        assert [each.id for each in latest_submissions(session, 9)] == [late, early]
        assert [each.id for each in latest_submissions(session, 1)] == [late]
        assert [each.id for each in standing_reviews(session, early)] == [proof]
        assert [each.id for each in standing_reviews(session, late)] == [praise, baseline]


def test_a_review_is_reported_as_it_is_kept(server: Serving) -> None:
    submission_id = sent(server)
    with server.acting(ORGANISER) as transaction:
        report = review(transaction, submission_id, "flagged", WHY)
        assert report.model_dump() == {
            "id": report.id,
            "submission_id": submission_id,
            "verdict": "flagged",
            "reason": WHY,
            "created_at": server.clock(),
            "lifted_at": None,
        }
        assert not is_disqualified(standing_reviews(transaction.session, submission_id))
        lifted = lift_review(transaction, report.id)
        assert lifted == report.model_copy(update={"lifted_at": server.clock()})
        review(transaction, submission_id, "disqualified")
        review(transaction, submission_id, "baseline")
        assert is_disqualified(standing_reviews(transaction.session, submission_id))


DISAPPEARING = [
    pytest.param({"withdrawn": True}, id="withdrawn"),
    pytest.param({"published": False}, id="unpublished"),
    pytest.param({"withdrawn": True, "published": False}, id="both"),
]


@pytest.mark.parametrize("change", DISAPPEARING)
def test_what_is_disqualified_does_not_disappear(
    change: Mapping[str, bool], server: Serving
) -> None:
    submission_id = sent(server)
    path = f"/submissions/{submission_id}"
    server.ask(OWNER, "PATCH", path, json={"published": True})
    number = say(server, submission_id, "disqualified")
    refused = server.ask(OWNER, "PATCH", path, json=change)
    assert refused.status_code == 409
    assert "until the review is lifted, it cannot be unpublished" in refused.json()["detail"]
    assert server.ask(OWNER, "GET", path).json()["status"] == "published"
    hidden = {"anonymous_until": "2026-12-31T00:00:00Z", "published": True}
    assert server.ask(OWNER, "PATCH", path, json=hidden).status_code == 200
    with server.acting(ORGANISER) as transaction:
        lift_review(transaction, number)
    assert server.ask(OWNER, "PATCH", path, json=change).status_code == 200


def test_whatever_is_said_is_written_down_also_what_it_takes_the_place_of(server: Serving) -> None:
    submission_id = sent(server)
    say(server, submission_id, "flagged", " doubtful ")
    say(server, submission_id, "disqualified", "proven")
    assert logged(server, submission_id)[1:] == [
        (ORGANISER, "flagged", {"submission_id": submission_id, "reason": "doubtful"}),
        (ORGANISER, "review lifted", {"verdict": "flagged"}),
        (ORGANISER, "disqualified", {"submission_id": submission_id, "reason": "proven"}),
    ]


@pytest.mark.parametrize(
    "reason",
    [
        pytest.param("", id="none"),
        pytest.param("  ", id="blank"),
        pytest.param("one\ntwo", id="two lines"),
        pytest.param("\u202eback", id="turned round"),
        pytest.param("x" * (LONGEST_LINE + 1), id="a letter too long"),
    ],
)
def test_a_reason_is_a_line(reason: str, server: Serving) -> None:
    submission_id = sent(server)
    with pytest.raises(ValidationError, match="reason"):
        say(server, submission_id, "verified", reason)
    assert standing(server, submission_id) == []


def test_the_longest_reason_is_kept(server: Serving) -> None:
    submission_id = sent(server)
    say(server, submission_id, "verified", "x" * LONGEST_LINE)
    assert standing(server, submission_id) == ["verified"]


@pytest.mark.parametrize("submission_id", ["nobodys", "", "a\0b", "../x"])
def test_nothing_is_said_of_what_is_not_there(submission_id: str, server_on: Serving) -> None:
    with pytest.raises(NotFoundError) as refused:
        say(server_on, submission_id, "verified")
    told = f"there is no submission {submission_id!r}; see the list of submissions"
    assert str(refused.value) == told


def test_reviews_are_listed_the_latest_first_and_shown_the_earliest_first(server: Serving) -> None:
    submission_id = sent(server)
    say(server, submission_id, "verified")
    say(server, submission_id, "baseline")
    listed = server.ask(ORGANISER, "GET", "/organiser/reviews").json()
    assert [said["verdict"] for said in listed] == ["baseline", "verified"]
    with server.state.database.reading() as session:
        shown = standing_reviews(session, submission_id)
    assert [said.verdict for said in shown] == ["verified", "baseline"]


def test_over_http(server: Serving) -> None:
    submission_id = sent(server)
    new = {"submission_id": submission_id, "verdict": "flagged", "reason": WHY}
    said = server.ask(ORGANISER, "POST", "/organiser/reviews", json=new).json()
    assert (said["verdict"], said["lifted_at"]) == ("flagged", None)
    assert server.ask(ORGANISER, "GET", "/organiser/reviews").json() == [said]
    path = f"/organiser/reviews/{said['id']}"
    lifted = server.ask(ORGANISER, "DELETE", path)
    assert (lifted.status_code, lifted.json()["lifted_at"]) == (200, "2026-03-02T12:00:00Z")
    assert server.ask(ORGANISER, "DELETE", path).json()["code"] == "conflict"
    new["submission_id"] = "nobodys"
    assert server.ask(ORGANISER, "POST", "/organiser/reviews", json=new).status_code == 404


def report(server: Serving, **changes: object) -> httpx.Response:
    """Enter a result that a paper reports."""
    new = {
        "split": OPEN,
        "method": {"name": "Pointer", "paper": PAPER},
        "team": "Qi et al., 2020",
        "scores": {"success": 0.1153, "path_length": 12.3},
        "source": PAPER,
        **changes,
    }
    return server.ask(ORGANISER, "POST", "/organiser/reported", json=new)


def test_what_a_paper_reports_is_kept_as_it_was_reported(server: Serving) -> None:
    added = report(server)
    assert added.status_code == 201
    assert server.ask(ORGANISER, "GET", "/organiser/reported").json() == [added.json()]
    with server.state.database.reading() as session:
        (result,) = reported_of(session, OPEN)
        assert result.scores == {"success": 0.1153, "path_length": 12.3}
        assert list(reported_of(session, PRIVATE)) == []
    told = {name: value for name, value in added.json().items() if name in NewReported.model_fields}
    assert logged(server, "Pointer") == [(ORGANISER, "reported result added", told)]


def test_what_is_removed_is_on_no_board_and_can_be_entered_again(server: Serving) -> None:
    number = report(server).json()["id"]
    assert report(server).json()["code"] == "conflict"
    path = f"/organiser/reported/{number}"
    assert server.ask(ORGANISER, "DELETE", path).status_code == 200
    assert server.ask(ORGANISER, "DELETE", path).status_code == 404
    assert server.ask(ORGANISER, "GET", "/organiser/reported").json() == []
    assert report(server).status_code == 201
    actions = [action for _, action, _ in logged(server, "Pointer")]
    assert actions == ["reported result added", "reported result removed", "reported result added"]


@pytest.mark.parametrize(
    ("changes", "status", "told"),
    [
        pytest.param({"scores": {"success": 1.0}}, 201, "", id="all of it"),
        pytest.param({"scores": {"success": 0}}, 201, "", id="none of it"),
        pytest.param({"scores": {"success": 52.5}}, 400, "a fraction from 0 to 1", id="percent"),
        pytest.param({"scores": {"success": -0.1}}, 400, "a fraction", id="below 0"),
        pytest.param({"scores": {"path_length": 99.5}}, 201, "", id="metres"),
        pytest.param({"scores": {"path_length": -1}}, 400, "0 or more", id="metres below 0"),
        pytest.param({"scores": {"bleu": 0.5}}, 400, "there is no metric 'bleu'", id="no metric"),
        pytest.param({"scores": {}}, 400, "must have 1 or more entries", id="no score"),
        pytest.param({"split": "train"}, 404, "there is no split 'train'", id="no split"),
        pytest.param({"source": "http://example.org"}, 400, "source", id="no https"),
        pytest.param({"source": "javascript:alert(1)"}, 400, "source", id="no address"),
        pytest.param({"team": " "}, 400, "team", id="nobody reports it"),
    ],
)
def test_only_results_are_reported(
    changes: Mapping[str, object], status: int, told: str, server: Serving
) -> None:
    reply = report(server, **changes)
    assert reply.status_code == status, reply.text
    assert told in reply.text


def test_a_score_that_is_no_number_is_refused(server: Serving) -> None:
    body = report(server).request.content.replace(b"0.1153", b"1e999")
    reply = server.ask(
        ORGANISER,
        "POST",
        "/organiser/reported",
        content=body.replace(b"Pointer", b"Other"),
        headers={"Content-Type": "application/json"},
    )
    assert reply.status_code == 400
