"""A year of a leaderboard: what participants do, what an organiser does, and who checks it all.

The organiser acts by commands, or at the desk in a browser; everything else is the same. The clock
is moved by the test, for the server, which listens in this process, as for the commands.
"""

import base64
import json
import re
import shutil
import threading
import typing
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import time_machine
import uvicorn
from cryptography.hazmat.primitives.serialization import load_pem_public_key

from fixtures.published import published_folder
from reverie_eval.ground_truth import Bundle
from reverie_eval.server.app import create_app
from reverie_eval.server.http.runtime import MOST_JOINING
from reverie_eval.server.opening import open_server
from reverie_eval.server.run import configuration, listen, url_of
from reverie_eval.server.settings import load_settings
from tests.support.plain_sql import Stored, stored
from tests.support.processes import TOKEN, Laptop
from tests.support.serving import NO_TLS, PRIVATE, broken_private, submission_for
from tests.support.signing import payload_in
from tests.support.waiting import PATIENCE, wait_until
from tests.support.worlds import with_arrays

TEAMS = [f"Team {number:02}" for number in range(1, 31)]
QUOTA = {"day": (1, 2), "month": (30, 10), "year": (365, 40)}
"""Days of each window, and submissions to a private split in it, as in a new settings file."""
SUBMISSIONS = 44
"""That are scored: one of each team, and more of some."""
CHALLENGE = "challenge 2027"
CORRECTION = "The targets of 10 items were corrected."
LEGACY = "https://eval.ai/web/challenges/challenge-page/606"
HISTORY = """team,nav_success,nav_spl,nav_length,rgspl,date
Walker,59.64,38.98,24.66,21.48,01/2026
Follower,41.2,30.5,18,12.9,2021
Walker,59.64,38.98,24.66,21.48,01/2026
"""


def at(month: int, day: int, hour: int = 12) -> datetime:
    """Return a time of the year."""
    return datetime(2027, month, day, hour, tzinfo=UTC)


@dataclass(frozen=True)
class Acknowledged:
    """A result that a team was told of."""

    id: str
    team: str
    received: datetime
    receipt: Mapping[str, Any]


class Organiser(typing.Protocol):
    """What an organiser does while the server runs; each counts what that takes."""

    steps: Counter[str]
    """Commands, or clicks, for each task."""

    def import_history(self, file: Path, source: str, told: str) -> None:
        """Add the results of an earlier leaderboard, and read how many were added."""

    def accept_requests(self) -> Mapping[str, str]:
        """Accept all requests to join; return the invitation of each team's person."""

    def open_phase(self, name: str, opens: datetime, closes: datetime | None) -> None:
        """Accept submissions to the private split in a period."""

    def close_phases(self) -> None:
        """Accept no submissions to the private split from now on."""

    def grant(self, team: str, number: int, reason: str) -> None:
        """Grant a team extra submissions."""

    def disqualify(self, submission_id: str, reason: str) -> None:
        """Disqualify a submission."""

    def correct(self, bundle: Path, reason: str) -> None:
        """Score everything again with another ground truth; ends with a restart."""

    def delete_person(self, team: str, name: str) -> None:
        """Delete a person's name and address."""


