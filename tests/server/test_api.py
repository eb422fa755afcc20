"""What the routes say and refuse: splits, submissions, changes, and problem documents."""

from collections.abc import Mapping
from typing import Any

import httpx
import pytest

from reverie_eval import GroundTruth, __version__
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.schemas.organising import NewNotice
from reverie_eval.server.messages.notices import post_notice
from tests.support.description import Description
from tests.support.serving import (
    GOOD,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    packed,
    settings_of,
)

CHANGED_BACK = "\u202eretsiM"  # what turns the direction of writing


@pytest.fixture
def submission(server: Serving) -> str:
    """Return the path of a submission of the owner's, with everything said of its method."""
    reply = server.upload(
        OWNER,
        description="Looks twice.",
        paper="https://example.org/paper",
        code="https://example.org/code",
        ensemble="true",
    )
    assert reply.status_code == 201, reply.text
    return f"/submissions/{reply.json()['submission']['id']}"


def test_the_server_says_what_it_is(open_server: OpenServer, folder: Any) -> None:
    settings = settings_of(folder).model_copy(update={"required_metadata": ("code",)})
    server = open_server(settings)
    with server.acting(ORGANISER) as transaction:
        post_notice(transaction, NewNotice(banner="Back at noon.", paused=True))
    said = server.ask(None, "GET", "/server").json()
    receipt_key = said.pop("key_id")
    assert said == {
        "title": settings.title,
        "version": __version__,
        "banner": "Back at noon.",
        "paused": True,
        "required_metadata": ["code"],
        "organiser": "the organiser",
        "contact": "",
        "links": {},
    }
    assert receipt_key == server.state.signer.key_id


def test_a_split_says_what_is_needed_to_score_alike(server: Serving) -> None:
    truth = GroundTruth.load(DEMO_BUNDLES / "private" / f"{PRIVATE}.npz")
    public = GroundTruth.load(DEMO_BUNDLES / f"{PRIVATE}.public.npz")
    said = server.ask(None, "GET", f"/splits/{PRIVATE}").json()
    assert said == {
        "name": PRIVATE,
        "task": "reverie",
        "episodes": len(truth.episodes.instr_ids),
        "subset": "",
        "split_episodes": len(truth.episodes.instr_ids),
        "visibility": "private",
        "protocol": "official-v1",
        "track": "full",
        "dataset": truth.header.dataset,
        "fingerprint": truth.fingerprint,
        "public_fingerprint": public.fingerprint,
        "phases": [{"name": "always", "opens": None, "closes": None, "is_open": True}],
        "paused": False,
        "release_scores": "at-once",
        "one_per_team": False,
        "boards": {},
        "quota": None,
    }
    assert said in server.ask(None, "GET", "/splits").json()


def test_who_is_signed_in_sees_the_quota(server: Serving) -> None:
    quota = server.ask(OWNER, "GET", f"/splits/{PRIVATE}").json()["quota"]
    assert [(window["name"], window["remaining"]) for window in quota["windows"]] == [
        ("day", 2),
        ("month", 10),
        ("year", 40),
    ]


def test_what_was_uploaded_comes_back_byte_for_byte(server: Serving, submission: str) -> None:
    assert server.ask(OWNER, "GET", f"{submission}/file").content == GOOD


def test_the_list_is_one_s_own_and_the_newest_is_first(server: Serving, submission: str) -> None:
    server.clock.turn(seconds=1)
    newer = server.upload(OWNER, server.distinct()).json()["submission"]["id"]
    other = server.upload(OTHER).json()["submission"]["id"]

    def ids(who: str) -> list[str]:
        return [said["id"] for said in server.ask(who, "GET", "/submissions").json()]

    assert ids(OWNER) == [newer, submission.rpartition("/")[2]]
    assert ids(OTHER) == [other]
    assert set(ids(ORGANISER)) == {*ids(OWNER), other}


def test_another_team_s_submission_is_none(server: Serving, submission: str) -> None:
    missing = "/submissions/" + "0" * len(submission.rpartition("/")[2])
    said = [
        server.ask(OTHER, method, path, **content).text.replace(path.rpartition("/")[2], "ID")
        for method, content in (("GET", {}), ("PATCH", {"json": {"withdrawn": True}}))
        for path in (submission, missing)
    ]
    assert len(set(said)) == 1


# What is said of a method, and how.
def as_query(server: Serving, said: Mapping[str, str]) -> httpx.Response:
    return server.ask(
        OWNER, "POST", f"/splits/{OPEN}/submissions", params=dict(said), content=packed(GOOD)
    )


