"""The pages of boards: what is where, who is named, and what stays out of the ranking."""

import re
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import html5lib
import httpx
import pytest

from reverie_eval import CATALOGUE
from reverie_eval.reporting.service import METHOD_FLAGS
from reverie_eval.schemas.service import Phase, Verdict
from reverie_eval.server.boards.reviews import lift_review
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.intake.submissions import SubmissionService, submission_of
from reverie_eval.server.state import Reading
from reverie_eval.tasks.reverie import TASK as REVERIE
from tests.support.acting import review
from tests.support.entries import BOARD, HTML, entered, get, named, report_result, tables
from tests.support.serving import (
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    CopyServer,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
)
from tests.support.visiting import said, signed_in

MARKUP = "<script>alert(1)</script>"


def ranking(server: Serving, query: str = "") -> list[tuple[str, str]]:
    """Return rank and method of the ranked rows."""
    rows = tables(get(server, query))[0]
    return [(row[0].split(" ")[0], row[1].split(" ")[0]) for row in rows if len(row) > 1]


def headings(reply: httpx.Response) -> list[str]:
    document = html5lib.parse(reply.text)
    head = next(document.iter(f"{HTML}thead"))
    return [
        "".join(cell.itertext()).split(" ")[0].strip()
        for cell in head.iter(f"{HTML}th")
        if {"team", "first"}.isdisjoint(cell.get("class", "").split())
    ]


def judge(server: Serving, submission: str, verdict: Verdict, reason: str = "checked") -> int:
    with server.acting(ORGANISER) as transaction:
        return review(transaction, submission, verdict, reason).id


@pytest.fixture(scope="module")
def five_results(original: Serving) -> Serving:
    """Return a server with five results: two tie, one has no SPL."""
    entered(original, {"rgspl": 0.25, "spl": 0.5, "path_length": 12.0}, **named("Ant"))
    entered(original, {"rgspl": 0.5, "spl": 0.25, "path_length": 9.5}, OTHER, **named("Bee"))
    entered(original, {"rgspl": 0.25, "path_length": 30.25}, **named("Cat"))
    entered(original, {"rgspl": 0.125, "spl": 0.75, "navigation_error": 4.0}, **named("Dog"))
    entered(original, {"spl": 0.5, "navigation_error": 2.0}, OTHER, **named("Elk"))
    return original


@pytest.fixture
def five(five_results: Serving, copy_server: CopyServer) -> Serving:
    """Return a copy of it."""
    return copy_server(five_results)


SORTED = [
    pytest.param(
        "",
        [("1", "Bee"), ("2", "Ant"), ("2", "Cat"), ("4", "Dog"), ("-", "Elk")],
        id="by the primary metric",
    ),
    pytest.param(
        "?metric=spl",
        [("1", "Dog"), ("2", "Ant"), ("2", "Elk"), ("4", "Bee"), ("-", "Cat")],
        id="by another: ties are equal, no score is last",
    ),
    pytest.param(
        "?metric=navigation_error",
        [("1", "Elk"), ("2", "Dog"), ("-", "Ant"), ("-", "Bee"), ("-", "Cat")],
        id="less is better",
    ),
    pytest.param(
        "?metric=path_length",
        [("1", "Bee"), ("2", "Ant"), ("2", "Cat"), ("4", "Dog"), ("-", "Elk")],
        id="neither is better: the least first, ranked by the primary metric",
    ),
]


@pytest.mark.parametrize(("query", "expected"), SORTED)
def test_a_board_sorted(five: Serving, query: str, expected: list[tuple[str, str]]) -> None:
    assert ranking(five, query) == expected


def test_every_metric_has_a_link_that_sorts_by_it(five: Serving) -> None:
    page = get(five, "?columns=all").text
    links = dict(re.findall(r'href="(\?[^"]*metric=(\w+)[^"]*)" title', page))
    assert set(links.values()) == {
        "path_length",
        "success",
        "oracle_success",
        "spl",
        "rgs",
        "navigation_error",
    }
    for link, key in links.items():
        text = get(five, unescape(link)).text
        (direction,) = set(re.findall(r'aria-sort="(\w+)"', text))
        assert direction == ("descending" if CATALOGUE[key].better == "higher" else "ascending")


