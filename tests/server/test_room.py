"""What uploads take on the disk: little, and no more in a day than a team may send."""

import gzip
import hashlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import pytest

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.service import Method
from reverie_eval.server.errors import QuotaSpentError
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import Limits, Quota
from tests.support.acting import NOON
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
from tests.support.waiting import PATIENCE

MEBIBYTE = 1 << 20


def kept(server: Serving) -> list[Path]:
    """Return all files of uploads."""
    return [
        path for path in (server.state.settings.folder / "uploads").rglob("*") if path.is_file()
    ]


def padded(mebibytes: float) -> bytes:
    """Return a sound submission of a size."""
    return GOOD + b" " * (int(mebibytes * MEBIBYTE) - len(GOOD))


def test_what_is_small_on_the_wire_stays_small_on_the_disk(server: Serving) -> None:
    content = padded(32)
    packed = gzip.compress(content)
    reply = server.upload(OWNER, packed).json()["submission"]
    assert sum(path.stat().st_size for path in kept(server)) < 8 * len(packed)
    sha256 = hashlib.sha256(content).hexdigest()
    assert reply["sha256"] == receipt_in(reply["receipt"]).sha256 == sha256
    assert server.ask(OWNER, "GET", f"/submissions/{reply['id']}/file").content == content


@pytest.fixture
def frugal(folder: Path, open_server: OpenServer) -> Serving:
    """Return a server that takes ten MiB from each team in a day."""
    limits = Limits(requests_per_minute=1_000_000, mebibytes_per_day=10)
    return open_server(settings_of(folder).model_copy(update={"limits": limits}))


def test_a_team_sends_no_more_bytes_in_a_day_than_it_may(frugal: Serving) -> None:
    first = padded(6)
    assert frugal.upload(OWNER, first).status_code == 201
    frugal.clock.turn(hours=1)
    assert frugal.upload(OWNER, padded(4)).status_code == 201, "just as much as it may"
    frugal.clock.turn(hours=1)
    refused = frugal.upload(OWNER, GOOD)
    assert (refused.status_code, refused.json()["code"]) == (429, "bytes-spent")
    assert refused.headers["retry-after"] == str(22 * 60 * 60)
    assert "may send 10 MiB of submissions in 24 hours" in refused.json()["detail"]
    assert refused.json()["quota"]["remaining"] > 0
    assert frugal.upload(OWNER, first).json()["is_repeat"] is True
    assert frugal.ask(OWNER, "POST", f"/splits/{OPEN}/validate", content=GOOD).status_code == 200
    assert frugal.upload(OTHER, GOOD).status_code == 201
    frugal.clock.turn(hours=22)
    assert frugal.upload(OWNER, GOOD).status_code == 201


def test_what_is_larger_than_a_day_never_fits(frugal: Serving) -> None:
    refused = frugal.upload(OWNER, padded(11))
    assert (refused.status_code, refused.json()["code"]) == (429, "bytes-spent")
    assert "retry-after" not in refused.headers


def both(server: Serving, split: str, *contents: bytes) -> list[str]:
    """Submit files that are all scored before any of them is kept; return what became of them."""
    person = server.person(OWNER)

    def submit(content: bytes) -> str:
        try:
            server.state.get(Intake).submit(
                person, split, content, Method(name="Walker"), None, arrived=NOON
            )
        except ReverieEvalError as error:
            return type(error).__name__
        return "kept"

    with ThreadPoolExecutor(len(contents)) as pool:
        return sorted(pool.map(submit, contents))


@pytest.fixture
def together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let two submissions wait for each other before they are scored."""
    barrier, score = Barrier(2), Board.score

    def score_together(*given: Any) -> Any:
        barrier.wait(PATIENCE)
        return score(*given)

    monkeypatch.setattr(Board, "score", score_together)


@pytest.mark.usefixtures("together")
def test_a_lost_race_for_the_quota_leaves_no_file(folder: Path, open_server: OpenServer) -> None:
    quota = Quota(day=1)
    server = open_server(adjusted(settings_of(folder), quota=quota))
    content = submission_for(PRIVATE)
    became = both(server, PRIVATE, content, content + b" ")
    assert became == [QuotaSpentError.__name__, "kept"]
    assert len(kept(server)) == 1


@pytest.mark.usefixtures("together")
def test_a_lost_race_for_the_bytes_leaves_no_file(frugal: Serving) -> None:
    assert both(frugal, OPEN, padded(6), padded(6) + b" ") == ["BytesSpentError", "kept"]
    assert len(kept(frugal)) == 1


@pytest.mark.usefixtures("together")
def test_a_file_that_came_twice_at_once_is_kept(server: Serving) -> None:
    assert both(server, OPEN, GOOD, GOOD) == ["kept", "kept"]
    assert len(kept(server)) == 1
