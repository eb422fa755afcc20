"""Whatever has happened to a server, its backup restores on every database.

Servers live through random years, are backed up and restored, again and again, on SQLite and on
PostgreSQL. Each restored server shows the same bytes as the one before, has nothing for the doctor
to complain of, and goes on.
"""

from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest
import time_machine
from anyio.from_thread import BlockingPortal

from tests.support.amounts import amount, tell
from tests.support.serving import GOOD, OPEN
from tests.support.worst_years import BEGIN, Lab, WorstYear

MOVES = ("postgresql", "sqlite")
"""The databases that a server is restored into, one after the other."""


@pytest.mark.slow
@pytest.mark.parametrize("first", MOVES)
@pytest.mark.parametrize("seed", range(amount(1)))
def test_any_year_is_restored_on_any_database(
    first: str, seed: int, postgresql: Callable[[], str], portal: BlockingPortal, tmp_path: Path
) -> None:
    with time_machine.travel(BEGIN, tick=False) as time:
        lab = Lab(tmp_path / "lab", portal, postgresql() if first == "postgresql" else None)
        lab.make()
        year = WorstYear(lab, time, Random(f"{first} {seed}"))
        year.go_on(1)
        year.leave_nothing_out()
        for number, database in enumerate(MOVES):
            former, archive = year.lab, tmp_path / f"{number}.tar.gz"
            assert former.faults() == []
            documents = former.documents()
            former.command("backup", "-o", archive, "--verify")
            address = postgresql() if database == "postgresql" else None
            year.lab = former.restored(archive, tmp_path / f"lab-{number}", address)
            assert year.lab.faults() == []
            documents_now = year.lab.documents()
            assert [path for path in documents if documents[path] != documents_now[path]] == []
            year.go_on(0.25)
            check_that_it_works(year)
        assert year.lab.faults() == []
    tell(**{f"year {seed} from {first}": f"{year.done.total()} changes"})


def check_that_it_works(year: WorstYear) -> None:
    """Check that two teams can be added, submit, and be merged."""
    lab = year.lab
    year.accept_everything()
    teams = []
    for _ in range(2):
        added = year.add_team()
        assert added.status_code == 201, added.text
        teams.append(added.json()["name"])
        *_, token = lab.tokens.values()
        content = GOOD + b" " * len(lab.tokens)  # which nobody has sent
        path = f"/splits/{OPEN}/submissions?name=Walker"
        sent = lab.ask("POST", path, token, content=content)
        assert sent.status_code == 201, sent.text
    merged = lab.organise("POST", "teams/merge", team=teams[0], into=teams[1])
    assert (merged.status_code, merged.json()["submissions"]) == (200, 1)
