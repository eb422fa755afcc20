"""The first page: the task by an example, who leads, and the ways in."""

import re
from html import unescape
from pathlib import Path

import pytest

from reverie_eval import evaluate
from reverie_eval.agents import DEMO_AGENT
from reverie_eval.runner import run_agent
from reverie_eval.server.explore.room import Showcase
from tests.support.entries import entered, get, named, report_result, tables
from tests.support.serving import (
    OPEN,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    rename_dataset,
    settings_of,
)
from tests.support.visiting import said


def home(server: Serving) -> str:
    return get(server, path="/").text


def leaders(server: Serving) -> dict[str, list[list[str]]]:
    """Return the rows of each leaderboard's table, by its heading."""
    reply = get(server, path="/")
    headings = re.findall(r'<h3 id="leaders-\d+"><a [^>]*>(.*?)</a>', reply.text)
    return dict(zip(headings, tables(reply), strict=True))


def test_an_empty_server_shows_what_reference_agents_score(server: Serving) -> None:
    rows = leaders(server)["Val unseen leaderboard"]
    assert [row[0] for row in rows] == [  # without ranks
        "Shortest agent computed here",
        "FAST-Short on names objects computed here",
        "Random agent computed here",
        "Stop agent computed here",
    ]
    truth = server.state.boards[OPEN].truth
    trained = evaluate(DEMO_AGENT / "val_unseen.json", split=OPEN)
    shortest, *others = (
        evaluate(run_agent(agent, truth), split=OPEN) for agent in ("shortest", "random", "stop")
    )
    for scores, row in zip((shortest, trained, *others), rows, strict=True):
        shown = [f"{100 * scores[key]:.2f}" for key in ("success", "spl", "rgs", "rgspl")]
        assert row[1:] == shown


def test_what_is_reported_and_what_is_computed_here_have_different_labels(
    server: Serving,
) -> None:
    report_result(server, "FAST", rgspl=0.9)
    names = [row[0] for row in leaders(server)["Val unseen leaderboard"]]
    reported = [name for name in names if " reported" in name]
    computed = [name for name in names if name.endswith(" computed here")]
    assert (len(reported), len(computed)) == (1, 4)
    assert [*reported, *computed] == names
    assert not any("paper" in name or "reference" in name for name in names)


def test_reference_agents_say_nothing_of_private_answers(server: Serving) -> None:
    assert leaders(server)["Test leaderboard"] == [
        ["No results are published yet. Submit the first"]
    ]


def test_the_first_five_with_their_intervals(server: Serving) -> None:
    for number in range(6):
        entered(server, {"rgspl": 0.1 * number}, (OWNER, OTHER)[number % 2], **named(f"M{number}"))
    rows = leaders(server)["Val unseen leaderboard"]
    assert [(row[0], row[1]) for row in rows] == [
        *(("1", "M5 Red"), ("2", "M4 Blue"), ("3", "M3 Red"), ("4", "M2 Blue"), ("5", "M1 Red"))
    ]
    assert re.fullmatch(r"50\.00 95 % interval [\d.]+ to [\d.]+", rows[0][-1])
    assert "All 6 results of val_unseen" in home(server)


def test_a_team_that_hides_is_not_named(server: Serving) -> None:
    entered(server, {"rgspl": 0.5}, anonymous_until="2100-01-01T00:00:00Z", **named("Ant"))
    assert leaders(server)["Val unseen leaderboard"][0][1] == "Ant anonymous"
    assert "Blue" not in home(server)


def test_an_example_with_its_instruction_and_answer(server: Serving) -> None:
    page, shown = home(server), server.state.get(Showcase).example()
    assert shown is not None
    board, example = shown.board, shown.episode
    assert example.instruction in unescape(page)
    assert f"object {example.target_object}" in page
    assert f"Building of episode {example.instr_id}" in page
    assert f'href="/episodes/{board.split}/{example.instr_id}"' in page
    assert "synthetic demo world" in page


