"""Leaderboards in words: on terminals of any width, in pipes, whatever things are named."""

import io
from datetime import UTC, datetime
from typing import Any

import pytest
from rich.cells import cell_len
from rich.console import Console

from reverie_eval.reporting.service import (
    METHOD_FLAGS,
    leaderboard_parts,
    leaderboard_table,
    narrow_leaderboard_table,
)
from reverie_eval.schemas.service import Leaderboard
from reverie_eval_cli.output import print_parts

SCORES = {"path_length": 12.34, "success": 0.5454, "rgspl": 0.3503, "ndtw": 0.61}
AT = datetime(2027, 6, 1, 23, 59, tzinfo=UTC)


NOTHING = dict.fromkeys(METHOD_FLAGS, False)
"""Declares that nothing applies."""


def row(rank: int | None, team: str, method: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """Return a row with some scores."""
    about = {"rank": rank, "team": team, "method": method, "scores": SCORES}
    return about | {"submission_id": "a1", "published_at": AT, "submissions": 7} | changes


def board(*rows: dict[str, Any], metric: str = "rgspl") -> Leaderboard:
    """Return a leaderboard."""
    about = {"split": "test", "protocol": "official-v1", "fingerprint": "ab" * 32}
    return Leaderboard.model_validate(about | {"metric": metric, "rows": rows})


LONG = board(
    row(1, "University of Somewhere", {"name": "A transformer with [bold]rich[/bold] markup"}),
    row(2, "", {"name": "漢字", "ensemble": True, "extra_data": True}, submissions=41),
    row(None, "Red", {"name": "Partial"}, scores={"success": 0.5}),
)


@pytest.mark.parametrize("columns", [20, 40, 60, 72, 80, 100, 140, 300])
def test_a_terminal_of_any_width_shows_everything(columns: int) -> None:
    screen = io.StringIO()
    print_parts(Console(file=screen, width=columns), leaderboard_parts(LONG))
    words = " ".join(screen.getvalue().split())
    for name in ("Somewhere", "transformer", "[bold]rich[/bold]", "(anonymous)", "漢字", "Partial"):
        assert name in words
    for value in ("12.34", "54.54", "35.03", "50.00", "2027-06-01", "extra data", "ensemble"):
        assert value.split()[0] in words
    if columns >= 80:
        assert max(map(cell_len, screen.getvalue().splitlines())) <= columns


def test_a_pipe_gets_aligned_columns() -> None:
    ours, theirs = {"name": "Ours", **NOTHING}, {"name": "B", **NOTHING, "human": True}
    two = board(row(1, "Blue", ours), row(10, "Red", theirs))
    assert leaderboard_parts(two)[0].to_text().splitlines() == [
        "rank  team  method   TL m   SR %  RGSPL %  entries   published  notes",
        "   1  Blue  Ours    12.34  54.54    35.03        7  2027-06-01",
        "  10  Red   B       12.34  54.54    35.03        7  2027-06-01  human",
        "",
        "split:test|protocol:official-v1|data:abababababab, sorted by RGSPL",
    ]


def review(verdict: str, reason: str) -> dict[str, Any]:
    """Return what the organiser says."""
    return {"verdict": verdict, "reason": reason, "reviewer": "Olga", "created_at": AT}


def test_what_the_organiser_says_and_what_is_not_ranked_is_shown() -> None:
    verified = row(
        1, "Blue", {"name": "Ours", **NOTHING}, reviews=[review("verified", "ran the code")]
    )
    flagged = row(
        *(2, "Red", {"name": "B", **NOTHING, "ensemble": True}),
        reviews=[review("flagged", "no \x1b[2J code")],
    )
    apart = [
        row(None, "", {"name": "Paper"}, submissions=None, standing="reported"),
        row(None, "Red", {"name": "Old", **NOTHING, "human": None}, standing="other-rules"),
        row(
            *(None, "Green", {"name": "C", **NOTHING}),
            standing="disqualified",
            reviews=[review("disqualified", "trained on test")],
        ),
    ]
    full = Leaderboard.model_validate(
        board(verified, flagged).model_dump(exclude={"apart"}) | {"apart": apart}
    )
    table = leaderboard_table(full)
    assert [(cells[0], cells[2], cells[-1]) for cells in table.rows] == [
        ("1", "Ours", "verified"),
        ("2", "B", "flagged, ensemble"),
        ("-", "Paper", "reported, not scored, nothing declared"),
        ("-", "Old", "scored under other rules, not declared: human"),
        ("-", "C", "disqualified"),
    ]
    assert narrow_leaderboard_table(full).rows[4][-1].endswith("2027-06-01, disqualified)")
    assert leaderboard_table(full).notes[1:] == [
        r"flagged: B (Olga: no \x1b[2J code)",
        "disqualified: C (Olga: trained on test)",
    ]


def test_what_the_board_is_sorted_by_is_shown() -> None:
    table = leaderboard_table(board(row(1, "Blue", {"name": "Ours"}), metric="ndtw"))
    assert "nDTW %" in table.headings
    assert leaderboard_parts(board(metric="ndtw"))[0].to_text().splitlines() == [
        "split:test|protocol:official-v1|data:abababababab, sorted by nDTW",
        "no results are published yet",
    ]


def test_a_metric_that_this_version_does_not_know() -> None:
    newer = board(row(1, "Blue", {"name": "Ours"}, scores=SCORES | {"joy": 1}), metric="joy\x1b[2J")
    assert leaderboard_table(newer).notes[0].endswith(r", sorted by joy\x1b[2J")
    assert "35.03" in leaderboard_table(newer).rows[0]


def test_names_cannot_command_a_terminal() -> None:
    table = leaderboard_table(board(row(1, "Blue\x1b[2J\u202e", {"name": "Ours"})))
    assert table.rows[0][1] == r"Blue\x1b[2J\u202e"


def test_an_anonymous_team_does_not_hide_how_often_it_tried() -> None:
    assert leaderboard_table(LONG).rows[1][-3:-1] == ["41", "2027-06-01"]
    assert "(anonymous): 漢字 (41 entries, " in narrow_leaderboard_table(LONG).rows[1][-1]


def test_what_is_not_declared_comes_last() -> None:
    assert [cells[-1] for cells in leaderboard_table(LONG).rows] == [
        "nothing declared",
        (
            "extra data, ensemble, not declared: pre-exploration, ground-truth objects, "
            "navigation only, human"
        ),
        "nothing declared",
    ]
    signature = "task:r2r|split:test|protocol:r2r|data:abababababab|n:1|version:1"
    of_r2r = LONG.model_copy(update={"signature": signature})
    assert leaderboard_table(of_r2r).rows[1][-1] == (
        "extra data, ensemble, not declared: pre-exploration, human"
    ), "without what matters only where methods predict objects"


def test_a_reported_result_has_no_number_of_submissions() -> None:
    reported = board(row(None, "", {"name": "Paper"}, submissions=None, standing="reported"))
    assert leaderboard_table(reported).rows[0][-3] == "-"
    assert "None" not in narrow_leaderboard_table(reported).rows[0][-1]


@pytest.mark.parametrize(
    ("changes", "date", "notes"),
    [
        pytest.param({"reported_date": "2020-06"}, "2020-06", "reported, not scored", id="a month"),
        pytest.param({}, "-", "reported, not scored", id="no date"),
        pytest.param(
            {"standing": "other-dataset", "dataset": "v2"},
            "-",
            "reported on v2, not scored",
            id="another version of the dataset",
        ),
    ],
)
def test_what_is_known_of_a_reported_result(changes: dict[str, Any], date: str, notes: str) -> None:
    about = {"submission_id": None, "submissions": None, "standing": "reported", **changes}
    reported = board(row(None, "They", {"name": "Paper", "ensemble": None}, **about))
    notes += ", nothing declared"
    assert leaderboard_table(reported).rows[0][-2:] == [date, notes]
    told = notes if date == "-" else f"{date}, {notes}"
    assert narrow_leaderboard_table(reported).rows[0][-1] == f"They: Paper ({told})"


def test_an_unscored_row_has_no_rank_and_dashes() -> None:
    (*_, last) = leaderboard_table(LONG).rows
    assert last == ["-", "Red", "Partial", "-", "50.00", "-", "7", "2027-06-01", "nothing declared"]
