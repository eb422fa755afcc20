"""What a board's charts draw, and copies of it for papers."""

import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest

from reverie_eval import CATALOGUE
from reverie_eval.schemas.service import ScoredSubmission
from reverie_eval.server.boards.charts import (
    chart_of,
    front,
    progress_of,
    rank_chart,
    timeline_of,
    whole_timeline,
)
from reverie_eval.server.boards.entries import Entry, Row
from reverie_eval.server.boards.leaderboard import Ranking
from tests.support.acting import NOON
from tests.support.entries import BOARD, entered, get, named, report_result
from tests.support.serving import OPEN, OTHER, OWNER, Serving
from tests.support.visiting import said


def test_a_chart(server: Serving) -> None:
    entered(server, {"rgspl": 0.25, "path_length": 12.0}, **named("Ant"))
    entered(server, {"rgspl": 0.5, "path_length": 9.5}, OTHER, **named("Bee"))
    entered(server, {"rgspl": 0.25, "path_length": 30.25}, **named("Cat"))
    entered(server, {"rgspl": 0.75}, **named("Dog"))
    chart = get(server, "?x=path_length&y=rgspl", f"{BOARD}/chart").json()
    assert chart["x"] == {"heading": "TL m", "name": "trajectory length", "most": None}
    assert chart["y"]["most"] == 100
    points = chart["points"]
    assert points["method"] == ["Bee", "Ant", "Cat"]  # who has both
    assert points["x"] == [9.5, 12.0, 30.25]
    assert points["y"] == [50.0, 25.0, 25.0]
    assert points["team"] == ["Red", "Blue", "Blue"]
    assert chart["front"] == []  # neither direction of the length is better


def test_a_front_is_of_metrics_that_have_a_better_direction(server: Serving) -> None:
    entered(server, {"success": 0.25, "rgs": 0.5}, **named("Ant"))
    entered(server, {"success": 0.5, "rgs": 0.25}, OTHER, **named("Bee"))
    entered(server, {"success": 0.25, "rgs": 0.25}, **named("Cat"))
    chart = get(server, path=f"{BOARD}/chart").json()
    assert [chart["points"]["method"][place] for place in chart["front"]] == ["Bee", "Ant"]


def test_a_chart_has_lines_for_people_and_the_best_that_is_reported(server: Serving) -> None:
    entered(server, {"success": 0.5, "rgs": 0.25}, **named("Ant"))
    entered(server, {"success": 0.5, "rgs": 0.5}, **named("Our students", human=True))
    for name, human, rgs in (("Their students", True, 0.7784), ("FAST", None, 0.35)):
        report_result(server, name, human=human, success=0.8, rgs=rgs)
    chart = get(server, path=f"{BOARD}/chart").json()
    assert sorted(chart["points"]["method"]) == ["Ant", "Our students"]
    assert sorted(chart["reported"]["method"]) == ["FAST", "Their students"]
    assert chart["lines"] == [{"name": "Human", "y": 77.84}, {"name": "Best reported", "y": 35.0}]


def test_history_is_of_the_metric_that_the_board_is_sorted_by(server: Serving) -> None:
    """It is in the page itself, for those without scripts too, and says what the bands say."""
    entered(server, {"rgspl": 0.25, "success": 0.5, "navigation_error": 4.0}, **named("Ant"))
    report_result(server, "Dated", date="2021-06", rgspl=0.125)
    report_result(server, "Undated", rgspl=0.5)
    report_result(server, "Elsewhere", date="2020", dataset="REVERIE v2", rgspl=0.75)
    report_result(server, "People", date="2020-06", human=True, rgspl=0.875)
    report_result(server, "Other people", human=True, rgspl=0.9375)
    text = get(server).text
    history = text[text.index('id="history"') : text.index('id="apart"')]
    groups = re.findall(r'<g class="(\w+) series-(\d)">(.*?)</g>', history)
    marks = {
        name: (kind, number)
        for kind, number, group in groups
        for name in re.findall("<title>(\\w+):", group)
    }
    assert marks == {
        "Ant": ("best", "1"),
        "Dated": ("best", "1"),
        "People": ("human", "1"),
        "Elsewhere": ("best", "2"),
    }
    assert "Other people 93.75" in history, "a line across needs no date"
    assert "REVERIE v2which are not comparable" in said(get(server)).replace(" which", "which")
    by_length = get(server, "?metric=navigation_error").text
    assert re.findall(r"<title>(\w+): 4.00, ", by_length) == ["Ant"]
    assert 'id="history"' not in get(server, "?text=nobody").text