def test_columns_are_grouped_in_the_order_of_papers(five: Serving) -> None:
    about, groups = ["#", "Method,"], ["Navigation", "Grounding"]
    usual = ["SR", "OSR", "SPL", "TL", "RGS", "RGSPL"]
    assert headings(get(five)) == [*about, *groups, "Entries", "Date", *usual]
    assert headings(get(five, "?columns=all"))[6:] == [*usual[:4], "NE", *usual[4:]]
    assert headings(get(five, "?metric=navigation_error"))[6:] == [*usual[:4], "NE", *usual[4:]]


@pytest.mark.parametrize(("query", "label"), [("", "RGSPL %"), ("?metric=spl", "SPL %")])
def test_what_it_is_sorted_by_also_comes_first_for_phones(
    five: Serving, query: str, label: str
) -> None:
    page = get(five, query).text
    ((heading, values),) = [
        (re.findall(r'<th scope="col" class="number first\b.*?>([A-Z]+ %)<', page), values)
        for values in [re.findall(r'<td class="first"[^>]*>([\d.-]+)', page)]
    ]
    assert heading == [label]
    assert values == re.findall(r'<td class="primary"[^>]*>([\d.-]+)', page)
    assert len(values) == 5


def test_every_column_is_explained_below_the_table(five: Serving) -> None:
    page = get(five, "?metric=navigation_error").text
    meanings = re.findall(r"<summary>Column definitions</summary>(.*?)</details>", page, re.DOTALL)
    explained = re.findall(r'<dt><a href="/guide/metrics#(\w+)">(.*?) \S+</a></dt>', meanings[0])
    assert [label for _, label in explained] == headings(get(five, "?metric=navigation_error"))[6:]
    for key, _ in explained:
        assert CATALOGUE[key].definition in unescape(meanings[0])


def test_what_was_declared_of_an_episode_has_columns(server: Serving) -> None:
    sampled = {"input_class": "objects", "sample_size": 60}
    entered(server, {"rgspl": 0.5}, **named("Ant", money_per_episode=0.0375, **sampled))
    entered(server, {"rgspl": 0.25}, **named("Bee", input_tokens_per_episode=18250.4))
    entered(server, {"rgspl": 0.125}, **named("Cat"))
    usual = [row[1] for row in tables(get(server))[0]]
    assert usual[0].startswith("Ant Blue objects 60 ep. $0.0375 ")
    assert "$" not in usual[1] + usual[2]
    page = get(server, "?columns=all")
    ant, bee, cat = tables(page)[0]
    assert [row[-4:-2] for row in (ant, bee, cat)] == [["-", "0.0375"], ["18,250", "-"], ["-", "-"]]
    assert ant[1].startswith("Ant Blue objects 60 ep.")
    assert all(each in page.text for each in (">Declared<", ">tokens in<", ">US$<"))
    assert "Declared by the team, not measured here" in page.text
    for query, shown in {
        "input_class=objects": ["Ant"],
        "input_class=undeclared": ["Bee", "Cat"],
        "sample_from=61": ["Bee", "Cat"],
        "money_until=0.0375&sample_from=60": ["Ant"],
        "money_until=0": [],
        "money_until=&sample_from=&input_class=": ["Ant", "Bee", "Cat"],
    }.items():
        rows = tables(get(server, f"?{query}"))[0]
        assert [row[1].split()[0] for row in rows if len(row) > 1] == shown, query
    assert 'href="?">Clear</a>' in get(server, "?money_until=1&input_class=views").text
    assert server.client.get(f"/splits/{OPEN}?money_until=-1").status_code == 400


def test_a_metric_that_nothing_has_is_said_to_be_so(five: Serving) -> None:
    absent = get(five, "?metric=ndtw").text
    nothing = "No result on this leaderboard has a value for"
    assert f"{nothing} normalised dynamic time warping (nDTW)" in absent
    assert nothing not in get(five, "?metric=navigation_error").text


def test_a_filter_keeps_the_axes_of_the_charts(five: Serving) -> None:
    page = get(five, "?x=spl&y=success&text=bee").text
    kept = dict(re.findall(r'<input type="hidden" name="(\w+)" value="(\w*)">', page))
    assert kept == {"metric": "rgspl", "columns": "", "x": "spl", "y": "success"}
    assert 'href="?x=spl&amp;y=success">Clear</a>' in page


