"""A server on the demo world with people in it, what they sent in, and what was said of it."""

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import httpx

from reverie_eval import CATALOGUE, GroundTruth
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.runner import run_agent
from reverie_eval.schemas.service import Method
from reverie_eval.server.opening import acting
from reverie_eval.server.settings import load_settings
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Attempt, Person, ReportedResult, Review, Submission
from tests.support.serving import NO_TLS, populate
from tests.support.waiting import PATIENCE

SAMPLES = Path(__file__).parents[2] / "fixtures" / "submissions"
MARKUP = "<script>alert(1)</script>"
"""A team's name."""
BOLD = "<b>Bold</b> & 'quoted' walker"
"""A method's name."""
WALKER = "Walker"
"""The owner's best method."""
ENDLESS = "Methodofonewordthatgoesonandon" * 3 + "tothelimit"
"""A name as long as any may be, without a place to break it."""
PEOPLE = {
    "Ada": "Blue",
    "Ben": "Blue",
    "Carl": "Red",
    "Eve": MARKUP,
    f"Fay{'longname' * 12}": f"Team{'longname' * 12}",
    "Olga": "Organisers",
}
OWNER, MATE, OTHER, MARKED, WORDY, ORGANISER = PEOPLE
BANNER = f"We move to https://example.org/{'announcements/' * 4}{ENDLESS[:60]}?year=2026 soon."
OPEN, PRIVATE = "val_unseen", "test"


class Sent(NamedTuple):
    """A submission: who sent it when, and what is said of its method."""

    who: str
    split: str
    agent: str
    """A reference agent with a seed, a sample, or ``mixed`` with a percentage."""
    days_ago: int
    said: Mapping[str, Any]
    change: Mapping[str, Any]


_PUBLISHED = {"published": True}
_SHOWN = {"published": True, "shows_episodes": True}
_ANONYMOUS = {"published": True, "anonymous_until": "2100-01-01T00:00:00Z"}
_LONG = "Recurrent walker with a very long name that nobody could pronounce, version 2.1-rc.3"
_SAMPLED = {"input_class": "objects", "sample_size": 60, "money_per_episode": 0}
_SENT = (
    Sent(OTHER, OPEN, "stop", 60, {"name": "Stays where it is"}, _PUBLISHED),
    Sent(OTHER, OPEN, "random 1", 55, {"name": "Random walker", **_SAMPLED}, _PUBLISHED),
    Sent(MARKED, OPEN, "mediocre", 41, {"name": BOLD, "extra_data": True}, _SHOWN),
    Sent(MATE, OPEN, "random 2", 30, {"name": _LONG, "pre_exploration": True}, _ANONYMOUS),
    Sent(
        OWNER,
        OPEN,
        "good",
        21,
        {
            "name": "Walker",
            "paper": "https://example.org/p",
            "code": "https://example.org/c",
            "input_class": "views",
            "actions_per_episode": 12.5,
            "seconds_per_episode": 41.25,
            "input_tokens_per_episode": 18250.4,
            "output_tokens_per_episode": 640,
            "money_per_episode": 0.0375,
        },
        _PUBLISHED,
    ),
    Sent(
        OWNER, OPEN, "drawn", 12, {"name": "Box drawer", "ground_truth_objects": True}, _PUBLISHED
    ),
    Sent(OWNER, OPEN, "random 3", 2, {"name": "Walker, early stopping"}, {}),
    Sent(WORDY, OPEN, "random 6", 25, {"name": ENDLESS, "description": ENDLESS * 4}, _PUBLISHED),
    Sent(OTHER, PRIVATE, "random 4", 15, {"name": "Random walker"}, _PUBLISHED),
    Sent(OWNER, PRIVATE, "shortest 0", 5, {"name": "Shortest paths"}, _PUBLISHED),
    Sent(MARKED, PRIVATE, "random 5", 4, {"name": BOLD}, {"withdrawn": True}),
)


@dataclass(frozen=True)
class Site:
    """A server that listens, with everybody's token and the ids of what was sent, by method."""

    url: str
    folder: Path
    tokens: Mapping[str, str]
    ids: Mapping[tuple[str, str], str]
    """By split and name of the method."""
    instr_id: str = "1196_0_0"
    """An episode of the open split."""
    scan: str = "DemoMansion"
    """One of its scans."""

    def ask(self, who: str, method: str, path: str, **content: Any) -> httpx.Response:
        """Ask the API with somebody's token."""
        headers = {"Authorization": f"Bearer {self.tokens[who]}"}
        reply = httpx.request(
            method,
            f"{self.url}/api/v1{path}",
            headers=headers,
            timeout=PATIENCE,
            verify=NO_TLS,
            **content,
        )
        return reply.raise_for_status()

    def invite(self, who: str) -> str:
        """Return an invitation that the organiser has made for somebody."""
        asked = {"person": who, "kind": "invite"}
        invitation: str = self.ask(ORGANISER, "POST", "/organiser/tokens", json=asked).json()[
            "token"
        ]
        return invitation


