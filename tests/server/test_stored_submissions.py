"""Stored submissions: who sees what of them, in which order, and what a change changes."""

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from sqlalchemy import select

from reverie_eval.schemas.service import EarlierResult, Method, ScoredSubmission, SubmissionChange
from reverie_eval.server.audit.log import audit_reports, entries
from reverie_eval.server.boards.leaderboard import cluster_sums
from reverie_eval.server.boards.reviews import lift_review
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.errors import ConflictError, MalformedError, NotFoundError
from reverie_eval.server.intake.submissions import (
    SubmissionService,
    all_submissions,
    check_metadata,
    list_submissions,
    newest_submissions,
    public_team,
    publication,
    result_on,
    submission_of,
    with_public_episodes,
)
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.state import Reading
from reverie_eval.server.store.paging import Page
from reverie_eval.server.store.tables import ClusterSums, Submission
from tests.conftest import SAMPLES
from tests.support.acting import NOON, review
from tests.support.serving import (
    GOOD,
    GROUNDING,
    MATE,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    STRICT,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
)

MEDIOCRE = (SAMPLES / "mediocre.json").read_bytes()
HOUR = timedelta(hours=1)


def sent(server: Serving, who: str = OWNER, split: str = OPEN, content: bytes | None = None) -> str:
    """Send a submission that nobody has sent yet, or this one, and return its id."""
    reply = server.upload(who, content or server.distinct(split), split)
    assert reply.status_code == 201, reply.text
    return str(reply.json()["submission"]["id"])


def change(server: Serving, submission: str, who: str = OWNER, **changes: object) -> None:
    reply = server.ask(who, "PATCH", f"/submissions/{submission}", json=changes)
    assert reply.status_code == 200, reply.text


def known(server: Serving, submission: str) -> ScoredSubmission:
    """Return all that is stored of a submission."""
    with server.state.database.reading() as session:
        return session.get_one(Submission, submission).as_scored()


def store(server: Serving, submission: str, **columns: object) -> None:
    """Write columns of a submission, whatever the service would say."""
    with server.state.database.writing() as session:
        row = session.get_one(Submission, submission)
        for name, value in columns.items():
            setattr(row, name, value)


def logged(server: Serving) -> list[tuple[str, str, str, str, Mapping[str, Any]]]:
    with server.state.database.reading() as session:
        return [
            (each.actor, each.action, each.row, each.subject, each.details)
            for each in audit_reports(session, entries(session))
        ]


# Lists.


def test_lists_begin_with_the_latest_and_then_with_the_largest_id(server: Serving) -> None:
    early = [sent(server, OWNER) for _ in range(4)]
    others = [sent(server, OTHER), sent(server, OTHER)]
    server.clock.turn(hours=1)
    late = sent(server, MATE, PRIVATE)
    both, blue, red = (sorted(ids, reverse=True) for ids in ([*early, *others], early, others))

    def listed(who: str) -> list[str]:
        """Read pages of two."""
        with server.state.database.reading() as session:
            person, cursor, ids = server.person(who), None, []
            view = View.of(Reading(server.state, session, NOON))
            for _ in range(4):
                found = list_submissions(session, person, Page(2, cursor), view)
                ids += [row.id for row in found.rows]
                cursor = found.next_cursor
                if cursor is None:
                    break
        return ids

    assert listed(ORGANISER) == [late, *both]
    assert listed(OWNER) == [late, *blue]
    assert listed(OTHER) == red
    with server.state.database.reading() as session:
        first = {
            (who, split): [
                each.id for each in newest_submissions(session, server.person(who), split, 3)
            ]
            for who in (ORGANISER, OWNER, OTHER)
            for split in (OPEN, PRIVATE)
        }
    assert first == {
        (ORGANISER, OPEN): both[:3],
        (ORGANISER, PRIVATE): [late],
        (OWNER, OPEN): blue[:3],
        (OWNER, PRIVATE): [late],
        (OTHER, OPEN): red,
        (OTHER, PRIVATE): [],
    }
    with server.state.database.reading() as session:
        found = {
            (split, team): [each.id for each in all_submissions(session, split=split, team=team)]
            for split in (None, OPEN, PRIVATE)
            for team in (None, "Blue", "Red", "Green")
        }
    assert found == {
        (None, None): [late, *both],
        (None, "Blue"): [late, *blue],
        (None, "Red"): red,
        (None, "Green"): [],
        (OPEN, None): both,
        (OPEN, "Blue"): blue,
        (OPEN, "Red"): red,
        (OPEN, "Green"): [],
        (PRIVATE, None): [late],
        (PRIVATE, "Blue"): [late],
        (PRIVATE, "Red"): [],
        (PRIVATE, "Green"): [],
    }


