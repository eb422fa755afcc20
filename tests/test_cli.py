"""The command line as people and programs meet it: what it prints, where, and its exit status.

Most tests call `main`; what depends on pipes, terminals, shells and start-up runs the installed
command.
"""

import csv
import io
import json
import os
import pty
import re
import shutil
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from reverie_eval import CATALOGUE, GroundTruth, __version__, evaluate
from reverie_eval.ground_truth.compile import compile_split
from reverie_eval.ground_truth.dataset import DatasetFiles
from reverie_eval_cli.main import main
from tests.conftest import SAMPLES, unavailable
from tests.oracle import Scan, Task, Viewpoint, World
from tests.worlds import SPLIT, write_world

COMMAND = Path(sys.executable).with_name("reverie-eval")
BROKEN = SAMPLES / "broken.json"

TUB, SINK = 5, 6
FLAT = World(
    {
        "flat": Scan(
            {
                "door": Viewpoint((0.0, 0.0, 0.0)),
                "hall": Viewpoint((8.0, 0.0, 0.0)),
                "bath": Viewpoint((8.0, 6.0, 0.0), views={TUB: [12], SINK: [13]}),
            },
            frozenset({("door", "hall"), ("hall", "bath")}),
        )
    },
    [Task("7_1", "flat", ["door", "hall", "bath"], TUB, instructions=5)],
)
WALKS = [
    (["door", "hall", "bath"], TUB),  # 14 m, the shortest route
    (["door", "bath", "hall"], SINK),  # 20 m, with a jump and past the goal
    (["door", "hall", "door", "hall", "bath"], TUB),  # 30 m, a detour
    (["door"], -1),  # nowhere
    (["door", "hall", "door", "hall", "door", "bath"], -1),  # 46 m, with a jump at the end
]


class Outcome(NamedTuple):
    """What a command came to."""

    status: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Return what runs the command in this process."""

    def run(*words: str) -> Outcome:
        status = main(words)
        return Outcome(status, *capsys.readouterr())

    return run


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with a dataset, its bundles and a submission."""
    write_world(FLAT, tmp_path / "dataset")
    bundle = compile_split(DatasetFiles.find(SPLIT, tmp_path / "dataset"), SPLIT)
    bundle.save(tmp_path / "full.npz")
    bundle.public().save(tmp_path / "public.npz")
    records = [
        {
            "instr_id": f"7_1_{k}",
            "trajectory": [[place, 0, 0] for place in walk],
            "predObjId": answer,
        }
        for k, (walk, answer) in enumerate(WALKS)
    ]
    (tmp_path / "submit.json").write_text(json.dumps(records))
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def words(line: str) -> list[str]:
    """Split a command line that works in the folder."""
    return line.format(split=f"--split {SPLIT}", full="--ground-truth full.npz").split()


SCORE = words("submit.json {split} {full}")


def fingerprint() -> str:
    """Return the fingerprint of the bundle in the folder."""
    return GroundTruth.load("full.npz").fingerprint


def signature() -> str:
    """Return what every table of the folder's submission is signed with."""
    data = fingerprint()[:12]
    return f"split:{SPLIT}|protocol:official-v1|data:{data}|n:5|version:{__version__}"


# Formats.

NOTE = (
    "note: 2 jumps in 2 episodes: "
    "moves between viewpoints that no edge joins, priced at their shortest distance"
)
TABLE = f"""\
 TL m   SR %  OSR %  SPL %  RGS %  RGSPL %
22.00  60.00  80.00  35.42  40.00    29.33

SIGNATURE
ground truth: full.npz (custom)
{NOTE}
"""
MARKDOWN = f"""\
| TL m | SR % | OSR % | SPL % | RGS % | RGSPL % |
| ---: | ---: | ---: | ---: | ---: | ---: |
| 22.00 | 60.00 | 80.00 | 35.42 | 40.00 | 29.33 |

`SIGNATURE`

ground truth: full.npz (custom)

{NOTE}
"""
LATEX = rf"""% SIGNATURE
% ground truth: full.npz (custom)
% {NOTE}
\begin{{tabular}}{{rrrrrr}}
\toprule
TL m & SR \% & OSR \% & SPL \% & RGS \% & RGSPL \% \\
\midrule
22.00 & 60.00 & 80.00 & 35.42 & 40.00 & 29.33 \\
\bottomrule
\end{{tabular}}
"""


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        pytest.param([], TABLE, id="table without asking"),
        pytest.param(["--format", "table"], TABLE, id="table"),
        pytest.param(["--format", "markdown"], MARKDOWN, id="markdown"),
        pytest.param(["--format", "latex"], LATEX, id="latex"),
    ],
)
def test_tables_for_people(options: list[str], expected: str, run: Run) -> None:
    assert run(*SCORE, *options) == (0, expected.replace("SIGNATURE", signature()), "")


