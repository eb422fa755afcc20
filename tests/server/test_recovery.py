"""Whatever has happened to a server, its backup restores on every database.

Servers live through random years, are backed up and restored, again and again, on SQLite and on
PostgreSQL. Each restored server shows the same bytes as the one before, has nothing for the doctor
to complain of, and goes on.
"""

import json
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from random import Random

import pytest
import time_machine
from anyio.from_thread import BlockingPortal

from reverie_eval.schemas.organising import NewMerge
from reverie_eval.server.accounts.people import merge_teams
from reverie_eval.server.audit.rows import all_names_of_teams
from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.operations.restore import restore_backup
from reverie_eval.server.settings import load_settings
from tests.support.amounts import amount, is_evidence, tell
from tests.support.entries import entered
from tests.support.server_data import faults, rows_of
from tests.support.serving import GOOD, OPEN, ORGANISER, OTHER, OWNER, OpenServer, Serving
from tests.support.worst_years import BEGIN, Lab, WorstYear

MOVES = ("postgresql", "sqlite")
"""The databases that a server is restored into, one after the other."""


@pytest.mark.slow
@pytest.mark.parametrize("first", MOVES if is_evidence() else MOVES[:1])
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


CHAINS = {
    "into newer ones at one moment": (("Blue", "Red", "Organisers"), 0),
    "into older ones at one moment": (("Organisers", "Red", "Blue"), 0),
    "into a newer one, an hour later into an older one": (("Red", "Organisers", "Blue"), 1),
}
"""Teams of which each is merged into the next, and the hours between; their order of ids is Blue,
Red, Organisers."""


@pytest.mark.parametrize(("chain", "hours"), CHAINS.values(), ids=CHAINS)
def test_a_chain_of_merged_teams_is_restored_on_the_other_database(  # noqa: PLR0917
    chain: Sequence[str],
    hours: int,
    server_on: Serving,
    request: pytest.FixtureRequest,
    open_server: OpenServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server, file = server_on, server_on.distinct()
    for who in (OWNER, OTHER, ORGANISER):
        entered(server, who=who)
        assert server.upload(who, file).status_code == 201  # all but one become repeats
    for team, into in pairwise(chain):
        server.clock.turn(hours=hours)
        with server.acting() as transaction:
            merge_teams(transaction, NewMerge(team=team, into=into))
    board = f"/splits/{OPEN}/leaderboard"
    before, shown = server.state.settings, server.ask(None, "GET", board).content
    assert [row["team"] for row in json.loads(shown)["rows"]] == 3 * [chain[-1]]
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", before.database)
    rows, archive = rows_of(before.folder), tmp_path / "backup.tar.gz"
    write_backup(before.folder, archive)

    to_sqlite = not server.state.database.is_sqlite
    other = "sqlite:///server.db" if to_sqlite else request.getfixturevalue("postgresql")()
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", other)
    restore_backup(archive, tmp_path / "restored")
    assert rows_of(tmp_path / "restored") == rows
    assert faults(tmp_path / "restored") == []
    restored = open_server(load_settings(tmp_path / "restored"), server.tokens)
    restored.clock.now = server.clock.now
    assert restored.ask(None, "GET", board).content == shown
    with restored.state.database.reading() as session:
        names = all_names_of_teams(session)
    assert [names[team] for team in chain] == [{*chain[: 1 + at]} for at in range(3)]
    for who in (OWNER, OTHER, ORGANISER):
        assert restored.ask(who, "GET", "/me").json()["team"] == chain[-1]
        assert restored.upload(who, file).status_code == 200  # a repeat of all
    assert restored.upload(OTHER, server.distinct()).status_code == 201
