"""What reading all uploads costs: time of the processors, and memory at the peak.

``python benchmarks/evidence_cost.py [SUBMISSIONS]`` makes a server with so many submissions of 100
teams to val_unseen, each another file, and runs the command. With the published files, it is
REVERIE's split, otherwise the demo world's.
"""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from sqlalchemy import insert, select

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.bars import Figure, judge
from fixtures.published import published_folder, unpack_dataset
from fixtures.servers import make_folder
from reverie_eval import GroundTruth
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.runner import run_agent
from reverie_eval.schemas.organising import NewPerson, NewTeam
from reverie_eval.server.accounts.people import add_person, add_team
from reverie_eval.server.opening import opened_server
from reverie_eval.server.settings import load_settings
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import Person, Submission

SUBMISSIONS = 2000
TEAMS = 100
SPLIT = "val_unseen"
COMMAND = Path(sys.executable).with_name("reverie-eval")
BARS = {"time": 180.0, "memory": 600.0}
"""Seconds of the processors, and megabytes."""


def main() -> int:
    """Print time and memory; return 1 if a bar is missed."""
    submissions = int(sys.argv[1]) if len(sys.argv) > 1 else SUBMISSIONS
    with TemporaryDirectory() as temporary:
        folder = Path(temporary) / "server"
        make_folder(folder)
        install_published(folder, Path(temporary))
        with opened_server(load_settings(folder)) as state:
            fill(state, submissions)
        seconds, memory = run(folder)
    figures: list[Figure] = [
        (f"{submissions:,} submissions, s", seconds, BARS["time"]),
        ("peak memory, MB", memory, BARS["memory"]),
    ]
    return judge(figures)


def install_published(folder: Path, temporary: Path) -> None:
    """Serve REVERIE's split, if it is here."""
    published = published_folder()
    if published is not None:
        root = unpack_dataset(published, temporary)
        place = folder / "bundles" / f"{SPLIT}.npz"
        compile_split(DatasetFiles.find(root, split=SPLIT), SPLIT).save(place)


def fill(state: ServerState, submissions: int) -> None:
    """Add submissions; the files of a team differ in a tenth of their answers."""
    board = state.board(SPLIT)
    with state.transactions.begin("benchmark") as transaction:
        for team in range(TEAMS):
            add_team(transaction, NewTeam(name=f"Team {team}"))
            add_person(transaction, NewPerson(team=f"Team {team}", name=f"P {team}"))
    with state.database.reading() as session:
        people = session.scalars(select(Person).where(Person.name.startswith("P "))).all()
        authors = [(each.team_id, each.id) for each in people]
    template = state.board(SPLIT).read(json.dumps(run_agent("random", board.truth, 0)).encode())
    report = board.report(board.score(template), template).model_dump(mode="json")
    rows = []
    for number, content in enumerate(files(board.truth, submissions)):
        sha256 = hashlib.sha256(content).hexdigest()
        state.uploads.put(sha256, content)
        team_id, person_id = authors[number % TEAMS]
        rows.append(
            {
                "id": f"{number:016x}",
                "split": SPLIT,
                "team_id": team_id,
                "person_id": person_id,
                "sha256": sha256,
                "size": len(content),
                "received_at": state.clock() - timedelta(hours=submissions - number),
                "scored_at": state.clock(),
                "method": {"name": "Method"},
                "report": report,
                "receipt": {},
            }
        )
    with state.database.writing() as session:
        session.execute(insert(Submission), rows)


def files(truth: GroundTruth, number: int) -> Iterator[bytes]:
    """Yield submissions of random walkers, each like one of a hundred others."""
    walkers: list[list[dict[str, Any]]] = [
        [dict(record) for record in run_agent("random", truth, seed)] for seed in range(10)
    ]
    random = np.random.default_rng(0)
    for index in range(number):
        records = [dict(record) for record in walkers[index % TEAMS % 10]]
        for row in np.flatnonzero(random.random(len(records)) < 0.1):
            records[row]["predObjId"] = int(random.integers(1, 500))
        yield json.dumps(records).encode()


def run(folder: Path) -> tuple[float, float]:
    """Run the command; return seconds of the processors and megabytes."""
    with subprocess.Popen(
        [COMMAND, "server", "evidence", folder, SPLIT], stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None  # noqa: S101  # it was asked for
        said = process.stdout.read().decode()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(said)
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1000


if __name__ == "__main__":
    sys.exit(main())