def test_cells(five: Serving) -> None:
    rank, method, *values, primary, entries, date = tables(get(five))[0][0]
    assert (rank.split(" ")[0], method) == ("1", "Bee Red ? not declared")
    assert re.fullmatch(r"50\.00 95 % interval [\d.]+ to [\d.]+", primary)
    assert values == ["-", "-", "25.00", "9.50", "-"]
    assert (entries, date) == ("2", "2026-03-02")


def test_what_nobody_has_declared_is_shown_of_every_result(server: Serving) -> None:
    none_applies = dict.fromkeys(METHOD_FLAGS, False)
    entered(server, {"rgspl": 0.5}, **named("Ant", **none_applies))
    entered(server, {"rgspl": 0.25}, **named("Bee", **{**none_applies, "ensemble": None}))
    report_result(server, "FAST", human=True, rgspl=0.125)
    ant, bee, fast = (row[1] for row in tables(get(server))[0])
    assert (ant, bee) == ("Ant Blue", "Bee Blue ? not declared")
    assert fast == "FAST Qi et al. reported human ? not declared source"
    titles = re.findall(r'title="not declared: ([^"]*)"', get(server).text)
    others = (words for flag, words in METHOD_FLAGS.items() if flag != "human")
    assert titles == ["ensemble", ", ".join(others)]


def test_the_head_counts_results_and_teams_that_are_named(five: Serving) -> None:
    report_result(five, "FAST", rgspl=0.99)
    assert "<strong>5 results</strong> from 2 teams, 1 reported" in get(five).text
    heads = []
    for who in (OTHER, OWNER):
        for row in five.ask(who, "GET", "/submissions").json():
            change = {"anonymous_until": "2100-01-01T00:00:00Z"}
            five.ask(who, "PATCH", f"/submissions/{row['id']}", json=change)
        heads.append(get(five).text)
    assert "<strong>5 results</strong> from 1 named team, 1 reported" in heads[0]
    assert "<strong>5 results</strong>, 1 reported" in heads[1]


def test_the_head_says_until_when_results_are_accepted(
    open_server: OpenServer, folder: Path
) -> None:
    phase = Phase.model_validate({"name": "2026", "closes": "2026-06-01T00:00:00Z"})
    server = open_server(adjusted(settings_of(folder), OPEN, phases=(phase,)))
    assert 'open</span> until <time datetime="2026-06-01' in get(server).text
    server.clock.turn(days=200)
    assert '<span class="badge">closed</span>' in get(server).text


def test_rows_of_one_s_own_team_are_marked(five: Serving) -> None:
    for who, own in ((None, []), (OTHER, ["Bee", "Elk"])):
        page = signed_in(five, who).get(BOARD) if who else get(five)
        rows = re.findall(r'<tr class="mine">.*?title="(\w+)".*?yours', page.text, re.DOTALL)
        assert rows == own


FILTERED = [
    pytest.param("?extra_data=with", ["Bee"], id="with a flag"),
    pytest.param("?extra_data=without", ["Cat"], id="declared to be without it"),
    pytest.param("?extra_data=undeclared", ["Ant"], id="not declared"),
    pytest.param("?extra_data=with&human=with", [], id="all must hold"),
    pytest.param("?human=with", ["Cat"], id="another flag"),
    pytest.param("?text=bEe", ["Bee"], id="the method, whatever the case"),
    pytest.param("?text=blu", ["Ant"], id="the team, unless it is anonymous"),
    pytest.param("?text=%20", ["Bee", "Ant", "Cat"], id="blank is nothing"),
    pytest.param("?text=.*", [], id="text is no pattern"),
    pytest.param("?since=2026-03-03", ["Bee", "Cat"], id="from a day on, that day too"),
    pytest.param("?until=2026-03-03", ["Bee", "Ant"], id="until a day, that day too"),
    pytest.param("?since=2026-03-03&until=2026-03-03", ["Bee"], id="on a day"),
    pytest.param("?since=&until=&extra_data=&text=", ["Bee", "Ant", "Cat"], id="as forms send it"),
]