def test_another_team_s_submission_is_no_cursor(server: Serving) -> None:
    theirs = sent(server, OTHER)
    with server.state.database.reading() as session:
        view = View.of(Reading(server.state, session, NOON))
        with pytest.raises(MalformedError) as refused:
            list_submissions(session, server.person(OWNER), Page(1, theirs), view)
        assert submission_of(session, server.person(ORGANISER), theirs, view).id == theirs
    assert [each.where for each in refused.value.problems] == ["cursor"]


def test_episodes_for_everyone_are_of_baselines_and_of_teams_that_show_them(
    server: Serving,
) -> None:
    shown = [sent(server) for _ in range(4)]
    late = [sent(server) for _ in range(3)]
    baseline, lifted, verified, silent, withdrawn, unpublished = (sent(server) for _ in range(6))
    for each in (*shown, *late, withdrawn, unpublished):
        store(server, each, shows_episodes=True)
    for each in (*shown, baseline, lifted, verified, silent, withdrawn):
        store(server, each, published_at=NOON)
    for hours, each in enumerate(late):
        store(server, each, published_at=NOON + (1 + hours) * HOUR)
    store(server, withdrawn, withdrawn_at=NOON)
    private = sent(server, OWNER, PRIVATE)
    store(server, private, shows_episodes=True, published_at=NOON)
    with server.acting() as transaction:
        review(transaction, baseline, "baseline")
        lift_review(transaction, review(transaction, lifted, "baseline").id)
        review(transaction, verified, "verified")
    with server.state.database.reading() as session:
        found = [each.id for each in session.scalars(with_public_episodes(OPEN))]
        of_private = [each.id for each in session.scalars(with_public_episodes(PRIVATE))]
    assert found == [*late[::-1], *sorted([*shown, baseline])]
    assert of_private == [private]


# One submission.


def test_a_report_has_everything_that_is_stored(several: Serving) -> None:
    server = several
    submission = sent(server, content=GOOD)
    fresh = known(server, submission)
    assert (fresh.status, fresh.shows_episodes, fresh.earlier) == ("unpublished", False, [])
    earlier = EarlierResult(
        report=fresh.report, receipt=fresh.receipt, replaced_at=NOON, reason="corrected"
    )
    with server.state.database.writing() as session:
        row = session.get_one(Submission, submission)
        own = row.results[""]
        row.store_result("", own.model_copy(update={"earlier": [earlier]}))
        row.method = {**row.method, "description": "walks"}
    times = {
        "published_at": NOON + HOUR,
        "anonymous_until": NOON + 3 * HOUR,
        "upload_deleted_at": NOON + 4 * HOUR,
    }
    store(server, submission, **times, shows_episodes=True)
    assert known(server, submission).status == "published"
    store(server, submission, withdrawn_at=NOON + 2 * HOUR)
    stored = known(server, submission)
    apart = {"method", "report", "receipt", "earlier", "boards"}
    assert stored.model_dump(exclude=apart) == {
        "id": submission,
        "split": OPEN,
        "team": "Blue",
        "person": OWNER,
        "sha256": hashlib.sha256(GOOD).hexdigest(),
        "received_at": NOON,
        "scores_held_until": None,
        "status": "withdrawn",
        "withdrawn_at": NOON + 2 * HOUR,
        "shows_episodes": True,
        **times,
    }
    assert stored.method == Method(name="Walker", description="walks")
    assert stored.earlier == [earlier]
    assert (stored.report, stored.receipt) == (fresh.report, fresh.receipt)
    assert list(stored.boards) == [GROUNDING, STRICT]
    assert stored.boards == fresh.boards
    with server.state.database.reading() as session:
        view = View.of(Reading(server.state, session, NOON))
        assert submission_of(session, server.person(OWNER), submission, view) == stored
    assert result_on(STRICT, stored) == stored.boards[STRICT]
    with pytest.raises(NotFoundError, match=r"^[0-9a-f]+ has no result on .*: grounding, strict$"):
        result_on("none", stored)