def test_a_chart_s_data_are_packed_for_whoever_takes_them_so(server: Serving) -> None:
    for number in range(20):
        entered(server, {"success": 0.5, "rgs": 0.25}, **named(f"Method {number}" * 5))
    packed = server.client.get(f"{BOARD}/chart", headers={"Accept-Encoding": "gzip"})
    plain = server.client.get(f"{BOARD}/chart", headers={"Accept-Encoding": "identity"})
    assert packed.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in plain.headers
    assert packed.json() == plain.json()


def test_a_chart_does_not_tell_who_is_anonymous(server: Serving) -> None:
    entered(
        server,
        {"success": 0.5, "path_length": 9.0},
        anonymous_until="2026-12-31T00:00:00Z",
    )
    for part in ("chart", "latex", "bibtex"):
        text = get(server, path=f"{BOARD}/{part}").text
        assert "Blue" not in text
        assert OWNER not in text


DAY = timedelta(days=1)


def row(
    name: str, scores: Mapping[str, float], rank: int | None = None, day: int = 0, **more: Any
) -> Row:
    """Return a row of a leaderboard, ranked if it has a rank, else reported."""
    about: dict[str, Any] = {
        "submission_id": None if rank is None else name.lower(),
        "team_id": 1,
        "team": f"Team {name}",
        "method": {"name": name, "human": name in {"Cat", "Elk"}},
        "published_at": NOON + day * DAY,
        "anonymous_until": None,
        "standing": "reported" if rank is None else "ranked",
    }
    return Row(rank, Entry(**{**about, "scores": scores, **more}))


def test_whatever_a_chart_draws(server: Serving) -> None:
    gnu = {"navigation_error": 5.0, "success": 0.125, "rgspl": 0.375}
    rows = [
        row("Ant", {"navigation_error": 4.0, "success": 0.5, "rgspl": 0.25}, 1, 2),
        row("Bee", {"navigation_error": 2.0, "success": 0.25, "rgspl": 0.125}, 2, 1),
        row("Cat", {"navigation_error": 1.5, "rgspl": 0.5}, 4, 3),
        row("Dog", {"navigation_error": 3.0, "success": 0.75}),
        row("Elk", {"success": 0.875}),
        row("Fox", {"success": 1.0, "navigation_error": 0.5}, 5, standing="disqualified"),
        row("Gnu", gnu, 3, 4, anonymous_until=NOON + 10 * DAY),
        row("Hen", {"navigation_error": 3.5, "success": 0.625}),
    ]
    board, now = server.state.boards[OPEN], NOON + 9 * DAY
    ranking = Ranking(board, "rgspl", rows, (), frozenset(), now, {})
    success = {"heading": "SR %", "name": "success rate", "most": 100.0}
    distance = {"heading": "NE m", "name": "navigation error", "most": None}
    assert chart_of(ranking, rows, "navigation_error", "success") == {
        "x": distance,
        "y": success,
        "points": {
            "x": [4.0, 2.0, 5.0],
            "y": [50.0, 25.0, 12.5],
            "rank": [1, 2, 3],
            "method": ["Ant", "Bee", "Gnu"],
            "team": ["Team Ant", "Team Bee", "anonymous"],
            "submission": ["ant", "bee", "gnu"],
        },
        "front": [1, 0],
        "reported": {
            "x": [3.0, 3.5],
            "y": [75.0, 62.5],
            "rank": [None, None],
            "method": ["Dog", "Hen"],
            "team": ["Team Dog", "Team Hen"],
            "submission": [None, None],
        },
        "lines": [{"name": "Human", "y": 87.5}, {"name": "Best reported", "y": 75.0}],
    }
    turned = chart_of(ranking, rows, "success", "navigation_error")
    assert (turned["x"], turned["y"], turned["front"]) == (success, distance, [0, 1])
    assert turned["lines"] == [{"name": "Human", "y": 1.5}, {"name": "Best reported", "y": 3.0}]
    walked = [row("Ant", {"success": 0.5, "path_length": 9.0}, 1), row("Bee", {"path_length": 8.0})]
    for x, y in (("path_length", "success"), ("success", "path_length")):
        chart = chart_of(ranking, walked, x, y)
        assert (len(chart["points"]["x"]), chart["front"], chart["lines"]) == (1, [], [])


