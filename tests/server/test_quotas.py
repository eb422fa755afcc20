"""Quotas: what is left for a team and a person, when there will be more, and what costs nothing."""

import secrets
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from sqlalchemy import func, select

from reverie_eval.schemas.organising import NewGrant
from reverie_eval.schemas.service import WINDOWS
from reverie_eval.server.accounts.people import person_named
from reverie_eval.server.audit.log import entries
from reverie_eval.server.errors import BytesSpentError, MalformedError, NotFoundError, RequestError
from reverie_eval.server.intake.quotas import QuotaUsage, grant, list_grants, usage_of
from reverie_eval.server.settings import Quota
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.paging import Page
from reverie_eval.server.store.tables import Base, Grant, Submission, Team
from tests.support.acting import NOON, acting
from tests.support.serving import (
    BROKEN,
    GOOD,
    MATE,
    OPEN,
    OTHER,
    OWNER,
    PEOPLE,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    populate,
    settings_of,
)
from tests.support.signing import receipt_in

QUOTA = Quota(day=2, month=4, year=6)
HOUR, DAY = 1, 24
BYTE = 2**-20
"""In MiB."""


def before(hours: Sequence[float]) -> Sequence[datetime]:
    """Return so many hours before noon, the oldest first."""
    return sorted(NOON - timedelta(hours=each) for each in hours)


def later(instant: datetime | None) -> float | None:
    """Return how many hours after noon it is."""
    return None if instant is None else (instant - NOON) / timedelta(hours=1)


@pytest.mark.parametrize(
    ("team", "person", "left", "hours_to_more", "hours_to_next"),
    [
        pytest.param([], [], (2, 4, 6), (None, None, None), None, id="nothing used"),
        pytest.param([1], [1], (1, 3, 5), (23, 719, 8759), None, id="one, an hour ago"),
        pytest.param([3, 1], [3, 1], (0, 2, 4), (21, 717, 8757), 21, id="the day's two"),
        pytest.param([25, 1], [1], (1, 2, 4), (23, 695, 8735), None, id="one of them a day old"),
        pytest.param([24], [24], (2, 3, 5), (None, 696, 8736), None, id="24 hours old to the tick"),
        pytest.param([23.999], [23.999], (1, 3, 5), (0.001, 696.001, 8736.001), None, id="nearly"),
        pytest.param([720], [720], (2, 4, 5), (None, None, 8040), None, id="30 days to the tick"),
        pytest.param(
            [8760], [8760], (2, 4, 6), (None, None, None), None, id="365 days to the tick"
        ),
        pytest.param(
            [700, 600, 500, 400], [], (2, 0, 2), (None, 20, 8060), 20, id="the month's four"
        ),
        pytest.param(
            [8000, 7000, 6000, 5000, 4000, 3000],
            [],
            (2, 4, 0),
            (None, None, 760),
            760,
            id="the year's six",
        ),
        pytest.param(
            [700, 600, 2, 1], [], (0, 0, 2), (22, 20, 8060), 22, id="day and month: the later one"
        ),
        pytest.param(
            [719, 718, 717, 716, 1],
            [],
            (1, 0, 1),
            (23, 2, 8041),
            2,
            id="more than allowed since: two have to leave",
        ),
        pytest.param([1], [], (1, 3, 5), (23, 719, 8759), None, id="a team mate's"),
        pytest.param([], [1], (1, 3, 5), (23, 719, 8759), None, id="the person's in another team"),
        pytest.param([5], [3, 1], (0, 2, 4), (21, 717, 8757), 21, id="the person has used more"),
        pytest.param([5, 4], [4, 1], (0, 2, 4), (20, 716, 8756), 20, id="both have: one of each"),
        pytest.param([-48], [-48], (1, 3, 5), (72, 768, 8808), None, id="the clock ran back"),
    ],
)
def test_what_is_left(
    team: Sequence[float],
    person: Sequence[float],
    left: Sequence[int],
    hours_to_more: Sequence[float | None],
    hours_to_next: float | None,
) -> None:
    state = QuotaUsage(QUOTA, [before(team), before(person)], []).state(NOON)
    assert [window.name for window in state.windows] == ["day", "month", "year"]
    assert [window.limit for window in state.windows] == [2, 4, 6]
    assert [window.remaining for window in state.windows] == list(left)
    assert [later(window.resets_at) for window in state.windows] == pytest.approx(
        list(hours_to_more)
    )
    assert state.remaining == min(left)
    assert later(state.next_at) == hours_to_next