def as_form(server: Serving, said: Mapping[str, str]) -> httpx.Response:
    return server.ask(
        OWNER,
        "POST",
        f"/splits/{OPEN}/submissions",
        data=dict(said),
        files={"file": ("submit.json", GOOD)},
    )


WAYS = [pytest.param(as_query, id="query"), pytest.param(as_form, id="form")]
FLAGS = ("extra_data", "pre_exploration", "ground_truth_objects", "ensemble")


@pytest.mark.parametrize("way", WAYS)
def test_what_is_said_of_a_method_is_kept(server: Serving, way: Any) -> None:
    said = {
        "name": "  Läufer 走 ",
        "description": "Two\r\nlines",
        "paper": "https://example.org/paper",
        "code": "",
        "extra_data": "true",
        "pre_exploration": "1",
        "ensemble": "false",
        "input_class": "objects",
        "sample_size": "60",
        "actions_per_episode": "12.5",
        "seconds_per_episode": "",
        "money_per_episode": "0",
    }
    reply = way(server, said)
    Description(server).check(reply)
    assert reply.json()["submission"]["method"] == {
        "name": "Läufer 走",
        "description": "Two\nlines",
        "paper": "https://example.org/paper",
        "code": None,
        "extra_data": True,
        "pre_exploration": True,
        "ground_truth_objects": None,
        "ensemble": False,
        "navigation_only": None,
        "human": None,
        "input_class": "objects",
        "sample_size": 60,
        "actions_per_episode": 12.5,
        "seconds_per_episode": None,
        "input_tokens_per_episode": None,
        "output_tokens_per_episode": None,
        "money_per_episode": 0.0,
    }


def test_a_form_may_leave_to_the_query_what_it_does_not_say(server: Serving) -> None:
    reply = server.ask(
        OWNER,
        "POST",
        f"/splits/{OPEN}/submissions",
        params={"name": "from the query", "description": "from the query"},
        data={"name": "from the form"},
        files={"file": ("submit.json", GOOD)},
    )
    method = reply.json()["submission"]["method"]
    assert (method["name"], method["description"]) == ("from the form", "from the query")


# A field of a method that is wrong.
WRONG = [
    pytest.param({"name": "a", "input_class": "pixels"}, "input_class", id="no such class"),
    pytest.param({"name": "a", "sample_size": "0"}, "sample_size", id="no episode"),
    pytest.param({"name": "a", "money_per_episode": "-1"}, "money_per_episode", id="paid for it"),
    pytest.param({"name": "a", "seconds_per_episode": "nan"}, "seconds_per_episode", id="no time"),
    pytest.param({"name": ""}, "name", id="no name"),
    pytest.param({"name": "   "}, "name", id="a blank name"),
    pytest.param({"name": "x" * 101}, "name", id="a long name"),
    pytest.param({"name": "two\nlines"}, "name", id="a name of two lines"),
    pytest.param({"name": "\x1b[2J"}, "name", id="a name that clears a terminal"),
    pytest.param({"name": "a\x00b"}, "name", id="a name with a zero byte"),
    pytest.param({"name": CHANGED_BACK}, "name", id="a name that is read backwards"),
    pytest.param({"name": "Wal\u200bker"}, "name", id="a name with what cannot be seen"),
    pytest.param({"description": CHANGED_BACK}, "description", id="a description read backwards"),
    pytest.param({"description": "x" * 2001}, "description", id="a long description"),
    pytest.param({"paper": "http://example.org"}, "paper", id="a link without encryption"),
    pytest.param({"paper": "https://me:secret@example.org"}, "paper", id="a link with a password"),
    pytest.param({"code": "https://github.com@example.org/x"}, "code", id="a link with a user"),
    pytest.param({"code": "javascript:alert(1)"}, "code", id="a link that is a script"),
    pytest.param({"code": "example.org"}, "code", id="no link"),
    pytest.param({"code": f"https://example.org/{'x' * 500}"}, "code", id="a long link"),
    pytest.param({"ensemble": "perhaps"}, "ensemble", id="neither yes nor no"),
    pytest.param({"colour": "blue"}, "colour", id="a field that there is not"),
]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("said", "where"), WRONG)
def test_what_is_said_wrongly_of_a_method_is_refused_with_its_place(
    server: Serving, way: Any, said: Mapping[str, str], where: str
) -> None:
    reply = way(server, {"name": "Walker", **said})
    Description(server).check(reply)
    assert (reply.status_code, reply.json()["code"]) == (400, "malformed-request")
    assert [problem["where"] for problem in reply.json()["problems"]] == [where]
    assert server.ask(OWNER, "GET", "/submissions").json() == []


