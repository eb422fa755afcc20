"""The worst years of a server: everything that may happen to it, in a random order.

Participants act over HTTP, organisers over HTTP and by commands. Much of it is refused, because a
team is gone, a phase is over or a token was revoked; what counts is what all of it leaves behind.
"""

import json
import os
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from math import ceil
from operator import itemgetter
from pathlib import Path
from random import Random
from typing import Any
from unittest.mock import patch

import httpx
import time_machine
from anyio.from_thread import BlockingPortal

from reverie_eval import GroundTruth
from reverie_eval.ground_truth import Bundle
from reverie_eval.runner import run_agent
from reverie_eval.server.app import create_app
from reverie_eval.server.intake.retention import tidy
from reverie_eval.server.opening import open_server
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.settings import SETTINGS_FILE, load_settings
from reverie_eval.server.state import ServerState
from tests.support.processes import TOKEN, Laptop
from tests.support.serving import OPEN, PRIVATE, InProcess, add_boards
from tests.support.worlds import with_arrays

TASKS = ("reverie", "r2r")
OTHER_TASK = "r2r-val_unseen"
BEGIN = datetime(2027, 1, 4, tzinfo=UTC)
WAITING = """
[mail]
host = "127.0.0.1"
security = "none"
sender = "reverie@lab.example.org"
recipients = ["olga@lab.example.org"]

[webhook]
url = "http://127.0.0.1:1/"
"""
"""Settings of channels, to which nothing is sent here."""
PLACES = {OPEN: "val_unseen.npz", PRIVATE: "test.npz", OTHER_TASK: "r2r/val_unseen.npz"}
"""The bundles of splits, in the folder of bundles."""
LONG = "蓝" * 100
"""A name as long as names may be."""
TEXT = "ü" * 500
"""A text as long as texts may be."""
RARELY = 0.2
TRIES = 20
NO_KINDS = ("go_on", "leave_nothing_out", "happen", "accept_everything")
NOTHING = httpx.Response(404)
LISTS = ("teams", "people", "tokens", "grants", "reviews", "reported", "attempts", "audit")


@dataclass
class Lab:
    """A server's folder, its people, and the time."""

    folder: Path
    portal: BlockingPortal
    database: str | None = None
    """The database's URL, unless it is in the folder."""
    organiser: str = ""
    """The organiser's token."""
    tokens: dict[str, str] = field(default_factory=dict)
    """A token of everybody else, by name; some are revoked."""
    _running: tuple[ServerState, httpx.Client] | None = None

    def make(self) -> None:
        """Make the server, with several tasks, other leaderboards and channels."""
        tasks = [word for task in TASKS for word in ("--task", task)]
        self.organiser = TOKEN.findall(self.command("init", *tasks))[0]
        settings = self.folder / SETTINGS_FILE
        text = settings.read_text().replace("day = 2, month = 10, year = 40", "day = 9, year = 99")
        text = text.replace("requests_per_minute = 120", "requests_per_minute = 1000000")
        settings.write_text(f"keep_uploads_days = 30\n{text}{WAITING}")
        add_boards(self.folder, PRIVATE)

    def command(self, name: str, *words: str | Path) -> str:
        """Run a command on the folder, which has to succeed, and return what it prints."""
        self.stop()
        all_words = ("server", *name.split(), self.folder, *words)
        status = None if name == "rescore" else 0  # some files may be gone
        done = Laptop(self.folder.parent).run(*all_words, status=status, variables=self._variables)
        return done.out

    def stop(self) -> None:
        """Stop the server, if it runs."""
        if self._running is not None:
            state, client = self._running
            client.close()
            state.database.close()
            self._running = None

    def ask(
        self, method: str, path: str, token: str | None = None, **content: Any
    ) -> httpx.Response:
        """Send a request to the server, which is started if it does not run."""
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        reply = self.running()[1].request(method, f"/api/v1{path}", headers=headers, **content)
        assert reply.status_code < 500, reply.text
        return reply

    def running(self) -> tuple[ServerState, httpx.Client]:
        """Return the server, which is started if it does not run."""
        if self._running is None:
            with patch.dict(os.environ, self._variables):
                state = open_server(load_settings(self.folder))
            transport = InProcess(create_app(state, "http://server"), self.portal)
            self._running = state, httpx.Client(transport=transport, base_url="http://server")
        return self._running

    def organise(self, method: str, path: str, **fields: Any) -> httpx.Response:
        """Send an organiser's request."""
        return self.ask(method, f"/organiser/{path}", self.organiser, json=fields or None)

    def restored(self, archive: Path, folder: Path, database: str | None) -> "Lab":
        """Restore a backup of this server to another folder and database."""
        self.stop()
        lab = replace(self, folder=folder, database=database)
        words = ("server", "restore", archive, folder)
        Laptop(folder.parent).run(*words, variables=lab._variables)  # noqa: SLF001
        return lab

    @property
    def _variables(self) -> Mapping[str, str]:
        return {"REVERIE_EVAL_DATABASE": self.database} if self.database else {}

    def faults(self) -> list[str]:
        """Return what the doctor complains of."""
        self.stop()
        with patch.dict(os.environ, self._variables):
            return [str(each) for each in examine(self.folder) if each.kind == "fault"]

    def documents(self) -> Mapping[str, bytes]:
        """Return every leaderboard and snapshot, and what the organiser and everybody else sees."""
        found = {path: self.ask("GET", path) for path in ("/splits", "/server", "/keys", "/news")}
        for split in found["/splits"].json():
            path = f"/splits/{split['name']}"
            boards = [path, *(f"{path}/boards/{name}" for name in split["boards"])]
            paths = [f"{board}/leaderboard{kind}" for board in boards for kind in ("", ".csv")]
            paths += [f"{path}/leaderboard?metric=success", f"{path}/snapshots"]
            for snapshot in self.ask("GET", f"{path}/snapshots").json():
                paths += [f"{path}/snapshots/{snapshot['number']}{kind}" for kind in ("", ".csv")]
            found |= {path: self.ask("GET", path) for path in paths}
        assert [path for path, reply in found.items() if not reply.is_success] == []
        for name in LISTS:
            found[name] = self.organise("GET", f"{name}?limit=1000")
        for name, token in self.tokens.items():
            for path in ("/me", "/submissions?limit=1000"):
                found[f"{path} of {name}"] = self.ask("GET", path, token)
        return {path: reply.content for path, reply in found.items()}