@pytest.mark.usefixtures("here")
def test_json(run: Run) -> None:
    status, out, err = run(*SCORE, "--format", "json")
    assert (status, err) == (0, "")
    assert json.loads(out) == {
        "schema_version": 1,
        "signature": signature(),
        "split": SPLIT,
        "protocol": "official-v1",
        "dataset": "custom",
        "fingerprint": fingerprint(),
        "version": __version__,
        "episodes": 5,
        "scores": dict(evaluate("submit.json", split=SPLIT, ground_truth="full.npz")),
        "notes": [NOTE.removeprefix("note: ")],
    }


@pytest.mark.usefixtures("here")
def test_csv(run: Run) -> None:
    status, out, err = run(*SCORE, "--format", "csv")
    headings, values = csv.reader(io.StringIO(out))
    scores = evaluate("submit.json", split=SPLIT, ground_truth="full.npz")
    assert (status, err) == (0, "")
    assert headings == [*CATALOGUE, "signature"]
    assert [*map(float, values[:-1])] == list(scores.values())
    assert values[-1] == signature()


def test_output_goes_to_a_file(here: Path, run: Run) -> None:
    assert run(*SCORE, "--output", "scores.txt") == (0, "", "")
    assert (here / "scores.txt").read_text() == TABLE.replace("SIGNATURE", signature())


def test_episodes_go_to_a_file_with_all_their_digits(here: Path, run: Run) -> None:
    assert run(*SCORE, "--episodes", "episodes.csv") == run(*SCORE)
    headings, *rows = csv.reader((here / "episodes.csv").read_text().splitlines())
    scores = evaluate("submit.json", split=SPLIT, ground_truth="full.npz")
    assert headings == ["instr_id", *scores.episodes]
    assert [row[0] for row in rows] == list(scores.instr_ids)
    columns = zip(*(row[1:] for row in rows), strict=True)
    expected = [column.tolist() for column in scores.episodes.values()]
    assert [[float(value) for value in column] for column in columns] == expected


