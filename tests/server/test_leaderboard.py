"""The leaderboard: who is where, and what it does not tell."""

import csv
import io
from collections.abc import Sequence
from dataclasses import replace
from datetime import date, timedelta
from typing import Any

import msgspec
import pytest

from reverie_eval import CATALOGUE
from reverie_eval.reporting.service import METHOD_COSTS
from reverie_eval.schemas.service import CorrectionReport
from reverie_eval.server.boards.entries import Entry, Row
from reverie_eval.server.boards.leaderboard import (
    Ranking,
    RankInterval,
    as_csv,
    as_json,
    method_names,
    paper_of,
    ranks,
)
from reverie_eval.server.boards.query import Filter
from reverie_eval.server.boards.reviews import PublishedReview
from reverie_eval.tasks import find_task
from tests.support.acting import NOON
from tests.support.description import Description
from tests.support.entries import demo_board, entered, entry, ranking_of
from tests.support.serving import OPEN, OTHER, OWNER, PRIVATE, Serving

BOARD = f"/splits/{OPEN}/leaderboard"


def rows_of(server: Serving, metric: str = "rgspl") -> list[dict[str, Any]]:
    reply = server.ask(None, "GET", BOARD, params={"metric": metric})
    Description(server).check(reply)
    rows: list[dict[str, Any]] = reply.json()["rows"]
    return rows


# The metric, the values in the order of publication (None: not scored), and the board: for each
# row its rank, and which submission it is.
BOARDS = [
    pytest.param("rgspl", [], [], id="nothing is published"),
    pytest.param("rgspl", [0.5], [(1, 0)], id="one"),
    pytest.param("rgspl", [0.2, 0.9, 0.5], [(1, 1), (2, 2), (3, 0)], id="higher is better"),
    pytest.param(
        "navigation_error", [2.0, 9.0, 5.0], [(1, 0), (2, 2), (3, 1)], id="lower is better"
    ),
    pytest.param(
        "success",
        [0.5, 0.7, 0.3, 0.7, 0.5, 0.1],
        [(1, 1), (1, 3), (3, 0), (3, 4), (5, 2), (6, 5)],
        id="equals are equal, the next counts all before it, the earlier of equals is first",
    ),
    pytest.param(
        "rgs", [None, 0.1, None, 0.0], [(1, 1), (2, 3), (None, 0), (None, 2)], id="no score is last"
    ),
    pytest.param(
        "navigation_error", [None, 8.0], [(1, 1), (None, 0)], id="no score is last, lower is better"
    ),
    pytest.param("iou", [None, None], [(None, 0), (None, 1)], id="nobody has a score"),
]


@pytest.mark.parametrize(("metric", "values", "expected"), BOARDS)
def test_ranks(
    server: Serving,
    metric: str,
    values: Sequence[float | None],
    expected: Sequence[tuple[int | None, int]],
) -> None:
    ids = [entered(server, {} if value is None else {metric: value}) for value in values]
    rows = rows_of(server, metric)
    assert [(row["rank"], ids.index(row["submission_id"])) for row in rows] == expected


@pytest.mark.parametrize("metric", ["path_length", "steps", "no-such", "", "rgspl "])
def test_a_board_is_not_sorted_by_what_has_no_better(server: Serving, metric: str) -> None:
    for path in (BOARD, f"{BOARD}.csv"):
        reply = server.ask(None, "GET", path, params={"metric": metric})
        Description(server).check(reply)
        assert (reply.status_code, reply.json()["code"]) == (400, "malformed-request")
        told = f"cannot sort by {metric!r}; choose one of: success, oracle_success, spl, rgs, "
        assert reply.json()["detail"].startswith(told)


def test_every_other_metric_sorts(server: Serving) -> None:
    metrics = [key for key in find_task("reverie").metrics if CATALOGUE[key].better != "neither"]
    assert len(metrics) > 10
    for metric in metrics:
        assert rows_of(server, metric) == []


def test_only_what_is_published_and_not_withdrawn_is_shown(server: Serving) -> None:
    server.upload(OWNER, server.distinct())
    shown = entered(server)
    taken_back = entered(server)
    server.ask(OWNER, "PATCH", f"/submissions/{taken_back}", json={"withdrawn": True})
    hidden = entered(server)
    server.ask(OWNER, "PATCH", f"/submissions/{hidden}", json={"published": False})
    rows = rows_of(server)
    assert [row["submission_id"] for row in rows] == [shown]
    assert rows[0]["submissions"] == 4  # all that stand behind it


