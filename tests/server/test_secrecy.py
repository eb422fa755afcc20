"""Nothing that the server says or keeps of a private split gives an answer away."""

import json
import sqlite3
import tarfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reverie_eval import GroundTruth, SubmissionError, evaluate
from reverie_eval.arrays import IntArray
from reverie_eval.ground_truth import Bundle, Solution
from reverie_eval.server.app import create_app
from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.operations.checks import check_folder
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import SETTINGS_FILE, Split
from tests.support.page_routes import page_routes
from tests.support.serving import (
    ANYBODY,
    ORGANISER,
    OTHER,
    OTHER_BOARDS,
    OWNER,
    PRIVATE,
    STRICT,
    OpenServer,
    Serving,
    adjusted,
    broken_private,
    private_truth,
    running,
    settings_of,
    submission_for,
)
from tests.support.traceable_answers import BOX, CATEGORY, FIRST_OBJECT, Secrets, planted
from tests.support.visiting import FIELD
from tests.support.waiting import PATIENCE

PLENTY = {"day": 1000, "month": 1000, "year": 1000}
EVERYBODY = (ANYBODY, OWNER, OTHER, ORGANISER)


def view_of_target(solution: Solution, episode: int) -> int:
    here = slice(episode, episode + 1)
    slot, _ = solution.find(solution.target_object[here], solution.goal[here])
    view: int = solution.boxes.view[solution.boxes.candidate == slot[0]].tolist()[0]
    return view


def answered(**answer: object) -> bytes:
    """Return a submission of agents that stay where they are and answer this."""
    records = json.loads(submission_for(PRIVATE, "stop"))
    for record in records:
        del record["predObjId"]
    return json.dumps([{**record, **answer} for record in records]).encode()


def walked(*, is_right: bool = False, **answer: object) -> bytes:
    """Return one whose first agents walk to their goals: some means are neither 0 nor 1.

    Right ones draw their box in a view of the target.
    """
    truth = private_truth()
    records = json.loads(answered(**answer))
    row = {record["instr_id"]: record for record in records}
    for episode, instr_id in enumerate(truth.episodes.instr_ids[:7]):
        goal = truth.graph.viewpoint_ids[int(truth.require_solution().goal[episode])]
        row[instr_id]["trajectory"].append([goal, 0.1, 0.2])
        if is_right:
            row[instr_id]["predView"] = view_of_target(truth.require_solution(), episode)
    return json.dumps(records).encode()


@cache
def sound() -> Sequence[bytes]:
    """Return submissions that are scored: objects, boxes, nothing, and where they are drawn."""
    near = {"predBox": [BOX[0] + 1, *BOX[1:]], "predView": 12}
    return (
        walked(predObjId=5),
        walked(is_right=True, **near),
        answered(predObjId=-1),
        answered(predObjId=0),
        answered(predBox=[0, 0, 640, 480], predView=13),
        answered(predBox=[0, 0, 1, 1], predImageSize=[1, 1], predView=35),
        walked(predObjId=5) + b" ",
    )


@cache
def unsound() -> Sequence[bytes]:
    """Return submissions that are rejected."""
    return (
        broken_private(),
        answered(predObjId="lamp"),
        answered(predObjId=2**40),
        answered(predObjId=-7),
        answered(predBox=[0, 0, 9, 9], predView=36),
        answered(predBox=[0, 0, 0, 9], predView=1),
        answered(predObjId=5, predBox=[0, 0, 9, 9], predView=1),
        answered(predObjId=5, trajectory=[]),
        b"[]",
        b"{",
        b"",
    )


@pytest.fixture(scope="module")
def planted_bundle(tmp_path_factory: pytest.TempPathFactory, made_folder: Path) -> Path:
    """Write the private split's bundle with a planted solution."""
    path = tmp_path_factory.mktemp("planted") / "test.npz"
    planted(Bundle.load(made_folder / "bundles" / "test.npz")).save(path)
    path.chmod(0o600)
    return path


