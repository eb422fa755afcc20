"""The entries of leaderboards: read once, until something that they show has changed."""

from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta
from threading import Event
from typing import Any

import pytest

from reverie_eval.schemas.organising import NewMerge
from reverie_eval.server.accounts.people import merge_teams
from reverie_eval.server.boards import entries as entries_module
from reverie_eval.server.boards.entries import BoardEntries, EntriesCache, count_submissions
from reverie_eval.server.boards.reviews import PublishedReview, lift_review
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.store.tables import Submission
from tests.support.acting import NOON, review
from tests.support.entries import entered, report_result
from tests.support.serving import GROUNDING, OPEN, OTHER, OWNER, PRIVATE, STRICT, Serving
from tests.support.waiting import PATIENCE, WatchedLock

HEADLINE = ["path_length", "success", "oracle_success", "spl", "rgs", "rgspl"]
SECOND = timedelta(seconds=1)


def read(server: Serving, name: str = "", cache: EntriesCache | None = None) -> BoardEntries:
    """Return the entries of a leaderboard of the open split."""
    cache = cache or EntriesCache(server.state.get(Schedules))
    with server.state.database.reading() as session:
        return cache.entries(session, server.state.board(OPEN, name), server.clock())


def test_an_entry_has_what_is_published_and_nothing_else(several: Serving) -> None:
    until = NOON.replace(year=2027)
    content = several.distinct()
    accepted = several.upload(OWNER, content, paper="https://example.org/p").json()["submission"]
    several.clock.turn(seconds=1)
    change = {"published": True, "anonymous_until": until.isoformat()}
    path = f"/submissions/{accepted['id']}"
    published = several.ask(OWNER, "PATCH", path, json=change).json()
    with several.acting("Olga") as transaction:
        review(transaction, accepted["id"], "verified", "run again")
        review(transaction, accepted["id"], "baseline", "ours")
    for name, headline in (("", HEADLINE), (GROUNDING, ["rgs"])):
        report = (published["boards"][name] if name else published)["report"]
        (entry,) = read(several, name).entries
        assert (entry.submission_id, entry.team) == (accepted["id"], "Blue")
        assert entry.team_id == several.person(OWNER).team_id
        assert entry.method == {**accepted["method"], "reference": None}
        assert (entry.published_at, entry.date) == (NOON + SECOND, "2026-03-02")
        assert (entry.anonymous_until, entry.scores_held_until) == (until, None)
        assert (entry.scores, entry.signature) == (report["scores"], report["signature"])
        drawn = {key: tuple(report["intervals"]["intervals"][key]) for key in headline}
        assert list(entry.intervals.items()) == list(drawn.items())
        assert entry.standing == "ranked"
        assert entry.reviews == [
            PublishedReview("verified", "run again", NOON + SECOND),
            PublishedReview("baseline", "ours", NOON + SECOND),
        ]