def test_whatever_a_team_s_chart_draws(server: Serving) -> None:
    known = ScoredSubmission.model_validate(server.upload(OWNER).json()["submission"])
    values = {"late": (3, 0.5), "early": (1, 0.25), "worse": (2, 0.125), "none": (0, None)}
    submissions = [
        known.model_copy(
            update={
                "id": name,
                "method": known.method.model_copy(update={"name": name.title()}),
                "received_at": NOON + day * DAY,
                "report": known.report.model_copy(
                    update={"scores": {} if value is None else {"rgspl": value}}
                ),
            }
        )
        for name, (day, value) in values.items()
    ]
    timeline = progress_of(submissions, CATALOGUE["rgspl"], NOON + 5 * DAY)
    assert timeline is not None
    assert [(each.name, each.date, each.value) for each in timeline.results] == [
        ("Late", "2026-03-05", 0.5),
        ("Early", "2026-03-03", 0.25),
        ("Worse", "2026-03-04", 0.125),
    ]
    assert [each.name for each in timeline.best_so_far[OPEN]] == ["Early", "Late"]
    assert progress_of(submissions[-2:], CATALOGUE["rgspl"], NOON) is None


def test_ranks_over_time_are_of_what_has_a_rank(server: Serving) -> None:
    rows = [
        row("Ant", {"rgspl": 0.5}, 1, 2),
        row("Bee", {"rgspl": 0.25}, 2, 1),
        row("Cat", {"rgspl": 0.75}),
    ]
    ranking = Ranking(server.state.boards[OPEN], "rgspl", rows, (), frozenset(), NOON + 9 * DAY, {})
    drawn = rank_chart(ranking, "Rank of <Bee>", lambda entry: entry.method["name"] == "Bee")
    assert "<title>Rank of &lt;Bee&gt;</title>" in drawn
    assert ">2 of 2</text>" in drawn
    assert rank_chart(ranking, "", lambda entry: entry.method["name"] == "Cat") == ""


def test_nothing_is_drawn_of_a_metric_without_a_better_direction(server: Serving) -> None:
    rows = [row("Ant", {"path_length": 9.0}, 1)]
    ranking = Ranking(server.state.boards[OPEN], "rgspl", rows, (), frozenset(), NOON, {})
    assert timeline_of(ranking, rows, "path_length") is None


def test_the_timeline_of_all_results_is_made_once_a_day(server: Serving) -> None:
    result = row("Ant", {"rgspl": 0.5}, 1)
    ranking = Ranking(server.state.boards[OPEN], "rgspl", [result], [result], frozenset(), NOON)
    today = whole_timeline(ranking, "rgspl")
    assert today is not None
    assert len(today.results) == 2, "those that are not ranked are among them"
    assert whole_timeline(replace(ranking, now=NOON + timedelta(hours=1)), "rgspl") is today
    tomorrow = whole_timeline(replace(ranking, now=NOON + DAY), "rgspl")
    assert tomorrow is not None
    assert tomorrow.until == f"{NOON + DAY:%Y-%m-%d}"


FRONTS = [
    pytest.param([], [], [], id="nothing"),
    pytest.param([1.0], [1.0], [0], id="one"),
    pytest.param([1, 2, 3], [3, 2, 1], [0, 1, 2], id="each is best at something"),
    pytest.param([1, 2, 3], [1, 2, 3], [0], id="one is better in both"),
    pytest.param([1, 1], [2, 1], [1], id="equal in one, better in the other"),
    pytest.param([2, 1], [1, 1], [1], id="the same, the other way round"),
    pytest.param([1, 1, 2], [1, 1, 0], [0, 1, 2], id="equals stand together"),
]


@pytest.mark.parametrize(("x", "y", "expected"), FRONTS)
def test_fronts(x: list[float], y: list[float], expected: list[int]) -> None:
    assert front(x, y) == expected


HARD = r"50% {braces} & _under_ #1 \cmd ~^ [x]*"


def in_latex(signature: str) -> str:
    """Write a signature as LaTeX shows it."""
    return signature.replace("_", r"\_").replace("|", r"\textbar{}")