@pytest.fixture
def planted_folder(folder: Path, planted_bundle: Path) -> Path:
    """Return a server's folder whose private split has a planted solution."""
    (folder / "bundles" / "test.npz").write_bytes(planted_bundle.read_bytes())
    return folder


@pytest.fixture(scope="module")
def secrets(planted_bundle: Path) -> Secrets:
    """Gather what nobody may be told."""
    truth = GroundTruth.load(planted_bundle)
    scores = [evaluate(each, split=PRIVATE, ground_truth=truth) for each in sound()]
    assert any(0 < each["success"] < 1 for each in scores)
    assert any(0 < each["rgs"] < 1 for each in scores)
    return Secrets.of(truth, [*sound(), *unsound()], scores)


@pytest.fixture
def server(planted_folder: Path, open_server: OpenServer) -> Serving:
    """Return a server with a planted solution and quota for everything."""
    quota = settings_of(planted_folder).splits[PRIVATE].effective_quota.model_copy(update=PLENTY)
    return open_server(adjusted(settings_of(planted_folder), quota=quota, boards=OTHER_BOARDS))


Ask = Callable[..., httpx.Response]


MONITORS = ("/healthz", "/readyz", "/metrics")


def everything_said(ask: Ask, server: Serving) -> Iterator[httpx.Response]:
    """Use the private split in every way, and everything else in a way or two."""
    ids: list[str] = []
    yield from said_of_uploads(ask, ids)
    yield from everything_declared(ask, ids[0])
    yield from everything_shown(ask, server, ids[0])
    yield from shown_of_uploads(ask, server)
    for who in EVERYBODY:
        for path in ("/", *MONITORS, "/api/v1/openapi.json", "/docs", "/no-such"):
            yield ask(who, "GET", path)


def said_of_uploads(ask: Ask, ids: list[str]) -> Iterator[httpx.Response]:
    """Send what is sound and what is not, publish what was scored, and gather its ids."""
    upload = f"/api/v1/splits/{PRIVATE}/submissions"
    validate = f"/api/v1/splits/{PRIVATE}/validate"
    for content in sound():
        reply = ask(OWNER, "POST", upload, content=content, params={"name": "Walker"})
        assert reply.status_code == 201, reply.text
        ids.append(reply.json()["submission"]["id"])
        yield reply
        yield ask(OWNER, "POST", upload, content=content, params={"name": "Walker"})
        yield ask(OWNER, "POST", validate, content=content)
        yield ask(OWNER, "POST", validate, files={"file": content}, data={"name": "Walker"})
    for content in unsound():
        reply = ask(OWNER, "POST", upload, content=content, params={"name": "Walker"})
        assert reply.status_code in {400, 422}, reply.text
        yield reply
        yield ask(OTHER, "POST", validate, content=content)
    for submission_id in ids:
        published = ask(
            OWNER, "PATCH", f"/api/v1/submissions/{submission_id}", json={"published": True}
        )
        assert published.status_code == 200, published.text
        yield published


def placed(route: str, submission_id: str) -> str:
    """Return a path of the private split and a submission to it."""
    parts = {"{split}": PRIVATE, "{submission_id}": submission_id, "{board}": STRICT}
    for name, value in parts.items():
        route = route.replace(name, value)
    return route


def everything_declared(ask: Ask, submission_id: str) -> Iterator[httpx.Response]:
    """Ask for every operation of the API's description, as everybody."""
    described = ask(ANYBODY, "GET", "/api/v1/openapi.json").json()["paths"]
    assert len(described) > 10
    for template, operations in described.items():
        path = placed(template, submission_id)
        if path.endswith("/file"):  # what somebody sent is theirs to see
            continue
        for method in operations.keys() & {"get", "post", "patch", "put", "delete"}:
            for who in EVERYBODY:
                body = {} if method == "get" else {"content": b"{}"}
                yield ask(who, method.upper(), path, **body)
                if method == "get" and "{split}" in template:
                    yield ask(who, "GET", path, params={"metric": "rgs"})