@pytest.mark.parametrize(
    ("grants", "limits", "left", "hours_to_next"),
    [
        pytest.param([(3, 5)], (5, 7, 9), (3, 5, 7), None, id="three more for five hours"),
        pytest.param([(3, 5), (1, 1)], (6, 8, 10), (4, 6, 8), None, id="two grants"),
        pytest.param([(3, 0)], (2, 4, 6), (0, 2, 4), 21, id="it ends now"),
        pytest.param([(3, -9)], (2, 4, 6), (0, 2, 4), 21, id="it has ended"),
    ],
)
def test_what_a_grant_adds_while_it_lasts(
    grants: Sequence[tuple[int, float]],
    limits: Sequence[int],
    left: Sequence[int],
    hours_to_next: float | None,
) -> None:
    received = before([3, 1])
    lasting = [(extra, NOON + timedelta(hours=hours)) for extra, hours in grants]
    state = QuotaUsage(QUOTA, [received, received], lasting).state(NOON)
    assert [window.limit for window in state.windows] == list(limits)
    assert [window.remaining for window in state.windows] == list(left)
    assert later(state.next_at) == hours_to_next


def test_when_there_is_more_counts_that_a_grant_has_ended_by_then() -> None:
    received = before([3, 2, 1])
    usage = QuotaUsage(QUOTA, [received, received], [(1, NOON + timedelta(hours=20))])
    assert later(usage.state(NOON).next_at) == 22  # at 21 there are two, of two


@pytest.mark.parametrize(
    ("quota", "received"),
    [
        pytest.param(Quota(day=0), [], id="none in a day"),
        pytest.param(Quota(year=0), [1], id="none in a year"),
    ],
)
def test_of_nothing_there_is_never_more(quota: Quota, received: Sequence[float]) -> None:
    state = QuotaUsage(quota, [before(received), []], []).state(NOON)
    assert (state.remaining, state.next_at) == (0, None)


UNIT = timedelta(hours=12)
_whens = st.lists(st.integers(-1, 750), max_size=8)
_grants = st.lists(st.tuples(st.integers(1, 3), st.integers(-2, 800)), max_size=3)


@pytest.fixture(scope="module")
def counted() -> Iterator[Database]:
    """Return a database in memory with everybody in it."""
    database = Database("sqlite://")
    Base.metadata.create_all(database.engine)
    with acting(database) as transaction:
        populate(transaction, PEOPLE)
    yield database
    database.close()


def submitted(team_id: int, person_id: int, whens: Sequence[int]) -> Iterator[Submission]:
    """Return submissions of so many half days ago."""
    for ago in whens:
        number = secrets.token_hex(16)
        yield Submission(
            id=number,
            split=OPEN,
            team_id=team_id,
            person_id=person_id,
            sha256=number,
            size=1,
            received_at=NOON - ago * UNIT,
            scored_at=NOON,
            method={},
            report={},
            receipt={},
        )


