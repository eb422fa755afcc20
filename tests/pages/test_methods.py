"""Methods side by side on an open split, what one result consists of, and the pages of teams."""

import hashlib
import json
import os
import re
import signal
from pathlib import Path

import httpx
import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.analysis import WalkOutcomes, find_grouping
from reverie_eval.reporting.report_sections import Breakdown, GroupRow
from reverie_eval.server.app import jobs_of
from reverie_eval.server.explore import results_page
from reverie_eval.server.explore.episodes import EpisodeService
from reverie_eval.server.explore.results_page import Analysis
from reverie_eval.server.explore.side_by_side import (
    DIFFICULTIES,
    MOST_AWAITED,
    ShownMethod,
    SideBySide,
)
from tests.conftest import SAMPLES
from tests.support.acting import review
from tests.support.entries import tables
from tests.support.killing import scorers
from tests.support.serving import (
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    Serving,
    running,
    submission_for,
)
from tests.support.visiting import said, signed_in
from tests.support.waiting import wait_until

GOOD, MEDIOCRE = SAMPLES / "good.json", SAMPLES / "mediocre.json"
LIST = f"/episodes/{OPEN}"


def publish(server: Serving, who: str, content: bytes, split: str = OPEN, **change: object) -> str:
    """Publish a result whose episodes everyone may look at, unless it is said otherwise."""
    name = f"Of {who}"
    identity: str = server.upload(who, content, split, name=name).json()["submission"]["id"]
    change = {"published": True, "shows_episodes": split == OPEN, **change}
    reply = server.ask(who, "PATCH", f"/submissions/{identity}", json=change)
    assert reply.status_code == 200, reply.text
    return identity


def correct(file: Path) -> set[str]:
    scores = rv.evaluate(file, split=OPEN)
    pairs = zip(scores.instr_ids, scores.outcomes, strict=True)
    return {instr_id for instr_id, outcome in pairs if outcome == "correct"}


def test_difficulty_counts_only_methods_that_show_their_episodes(server: Serving) -> None:
    publish(server, OTHER, MEDIOCRE.read_bytes())
    assert "1 method whose episodes" in said(server.client.get(LIST))
    good = publish(server, OWNER, GOOD.read_bytes(), shows_episodes=False)
    assert "1 method whose episodes" in said(server.client.get(LIST))
    server.ask(OWNER, "PATCH", f"/submissions/{good}", json={"shows_episodes": True})

    page = server.client.get(LIST)
    one, other = correct(GOOD), correct(MEDIOCRE)
    episodes = set(rv.evaluate(GOOD, split=OPEN).instr_ids)
    expected = {
        "no method": episodes - one - other,
        "one method": one ^ other,
        "every method": one & other,
    }
    by_difficulty, buildings = tables(page)[:2]
    assert {row[0]: int(row[1].split()[0]) for row in by_difficulty} == {
        name: len(ids) for name, ids in expected.items()
    }
    for name, ids in expected.items():
        found = server.client.get(f"{LIST}?solved_by={name.replace(' ', '+')}")
        assert f"{len(ids)} episodes found Solved by {name}." in said(found)
        listed = re.findall(r'<th scope="row"><a href="/episodes/[^/]+/([^?"]+)', found.text)
        assert set(listed) <= ids
        assert len(listed) == min(len(ids), 50)
    solved = [float(row[2]) for row in buildings]
    assert solved == sorted(solved)
    assert sum(int(row[1]) for row in buildings) == len(episodes)
    assert re.findall(r'<li title="(Of \w+)">\1<', page.text) == ["Of Ada", "Of Carl"]
    assert set(expected) <= set(DIFFICULTIES)

    server.ask(OWNER, "PATCH", f"/submissions/{good}", json={"shows_episodes": False})
    assert "1 method whose episodes" in said(server.client.get(LIST))
    assert len(server.state.get(EpisodeService).comparing.walks.kept) == 1


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        pytest.param(1, ["no method", "every method"], id="one method"),
        pytest.param(2, ["no method", "one method", "every method"], id="two"),
        pytest.param(
            4,
            ["no method", "one method", "half or more", "half or more", "every method"],
            id="exactly half is half or more",
        ),
        pytest.param(
            5,
            ["no method", "one method", "less than half", *["half or more"] * 2, "every method"],
            id="two of five are less",
        ),
    ],
)
def test_difficulty_by_the_number_of_methods_that_solve(
    number: int, expected: list[str], server: Serving
) -> None:
    """Episode k is solved by the first k methods."""
    unused = np.zeros(number + 1, dtype=np.int64)
    walks = [
        WalkOutcomes(
            outcome=np.where(np.arange(number + 1) > method, 4, 0),
            path_length=np.arange(10.0 * method, 10.0 * method + number + 1),
            stop=unused,
            wrong_turn=unused,
        )
        for method in range(number)
    ]
    methods = [ShownMethod(f"{each}", f"M{each}", "", 1.0) for each in range(number)]
    beside = SideBySide(server.state.boards[OPEN], methods, walks, ["a"] * (number + 1))
    assert beside.solved.tolist() == [*range(number + 1)]
    assert beside.difficulty == expected
    assert sum(beside.counts.values()) == number + 1
    assert [each.name for each in beside.solvers(1)] == ["M0"]
    assert beside.lengths(number) == [number + 10.0 * method for method in range(number)]
    assert [(each.scan, each.episodes, each.solved) for each in beside.buildings] == [
        ("a", number + 1, 0.5)
    ]