def everything_shown(ask: Ask, server: Serving, submission_id: str) -> Iterator[httpx.Response]:
    """Look at every page that there is, as everybody."""
    routes = [path for method, path in page_routes(create_app(server.state)) if method == "GET"]
    assert len(routes) > 25
    for who in EVERYBODY:
        cookie = signed_in(ask, server.tokens[who]) if who else {}
        for route in routes:
            path = placed(route, submission_id)
            yield ask(ANYBODY, "GET", path, headers=cookie)
            if "{split}" in route:
                query = {"metric": "rgs", "columns": "all"}
                yield ask(ANYBODY, "GET", path, headers=cookie, params=query)


def shown_of_uploads(ask: Ask, server: Serving) -> Iterator[httpx.Response]:
    """Send in a browser, to be scored and to be checked, what is sound and what is not."""
    cookie = signed_in(ask, server.tokens[OTHER])
    (csrf_token, *_) = FIELD.findall(ask(ANYBODY, "GET", "/team", headers=cookie).text)
    for content in (*sound(), *unsound()):
        for what in ("check", "score"):
            said = {"csrf_token": csrf_token, "split": PRIVATE, "what": what, "name": "Walker"}
            file = {"file": ("submit.json", content)}
            reply = ask(ANYBODY, "POST", "/submit", headers=cookie, data=said, files=file)
            assert reply.status_code in {200, 303, 400, 422}, reply.text
            yield reply
            if "location" in reply.headers:
                yield ask(ANYBODY, "GET", reply.headers["location"], headers=cookie)


def signed_in(ask: Ask, token: str) -> dict[str, str]:
    """Return the cookie of somebody's browser."""
    reply = ask(ANYBODY, "POST", "/sign-in", data={"token": token})
    return {"Cookie": reply.headers["set-cookie"].partition(";")[0]}


def leaks(secrets: Secrets, replies: Iterator[httpx.Response]) -> set[str]:
    """Return what kinds of secrets are in the bodies and the headers of replies."""
    found = set()
    for reply in replies:
        headers = "\n".join(f"{name}: {value}" for name, value in reply.headers.items())
        found |= {*secrets.found_in(headers), *secrets.found_in(reply.text)}
    return found


def asking(server: Serving) -> Ask:
    """Return what asks a server in this process, at any path."""
    return asking_with(server.client, server)


def asking_with(client: httpx.Client, server: Serving, url: str = "") -> Ask:
    """Return what asks with a client, which keeps no cookies."""

    def ask(who: str | None, method: str, path: str, **content: Any) -> httpx.Response:
        headers = {"Authorization": f"Bearer {server.tokens[who]}"} if who else {}
        headers |= content.pop("headers", {})
        client.cookies.clear()
        return client.request(method, url + path, headers=headers, **content)

    return ask


def test_nothing_that_a_server_says_logs_or_keeps_holds_a_secret(
    server: Serving, planted_folder: Path, secrets: Secrets, tmp_path: Path
) -> None:
    generous = {
        f"REVERIE_EVAL_SPLITS__test__quota__{name}": str(limit) for name, limit in PLENTY.items()
    }
    generous["REVERIE_EVAL_LIMITS__REQUESTS_PER_MINUTE"] = "1000000"
    with running(planted_folder, **generous) as (_, url), httpx.Client(timeout=PATIENCE) as client:
        said = everything_said(asking_with(client, server, url), server)
        assert leaks(secrets, said) == set()
    kept = dict(everything_kept(planted_folder, tmp_path))
    assert {"log", "rows", "server.db", "backup: database.jsonl", "check"} <= kept.keys()
    assert {
        name: found for name, text in kept.items() if (found := [*secrets.found_in(text)])
    } == {}


def test_a_server_refuses_to_keep_exact_values_of_a_private_split(
    server: Serving, folder: Path
) -> None:
    server.upload(OWNER)
    assert not [finding for finding in check_folder(folder) if finding.kind != "ok"]
    file = folder / SETTINGS_FILE
    file.write_text(file.read_text().replace('visibility = "open"', 'visibility = "private"'))
    (fault,) = [finding for finding in check_folder(folder) if finding.kind != "ok"]
    assert (fault.check, fault.kind) == ("secrets", "fault")
    assert "val_unseen is private, but exact values of 1 result were stored" in fault.what