def test_what_everyone_sees_of_a_published_submission(several: Serving) -> None:
    server = several
    submission = sent(server)
    own = known(server, submission)
    earlier = EarlierResult(
        report=own.report, receipt=own.receipt, replaced_at=NOON, reason="corrected"
    )
    hidden = NOON + HOUR
    store(server, submission, earlier=[earlier.model_dump(mode="json")], anonymous_until=hidden)
    view = View({}, server.state.signer, NOON)

    def seen() -> Any:
        with server.state.database.reading() as session:
            return publication(session, submission, view)

    for columns in ({}, {"published_at": NOON, "withdrawn_at": NOON}):
        store(server, submission, **columns)
        with pytest.raises(NotFoundError):
            seen()
    store(server, submission, withdrawn_at=None)
    shown = seen()
    assert (shown.id, shown.split, shown.team) == (submission, OPEN, "")
    assert (shown.method, shown.report, shown.boards) == (own.method, own.report, own.boards)
    assert (shown.published_at, shown.scores_held_until) == (NOON, None)
    assert (shown.shows_episodes, list(shown.reviews), shown.earlier) == (False, [], [earlier])
    with server.acting() as transaction:
        review(transaction, submission, "verified")
    assert not seen().shows_episodes
    with server.acting() as transaction:
        review(transaction, submission, "baseline")
    assert seen().shows_episodes
    assert [each.verdict for each in seen().reviews] == ["verified", "baseline"]
    with server.state.database.reading() as session:
        row = session.get_one(Submission, submission)
        moments = (hidden - timedelta(seconds=1), hidden)
        assert [public_team(row, now) for now in moments] == ["", "Blue"]
        with pytest.raises(NotFoundError, match=r"^nothing is published here; "):
            publication(session, "0" * 16, view)


def test_required_information_that_is_empty_is_missing() -> None:
    method = Method(name="Walker", description="", code=None, extra_data=False)
    check_metadata(method, ("name", "extra_data"))
    with pytest.raises(MalformedError) as refused:
        check_metadata(method, ("ensemble", "name", "description", "code", "extra_data"))
    told = "required information about the method is missing: ensemble, description, code"
    assert str(refused.value) == told
    declared = Method(name="Walker", ensemble=None)
    with pytest.raises(MalformedError, match=r"is missing: ensemble$"):
        check_metadata(declared, ("ensemble",))


# Its episodes.


def test_episodes_are_scored_by_the_rules_of_the_leaderboard(several: Serving) -> None:
    """By hand, as README has them: RGS is 40.48 or 28.57; in all, 34 of 84 answers are right."""
    service = several.state.get(SubmissionService)
    mediocre = known(several, sent(several, content=MEDIOCRE))
    good = known(several, sent(several, content=GOOD))
    for name, right in (("", 34), (STRICT, 24), (GROUNDING, 34)):
        scores = service.episodes(mediocre, name)
        assert scores.episodes["rgs"].sum() == right
        # Nothing of what the values are computed from, which takes much more memory.
        assert isinstance(scores.episodes, MappingProxyType)
        assert service.episodes(mediocre, name) is scores
        board = several.state.boards[OPEN]
        board = board.others[name] if name else board
        compared = service.compare(board, {"good": good, "mediocre": mediocre})
        assert list(compared) == ["mediocre"]
        assert compared.scores["mediocre"] is scores
        assert service.compare(board, {"good": good, "mediocre": mediocre}) is compared
    assert b"".join(service.file(good)) == GOOD