def test_a_board_is_of_one_split_and_counts_teams_apart(server: Serving) -> None:
    entered(server, split=PRIVATE)
    entered(server, who=OTHER)
    ours = entered(server)
    counts = {row["submission_id"]: row["submissions"] for row in rows_of(server)}
    assert counts[ours] == 1
    assert len(counts) == 2


def test_an_anonymous_team_shows_nowhere_until_its_date(server: Serving) -> None:
    until = "2026-03-03T12:00:00Z"
    entered(server)  # under its name
    hidden = entered(server, anonymous_until=until)
    paths = [BOARD, f"{BOARD}.csv", "/splits", f"/splits/{OPEN}", "/server"]

    def row() -> dict[str, Any]:
        return next(row for row in rows_of(server) if row["submission_id"] == hidden)

    assert (row()["team"], row()["submissions"]) == ("", 2)
    for path in paths:
        for who in (None, OTHER):
            said = server.ask(who, "GET", path).text
            assert said.count("Blue") == path.startswith(BOARD)  # the other row alone
            assert OWNER not in said

    server.clock.now = NOON.replace(day=3, hour=11, minute=59, second=59)
    assert row()["team"] == ""
    server.clock.turn(seconds=1)
    assert (row()["team"], row()["submissions"]) == ("Blue", 2)


def test_a_team_may_name_itself_earlier(server: Serving) -> None:
    hidden = entered(server, anonymous_until="2026-12-31T00:00:00+01:00")
    mine = server.ask(OWNER, "GET", f"/submissions/{hidden}").json()
    assert mine["anonymous_until"] == "2026-12-30T23:00:00Z"
    server.ask(OWNER, "PATCH", f"/submissions/{hidden}", json={"anonymous_until": None})
    assert [row["team"] for row in rows_of(server)] == ["Blue"]


def table_of(server: Serving, metric: str = "rgspl") -> list[list[str]]:
    reply = server.ask(None, "GET", f"{BOARD}.csv", params={"metric": metric})
    Description(server).check(reply)
    assert reply.headers["content-type"] == "text/csv; charset=utf-8"
    return list(csv.reader(io.StringIO(reply.text)))


def test_the_board_as_csv(server: Serving) -> None:
    links = {"paper": "https://example.org/a,b", "code": "https://example.org/c"}
    first = entered(
        server,
        {"rgspl": 0.25, "success": 0.5},
        method={"name": 'Our, "best"', "ensemble": True, "human": False, **links, **SAMPLED},
    )
    second = entered(server, {"success": 0.75}, who=OTHER, anonymous_until="2027-01-01T00:00:00Z")
    at = "2026-03-02T12:00:0"
    undeclared = ["", "", ""]
    about = ["rank", "submission_id", "team", "published_at", "submissions"]
    said = [
        "method",
        "paper",
        "code",
        "extra_data",
        "pre_exploration",
        "ground_truth_objects",
        "ensemble",
        "navigation_only",
        "human",
        "input_class",
        "sample_size",
        *METHOD_COSTS,
        "reference",
    ]
    more = ["standing", "reviews", "source", "reported_date", "dataset", "signature"]
    known = ("ranked", *4 * [""], server.state.boards[OPEN].signature)
    headline = ["path_length", "success", "oracle_success", "spl", "rgs", "rgspl"]
    bounds = [f"{key}_{end}" for key in headline for end in ("low", "high")]
    bounds += ["rank_low", "rank_high", "group"]
    table = table_of(server)
    assert table[0][-len(bounds) :] == bounds
    assert [row[-3:] for row in table[1:]] == [["", "", ""]] * 2  # one result alone has a rank
    assert [row[: -len(bounds)] for row in table] == [
        [*about, *said, *more, "success", "rgspl"],
        [
            *("1", first, "Blue", f"{at}0Z", "1"),
            *('Our, "best"', *links.values(), *undeclared, "true", "", "false"),
            *("views", "59", "", "", "", "", "0.25", ""),
            *known,
            *("0.5", "0.25"),
        ],
        [
            *("", second, "", f"{at}1Z", "1"),
            *("Walker", "", "", *undeclared, *undeclared),
            *8 * [""],
            *known,
            *("0.75", ""),
        ],
    ]
    assert [row[0] for row in table_of(server, "success")] == ["rank", "1", "2"]


def test_an_empty_board_as_csv(server: Serving) -> None:
    (headings,) = table_of(server)
    assert headings[:2] == ["rank", "submission_id"]


@pytest.mark.parametrize(
    "sign",
    [*"=+-@", "\uff1d", "\uff0b", "\uff0d", "\uff20", "\ufe66"],
)
def test_no_cell_is_a_formula(server: Serving, sign: str) -> None:
    formula = f'{sign}HYPERLINK("https://evil.example","Walker")'
    entered(server, method={"name": formula})
    (_, row) = table_of(server)
    assert row[5] == f"'{formula}"
    assert rows_of(server)[0]["method"]["name"] == formula  # JSON is no spreadsheet


