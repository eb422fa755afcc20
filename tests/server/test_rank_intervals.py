"""Which ranks results may have: on pages, in JSON and in CSV, stored and computed again."""

import csv
import json
import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
from sqlalchemy import delete

from reverie_eval import evaluate
from reverie_eval.runner import run_agent
from reverie_eval.server.boards import leaderboard as leaderboards
from reverie_eval.server.boards.entries import EntriesCache, Row
from reverie_eval.server.boards.leaderboard import Rankings, RankInterval, RankIntervals
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.store.tables import ClusterSums
from tests.support.correcting import rescored
from tests.support.entries import entered, entry, get, named, tables
from tests.support.serving import (
    GOOD,
    OPEN,
    OTHER,
    OWNER,
    PRIVATE,
    STRICT,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
)
from tests.support.waiting import PATIENCE, WatchedLock


def publish(server: Serving, content: bytes, name: str, who: str = OWNER, split: str = OPEN) -> str:
    submission: str = server.upload(who, content, split, name=name).json()["submission"]["id"]
    reply = server.ask(who, "PATCH", f"/submissions/{submission}", json={"published": True})
    assert reply.status_code == 200
    return submission


def leaderboard(server: Serving, split: str = OPEN, query: str = "") -> list[dict[str, Any]]:
    rows = server.ask(None, "GET", f"/splits/{split}/leaderboard{query}").json()["rows"]
    return list(rows)


def places(rows: list[dict[str, Any]]) -> list[tuple[str, Any, Any]]:
    return [(row["method"]["name"], row["rank_interval"], row["group"]) for row in rows]


@pytest.fixture
def three(server: Serving) -> Serving:
    """Return a server with two results that differ in little, and one that is far worse."""
    records = json.loads(GOOD)
    publish(server, GOOD, "Good")
    records[0]["predObjId"] = None
    publish(server, json.dumps(records).encode(), "Nearly", OTHER)
    far = run_agent("random", server.state.boards[OPEN].truth)
    publish(server, json.dumps(far).encode(), "Random")
    return server