@dataclass
class Year:
    """The server's folder, who is there, and what they were told."""

    laptop: Laptop
    time: time_machine.Traveller
    url: str = ""
    organiser_token: str = ""
    tokens: dict[str, str] = field(default_factory=dict)
    """The token of each team's person."""
    acknowledged: list[Acknowledged] = field(default_factory=list)
    refused: Counter[int] = field(default_factory=Counter)
    """Uploads that were refused, by status."""
    _serial: int = 0
    _running: tuple[uvicorn.Server, threading.Thread] | None = None

    @property
    def folder(self) -> Path:
        """The server's folder."""
        return self.laptop.folder / "lab"

    def move_to(self, instant: datetime) -> None:
        """Let time pass."""
        self.time.move_to(instant)

    def start(self) -> None:
        """Start the server, in this process."""
        state = open_server(load_settings(self.folder))
        listening = listen("127.0.0.1", 0)
        self.url = url_of(listening)
        app = create_app(state, self.url)
        server = uvicorn.Server(configuration(app))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
        thread.start()
        self._running = server, thread
        wait_until(lambda: server.started)

    def stop(self) -> None:
        """Stop it as a signal does."""
        if self._running:
            server, thread = self._running
            server.should_exit = True
            thread.join(PATIENCE)
            self._running = None

    def restart(self) -> None:
        """Stop and start it."""
        self.stop()
        self.start()

    def ask(self, method: str, path: str, token: str = "", **content: Any) -> httpx.Response:
        """Send a request."""
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        reply = httpx.request(
            method,
            f"{self.url}/api/v1{path}",
            headers=headers,
            timeout=PATIENCE,
            verify=NO_TLS,
            **content,
        )
        assert reply.status_code < 500, reply.text
        return reply

    def new_file(self) -> bytes:
        """Return a submission that nobody has sent, better than the one before."""
        self._serial += 1
        best, lost = (json.loads(submission_for(PRIVATE, name)) for name in ("shortest", "random"))
        return json.dumps([*best[: self._serial], *lost[self._serial :]]).encode()

    def upload(self, team: str, content: bytes, status: int = 201) -> str:
        """Upload for a team and publish; return the submission's id, or nothing if refused."""
        token = self.tokens[team]
        path = f"/splits/{PRIVATE}/submissions?name=Walker"
        reply = self.ask("POST", path, token, content=content)
        assert reply.status_code == status, reply.text
        if status >= 400:
            self.refused[status] += 1
            return ""
        submission = reply.json()["submission"]
        self.acknowledge(submission)
        self.ask("PATCH", f"/submissions/{submission['id']}", token, json={"published": True})
        return str(submission["id"])

    def acknowledge(self, submission: Mapping[str, Any]) -> None:
        """Remember what a team was told."""
        received = datetime.fromisoformat(submission["received_at"])
        told = submission["id"], submission["team"], received, submission["receipt"]
        self.acknowledged.append(Acknowledged(*told))

    def board(self, kind: str = "") -> httpx.Response:
        """Read the leaderboard of the private split."""
        return self.ask("GET", f"/splits/{PRIVATE}/leaderboard{kind}")


@contextmanager
def begin_year(folder: Path) -> Iterator[Year]:
    """Make a server on the fourth of January, and stop it at the end."""
    with time_machine.travel(at(1, 4), tick=True) as time:
        year = Year(Laptop(folder), time)
        made = TOKEN.search(year.laptop.run("server", "init", "lab").out)
        assert made is not None
        year.organiser_token = made[0]
        settings = year.folder / "reverie-eval.toml"
        text, n = re.subn(r"#? ?(requests_per_minute = )\d+", r"\g<1>1000000", settings.read_text())
        assert n == 1
        settings.write_text(text)
        year.start()
        try:
            yield year
        finally:
            year.stop()


