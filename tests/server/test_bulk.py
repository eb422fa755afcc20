"""All submissions to a split as one archive: complete, in bounded memory, or with an error."""

import csv
import hashlib
import io
import stat
import tarfile
import tracemalloc
from pathlib import Path

import httpx
import pytest

from reverie_eval.reporting.service import METHOD_COSTS
from reverie_eval.schemas.service import Phase
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.intake.bulk import Archive, archive_of
from reverie_eval.server.state import Reading
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.uploads import UploadsError
from tests.support.flat_world import Run
from tests.support.serving import (
    GOOD,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    running,
    settings_of,
    submission_for,
)
from tests.support.waiting import PATIENCE

PATH = f"/organiser/splits/{OPEN}/submissions.tar"


def sent(server: Serving, who: str, content: bytes = GOOD, split: str = OPEN, **said: str) -> str:
    server.clock.turn(seconds=1)
    return str(server.upload(who, content, split, **said).json()["submission"]["id"])


def members(content: bytes) -> dict[str, bytes]:
    with tarfile.open(fileobj=io.BytesIO(content), mode="r:") as archive:
        found = {}
        for member in archive:
            file = archive.extractfile(member)
            assert file is not None
            found[member.name] = file.read()
        return found


def archive(server: Serving) -> Archive:
    state = server.state
    with state.database.reading() as session:
        view = View.of(Reading(state, session, server.clock()))
        return archive_of(session, state.boards[OPEN], state.uploads, view)


def metadata(files: dict[str, bytes]) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(files["metadata.csv"].decode())))


def test_every_file_is_there_as_it_was_sent(server: Serving) -> None:
    contents = {}
    for who, spaces in ((OWNER, b""), (OTHER, b""), (OWNER, b" ")):
        contents[sent(server, who, GOOD + spaces, name="=1+1")] = GOOD + spaces
    reply = server.ask(ORGANISER, "GET", PATH)
    assert len(reply.content) == int(reply.headers["content-length"])
    files = members(reply.content)
    assert next(iter(files)) == "metadata.csv"
    assert files == {
        "metadata.csv": files["metadata.csv"],
        **{f"{name}.json": content for name, content in contents.items()},
    }
    rows = metadata(files)
    assert [row["id"] for row in rows] == list(contents)
    shown = {each["id"]: each for each in server.ask(ORGANISER, "GET", "/submissions").json()}
    for row in rows:
        known = shown[row["id"]]
        assert row["sha256"] == hashlib.sha256(files[row["file"]]).hexdigest()
        assert (row["team"], row["person"]) == (known["team"], known["person"])
        assert row["received_at"] == known["received_at"]
        assert row["name"] == "'=1+1"
        scores = {key: float(row[key]) for key in known["report"]["scores"]}
        assert scores == known["report"]["scores"]


def test_an_empty_split_is_an_archive_of_its_headings(server: Serving) -> None:
    files = members(server.ask(ORGANISER, "GET", PATH).content)
    assert list(files) == ["metadata.csv"]
    assert metadata(files) == []
    assert server.ask(ORGANISER, "GET", PATH.replace(OPEN, "none")).status_code == 404


def test_scores_that_are_held_back_are_left_out(folder: Path, open_server: OpenServer) -> None:
    settings = settings_of(folder)
    phases = (Phase(name="test", opens=None, closes="2026-06-01T00:00:00Z"),)
    server = open_server(adjusted(settings, PRIVATE, phases=phases, release_scores="phase-end"))
    sent(server, OWNER, submission_for(PRIVATE), PRIVATE)
    (row,) = metadata(members(server.ask(ORGANISER, "GET", PATH.replace(OPEN, PRIVATE)).content))
    assert row["success"] == ""


def test_the_command_writes_the_same(server: Serving, folder: Path, run: Run) -> None:
    sent(server, OWNER)
    file = folder.parent / "all.tar"
    outcome = run("server", "export", "submissions", str(folder), OPEN, "-o", str(file))
    assert outcome.status == 0, outcome.err
    assert "1 submission" in outcome.out
    assert file.read_bytes() == server.ask(ORGANISER, "GET", PATH).content
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_a_damaged_upload_is_named_and_no_file_is_written(
    server: Serving, folder: Path, run: Run
) -> None:
    sent(server, OWNER, GOOD + b" ")
    sha256 = hashlib.sha256(GOOD + b" ").hexdigest()
    server.state.uploads.put(sha256, b"")
    (folder / "uploads" / sha256[:2] / f"{sha256}.json.gz").unlink()
    server.state.uploads.put(sha256, GOOD + b"\n")
    file = folder.parent / "all.tar"
    outcome = run("server", "export", "submissions", str(folder), OPEN, "-o", str(file))
    assert outcome.status == 2
    assert f"the upload {sha256} is not the file that was uploaded" in outcome.err
    assert list(folder.parent.glob("*.tar*")) == []


