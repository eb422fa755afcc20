"""Two servers with different solutions say the same to everybody, apart from scores.

What is compared is everything that participants and visitors can send or look at. The files are
random: sound ones, ones with mistakes, broken ones, and boxes drawn from the solution of either
server, which one of them would recognise if it looked.
"""

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from reverie_eval.scoring import PreparedSubmission
from reverie_eval.server.app import create_app
from reverie_eval.server.operations import health
from tests.support.amounts import amount, tell
from tests.support.mutated_files import FileMaker
from tests.support.page_routes import page_routes
from tests.support.paired_servers import Twins, open_twins
from tests.support.serving import (
    ANYBODY,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    STRICT,
    OpenServer,
    private_truth,
)
from tests.support.visiting import place_of

FILES_IN_SUITE = 10
MOST_SHOWN = 100


@pytest.fixture
def twins(
    folder: Path, open_server: OpenServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Twins:
    """Return two servers whose private solutions differ.

    They check their health whenever they are asked for it: with a report kept by the one and out
    of date at the other, the one would give out more ids.
    """
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    return open_twins(open_server, (folder, Path(shutil.copytree(folder, tmp_path / "twin"))), 1)


@pytest.fixture
def files(twins: Twins) -> FileMaker:
    """Return what makes files out of the solutions of both."""
    return FileMaker([server.state.boards[PRIVATE].truth for server in twins.servers])


def test_the_twins_have_the_same_public_part_and_different_answers(twins: Twins) -> None:
    left, right = (server.state.boards[PRIVATE] for server in twins.servers)
    assert left.public_fingerprint == right.public_fingerprint
    solution, others = left.truth.require_solution(), right.truth.require_solution()
    assert (solution.target_object != others.target_object).mean() > 0.9
    assert (solution.goal != others.goal).mean() > 0.7


def test_the_comparison_finds_hints_from_answers(
    twins: Twins, files: FileMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PreparedSubmission, "without_answer_hints", lambda reading: reading)
    with pytest.raises(AssertionError, match="submissions"):
        upload_all(twins, files)


@pytest.mark.slow
def test_what_is_said_of_files_does_not_depend_on_answers(twins: Twins, files: FileMaker) -> None:
    cookie = twins.cookie_of(OTHER)
    csrf_token = twins.csrf_token(cookie)
    n_files, accepted = amount(FILES_IN_SUITE), []
    for seed in range(n_files):
        content = files.file(seed)
        validated = twins.ask(
            OTHER, "POST", f"/api/v1/splits/{PRIVATE}/validate", content=content
        ).status_code
        submission_id = upload(twins, content)
        assert (validated == 200) is (submission_id is not None), seed
        accepted += [submission_id] if submission_id else []
        if seed % 4 == 0:
            upload_in_browser(twins, cookie, csrf_token, content)
    shown = list(dict.fromkeys(accepted))[-MOST_SHOWN:]
    publish(twins, shown)
    cookies = {who: twins.cookie_of(who) for who in (OWNER, OTHER)}
    for place in places(twins, shown[-1]):
        compare_as_everybody(twins, place, cookies)
    for submission_id in shown:
        for part in ("", "/receipt", f"/boards/{STRICT}/receipt", "/file", "/episodes"):
            twins.ask(OWNER, "GET", f"/api/v1/submissions/{submission_id}{part}")
        twins.ask(ANYBODY, "GET", f"/submissions/{submission_id}")
    assert len(accepted) > n_files / 10
    tell(files=n_files, accepted=len(set(accepted)), requests=twins.asked, by_status=twins.statuses)


def upload_all(twins: Twins, files: FileMaker) -> None:
    for seed in range(10 * FILES_IN_SUITE):
        upload(twins, files.file(seed))


def upload(twins: Twins, content: bytes) -> str | None:
    """Send a file to be scored, and return its id if it was."""
    path = f"/api/v1/splits/{PRIVATE}/submissions?name=Walker"
    reply = twins.ask(OWNER, "POST", path, content=content, has_scores=True)
    if '"code":"navigation-only"' in reply.text:
        declared = f"{path}&navigation_only=true"
        reply = twins.ask(OWNER, "POST", declared, content=content, has_scores=True)
    if reply.status_code >= 400:
        assert reply.status_code in {400, 413, 422}, reply.text
        return None
    submission_id = str(reply.json()["submission"]["id"])
    twins.give_same_scores(submission_id)
    return submission_id


def upload_in_browser(
    twins: Twins, cookie: Mapping[str, str], csrf_token: str, content: bytes
) -> None:
    """Send a file with the page's form, to be checked and to be scored, and follow it."""
    for what in ("check", "score"):
        said = {"csrf_token": csrf_token, "split": PRIVATE, "what": what, "name": "Walker"}
        file = {"file": ("submit.json", content)}
        reply = twins.ask(ANYBODY, "POST", "/submit", headers=cookie, data=said, files=file)
        if "location" in reply.headers:
            twins.give_same_scores(place_of(reply))
            twins.ask(ANYBODY, "GET", reply.headers["location"], headers=cookie)


def publish(twins: Twins, submission_ids: list[str]) -> None:
    for submission_id in submission_ids:
        path = f"/api/v1/submissions/{submission_id}"
        twins.ask(OWNER, "PATCH", path, json={"published": True})


def places(twins: Twins, submission_id: str) -> Iterator[str]:
    """Yield every path that can be looked at, of the private split and of a submission to it."""
    described = twins.ask(ANYBODY, "GET", "/api/v1/openapi.json").json()["paths"]
    app = create_app(twins.servers[0].state)
    routes = [path for path, operations in described.items() if "get" in operations]
    routes += [path for method, path in page_routes(app) if method == "GET"]
    instr_id = private_truth().episodes.instr_ids[0]
    for route in [*routes, "/no-such"]:
        for split in (PRIVATE, OPEN) if "{split}" in route else (PRIVATE,):
            yield route.format(
                split=split,
                board=STRICT,
                submission_id=submission_id,
                instr_id=instr_id,
                result_id=1,
                person_id=1,
                team_id=1,
                number=1,
                task="reverie",
            )


def compare_as_everybody(twins: Twins, path: str, cookies: Mapping[str, Mapping[str, str]]) -> None:
    """Look at a path as a visitor and as participants, and at metrics as the organiser."""
    is_page = not path.startswith(("/api", "/healthz", "/readyz", "/metrics"))
    people = [ANYBODY, OWNER, OTHER, *([ORGANISER] if path == "/metrics" else [])]
    for who in people:
        headers = cookies[who] if is_page and who else {}
        asks = [path, f"{path}?metric=rgs&columns=all"] if f"/{PRIVATE}" in path else [path]
        for each in asks:
            twins.ask(None if is_page else who, "GET", each, headers=headers)