def test_results_that_cannot_be_read_are_the_doctor_s(server: Serving, folder: Path) -> None:
    server.upload(OWNER, sound()[0], PRIVATE)
    with closing(sqlite3.connect(folder / "server.db")) as database, database:
        database.execute("UPDATE submission SET report = '[]'")
    (note,) = [finding for finding in check_folder(folder) if finding.kind != "ok"]
    assert (note.check, note.kind) == ("results", "note")


def everything_kept(folder: Path, tmp_path: Path) -> Iterator[tuple[str, str]]:
    """Return what lies in a server's folder and its backup, but bundles and what was sent."""
    sent = set(sound())
    for file in folder.rglob("*"):
        is_bundle = "bundles" in file.relative_to(folder).parts
        if file.is_file() and not is_bundle and file.read_bytes() not in sent:
            yield str(file.relative_to(folder)), file.read_bytes().decode("latin-1")
    with closing(sqlite3.connect(folder / "server.db")) as database:
        yield "rows", "\n".join(database.iterdump())
    yield "check", "\n".join(map(str, check_folder(folder)))
    write_backup(folder, tmp_path / "backup.tar.gz")
    with tarfile.open(tmp_path / "backup.tar.gz") as archive:
        for member in archive.getmembers():
            file_ = archive.extractfile(member)
            content = file_.read() if file_ else b""
            if not member.name.startswith("bundles") and content not in sent:
                yield f"backup: {member.name}", content.decode("latin-1")


# The search finds what is there to be found.


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        pytest.param(f'{{"found": {FIRST_OBJECT + 7919 * 40}}}', "target object", id="a number"),
        pytest.param(f"expected object {FIRST_OBJECT}, got 5", "target object", id="a sentence"),
        pytest.param(f"its box is {list(BOX)}", "box", id="a list"),
        pytest.param("x=601.0,433.0,37.0,29.0", "box", id="other numbers"),
        pytest.param(f"the {CATEGORY}7 was not found", "category", id="a word"),
        pytest.param('{"a": [{"b": 0.12345}]}', "number that is not rounded", id="digits"),
        pytest.param(f"{[0] * 91}", "list of numbers", id="a value for each episode"),
        pytest.param('{"report": {"boxes": {"correct": 3}}}', "what became of boxes", id="boxes"),
    ],
)
def test_the_search_finds(text: str, kind: str, secrets: Secrets) -> None:
    assert kind in set(secrets.found_in(text))


def test_the_search_finds_goals_and_means(secrets: Secrets, planted_bundle: Path) -> None:
    truth = GroundTruth.load(planted_bundle)
    paths = {truth.graph.viewpoint_ids[each] for each in truth.require_solution().path.tolist()}
    hidden = [each for each in paths if {*secrets.found_in(f"go to {each}")} == {"goal or path"}]
    assert len(hidden) > 10
    scores = evaluate(sound()[0], split=PRIVATE, ground_truth=truth)
    kind = "mean that is not rounded"
    assert kind in set(secrets.found_in(f"log: success {scores['success']}"))
    assert kind in set(secrets.found_in(f"SR {100 * scores['success']} %"))
    assert not set(secrets.found_in(f"SR {100 * scores['success']:.2f} %"))


def test_the_search_passes_over_times_and_durations(secrets: Secrets, planted_bundle: Path) -> None:
    truth = GroundTruth.load(planted_bundle)
    success = evaluate(sound()[0], split=PRIVATE, ground_truth=truth)["success"]
    told = {"mean that is not rounded"}
    for text in (
        f"at 2026-11-24T00:19:{100 * success:09.6f}Z",
        f'request_seconds_sum{{route="/api/v1/splits"}} {success}',
        f"process_cpu_seconds_total {100 * success}",
    ):
        assert not set(secrets.found_in(text))
        assert set(secrets.found_in(f"{text}\nSR {100 * success}")) == told
    assert set(secrets.found_in(f'request_seconds_sum{{about="{success}"}} 0.1')) == told
    assert set(secrets.found_in(f'[{{"wait_seconds":60,"success":{success}}}] and')) == told