@pytest.mark.parametrize(("said", "where"), WRONG)
def test_what_is_changed_wrongly_is_refused_with_its_place(
    server: Serving, submission: str, said: Mapping[str, str], where: str
) -> None:
    before = server.ask(OWNER, "GET", submission).json()
    reply = server.ask(OWNER, "PATCH", submission, json={"published": True, "method": said})
    Description(server).check(reply)
    assert (reply.status_code, reply.json()["code"]) == (400, "malformed-request")
    assert [problem["where"] for problem in reply.json()["problems"]] == [f"method.{where}"]
    assert server.ask(OWNER, "GET", submission).json() == before


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        pytest.param({}, {}, id="nothing"),
        pytest.param({"name": "Runner"}, {"name": "Runner"}, id="the name alone"),
        pytest.param({"paper": None}, {"paper": None}, id="without a paper"),
        pytest.param(
            {"code": "https://example.org/2", "description": ""},
            {"code": "https://example.org/2", "description": ""},
            id="another link and no description",
        ),
        pytest.param({"ensemble": False}, {"ensemble": False}, id="a flag"),
    ],
)
def test_what_is_left_out_of_a_change_stays(
    server: Serving, submission: str, change: Mapping[str, Any], expected: Mapping[str, Any]
) -> None:
    before = server.ask(OWNER, "GET", submission).json()
    reply = server.ask(OWNER, "PATCH", submission, json={"method": change})
    after = {**before, "method": {**before["method"], **expected}}
    assert reply.json() == after
    assert server.ask(OWNER, "GET", submission).json() == after


PUBLISH, HIDE = {"published": True}, {"published": False}
WITHDRAW, RESTORE = {"withdrawn": True}, {"withdrawn": False}


@pytest.mark.parametrize(
    ("changes", "statuses", "final"),
    [
        pytest.param([PUBLISH], [200], "published", id="publish"),
        pytest.param([PUBLISH, HIDE], [200, 200], "unpublished", id="hide again"),
        pytest.param([PUBLISH, WITHDRAW], [200, 200], "withdrawn", id="withdraw what is published"),
        pytest.param([WITHDRAW, PUBLISH], [200, 409], "withdrawn", id="publish what is withdrawn"),
        pytest.param([WITHDRAW, RESTORE], [200, 200], "unpublished", id="restore"),
        pytest.param(
            [PUBLISH, WITHDRAW, RESTORE], [200] * 3, "published", id="restore what was published"
        ),
        pytest.param([{**PUBLISH, **WITHDRAW}], [409], "unpublished", id="both at once"),
        pytest.param(
            [WITHDRAW, {**RESTORE, **PUBLISH}], [200, 200], "published", id="restore and publish"
        ),
    ],
)
def test_what_follows_on_what(
    server: Serving, submission: str, changes: Any, statuses: list[int], final: str
) -> None:
    replies = [server.ask(OWNER, "PATCH", submission, json=change) for change in changes]
    for reply in replies:
        Description(server).check(reply)
    assert [reply.status_code for reply in replies] == statuses
    assert server.ask(OWNER, "GET", submission).json()["status"] == final


def test_to_publish_again_leaves_the_date(server: Serving, submission: str) -> None:
    first = server.ask(OWNER, "PATCH", submission, json=PUBLISH).json()["published_at"]
    server.clock.turn(hours=1)
    assert server.ask(OWNER, "PATCH", submission, json=PUBLISH).json()["published_at"] == first


def test_what_the_organiser_asks_for_cannot_be_taken_away_later(
    open_server: OpenServer, folder: Any
) -> None:
    asked = {"required_metadata": ("code",)}
    server = open_server(settings_of(folder).model_copy(update=asked))
    assert server.upload(OWNER).status_code == 400
    accepted = server.upload(OWNER, code="https://example.org").json()
    path = f"/submissions/{accepted['submission']['id']}"
    assert server.ask(OWNER, "PATCH", path, json={"method": {"name": "x"}}).status_code == 200
    reply = server.ask(OWNER, "PATCH", path, json={"method": {"code": None}})
    assert (reply.status_code, reply.json()["code"]) == (400, "malformed-request")