@dataclass
class WorstYear:
    """What happens to a lab."""

    lab: Lab
    time: time_machine.Traveller
    random: Random
    files: list[tuple[str, bytes]] = field(default_factory=list)
    """The files that were sent, with their splits."""
    done: Counter[str] = field(default_factory=Counter)
    """How often something was not refused, by kind."""

    def go_on(self, share: float) -> None:
        """Let everything happen so many times, or a share of it, in a random order."""
        number = int(share * len(KINDS))
        for kind in self.random.sample(list(KINDS) * ceil(share), number):
            self.time.shift(timedelta(hours=self.random.choice([1, 30, 300])))
            self.happen(kind)

    def leave_nothing_out(self) -> None:
        """Let what was always refused so far happen too."""
        self.accept_everything()
        for kind in KINDS:
            for _ in range(TRIES):
                if not self.done[kind]:
                    self.add_team()
                    self.upload_publicly()
                    self.happen(kind)
            assert self.done[kind], kind

    def happen(self, kind: str) -> None:
        """Let something happen, and count it unless it is refused."""
        reply = KINDS[kind](self)
        self.done[kind] += reply is None or reply.is_success

    def accept_everything(self) -> None:
        """End all pauses and phases that were set."""
        self.lab.organise("PUT", "notice", banner="")
        self.lab.organise("PUT", f"schedules/{PRIVATE}", paused=False)

    # Teams and people.

    def add_team(self) -> httpx.Response:
        """Add a team of two, with a token each."""
        team = self._new_name()
        added = self.lab.organise("POST", "teams", name=team)
        for _ in range(2):
            self._add_person(team)
        return added

    def merge_older_into_newer(self) -> httpx.Response:
        """Merge a team into one that was added later."""
        return self._merge(*self._two_teams())

    def merge_newer_into_older(self) -> httpx.Response:
        """Merge a team into one that was added before."""
        return self._merge(*reversed(self._two_teams()))

    def rename_team(self) -> httpx.Response:
        """Rename a team."""
        return self.lab.organise("PATCH", f"teams/{self._team()}", name=self._new_name())

    def move_person(self) -> httpx.Response:
        """Move a person to another team."""
        return self.lab.organise("PATCH", f"people/{self._one('people')}", team=self._team())

    def delete_person(self) -> httpx.Response:
        """Delete a person."""
        return self.lab.organise("DELETE", f"people/{self._one('people')}")

    def grant(self) -> httpx.Response:
        """Grant a team extra submissions."""
        ends = (datetime.now(UTC) + timedelta(days=99)).isoformat()
        new = {"team": self._team(), "split": PRIVATE, "extra": 10_000, "reason": TEXT}
        return self.lab.organise("POST", "grants", **new, expires_at=ends)

    def revoke_token(self) -> httpx.Response:
        """Revoke a token."""
        return self.lab.organise("DELETE", f"tokens/{self._one('tokens', 'hint')}")

    def ask_to_join(self) -> httpx.Response:
        """Ask for an account."""
        people = [{"name": self._new_name(), "email": "dora@example.org"}]
        about = {"team": self._new_name(), "people": people, "institution": "U", "purpose": "Maps"}
        return self.lab.ask("POST", "/join", json=about)

    def answer_requests(self) -> None:
        """Accept or reject a request to join, if there is one."""
        _, *rows = self.lab.command("request list").splitlines()
        answer = self.random.choice(["accept", "reject"])
        if rows and rows[0].split()[0].isdigit():
            self.lab.command(f"request {answer}", rows[0].split()[0])

    # Submissions.

    def upload(self) -> httpx.Response:
        """Upload a new file."""
        split = self.random.choice(list(PLACES))
        truth = GroundTruth.load(self.lab.folder / "bundles" / PLACES[split])
        seed = self.random.getrandbits(30)
        content = json.dumps(run_agent("random", truth, seed)).encode()
        self.files.append((split, content))
        return self._upload(split, content)

    def upload_publicly(self) -> httpx.Response:
        """Upload a new file, and publish it."""
        sent = self.upload()
        return (
            self._change(sent.json()["submission"]["id"], published=True)
            if sent.is_success
            else sent
        )

    def upload_the_same(self) -> httpx.Response:
        """Upload a file that somebody has sent before."""
        return self._upload(*self.random.choice(self.files or [(OPEN, b"[]")]))

    def upload_nonsense(self) -> None:
        """Upload what is not a submission."""
        self._upload(OPEN, b'[{"instr_id": "' + LONG.encode() + b'"}]')

    def publish_for_later(self) -> httpx.Response:
        """Publish a submission, at first without the team's name."""
        until = (datetime.now(UTC) + timedelta(days=20)).isoformat()
        return self._change(self._submission(), published=True, anonymous_until=until)

    def withdraw(self) -> httpx.Response:
        """Withdraw a submission."""
        return self._change(self._submission(), withdrawn=True)

    def describe(self) -> httpx.Response:
        """Describe a method otherwise."""
        method = {"name": self._new_name(), "description": LONG, "extra_data": True}
        return self._change(self._submission(), method=method)

    def tidy(self) -> None:
        """Delete old files, as a running server does every day."""
        state = self.lab.running()[0]
        if state.settings.keep_uploads_days is not None:
            tidy(state, state.settings.keep_uploads_days)

    # What organisers publish.

    def review(self) -> httpx.Response:
        """Review a submission."""
        verdict = self.random.choice(["verified", "flagged", "disqualified", "baseline"])
        new = {"submission_id": self._submission(), "verdict": verdict, "reason": TEXT}
        return self.lab.organise("POST", "reviews", **new)

    def lift_review(self) -> httpx.Response:
        """Lift a review."""
        return self.lab.organise("DELETE", f"reviews/{self._one('reviews')}")

    def import_results(self) -> httpx.Response:
        """Import a reported result."""
        score = self.random.randrange(100)
        text = f"team,method,SR,SPL\n{self._new_name()},{LONG},{score},{score / 3}\n"
        new = {"split": self.random.choice(list(PLACES)), "source": TEXT, "text": text}
        return self.lab.organise("POST", "reported/import", **new)

    def remove_result(self) -> httpx.Response:
        """Remove a reported result."""
        return self.lab.organise("DELETE", f"reported/{self._one('reported')}")

    def post_notice(self) -> httpx.Response:
        """Post a banner, and sometimes pause submissions."""
        return self.lab.organise("PUT", "notice", banner=TEXT, paused=self.random.random() < RARELY)

    def add_news(self) -> httpx.Response:
        """Post news."""
        return self.lab.organise("POST", "news", text=TEXT)

    def take_snapshot(self) -> httpx.Response:
        """Take a snapshot."""
        new = {"split": self.random.choice(list(PLACES)), "title": self._new_name()}
        return self.lab.organise("POST", "snapshots", **new)

    def hold_scores_back(self) -> httpx.Response:
        """Open a phase that holds scores back."""
        now = datetime.now(UTC)
        ends = now + timedelta(days=self.random.choice([3, 30]))
        phase = {"name": self._new_name(), "opens": now.isoformat(), "closes": ends.isoformat()}
        path = f"schedules/{PRIVATE}"
        return self.lab.organise("PUT", path, phases=[phase], release_scores="phase-end")

    def show_scores(self) -> httpx.Response:
        """Go back to the phases of the settings."""
        return self.lab.organise("PUT", f"schedules/{PRIVATE}", paused=False)

    # What is corrected, rotated and lost.

    def correct(self) -> None:
        """Correct a split's answers, and score it again."""
        split = self.random.choice([OPEN, PRIVATE])
        bundle = Bundle.load(self.lab.folder / "bundles" / PLACES[split])
        target = bundle.arrays["task_target"].copy()
        target[self.random.randrange(len(target))] += 1
        corrected = self.lab.folder.parent / "corrected.npz"
        with_arrays(bundle, task_target=target).save(corrected)
        words = ("--reason", TEXT, "--jobs", "1")
        self.lab.command("rescore", split, "--bundle", corrected, *words)

    def rank_by_more_rules(self) -> None:
        """Add other leaderboards to the open split, unless it has some."""
        if "val_unseen.boards" not in (self.lab.folder / SETTINGS_FILE).read_text():
            self.lab.stop()
            add_boards(self.lab.folder, OPEN)
            self.lab.command("rescore", OPEN, "--reason", "other leaderboards", "--jobs", "1")

    def rotate_key(self) -> None:
        """Rotate the signing key."""
        self.lab.command("key rotate", "--reason", TEXT)

    def lose_key(self) -> None:
        """Lose the signing key."""
        (self.lab.folder / "signing-key.pem").unlink()
        self.lab.command("key rotate", "--lost", "--reason", TEXT)

    def revoke_key(self) -> None:
        """Revoke half of the time in which a former key was valid."""
        key = self.random.choice(self.lab.ask("GET", "/keys").json())
        if key["valid_until"] is not None:
            begin, end = map(datetime.fromisoformat, (key["valid_from"], key["valid_until"]))
            if begin < end:
                since = (begin + (end - begin) / 2).isoformat()
                self.lab.command("key revoke", key["key_id"], "--since", since, "--reason", TEXT)

    # What they choose from.

    def _merge(self, team: str, into: str) -> httpx.Response:
        return self.lab.organise("POST", "teams/merge", team=team, into=into)

    def _upload(self, split: str, content: bytes) -> httpx.Response:
        path = f"/splits/{split}/submissions?name=Walker"
        return self.lab.ask("POST", path, self._token(), content=content)

    def _change(self, submission: str, **fields: object) -> httpx.Response:
        with_token = (
            self.lab.ask("PATCH", f"/submissions/{submission}", token, json=fields)
            for token in self.lab.tokens.values()
        )
        return next((reply for reply in with_token if reply.is_success), NOTHING)

    def _token(self) -> str | None:
        """Choose a token, mostly a valid one."""
        tokens: list[str | None] = [*self.lab.tokens.values()] or [None]
        self.random.shuffle(tokens)
        valid = (token for token in tokens if self.lab.ask("GET", "/me", token).is_success)
        return tokens[0] if self.random.random() < RARELY else next(valid, None)

    def _submission(self) -> str:
        rows = self.lab.ask("GET", "/submissions?limit=1000", self.lab.organiser).json()
        return str(self.random.choice([row["id"] for row in rows] or ["0" * 16]))

    def _one(self, path: str, key: str = "id") -> Any:
        """Choose a row of a list, but not the organiser's; return what identifies it."""
        rows = self.lab.organise("GET", f"{path}?limit=1000").json()
        others = [row[key] for row in rows if row.get("team") != "Organisers"]
        return self.random.choice(others or ["0"])

    def _two_teams(self) -> tuple[str, str]:
        """Choose two teams, the older first."""
        teams = [*self._teams(), "none"]
        older, newer = sorted(self.random.sample(range(len(teams)), 2))
        return teams[older], teams[newer]

    def _team(self) -> str:
        return self.random.choice(self._teams())

    def _teams(self) -> list[str]:
        """Return the names of all teams but the organisers', the oldest first."""
        rows = self.lab.organise("GET", "teams?limit=1000").json()
        rows.sort(key=itemgetter("created_at"))
        return [row["name"] for row in rows if row["name"] != "Organisers"] or ["none"]

    def _add_person(self, team: str) -> None:
        name = self._new_name()
        self.lab.organise("POST", "people", team=team, name=name, email="a@example.org")
        new = self.lab.organise("POST", "tokens", person=name, kind="access").json()
        self.lab.tokens[name] = new["token"]

    def _new_name(self) -> str:
        """Return a name that nobody has, sometimes as long as a name may be."""
        name = f"Ünit {self.random.getrandbits(40):x}"
        return name.ljust(100, "蓝") if self.random.random() < RARELY else name


KINDS: Mapping[str, Callable[[WorstYear], httpx.Response | None]] = {
    name: act
    for name, act in vars(WorstYear).items()
    if callable(act) and not name.startswith("_") and name not in NO_KINDS
}
"""All that can happen, by name."""
