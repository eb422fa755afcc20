"""Files of old submissions that are not published: deleted by rule, and what knows of it."""

from pathlib import Path

import pytest
from sqlalchemy import select

from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.corrections.corrections import outdated, rescore_one
from reverie_eval.server.intake.retention import tidy
from reverie_eval.server.intake.room import jobs
from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.uploads import pack
from tests.support.serving import (
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    OpenServer,
    Serving,
    replace_answers,
    running,
    settings_of,
)
from tests.support.visiting import said, signed_in
from tests.support.waiting import wait_until

DAYS = 30


@pytest.fixture
def server(open_server: OpenServer, folder: Path) -> Serving:
    """Return a server that keeps files for 30 days."""
    file = folder / "reverie-eval.toml"
    file.write_text(f"keep_uploads_days = {DAYS}\n{file.read_text()}")
    return open_server(settings_of(folder))


def sent(server: Serving, who: str = OWNER, content: bytes | None = None) -> str:
    content = server.distinct() if content is None else content
    return str(server.upload(who, content).json()["submission"]["id"])


def publish(server: Serving, who: str, submission: str, **change: bool) -> None:
    change = change or {"published": True}
    reply = server.ask(who, "PATCH", f"/submissions/{submission}", json=change)
    assert reply.status_code == 200


def files(server: Serving) -> int:
    return len(list(server.state.uploads.names()))


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [pytest.param(-1, 0, id="a second too young"), pytest.param(0, 1, id="old enough")],
)
def test_a_file_is_deleted_after_so_many_days(seconds: int, expected: int, server: Serving) -> None:
    submission = sent(server)
    server.clock.turn(days=DAYS, seconds=seconds)
    assert tidy(server.state, DAYS) == expected * [submission]
    assert files(server) == 1 - expected
    assert tidy(server.state, DAYS) == []


def test_what_is_published_stays_and_what_is_withdrawn_does_not(server: Serving) -> None:
    published, withdrawn = sent(server), sent(server)
    publish(server, OWNER, published)
    publish(server, OWNER, withdrawn)
    publish(server, OWNER, withdrawn, withdrawn=True)
    server.clock.turn(days=DAYS)
    assert tidy(server.state, DAYS) == [withdrawn]
    assert server.ask(OWNER, "GET", f"/submissions/{published}/file").status_code == 200


def test_what_is_published_meanwhile_stays(server: Serving) -> None:
    first, second, third = (sent(server) for _ in range(3))

    def publish_second(transaction: Transaction) -> None:
        transaction.session.get_one(Submission, second).published_at = transaction.now

    server.clock.turn(days=DAYS)
    server.state.transactions.begins = publish_second
    assert sorted(tidy(server.state, DAYS)) == sorted([first, third])
    assert files(server) == 1
    assert server.ask(OWNER, "GET", f"/submissions/{second}/file").status_code == 200


def test_the_oldest_files_are_deleted_first(server: Serving) -> None:
    names = []
    for _ in range(5):
        names.append(sent(server))
        server.clock.turn(seconds=1)
    server.clock.turn(days=DAYS)
    with server.state.database.reading() as session:
        digests = {row.id: row.sha256 for row in session.scalars(select(Submission))}
    assert sorted(names, key=digests.__getitem__) != names  # no accident
    assert tidy(server.state, DAYS) == names


def test_a_file_of_two_teams_stays_until_both_need_it_no_more(server: Serving) -> None:
    content = server.distinct()
    first = sent(server, OWNER, content)
    server.clock.turn(days=1)
    second = sent(server, OTHER, content)
    server.clock.turn(days=DAYS - 1)
    assert tidy(server.state, DAYS) == []
    server.clock.turn(days=1)
    assert tidy(server.state, DAYS) == [first, second]


def test_the_same_file_is_stored_again_for_another_team(server: Serving) -> None:
    content = server.distinct()
    sent(server, OWNER, content)
    server.clock.turn(days=DAYS)
    tidy(server.state, DAYS)
    again = sent(server, OTHER, content)
    assert server.ask(OTHER, "GET", f"/submissions/{again}/file").content == content
    assert faults(server) == []
    server.clock.turn(days=DAYS)
    assert tidy(server.state, DAYS) == [again]


def test_a_file_that_is_deleted_while_the_same_arrives_is_not_lost(server: Serving) -> None:
    content, uploads = server.distinct(), server.state.uploads
    digest = server.upload(OWNER, content).json()["submission"]["sha256"]
    with uploads.staged(digest, pack(content)) as keep:
        uploads.delete(digest)
        keep()
    assert uploads.get(digest) == content


def faults(server: Serving) -> list[str]:
    found = examine(server.state.settings.folder)
    return [finding.what for finding in found if finding.kind == "fault"]


def test_everything_knows_that_the_file_is_gone(
    server: Serving, tmp_path: Path, open_server: OpenServer
) -> None:
    submission = server.upload(OWNER).json()["submission"]
    path = f"/submissions/{submission['id']}"
    server.clock.turn(days=DAYS)
    tidy(server.state, DAYS)
    seen = server.ask(OWNER, "GET", path).json()
    assert seen["upload_deleted_at"] == "2026-04-01T12:00:00Z"
    assert (seen["receipt"], seen["report"]) == (submission["receipt"], submission["report"])
    for part in ("file", "episodes"):
        reply = server.ask(OWNER, "GET", f"{path}/{part}")
        assert (reply.status_code, "deleted on 2026-04-01" in reply.json()["detail"]) == (404, True)
    page = signed_in(server, OWNER).get(path)
    assert "The submitted file was deleted 2026-04-01 12:00 UTC" in said(page)
    assert f"{path}/file" not in page.text
    privacy = said(server.client.get("/guide/privacy"))
    assert "30 days, unless the submission is published" in privacy
    assert "For private splits (test)" in privacy
    publish(server, OWNER, submission["id"])  # without intervals, which need the file
    last = server.ask(ORGANISER, "GET", "/organiser/audit").json()[-2]
    assert (last["actor"], last["action"], last["subject"]) == (
        "server",
        "upload deleted",
        submission["id"],
    )
    assert faults(server) == []
    settings = server.state.settings
    assert write_backup(settings.folder, tmp_path / "backup").manifest.lacking == ()
    replace_answers(settings.folder, OPEN)
    corrected = open_server(settings, server.tokens)
    board = corrected.state.board(OPEN)
    with corrected.state.database.reading() as session:
        (job,) = outdated(session, board)
    told = "its upload was deleted on 2026-04-01 (keep_uploads_days)"
    assert corrected.state.scoring.run(rescore_one, board.split, "", job) == told


def test_without_a_number_of_days_nothing_is_deleted(
    server: Serving, open_server: OpenServer
) -> None:
    for days, expected in ((DAYS, ["tidying"]), (None, [])):
        settings = server.state.settings.model_copy(update={"keep_uploads_days": days})
        state = open_server(settings, server.tokens).state
        assert [job.name for job in jobs(state)] == expected


@pytest.mark.server
def test_a_running_server_deletes_by_itself(server: Serving) -> None:
    sent(server)
    with running(server.state.settings.folder):
        # Killed between deleting a file and recording that, it would record it the next time.
        wait_until(lambda: files(server) == 0 and faults(server) == [])
