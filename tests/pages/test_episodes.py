"""The episode browser: who may look at what, and which episodes are listed."""

import json
import re
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import httpx
import pytest

import reverie_eval as rv
from reverie_eval.agents import AGENTS
from reverie_eval.runner import run_agent
from reverie_eval.server.intake import submissions as service
from tests.support.episode_pages import drawn, linked, listed, picture, send, visitor, walks
from tests.support.serving import (
    ANYBODY,
    MATE,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    private_truth,
    settings_of,
)
from tests.support.visiting import Visitor, said, signed_in

EVERYBODY = (ANYBODY, OWNER, MATE, OTHER, ORGANISER)


# Who may look.


@pytest.mark.parametrize(
    ("who", "status"),
    [(ANYBODY, 303), (OTHER, 404), (MATE, 200), (OWNER, 200), (ORGANISER, 200)],
)
def test_where_agents_went_is_their_team_s_to_see(
    who: str | None, status: int, home: Serving, submission: str
) -> None:
    """Published or not: that is what the board shows, not what the episodes do."""
    home.ask(OWNER, "PATCH", f"/submissions/{submission}", json={"published": True})
    browser = visitor(home, who)
    queries = ("submission={0}", "other={0}", "submission={0}&other={0}")
    paths = [
        f"/episodes/{OPEN}{place}?{query.format(submission)}"
        for place in ("", "/1_3_0")
        for query in queries
    ]
    replies = {path: browser.get(path).status_code for path in paths}
    assert replies == dict.fromkeys(paths, status)


def test_who_signs_in_comes_back_to_the_very_view(home: Serving, submission: str) -> None:
    path = f"/episodes/{OPEN}/1_3_0?submission={submission}&outcome=correct"
    location = Visitor(home).get(path).headers["location"]
    assert dict(parse_qsl(urlsplit(location).query)) == {"back": path}


def test_everybody_may_look_at_what_was_annotated(home: Serving, submission: str) -> None:
    for who in EVERYBODY:
        page = visitor(home, who).get(f"/episodes/{OPEN}/1_3_0")
        assert "turn on the lamp" in said(page)
        assert [len(drawn(picture(page), kind)) for kind in ("annotated", "stop")] == [1, 0]
        assert submission not in page.text or who not in {ANYBODY, OTHER}


def test_one_chooses_among_one_s_own(home: Serving, submission: str, other: str) -> None:
    foreign = send(home, walks() + b" ", OTHER, name="Foreign")
    seen = {
        who: {
            id_
            for id_ in (submission, other, foreign)
            if f'value="{id_}"' in visitor(home, who).get(f"/episodes/{OPEN}").text
        }
        for who in EVERYBODY
    }
    assert seen == {
        ANYBODY: set(),
        OWNER: {submission, other},
        MATE: {submission, other},
        OTHER: {foreign},
        ORGANISER: {submission, other, foreign},
    }


@pytest.mark.parametrize(
    ("changes", "is_baseline", "are_shown"),
    [
        pytest.param([{"published": True}], False, False, id="published alone"),
        pytest.param([{"shows_episodes": True}], False, False, id="shown, but not published"),
        pytest.param([{"published": True, "shows_episodes": True}], False, True, id="both"),
        pytest.param(
            [{"published": True, "shows_episodes": True}, {"shows_episodes": False}],
            False,
            False,
            id="hidden again",
        ),
        pytest.param(
            [{"published": True, "shows_episodes": True}, {"withdrawn": True}],
            False,
            False,
            id="withdrawn",
        ),
        pytest.param([{"published": True}], True, True, id="a baseline"),
        pytest.param([], True, False, id="a baseline that is not published"),
    ],
)
def test_a_team_may_show_its_walks_to_everyone(
    *,
    changes: list[dict[str, bool]],
    is_baseline: bool,
    are_shown: bool,
    home: Serving,
    submission: str,
) -> None:
    for change in changes:
        reply = home.ask(OWNER, "PATCH", f"/submissions/{submission}", json=change)
        assert reply.status_code == 200
    if is_baseline:
        review = {"submission_id": submission, "verdict": "baseline", "reason": "ours"}
        assert home.ask(ORGANISER, "POST", "/organiser/reviews", json=review).status_code == 201
    walked = f"/episodes/{OPEN}/1_3_0?submission={submission}"
    for who, hidden in ((ANYBODY, 303), (OTHER, 404)):
        browser = visitor(home, who)
        page = browser.get(walked)
        assert page.status_code == (200 if are_shown else hidden)
        assert (f'value="{submission}"' in browser.get(f"/episodes/{OPEN}").text) == are_shown
        published = browser.get(f"/submissions/{submission}").text
        assert (f"/episodes/{OPEN}?submission={submission}" in published) == are_shown
        if are_shown:
            assert [len(drawn(picture(page), kind)) for kind in ("annotated", "stop")] == [1, 1]
    assert visitor(home, MATE).get(walked).status_code == 200


