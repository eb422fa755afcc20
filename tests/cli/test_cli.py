"""The command line as people and programs meet it: what it prints, where, and its exit status.

Its tables are in ``test_tables.py``; what depends on pipes, terminals, shells and start-up is in
``test_command.py``.
"""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from shlex import quote

import click
import pytest

from reverie_eval import GroundTruth, __version__
from reverie_eval.agents import DEMO_AGENT
from reverie_eval_cli.main import main, program
from tests.conftest import SAMPLES, unavailable
from tests.support.flat_world import NOTE, SCORE, TABLE, Run, signature, words
from tests.support.worlds import SPLIT

BROKEN = SAMPLES / "broken.json"
BROKEN_WORD = quote(str(BROKEN))

# Exit statuses.


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("line", "status", "reason"),
    [
        pytest.param(
            f"{BROKEN_WORD} {{split}}",
            1,
            "broken.json: submission rejected",
            id="broken file",
        ),
        pytest.param(
            f"validate {BROKEN_WORD} {{split}}",
            1,
            "broken.json: submission rejected",
            id="validating a broken file",
        ),
        pytest.param(
            "none.json {split}", 2, "reverie-eval: none.json: No such file", id="missing file"
        ),
        pytest.param(
            "submit.json",
            2,
            "Missing option '--split' / '--report'. Name the split of the file: train, val_seen, "
            "val_unseen or test.",
            id="no split",
        ),
        pytest.param(
            "folder {split}", 2, "reverie-eval: folder: no submission found", id="no file"
        ),
        pytest.param(
            "submit.json --split val",
            2,
            "the demo world has no split 'val'; choose one of: test, train, val_seen, val_unseen",
            id="unknown split",
        ),
        pytest.param(
            "submit.json --split test {full}",
            2,
            "full.npz is the ground truth of val_unseen, not of test",
            id="bundle of another split",
        ),
        pytest.param(
            "submit.json {split} --ground-truth none.npz",
            2,
            "there is no ground truth at none.npz",
            id="missing bundle",
        ),
        pytest.param(
            "submit.json {split} --ground-truth submit.json",
            2,
            "submit.json is not a ground-truth bundle",
            id="no bundle",
        ),
        pytest.param(
            "submit.json {split} --ground-truth dataset",
            2,
            f"`reverie-eval compile dataset --split {SPLIT}",
            id="dataset in place of a bundle",
        ),
        pytest.param(
            "submit.json {split} --ground-truth public.npz",
            2,
            "public.npz is a public bundle",
            id="public bundle",
        ),
        pytest.param(
            "submit.json {split} --ground-truth public.npz --track grounding",
            2,
            "public.npz is a public bundle",
            id="grounding track on a public bundle",
        ),
        pytest.param(
            "submit.json {split} {full} --protocol challenge-2022",
            2,
            "challenge-2022 needs object positions, which full.npz was compiled without",
            id="protocol that the bundle cannot serve",
        ),
        pytest.param(
            "hops.json {split} {full} --diagnose --protocol all",
            2,
            "--protocol all cannot be combined with --diagnose",
            id="diagnosis by all protocols",
        ),
        pytest.param(
            "hops.json {split} {full} --diagnose --track grounding",
            2,
            "--diagnose needs the full track",
            id="diagnosis without trajectories",
        ),
        pytest.param(
            f"{BROKEN_WORD} {{split}} --diagnose",
            1,
            "broken.json: submission rejected",
            id="diagnosing a broken file",
        ),
        pytest.param(
            f"convert {BROKEN_WORD}",
            1,
            "broken.json: submission rejected",
            id="converting it",
        ),
        pytest.param(
            "convert submit.json -o none/new.json",
            2,
            "reverie-eval: none/new.json: No such file or directory",
            id="conversion that cannot be written",
        ),
        pytest.param(
            "run shortest {split} --ground-truth public.npz -o run",
            2,
            "public.npz is a public bundle",
            id="agent on a public bundle",
        ),
        pytest.param(
            "submit.json {split} {full} --output none/scores.txt",
            2,
            "reverie-eval: none/scores.txt: No such file or directory",
            id="output that cannot be written",
        ),
        pytest.param(
            "submit.json {split} {full} --episodes folder",
            2,
            "reverie-eval: folder: Is a directory",
            id="episodes that cannot be written",
        ),
        pytest.param(
            "validate folder {split}",
            2,
            "reverie-eval: folder: is a folder, and not that of a run; name a result file in it",
            id="a folder to validate",
        ),
        pytest.param(
            "compile folder {split} -o new.npz",
            1,
            "reverie-eval: dataset rejected, 3 problems",
            id="no dataset",
        ),
        pytest.param(
            "compile dataset {split} -o none/new.npz",
            2,
            "No such file or directory",
            id="bundle that cannot be written",
        ),
    ],
)
def test_a_reason_goes_to_standard_error(line: str, status: int, reason: str, run: Run) -> None:
    outcome = run(*words(line))
    assert (outcome.status, outcome.out) == (status, "")
    assert reason in outcome.err


