"""Traces of uploads: what they hold of each episode, and when they are made again."""

import json
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select, update
from sqlalchemy.orm import Session

from reverie_eval import evaluate
from reverie_eval.server.integrity.traces import Trace, Traces, Walks
from reverie_eval.server.scoring.boards import Board, load_board
from reverie_eval.server.settings import Split
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.tables import Trace as Row
from tests.conftest import SAMPLES
from tests.support.flat_world import TUB, WALKS, write_submission
from tests.support.serving import BROKEN, GOOD, OPEN, OTHER, OWNER, PRIVATE, Serving
from tests.support.worlds import SPLIT

DRAWN = (SAMPLES / "drawn.json").read_bytes()
MULTIPLIER, MASK = 0x9E3779B97F4A7C15, 2**64 - 1
"""What the numbers of paths, and of answers and stops, are mixed with; they are 64 bits long."""
TWO_JUMPS = (["door", "bath", "door"], TUB)
"""28 m in two jumps, in place of the walk that does not move."""


@pytest.fixture
def flat_board(here: Path) -> Board:
    """Return an open leaderboard of the flat's split."""
    (here / "full.npz").chmod(0o600)
    split = Split(bundle=Path("full.npz"), visibility="open")
    return load_board(SPLIT, split, here / "full.npz")


def walking(folder: Path, answers: Sequence[object]) -> bytes:
    """Return a submission of the flat's walks with these answers."""
    walks = [*WALKS[:3], TWO_JUMPS, WALKS[4]]
    told = [
        ([[place, 0, 0] for place in walk], answer)
        for (walk, _), answer in zip(walks, answers, strict=True)
    ]
    write_submission(folder / "told.json", told)  # type: ignore[arg-type]  # also texts
    return (folder / "told.json").read_bytes()


def test_what_a_fingerprint_has_of_each_episode(flat_board: Board, here: Path) -> None:
    found = Trace.of(flat_board, walking(here, [TUB, "6", "05", -1, -1]))
    door, hall, bath = map(flat_board.truth.graph.viewpoint_ids.index, _PLACES)
    episodes = found.episodes
    assert episodes["answer"].tolist() == [5, 6, 5, -1, -1]
    assert episodes["is_text"].tolist() == [False, True, True, False, False]
    assert episodes["has_leading_zeros"].tolist() == [False, False, True, False, False]
    assert episodes["is_box"].tolist() == 5 * [False]
    assert episodes["stop"].tolist() == [bath, hall, bath, door, bath]
    by_name = {"door": door, "hall": hall, "bath": bath}
    walks = [*WALKS[:3], TWO_JUMPS, WALKS[4]]
    assert episodes["path"].tolist() == [
        path_code([by_name[place] for place in walk]) for walk, _ in walks
    ]
    assert found.codes.tolist() == [
        answer_code(answer, stop)
        for answer, stop in zip(episodes["answer"].tolist(), episodes["stop"].tolist(), strict=True)
    ]
    assert found.codes.dtype == np.uint32
    assert found.walks == Walks(
        jumps=4,
        episodes_with_jumps=3,
        longest_jump=14.0,
        mean_viewpoints=14 / 5,
        most_viewpoints=3,
        longest_walk=46.0,
    )
    again = Trace.from_bytes(found.to_bytes())
    assert again.walks == found.walks
    assert np.array_equal(again.episodes, episodes)


_PLACES = ("door", "hall", "bath")


def path_code(viewpoints: list[int]) -> int:
    """Mix a trajectory's viewpoints with their places, in numbers of any length."""
    total = 0
    for step, viewpoint in enumerate(viewpoints):
        mixed = (viewpoint + 1) * MULTIPLIER & MASK
        mixed = (mixed ^ mixed >> 29) * (2 * step + 3) & MASK
        total += mixed * MULTIPLIER
    return (total & MASK) >> 32


def answer_code(answer: int, stop: int) -> int:
    mixed = (answer & MASK) * MULTIPLIER & MASK
    return ((mixed ^ stop) * MULTIPLIER & MASK) >> 32


def test_fingerprints_are_equal_in_some_fields(flat_board: Board, here: Path) -> None:
    one, other = (
        Trace.of(flat_board, walking(here, answers))
        for answers in ([5, 5, 5, 5, 5], [5, "5", 6, 6, -1])
    )
    assert one.equal(other, "stop") == one.equal(other, "stop", "path") == 1
    assert one.equal(other, "answer") == one.equal(other, "stop", "answer") == 2 / 5
    assert one.equal(other, "answer", "is_text") == 1 / 5
    assert (one.codes == other.codes).tolist() == [True, True, False, False, False]