def test_few_scores_and_comparisons_are_kept(
    several: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("reverie_eval.server.intake.submissions.RECENT", 1)
    service, board = replace(several.state.get(SubmissionService)), several.state.boards[OPEN]
    named = {"one": known(several, sent(several)), "two": known(several, sent(several))}
    first, second = named.values()
    scores, compared = service.episodes(first), service.compare(board, named)
    service.episodes(second)
    service.compare(board.others[STRICT], named)
    assert service.episodes(first) is not scores
    assert service.compare(board, named) is not compared


def test_episodes_that_cannot_be_shown_are_refused_with_the_reason(several: Serving) -> None:
    service, boards = several.state.get(SubmissionService), several.state.boards
    mine = known(several, sent(several))
    private = known(several, sent(several, OWNER, PRIVATE))
    deleted = mine.model_copy(update={"upload_deleted_at": NOON})
    old = mine.boards[STRICT].report.model_copy(update={"fingerprint": "0" * 64})
    result = mine.boards[STRICT].model_copy(update={"report": old})
    changed = mine.model_copy(update={"boards": {**mine.boards, STRICT: result}})
    gone = (
        "the file was deleted on 2026-03-02: this server deletes the files of unpublished "
        "submissions after a while; scores and receipt stay"
    )
    other = (
        f"the ground truth or protocol of {OPEN}, {STRICT} has changed since this submission; "
        "see its signature"
    )
    secret = "per-episode values of private splits are never released"
    strict = boards[OPEN].others[STRICT]
    for refuse, told in (
        (lambda: service.file(deleted), gone),
        (lambda: service.episodes(deleted), gone),
        (lambda: service.episodes(changed, STRICT), other),
        (lambda: service.compare(strict, {"one": mine, "two": changed}), other),
        (lambda: service.compare(boards[PRIVATE], {"one": private, "two": private}), secret),
    ):
        with pytest.raises(NotFoundError) as refused:
            refuse()
        assert str(refused.value) == told
    assert service.episodes(changed)["rgs"] > 0


# Changes.


def test_a_change_is_logged_with_who_made_it_and_what_was_said(server: Serving) -> None:
    submission = sent(server)
    service, owner = server.state.get(SubmissionService), server.person(OWNER)
    said: dict[str, Any] = {
        "method": {"name": "Runner", "code": "https://example.org/code"},
        "anonymous_until": "2026-04-01T00:00:00Z",
        "shows_episodes": True,
    }
    hidden = service.change(owner, submission, SubmissionChange.model_validate(said), ORGANISER)
    assert hidden == known(server, submission)
    assert hidden.anonymous_until == datetime(2026, 4, 1, tzinfo=UTC)
    change(server, submission, anonymous_until=None)
    change(server, submission, anonymous_until=None, published=False)  # as it was
    row = f"submission:{submission}"
    before = {
        "method": {"name": "Walker", "code": None},
        "anonymous_until": None,
        "shows_episodes": False,
    }
    hidden_until = {"anonymous_until": said["anonymous_until"]}
    named = {"before": hidden_until, "after": {"anonymous_until": None}}
    assert logged(server)[-2:] == [
        (ORGANISER, "changed", row, submission, {"before": before, "after": said}),
        (OWNER, "changed", row, submission, named),
    ]
    stored = known(server, submission)
    assert stored.method == Method(name="Runner", code="https://example.org/code")
    assert (stored.anonymous_until, stored.shows_episodes) == (None, True)


def test_publishing_computes_intervals_on_every_leaderboard_once(
    several: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    submission = sent(several)
    change(several, submission, shows_episodes=True)
    assert {each.report.intervals for each in known(several, submission).results.values()} == {None}
    before_it = known(several, submission)
    before = {name: each.report for name, each in before_it.results.items()}
    change(several, submission, published=True)
    after = {name: each.report for name, each in known(several, submission).results.items()}
    with several.state.database.reading() as session:
        sums = {each.board: each.sums for each in session.scalars(select(ClusterSums))}
    assert sums == {
        board.name: cluster_sums(
            several.state.get(SubmissionService).episodes(before_it, board.name)
        )
        for board in several.state.boards[OPEN].all
    }
    for name, report in after.items():
        assert report.intervals is not None
        low, high = report.intervals.intervals["rgs"]
        assert low < report.scores["rgs"] < high
        assert report.model_copy(update={"intervals": None}) == before[name]
    monkeypatch.setattr(Board, "scored", lambda *_, **__: pytest.fail("scored once more"))
    change(several, submission, published=True)


@pytest.mark.parametrize(
    ("split", "columns"),
    [
        pytest.param(PRIVATE, {}, id="private"),
        pytest.param(OPEN, {"upload_deleted_at": NOON}, id="without its file"),
        pytest.param(OPEN, {"report": {"fingerprint": "0" * 64}}, id="by other ground truth"),
    ],
)
def test_nothing_is_computed_for_what_has_no_intervals(
    split: str, columns: Mapping[str, Any], server: Serving
) -> None:
    submission = sent(server, split=split)
    report = known(server, submission).report.model_dump(mode="json")
    changed = {**columns, "report": {**report, **columns.get("report", {})}}
    store(server, submission, **changed)
    change(server, submission, published=True)
    stored = known(server, submission)
    assert (stored.status, stored.report.intervals) == ("published", None)


def test_a_leaderboard_that_was_added_later_is_left_as_it_is(several: Serving) -> None:
    submission = sent(several)
    result = known(several, submission).boards[STRICT].model_dump(mode="json")
    store(several, submission, boards={STRICT: result})
    change(several, submission, published=True)
    stored = known(several, submission)
    assert [name for name, each in stored.results.items() if each.report.intervals] == ["", STRICT]


def test_a_submission_to_a_split_that_is_gone_can_be_withdrawn(server: Serving) -> None:
    submission = sent(server)
    store(server, submission, split="gone")
    change(server, submission, withdrawn=True, shows_episodes=False)
    assert known(server, submission).status == "withdrawn"
    reply = server.ask(OWNER, "PATCH", f"/submissions/{submission}", json={"shows_episodes": True})
    told = "episodes of private splits are never shown to anyone"
    assert (reply.status_code, reply.json()["detail"]) == (409, told)


def test_results_that_are_replaced_are_logged_and_no_others(
    folder: Path, open_server: OpenServer
) -> None:
    server = open_server(adjusted(settings_of(folder), OPEN, one_per_team=True))
    withdrawn, first, second = (sent(server) for _ in range(3))
    sent(server)  # is not published
    others = sent(server, OTHER), sent(server, OWNER, PRIVATE)
    for each in others:
        store(server, each, published_at=NOON)
    change(server, withdrawn, published=True)
    change(server, withdrawn, withdrawn=True)
    server.clock.turn(hours=1)
    for each in (first, second):
        change(server, each, published=True)
    assert {known(server, each).published_at for each in (withdrawn, *others)} == {NOON}
    published = {"before": {"published": False}, "after": {"published": True}}
    assert [(subject, details) for *_, subject, details in logged(server)[-3:]] == [
        (first, published),
        (second, published),
        (first, {"before": published["after"], "after": published["before"]}),
    ]
    assert {action for _, action, *_ in logged(server)[-3:]} == {"changed"}


def test_a_withdrawn_submission_is_restored_before_it_is_published(server: Serving) -> None:
    submission, owner = sent(server), server.person(OWNER)
    change(server, submission, withdrawn=True)
    with pytest.raises(ConflictError, match=r"^a withdrawn submission cannot be published"):
        server.state.get(SubmissionService).change(
            owner, submission, SubmissionChange(published=True)
        )
    change(server, submission, withdrawn=False, published=True)
    assert known(server, submission).status == "published"