@pytest.mark.usefixtures("here")
def test_a_full_disk(run: Run) -> None:
    """Writing fails late, where the error does not know the file any more."""
    if not Path("/dev/full").exists():
        unavailable("there is no /dev/full")
    status, out, err = run(*SCORE, "--output", "/dev/full")
    assert (status, out) == (2, "")
    assert "No space left on device" in err
    assert "None" not in err


def test_every_problem_is_listed_with_its_place(run: Run) -> None:
    title, *problems = run(str(BROKEN), *words("{split}")).err.splitlines()
    listed = [problem for problem in problems if re.match(r"(file|\[\d+\]\S*): ", problem)]
    hidden = [re.fullmatch(r"\.\.\. and (\d+) more \S+", line) for line in problems[len(listed) :]]
    total = len(listed) + sum(int(match[1]) for match in hidden if match)
    assert title == f"{BROKEN}: submission rejected, {total} problems"
    assert all(hidden)


@pytest.mark.parametrize(
    "line",
    [
        pytest.param("submit.json", id="no split"),
        pytest.param("{split}", id="no submission"),
        pytest.param("submit.json {split} --format yaml", id="unknown format"),
        pytest.param("submit.json {split} --track navigation", id="unknown track"),
        pytest.param("submit.json {split} --diagnose twice", id="diagnose takes no value"),
        pytest.param("convert", id="convert nothing"),
        pytest.param("agent {split}", id="no agent"),
        pytest.param("agent perfect {split}", id="unknown agent"),
        pytest.param("agent random {split} --seed lucky", id="seed that is no number"),
        pytest.param("schema dataset", id="unknown schema"),
        pytest.param("submit.json {split} --verbose", id="unknown option"),
        pytest.param("validate submit.json", id="validate without a split"),
        pytest.param("compile dataset {split}", id="compile without an output"),
        pytest.param("completion tcsh", id="unknown shell"),
    ],
)
def test_words_that_make_no_sense(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words(line)) == 2
    out, err = capsys.readouterr()
    assert (out, err.partition(" ")[0]) == ("", "Usage:")


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("line", "suggestion"),
    [
        pytest.param("vaildate submit.json", "Did you mean 'validate'?", id="command"),
        pytest.param("agent shortest", "Did you mean 'run'?", id="word of others"),
        pytest.param("server backpu folder", "Did you mean 'backup'?", id="command of a group"),
        pytest.param("submit.json --protcol x", "Did you mean '--protocol'?", id="option"),
        pytest.param(
            "submit.json {split} --protocol offical-v1", "did you mean official-v1?", id="protocol"
        ),
        pytest.param("submit.json --split valunseen", "did you mean val_unseen?", id="split"),
        pytest.param("leaderboard --metric rgsp", "did you mean rgspl?", id="metric"),
        pytest.param("schema submision", "did you mean submission?", id="schema"),
    ],
)
def test_a_slip_is_answered_with_a_suggestion(line: str, suggestion: str, run: Run) -> None:
    outcome = run(*words(line))
    assert (outcome.status, outcome.out) == (2, "")
    assert suggestion in outcome.err


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        pytest.param("--version", f"reverie-eval {__version__}\n", id="version"),
        pytest.param("--help", "Exit status: 0 done, 1 input rejected", id="help"),
        pytest.param("--help", "\n  validate ", id="commands in help"),
        pytest.param("validate --help", "Usage: reverie-eval validate", id="help of a command"),
        pytest.param("server team add --help", "\nUsage: reverie-eval server team add", id="deep"),
    ],
)
def test_help(line: str, expected: str, run: Run) -> None:
    status, out, err = run(*line.split())
    assert (status, err) == (0, "")
    assert expected in f"\n{out}" if expected.startswith("\n") else expected in out