def test_the_walks_of_an_anonymous_team_do_not_name_it(home: Serving, submission: str) -> None:
    change = {
        "published": True,
        "shows_episodes": True,
        "anonymous_until": "2100-01-01T00:00:00Z",
    }
    home.ask(OWNER, "PATCH", f"/submissions/{submission}", json=change)
    team = home.ask(OWNER, "GET", "/me").json()["team"]
    browser = Visitor(home)
    for place in ("", f"/{OPEN}", f"/{OPEN}/1_3_0"):
        page = browser.get(f"/episodes{place}?submission={submission}")
        assert submission in page.text
        assert team not in said(page)


def test_a_team_decides_on_its_page(home: Serving, submission: str) -> None:
    owner = signed_in(home, OWNER)
    path = f"/submissions/{submission}"
    assert owner.send(path, {"published": "true", "shows_episodes": "true"}).status_code == 303
    assert Visitor(home).get(f"/episodes/{OPEN}?submission={submission}").status_code == 200
    assert "episodes shown to everyone" in said(owner.get(path))
    assert owner.send(path, {"shows_episodes": "false"}).status_code == 303
    assert Visitor(home).get(f"/episodes/{OPEN}?submission={submission}").status_code == 303


def test_episodes_of_a_private_split_cannot_be_shown(server: Serving) -> None:
    id_ = send(server, server.distinct(PRIVATE), split=PRIVATE)
    reply = server.ask(OWNER, "PATCH", f"/submissions/{id_}", json={"shows_episodes": True})
    assert reply.status_code == 409
    assert "private splits are never shown" in reply.json()["detail"]


@pytest.mark.parametrize("agent", AGENTS)
def test_everyone_can_replay_the_reference_agents(agent: str, home: Serving) -> None:
    page = Visitor(home).get(f"/episodes/{OPEN}/1_3_0?submission={agent}&other=shortest")
    assert page.status_code == 200
    assert f"{agent.capitalize()} (reference agent)" in said(page)
    assert "/submissions/" not in page.text


# Nothing of private splits, for nobody.


@pytest.mark.parametrize("who", EVERYBODY)
def test_a_private_split_has_no_episodes(who: str | None, server: Serving) -> None:
    id_ = send(server, server.distinct(PRIVATE), split=PRIVATE)
    known = private_truth().episodes.instr_ids[0]
    browser = visitor(server, who)
    for split in (
        PRIVATE,
        PRIVATE.upper(),
        f" {PRIVATE}",
        f"{PRIVATE}%00",
        f"{OPEN}%2f..%2f{PRIVATE}",
    ):
        for place in ("", f"/{known}", "/no-such"):
            for query in ("", f"?submission={id_}", f"?other={id_}&text=a", "?outcome=correct"):
                reply = browser.get(f"/episodes/{split}{place}{query}")
                assert reply.status_code == 404
                assert known not in said(reply)


@pytest.mark.parametrize("who", EVERYBODY)
def test_no_private_submission_comes_in_by_another_split(who: str | None, server: Serving) -> None:
    """What is said is what is said of an id that there is not."""
    id_ = send(server, server.distinct(PRIVATE), split=PRIVATE)
    browser = visitor(server, who)
    for place in ("", "/1196_0_0"):
        for query in ("submission={}", "other={}", "submission={}&other={}"):
            secret, unknown = (
                browser.get(f"/episodes/{OPEN}{place}?{query.format(each, each)}")
                for each in (id_, "0123456789abcdef")
            )
            assert secret.status_code == unknown.status_code == (404 if who else 303)
            assert said(secret).replace(id_, "0123456789abcdef") == said(unknown)