@given(
    team=_whens,
    person=_whens,
    grants=_grants,
    limits=st.lists(st.integers(0, 4), min_size=3, max_size=3),
)
@example(team=[3], person=[], grants=[], limits=[4, 4, 4])  # which counts for all but the day
def test_quotas_agree_with_counting_every_half_day(
    counted: Database,
    team: Sequence[int],
    person: Sequence[int],
    grants: Sequence[tuple[int, int]],
    limits: Sequence[int],
) -> None:
    """Everything happens at whole half days, so looking at each of them misses nothing."""

    def left(window: int, at: int) -> int:
        length, limit = ((2, 60, 730)[window], limits[window])
        used = [len([ago for ago in whose if at + ago < length]) for whose in (team, person)]
        more = sum(extra for extra, until in grants if until > at)
        return max(0, limit + more - max(used))

    def first_rise(windows: Sequence[int]) -> int | None:
        now = min(left(window, 0) for window in windows)
        rises = (at for at in range(1, 740) if min(left(window, at) for window in windows) > now)
        return next(rises, None)

    quota = Quota(**dict(zip(WINDOWS, limits, strict=True)))
    with counted.reading() as session:  # and nothing is kept
        ada = person_named(session, OWNER)
        red = session.scalars(select(Team.id).where(Team.name == "Red")).one()
        ben = person_named(session, MATE)
        session.add_all(submitted(ada.team_id, ben.id, team))
        session.add_all(submitted(red, ada.id, person))
        session.add_all(
            Grant(
                team_id=ada.team_id,
                split=OPEN,
                extra=extra,
                reason="",
                created_at=NOON,
                expires_at=NOON + ends * UNIT,
            )
            for extra, ends in grants
        )
        state = usage_of(session, ada, NOON).of_split(OPEN, quota).state(NOON)

    def units(instant: datetime | None) -> float | None:
        return None if instant is None else (instant - NOON) / UNIT

    assert [window.remaining for window in state.windows] == [left(each, 0) for each in range(3)]
    assert [units(window.resets_at) for window in state.windows] == [
        first_rise([each]) for each in range(3)
    ]
    expected = None if state.remaining else first_rise(range(3))
    assert units(state.next_at) == expected


def test_submissions_count_by_their_arrival_in_whatever_order_they_were_scored(
    counted: Database,
) -> None:
    with counted.reading() as session:  # and nothing is kept
        ada = person_named(session, OWNER)
        for ago in (1, 5, 3):
            session.add_all(submitted(ada.team_id, ada.id, [ago]))
            session.flush()
        usage = usage_of(session, ada, NOON).of_split(OPEN, QUOTA)
    assert usage.received == [before([12, 36, 60])] * 2


@pytest.fixture
def narrow(folder: Path, open_server: OpenServer) -> Serving:
    """Return a server whose open split has the quota of the tables above."""
    return open_server(adjusted(settings_of(folder), OPEN, quota=QUOTA))


def quota_of(server: Serving, who: str, split: str = OPEN) -> dict[str, Any]:
    quota: dict[str, Any] = server.ask(who, "GET", f"/splits/{split}").json()["quota"]
    return quota


def rows(server: Serving) -> int:
    with server.state.database.reading() as session:
        return session.scalar(select(func.count()).select_from(Submission)) or 0


def test_a_third_upload_in_a_day_waits_until_the_first_is_24_hours_old(narrow: Serving) -> None:
    assert narrow.upload(OWNER, narrow.distinct()).status_code == 201
    narrow.clock.turn(hours=1)
    assert narrow.upload(OWNER, narrow.distinct()).status_code == 201
    refused = narrow.upload(OWNER, narrow.distinct())
    assert refused.status_code == 429
    assert refused.headers["Retry-After"] == str(23 * 3600)
    problem = refused.json()
    assert problem["code"] == "quota-spent"
    assert problem["detail"].startswith(
        "no submissions left; next possible at 2026-03-03T12:00:00+00:00"
    )
    assert problem["quota"]["next_at"] == "2026-03-03T12:00:00Z"
    assert problem["quota"]["seconds_to_next"] == 23 * 3600
    narrow.clock.turn(hours=23, microseconds=-1)
    waiting = narrow.upload(OWNER, narrow.distinct())
    assert (waiting.status_code, waiting.headers["Retry-After"]) == (429, "1")
    narrow.clock.turn(microseconds=1)
    assert narrow.upload(OWNER, narrow.distinct()).status_code == 201
    assert rows(narrow) == 3


def quota_on(accepted: dict[str, Any]) -> dict[str, Any]:
    """Return the quota on the receipt of an upload."""
    return receipt_in(accepted["submission"]["receipt"]).quota.model_dump(mode="json")