@pytest.mark.parametrize(
    ("short", "long"),
    [
        pytest.param("", "--help", id="nothing at all"),
        pytest.param("help", "--help", id="help"),
        pytest.param("help help", "--help", id="help of help"),
        pytest.param("-h", "--help", id="-h"),
        pytest.param("help validate", "validate --help", id="help of a command"),
        pytest.param("server", "server --help", id="group alone"),
        pytest.param("server help backup", "server backup --help", id="help within a group"),
        pytest.param("server token", "server token --help", id="group in a group"),
    ],
)
def test_ways_to_ask_for_help(short: str, long: str, run: Run) -> None:
    assert run(*short.split()) == run(*long.split())


def paths_of(command: click.Command, *above: str) -> Iterator[tuple[str, ...]]:
    """List a command and all commands below it, each as the words that call it."""
    yield above
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from paths_of(below, *above, name)


@pytest.mark.parametrize("path", list(paths_of(program)), ids=" ".join)
def test_help_fits_80_columns(
    path: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = run(*path, "--help")
    assert status == 0
    assert max(map(len, out.splitlines())) <= 80
    assert "..." not in out.partition("Options:")[2].replace("]...", "")


def test_an_interruption(monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("reverie_eval.Evaluator.__call__", interrupt)
    assert run("submit.json", *words("{split}")) == (2, "", "reverie-eval: interrupted\n")


# What the words mean.


@pytest.mark.parametrize(
    "line",
    [
        pytest.param("submit.json {split} {full}", id="file first"),
        pytest.param("{split} {full} submit.json", id="options first"),
        pytest.param("{split} submit.json {full}", id="file between"),
        pytest.param("./validate {split} {full}", id="file with the name of a command"),
        pytest.param("{split} {full} validate", id="name of a command, but not the first word"),
    ],
)
def test_ways_to_say_it(line: str, here: Path, run: Run) -> None:
    shutil.copy("submit.json", "validate")
    assert run(*words(line)) == (0, TABLE.replace("SIGNATURE", signature()), "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "between"), [("compare", True), ("compare", False), ("report", True)]
)
def test_files_may_stand_around_options(command: str, *, between: bool, run: Run) -> None:
    first, other = (str(SAMPLES / f"{name}.json") for name in ("good", "mediocre"))
    options = words("{split} --cluster target")
    together = run(command, first, other, *options)
    assert together.status == 0
    apart = [first, *options, other] if between else [*options, first, other]
    assert run(command, *apart) == together


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("command", ["", "validate "])
def test_a_dash_is_standard_input(command: str, monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    expected = run(*words(command + "submit.json {split} {full}"))
    with Path("submit.json").open() as file:
        monkeypatch.setattr("sys.stdin", file)
        outcome = run(*words(command + "- {split} {full}"))
    assert outcome.status == 0
    assert outcome.out.replace("standard input: ", "submit.json: ") == expected.out


# Validating.


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("bundle", ["full.npz", "public.npz"])
def test_validating_needs_no_answers(bundle: str, run: Run) -> None:
    outcome = run(*words(f"validate submit.json {{split}} --ground-truth {bundle}"))
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out.splitlines() == [
        f"submit.json: valid, with a prediction for each of the 5 episodes of {SPLIT}",
        f"ground truth: {bundle} (custom)",
        "note: 2 of 5 answers predict no object",
        NOTE,
    ]


@pytest.mark.usefixtures("here")
def test_a_valid_submission_as_json(run: Run) -> None:
    status, out, err = run(*words("validate submit.json {split} {full} --format json"))
    assert (status, err) == (0, "")
    assert json.loads(out) == {
        "schema_version": 1,
        "split": SPLIT,
        "valid": True,
        "problems": [],
        "notes": ["2 of 5 answers predict no object", NOTE.removeprefix("note: ")],
    }


@pytest.mark.usefixtures("here")
def test_problems_as_json(run: Run) -> None:
    """They are a result, on standard output: a program has asked for them."""
    Path("wrong.json").write_text('[{}, 7, {"predObjId": 5}]')
    status, out, err = run(*words("validate wrong.json {split} {full} --format json"))
    report = json.loads(out)
    assert (status, err, report["valid"]) == (1, "", False)
    assert [(problem["code"], problem["where"]) for problem in report["problems"]] == [
        ("missing-episode", "file"),
        ("missing-field", "[0]"),
        ("missing-field", "[0]"),
        ("missing-field", "[0]"),
        ("wrong-type", "[1]"),
        ("missing-field", "[2]"),
        ("missing-field", "[2]"),
    ]


# Compiling.


@pytest.mark.parametrize(
    ("line", "written", "is_public"),
    [
        pytest.param("compile dataset {split} -o new.npz", "new.npz", False, id="into a file"),
        pytest.param(
            "compile dataset {split} -o folder", f"folder/{SPLIT}.npz", False, id="into a folder"
        ),
        pytest.param("compile dataset {split} -o new.npz --public", "new.npz", True, id="public"),
        pytest.param(
            "compile dataset {split} -o folder --public",
            f"folder/{SPLIT}.public.npz",
            True,
            id="public into a folder",
        ),
        pytest.param(
            "compile {split} -o new.npz --annotations dataset/tasks/REVERIE/data "
            "--boxes dataset/tasks/REVERIE/data/BBoxes.json --connectivity dataset/connectivity",
            "new.npz",
            False,
            id="from files pointed at",
        ),
    ],
)
def test_compiling(line: str, written: str, *, is_public: bool, here: Path, run: Run) -> None:
    status, out, err = run(*words(line))
    truth = GroundTruth.load(here / written)
    assert (status, err) == (0, "")
    assert out.startswith(f"{written}: custom {SPLIT}, 5 episodes, 1 scan")
    assert ("no solution included" in out) == is_public == (truth.solution is None)
    assert out.endswith(f"fingerprint {truth.fingerprint}\n")


def test_compiling_a_sample(here: Path, run: Run) -> None:
    (here / "ids.txt").write_text("\n".join(GroundTruth.load("full.npz").episodes.instr_ids[:2]))
    line = "compile dataset {split} --episodes-from ids.txt -o"
    status, out, err = run(*words(f"{line} some.npz"))
    assert (status, err) == (0, "")
    assert "some.npz: custom val_unseen, 5 episodes, 1 scan" in out
    assert "\nscores a sample of 2 episodes\n" in out
    scored = run(*words("submit.json {split} --ground-truth"), "some.npz")
    assert scored == run(*words("submit.json {split} {full} --episodes-from ids.txt"))._replace(
        out=scored.out
    )
    assert "|subset:" in scored.out
    for folder in ("folder", "new/"):
        assert "name the file, as the split has another" in run(*words(f"{line} {folder}")).err
    assert not Path("new").exists()


# Converting, agents and schemas are tried in full elsewhere; here, how they are called.


@pytest.mark.usefixtures("here")
def test_a_converted_file_scores_the_same(run: Run) -> None:
    status, out, err = run(*words("convert hops.json -o converted.json"))
    assert (status, out) == (0, "")
    assert err.startswith("hops.json: read as: 3 trajectories of nested hops; ")
    assert run(*words("converted.json {split} {full}")).out.startswith(
        TABLE.partition("SIGNATURE")[0]
    )


@pytest.mark.usefixtures("here")
def test_converting_prints_where_no_file_is_named(run: Run) -> None:
    status, out, err = run("convert", "submit.json")
    assert (status, err) == (0, "")
    assert json.loads(out) == [
        {**record, "trajectory": [[place, 0.0, 0.0] for place, _, _ in record["trajectory"]]}
        for record in json.loads(Path("submit.json").read_text())
    ]


# Completion.


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "powershell"])
def test_every_shell_gets_a_script(shell: str, run: Run) -> None:
    status, out, err = run("completion", shell)
    assert (status, err) == (0, "")
    assert "reverie-eval" in out


def test_demo_writes_the_samples_into_a_new_folder(tmp_path: Path, run: Run) -> None:
    folder = tmp_path / "samples"
    assert run("demo", str(folder)).status == 0
    for original in SAMPLES, DEMO_AGENT:
        at = folder if original == SAMPLES else folder / DEMO_AGENT.name
        written = {path.name: path.read_bytes() for path in at.iterdir() if path.is_file()}
        assert written == {path.name: path.read_bytes() for path in original.iterdir()}
    again = run("demo", str(folder))
    assert (again.status, again.out) == (2, "")
    assert f"{folder} is not empty; name a new folder" in again.err