# Exit statuses.


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("line", "status", "reason"),
    [
        pytest.param(
            f"{BROKEN} {{split}}", 1, "broken.json: submission rejected", id="broken file"
        ),
        pytest.param(
            f"validate {BROKEN} {{split}}",
            1,
            "broken.json: submission rejected",
            id="validating a broken file",
        ),
        pytest.param(
            "none.json {split}", 2, "reverie-eval: none.json: No such file", id="missing file"
        ),
        pytest.param("folder {split}", 2, "reverie-eval: folder: Is a directory", id="directory"),
        pytest.param(
            "submit.json --split val",
            2,
            "the demo world has no split 'val'; it has test, train, val_seen, val_unseen",
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
    assert title == f"{BROKEN}: submission rejected, {len(problems)} problems"
    assert all(re.match(r"(file|\[\d+\]\S*): ", problem) for problem in problems)


@pytest.mark.parametrize(
    "line",
    [
        pytest.param("", id="nothing"),
        pytest.param("submit.json", id="no split"),
        pytest.param("{split}", id="no submission"),
        pytest.param("submit.json {split} --protocol mine", id="unknown protocol"),
        pytest.param("submit.json {split} --format yaml", id="unknown format"),
        pytest.param("submit.json {split} --verbose", id="unknown option"),
        pytest.param("submit.json {split} validate", id="command at the end"),
        pytest.param("validate submit.json", id="validate without a split"),
        pytest.param("compile dataset {split}", id="compile without an output"),
        pytest.param("completion tcsh", id="unknown shell"),
    ],
)
def test_words_that_make_no_sense(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(words(line))
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith("usage: reverie-eval")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        pytest.param("--version", f"reverie-eval {__version__}\n", id="version"),
        pytest.param("--help", "exit status: 0 done, 1 what was given was rejected", id="help"),
        pytest.param("--help", "\n  validate ", id="commands in help"),
        pytest.param("validate --help", "usage: reverie-eval validate", id="help of a command"),
    ],
)
def test_help(line: str, expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(line.split())
    assert stopped.value.code == 0
    assert expected in capsys.readouterr().out


def test_an_interruption(monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("reverie_eval_cli.commands.score.evaluate", interrupt)
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


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("command", ["", "validate "])
def test_a_dash_is_standard_input(command: str, monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    expected = run(*words(command + "submit.json {split} {full}"))
    with Path("submit.json").open() as file:
        monkeypatch.setattr("sys.stdin", file)
        outcome = run(*words(command + "- {split} {full}"))
    assert outcome.status == 0
    assert outcome.out.replace("-: ", "submit.json: ") == expected.out


# Validating.


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("bundle", ["full.npz", "public.npz"])
def test_validating_needs_no_answers(bundle: str, run: Run) -> None:
    outcome = run(*words(f"validate submit.json {{split}} --ground-truth {bundle}"))
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out.splitlines() == [
        f"submit.json: valid, with a prediction for each of the 5 episodes of {SPLIT}",
        f"ground truth: {bundle} (custom)",
        "note: no object named in 2 of 5 answers",
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
        "notes": ["no object named in 2 of 5 answers", NOTE.removeprefix("note: ")],
    }


@pytest.mark.usefixtures("here")
def test_problems_as_json(run: Run) -> None:
    """They are a result, on standard output: a program has asked for them."""
    Path("wrong.json").write_text("[{}, 7]")
    status, out, err = run(*words("validate wrong.json {split} {full} --format json"))
    report = json.loads(out)
    assert (status, err, report["valid"]) == (1, "", False)
    assert [(problem["code"], problem["where"]) for problem in report["problems"]] == [
        ("missing-episode", "file"),
        ("missing-field", "[0]"),
        ("missing-field", "[0]"),
        ("missing-field", "[0]"),
        ("wrong-type", "[1]"),
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
    assert ("it holds no answers" in out) == is_public == (truth.answers is None)
    assert out.endswith(f"fingerprint {truth.fingerprint}\n")


# The installed command.


def installed(*given: str | Path) -> Outcome:
    """Run the installed command as a process of its own."""
    process = subprocess.run([COMMAND, *given], capture_output=True, text=True, check=False)
    return Outcome(process.returncode, process.stdout, process.stderr)


@pytest.mark.usefixtures("here")
def test_a_pipe_gets_plain_text() -> None:
    assert installed(*SCORE) == (0, TABLE.replace("SIGNATURE", signature()), "")


def test_reasons_and_status_of_the_installed_command() -> None:
    outcome = installed(BROKEN, "--split", SPLIT)
    assert (outcome.status, outcome.out) == (1, "")
    assert outcome.err.startswith(f"{BROKEN}: submission rejected")


@pytest.mark.parametrize(
    "line", ["submit.json {split} {full}", "validate submit.json {split} {full}", "--help"]
)
def test_a_reader_that_has_gone_is_no_failure(line: str, here: Path) -> None:
    """As with `| head -1`, at the worst moment: nobody reads any more when it prints."""
    readable, writable = os.pipe()
    os.close(readable)
    with os.fdopen(writable, "w") as nobody:
        process = subprocess.run(
            [COMMAND, *words(line)], stdout=nobody, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (process.returncode, process.stderr) == (0, "")


def test_python_runs_the_module_alike() -> None:
    module = [sys.executable, "-m", "reverie_eval_cli", "--version"]
    assert subprocess.check_output(module, text=True) == installed("--version").out


HEAVY = ("fastapi", "pandas", "pydantic", "rich", "scipy", "shapely")
LOADED = f"""
import sys
from reverie_eval_cli.main import main
status = main(sys.argv[1:])
print([name for name in {HEAVY} if name in sys.modules], file=sys.stderr)
sys.exit(status)
"""


@pytest.mark.usefixtures("here")
def test_plain_scoring_imports_nothing_heavy() -> None:
    process = subprocess.run(
        [sys.executable, "-c", LOADED, *SCORE], capture_output=True, text=True, check=True
    )
    assert process.stderr == "[]\n"


# Terminals.

ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def on_terminal(columns: int, *given: str) -> str:
    """Run the installed command on a terminal of this width and return what it shows."""
    leader, follower = pty.openpty()
    termios.tcsetwinsize(follower, (24, columns))
    environment = os.environ | {"TERM": "xterm-256color"}
    for name in ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR"):
        environment.pop(name, None)
    with subprocess.Popen(
        [COMMAND, *given], stdin=follower, stdout=follower, stderr=follower, env=environment
    ):
        os.close(follower)
        with os.fdopen(leader, "rb", buffering=0) as screen:
            return _everything(screen).decode().replace("\r\n", "\n")


def _everything(screen: io.FileIO) -> bytes:
    """Read until the other side has closed, which Linux calls an error."""
    shown = b""
    try:
        while chunk := screen.read(4096):
            shown += chunk
    except OSError:
        pass
    return shown


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("columns", [20, 40, 80, 120])
def test_the_table_fits_the_terminal(columns: int) -> None:
    shown = on_terminal(columns, *SCORE)
    table, _, captions = ESCAPES.sub("", shown).partition("split:")
    assert max(map(len, table.splitlines())) <= columns
    assert re.findall(r"\d+\.\d\d", table) == ["22.00", "60.00", "80.00", "35.42", "40.00", "29.33"]
    for heading in ("TL m", "SR %", "OSR %", "SPL %", "RGS %", "RGSPL %"):
        assert heading in table
    assert f"split:{captions.splitlines()[0]}" == signature()


@pytest.mark.usefixtures("here")
def test_only_a_terminal_gets_escape_codes() -> None:
    assert ESCAPES.search(on_terminal(80, *SCORE))
    assert not ESCAPES.search(installed(*SCORE).out)


# Completion.

COMPLETE = """
eval "$(reverie-eval completion bash)"
COMP_LINE=$1 COMP_POINT=${#1} COMP_TYPE=9
_python_argcomplete reverie-eval
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        pytest.param("reverie-eval --sp", {"--split"}, id="option"),
        pytest.param("reverie-eval val", {"validate"}, id="command"),
        pytest.param("reverie-eval validate --sp", {"--split"}, id="option of a command"),
        pytest.param("reverie-eval compile --pu", {"--public"}, id="option of one command only"),
        pytest.param("reverie-eval submit.json --pu", set(), id="not where it is none"),
        pytest.param("reverie-eval submit.json --format la", {"latex"}, id="value of an option"),
        pytest.param("reverie-eval sub", {"submit.json"}, id="file"),
        pytest.param("reverie-eval validate sub", {"submit.json"}, id="file of a command"),
        pytest.param("reverie-eval completion z", {"zsh"}, id="shell"),
    ],
)
def test_completion_in_bash(line: str, expected: set[str], here: Path) -> None:
    bash = shutil.which("bash")
    if not bash:
        unavailable("there is no bash")
    path = f"{COMMAND.parent}{os.pathsep}{os.environ['PATH']}"
    completions = subprocess.check_output(
        [str(bash), "--norc", "-c", COMPLETE, "bash", line],
        text=True,
        env=os.environ | {"PATH": path},
    )
    assert {word.strip() for word in completions.splitlines()} - {""} == expected


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "powershell"])
def test_every_shell_gets_a_script(shell: str, run: Run) -> None:
    status, out, err = run("completion", shell)
    assert (status, err) == (0, "")
    assert "reverie-eval" in out
