"""Two results of a leaderboard side by side."""

import re
from collections.abc import Mapping
from datetime import timedelta
from html import unescape
from pathlib import Path
from urllib.parse import urlencode

import pytest

import reverie_eval as rv
from reverie_eval import CATALOGUE
from reverie_eval.analysis import Difference
from reverie_eval.metrics import Metric
from reverie_eval.reporting.comparisons import signed
from reverie_eval.schemas.service import Phase
from reverie_eval.server.boards.leaderboard import Rankings
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.explore.results_page import ComparedPair, compare_results
from reverie_eval.server.intake.submissions import SubmissionService
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.store.tables import Submission
from tests.conftest import SAMPLES
from tests.support.acting import NOON, review
from tests.support.entries import entered, get, named, report_result, tables
from tests.support.serving import (
    GROUNDING,
    OPEN,
    ORGANISER,
    OTHER,
    OTHER_BOARDS,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
)
from tests.support.visiting import said

FILES = {"Mediocre": SAMPLES / "mediocre.json", "Good": SAMPLES / "good.json"}


def publish_two(server: Serving) -> tuple[str, str]:
    """Publish two results on an open split, the second as a baseline; return their ids."""
    ids = {}
    for who, (name, file) in zip((OTHER, OWNER), FILES.items(), strict=True):
        reply = server.upload(who, file.read_bytes(), name=name)
        ids[name] = reply.json()["submission"]["id"]
        change(server, who, ids[name], published=True)
    with server.acting(ORGANISER) as transaction:
        review(transaction, ids["Mediocre"], "baseline", "ours")
    return ids["Good"], ids["Mediocre"]


def change(server: Serving, who: str, submission: str, **changed: object) -> None:
    reply = server.ask(who, "PATCH", f"/submissions/{submission}", json=changed)
    assert reply.status_code == 200


def place(*ids: str, board: str = OPEN) -> str:
    return f"/splits/{board}/compare?{urlencode([('result', each) for each in ids])}"


def bar_of(metric: Metric, found: Difference) -> str:
    """Return what is said of the bar of a difference; lengths have none."""
    if metric.unit != "fraction":
        return ""
    return f"{metric.label}: {ends_of(metric, found)}"


def ends_of(metric: Metric, found: Difference) -> str:
    return f"{signed(metric, found.interval.low)} to {signed(metric, found.interval.high)}"


def outcomes_of(name: str) -> Mapping[str, str]:
    scores = rv.evaluate(FILES[name], split=OPEN)
    return dict(zip(scores.instr_ids, scores.outcomes, strict=True))


def test_two_ticks_lead_to_what_the_command_says_of_the_files(server: Serving) -> None:
    good, mediocre = publish_two(server)
    board = get(server).text
    ticks = re.findall(r'type="checkbox" form="compare" name="result" value="(\w+)"', board)
    assert re.findall(r'<form [^>]*id="compare" [^>]*action="([^"]*)"', board) == [
        f"/splits/{OPEN}/compare"
    ]
    assert ticks == [good, mediocre]

    page = get(server, "", place(*ticks))
    expected = rv.compare(*FILES.values(), split=OPEN, names=list(FILES))
    assert f"{expected.sentence('Good')}." in said(page)
    assert tables(page)[0] == [
        [
            CATALOGUE[key].heading,
            CATALOGUE[key].display(expected.scores["Good"][key]),
            CATALOGUE[key].display(expected.scores["Mediocre"][key]),
            f"{signed(CATALOGUE[key], found.mean)} {ends_of(CATALOGUE[key], found)}",
            bar_of(CATALOGUE[key], found),
        ]
        for key, found in expected["Good"].items()
    ]
    assert "where both teams show their episodes" in said(page)

    change(server, OWNER, good, shows_episodes=True)
    page = get(server, "", place(*ticks))
    correct = [
        {instr_id for instr_id, outcome in outcomes_of(name).items() if outcome == "correct"}
        for name in ("Good", "Mediocre")
    ]
    gained, lost = len(correct[0] - correct[1]), len(correct[1] - correct[0])
    assert f"Only Good is correct in {gained} episodes, only Mediocre in {lost}." in said(page)
    counts = re.findall(r'<a href="(/episodes/[^"#]*)#list">(\d+)</a>', page.text)
    assert sum(int(count) for _, count in counts) == len(outcomes_of("Good"))
    for name, won in (("Good", correct[0] - correct[1]), ("Mediocre", correct[1] - correct[0])):
        begin = page.text.index(f"in which only {name} is correct")
        listed = re.findall(
            r"/episodes/[^/]*/([^?]*)\?submission", page.text[begin:].split("</ol>")[0]
        )
        assert listed == [each for each in outcomes_of("Good") if each in won][:10]
    link, count = counts[-1]
    assert f"{count} episodes found" in said(server.client.get(unescape(link)))

    with server.state.database.writing() as session:
        row = session.get_one(Submission, good)
        row.report = {**row.report, "fingerprint": "0" * 64}
    page = get(server, "", place(*ticks))
    assert "There are no intervals: the ground truth or protocol" in said(page)
    assert "Walks side by side" not in said(page)


