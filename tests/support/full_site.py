"""A server as full as a real one: many methods, and six years of results.

It is of REVERIE's own files or, where they are not, of a made-up world of their size.
"""

import csv
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from io import StringIO
from pathlib import Path
from random import Random
from typing import Any, TypeAlias

import httpx

from fixtures.published import reference_submission, unpack_dataset
from fixtures.servers import make_folder
from reverie_eval import GroundTruth
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.runner import run_agent
from reverie_eval.server.opening import acting
from reverie_eval.server.settings import load_settings
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Submission
from tests.support.browser import UNLIMITED
from tests.support.crowded_site import METHODS, TEAMS
from tests.support.demo_site import BOLD, ENDLESS, ORGANISER, PEOPLE, WALKER, Site
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.serving import OPEN, PRIVATE, populate, running
from tests.support.waiting import PATIENCE, SELDOM, wait_until
from tests.support.worlds import write_world

Record: TypeAlias = Mapping[str, Any]
Walks: TypeAlias = tuple[Record, Record]
"""The best walk through an episode, and a random one."""
PUBLISHED_SPLITS = {OPEN: OPEN, PRIVATE: "val_seen"}
"""Nobody has the solution of test, so val_seen stands in for it."""
MANY = 54
"""Methods on val_unseen."""
ROWS = 81
"""Reported results that are imported from an earlier leaderboard."""
ITEMS = 1174
"""Items of val_unseen."""
_SCANS, _OBJECTS = 10, 50
_STOREY = 9, 8
"""Viewpoints across and along on a storey, two metres apart."""
_NAMES = ("chair", "table", "lamp", "picture", "window", "door", "sink", "towel", "bed", "plant")
_DATA = Path("tasks", "REVERIE", "data")
_DAYS = 900