def tells_boxes(self: Board, scores: Any, reading: Any) -> Any:
    return scores.to_report().model_copy(update={"scores": {}})


def tells_exactly(self: Board, scores: Any, reading: Any) -> Any:
    report = scores.to_report()
    return report.model_copy(update={"boxes": None, "notes": []})


def tells_targets(self: Board, scores: Any, reading: Any) -> Any:
    notes = [f"wrong: {self.truth.require_solution().target_object.tolist()[0]}"]
    return rounded(self, scores, reading).model_copy(update={"notes": notes})


def tells_goals(self: Board, scores: Any, reading: Any) -> Any:
    paths = [
        self.truth.graph.viewpoint_ids[each] for each in self.truth.require_solution().path.tolist()
    ]
    return rounded(self, scores, reading).model_copy(update={"notes": paths})


rounded = Board.report


@pytest.mark.parametrize(
    ("leaking", "found"),
    [
        (tells_boxes, {"what became of boxes"}),
        (tells_exactly, {"mean that is not rounded", "number that is not rounded"}),
        (tells_targets, {"target object"}),
        (tells_goals, {"goal or path"}),
    ],
)
def test_a_server_that_tells_is_found_out(
    server: Serving,
    secrets: Secrets,
    leaking: Any,
    found: set[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Board, "report", leaking)
    assert leaks(secrets, said_of_uploads(asking(server), [])) >= found


def test_a_page_that_tells_is_found_out(server: Serving, secrets: Secrets) -> None:
    telling = f"expected object {FIRST_OBJECT}"
    reply = server.upload(OWNER, sound()[0], PRIVATE, name=telling)
    identity = reply.json()["submission"]["id"]
    pages = everything_shown(asking(server), server, identity)
    told = {page.request.url.path for page in pages if {*secrets.found_in(page.text)}}
    assert told >= {"/team", f"/submissions/{identity}"}


# What is said does not depend on the solution.


def board_with(target: IntArray, candidates: IntArray) -> Board:
    truth = private_truth()
    solution = replace(
        truth.require_solution(),
        target_object=target,
        candidate_object=candidates,
        goal=np.roll(truth.require_solution().goal, int(target[0])),
    )
    split = Split(bundle=Path("test.npz"))
    return Board(PRIVATE, split, replace(truth, solution=solution), "")


def said(board: Board, content: bytes) -> object:
    """Return what is said of a submission besides its scores, in the bytes of its JSON."""
    try:
        reading = board.read(content)
        notes = board.report(board.score(reading), reading).notes
        checked = board.check(content).validation().notes
    except SubmissionError as error:
        return [(each.code, each.where, each.message) for each in error.problems]
    return json.dumps([notes, list(checked)]).encode()


@given(st.integers(0, 2**31 - 2), st.integers(1, 90), st.sampled_from(range(18)))
def test_problems_and_notes_are_the_same_whatever_the_answers_are(
    seed: int, offset: int, which: int
) -> None:
    content = [*sound(), *unsound()][which]
    random = np.random.default_rng(seed)
    truth = private_truth().require_solution()
    as_is = board_with(truth.target_object, truth.candidate_object)
    other = board_with(
        random.integers(0, 90, len(truth.target_object)), truth.candidate_object + offset
    )
    assert said(as_is, content) == said(other, content)


def test_the_notes_would_tell_if_they_could() -> None:
    """What a laptop says of objects that are nowhere visible, a private split does not."""
    content = walked(predObjId=123)
    told = evaluate(content, split=PRIVATE, ground_truth=private_truth()).notes
    assert any("no predicted object is visible" in note for note in told)
    truth = private_truth().require_solution()
    board = board_with(truth.target_object, truth.candidate_object)
    assert "visible" not in str(said(board, content))