def test_a_submission_to_another_open_split_does_not_fit(server: Serving) -> None:
    truth = server.state.boards["val_seen"].truth
    id_ = send(server, json.dumps(run_agent("stop", truth, 0)).encode(), split="val_seen")
    browser = signed_in(server, OWNER)
    assert browser.get(f"/episodes/val_seen?submission={id_}").status_code == 200
    for place in ("", "/1196_0_0"):
        for name in ("submission", "other"):
            assert browser.get(f"/episodes/{OPEN}{place}?{name}={id_}").status_code == 404


def test_nothing_private_is_offered(server: Serving) -> None:
    id_ = send(server, server.distinct(PRIVATE), split=PRIVATE, name="Secret walker")
    for path in ("/episodes", f"/episodes/{OPEN}", f"/episodes/{OPEN}/1196_0_0"):
        page = signed_in(server, ORGANISER).get(path)
        assert page.status_code == 200
        assert id_ not in page.text
        assert "Secret walker" not in page.text
        assert f"/episodes/{PRIVATE}" not in page.text


def test_a_split_that_becomes_private_has_no_episodes(
    open_server: OpenServer, folder: Path
) -> None:
    settings = settings_of(folder)
    (folder / "bundles" / f"{OPEN}.npz").chmod(0o600)
    server = open_server(adjusted(settings, OPEN, visibility="private"))
    id_ = send(server, server.distinct())
    browser = signed_in(server, ORGANISER)
    for path in ("", "/1196_0_0", f"?submission={id_}", f"/1196_0_0?submission={id_}"):
        assert browser.get(f"/episodes/{OPEN}{path}").status_code == 404
    assert OPEN not in said(browser.get("/episodes")).split("Episodes Every episode")[1]


# The list.

BY_OUTCOME = {
    "correct": ["1_3_0"],
    "wrong object": ["1_3_1"],
    "correct object at the wrong stop": ["1_3_2"],
    "overshot": ["2_4_0"],
    "never reached": ["2_4_1"],
}


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        pytest.param("", ["1_3_0", "1_3_1", "1_3_2", "2_4_0", "2_4_1"], id="all"),
        *(
            pytest.param(f"outcome={outcome}", ids, id=outcome)
            for outcome, ids in BY_OUTCOME.items()
        ),
        pytest.param("text=2_4", ["2_4_0", "2_4_1"], id="of the id"),
        pytest.param(
            "text=TURN  on", ["1_3_0", "1_3_1", "1_3_2", "2_4_0", "2_4_1"], id="in any case"
        ),
        pytest.param("scan=home&text=1_3_1", ["1_3_1"], id="scan and text"),
        pytest.param("scan=Home", [], id="no such scan"),
        pytest.param("outcome=Right", [], id="no such outcome"),
        pytest.param("outcome=correct&text=2_4", [], id="both must hold"),
        pytest.param("text=%25_%00'", [], id="odd text"),
    ],
)
def test_what_is_listed(query: str, expected: list[str], home: Serving, submission: str) -> None:
    page = signed_in(home, OWNER).get(f"/episodes/{OPEN}?submission={submission}&{query}")
    assert sorted(listed(page)) == expected
    assert ("No episodes match" in said(page)) == (not expected)


def test_outcomes_of_two(home: Serving, submission: str, other: str) -> None:
    browser, both = signed_in(home, OWNER), f"submission={submission}&other={other}"
    right_once = browser.get(f"/episodes/{OPEN}?{both}&outcome=correct&other_outcome=never reached")
    assert listed(right_once) == ["1_3_0"]
    improved = browser.get(f"/episodes/{OPEN}?{both}&outcome=never reached&other_outcome=correct")
    assert listed(improved) == ["2_4_1"]


def test_what_is_chosen_is_marked_where_it_was_chosen(
    home: Serving, submission: str, other: str
) -> None:
    browser, both = signed_in(home, OWNER), f"submission={submission}&other={other}"
    page = browser.get(f"/episodes/{OPEN}?{both}&outcome=correct&other_outcome=never reached").text
    marked = re.findall(r'<td class="number"><a aria-current="true" href="([^"]*)"', page)
    assert ["other_outcome" in link.replace("&amp;outcome=correct", "") for link in marked] == [
        False,
        True,
    ]


