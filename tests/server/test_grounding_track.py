"""A split in the grounding track: answers alone are checked, scored and ranked by RGS."""

import json
from pathlib import Path

import pytest

from reverie_eval.server.scoring.boards import load_boards
from reverie_eval.server.settings import SettingsError
from tests.support.serving import (
    GOOD,
    OPEN,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
    submission_for,
)
from tests.support.signing import receipt_in
from tests.support.visiting import signed_in

LEADERBOARD = f"/splits/{OPEN}/leaderboard"


def answers_of(content: bytes) -> bytes:
    """Return a submission without its trajectories."""
    records = json.loads(content)
    return json.dumps([{k: r[k] for k in ("instr_id", "predObjId")} for r in records]).encode()


@pytest.fixture
def grounding(open_server: OpenServer, folder: Path) -> Serving:
    """Return a server whose splits are in the grounding track."""
    settings = settings_of(folder)
    for split in (OPEN, PRIVATE):
        settings = adjusted(settings, split, track="grounding")
    return open_server(settings)


def test_answers_alone_are_checked_scored_and_ranked(grounding: Serving) -> None:
    """By hand: 55 of the 84 answers are correct."""
    answers = answers_of(GOOD)
    checked = grounding.ask(OWNER, "POST", f"/splits/{OPEN}/validate", content=answers)
    assert checked.json()["valid"] is True
    sent = grounding.upload(OWNER, answers)
    assert sent.status_code == 201
    submission = sent.json()["submission"]
    assert submission["report"]["scores"] == {"rgs": 55 / 84}
    assert "|track:grounding|" in receipt_in(submission["receipt"]).signature
    path = f"/submissions/{submission['id']}"
    grounding.ask(OWNER, "PATCH", path, json={"published": True})
    board = grounding.ask(None, "GET", LEADERBOARD).json()
    assert (board["metric"], board["signature"]) == ("rgs", submission["report"]["signature"])
    assert [(row["rank"], row["standing"]) for row in board["rows"]] == [(1, "ranked")]
    visitor = signed_in(grounding, OWNER)
    for page in (
        *(f"/splits/{OPEN}", f"/splits/{OPEN}?columns=all", f"/splits/{OPEN}/chart"),
        *(f"/splits/{OPEN}/latex", f"/splits/{OPEN}/bibtex", "/guide/rules", path, "/submit"),
        *(f"/episodes/{OPEN}", f"/episodes/{OPEN}?submission={submission['id']}", "/team"),
        f"/episodes/{OPEN}/1196_0_0?submission={submission['id']}",
    ):
        assert visitor.get(page).status_code == 200, page
    assert "track: grounding" in grounding.client.get(f"/splits/{OPEN}").text


def test_private_answers_give_a_rounded_score(grounding: Serving) -> None:
    sent = grounding.upload(OTHER, answers_of(submission_for(PRIVATE)), PRIVATE)
    scores = sent.json()["submission"]["report"]["scores"]
    assert list(scores) == ["rgs"]
    assert scores["rgs"] == round(scores["rgs"], 4)


def test_trajectories_are_needed_on_the_full_track(server: Serving) -> None:
    assert server.upload(OWNER, answers_of(GOOD)).status_code == 422


@pytest.mark.parametrize("track", ["full", "grounding"])
def test_a_split_names_its_track(track: str, open_server: OpenServer, folder: Path) -> None:
    server = open_server(adjusted(settings_of(folder), OPEN, track=track))
    assert server.ask(None, "GET", f"/splits/{OPEN}").json()["track"] == track


def test_the_server_is_healthy(grounding: Serving) -> None:
    assert grounding.client.get("/healthz").json()["status"] == "ok"


def test_a_change_of_track_sets_earlier_results_apart(
    open_server: OpenServer, folder: Path
) -> None:
    before = open_server(settings_of(folder))
    submission = before.upload(OWNER).json()["submission"]["id"]
    before.ask(OWNER, "PATCH", f"/submissions/{submission}", json={"published": True})
    after = open_server(adjusted(settings_of(folder), OPEN, track="grounding"), before.tokens)
    board = after.ask(None, "GET", LEADERBOARD).json()
    assert [row["standing"] for row in board["apart"]] == ["other-rules"]
    assert board["rows"] == []


def test_a_protocol_without_grounding_cannot_have_the_track(folder: Path) -> None:
    settings = adjusted(settings_of(folder), OPEN, track="grounding", protocol="r2r-style")
    with pytest.raises(SettingsError, match="r2r-style does not score grounding"):
        load_boards(settings)
