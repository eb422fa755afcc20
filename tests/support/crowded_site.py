"""The demo site a year later: 60 results of 17 teams, and work for the organiser."""

from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import cycle, islice
from typing import Any

import httpx

from reverie_eval.server.opening import acting
from reverie_eval.server.settings import load_settings
from reverie_eval.server.store.database import Database
from tests.support.demo_site import ORGANISER, Sent, Site, send_all
from tests.support.serving import NO_TLS, OPEN, PRIVATE, populate
from tests.support.waiting import PATIENCE

TEAMS = (
    "Northern Lights",
    "Institute for Robotics, University of Lower Saxony",
    "Wayfinders",
    "Embodied Group",
    "Laboratory of Visual Navigation",
    "Three Doors Down",
    "Maple Lab",
    "Team Corridor",
    "Harbour University",
    "Alpine Institute of Technology",
    "Second Floor",
    "Vision and Language Research Centre",
    "Grey",
)
"""Beside the four who submit to the demo site."""
METHODS = (
    "Layout transformer",
    "Waypoint memory",
    "Object prior",
    "Recurrent history",
    "Room-aware planner with language grounding",
    "Topological map",
    "Cross-modal matching",
    "Pretrained speaker",
    "Value iteration over a learned graph of the building",
    "DUET-like",
)
_FLAGS: tuple[dict[str, Any], ...] = (
    {},
    {"extra_data": True, "paper": "https://example.org/paper"},
    {"paper": "https://example.org/paper", "code": "https://example.org/code"},
    {"ensemble": True, "pre_exploration": True},
    {"ground_truth_objects": True, "code": "https://example.org/code"},
    {"extra_data": True, "ensemble": True, "ground_truth_objects": True},
)
_CHANGES: tuple[dict[str, Any], ...] = (
    *[{"published": True}] * 8,
    {"published": True, "anonymous_until": "2100-01-01T00:00:00Z"},
    {},
)
_RESULTS = 52
"""Beside those of the demo site; one of ten is not published."""


def crowd(site: Site) -> Site:
    """Add teams with what they send in, reported results, news, phases and requests to join."""
    now = datetime.now(UTC)
    people = {f"Person {number}": team for number, team in enumerate(TEAMS)}
    with acting(load_settings(site.folder), "test") as transaction:
        tokens = populate(transaction, people)
    site = replace(site, tokens={**site.tokens, **tokens})
    with closing(Database(load_settings(site.folder).database_url)) as database:
        send_all(site, database, [*_open(people), *_private(people)])
    for name, success, rgspl in (("Human", 0.8151, 0.5366), ("Published baseline", 0.4184, 0.2175)):
        result = {"split": OPEN, "method": {"name": name}, "team": "Qi et al.", "date": "2020-06"}
        scores = {"success": success, "rgspl": rgspl}
        more = {"scores": scores, "source": "https://example.org/paper"}
        site.ask(ORGANISER, "POST", "/organiser/reported", json={**result, **more})
    for text in (
        "The workshop is on 12 June.",
        "Submissions to test close a week later than planned.",
    ):
        site.ask(ORGANISER, "POST", "/organiser/news", json={"text": text})
    phases = [
        {"name": "challenge", "closes": _day(now + timedelta(days=20))},
        {"name": "after the challenge", "opens": _day(now + timedelta(days=30))},
    ]
    schedule = {"phases": phases, "release_scores": "at-once"}
    site.ask(ORGANISER, "PUT", f"/organiser/schedules/{PRIVATE}", json=schedule)
    for team in ("Green", "Blue", "A laboratory with a long name, of a university with another"):
        dora = {"name": f"Dora of {team}", "email": "dora@example.org"}
        request = {"team": team, "people": [dora], "institution": "University of the South"}
        asked = {**request, "purpose": "Object search with language"}
        url = f"{site.url}/api/v1/join"
        httpx.post(url, json=asked, timeout=PATIENCE, verify=NO_TLS).raise_for_status()
    return site


def _open(people: dict[str, str]) -> list[Sent]:
    said = zip(cycle(people), cycle(METHODS), cycle(_FLAGS), cycle(_CHANGES), strict=False)
    return [
        Sent(
            who,
            OPEN,
            f"mixed {12 + (37 * number) % 79}",
            300 - 5 * number,
            {"name": f"{method} {1 + number // len(METHODS)}", **flags},
            change,
        )
        for number, (who, method, flags, change) in enumerate(islice(said, _RESULTS))
    ]


def _private(people: dict[str, str]) -> list[Sent]:
    methods = cycle(METHODS)
    return [
        Sent(
            who,
            PRIVATE,
            f"mixed {20 + 5 * number}",
            90 - number,
            {"name": method},
            {"published": True},
        )
        for number, (who, method) in enumerate(zip(people, methods, strict=False))
    ]


def _day(instant: datetime) -> str:
    return instant.date().isoformat()