def live(year: Year, organiser: Organiser) -> None:
    """Live through the year up to its last month."""
    laptop = year.laptop
    organiser.import_history(*history(laptop.folder))

    for number, team in enumerate(TEAMS):
        days = number // MOST_JOINING  # all are sent from one address
        year.move_to(at(1, 11) + timedelta(days=days, minutes=days))
        person = {"name": f"Person {number}", "email": f"person{number}@example.org"}
        said = {"team": team, "people": [person], "institution": "University"}
        for _ in range(1 + number % 2):  # some press the button twice
            assert year.ask("POST", "/join", json=said).status_code == 202
    for team, invitation in organiser.accept_requests().items():
        welcome = year.ask("POST", "/tokens", json={"invitation": invitation}).json()
        year.tokens[team] = welcome["token"]
    assert sorted(year.tokens) == TEAMS

    organiser.close_phases()  # a new server accepts submissions at any time
    organiser.open_phase(CHALLENGE, at(3, 1, 0), at(6, 1, 0))
    year.move_to(at(2, 10))
    year.upload(TEAMS[0], year.new_file(), status=409)
    submit_for_three_months(year, organiser)

    year.move_to(at(6, 2))
    year.upload(TEAMS[1], year.new_file(), status=409)
    organiser.open_phase("after the challenge", at(6, 3, 0), None)
    year.move_to(at(6, 10))
    before = year.ask("GET", f"/splits/{PRIVATE}/snapshots/1").json()
    assert payload_in(before)["title"] == CHALLENGE
    year.upload(TEAMS[2], year.new_file())
    assert year.ask("GET", f"/splits/{PRIVATE}/snapshots/1").json() == before

    year.move_to(at(7, 1))
    laptop.run("server", "key", "rotate", "lab", "--reason", "the yearly change")
    organiser.steps["rotate the key"] += 1
    year.restart()
    for team in TEAMS[:5]:
        year.upload(team, year.new_file())

    year.move_to(at(9, 1))
    organiser.delete_person(TEAMS[3], "Person 3")
    assert year.ask("GET", "/me", year.tokens[TEAMS[3]]).status_code == 401


def history(folder: Path) -> tuple[Path, str, str]:
    """Return an earlier leaderboard, its source, and what is said when it was imported."""
    published = published_folder()
    if published is not None:
        said = "83 rows: 81 added, 0 already there, 2 repeated"
        return published / "legacy_leaderboard.csv", LEGACY, said
    file = folder / "history.csv"
    file.write_text(HISTORY)
    return file, LEGACY, "3 rows: 2 added, 0 already there, 1 repeated"


def submit_for_three_months(year: Year, organiser: Organiser) -> None:
    """Let every team submit: some broken files, some twice, some too many, some by e-mail."""
    ids = {}
    for number, team in enumerate(TEAMS):
        year.move_to(at(3, 2) + timedelta(days=2 * number))
        if number % 3 == 0:
            year.upload(team, broken_private(), status=422)
        content = year.new_file()
        ids[team] = year.upload(team, content)
        if number % 4 == 0:
            assert year.upload(team, content, status=200) == ids[team]  # the same file
        if number % 5 == 0:
            year.upload(team, year.new_file())
            year.upload(team, year.new_file(), status=429)
        if team == TEAMS[10]:
            organiser.grant(team, 2, "The power failed.")
            year.upload(team, year.new_file())
    organiser.disqualify(ids[TEAMS[8]], "It read the answers of another team.")
    year.move_to(at(5, 10))
    submit_by_mail(year)
    corrected = year.laptop.folder / "corrected.npz"
    correct_answers(year.folder / "bundles" / f"{PRIVATE}.npz", corrected)
    year.move_to(at(5, 20))
    organiser.correct(corrected, CORRECTION)
    assert [each["reason"] for each in year.board().json()["corrections"]] == [CORRECTION]


def submit_by_mail(year: Year) -> None:
    """Submit two files, one of them broken, that came some days ago."""
    mail = year.laptop.folder / "mail"
    mail.mkdir()
    (mail / "good.json").write_bytes(year.new_file())
    (mail / "broken.json").write_bytes(broken_private())
    words = ["--split", PRIVATE, "--team", TEAMS[20], "--person", "Person 20", "--publish"]
    received = at(5, 5).isoformat()
    year.laptop.run("server", "submit", "lab", "mail", *words, "--received", received, status=1)
    (theirs,) = year.ask("GET", "/submissions", year.tokens[TEAMS[20]], params={"limit": 1}).json()
    assert theirs["received_at"].startswith("2027-05-05")
    year.acknowledge(theirs)