def test_every_reply_to_an_upload_says_what_is_left(narrow: Serving) -> None:
    first = narrow.upload(OWNER).json()
    assert first["quota"] == {
        "remaining": 1,
        "next_at": None,
        "seconds_to_next": 0,
        "windows": [
            {"name": "day", "limit": 2, "remaining": 1, "resets_at": "2026-03-03T12:00:00Z"},
            {"name": "month", "limit": 4, "remaining": 3, "resets_at": "2026-04-01T12:00:00Z"},
            {"name": "year", "limit": 6, "remaining": 5, "resets_at": "2027-03-02T12:00:00Z"},
        ],
    }
    assert quota_on(first) == first["quota"]
    assert quota_of(narrow, OWNER) == first["quota"]
    second = narrow.upload(OWNER, narrow.distinct()).json()
    assert second["quota"]["next_at"] == "2026-03-03T12:00:00Z"
    repeat = narrow.upload(OWNER).json()
    assert repeat["quota"] == second["quota"]
    assert quota_on(repeat) == first["quota"]


def test_a_team_shares_its_quota(narrow: Serving) -> None:
    narrow.upload(OWNER, narrow.distinct())
    narrow.upload(MATE, narrow.distinct())
    assert narrow.upload(OWNER, narrow.distinct()).status_code == 429
    assert narrow.upload(MATE, narrow.distinct()).status_code == 429
    assert narrow.upload(OTHER, narrow.distinct()).status_code == 201


def test_nobody_gains_by_changing_teams(narrow: Serving) -> None:
    narrow.upload(OWNER, narrow.distinct())
    narrow.upload(OWNER, narrow.distinct())
    with narrow.state.database.writing() as session:
        red = session.scalars(select(Team).where(Team.name == "Red")).one()
        session.merge(narrow.person(OWNER)).team_id = red.id
    assert narrow.upload(OWNER, narrow.distinct()).status_code == 429
    assert narrow.upload(OTHER, narrow.distinct()).status_code == 201  # of the same team now


def test_each_split_has_a_quota_of_its_own(narrow: Serving) -> None:
    narrow.upload(OWNER, narrow.distinct())
    narrow.upload(OWNER, narrow.distinct())
    assert quota_of(narrow, OWNER)["remaining"] == 0
    assert quota_of(narrow, OWNER, PRIVATE)["remaining"] == 2


@pytest.mark.parametrize(("split", "limits"), [(PRIVATE, [2, 10, 40]), (OPEN, [200, 2000, 10000])])
def test_what_a_split_allows_if_the_organiser_says_nothing(
    split: str, limits: Sequence[int], folder: Path, open_server: OpenServer
) -> None:
    server = open_server(adjusted(settings_of(folder), split, quota=None))
    assert [window["limit"] for window in quota_of(server, OWNER, split)["windows"]] == limits


def test_what_is_withdrawn_counts(narrow: Serving) -> None:
    for _ in range(2):
        sent = narrow.upload(OWNER, narrow.distinct()).json()["submission"]["id"]
        changed = narrow.ask(OWNER, "PATCH", f"/submissions/{sent}", json={"withdrawn": True})
        assert changed.json()["status"] == "withdrawn"
    assert narrow.upload(OWNER, narrow.distinct()).status_code == 429


@pytest.mark.parametrize(
    ("method", "path", "said"),
    [
        pytest.param("POST", "/submissions", {"content": BROKEN}, id="a broken submission"),
        pytest.param("POST", "/submissions", {"content": b"{"}, id="no JSON"),
        pytest.param("POST", "/submissions", {"content": b"PK\3\4"}, id="no archive"),
        pytest.param("POST", "/submissions", {"content": GOOD, "params": {}}, id="without a name"),
        pytest.param("POST", "/validate", {"content": GOOD}, id="validating"),
        pytest.param("POST", "/validate", {"content": BROKEN}, id="validating what is broken"),
        pytest.param("GET", "", {}, id="looking"),
    ],
)
def test_what_is_no_submission_costs_nothing(
    narrow: Serving, method: str, path: str, said: Mapping[str, Any]
) -> None:
    untouched = quota_of(narrow, OWNER)
    assert untouched["remaining"] == 2
    for _ in range(3):
        said = {"params": {"name": "Walker"}, **said}
        reply = narrow.ask(OWNER, method, f"/splits/{OPEN}{path}", **said)
        assert reply.status_code in {200, 400, 422}
    assert quota_of(narrow, OWNER) == untouched
    assert rows(narrow) == 0


