"""One team sends what takes longest to read, without pause: others hardly notice.

A real server has the limits that it has by default. The team sends from a process and an address
of its own, while another team checks a file and a visitor reads the leaderboard. How long that
takes is measured and reported; the suite only asserts that all are served.
"""

import asyncio
import os
import statistics
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from reverie_eval.server.opening import acting
from reverie_eval.server.run import run_server
from reverie_eval.server.settings import SETTINGS_FILE, load_settings
from tests.support.amounts import amount, is_evidence, tell
from tests.support.crowd import Reply, ask, connect, large, peak_megabytes
from tests.support.forking import Forked, Surroundings
from tests.support.hostile import FILES, Sender, dripping, sending
from tests.support.killing import scorers
from tests.support.serving import OPEN, populate
from tests.support.waiting import wait_until

CHECKS_IN_SUITE = 2
PART_IN_SUITE = 500
"""The suite sends files that have one in so many of the pieces."""
SLOW, SLOW_IN_SUITE = 200, 20
"""Connections of one team that send a byte a second."""
ROUND, ROUND_IN_SUITE = 0.15, 0.0
"""Seconds from one check to the next, at least."""
BEAT = 0.01
"""Seconds that the event loop is asked to wait, again and again, to see how long it really does."""
SCENES = len(FILES) + 3
"""In each, everybody has a token and an address that have not been limited before."""

TEAMS = ("hostile", "other")
CHECK = f"/api/v1/splits/{OPEN}/validate"
PAGE = f"/splits/{OPEN}"

SETTINGS = f"""
[splits.{OPEN}]
bundle = "{{bundle}}"
visibility = "private"
"""


class Figures(NamedTuple):
    """What others notice during a scene."""

    checks: Sequence[Reply]
    pages: Sequence[Reply]
    stall: float
    """Seconds: the longest that the event loop did nothing else."""
    megabytes: float
    """The peak of all processes of the server, so far."""


class Scene(NamedTuple):
    """A server, who measures, and who means harm."""

    url: str
    process: int
    folder: Path
    tokens: Mapping[str, str]
    content: bytes

    def hostile(self, number: int) -> Sender:
        """Return who sends hostile files in a scene."""
        return Sender(self.url, CHECK, self.tokens[f"hostile {number}"], f"127.0.1.{number + 1}")

    def watch(self, number: int) -> Figures:
        """Check a file and read a page again and again."""
        checker = connect(self.url, f"127.0.2.{number + 1}")
        visitor = connect(self.url, f"127.0.3.{number + 1}")
        pace = ROUND if is_evidence() else ROUND_IN_SUITE
        token = self.tokens[f"other {number}"]
        began = time.monotonic()
        checks, pages = [], []
        for _ in range(amount(CHECKS_IN_SUITE)):
            until = time.monotonic() + pace
            checks.append(ask(checker, "POST", CHECK, self.content, token))
            pages.append(ask(visitor, "GET", PAGE))
            time.sleep(max(0, until - time.monotonic()))
        checker.close()
        visitor.close()
        lines = (line.split() for line in beats(self.folder).read_text().splitlines())
        stall = max((float(late) for at, late in lines if float(at) >= began), default=0.0)
        processes = [self.process, *scorers(self.folder / "log")]
        return Figures(checks, pages, stall, sum(map(peak_megabytes, processes)))


def beats(folder: Path) -> Path:
    """Return the file with how late the event loop was, and when."""
    return folder / "beats"


@pytest.fixture
def scene(folder: Path, request: pytest.FixtureRequest) -> Iterator[Scene]:
    """Run a server, with the published ground truth if it is there."""
    bundle, content = large(request)
    (folder / SETTINGS_FILE).write_text(SETTINGS.format(bundle=bundle))
    (folder / bundle).chmod(0o600)
    with acting(load_settings(folder), "test") as transaction:
        people = {f"{team} {number}": team for team in TEAMS for number in range(SCENES)}
        tokens = populate(transaction, people)
    announced, log = folder / "url", folder / "log"
    surroundings = Surroundings(Path.cwd(), dict(os.environ), log, log)
    with Forked(_serve, surroundings, folder, announced) as process:
        try:
            wait_until(lambda: announced.exists() or process.poll() is not None)
            url = announced.read_text()
            yield Scene(url, process.pid, folder, tokens, content)
        finally:
            process.kill()


def _serve(folder: Path, announced: Path) -> None:
    beating = []

    def announce(url: str) -> None:
        beating.append(asyncio.ensure_future(_beat(beats(folder))))
        part = announced.with_suffix(".part")
        part.write_text(url)
        part.rename(announced)

    run_server(load_settings(folder), "127.0.0.1", 0, announce)


async def _beat(file: Path) -> None:
    with file.open("w", 1) as lines:
        while True:
            began = time.monotonic()
            await asyncio.sleep(BEAT)
            late = time.monotonic() - began - BEAT
            print(began, late, file=lines)


@pytest.mark.slow
def test_others_are_served_while_a_team_sends_what_takes_longest(scene: Scene) -> None:
    scene.watch(0)  # the first ones take longer
    calm = scene.watch(1)
    report("nothing else", calm, calm, Counter())
    for number, (name, (make, pieces)) in enumerate(FILES.items(), 2):
        content = make(pieces if is_evidence() else pieces // PART_IN_SUITE)
        with sending(scene.hostile(number), content) as statuses:
            figures = scene.watch(number)
        assert set(statuses) <= {200, 422, 429, 503}, name
        assert_served(figures)
        report(f"{name}, {len(content) >> 10} KiB", figures, calm, statuses)
    slow = SLOW if is_evidence() else SLOW_IN_SUITE
    with dripping(scene.hostile(SCENES - 1), slow) as statuses:
        figures = scene.watch(SCENES - 1)
    assert set(statuses) <= {408, 429, 503}
    assert_served(figures)
    report(f"{slow} connections at a byte a second", figures, calm, statuses)


def assert_served(figures: Figures) -> None:
    """Check that another team and a visitor got what they asked for."""
    assert {reply.status for reply in figures.checks} == {200}
    assert {reply.status for reply in figures.pages} == {200}


def report(name: str, figures: Figures, calm: Figures, statuses: Counter[int]) -> None:
    """Report what others noticed; at most 3 and 2 times the calm medians and 100 ms are wanted."""
    check, page = map(median, (figures.checks, figures.pages))
    times = check / median(calm.checks), page / median(calm.pages)
    longest = max(reply.seconds for reply in figures.checks)
    tell(
        **{
            f"while a team sends {name}": f"check {1000 * check:.0f} ms ({times[0]:.1f} times; "
            f"longest {1000 * longest:.0f} ms), leaderboard {1000 * page:.0f} ms "
            f"({times[1]:.1f} times), longest stall {1000 * figures.stall:.0f} ms, "
            f"{figures.megabytes:.0f} MB; replies to it {dict(statuses)}"
        }
    )


def median(replies: Sequence[Reply]) -> float:
    """Return the median time of replies."""
    return statistics.median(reply.seconds for reply in replies)
