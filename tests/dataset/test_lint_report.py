"""The command ``reverie-eval lint``: exit status, tables and JSON."""

import io
import json
import re
from pathlib import Path

import pytest
from pydantic import TypeAdapter
from rich.console import Console

from reverie_eval.dataset import DatasetFiles, LintReport, lint_dataset
from reverie_eval.reporting.datasets import lint_printout
from reverie_eval_cli.output import print_parts
from tests.support.broken_datasets import DATA, listed, write_published_flat
from tests.support.flat_world import TUB, Run


@pytest.fixture
def flat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with the flat's published files."""
    write_published_flat(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


HIDDEN_TARGET = listed(key=TUB, visible_pos=[], bbox2d=[])


def test_a_sound_dataset_in_a_pipe(flat: Path, run: Run) -> None:
    status, out, err = run("lint", ".")
    assert (status, err) == (0, "")
    sections = out.split("\n\n")
    assert sections[0].splitlines() == [
        "files",
        "    code            number  of  %  description",
        "    files                5         files read",
        "ok  malformed-file       0   5     files that do not have the published form",
        "ok  duplicate-key        0         keys that occur twice in one JSON object",
    ]
    assert sections[1].splitlines()[-2:] == [
        "code         number  min   5 %  median  mean  95 %  max  description",
        "edge-length       2    6  6.10       7     7  7.90    8  length of the edges, m",
    ]
    assert sections[-1] == "passed: 23 checks, no errors, 0 warnings\n"


def test_an_error_is_shown_with_advice_and_examples(flat: Path, run: Run) -> None:
    HIDDEN_TARGET(flat)
    status, out, err = run("lint", ".")
    assert (status, err) == (1, "")
    assert out.endswith(
        "\n\nerror target-not-visible, annotations of val_unseen: 1 of 1 items whose target is "
        "listed where the path ends, but not visible in any view\n"
        "Annotations and boxes are probably from different releases (v2 annotations of val_seen "
        "with v1 boxes give 3 of 501): fetch both from the same one.\n"
        "  7_1\n\n"
        "failed: 1 of 23 checks found errors, 2 warnings\n"
    )
    marks = {code: mark for mark, code in re.findall(r"^(\w+) +([a-z-]+) ", out, re.MULTILINE)}
    assert marks["target-not-visible"] == "error"
    assert (marks["never-visible"], marks["target-not-listed"]) == ("warning", "ok")


@pytest.mark.usefixtures("flat")
def test_more_faults_than_are_shown(run: Run) -> None:
    for number in range(5):
        Path(DATA, "BBox", f"flat_attic{number}.json").write_text(f'{{"attic{number}": {{}}}}')
    _, out, _ = run("lint", ".")
    assert "  flat_attic0\n  flat_attic1\n  flat_attic2\n  and 2 more\n" in out


def test_json_is_the_report_that_the_library_gives(flat: Path, run: Run) -> None:
    HIDDEN_TARGET(flat)
    status, out, err = run("lint", ".", "--format", "json")
    assert (status, err) == (1, "")
    report = lint_dataset(DatasetFiles.find(flat))
    assert json.loads(out) == TypeAdapter(LintReport).dump_python(report, mode="json")
    assert not report.sound
    sections = json.loads(out)["sections"]
    (found,) = [
        count["found"]
        for section in sections
        if section["split"] == "val_unseen"
        for count in section["counts"]
        if count["code"] == "target-not-visible"
    ]
    assert found == {"number": 1, "of": 1, "examples": ["7_1"]}


@pytest.mark.usefixtures("flat")
def test_files_at_other_paths(run: Run) -> None:
    elsewhere = ["--annotations", DATA, "--boxes", DATA / "BBox", "--connectivity", "connectivity"]
    assert run("lint", *map(str, elsewhere)) == run("lint", ".")


@pytest.mark.parametrize(
    ("words", "reasons"),
    [
        pytest.param(["nowhere"], ["REVERIE_*.json", "BBox", "nowhere/connectivity"], id="all"),
        pytest.param(
            ["--annotations", "connectivity"],
            ["the folder has flat_connectivity.json; name the file with --annotations"],
            id="another folder",
        ),
        pytest.param([".", "--boxes", "nowhere"], ["nowhere: no boxes found"], id="boxes"),
        pytest.param(
            [".", "--annotations", "connectivity"],
            ["connectivity/REVERIE_*.json"],
            id="items",
        ),
        pytest.param(
            [".", "--object-positions", "nowhere"], ["nowhere: no object-positions"], id="positions"
        ),
        pytest.param([], ["annotations: no annotations found"], id="nothing given"),
    ],
)
@pytest.mark.usefixtures("flat")
def test_missing_files(words: list[str], reasons: list[str], run: Run) -> None:
    status, out, err = run("lint", *words)
    assert (status, out) == (2, "")
    assert all(reason in err for reason in reasons)


@pytest.mark.parametrize("columns", [60, 80, 160])
def test_the_tables_fit_the_terminal(columns: int, flat: Path) -> None:
    HIDDEN_TARGET(flat)
    screen = io.StringIO()
    print_parts(
        Console(file=screen, width=columns, force_terminal=True, color_system=None),
        lint_printout(lint_dataset(DatasetFiles.find(flat))).parts(),
    )
    shown = screen.getvalue()
    assert max(map(len, shown.splitlines())) <= columns
    for word in ("target-not-visible", "boxes-of-excluded-viewpoint", "failed: 1 of 23"):
        assert word in shown