@pytest.mark.parametrize(("query", "expected"), FILTERED)
def test_filters(server: Serving, query: str, expected: list[str]) -> None:
    day = {"hours": 24}
    entered(server, {"rgspl": 0.5}, **named("Ant"))
    server.clock.turn(**day)
    entered(server, {"rgspl": 0.75}, OTHER, **named("Bee", extra_data=True))
    server.clock.turn(**day)
    until = "2026-12-31T00:00:00Z"
    entered(
        server, {"rgspl": 0.25}, anonymous_until=until, **named("Cat", human=True, extra_data=False)
    )
    rows = ranking(server, query)
    ranks = {"Bee": "1", "Ant": "2", "Cat": "3"}  # of the whole board, whatever is shown
    assert rows == [(ranks[name], name) for name in expected]
    assert ("No results match" in get(server, query).text) == (expected == [])


@pytest.mark.parametrize(
    "query",
    [
        "?metric=joy",
        "?extra_data=maybe",
        "?since=yesterday",
        "?page=0",
        "?page=x",
        "?x=joy",
        f"?text={'a' * 101}",
    ],
)
def test_a_query_that_is_none_is_a_page_that_says_so(server: Serving, query: str) -> None:
    page = get(server, query, status=400)
    assert "The request is invalid" in page.text
    assert "<h1>Invalid request</h1>" in page.text
    ((field, said),) = tables(page)[0]
    assert query.startswith(f"?{field}=")
    assert not re.search("should|Input|Value error", said)
    assert f'<a href="/splits/{OPEN}">Back to the {OPEN} leaderboard</a>' in page.text


def test_an_unknown_metric_suggests_only_metrics_of_the_leaderboard(server: Serving) -> None:
    page = get(server, "?metric=rgspll&x=goal_progress", status=400)
    near, other = (
        f"{REVERIE.title} has no metric {key!r}; " for key in ("rgspll", "goal_progress")
    )
    known = ", ".join(REVERIE.metrics)
    assert dict(tables(page)[0]) == {
        "metric": f"{near}did you mean rgspl? Choose one of: {known}",
        "x": f"{other}choose one of: {known}",
    }


def test_no_such_split(server: Serving) -> None:
    for part in ("", "/chart", "/latex", "/bibtex"):
        get(server, path=f"/splits/nowhere{part}", status=404)


def test_an_empty_board(server: Serving) -> None:
    page = get(server).text
    assert "No results are published yet." in page
    assert "<canvas" not in page


def test_names_are_text(server: Serving) -> None:
    entered(server, {"rgspl": 0.5}, **named(MARKUP))
    page = get(server).text
    assert MARKUP not in page
    assert tables(get(server))[0][0][1] == f"{MARKUP} Blue ? not declared"
    for part in ("chart", "latex", "bibtex"):
        kind = get(server, path=f"{BOARD}/{part}").headers["content-type"]
        assert kind.partition(";")[0] == ("application/json" if part == "chart" else "text/plain")


def test_a_filter_s_text_comes_back_as_text(server: Serving) -> None:
    page = get(server, "?text=%22%3E%3Cscript%3E").text
    assert "<script>" not in page.replace("<script src", "")
    assert 'value="&#34;&gt;&lt;script&gt;"' in page


def test_reviews_are_shown_with_who_and_when(five: Serving) -> None:
    rows = five.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()["rows"]
    judge(five, rows[0]["submission_id"], "verified", "run again from the code")
    judge(five, rows[0]["submission_id"], "baseline", "of the dataset's authors")
    number = judge(five, rows[1]["submission_id"], "flagged", "a question is open")
    page = get(five).text
    assert ranking(five)[0] == ("1", "Bee")
    assert 'title="run again from the code (the organiser, 2026-03-02)">verified</a>' in page
    assert re.search(r"a question is open.*the organiser.*2026-03-02", page, re.DOTALL)
    with five.acting(ORGANISER) as transaction:
        lift_review(transaction, number)
    assert "a question is open" not in get(five).text


def test_what_is_disqualified_is_not_ranked(five: Serving) -> None:
    rows = five.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()["rows"]
    number = judge(five, rows[0]["submission_id"], "disqualified", "trained on the split")
    assert ranking(five) == [("1", "Ant"), ("1", "Cat"), ("3", "Dog"), ("-", "Elk")]
    page = get(five)
    band, row = tables(page)[1]
    assert band == ["Disqualified 1 result by the organiser, with the reasons below"]
    assert row[0].startswith("Bee Red disqualified")
    assert "disqualified Bee: trained on the split the organiser, 2026-03-02" in said(page)
    with five.acting(ORGANISER) as transaction:
        lift_review(transaction, number)
    assert ranking(five)[0] == ("1", "Bee")