def test_latex(server: Serving) -> None:
    entered(server, {"rgspl": 0.5, "spl": 0.25}, **named("Ant"))
    entered(server, {"rgspl": 0.25, "spl": 0.5}, OTHER, **named("Ant"))
    entered(server, {"rgspl": 0.125}, **named(HARD))
    escaped = (
        r"50\% \{braces\} \& \_under\_ \#1 \textbackslash{}cmd "
        r"\textasciitilde{}\textasciicircum{} {[}x{]}{*}"
    )
    lines = get(server, path=f"{BOARD}/latex").text.splitlines()
    assert lines[lines.index(r"\midrule") + 1 : lines.index(r"\bottomrule")] == [
        r"Ant (Blue) & 25.00 & \textbf{50.00} \\",
        r"Ant (Red) & \textbf{50.00} & 25.00 \\",
        rf"{escaped} & - & 12.50 \\",
    ]
    assert r"Method & SPL & RGSPL \\" in lines
    assert in_latex(server.state.boards[OPEN].signature) in lines[2]


def test_bibtex(server: Serving) -> None:
    submission = entered(server, {"rgspl": 0.5}, **named(HARD))
    text = get(server, path=f"{BOARD}/bibtex").text
    signature = in_latex(server.state.boards[OPEN].signature)
    dataset, board, row = text.split("\n\n")
    assert dataset.startswith("@inproceedings{qi2020reverie,")
    assert board.splitlines() == [
        "@misc{reverie-val-unseen-2026-03-02,",
        "  author = {{REVERIE evaluation server}},",
        r"  title = {{REVERIE val unseen leaderboard}},",
        "  year = {2026},",
        r"  howpublished = {\url{http://server/splits/val_unseen}},",
        f"  note = {{{signature}, as of 2026-03-02}},",
        "}",
    ]
    assert row.splitlines()[:2] == [f"@misc{{reverie-{submission},", "  author = {{Blue}},"]
    assert rf"\url{{http://server/submissions/{submission}}}" in row
    assert r"50\% \textbraceleft{}braces\textbraceright{} \& \_under\_" in row
    assert text.count("{") == text.count("}")  # BibTeX counts them, with a backslash or not


def test_a_citation_leads_to_the_method_s_paper_and_says_where_the_numbers_are(
    server: Serving,
) -> None:
    paper = "https://arxiv.org/abs/2301.00001"
    submission = entered(server, {"rgspl": 0.5}, **named("Ant", paper=paper))
    *_, row = get(server, path=f"{BOARD}/bibtex").text.split("\n\n")
    assert rf"  howpublished = {{\url{{{paper}}}}}," in row
    assert rf", \url{{http://server/submissions/{submission}}}}}," in row


def test_an_address_in_bibtex_is_left_as_it_is(server: Serving) -> None:
    r"""As ``\\url`` takes it, which would show a backslash."""
    assert (
        r"\url{http://server/splits/val_unseen?text=%C3%A4}"
        in get(server, "?text=%C3%A4", f"{BOARD}/bibtex").text
    )


def test_an_unbalanced_brace_leaves_bibtex_whole(server: Serving) -> None:
    entered(server, {"rgspl": 0.5}, **named("{"))
    text = get(server, path=f"{BOARD}/bibtex").text
    assert text.count("{") == text.count("}")


NOTHING = [
    pytest.param("", id="an empty board"),
    pytest.param("?text=nobody", id="a filter that nothing fits"),
]


@pytest.mark.parametrize("query", NOTHING)
def test_of_nothing_there_are_no_copies(server: Serving, query: str) -> None:
    if query:
        entered(server, {"rgspl": 0.5})
    page = get(server, query).text
    assert ">LaTeX<" not in page
    assert ">BibTeX<" not in page
    (line,) = get(server, query, f"{BOARD}/latex").text.splitlines()
    assert line == f"% No result of {OPEN} is shown at http://server{BOARD}{query}"
    assert get(server, query, f"{BOARD}/bibtex").text.count("@misc") == 1  # the board itself


def test_copies_of_a_page_that_is_not_there_are_of_the_last(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("reverie_eval.server.boards.pages.PER_PAGE", 2)
    for number in range(3):
        entered(server, {"rgspl": 0.5 - 0.1 * number}, **named(f"M{number}"))
    for copy in ("latex", "bibtex"):
        text = get(server, "?page=99", f"{BOARD}/{copy}").text
        assert [name for name in ("M0", "M1", "M2") if name in text] == ["M2"]