def counts(reply: httpx.Response) -> list[tuple[str, list[int]]]:
    """Return the rows of the table of outcomes."""
    table = re.search(r'<table class="outcomes counts">.*?</table>', reply.text, re.DOTALL)
    assert table
    rows = re.findall(r'<th scope="row">.*?</svg>([^<]*)<(.*?)</tr>', table[0], re.DOTALL)
    return [(name, [int(n) for n in re.findall(r">(\d+)<", cells)]) for name, cells in rows]


def test_counts_are_those_of_the_scores(server: Serving) -> None:
    id_ = send(server, server.distinct())
    page = signed_in(server, OWNER).get(f"/episodes/{OPEN}?submission={id_}")
    anatomy = rv.evaluate(server.distinct(), split=OPEN).failure_modes
    assert dict(counts(page)) == {name: [count] for name, count in anatomy.counts.items()}
    funnel = re.search(r'<table class="funnel">.*?</table>', page.text, re.DOTALL)
    assert funnel
    stages = re.findall(r'<th scope="row">([^<]*)</th><td class="number">([\d,]+)<', funnel[0])
    assert {name: int(count) for name, count in stages} == anatomy.funnel


def test_counts_are_of_what_is_chosen_whatever_its_outcome(
    home: Serving, submission: str, other: str
) -> None:
    path = f"/episodes/{OPEN}?submission={submission}&other={other}&text=2_4&outcome=overshot"
    page = signed_in(home, OWNER).get(path)
    assert counts(page) == [
        ("correct", [0, 1]),
        ("correct object at the wrong stop", [0, 0]),
        ("wrong object", [0, 0]),
        ("overshot", [1, 0]),
        ("never reached", [1, 1]),
    ]
    assert listed(page) == ["2_4_0"]


def test_pages_of_the_list_join_to_the_whole(server: Serving) -> None:
    browser, truth = Visitor(server), server.state.boards[OPEN].truth
    first, second = (browser.get(f"/episodes/{OPEN}?page={number}") for number in (1, 2))
    assert listed(first) + listed(second) == list(truth.episodes.instr_ids)
    assert linked(first, "next") == f"/episodes/{OPEN}?page=2#list"
    assert linked(second, "prev") == f"/episodes/{OPEN}?page=1#list"
    assert linked(first, "prev") is None
    assert listed(browser.get(f"/episodes/{OPEN}?page=99")) == listed(second)
    assert browser.get(f"/episodes/{OPEN}?page=0").status_code == 400


def test_targets_are_chosen_by_category(server: Serving) -> None:
    solution, episodes = (
        server.state.boards[OPEN].truth.require_solution(),
        server.state.boards[OPEN].truth.episodes,
    )
    lamps = [
        instr_id
        for instr_id, item in zip(episodes.instr_ids, episodes.item, strict=True)
        if solution.target_categories[item] == "lamp"
    ]
    assert lamps
    assert listed(Visitor(server).get(f"/episodes/{OPEN}?category=lamp")) == lamps


# At hand.


def test_who_looks_at_the_next_episode_waits_for_no_scoring(
    home: Serving, submission: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    browser, query = signed_in(home, OWNER), f"submission={submission}"
    before = browser.get(f"/episodes/{OPEN}/1_3_0?{query}").text

    def fail(*_: object) -> None:
        raise AssertionError("scored again")

    monkeypatch.setattr("reverie_eval.server.scoring.boards.Board.read", fail)
    assert browser.get(f"/episodes/{OPEN}/1_3_0?{query}").text == before
    assert browser.get(f"/episodes/{OPEN}/2_4_0?{query}").status_code == 200
    assert visitor(home, OTHER).get(f"/episodes/{OPEN}/1_3_0?{query}").status_code == 404


def test_few_are_kept(home: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    browser, scored = signed_in(home, OWNER), []
    read = home.state.boards[OPEN].__class__.read
    ids = [send(home, walks() + b" " * n) for n in range(service.RECENT + 1)]

    def count(board: object, content: bytes) -> object:
        scored.append(len(content))
        return read(board, content)  # type: ignore[arg-type]

    monkeypatch.setattr("reverie_eval.server.scoring.boards.Board.read", count)
    for id_ in [*ids, *ids[1:], ids[0]]:
        assert browser.get(f"/episodes/{OPEN}?submission={id_}").status_code == 200
    assert len(scored) == service.RECENT + 2