def test_reported_results_stand_among_the_others_without_a_rank(five: Serving) -> None:
    report_result(five, "FAST", date="2020-06", rgspl=0.99, spl=0.5)
    report_result(five, "Tie", source="An old leaderboard", date=None, rgspl=0.25)
    assert ranking(five) == [
        ("-", "FAST"),
        ("1", "Bee"),
        ("2", "Ant"),
        ("2", "Cat"),
        ("-", "Tie"),
        ("4", "Dog"),
        ("-", "Elk"),
    ]
    first, *_, tie, _, _ = tables(get(five))[0]
    assert first == [
        *(
            "-",
            "FAST Qi et al. reported ? not declared source",
            "-",
            "-",
            "50.00",
            "-",
            "-",
            "99.00",
        ),
        *("-", "2020-06"),
    ]
    assert tie[1] == "Tie Qi et al. reported ? not declared from: An old leaderboard"
    assert tie[-1] == "-"
    assert 'href="https://example.org/paper.pdf"' in get(five).text
    by_spl = [("1", "Dog"), ("2", "Ant"), ("2", "Elk"), ("-", "FAST"), ("4", "Bee")]
    assert ranking(five, "?metric=spl")[:5] == by_spl
    assert [name for _, name in ranking(five, "?metric=path_length")] == [
        *("Bee", "Ant", "Cat", "FAST", "Tie", "Dog", "Elk")
    ]


def test_citations_are_of_scored_results(five: Serving) -> None:
    report_result(five, "FAST", rgspl=0.99, spl=0.5)
    for copy in ("latex", "bibtex"):
        text = five.client.get(f"{BOARD}/{copy}").text
        assert "Bee" in text
        assert "FAST" not in text


ON_A_DATE = [
    pytest.param("?since=2020-06-30&until=2020-06-30", True, id="a day of the month"),
    pytest.param("?since=2020-07-01", False, id="after it"),
    pytest.param("?until=2020-05-31", False, id="before it"),
    pytest.param("?extra_data=with", False, id="not declared to be with"),
    pytest.param("?extra_data=without", False, id="not declared to be without"),
    pytest.param("?extra_data=undeclared&until=2020-06-30", True, id="not declared"),
]


@pytest.mark.parametrize(("query", "is_shown"), ON_A_DATE)
def test_filters_of_reported_results(query: str, server: Serving, *, is_shown: bool) -> None:
    report_result(server, "FAST", date="2020-06", rgspl=0.99)
    report_result(server, "Slow", date=None, rgspl=0.5)
    shown = [("-", "FAST")] if is_shown else []
    assert ranking(server, query) == shown


def test_results_on_another_version_of_the_dataset_are_apart(five: Serving) -> None:
    for name, dataset, value in (("Old", "v2", 0.5), ("Older", "v1", 1), ("Oldest", "v2", 0.99)):
        report_result(five, name, dataset=dataset, rgspl=value)
    report_result(five, "Same", dataset="Demo", rgspl=0.75)
    assert ranking(five)[0] == ("-", "Same")
    rows = [
        row[0].removesuffix(" Qi et al. reported ? not declared source")
        for band in tables(get(five))[1:]
        for row in band
    ]
    why = "another version of the dataset: this leaderboard is on demo"
    assert rows == [f"On v1 1 result {why}", "Older", f"On v2 2 results {why}", "Oldest", "Old"]
    assert "3 not ranked" in said(get(five))
    board = five.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()
    assert {each["standing"] for each in board["apart"]} == {"other-dataset"}


OTHER_RULES = [
    pytest.param("protocol:official-v1", "protocol:duet", False, id="another protocol"),
    pytest.param("|data:", "|data:0", False, id="another ground truth"),
    pytest.param("|data:", "|reading:first-of-hop|data:", False, id="read in another way"),
    pytest.param("version:", "version:9.", True, id="another version scores the same"),
]