def test_entries_are_read_once_for_all_who_ask_meanwhile(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    entered(server, {"rgspl": 0.5})
    cache, came, calls = EntriesCache(server.state.get(Schedules)), Event(), []
    read_entries = entries_module._read_entries  # noqa: SLF001

    def reading(*about: Any) -> Any:
        calls.append(about)
        if len(calls) > 1:
            came.set()
        assert came.wait(PATIENCE)
        return read_entries(*about)

    monkeypatch.setattr(cache, "_lock", WatchedLock(came))
    monkeypatch.setattr(entries_module, "_read_entries", reading)
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(lambda _: read(server, cache=cache), range(2))
    assert first is second
    assert len(calls) == 1


def test_a_disqualified_result_is_apart_with_what_it_scored(server: Serving) -> None:
    first, second = entered(server, {"rgspl": 0.5}), entered(server, {"spl": 0.25}, OTHER)
    with server.acting() as transaction:
        review(transaction, first, "baseline")
        disqualified = review(transaction, first, "disqualified")
    found = read(server)
    assert [entry.submission_id for entry in found.entries] == [second]
    assert [(row.rank, row.entry.submission_id, row.entry.standing) for row in found.apart] == [
        (None, first, "disqualified")
    ]
    assert found.metrics == {"spl"}
    with server.acting() as transaction:
        lift_review(transaction, disqualified.id)
    assert [entry.standing for entry in read(server).entries] == ["ranked", "ranked"]


def test_a_reported_result_has_its_source_and_no_team_of_the_server(several: Serving) -> None:
    report_result(several, "FAST", date="2020-06", human=True, rgspl=0.25)
    (entry,) = read(several).entries
    assert (entry.submission_id, entry.team_id, entry.team) == (None, None, "Qi et al.")
    assert (entry.method["name"], entry.method["human"]) == ("FAST", True)
    assert (entry.published_at, entry.date, entry.reported_date) == (NOON, "2020-06", "2020-06")
    assert (entry.anonymous_until, entry.scores) == (None, {"rgspl": 0.25})
    assert (entry.source, entry.dataset) == ("https://example.org/paper.pdf", "")
    assert entry.standing == "reported"
    assert read(several, STRICT).entries == []
    report_result(several, "Old", dataset="v0", spl=0.5)
    found = read(several)
    assert [row.entry.standing for row in found.apart] == ["other-dataset"]
    assert (found.apart[0].entry.dataset, found.apart[0].entry.date) == ("v0", "")
    assert found.metrics == {"rgspl"}


def test_entries_are_read_again_if_a_leaderboard_has_changed(several: Serving) -> None:
    cache = EntriesCache(several.state.get(Schedules))
    empty = read(several, cache=cache)
    several.upload(OWNER, several.distinct())  # publishes nothing
    assert read(several, cache=cache) is empty
    assert read(several, STRICT, cache) is not empty
    assert read(several, STRICT, cache) is read(several, STRICT, cache)
    shown = entered(several, who=OTHER)
    changed = read(several, cache=cache)
    assert [entry.submission_id for entry in changed.entries] == [shown]
    assert read(several, cache=cache) is changed
    with several.state.database.writing() as session:
        row = session.get_one(Submission, shown)
        row.report = {**row.report, "signature": "another"}
    (apart,) = read(several).apart
    assert apart.entry.standing == "other-rules"


@pytest.mark.parametrize(
    ("held", "expected"),
    [
        pytest.param(None, False, id="nothing is held back"),
        pytest.param(NOON - SECOND, True, id="the second after the last"),
        pytest.param(NOON, False, id="in the last second"),
        pytest.param(NOON + SECOND, False, id="before it"),
    ],
)
def test_entries_are_old_when_scores_are_released(
    held: datetime | None, *, expected: bool, shared: Serving
) -> None:
    board = shared.state.board(OPEN)
    entries = BoardEntries(1, board.signature, [], [], frozenset(), held_until=held)
    assert entries.is_old(board, 1, NOON + 0.9 * SECOND) is expected


def test_submissions_of_teams_are_counted_again_after_each_upload(server: Serving) -> None:
    cache = EntriesCache(server.state.get(Schedules))
    blue, red = (server.person(name).team_id for name in (OWNER, OTHER))

    def counts(split: str = OPEN) -> dict[int, int]:
        with server.state.database.reading() as session:
            found = dict(cache.submissions_of_teams(session, split))
            assert found == count_submissions(session, split)
        return found

    assert counts() == {}
    same = server.distinct()
    server.upload(OWNER, same)
    server.upload(OWNER, server.distinct())
    assert counts() == {blue: 2}
    server.upload(OTHER, same)
    server.upload(OTHER, server.distinct(PRIVATE), PRIVATE)
    assert counts() == {blue: 2, red: 1}
    assert counts(PRIVATE) == {red: 1}
    with server.acting() as transaction:
        merge_teams(transaction, NewMerge(team="Red", into="Blue"))
    assert counts() == {blue: 2}, "both had sent the same file"
    assert counts(PRIVATE) == {blue: 1}
    server.upload(OWNER, server.distinct())
    assert counts() == {blue: 3}