def test_a_building_shows_where_walks_end(server: Serving) -> None:
    mediocre = publish(server, OTHER, MEDIOCRE.read_bytes())
    publish(server, OWNER, GOOD.read_bytes())
    scan = rv.evaluate(GOOD, split=OPEN).ground_truth.graph.scan_ids[0]

    def stops(query: str) -> int:
        page = server.client.get(f"{LIST}?scan={scan}{query}").text
        numbers = re.findall(
            r"Walks in [^<]*: ([\d,]+) stops at the goal, (\d+) after it, (\d+) ", page
        )
        return sum(int(number.replace(",", "")) for storey in numbers for number in storey)

    episodes = int(
        re.findall(r"(\d+) episodes found", server.client.get(f"{LIST}?scan={scan}").text)[0]
    )
    assert stops("") == 2 * episodes
    assert stops(f"&submission={mediocre}") == episodes
    assert "Where walks end" not in server.client.get(f"{LIST}?scan=elsewhere").text


def test_without_a_method_there_is_nothing_to_compare(server: Serving) -> None:
    page = server.client.get(LIST)
    assert "Difficulty" not in page.text
    assert "Solved by" not in page.text
    assert "0 episodes found" in said(server.client.get(f"{LIST}?solved_by=no+method"))


def test_what_a_result_consists_of(server: Serving) -> None:
    good = publish(server, OWNER, GOOD.read_bytes())
    other = publish(server, OTHER, MEDIOCRE.read_bytes(), shows_episodes=False)
    scores = rv.evaluate(GOOD, split=OPEN).with_intervals()
    page = server.client.get(f"/submissions/{good}/analysis")
    funnel, counts, ranks, *groups = tables(page)
    modes = scores.failure_modes
    assert {row[0]: int(row[1].replace(",", "")) for row in funnel} == modes.funnel
    assert [int(row[1]) for row in counts] == [*modes.counts.values()][::-1]
    assert [row[:2] for row in ranks] == [["1", "Of Ada"], ["2", "Of Carl"]]
    lengths = scores.breakdown("length")
    assert [(row[0], int(row[1])) for row in groups[0]] == [
        (name, count) for name, count in lengths["episodes"].items() if count
    ]
    assert "Near misses" in page.text
    assert "Near misses" not in server.client.get(f"/submissions/{other}/analysis").text
    assert "1 of 2" in page.text, "the rank over time"