def test_a_negative_number_is_no_formula(server: Serving) -> None:
    entered(server, {"rgspl": -0.5})
    headings, row = table_of(server)
    assert row[headings.index("rgspl")] == "-0.5"


# Without a server.


def reported(name: str, day: str | None) -> Entry:
    return entry(name, submission_id=None, team_id=None, reported_date=day)


HIDDEN = NOON + timedelta(seconds=1)
FREE = {"money_per_episode": 0.0, "input_class": "other"}
SAMPLED = {"sample_size": 59, "money_per_episode": 0.25, "input_class": "views"}
SHOWN = [
    Row(1, entry("Ant", method={"name": "Ant", "human": None})),
    Row(2, entry("Bee", method={"name": "Bee", "human": True, **SAMPLED}, team="Straße")),
    Row(
        3,
        entry(
            "Cat",
            method={"name": "Cat", "human": False, **FREE},
            anonymous_until=HIDDEN,
            published_at=NOON + timedelta(days=1),
        ),
    ),
    *(Row(None, reported(day or "unknown", day)) for day in ("2026-03-01", "2026-03", "2026", "")),
]


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [
        pytest.param({"human": "with"}, ["Bee"], id="declared"),
        pytest.param({"human": "without"}, ["Cat"], id="declared not to be so"),
        pytest.param(
            {"human": "undeclared"},
            ["Ant", "2026-03-01", "2026-03", "2026", "unknown"],
            id="not declared",
        ),
        pytest.param({"human": "with", "ensemble": "with"}, [], id="both"),
        pytest.param({"input_class": "views"}, ["Bee"], id="an input class"),
        pytest.param({"input_class": "undeclared", "text": "t"}, ["Ant"], id="no input class"),
        pytest.param({"sample_from": 60, "text": "t"}, ["Ant", "Cat"], id="most episodes"),
        pytest.param({"sample_from": 59, "text": "t"}, ["Ant", "Bee", "Cat"], id="enough of them"),
        pytest.param({"money_until": 0.25}, ["Bee", "Cat"], id="affordable"),
        pytest.param({"money_until": 0}, ["Cat"], id="free"),
        pytest.param({"since": date(2026, 3, 3)}, ["Cat", "2026-03", "2026"], id="since"),
        pytest.param({"since": date(2026, 4, 1)}, ["2026"], id="since the next month"),
        pytest.param(
            {"until": date(2026, 3, 2)},
            ["Ant", "Bee", "2026-03-01", "2026-03", "2026"],
            id="until",
        ),
        pytest.param({"until": date(2026, 2, 28)}, ["2026"], id="until the month before"),
        pytest.param({"until": date(2025, 12, 31)}, [], id="until the year before"),
        pytest.param({"text": "ANT"}, ["Ant"], id="the method"),
        pytest.param({"text": "strasse"}, ["Bee"], id="the team"),
        pytest.param({"text": "t"}, ["Ant", "Bee", "Cat"], id="either"),
        pytest.param(
            {"text": "blue", "since": date(2026, 3, 2)}, ["Ant", "2026-03", "2026"], id="all"
        ),
    ],
)
def test_which_rows_a_filter_shows(wanted: Any, expected: list[str]) -> None:
    ranking = ranking_of(*SHOWN)
    shown = Filter(**wanted).shown(ranking.rows, ranking)
    assert [row.entry.method["name"] for row in shown] == expected
    assert Filter(text=" ").shown(ranking.rows, ranking) is ranking.rows


def test_ranks_of_values() -> None:
    values = [0.5, None, 0.75, 0.5, 0.25]
    assert ranks(values, CATALOGUE["spl"]) == [2, None, 1, 2, 4]
    assert ranks(values, CATALOGUE["navigation_error"]) == [2, None, 4, 2, 1]


def full() -> Ranking:
    """Return a leaderboard with a result, a reported one, and one that is apart."""
    review = PublishedReview("disqualified", "trained on it", NOON)
    again = PublishedReview("baseline", "ours", NOON)
    first = entry(scores={"spl": 0.5}, intervals={"spl": (0.25, 0.75)}, signature="sig")
    paper = reported("Paper", "2020")
    return ranking_of(
        Row(1, first),
        Row(None, replace(paper, standing="reported", source="A table", dataset="v2")),
        apart=[
            Row(
                None,
                entry(
                    "Cat",
                    anonymous_until=HIDDEN,
                    standing="disqualified",
                    reviews=[review, again],
                    scores={"rgs": 0.0},
                ),
            )
        ],
        rank_intervals={"walker": RankInterval(best=1, worst=2, group=1)},
    )