def test_another_leaderboard_compares_by_its_own_rules(
    folder: Path, open_server: OpenServer
) -> None:
    settings = adjusted(settings_of(folder), OPEN, boards={GROUNDING: OTHER_BOARDS[GROUNDING]})
    server = open_server(settings)
    page = get(server, "", place(*publish_two(server), board=f"{OPEN}/boards/{GROUNDING}"))
    expected = rv.compare(*FILES.values(), split=OPEN, names=list(FILES), track="grounding")
    assert f"{expected.sentence('Good')}." in said(page)
    assert "side by side" not in said(page)


def test_a_private_split_has_differences_of_what_everyone_sees(server: Serving) -> None:
    values = ({"rgspl": 0.5012, "spl": 0.5}, {"rgspl": 0.25, "spl": 0.625}, {"rgs": 0.5})
    ant, bee, cat = (
        entered(server, scores, who, PRIVATE, **named(name))
        for scores, who, name in zip(
            values, (OWNER, OTHER, OWNER), ("Ant", "Bee", "Cat"), strict=True
        )
    )
    page = get(server, "", place(ant, bee, board=PRIVATE))
    assert tables(page) == [
        [["SPL %", "50.00", "62.50", "-12.50"], ["RGSPL %", "50.12", "25.00", "+25.12"]]
    ]
    assert "There are no intervals: this split is private" in said(page)
    page = get(server, "", place(ant, cat, board=PRIVATE))
    assert "The two have no scores in common." in said(page)


def test_nothing_is_said_of_scores_that_are_held_back(
    folder: Path, open_server: OpenServer
) -> None:
    phases = (Phase(name="first", closes=NOON + timedelta(days=1)),)
    settings = adjusted(settings_of(folder), OPEN, phases=phases, release_scores="phase-end")
    server = open_server(settings)
    good, mediocre = publish_two(server)
    change(server, OWNER, good, shows_episodes=True)
    page = said(get(server, "", place(good, mediocre)))
    assert "no scores in common, because some are held back" in page
    assert "better" not in page.partition("compare ")[2].partition("reverie-eval")[0]
    assert "Outcomes" not in page


def test_what_cannot_be_compared(server: Serving) -> None:
    first = entered(server, {"rgspl": 0.5})
    assert 'name="result"' not in get(server).text  # nothing to compare it with
    second, bad = (entered(server, {"rgspl": 0.25}, who) for who in (OTHER, OWNER))
    with server.acting(ORGANISER) as transaction:
        review(transaction, bad, "disqualified", "used the answers")
    report_result(server, "Theirs", rgspl=0.375)
    board = get(server)
    assert re.findall(r'name="result" value="(\w+)"', board.text) == [first, second]
    assert "Tick two that this server has scored" in said(board)

    for ticked, status, says in (
        ([], 400, "Tick two results to compare, not 0"),
        ([first], 400, "Tick two results to compare, not 1"),
        ([first, first], 400, "Tick two results to compare, not 1"),
        ([first, second, bad], 400, "Tick two results to compare, not 3"),
        ([first, "x"], 404, "no ranked result 'x'"),
        ([first, bad], 404, "scored under other rules cannot be compared"),
    ):
        assert says in said(get(server, "", place(*ticked), status))