def test_validating_is_possible_when_nothing_is_left(narrow: Serving) -> None:
    for _ in range(2):
        narrow.upload(OWNER, narrow.distinct())
    reply = narrow.ask(OWNER, "POST", f"/splits/{OPEN}/validate", content=GOOD)
    assert (reply.status_code, reply.json()["valid"]) == (200, True)


def test_a_grant_lets_a_team_submit_more_and_is_on_record(narrow: Serving) -> None:
    for _ in range(2):
        narrow.upload(OWNER, narrow.distinct())
    new = NewGrant(
        team="Blue",
        split=OPEN,
        extra=1,
        reason="our disk was full",
        expires_at=NOON + timedelta(hours=2),
    )
    with narrow.acting("Olga") as transaction:
        grant(transaction, new, narrow.state.boards)
        session = transaction.session
        assert [entry.action for entry in entries(session)][-1] == "granted"
        assert entries(session)[-1].details["reason"] == "our disk was full"
    assert quota_of(narrow, OTHER)["windows"][0]["limit"] == 2
    assert narrow.upload(MATE, narrow.distinct()).json()["quota"]["windows"][0]["limit"] == 3
    assert narrow.upload(OWNER, narrow.distinct()).status_code == 429
    narrow.clock.turn(hours=2)
    assert quota_of(narrow, OWNER)["windows"][0]["limit"] == 2
    assert quota_of(narrow, OWNER)["remaining"] == 0


def some_grant(**changes: Any) -> NewGrant:
    """Return a grant that can be made, with changes."""
    usual = {"team": "Blue", "split": OPEN, "extra": 1, "reason": "a full disk"}
    return NewGrant(**{**usual, "expires_at": NOON + timedelta(hours=2), **changes})


@pytest.mark.parametrize(
    ("changes", "error", "says"),
    [
        pytest.param(
            {"expires_at": NOON},
            MalformedError,
            "the expiry time is in the past; choose a later time",
            id="it ends at once",
        ),
        pytest.param(
            {"split": "elsewhere"},
            NotFoundError,
            f"there is no split 'elsewhere' here; choose one of: {PRIVATE}, {OPEN}",
            id="no such split",
        ),
        pytest.param(
            {"team": "Green"},
            NotFoundError,
            "there is no team 'Green'; see the list of teams",
            id="no team",
        ),
    ],
)
def test_a_grant_that_cannot_be(
    changes: Mapping[str, Any], error: type[RequestError], says: str, counted: Database
) -> None:
    with acting(counted) as transaction, pytest.raises(error) as refused:
        grant(transaction, some_grant(**changes), [PRIVATE, OPEN])
    assert str(refused.value) == says


def test_grants_are_listed_with_the_latest_first(narrow: Serving) -> None:
    ends = NOON + timedelta(microseconds=1)
    with narrow.acting("Olga") as transaction:
        grant(transaction, some_grant(), narrow.state.boards)
        grant(transaction, some_grant(team="Red", extra=3, expires_at=ends), narrow.state.boards)
        page = list_grants(transaction.session, Page(limit=1))
        (latest,) = page.rows
        rest = list_grants(transaction.session, Page(limit=1, cursor=page.next_cursor)).rows
        recorded = entries(transaction.session)[-1]
    assert latest.model_dump() == {
        "team": "Red",
        "split": OPEN,
        "extra": 3,
        "reason": "a full disk",
        "created_at": NOON,
        "expires_at": ends,
    }
    assert [each.team for each in rest] == ["Blue"]
    assert (recorded.action, recorded.subject) == ("granted", "Red")
    assert recorded.details == latest.model_dump(mode="json", exclude={"team", "created_at"})


