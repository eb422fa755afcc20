"""The installed command as a process of its own: pipes, start-up, terminals, completion."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from reverie_eval_cli.main import COMPLETION_VARIABLE
from tests.conftest import COMMAND, SAMPLES, unavailable
from tests.support.flat_world import NOTE, SCORE, Outcome, Run, signature, words
from tests.support.forking import Forked, Surroundings, command, run_command
from tests.support.terminals import ESCAPES, on_terminal
from tests.support.worlds import SPLIT

BROKEN = SAMPLES / "broken.json"

# The installed command.


def installed(*given: str | Path) -> Outcome:
    """Run the installed command as a process of its own."""
    process = subprocess.run([COMMAND, *given], capture_output=True, text=True, check=False)
    return Outcome(process.returncode, process.stdout, process.stderr)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("options", [[], ["--protocol", "all"], ["--diagnose"]], ids=" ".join)
def test_a_pipe_gets_what_a_file_gets(options: list[str], run: Run) -> None:
    outcome = installed(*SCORE, *options)
    assert outcome == run(*SCORE, *options)
    assert outcome.out.endswith(f"{NOTE}\n")


def test_reasons_and_status_of_the_installed_command() -> None:
    outcome = installed(BROKEN, "--split", SPLIT)
    assert (outcome.status, outcome.out) == (1, "")
    assert outcome.err.startswith(f"{BROKEN}: submission rejected")


@pytest.mark.parametrize(
    "line",
    [
        "submit.json {split} {full}",
        "validate submit.json {split} {full}",
        "convert submit.json",
        "schema submission",
        "--help",
        "--version",
        "server backup --help",
        "completion bash",
    ],
)
@pytest.mark.parametrize("variables", [{}, {"PYTHONUNBUFFERED": "1"}], ids=["", "unbuffered"])
def test_a_closed_pipe_ends_a_command_quietly(
    line: str, variables: Mapping[str, str], here: Path
) -> None:
    """As with `| head -1`, at the worst moment: the reader is gone before anything is printed."""
    readable, writable = os.pipe()
    os.close(readable)
    usual = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    said = here / "said"
    said.touch()
    with Connection(writable) as nobody:
        surroundings = Surroundings(here, {**usual, **variables}, nobody, said)
        status = Forked(command, surroundings, *words(line)).wait()
    assert (status, said.read_text()) == (0, "")


@pytest.mark.parametrize(
    ("line", "status"),
    [
        pytest.param(["vaildate"], 2, id="usage"),
        pytest.param(["none.json", "--split", SPLIT], 2, id="no file"),
        pytest.param(["validate", str(BROKEN), "--split", SPLIT], 1, id="rejected"),
        pytest.param(["run", "stop", "--split", SPLIT, "-o", "run"], 0, id="notes"),
    ],
)
@pytest.mark.parametrize("errors", ["a full disk", "a closed pipe"])
def test_reasons_that_cannot_be_written_change_no_status(
    line: Sequence[str], status: int, errors: str, tmp_path: Path
) -> None:
    readable, writable = os.pipe()
    os.close(readable)
    if errors == "a full disk":
        if not Path("/dev/full").exists():
            unavailable("there is no /dev/full")
        full = os.open("/dev/full", os.O_WRONLY)
        os.dup2(full, writable)
        os.close(full)
    with Connection(writable) as nobody:
        surroundings = Surroundings(tmp_path, dict(os.environ), tmp_path / "printed", nobody)
        assert Forked(command, surroundings, *line).wait() == status
    assert ("ground truth: " in (tmp_path / "printed").read_text()) == (status == 0)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("closed", "line", "status"),
    [
        pytest.param(">&-", SCORE, 0, id="no output"),
        pytest.param("2>&-", ["score", "none.json", "--split", SPLIT], 2, id="no errors"),
        pytest.param("<&- >&- 2>&-", SCORE, 0, id="nothing"),
    ],
)
def test_streams_that_the_shell_closed_are_not_missed(
    closed: str, line: Sequence[str], status: int
) -> None:
    script = f'exec "$0" "$@" {closed}'
    command = ["sh", "-c", script, str(COMMAND), *line]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (process.returncode, process.stdout, process.stderr) == (status, "", "")


@pytest.mark.parametrize("module", ["reverie_eval", "reverie_eval_cli"])
def test_python_runs_the_module_alike(module: str) -> None:
    command = [sys.executable, "-m", module, "--version"]
    assert subprocess.check_output(command, text=True) == installed("--version").out


HEAVY = (
    *("fastapi", "pandas", "pydantic", "rich", "scipy", "shapely", "email.message"),
    *("multiprocessing", "reverie_eval.agents", "reverie_eval.analysis"),
)
LOADED = f"""
import sys
from reverie_eval_cli.main import main
status = main(sys.argv[1:])
print([name for name in {HEAVY} if name in sys.modules], file=sys.stderr)
sys.exit(status)
"""


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    "words",
    [SCORE, [*SCORE, "--protocol", "all"], [*SCORE, "--diagnose"], ["train", "--help"]],
    ids=" ".join,
)
def test_what_needs_little_imports_nothing_heavy(words: list[str]) -> None:
    process = subprocess.run(
        [sys.executable, "-c", LOADED, *words], capture_output=True, text=True, check=True
    )
    assert process.stderr == "[]\n"


# Terminals.


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
@pytest.mark.parametrize("columns", [24, 40, 80, 120])
def test_several_rows_fit_the_terminal(columns: int) -> None:
    shown = on_terminal(columns, *words("afar.json {split} {full} --protocol all"))
    table, _, captions = ESCAPES.sub("", shown).partition("* differs from official-v1")
    assert max(map(len, table.splitlines())) <= columns
    assert re.findall(r"60\.00|49\.33|40\.00\*|29\.33\*", table).count("40.00*") == 2
    assert all(table.count(rules) == 1 for rules in ("official-v1", "paper", "r2r-style"))
    assert signature("r2r-style") in captions


@pytest.mark.usefixtures("here")
def test_only_a_terminal_gets_escape_codes() -> None:
    assert ESCAPES.search(on_terminal(80, *SCORE))
    assert not ESCAPES.search(installed(*SCORE).out)


# Completion.

FILES = "files"
"""What the shell itself completes."""


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        pytest.param("reverie-eval --sp", {"--split"}, id="option"),
        pytest.param("reverie-eval val", {"validate"}, id="command"),
        pytest.param("reverie-eval validate --sp", {"--split"}, id="option of a command"),
        pytest.param("reverie-eval compile --pu", {"--public"}, id="option of one command only"),
        pytest.param("reverie-eval submit.json --pu", set(), id="not an option of score"),
        pytest.param("reverie-eval submit.json --split val_u", {"val_unseen"}, id="split"),
        pytest.param("reverie-eval server to", {"token"}, id="command of a group"),
        pytest.param("reverie-eval server token rev", {"revoke"}, id="command of a group below"),
        pytest.param("reverie-eval submit.json --format la", {"latex"}, id="value of an option"),
        pytest.param(
            "reverie-eval submit.json --protocol pa", {"paper", "paper-3m"}, id="protocol"
        ),
        pytest.param("reverie-eval submit.json --track gr", {"grounding"}, id="track"),
        pytest.param("reverie-eval con", {"convert"}, id="another command"),
        pytest.param("reverie-eval run random --se", {"--seed"}, id="option of a run"),
        pytest.param("reverie-eval schema sub", {"submission"}, id="schema"),
        pytest.param("reverie-eval sub", {"submit", "subset", "submit.json"}, id="command or file"),
        pytest.param("reverie-eval validate sub", {FILES}, id="file of a command"),
        pytest.param("reverie-eval completion z", {"zsh"}, id="shell"),
    ],
)
def test_completion(line: str, expected: set[str], here: Path) -> None:
    """As bash asks for it."""
    last = str(len(line.split()) - 1)
    asking = {COMPLETION_VARIABLE: "bash_complete", "COMP_WORDS": line, "COMP_CWORD": last}
    told = run_command(folder=here, environment=os.environ | asking).out
    completions = [completion.split(",") for completion in told.split()]
    assert {word if kind == "plain" else FILES for kind, word in completions} == expected


BASH = """
eval "$SCRIPT"
compopt() { COMPREPLY+=($(compgen -f -- "${COMP_WORDS[COMP_CWORD]}")); }
read -ra COMP_WORDS <<< "$1"
COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
_reverie_eval_completion reverie-eval "${COMP_WORDS[COMP_CWORD]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.usefixtures("here")
def test_bash_completes_commands_and_files() -> None:
    bash = shutil.which("bash")
    if not bash:
        unavailable("there is no bash")
    path = f"{COMMAND.parent}{os.pathsep}{os.environ['PATH']}"
    completions = subprocess.check_output(
        [bash, "--norc", "-c", BASH, "bash", "reverie-eval sub"],
        text=True,
        env=os.environ | {"PATH": path, "SCRIPT": installed("completion", "bash").out},
    )
    assert {word.strip() for word in completions.splitlines()} == {
        *("submit", "subset", "submit.json")
    }