def test_an_interrupted_download_is_an_error(folder: Path, open_server: OpenServer) -> None:
    server = open_server(settings_of(folder))
    for spaces in range(2):
        sent(server, OWNER, GOOD + b" " * spaces)
    sha256 = hashlib.sha256(GOOD + b" ").hexdigest()
    (folder / "uploads" / sha256[:2] / f"{sha256}.json.gz").unlink()
    with running(folder) as (_, url), pytest.raises(httpx.RemoteProtocolError):
        httpx.get(
            f"{url}/api/v1{PATH}",
            headers={"Authorization": f"Bearer {server.tokens[ORGANISER]}"},
            timeout=PATIENCE,
        )


def test_memory_does_not_grow_with_the_number_of_files(server: Serving) -> None:
    def peak() -> int:
        tracemalloc.start()
        made = archive(server)
        assert sum(map(len, made.pieces())) == made.length
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    large = GOOD + b" " * 2_000_000
    for spaces in range(2):
        sent(server, OWNER, large + b" " * spaces)
    peak()  # what is imported and kept
    few = peak()
    for spaces in range(2, 12):
        sent(server, OWNER, large + b" " * spaces)
    assert peak() < few + 1_000_000


def test_a_missing_upload_ends_the_archive(server: Serving, folder: Path) -> None:
    sent(server, OWNER)
    next((folder / "uploads").rglob("*.gz")).unlink()
    digest = hashlib.sha256(GOOD).hexdigest()
    with pytest.raises(UploadsError) as missing:
        list(archive(server).pieces())
    assert str(missing.value) == (
        f"the upload {digest} is missing; run `reverie-eval server doctor`"
    )


def test_files_that_were_deleted_for_their_age_are_left_out(server: Serving) -> None:
    paper = "https://example.org/paper"
    deleted, kept = sent(server, OWNER), sent(server, OWNER, GOOD + b" ", paper=paper)
    server.state.uploads.delete(hashlib.sha256(GOOD).hexdigest())
    with server.state.database.writing() as session:
        session.get_one(Submission, deleted).upload_deleted_at = server.clock()
    made = archive(server)
    content = b"".join(made.pieces())
    assert (len(content), made.files) == (made.length, 2)
    files = members(content)
    rows = [(row["file"], row["paper"]) for row in metadata(files)]
    assert rows == [("", ""), (f"{kept}.json", paper)]
    assert list(files) == ["metadata.csv", f"{kept}.json"]


COLUMNS = [
    *("file", "sha256", "size", "id", "team", "person", "received_at", "status", "published_at"),
    *("withdrawn_at", "name", "description", "paper", "code", "extra_data", "pre_exploration"),
    *("ground_truth_objects", "ensemble", "navigation_only", "human", "input_class"),
    *("sample_size", *METHOD_COSTS, "signature"),
]


def test_what_the_archive_says_of_each_submission(server: Serving) -> None:
    first = sent(server, OWNER, name="Ünt {漢}", description="walks, a lot", extra_data="true")
    path = f"/submissions/{first}"
    server.ask(OWNER, "PATCH", path, json={"published": True})
    server.clock.turn(hours=1)
    server.ask(OWNER, "PATCH", path, json={"withdrawn": True})
    others = sorted(
        server.upload(OTHER, GOOD + b" " * (size + 1)).json()["submission"]["id"]
        for size in range(4)
    )
    board = server.state.boards[OPEN]
    made = archive(server)
    content = b"".join(made.pieces())
    assert (made.length, made.files) == (len(content), 5)
    assert made.metadata.closed
    with tarfile.open(fileobj=io.BytesIO(content), mode="r:") as tar:
        assert {member.mode for member in tar} == {0o600}
    text = members(content)["metadata.csv"].decode()
    heading, row, *rest = csv.reader(io.StringIO(text))
    assert heading == [*COLUMNS, *board.task.metrics]
    assert [each[3] for each in rest] == others
    digest = hashlib.sha256(GOOD).hexdigest()
    times = "2026-03-02T12:00:01Z", "withdrawn", "2026-03-02T12:00:01Z", "2026-03-02T13:00:01Z"
    assert row[: len(COLUMNS)] == [
        *(f"{first}.json", digest, str(len(GOOD)), first, "Blue", OWNER, *times),
        *("Ünt {漢}", "walks, a lot", "", "", "true", *12 * [""], board.signature),
    ]
    assert "\r" not in text


def test_an_upload_of_another_length_is_cut_and_named(server: Serving, folder: Path) -> None:
    sent(server, OWNER)
    digest = hashlib.sha256(GOOD).hexdigest()
    (folder / "uploads" / digest[:2] / f"{digest}.json.gz").unlink()
    server.state.uploads.put(digest, GOOD + b" " * 9)
    made, lengths = archive(server), list[int]()
    with pytest.raises(UploadsError) as damaged:
        lengths.extend(map(len, made.pieces()))
    assert str(damaged.value) == (
        f"the upload {digest} is not the file that was uploaded; run `reverie-eval server doctor`"
    )
    assert sum(lengths) <= made.length
