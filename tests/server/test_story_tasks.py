"""Leaderboards of other benchmarks, from an empty folder to a ranking, for each that has a demo."""

import csv
import io
import json
import re
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

import pytest

from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.metrics import CATALOGUE
from reverie_eval.runner import run_agent
from reverie_eval.server.explore.episodes import EpisodeService
from reverie_eval.server.scoring.boards import Board
from reverie_eval.tasks import BUILT_IN, DEFAULT_TASK
from tests.conftest import SAMPLES
from tests.support.processes import TOKEN, Laptop
from tests.support.serving import GOOD, OWNER, OpenServer, Serving, settings_of
from tests.support.visiting import place_of, said, signed_in

OTHERS = [name for name in BUILT_IN if name != DEFAULT_TASK and (DEMO_BUNDLES / name).is_dir()]
OF_OBJECTS = re.compile(r"\bobjects?\b|\bRGS|\bboxe?s?\b|grounding", re.IGNORECASE)

TITLES = re.compile("Dense Spatiotemporal Grounding|Scenario Oriented Object Navigation")
"""Titles of papers that have such words."""
INPUT_CLASS = re.compile("annotators' objects|geometry objects views other")
"""What an agent may be shown, whatever its task."""


@pytest.fixture(params=OTHERS)
def task(request: pytest.FixtureRequest) -> str:
    """Return the name of a task."""
    return str(request.param)


@pytest.fixture
def lab(task: str, laptop: Laptop, open_server: OpenServer) -> Serving:
    """Return a task's server as commands make it, with somebody to submit."""
    laptop.run("server", "init", "lab", "--task", task)
    assert "fault" not in laptop.run("server", "doctor", "--quick", "lab").out
    laptop.run("server", "team", "add", "lab", "Blue")
    laptop.run("server", "person", "add", "lab", OWNER, "--team", "Blue")
    token = laptop.run("server", "token", "add", "lab", OWNER).out.strip()
    return open_server(settings_of(laptop.folder / "lab"), {OWNER: token})


def walks(board: Board) -> list[dict[str, Any]]:
    """Return the submission of an agent that takes the shortest route to each goal."""
    return run_agent("shortest", board.truth)


def in_another_form(records: list[dict[str, Any]]) -> bytes:
    """Write trajectories as bare viewpoints, as some public codebases do."""
    bare = [each | {"trajectory": without_angles(each["trajectory"])} for each in records]
    return json.dumps(bare).encode()


def without_angles(trajectory: list[Any]) -> list[Any]:
    """Return the viewpoints of a trajectory, or of each one in a list of them."""
    return [
        part | {"path": [[pose[0]] for pose in part["path"]]} if isinstance(part, dict) else part[0]
        for part in trajectory
    ]


def left(server: Serving, split: str) -> int:
    remaining: int = server.ask(OWNER, "GET", f"/splits/{split}").json()["quota"]["remaining"]
    return remaining


def test_a_leaderboard_of_another_task(task: str, lab: Serving, laptop: Laptop) -> None:
    split, *_ = lab.state.boards
    board = lab.state.board(split)
    assert split == f"{task}-{board.truth.split}"
    assert board.is_private == (board.truth.split == "test")
    before = left(lab, split)
    refuse_others(lab, board)
    assert left(lab, split) == before
    sent = publish_in_two_forms(lab, board)
    assert left(lab, split) == before - 2
    look_at_ranking(lab, board, sent["report"]["scores"])
    look_at_pages(lab, board, sent["id"])

    # Results of others are imported once, by the task's own columns.
    (laptop.folder / "old.csv").write_text("team,SR,SPL\nThey,40.5,33\n")
    words = (
        "server",
        "import",
        "lab",
        "old.csv",
        "--split",
        split,
        "--source",
        "https://a.example",
    )
    assert [laptop.run(*words).out.split(", ")[0] for _ in range(2)] == [
        f"{split}: 1 row: {added} added" for added in (1, 0)
    ]
    rows = lab.ask(None, "GET", f"/splits/{split}/leaderboard").json()["rows"]
    assert [row["standing"] for row in rows] == ["ranked", "ranked", "reported"]
    assert "fault" not in laptop.run("server", "doctor", "lab").out


def test_a_result_without_a_value_for_a_metric(lab: Serving, laptop: Laptop) -> None:
    """An agent that stays where it starts detects no target, so no direction has an error."""
    for split, board in lab.state.boards.items():
        content = json.dumps(run_agent("stop", board.truth)).encode()
        sent = lab.upload(OWNER, content, split).json()["submission"]
        path = f"/submissions/{sent['id']}"
        assert lab.ask(OWNER, "PATCH", path, json={"published": True}).status_code == 200
        (row,) = lab.ask(None, "GET", f"/splits/{split}/leaderboard").json()["rows"]
        assert row["scores"] == sent["report"]["scores"]
        for page in ("/", f"/splits/{split}", f"/splits/{split}/feed.atom", "/feed.atom", path):
            assert signed_in(lab, OWNER).get(page).status_code == 200, page
    assert "fault" not in laptop.run("server", "doctor", "lab").out