def test_intervals_are_computed_once_for_all_who_ask_meanwhile(
    three: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, came, calls = three.state, Event(), []
    computed = leaderboards._compare  # noqa: SLF001

    def computing(*about: Any) -> Any:
        calls.append(about)
        if len(calls) > 1:
            came.set()
        assert came.wait(PATIENCE)
        return computed(*about)

    def compute(_: int) -> Mapping[str, RankInterval]:
        with state.database.reading() as session:
            return intervals.compute(session, state.board(OPEN), "rgspl", rows)

    monkeypatch.setattr(leaderboards, "_compare", computing)
    lock: Any = WatchedLock(came)
    intervals = RankIntervals(_lock=lock)
    with state.database.reading() as session:
        cache = EntriesCache(state.get(Schedules))
        read = cache.entries(session, state.board(OPEN), three.clock())
    rows = [Row(rank, entry) for rank, entry in enumerate(read.entries, 1)]
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(compute, range(2))
    assert first is second
    assert len(calls) == 1
    assert len(first) == 3


def test_what_has_no_rank_is_not_compared(three: Serving) -> None:
    state = three.state
    with state.database.reading() as session:
        ranking = state.get(Rankings).ranking(session, state.board(OPEN), "rgspl")
        walker = entry("Walker")  # has no value
        more = [*ranking.rows, Row(None, walker), Row(None, replace(walker, submission_id=None))]
        found = [
            RankIntervals().compute(session, ranking.board, "rgspl", rows)
            for rows in (ranking.rows, more)
        ]
    assert len(found[0]) == 3
    assert found[0] == found[1]


EXPECTED = [("Good", [1, 2], 1), ("Nearly", [1, 2], 1), ("Random", [3, 3], 2)]


def test_an_open_split_compares_results_episode_by_episode(three: Serving) -> None:
    assert sorted(places(leaderboard(three))) == EXPECTED
    by_success = leaderboard(three, query="?metric=success")
    assert sorted(places(by_success)) == EXPECTED


def test_pages_and_csv_have_them_too(three: Serving) -> None:
    page = get(three)
    assert [re.findall(r"\d+", row[0]) for row in tables(page)[0]] == [
        *(["1", "1", "2", "1"], ["2", "1", "2", "1"], ["3", "3", "2"])
    ]
    assert page.text.count('class="begins"') == 1  # a line before the second group
    text = three.client.get(f"/api/v1/splits/{OPEN}/leaderboard.csv").text
    rows = list(csv.DictReader(text.splitlines()))
    assert [(row["rank_low"], row["rank_high"], row["group"]) for row in rows] == [
        *(("1", "2", "1"), ("1", "2", "1"), ("3", "3", "2"))
    ]
    low, high = leaderboard(three)[0]["intervals"]["rgspl"]
    assert [float(rows[0]["rgspl_low"]), float(rows[0]["rgspl_high"])] == [low, high]


def test_a_result_without_stored_sums_may_have_any_rank(three: Serving) -> None:
    worst = leaderboard(three)[-1]["submission_id"]
    with three.state.database.writing() as session:
        session.delete(session.get_one(ClusterSums, (worst, "")))
    publish(three, GOOD + b"\n", "Good again")
    *rest, last = sorted(places(leaderboard(three)))
    assert last == ("Random", None, None)
    assert [interval for _, interval, _ in rest] == [[1, 4]] * 3


def test_another_leaderboard_compares_by_its_own_sums(several: Serving) -> None:
    publish(several, GOOD, "Good")
    publish(
        several, json.dumps(run_agent("random", several.state.boards[OPEN].truth)).encode(), "R"
    )
    with several.state.database.writing() as session:
        session.execute(delete(ClusterSums).where(ClusterSums.board == ""))
    assert [row["rank_interval"] for row in leaderboard(several)] == [None, None]
    strict = several.ask(None, "GET", f"/splits/{OPEN}/boards/{STRICT}/leaderboard").json()
    assert [row["rank_interval"] for row in strict["rows"]] == [[1, 1], [2, 2]]


def test_a_private_split_uses_the_shown_means_alone(server: Serving) -> None:
    """By hand: 0.5 and 0.4 of so few items are not told apart, 0.9 and 0.1 are."""
    for name, value in (("Ant", 0.9), ("Bee", 0.5), ("Cat", 0.4), ("Dog", 0.1)):
        who = OWNER if value > 0.45 else OTHER
        entered(server, {"rgspl": value}, who, PRIVATE, **named(name))
    with server.state.database.reading() as session:
        assert session.query(ClusterSums).count() == 0
    n_items = len(np.unique(server.state.boards[PRIVATE].truth.episodes.item))
    assert n_items < 100
    found = places(leaderboard(server, PRIVATE))
    assert found[1][2] == found[2][2]
    assert found[0][1][0] == 1
    assert found[3][1] == [4, 4]


def test_there_are_none_of_a_single_result_or_too_many(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    publish(server, GOOD, "Good")
    assert places(leaderboard(server)) == [("Good", None, None)]
    publish(server, GOOD + b"\n", "Again")
    assert sorted(places(leaderboard(server))) == [("Again", [1, 2], 1), ("Good", [1, 2], 1)]
    monkeypatch.setattr(leaderboards, "MOST_COMPARED", 2)
    assert leaderboard(server)[0]["rank_interval"] == [1, 2]
    monkeypatch.setattr(leaderboards, "MOST_COMPARED", 1)
    server.clock.turn(seconds=1)
    assert sorted(places(leaderboard(server))) == [("Again", None, None), ("Good", None, None)]


def test_scoring_again_renews_what_ranks_are_compared_by(
    three: Serving, open_server: OpenServer, folder: Path
) -> None:
    submission = leaderboard(three)[0]["submission_id"]
    again = open_server(adjusted(settings_of(folder), OPEN, protocol="paper"), three.tokens)
    rescored(again, reason="the paper's rules")
    scores = evaluate(GOOD, split=OPEN, protocol="paper")
    with again.state.database.reading() as session:
        stored = session.get_one(ClusterSums, (submission, "")).sums
    assert sum(stored["rgs"]) == pytest.approx(scores.episodes["rgs"].sum())
    assert sorted(places(leaderboard(again))) == EXPECTED
