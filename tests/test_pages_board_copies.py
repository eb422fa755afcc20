"""What a board's charts draw, and copies of it for papers."""

from datetime import UTC, datetime

import pytest

from reverie_eval.server.service.charts import front, records
from tests.entries import BOARD, entered, get, named
from tests.serving import OPEN, OTHER, OWNER, Serving


def test_a_chart(server: Serving) -> None:
    entered(server, {"rgspl": 0.25, "path_length": 12.0}, **named("Ant"))
    entered(server, {"rgspl": 0.5, "path_length": 9.5}, OTHER, **named("Bee"))
    entered(server, {"rgspl": 0.25, "path_length": 30.25}, **named("Cat"))
    entered(server, {"rgspl": 0.75}, **named("Dog"))
    chart = get(server, "?x=path_length&y=rgspl", f"{BOARD}/chart").json()
    assert chart["x"] == {"key": "path_length", "heading": "TL m", "name": "trajectory length"}
    points = chart["points"]
    assert points["method"] == ["Bee", "Ant", "Cat"]  # who has both
    assert points["x"] == [9.5, 12.0, 30.25]
    assert points["y"] == [50.0, 25.0, 25.0]
    assert points["team"] == ["Red", "Blue", "Blue"]
    assert chart["front"] == [0]
    assert chart["best"] == [1, 0]  # Ant was first, then came Bee


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
        r"Ant (Blue) & \textbf{50.00} & 25.00 \\",
        r"Ant (Red) & 25.00 & \textbf{50.00} \\",
        rf"{escaped} & 12.50 & - \\",
    ]
    assert r"Method & RGSPL & SPL \\" in lines
    assert in_latex(server.state.boards[OPEN].signature) in lines[2]


def test_bibtex(server: Serving) -> None:
    submission = entered(server, {"rgspl": 0.5}, **named(HARD))
    text = get(server, path=f"{BOARD}/bibtex").text
    signature = in_latex(server.state.boards[OPEN].signature)
    board, row = text.split("\n\n")
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


def test_an_unbalanced_brace_leaves_bibtex_whole(server: Serving) -> None:
    entered(server, {"rgspl": 0.5}, **named("{"))
    text = get(server, path=f"{BOARD}/bibtex").text
    assert text.count("{") == text.count("}")