def correct_answers(path: Path, corrected: Path) -> None:
    """Write a bundle with other targets in ten items."""
    bundle = Bundle.load(path)
    target = bundle.arrays["task_target"].copy()
    target[:10] += 1
    with_arrays(bundle, task_target=target).save(corrected)


# The end of the year, checked by somebody who uses nothing of the server's code.


def hand_over(year: Year) -> Path:
    """Back the server up, restore it elsewhere, and export the site of the backup."""
    laptop, elsewhere = year.laptop, year.laptop.folder / "successor"
    laptop.run("server", "backup", "lab", "-o", "lab.tar.gz")
    elsewhere.mkdir()
    laptop.run("server", "restore", "lab.tar.gz", elsewhere / "lab")
    laptop.run("server", "export", "site", "lab.tar.gz", "-o", "site")
    return elsewhere / "lab"


def check(year: Year, folder: Path) -> None:
    """Check everything that was promised, in the server's folder or that of its successor."""
    found = stored(f"sqlite:///{folder / 'server.db'}")
    assert "fault" not in year.laptop.run("server", "doctor", folder).out
    check_submissions(year, found)
    check_quotas(found)
    check_links(found)
    check_signatures(year, found)


def check_submissions(year: Year, found: Stored) -> None:
    """Check that every acknowledged submission is there once, and nothing else is."""
    kept = Counter(each.id for each in found.submissions)
    assert len(kept) == SUBMISSIONS
    assert set(kept) == {each.id for each in year.acknowledged}
    assert set(kept.values()) == {1}
    assert Counter(each.action for each in found.audit)["submitted"] == len(kept)


def check_quotas(found: Stored) -> None:
    """Check that no team has more submissions in any window than its quota and grants allow."""
    times = defaultdict(list)
    for each in found.submissions:
        received_at = payload_in(each.receipt)["predicate"]["received_at"]
        times[each.team].append(datetime.fromisoformat(received_at))
    for team, received in times.items():
        extra = 2 if team == TEAMS[10] else 0
        for begin in received:
            for days, limit in QUOTA.values():
                n = sum(begin <= one < begin + timedelta(days=days) for one in received)
                assert n <= limit + extra, (team, begin)


def check_links(found: Stored) -> None:
    """Check that each entry of the audit log has the digest of the one before it."""
    digests = ["0" * 64, *(each.digest for each in found.audit)]
    assert [each.previous for each in found.audit] == digests[:-1]


def check_signatures(year: Year, found: Stored) -> None:
    """Check all receipts, also earlier ones, by the published keys."""
    keys = {key["key_id"]: key for key in year.ask("GET", "/keys").json()}
    assert len(keys) == 2
    used = Counter()  # type: ignore[var-annotated]
    receipts = [each.receipt for each in year.acknowledged]
    for receipt in [*receipts, *(each.receipt for each in found.submissions)]:
        (signature,) = receipt["signatures"]
        kind, payload = receipt["payloadType"], base64.b64decode(receipt["payload"])
        signed = f"DSSEv1 {len(kind)} {kind} {len(payload)} ".encode() + payload
        key = load_pem_public_key(keys[signature["keyid"]]["public_key"].encode())
        key.verify(base64.b64decode(signature["sig"]), signed)  # type: ignore[union-attr, call-arg]
        used[signature["keyid"]] += 1
    assert used.keys() == keys.keys()


def check_site(year: Year) -> None:
    """Check that the exported files have the digits of the server, to the byte."""
    site = year.laptop.folder / "site"
    for split in (PRIVATE, "val_unseen"):
        path = f"/splits/{split}/leaderboard"
        exported = site / "api" / "v1" / "splits" / split
        assert (exported / "leaderboard.csv").read_bytes() == year.ask("GET", f"{path}.csv").content
        assert (exported / "leaderboard.json").read_bytes() == year.ask("GET", path).content
    assert re.search(r"Person \d", (site / "index.html").read_text()) is None
    shutil.rmtree(site)