def refuse_others(lab: Serving, board: Board) -> None:
    """Send a file of REVERIE, and one of another split of the task."""
    refused = lab.upload(OWNER, GOOD, board.split)
    assert [each["code"] for each in refused.json()["problems"]] == ["other-task"]
    recognised = f"look like REVERIE ids, not like {board.task.title} ids"
    assert recognised in refused.text
    assert recognised in said(signed_in(lab, OWNER).upload(GOOD, split=board.split))
    other = lab.state.board(f"{board.task.name}-val_unseen")
    strayed = lab.upload(OWNER, json.dumps(walks(other)).encode(), board.split)
    assert strayed.status_code == 422
    # R4R numbers its paths in each split anew.
    if not board.truth.episodes.index.keys() & other.truth.episodes.index.keys():
        assert {each.get("split") for each in strayed.json()["problems"]} == {other.split}


def publish_in_two_forms(lab: Serving, board: Board) -> dict[str, Any]:
    """Send the same walks in two forms, through two doors: they all reach the goal."""
    official = json.dumps(walks(board)).encode()
    sent: dict[str, Any] = lab.upload(OWNER, official, board.split).json()["submission"]
    assert sent["report"]["scores"]["success"] == 1
    assert sent["report"]["signature"].startswith(f"task:{board.task.name}|split:")
    reply = signed_in(lab, OWNER).upload(in_another_form(walks(board)), split=board.split)
    by_form = lab.ask(OWNER, "GET", f"/submissions/{place_of(reply)}").json()
    assert by_form["report"]["scores"] == sent["report"]["scores"]
    for each in (sent, by_form):
        reply = lab.ask(OWNER, "PATCH", f"/submissions/{each['id']}", json={"published": True})
        assert reply.status_code == 200, reply.text
    return sent


def look_at_ranking(lab: Serving, board: Board, scores: Mapping[str, float]) -> None:
    """Results are ranked by what ranks in the task, and only its metrics are shown."""
    place = f"/splits/{board.split}/leaderboard"
    found = lab.ask(None, "GET", place).json()
    assert found["metric"] == board.task.ranking[0]
    assert [(row["rank"], row["scores"]) for row in found["rows"]] == [(1, scores)] * 2
    columns = next(csv.reader(io.StringIO(lab.ask(None, "GET", f"{place}.csv").text)))
    assert {*columns} & CATALOGUE.keys() == {*scores}
    page = lab.client.get(f"/splits/{board.split}").text
    names = re.findall(r'<th scope="col" class="number[^>]*><a href="[^"]*" title="(.*?)"', page)
    assert {*names} == {CATALOGUE[key].name for key in board.task.headline}
    unknown = lab.ask(None, "GET", f"{place}?metric=iou")
    assert (unknown.status_code, "cannot sort by 'iou'" in unknown.text) == (400, True)


def look_at_pages(lab: Serving, board: Board, submission: str) -> None:
    """Nothing is said of objects where a task has none."""
    owner, name = signed_in(lab, OWNER), board.task.name
    title = f"{board.task.title} {board.truth.split.replace('_', ' ')} leaderboard"
    assert title in said(owner.get("/"))
    guide = [f"/guide/{chapter}/{name}" for chapter in ("submitting", "metrics", "protocols")]
    browsed = next(each.split for each in lab.state.get(EpisodeService).boards)
    first, *_ = lab.state.boards[browsed].truth.episodes.instr_ids
    episode = f"/episodes/{browsed}/{quote(first)}"
    pages = (
        *("/", "/submit", "/team", f"/splits/{board.split}", f"/submissions/{submission}", *guide),
        *(f"/episodes/{browsed}?submission=shortest", f"{episode}?submission=shortest"),
        *(f"/play/{browsed}", f"/play/{browsed}/1?answer=none"),
    )
    for path in pages:
        reply = owner.get(path)
        assert reply.status_code == 200, path
        words = INPUT_CLASS.sub("", TITLES.sub("", said(reply)))
        assert board.task.has_targets or OF_OBJECTS.search(words) is None, path


def test_commands_name_the_task(laptop: Laptop) -> None:
    """They are what participants of a real server type; one that scores several tasks."""
    made = laptop.run("server", "init", "lab", "--task", "reverie", "--task", "ndh").out
    (token,) = TOKEN.findall(made)
    (laptop.folder / "reverie.json").write_bytes(GOOD)
    sample = SAMPLES / "ndh.json"
    with laptop.serving("lab") as server:
        there = ("--split", "val_unseen", "--server", server.url)
        variables = {"REVERIE_EVAL_TOKEN": token}
        words = ("submit", sample, "--task", "ndh", *there, "--receipt", "receipt", "--publish")
        sent = laptop.run(*words, variables=variables).out
        assert "task:ndh|split:val_unseen|protocol:official-v1|" in sent
        assert "submissions left on ndh-val_unseen: 199" in sent
        proof = ("verify", "receipt", "--submission", sample, "--server", server.url)
        assert "  GP m       6.29" in laptop.run(*proof).out
        mistaken = laptop.run("submit", sample, *there, status=1, variables=variables)
        assert "holds results of NDH, not of REVERIE" in mistaken.err
        assert "no submission used" in mistaken.err
        laptop.run("submit", "reverie.json", *there, "--publish", variables=variables)
        ranked, usual = (
            laptop.run("leaderboard", *there, *more).out.splitlines()[0].split()
            for more in (("--task", "ndh"), ())
        )
    assert (ranked[3:5], "RGSPL" in ranked, "RGSPL" in usual) == (["GP", "m"], False, True)
