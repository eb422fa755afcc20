"""The leaderboards as tables: what they show, the same numbers, and nothing else."""

import csv
import json
from pathlib import Path

import pytest

from reverie_eval.schemas.organising import NewReported
from reverie_eval.server.boards.reported import add_reported
from tests.server.test_roles import BODIES
from tests.support.acting import review
from tests.support.entries import entered, named
from tests.support.flat_world import Run
from tests.support.serving import GOOD, OPEN, ORGANISER, OTHER, OWNER, PRIVATE, Serving

SECRET = "an unpublished method"


@pytest.fixture
def busy(server: Serving) -> Serving:
    first = entered(server, who=OWNER, **named("=Walker", extra_data=True))
    entered(server, who=OTHER, anonymous_until="2100-01-01T00:00:00Z")
    entered(server, who=OWNER, split=PRIVATE)
    server.upload(OWNER, GOOD + b"\n\n", name=SECRET)
    with server.acting(ORGANISER) as transaction:
        review(transaction, first, "verified", "we ran its code")
        body = {**BODIES["POST /organiser/reported"]["json"], "split": OPEN}
        new = NewReported.model_validate({**body, "method": {"name": "Chance", "reference": True}})
        add_reported(transaction, new, server.state.settings.tasks)
    return server


def test_results_are_those_of_the_leaderboard_s_csv(busy: Serving, folder: Path, run: Run) -> None:
    outcome = run("server", "export", "tables", str(folder), "-o", str(folder.parent / "out"))
    assert outcome.status == 0, outcome.err
    with (folder.parent / "out" / "results.csv").open(newline="") as file:
        results = list(csv.DictReader(file))
    for split in (OPEN, PRIVATE):
        text = busy.client.get(f"/api/v1/splits/{split}/leaderboard.csv").text
        shown = list(csv.DictReader(text.splitlines()))
        own = [row for row in results if row["split"] == split]
        assert len(own) == len(shown) > 0
        for row, expected in zip(own, shown, strict=True):
            assert {name: row[name] for name in expected} == expected
            assert {*row} >= {"split", "board", "description"}


def test_columns_are_described_with_their_types_and_units(
    busy: Serving, folder: Path, run: Run
) -> None:
    out = folder.parent / "out"
    run("server", "export", "tables", str(folder), "-o", str(out))
    described = json.loads((out / "datapackage.json").read_text())
    for resource in described["resources"]:
        with (out / resource["path"]).open(newline="") as file:
            heading = next(csv.reader(file))
        assert heading == [field["name"] for field in resource["schema"]["fields"]]
    fields = {each["name"]: each for each in described["resources"][1]["schema"]["fields"]}
    assert fields["spl"] == {"name": "spl", "type": "number", "unit": "fraction"}
    assert fields["path_length"]["unit"] == "metres"
    assert fields["reference"] == {"name": "reference", "type": "boolean"}


def test_a_backup_has_the_same_tables(busy: Serving, folder: Path, run: Run) -> None:
    archive, outs = folder.parent / "backup.tar.gz", [folder.parent / "a", folder.parent / "b"]
    assert run("server", "backup", str(folder), "-o", str(archive)).status == 0
    for source, out in zip((folder, archive), outs, strict=True):
        outcome = run("server", "export", "tables", str(source), "-o", str(out))
        assert outcome.status == 0, outcome.err
    own, restored = ({path.name: path.read_bytes() for path in out.iterdir()} for out in outs)
    assert own == restored


def test_a_site_does_not_replace_the_tables(busy: Serving, folder: Path, run: Run) -> None:
    out = folder.parent / "out"
    run("server", "export", "tables", str(folder), "-o", str(out))
    refused = run("server", "export", "site", str(folder), "-o", str(out))
    assert "is not an earlier copy" in refused.err


def test_nothing_is_there_that_is_not_public(busy: Serving, folder: Path, run: Run) -> None:
    out = folder.parent / "out"
    run("server", "export", "tables", str(folder), "-o", str(out))
    text = "".join(path.read_text() for path in out.iterdir())
    assert "we ran its code" in text
    for private in (SECRET, "Red", OWNER, OTHER, "sha256"):
        assert private not in text


def test_a_folder_that_is_not_empty_is_refused(busy: Serving, folder: Path, run: Run) -> None:
    assert "is not empty" in run("server", "export", "tables", str(folder), "-o", str(folder)).err