@contextmanager
def full_site(folder: Path, published: Path | None, methods: int = MANY) -> Iterator[Site]:
    """Run a server until the end, with methods on val_unseen and rows of an earlier leaderboard.

    ``published`` is the folder of the published files; the made-up world needs none.
    """
    server = folder / "server"
    make_folder(server)
    truths = write_bundles(folder / "dataset", published, server / "bundles")
    people = PEOPLE | {f"Person {number}": team for number, team in enumerate(TEAMS)}
    with acting(load_settings(server), "test") as transaction:
        tokens = populate(transaction, people)
    authors = [name for name in people if name != ORGANISER]
    instr_ids = truths[OPEN].episodes.instr_ids
    with running(server, **UNLIMITED) as (_, url):
        scan = truths[OPEN].graph.scan_ids[0]
        # Until reference agents have walked, a busy machine may refuse uploads.
        wait_until(lambda: httpx.get(f"{url}/readyz", timeout=PATIENCE).is_success, SELDOM)
        site = Site(url, server, tokens, {}, instr_ids[len(instr_ids) // 2], scan)
        walks = {split: walks_of(truth, published) for split, truth in truths.items()}
        ids = {**_send(site, walks[OPEN], authors, OPEN, methods)}
        ids |= _send(site, walks[PRIVATE], authors, PRIVATE, max(3, methods // 9))
        _import(site, published)
        snapshot = {"split": OPEN, "title": "The first month"}
        site.ask(ORGANISER, "POST", "/organiser/snapshots", json=snapshot)
        yield replace(site, ids=ids)


def write_bundles(
    dataset: Path, published: Path | None, bundles: Path
) -> Mapping[str, GroundTruth]:
    """Compile val_unseen, and a private split of the same form, into a server's folder."""
    if published is None:
        root, test = made_up_world(dataset), OPEN
    else:
        root, test = unpack_dataset(published, dataset), PUBLISHED_SPLITS[PRIVATE]
    answered = json.loads((root / _DATA / f"REVERIE_{test}.json").read_text(encoding="utf-8"))
    if test == OPEN:  # other episodes than those whose solution is open
        answered = [{**each, "id": f"9{each['id']}"} for each in answered[::2]]
    (root / _DATA / f"REVERIE_{PRIVATE}.json").write_text(json.dumps(answered), encoding="utf-8")
    for split in (OPEN, PRIVATE):
        bundle = compile_split(DatasetFiles.find(root, split=split), split, dataset="REVERIE v1")
        bundle.save(bundles / f"{split}.npz")
    return {split: GroundTruth.load(bundles / f"{split}.npz") for split in (OPEN, PRIVATE)}


def made_up_world(folder: Path) -> Path:
    """Write a world of as many buildings as val_unseen, with 50 objects in sight everywhere."""
    random = Random(0)
    scans = {f"Scan{number:02}": _scan(number, random) for number in range(_SCANS)}
    write_world(World(scans, [*_items(scans, random)]), folder)
    boxes = folder / _DATA / "BBoxes.json"
    seen = json.loads(boxes.read_text())
    for objects in seen.values():
        for object_id, about in objects.items():
            about["name"] = _NAMES[int(object_id) % len(_NAMES)]
    boxes.write_text(json.dumps(seen))
    return folder


def _scan(number: int, random: Random) -> Scan:
    """Lay out one to three storeys with a staircase between them."""
    across, along = _STOREY
    places = {
        f"{number:02}{level}{x:02}{y:02}": (2.0 * x, 2.0 * y, 3.0 * level)
        for level in range(1 + number % 3)
        for x in range(across)
        for y in range(along)
    }
    viewpoints = {
        id_: Viewpoint(
            position,
            views={
                100 * (index // 6) + each: [12 + (7 * each + random.randrange(2)) % 12]
                for each in range(_OBJECTS)
            },
            boxes={},
        )
        for index, (id_, position) in enumerate(places.items())
    }
    edges = {
        (here, there)
        for here, (x, y, z) in places.items()
        for there, (its_x, its_y, its_z) in places.items()
        if here < there
        and (
            (z == its_z and abs(x - its_x) + abs(y - its_y) == 2 and random.random() < 0.8)
            or (z != its_z and (x, y, its_x, its_y) == (0, 0, 0, 0) and abs(z - its_z) == 3)
        )
    }
    return Scan(viewpoints, frozenset(edges))


def _items(scans: Mapping[str, Scan], random: Random) -> Iterator[Item]:
    """Annotate paths of some metres: three instructions each, but for one item with two."""
    for number in range(ITEMS):
        scan_id = f"Scan{number % _SCANS:02}"
        scan = scans[scan_id]
        routes = scan.routes
        start = random.choice([*scan.viewpoints])
        reached = [id_ for id_, metres in routes[start].items() if 6 <= metres <= 16]
        goal = random.choice(reached or [start])
        target = random.choice([*scan.viewpoints[goal].views])
        path = _way(scan, start, goal)
        yield Item(f"{number}_{target}", scan_id, path, target, 2 if number == 0 else 3)


def _way(scan: Scan, start: str, goal: str) -> Sequence[str]:
    """Return a shortest way, by going on to whichever viewpoint is nearest to the goal."""
    neighbours: dict[str, list[str]] = {}
    for one, other in scan.unobstructed:
        neighbours.setdefault(one, []).append(other)
        neighbours.setdefault(other, []).append(one)
    way = [start]
    while way[-1] != goal:
        way.append(min(neighbours[way[-1]], key=scan.routes[goal].__getitem__))
    return way


def _send(
    site: Site, walks: Sequence[Walks], people: Sequence[str], split: str, methods: int
) -> Mapping[tuple[str, str], str]:
    """Send the files of methods, each better than the one before, over some years."""
    ids = {}
    for number in range(methods):
        who, name = people[number % len(people)], _name(number)
        content = json.dumps(submission(walks, number, methods)).encode()
        path = f"/splits/{split}/submissions"
        reply = site.ask(who, "POST", path, content=content, params={"name": name})
        ids[split, name] = identity = reply.json()["submission"]["id"]
        shown = {"shows_episodes": True} if split == OPEN else {}
        site.ask(who, "PATCH", f"/submissions/{identity}", json={"published": True, **shown})
    with (
        closing(Database(load_settings(site.folder).database_url)) as database,
        database.writing() as session,
    ):
        for number, identity in enumerate(ids.values()):
            row = session.get_one(Submission, identity)
            row.received_at = datetime.now(UTC) - timedelta(days=_DAYS * (1 - number / methods))
            row.published_at = row.received_at + timedelta(hours=1)
    return ids


def _name(number: int) -> str:
    """Name a method: the first few as on the other servers."""
    usual = (WALKER, "Shortest paths", BOLD, ENDLESS)
    if number < len(usual):
        return usual[number]
    return f"{METHODS[number % len(METHODS)]} {1 + number // len(METHODS)}"


def walks_of(truth: GroundTruth, published: Path | None) -> Sequence[Walks]:
    """Return the best walk and a random one through each episode."""
    if published is None:
        return [*zip(run_agent("shortest", truth), run_agent("random", truth), strict=True)]
    split = PUBLISHED_SPLITS[truth.split]
    best, lost = (
        {each["instr_id"]: each for each in reference_submission(published, f"{split}.{name}")}
        for name in ("shortest", "walk")
    )
    return [(best[instr_id], lost[instr_id]) for instr_id in truth.episodes.instr_ids]


def submission(walks: Sequence[Walks], number: int, methods: int) -> Sequence[Record]:
    """Walk as a method that solves easy episodes more often than hard ones, and fails in turn."""
    random, skill, difficulty = Random(number), 3.5 * number / methods - 2.5, Random(-1)
    return [_walk(*each, skill - difficulty.gauss(0, 1.6), random) for each in walks]


def _walk(best: Record, lost: Record, ease: float, random: Random) -> Record:
    if random.random() < 1 / (1 + math.exp(-ease)):
        return best
    way = best["trajectory"]
    half, most = way[: 1 + len(way) // 2], way[: 1 + 2 * len(way) // 3]
    failures = (
        lost,
        {**lost, "trajectory": [*half, *_back(half)]},
        {**best, "trajectory": most},
        {**best, "predObjId": lost["predObjId"]},
        {**best, "trajectory": [*way, *_back(way)]},
    )
    return random.choices(failures, (5, 1, 2, 3, 1))[0]


def _back(way: Sequence[Any]) -> Sequence[Any]:
    """Return the last steps of a way once more, backwards."""
    return [*way[-2::-1]][:3]


def earlier_rows(published: Path | None) -> str:
    """Return the rows of the leaderboard of 2020 to 2026, as CSV."""
    if published is None:
        return _made_up_rows()
    return (published / "legacy_leaderboard.csv").read_text()


def paper_table(published: Path | None) -> str:
    """Return the results of the paper, as JSON."""
    if published is None:
        return _made_up_paper()
    return (published / "paper_results.json").read_text()


def _import(site: Site, published: Path | None) -> None:
    """Add the rows of the earlier leaderboard, and those of the paper."""
    source = "https://eval.ai/web/challenges/challenge-page/606"
    rows, paper = earlier_rows(published), paper_table(published)
    old = {"split": PRIVATE, "text": rows, "source": source, "dataset": "REVERIE v2"}
    site.ask(ORGANISER, "POST", "/organiser/reported/import", json=old)
    about = {"source": "Qi et al., CVPR 2020", "date": "2020-06", "dataset": "REVERIE v1"}
    for split, people in ((OPEN, []), (PRIVATE, ["Human"])):
        marks = {"human": people, "reference": ["Random", "Shortest"]}
        new = {"split": split, "text": paper, **about, **marks}
        site.ask(ORGANISER, "POST", "/organiser/reported/import", json=new)


def _made_up_rows() -> str:
    random, text = Random(5), StringIO()
    columns = ["team", "nav_success", "nav_oracle_success", "nav_spl", "nav_length", "rgs", "rgspl"]
    table = csv.writer(text)
    table.writerow([*columns, "date"])
    for number in range(ROWS):
        rgspl = 4 + 30 * (number / ROWS) ** 0.5 + random.gauss(0, 3)
        rates = (rgspl * factor for factor in (2.1, 2.4, 1.6))
        length, date = random.uniform(10, 35), f"{1 + number % 12:02}/{2020 + 6 * number // ROWS}"
        shown = [*rates, length, rgspl * 1.3, rgspl]
        table.writerow([f"Earlier {number}", *(f"{max(each, 0):.2f}" for each in shown), date])
    return text.getvalue()


def _made_up_paper() -> str:
    methods = {"Random": 0.9, "FAST": 7.2, "Pointer": 11.6, "Shortest": 90.0, "Human": 53.66}
    rates = {name: [2 * value / 3 + 30, value] for name, value in methods.items()}
    table = {
        name: {split: values for split in (OPEN, PRIVATE) if name != "Human" or split == PRIVATE}
        for name, values in rates.items()
    }
    return json.dumps({"columns": ["SR", "RGSPL"], "methods": table})
