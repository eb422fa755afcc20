"""What a board's charts draw, and copies of it for papers."""

from datetime import UTC, datetime

import pytest

from reverie_eval.server.service.charts import front, records
from tests.support.entries import BOARD, entered, get, named, report_result
from tests.support.serving import OPEN, OTHER, OWNER, Serving


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


def test_progress_is_by_the_metric_that_the_board_is_ranked_by(server: Serving) -> None:
    entered(server, {"rgspl": 0.25, "success": 0.5, "navigation_error": 4.0}, **named("Ant"))
    entered(server, {"rgspl": 0.5, "success": 0.25}, OTHER, **named("Bee"))
    entered(server, {"rgspl": 0.25, "success": 0.75, "navigation_error": 3.0}, **named("Cat"))
    server.clock.turn(hours=24)
    for query, heading, names, values in (
        ("", "RGSPL %", ["Ant", "Bee"], [25.0, 50.0]),
        ("?y=success", "RGSPL %", ["Ant", "Bee"], [25.0, 50.0]),
        ("?metric=navigation_error", "NE m", ["Ant", "Cat"], [4.0, 3.0]),
        ("?metric=path_length", "RGSPL %", ["Ant", "Bee"], [25.0, 50.0]),
    ):
        progress = get(server, query, f"{BOARD}/chart").json()["progress"]
        assert progress["y"]["heading"] == heading
        assert progress["points"]["method"] == names
        assert progress["points"]["y"] == values
        assert progress["until"] == int(1000 * server.clock().timestamp())


def test_a_chart_s_data_are_packed_for_whoever_takes_them_so(server: Serving) -> None:
    for number in range(8):
        entered(server, {"success": 0.5, "path_length": 9.0}, **named(f"Method {number}" * 5))
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


def test_records_by_time() -> None:
    at = [datetime(2026, 1, day, tzinfo=UTC) for day in (4, 1, 3, 2)]
    assert records(at, [1, 5, 5, 3]) == [1, 3, 0]
    assert records([], []) == []


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
        r"  title = {{Leaderboard of val\_unseen}},",
        "  year = {2026},",
        r"  howpublished = {\url{http://server/boards/val_unseen}},",
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
        r"\url{http://server/boards/val_unseen?text=%C3%A4}"
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
    monkeypatch.setattr("reverie_eval.server.pages.boards.PER_PAGE", 2)
    for number in range(3):
        entered(server, {"rgspl": 0.5 - 0.1 * number}, **named(f"M{number}"))
    for copy in ("latex", "bibtex"):
        text = get(server, "?page=99", f"{BOARD}/{copy}").text
        assert [name for name in ("M0", "M1", "M2") if name in text] == ["M2"]