@pytest.mark.parametrize(
    ("sent", "size", "seconds"),
    [
        pytest.param([], 10, 0, id="all of it at once"),
        pytest.param([], 10 + BYTE, None, id="more than ever fits"),
        pytest.param([(1, 6)], 4, 0, id="the rest"),
        pytest.param([(1, 6)], 5, 23 * 3600, id="one too many, until the first is a day old"),
        pytest.param([(5, 3), (1, 3)], 6, 19 * 3600, id="more than enough leaves first"),
        pytest.param([(5, 3), (1, 3)], 7, 19 * 3600, id="just enough leaves first"),
        pytest.param([(5, 3), (1, 3)], 7 + BYTE, 23 * 3600, id="a byte too many for that"),
        pytest.param([(1, 3), (5, 3)], 8, 23 * 3600, id="both have to leave, and the later does"),
        pytest.param([(23.9999, 10)], 1, 1, id="a part of a second is a second"),
        pytest.param([(24, 10)], 10, 0, id="a day old to the tick"),
        pytest.param([(-24, 10)], 10, 0, id="a day later to the tick"),
        pytest.param([(-23, 10)], 1, 47 * 3600, id="by a clock that ran back"),
    ],
)
def test_bytes_of_a_day(
    sent: Sequence[tuple[float, int]], size: float, seconds: int | None, counted: Database
) -> None:
    """With a limit of 10 MiB; sizes are in MiB, ages in hours."""
    with counted.reading() as session:  # and nothing is kept
        ada, carl = (person_named(session, name) for name in (OWNER, OTHER))
        of_others = [(2, 10)]  # by Carl, and by Ada when she was in his team
        for team, person, uploads in (
            (ada.team_id, ada, sent),
            (carl.team_id, carl, of_others),
            (carl.team_id, ada, of_others),
        ):
            for hours, mebibytes in uploads:
                (row,) = submitted(team, person.id, [0])
                row.received_at = NOON - timedelta(hours=hours)
                row.size = mebibytes << 20
                session.add(row)
        if seconds == 0:
            usage_of(session, ada, NOON).check_bytes(round(size * 2**20), 10, NOON)
            return
        with pytest.raises(BytesSpentError) as refused:
            usage_of(session, ada, NOON).check_bytes(round(size * 2**20), 10, NOON)
    used = sum(mebibytes for _, mebibytes in sent)
    assert refused.value.seconds == seconds
    assert f"has sent {used}.0 MiB; this one is {size:.1f} MiB" in str(refused.value)
    assert "may send 10 MiB" in str(refused.value)


def test_a_clock_that_runs_back_gives_nothing(narrow: Serving) -> None:
    for _ in range(2):
        narrow.upload(OWNER, narrow.distinct())
    narrow.clock.turn(days=-3)
    refused = narrow.upload(OWNER, narrow.distinct())
    assert (refused.status_code, refused.headers["Retry-After"]) == (429, str(4 * 24 * 3600))


# Files that were received in the past.


@given(
    st.lists(st.integers(-9000, 9000).map(float), max_size=6),
    st.integers(-9000, 9000).map(float),
)
@example([], 0.0)
@example([5.0, 20.0], 0.0)
@example([-23.0, 23.0], 0.0)
@example([24.0, 48.0], 0.0)
@example([-1.0, -24.0], 0.0)  # a full window that begins just after it
def test_a_file_of_the_past_keeps_every_window_within_its_limit(
    hours: Sequence[float], then: float
) -> None:
    """Against all windows that end with a submission, one by one."""
    usage = QuotaUsage(QUOTA, [before(hours), []], [])
    received = before([*hours, then])
    at = NOON - timedelta(hours=then)
    overfull = any(
        end - length < at <= end
        and sum(end - length < each <= end for each in received) > getattr(QUOTA, name)
        for end in received
        for name, length in WINDOWS.items()
    )
    assert usage.had_room(at) is not overfull