# What the page shows, in numbers.


def pair_of(server: Serving, *ids: str, board: Board | None = None) -> ComparedPair:
    with server.state.database.reading() as session:
        ranking = server.state.get(Rankings).ranking(session, board or server.state.boards[OPEN])
        return compare_results(session, server.state.get(SubmissionService), ranking, ids)


def test_a_pair_has_differences_and_outcomes_of_the_first_minus_the_second(
    several: Serving,
) -> None:
    good, mediocre = publish_two(several)
    pair = pair_of(several, good, mediocre)
    scores = {name: rv.evaluate(file, split=OPEN) for name, file in FILES.items()}
    assert (list(pair.names), pair.why_not, pair.outcomes) == (["Good", "Mediocre"], "", {})
    assert [row.entry.submission_id for row in pair.rows] == [good, mediocre]
    headline = ["path_length", "success", "oracle_success", "spl", "rgs", "rgspl"]
    assert [metric.key for metric in pair.metrics][:7] == [*headline, "navigation_error"]
    for metric in pair.metrics:
        difference = scores["Good"][metric.key] - scores["Mediocre"][metric.key]
        assert pair.difference(metric) == pytest.approx(difference, abs=1e-12)
        found = pair.paired(metric)
        assert found is None or found.mean == pair.difference(metric)
    assert pair.paired(CATALOGUE["rgspl"]) is not None

    change(several, OWNER, good, shows_episodes=True)
    pair = pair_of(several, good, mediocre)
    outcomes = list(
        zip(*(outcomes_of(name).values() for name in ("Good", "Mediocre")), strict=True)
    )
    for first, row in pair.outcomes.items():
        assert list(row) == list(pair.outcomes)
        for second, count in row.items():
            assert count == outcomes.count((first, second))
    gained = sum(first == "correct" != second for first, second in outcomes)
    lost = sum(first != "correct" == second for first, second in outcomes)
    assert list(pair.won) == [gained, lost]
    assert gained != lost
    turned = pair_of(several, mediocre, good)
    assert list(turned.won) == [lost, gained]
    for board in several.state.boards[OPEN].others.values():
        assert pair_of(several, good, mediocre, board=board).outcomes == {}


def test_a_private_pair_has_what_everyone_sees_and_no_more(server: Serving) -> None:
    values = {"spl": 0.5, "path_length": 9.0, "rgspl": 0.5}
    one, two = (
        entered(server, {**values, "spl": spl}, who, PRIVATE, **named("Ant"))
        for who, spl in ((OWNER, 0.5), (OTHER, 0.625))
    )
    pair = pair_of(server, one, two, board=server.state.boards[PRIVATE])
    assert (pair.comparison, pair.outcomes) == (None, {})
    assert list(pair.names) == ["Ant (Blue)", "Ant (Red)"]
    assert pair.why_not == (
        "this split is private, and an interval of a difference would reveal more about its "
        "episodes than the digits that everyone sees"
    )
    assert pair.difference(CATALOGUE["spl"]) == -0.125
    assert pair.paired(CATALOGUE["spl"]) is None
    with pytest.raises(NotFoundError) as missing:
        pair_of(server, one, two)
    assert str(missing.value) == (
        f"{OPEN} has no ranked result {one!r}; results that are reported, disqualified or scored "
        "under other rules cannot be compared"
    )


def test_a_pair_whose_scores_are_held_back_says_so(folder: Path, open_server: OpenServer) -> None:
    phases = (Phase(name="first", closes=NOON + timedelta(days=1)),)
    held = adjusted(settings_of(folder), PRIVATE, phases=phases, release_scores="phase-end")
    server = open_server(held)
    one, two = (entered(server, None, who, PRIVATE) for who in (OWNER, OTHER))
    pair = pair_of(server, one, two, board=server.state.boards[PRIVATE])
    assert pair.why_not == "scores are held back until the phase ends"
    assert (list(pair.metrics), pair.comparison) == ([], None)