def test_a_leaderboard_as_json() -> None:
    board = demo_board()
    corrected = CorrectionReport(split=OPEN, created_at=NOON, reason="Targets.", signature="new")
    at = "2026-03-02T12:00:00Z"
    same: dict[str, Any] = {
        "rank_interval": None,
        "group": None,
        "published_at": at,
        "submissions": 3,
        "intervals": {},
        "source": "",
        "reported_date": None,
        "dataset": "",
        "reviews": [],
    }
    assert msgspec.json.decode(as_json(full(), [corrected], "Example Lab")) == {
        "split": OPEN,
        "board": "",
        "protocol": "official-v1",
        "metric": "spl",
        "fingerprint": board.truth.fingerprint,
        "signature": board.signature,
        "rows": [
            {
                **same,
                "rank": 1,
                "rank_interval": [1, 2],
                "group": 1,
                "submission_id": "walker",
                "team": "Blue",
                "method": {"name": "Walker"},
                "scores": {"spl": 0.5},
                "intervals": {"spl": [0.25, 0.75]},
                "signature": "sig",
                "standing": "ranked",
            },
            {
                **same,
                "rank": None,
                "submission_id": None,
                "team": "Blue",
                "method": {"name": "Paper"},
                "submissions": None,
                "scores": {},
                "signature": "",
                "standing": "reported",
                "source": "A table",
                "reported_date": "2020",
                "dataset": "v2",
            },
        ],
        "apart": [
            {
                **same,
                "rank": None,
                "submission_id": "cat",
                "team": "",
                "method": {"name": "Cat"},
                "scores": {"rgs": 0.0},
                "signature": "",
                "standing": "disqualified",
                "reviews": [
                    {
                        "verdict": verdict,
                        "reason": reason,
                        "reviewer": "Example Lab",
                        "created_at": at,
                    }
                    for verdict, reason in (("disqualified", "trained on it"), ("baseline", "ours"))
                ],
            }
        ],
        "corrections": [
            {
                "split": OPEN,
                "board": "",
                "created_at": at,
                "reason": "Targets.",
                "signature": "new",
            }
        ],
    }


def test_what_is_not_ranked_comes_last_in_csv() -> None:
    text = as_csv(full())
    assert "\r" not in text
    headings, *rows = csv.reader(io.StringIO(text))
    told = "disqualified: trained on it; baseline: ours"
    assert headings[-7:] == [
        *("spl", "rgs", "spl_low", "spl_high", "rank_low", "rank_high", "group")
    ]
    at, empty, undeclared = "2026-03-02T12:00:00Z", [""] * 8, [""] * 8
    ranks_of_first = ("0.25", "0.75", "1", "2", "1")
    assert rows == [
        [
            *("1", "walker", "Blue", at, "3", "Walker", *empty, *undeclared),
            *("ranked", "", "", "", "", "sig", "0.5", "", *ranks_of_first),
        ],
        [
            *("", "", "Blue", at, "", "Paper", *empty, *undeclared),
            *("reported", "", "A table", "2020", "v2", *empty),
        ],
        [
            *("", "cat", "", at, "3", "Cat", *empty, *undeclared),
            *("disqualified", told, "", "", "", "", "", "0.0", *empty[:5]),
        ],
    ]


def test_names_are_made_distinct_by_team_and_then_by_id() -> None:
    hidden = {"method": {"name": "Ant"}, "anonymous_until": HIDDEN}
    rows = [
        Row(1, entry("Ant")),
        Row(2, entry("Ant", submission_id="ant2")),
        Row(3, entry("Ant", submission_id="ant3", team="Red")),
        Row(4, entry("x", submission_id="ant4", **hidden)),
        Row(5, entry("Bee")),
        *(Row(rank, reported("Cat", None)) for rank in (6, 7)),
    ]
    assert method_names(ranking_of(), rows) == [
        *("Ant (Blue) (ant)", "Ant (Blue) (ant2)", "Ant (Red)", "Ant (anonymous)", "Bee"),
        *("Cat (Blue) (6)", "Cat (Blue) (7)"),
    ]


def test_what_to_cite_for_another_task() -> None:
    assert paper_of(find_task("r2r")) == (
        "@misc{r2r,\n"
        "  title = {{R2R}},\n"
        "  howpublished = {\\url{https://github.com/peteanderson80/Matterport3DSimulator}},\n"
        "  note = {Anderson et al., Vision-and-Language Navigation: Interpreting "
        "visually-grounded navigation instructions in real environments, CVPR 2018},\n"
        "}\n"
    )