def test_a_line_says_how_far_methods_are_from_people(open_server: OpenServer, folder: Path) -> None:
    """By the metric that people have; references and other versions' rows do not lead."""
    rename_dataset(folder, OPEN, "REVERIE v1")
    server = open_server()
    assert "standing-line" not in home(server)
    entered(server, {"rgspl": 0.25, "rgs": 0.5}, OWNER, **named("Ant"))
    entered(server, {"rgspl": 0.5, "rgs": 0.25}, OTHER, **named("Bee"))
    report_result(server, "Elsewhere", dataset="REVERIE v2", rgspl=0.875)
    line = "val_unseen: best RGSPL 50.00 % (Bee), 3 methods. open"
    assert line in said(get(server, path="/"))
    report_result(server, "People", human=True, rgs=0.7784)
    report_result(server, "Chance", reference=True, rgs=1.0, rgspl=1.0)
    line = "val_unseen: best RGS 50.00 % (Ant), human 77.84 %, 3 methods. open"
    assert line in said(get(server, path="/"))


def test_demo_data_are_called_so(open_server: OpenServer, folder: Path) -> None:
    """On the first page, beside splits with real data, and on the leaderboard."""
    for split in ("val_seen", OPEN):
        rename_dataset(folder, split, "REVERIE v1")
    server = open_server()
    found = re.findall(r'<h3 id="leaders-.*?(?=<table)', home(server), re.DOTALL)
    assert ["Scores mean nothing" in each for each in found] == [False, False, True]
    boards = {split: get(server, path=f"/splits/{split}").text for split in (PRIVATE, OPEN)}
    told = "the synthetic demo world, not of REVERIE: its scores mean nothing"
    assert {split: told in page for split, page in boards.items()} == {PRIVATE: True, OPEN: False}


def test_without_an_open_split_the_example_is_of_the_demo_world(
    open_server: OpenServer, folder: Path
) -> None:
    server = open_server(adjusted(settings_of(folder), OPEN, visibility="private"))
    page = home(server)
    assert "From the synthetic demo world" in page
    assert "Building of episode" in page
    assert not re.search(f'href="/(episodes|play)/{OPEN}', page)


def test_links_to_it_show_what_it_is(open_server: OpenServer, folder: Path) -> None:
    address = "https://lab.example.org"
    server = open_server(settings_of(folder).model_copy(update={"public_address": address}))
    page = home(server)
    said = dict(re.findall(r'<meta (?:name|property)="([\w:]+)" content="([^"]*)">', page))
    assert said["og:title"] == "REVERIE leaderboards"
    assert said["og:url"] == f"{address}/"
    assert said["og:description"] == said["description"] != ""
    picture = server.client.get(said["og:image"].removeprefix(address))
    assert picture.headers["content-type"] == "image/png"


def test_the_ways_in(open_server: OpenServer, folder: Path) -> None:
    links = {"Data": "https://example.org/data", "Paper": "https://example.org/paper"}
    server = open_server(settings_of(folder).model_copy(update={"links": links}))
    main = home(server).partition("<main")[2]
    play = f"/play/{OPEN}"
    for link in ("/submit", "https://example.org/data", "https://example.org/paper", "#cite", play):
        assert f'href="{link}"' in main
    assert "@inproceedings{qi2020reverie," in main


@pytest.mark.parametrize(
    ("accepts", "way"),
    [
        pytest.param(True, '<a href="/join">Request one</a>', id="by a request"),
        pytest.param(False, 'can invite you: <a href="mailto:lab@example.org">', id="by e-mail"),
    ],
)
def test_who_would_submit_is_led_to_an_account(
    open_server: OpenServer, folder: Path, way: str, *, accepts: bool
) -> None:
    changed = {"contact": "lab@example.org", "accept_requests_to_join": accepts}
    server = open_server(settings_of(folder).model_copy(update=changed))
    assert '<li><a href="/submit">Submit</a></li>' in home(server)
    asked = server.client.get("/submit")
    assert asked.headers["location"] == "/sign-in?back=/submit"
    assert way in server.client.get(asked.headers["location"]).text