def test_nobody_waits_for_the_analysis_of_many_episodes(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    episodes = len(server.state.boards[OPEN].truth.episodes.instr_ids)
    one, other = (publish(server, OWNER, GOOD.read_bytes() + b" " * each) for each in range(2))
    monkeypatch.setattr(results_page, "EPISODES_AWAITED", episodes)
    assert "Strengths and weaknesses" in said(server.client.get(f"/submissions/{one}/analysis"))
    monkeypatch.setattr(results_page, "EPISODES_AWAITED", episodes - 1)
    page = f"/submissions/{other}/analysis"
    first = server.client.get(page)
    assert "The server is analysing this result." in said(first)
    assert f'<a href="{page}">Reload' in first.text
    assert "Strengths and weaknesses" not in first.text
    wait_until(lambda: "Strengths and weaknesses" in said(server.client.get(page)))


def test_one_sees_where_one_s_result_fails_before_it_is_published(server: Serving) -> None:
    identity = server.upload(OWNER, GOOD.read_bytes()).json()["submission"]["id"]
    visitor, page = signed_in(server, OWNER), f"/submissions/{identity}"
    scores, _, _ = visitor.get(page).text.partition('id="publish"')
    assert f'href="{page}/analysis"' in scores
    assert "Near misses" in visitor.get(f"{page}/analysis").text
    assert server.client.get(f"{page}/analysis").status_code == 404


def test_who_sees_near_misses(server: Serving) -> None:
    """The team and the organiser, of a baseline everybody; they see small groups too."""
    identity = publish(server, OWNER, GOOD.read_bytes(), shows_episodes=False)
    page = f"/submissions/{identity}/analysis"
    visitors = {None: server.client} | {
        who: signed_in(server, who) for who in (OWNER, OTHER, ORGANISER)
    }

    def those_who_see() -> set[str | None]:
        pages = {who: visitor.get(page).text for who, visitor in visitors.items()}
        seen = {who for who, text in pages.items() if "Near misses" in text}
        assert seen == {who for who, text in pages.items() if "Groups of fewer" not in text}
        return seen

    assert those_who_see() == {OWNER, ORGANISER}
    with server.acting() as transaction:
        review(transaction, identity, "baseline", "It is the organiser's.")
    assert those_who_see() == {None, OWNER, OTHER, ORGANISER}


@pytest.mark.parametrize(
    ("sizes", "shown"),
    [
        pytest.param([50, 10, 12], [50, 10, 12], id="none is small"),
        pytest.param([50, 9, 2, 10], [50, 10], id="small ones hide each other"),
        pytest.param([50, 1, 12, 30], [50, 30], id="alone, it would follow from the total"),
        pytest.param([50, 12, 4, 5], [50], id="so would two that are few together"),
        pytest.param([1, 2], [], id="all are small"),
    ],
)
def test_small_groups_show_no_single_episode(sizes: list[int], shown: list[int]) -> None:
    rows = [GroupRow(str(number), size, "0.00", [None]) for number, size in enumerate(sizes)]
    table = Breakdown(find_grouping("scan"), rows)
    analysis = Analysis("", "rgspl", True, (), (), (), [table], table, {})  # noqa: FBT003
    found = analysis.without_small_groups()
    assert [row.episodes for row in found.scans.rows] == shown
    assert found.breakdowns == ([found.scans] if shown else [])


def test_a_method_without_answers_is_listed_by_its_own_metric_and_not_compared(
    server: Serving,
) -> None:
    publish(server, OTHER, MEDIOCRE.read_bytes())
    records = json.loads(GOOD.read_bytes())
    walks = json.dumps([{k: v for k, v in each.items() if k != "predObjId"} for each in records])
    sent = server.upload(OWNER, walks.encode(), OPEN, name="Walks alone", navigation_only="true")
    identity = sent.json()["submission"]["id"]
    change = {"published": True, "shows_episodes": True}
    server.ask(OWNER, "PATCH", f"/submissions/{identity}", json=change)
    assert "1 method whose episodes" in said(server.client.get(LIST))
    for query in (f"submission={identity}", f"submission=random&other={identity}"):
        page = server.client.get(f"{LIST}?{query}")
        assert page.status_code == 200
        assert "Outcome counts" not in page.text
    (episodes,) = tables(server.client.get(f"{LIST}?submission={identity}"))
    spl = rv.evaluate(GOOD, split=OPEN).episodes["spl"][:2]
    assert [row[1] for row in episodes[:2]] == [f"{100 * value:.2f}" for value in spl]


def test_a_damaged_file_is_left_out(server: Serving) -> None:
    publish(server, OTHER, MEDIOCRE.read_bytes())
    publish(server, OWNER, GOOD.read_bytes())
    digest = hashlib.sha256(GOOD.read_bytes()).hexdigest()
    (file,) = server.state.settings.folder.rglob(f"{digest}*")
    content = file.read_bytes()
    file.write_bytes(b"")
    assert "1 method whose episodes" in said(server.client.get(LIST))
    file.write_bytes(content)
    assert "2 methods whose episodes" in said(server.client.get(LIST))


def test_nobody_waits_for_many_files(server: Serving, folder: Path) -> None:
    """As after a correction: the page says that methods are being compared."""
    with running(folder) as (_, url):
        for number in range(MOST_AWAITED + 1):
            publish(server, OWNER, GOOD.read_bytes() + b" " * number)
        wait_until(lambda: scorers(folder / "log"))
        held = scorers(folder / "log")
        for process in held:
            os.kill(process, signal.SIGSTOP)
        page = httpx.get(f"{url}{LIST}?solved_by=no+method")
        for process in held:
            os.kill(process, signal.SIGCONT)
        assert "The server is comparing methods" in page.text
        assert f'<a href="{LIST}?solved_by=no+method">Reload' in page.text
        assert "Difficulty" not in page.text
        wait_until(lambda: "3 methods whose episodes" in said(httpx.get(f"{url}{LIST}")))


def test_a_job_compares_methods_when_the_server_starts(server: Serving) -> None:
    for number in range(MOST_AWAITED + 1):
        publish(server, OWNER, GOOD.read_bytes() + b" " * number)
    (job,) = (each for each in jobs_of(server.state).jobs if each.name == "methods")
    job.work()
    assert "3 methods whose episodes" in said(server.client.get(LIST))


def test_a_private_result_has_no_analysis(server: Serving) -> None:
    private = publish(server, OWNER, submission_for(PRIVATE, "shortest"), PRIVATE)
    page = server.client.get(f"/submissions/{private}/analysis")
    assert page.status_code == 404
    assert "values of private splits are never released" in said(page)
    assert "/analysis" not in server.client.get(f"/submissions/{private}").text


def test_a_team_s_page_has_what_is_public_of_it(server: Serving) -> None:
    first = publish(server, OWNER, GOOD.read_bytes())
    publish(server, OWNER, submission_for(PRIVATE, "shortest"), PRIVATE)
    hidden = publish(server, OTHER, MEDIOCRE.read_bytes(), anonymous_until="2030-01-01T00:00:00Z")
    board = server.client.get(f"/splits/{OPEN}").text
    (address,) = set(re.findall(r'href="(/teams/\d+)"', board))
    page = server.client.get(address)
    assert "Blue" in page.text
    assert [[row[1] for row in table] for table in tables(page)] == [["Of Ada"], ["Of Ada"]]
    assert page.text.count("of the team") + page.text.count("1 of ") >= 2
    assert first in page.text
    assert hidden not in page.text
    for number in range(1, 5):
        other = server.client.get(f"/teams/{number}")
        assert (other.status_code == 200) == (f"/teams/{number}" == address)
    assert server.client.get(f"/submissions/{hidden}").text.count("/teams/") == 0


def test_a_disqualified_result_keeps_its_team_s_page(server: Serving) -> None:
    """The board leads there from what is listed separately, too; methods are compared without."""
    identity = publish(server, OWNER, GOOD.read_bytes())
    publish(server, OTHER, MEDIOCRE.read_bytes())
    assert "2 methods whose episodes" in said(server.client.get(LIST))
    with server.acting() as transaction:
        review(transaction, identity, "disqualified", "It read the answers.")
    assert "1 method whose episodes" in said(server.client.get(LIST))
    board = server.client.get(f"/splits/{OPEN}").text
    (address,) = set(re.findall(r'>Of Ada</a>.*?href="(/teams/\d+)"', board, re.DOTALL))
    page = server.client.get(address)
    assert [[row[1] for row in table] for table in tables(page)] == [["Of Ada disqualified"]]