@pytest.mark.parametrize(("old", "new", "is_ranked"), OTHER_RULES)
def test_what_other_rules_scored(server: Serving, old: str, new: str, *, is_ranked: bool) -> None:
    signature = server.state.boards[OPEN].signature.replace(old, new)
    entered(server, {"rgspl": 0.9}, report={"signature": signature}, **named("Ant"))
    entered(server, {"rgspl": 0.5}, **named("Bee"))
    expected = [("1", "Ant"), ("2", "Bee")] if is_ranked else [("1", "Bee")]
    assert ranking(server) == expected
    if not is_ranked:
        band, row = tables(get(server))[1]
        rules, _, _ = signature.rpartition("|version:")
        assert band == [f"Under other rules 1 result {rules}"]
        assert row[0].startswith("Ant")
    board = server.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()
    assert [each["standing"] for each in board["apart"]] == ["other-rules"] * (not is_ranked)


def test_intervals_of_open_splits_alone(server: Serving) -> None:
    entered(server)
    board = server.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()
    low, high = board["rows"][0]["intervals"]["rgspl"]
    assert 0 < low < board["rows"][0]["scores"]["rgspl"] < high < 1
    assert f"95 % interval {100 * low:.2f} to {100 * high:.2f}" in get(server).text
    entered(server, split=PRIVATE)
    board = server.ask(None, "GET", f"/splits/{PRIVATE}/leaderboard").json()
    assert board["rows"][0]["intervals"] == {}
    assert "confidence" not in get(server, path=f"/splits/{PRIVATE}").text


def test_intervals_are_those_of_the_command_line(server: Serving) -> None:
    submission = entered(server)
    report = server.ask(OWNER, "GET", f"/submissions/{submission}").json()["report"]
    with server.state.database.reading() as session:
        view = View.of(Reading(server.state, session, server.clock()))
        known = submission_of(session, server.person(OWNER), submission, view)
    scores = server.state.get(SubmissionService).episodes(known)
    expected = scores.with_intervals().intervals
    assert expected is not None
    assert report["intervals"]["resamples"] == 10_000
    assert report["intervals"]["intervals"]["spl"] == [expected["spl"].low, expected["spl"].high]


def test_nothing_is_stale(server: Serving) -> None:
    """Whatever changes is there at once, also if another process changes it."""
    submission = entered(server, {"rgspl": 0.5}, **named("Ant"))
    assert ranking(server) == [("1", "Ant")]

    def change(**what: Any) -> list[list[str]]:
        server.ask(OWNER, "PATCH", f"/submissions/{submission}", json=what)
        return tables(get(server))[0]

    assert change(method={"name": "Bee"})[0][1] == "Bee Blue ? not declared"
    assert change(anonymous_until="2026-03-03T12:00:00Z")[0][1] == "Bee anonymous ? not declared"
    server.clock.turn(hours=24)
    assert tables(get(server))[0][0][1] == "Bee Blue ? not declared"
    server.upload(OWNER, server.distinct())
    assert tables(get(server))[0][0][-2] == "2"
    assert "No results are published" in change(withdrawn=True)[0][0]


def test_pages_of_a_long_board(server: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reverie_eval.server.boards.pages.PER_PAGE", 2)
    for number in range(5):
        entered(server, {"rgspl": 0.5 - 0.1 * number}, **named(f"M{number}"))
    assert ranking(server) == [("1", "M0"), ("2", "M1")]
    assert ranking(server, "?page=2") == [("3", "M2"), ("4", "M3")]
    assert ranking(server, "?page=3") == [("5", "M4")]
    assert ranking(server, "?page=99") == [("5", "M4")]
    page = get(server, "?page=2&metric=rgspl&text=m").text
    assert "3 to 4 of 5." in page
    links = re.findall(r'<a rel="(\w+)" href="([^"]+)"', page)
    said = {rel: dict(parse_qsl(urlsplit(unescape(link)).query)) for rel, link in links}
    assert said == {"prev": {"text": "m"}, "next": {"text": "m", "page": "3"}}


def test_on_either_database(server_on: Serving) -> None:
    submission = entered(server_on, {"rgspl": 0.5}, **named("Ünt {漢}"))
    entered(server_on, {"rgspl": 0.75}, **named("Bee"))
    judge(server_on, submission, "verified")
    assert ranking(server_on) == [("1", "Bee"), ("2", "Ünt")]
    assert tables(get(server_on))[0][1][1] == "Ünt {漢} Blue verified ? not declared"