def test_fingerprints_score_as_their_files_where_they_can(server: Serving) -> None:
    board = server.state.boards[OPEN]
    grounding = load_board(
        OPEN,
        board.settings.model_copy(update={"track": "grounding"}),
        server.state.settings.path(board.settings.bundle),
    )
    found = Trace.of(grounding, GOOD).values(grounding, "rgs")
    expected = evaluate(GOOD, split=OPEN, ground_truth=board.truth, track="grounding")
    assert found is not None
    assert found.tolist() == expected.episodes["rgs"].tolist()
    records = json.loads(GOOD)
    for record in records:
        del record["predObjId"]
    silent = Trace.of(board, json.dumps(records).encode())
    assert silent.values(board, "rgs") is None
    success = silent.values(board, "success")
    assert success is not None
    assert success.tolist() == evaluate(GOOD, split=OPEN).episodes["success"].tolist()
    drawn = Trace.of(board, DRAWN).episodes
    boxes = ["predBox" in record for record in json.loads(DRAWN)]
    assert drawn["is_box"].sum() == sum(boxes)
    assert set(drawn["answer"][~drawn["is_box"]].tolist()) < set(range(-1, 10_000))


def test_missing_fingerprints_are_computed_and_stored(server: Serving) -> None:
    state, board = server.state, server.state.boards[OPEN]
    service = Traces(board, state.database, state.scoring)
    episodes = len(board.truth.episodes.instr_ids)
    assert service.basis == f"full:{board.public_fingerprint}:{episodes}"
    good, drawn = (
        server.upload(OWNER, content).json()["submission"]["sha256"] for content in (GOOD, DRAWN)
    )
    asked = [drawn, good, drawn]
    submissions = select(Submission.sha256).order_by(Submission.size.desc())

    def missing(session: Session | None = None, service: Traces = service) -> list[str]:
        with nullcontext(session) if session else state.database.reading() as read:
            marked = service.marked(read, submissions)
            return [sha256 for (sha256,), is_known in marked if not is_known]

    assert missing() == [drawn, good]
    for sha256, left in ((good, [drawn]), (drawn, [])):
        read = service.read([sha256, "0" * 64], 1)
        assert ([*read.contents], read.unreadable) == ([sha256], {})
        service.store(read.contents)
        assert missing() == left
    with state.database.reading() as session:
        loaded = service.load(session, asked)
        stored = session.get_one(Row, (OPEN, good))
        assert (stored.split, stored.sha256, stored.basis) == (OPEN, good, service.basis)
    for sha256, content in ((drawn, DRAWN), (good, GOOD)):
        assert np.array_equal(loaded[sha256].episodes, Trace.of(board, content).episodes)
    private = Traces(state.boards[PRIVATE], state.database, state.scoring)
    with state.database.trying() as session:
        session.execute(update(Submission).values(split=PRIVATE))
        assert missing(session) == missing(session, private) == [drawn, good]
    with state.database.writing() as session:
        session.get_one(Row, (OPEN, good)).basis = "another"
        session.add(Row(split=PRIVATE, sha256=good, basis=service.basis, content=b"another's"))
    assert missing() == [good]
    with state.database.reading() as before:
        assert missing(before) == [good]
        contents = service.read([good], 1).contents
        service.store(contents)
        (seen,) = service.load(before, [good], contents).values()
    with state.database.reading() as session:
        (again,) = service.load(session, [good]).values()
    for each in (seen, again):
        assert np.array_equal(each.episodes, Trace.of(board, GOOD).episodes)


def test_submissions_come_with_the_fingerprints_of_their_uploads(server: Serving) -> None:
    state = server.state
    service = Traces(state.boards[OPEN], state.database, state.scoring)
    good, drawn, unread = (
        server.upload(OWNER, content).json()["submission"]["sha256"]
        for content in (GOOD, DRAWN, GOOD + b" ")
    )
    again = server.upload(OTHER, DRAWN).json()["submission"]["sha256"]
    service.store(service.read([good], 1).contents)
    chosen = select(Submission.id, Submission.sha256).order_by(Submission.team_id, Submission.size)
    with state.database.reading() as session:
        read = service.read([drawn], 1).contents
        found = [(sha256, each) for (_, sha256), each in service.of_each(session, chosen, read)]
    assert len(GOOD) < len(DRAWN)
    assert [sha256 for sha256, _ in found] == [good, drawn, again]
    assert unread not in dict(found)


def test_what_has_no_fingerprint_says_why(server: Serving) -> None:
    state, board = server.state, server.state.boards[OPEN]
    service = Traces(board, state.database, state.scoring)
    told = f"the upload {'0' * 64} is missing; run `reverie-eval server doctor`"
    state.uploads.put("1" * 64, BROKEN)
    missing, broken = service.read(["0" * 64, "1" * 64], 2).unreadable.items()
    assert missing == ("0" * 64, told)
    assert broken[1].startswith("rejected: file: episode 1308_18_1 has no prediction; every ")
    with state.database.reading() as session:
        assert session.query(Row).count() == 0