def furnish(url: str, folder: Path) -> Site:
    """Add people to a running server, send in what they have, and judge some of it."""
    now = datetime.now(UTC)
    with acting(load_settings(folder), "test") as transaction:
        tokens = populate(transaction, PEOPLE)
    with closing(Database(load_settings(folder).database_url)) as database:
        site = Site(url, folder, tokens, {})
        site.ask(ORGANISER, "PUT", "/organiser/notice", json={"banner": BANNER})
        ids = send_all(site, database, _SENT)
        with database.writing() as session:
            session.add_all([*_reviews(ids, now), _reported(now)])
            ada = session.get_one(Person, 1)
            session.add_all(_attempts(ada, now))
        taken = {"split": OPEN, "title": "The first month"}
        site.ask(ORGANISER, "POST", "/organiser/snapshots", json=taken)
    return Site(url, folder, site.tokens, ids)


def send_all(site: Site, database: Database, sent: Sequence[Sent]) -> Mapping[tuple[str, str], str]:
    """Send submissions, as if each had come on its day; return their ids by split and method."""
    now = datetime.now(UTC)
    ids = {(each.split, each.said["name"]): _send(site, each) for each in sent}
    with database.writing() as session:
        for each in sent:
            row = session.get_one(Submission, ids[each.split, each.said["name"]])
            row.received_at = now - timedelta(days=each.days_ago)
            row.published_at = row.published_at and row.received_at + timedelta(hours=1)
    return ids


def sound(split: str, agent: str) -> bytes:
    """Return a sound submission of an agent's, or a sample.

    The mixed one walks the shortest path in that percentage of the episodes, and else at random.
    """
    name, _, seed = agent.partition(" ")
    if (sample := SAMPLES / f"{name}.json").exists():
        return sample.read_bytes()
    apart = DEMO_BUNDLES / "private" if split == PRIVATE else DEMO_BUNDLES
    truth, number = GroundTruth.load(apart / f"{split}.npz"), int(seed or 0)
    if name != "mixed":
        return json.dumps(run_agent(name, truth, number)).encode()
    pairs = zip(run_agent("shortest", truth), run_agent("random", truth, number), strict=True)
    random = Random(number)
    return json.dumps([pair[random.random() * 100 > number] for pair in pairs]).encode()


def _send(site: Site, each: Sent) -> str:
    content = sound(each.split, each.agent)
    path = f"/splits/{each.split}/submissions"
    reply = site.ask(each.who, "POST", path, content=content, params=each.said)
    identity: str = reply.json()["submission"]["id"]
    if each.change:
        site.ask(each.who, "PATCH", f"/submissions/{identity}", json=each.change)
    return identity


def _reviews(ids: Mapping[tuple[str, str], str], now: datetime) -> list[Review]:
    said = {
        "Walker": ("verified", "we ran its code and got the same file"),
        "Random walker": ("baseline", "walks at random, for comparison"),
        BOLD: ("flagged", f"its paper is missing {MARKUP}"),
        ENDLESS: ("flagged", ENDLESS * 4),
    }
    return [
        Review(
            submission_id=ids[OPEN, name],
            verdict=verdict,
            reason=reason,
            created_at=now - timedelta(days=1),
        )
        for name, (verdict, reason) in said.items()
    ]


def _reported(now: datetime) -> ReportedResult:
    scores = {"success": 0.5251, "spl": 0.4706, "rgs": 0.3493, "rgspl": 0.3144}
    assert set(scores) <= set(CATALOGUE)
    return ReportedResult(
        split=OPEN,
        method=Method(name="A published method").model_dump(mode="json"),
        team="Its authors",
        scores=scores,
        source="https://example.org/paper",
        date="2020-06",
        dataset="",
        created_at=now - timedelta(days=50),
    )


def _attempts(person: Person, now: datetime) -> list[Attempt]:
    outcomes = (("scored", 0, 84), ("submission-rejected", 12, 9), ("repeat", 0, 5))
    return [
        Attempt(
            at=now - timedelta(hours=hours),
            person_id=person.id,
            split=OPEN,
            outcome=outcome,
            problems=problems,
            size=61_440,
            milliseconds=milliseconds,
        )
        for hours, (outcome, problems, milliseconds) in enumerate(outcomes)
    ]
