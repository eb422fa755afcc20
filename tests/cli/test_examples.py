"""The examples run as they stand, each in a folder of its own, and what they log can be read back.

Notebooks run in a kernel as Jupyter's does, every warning an error.
"""

import ast
import json
import os
import re
import shutil
import sqlite3
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias

import pytest

import reverie_eval as rv
from reverie_eval_cli.main import main
from tests.conftest import REPOSITORY, SAMPLES, unavailable

EXAMPLES = REPOSITORY / "examples"
DAY = REPOSITORY / "docs" / "tutorials" / "day.ipynb"
"""The notebook whose outputs are kept, for readers who do not run it."""
NOTEBOOKS = [DAY, *sorted(EXAMPLES.glob("*.ipynb"))]
EPOCHS = ["mediocre", "drawn", "good"]
PYENV = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
MINUTES = 60

Outputs: TypeAlias = Sequence[Mapping[str, Any]]

every_notebook = pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda file: file.stem)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Lay out what a reader has who takes the examples, and writes the samples beside them."""
    shutil.copytree(EXAMPLES, tmp_path / "examples", ignore=shutil.ignore_patterns("[!a-z]*"))
    tutorials = tmp_path / DAY.parent.relative_to(REPOSITORY)
    tutorials.mkdir(parents=True)
    shutil.copy(DAY, tutorials)
    for beside in (tmp_path / "examples", tutorials):
        main(["demo", str(beside / "demo")])
    monkeypatch.setenv("HOME", str(tmp_path))  # where kernels and loggers keep their settings
    return tmp_path / "examples"


# Notebooks.


def test_there_are_notebooks() -> None:
    names = {notebook.stem for notebook in NOTEBOOKS}
    assert names >= {"day", "score_and_explore", "write_a_submission"}


@every_notebook
def test_a_notebook_runs(notebook: Path, folder: Path) -> None:
    if not (find_spec("nbclient") and find_spec("ipykernel")):
        unavailable("nbclient and ipykernel are not installed")
    source = notebook.read_text()
    shown = execute(folder.parent / notebook.relative_to(REPOSITORY))
    drawn = len(re.findall(r"\.plot\.\w+\(|\.plot\(\)|plot_curve\(", source))
    assert json.dumps(shown).count('"image/png"') == drawn
    if notebook == DAY:  # `scripts/notebook` keeps what it shows now
        assert text_of(shown) == text_of(outputs_of(notebook))


def text_of(outputs: Outputs) -> str:
    """Return what outputs show as text; pictures depend on matplotlib's version.

    All in one, because a kernel sends what a cell prints in as many pieces as it takes time.
    """
    return "".join("".join(each.get("text") or each["data"]["text/plain"]) for each in outputs)


def execute(notebook: Path) -> Outputs:
    """Run a notebook in its folder as Jupyter's own command does; return what its cells show."""
    document = json.loads(notebook.read_text())
    begin, end = map(code_cell, ("simplefilter('error')", "resetwarnings()"))
    document["cells"] = [begin, *document["cells"], end]
    notebook.write_text(json.dumps(document))
    jupyter = Path(sys.executable).with_name("jupyter-execute")
    process = subprocess.run(
        [jupyter, "--inplace", f"--timeout={20 * MINUTES}", notebook.name],
        cwd=notebook.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return outputs_of(notebook)


def outputs_of(notebook: Path) -> Outputs:
    """Return the outputs that a notebook is stored with."""
    cells = json.loads(notebook.read_text())["cells"]
    return [output for cell in cells for output in cell.get("outputs", ())]


def code_cell(call: str) -> dict[str, object]:
    """Return a cell that says what is to become of warnings."""
    source = f"import warnings; warnings.{call}"
    empty: dict[str, object] = {"execution_count": None, "metadata": {}, "outputs": []}
    return {"cell_type": "code", "id": call[:5], "source": source, **empty}


@every_notebook
def test_a_notebook_is_stored_without_what_it_showed(notebook: Path) -> None:
    """But for one, which shows nothing of the machine that it ran on."""
    if notebook == DAY:
        assert tempfile.gettempdir() not in notebook.read_text()
        assert str(REPOSITORY) not in notebook.read_text()
        assert notebook.stat().st_size < 200_000
        return
    cells = json.loads(notebook.read_text())["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code)
    assert notebook.stat().st_size < 20_000


@every_notebook
def test_a_notebook_begins_with_what_it_is_about(notebook: Path) -> None:
    first = json.loads(notebook.read_text())["cells"][0]
    assert first["cell_type"] == "markdown"
    assert first["source"][0].startswith("# ")


# Loggers.


@pytest.fixture(scope="module")
def expected() -> list[Mapping[str, float]]:
    """Score what the example's loop yields, epoch after epoch."""
    files = [SAMPLES / f"{name}.json" for name in EPOCHS]
    return [rv.evaluate(file, split="val_unseen").to_dict() for file in files]


def log_to(name: str, module: str, folder: Path) -> None:
    """Run the example for one logger, which is to tell nobody how it is used."""
    if not find_spec(module):
        unavailable(f"{module} is not installed (the dependency group `loggers`)")
    quiet = {
        "MLFLOW_DISABLE_TELEMETRY": "true",
        "WANDB_ERROR_REPORTING": "false",
        "WANDB_SILENT": "true",
    }
    subprocess.run(
        [sys.executable, "loggers.py", name],
        cwd=folder,
        env=os.environ | quiet,
        check=True,
        capture_output=True,
        timeout=20 * MINUTES,
    )


def test_tensorboard(folder: Path, expected: list[Mapping[str, float]]) -> None:
    log_to("tensorboard", "tensorboardX", folder)
    logged: list[dict[str, float]] = [{} for _ in EPOCHS]
    (file,) = (folder / "runs" / "my-agent").iterdir()
    for step, tag, value in scalars_of(file):
        logged[step][tag.removeprefix("val_unseen/")] = value
    for found, epoch in zip(logged, expected, strict=True):
        assert found == pytest.approx(epoch, rel=1e-6)  # TensorBoard keeps 32 bits


def scalars_of(file: Path) -> Iterator[tuple[int, str, float]]:
    """Read an event file: records of a length, its checksum, the content and its checksum."""
    from tensorboardX.proto.event_pb2 import Event

    content, position = file.read_bytes(), 0
    while position < len(content):
        (length,) = struct.unpack_from("<Q", content, position)
        event = Event.FromString(content[position + 12 : position + 12 + length])
        position += length + 16
        for value in event.summary.value:
            if value.HasField("simple_value"):
                yield event.step, value.tag, value.simple_value


def test_mlflow(folder: Path, expected: list[Mapping[str, float]]) -> None:
    log_to("mlflow", "mlflow", folder)
    logged: list[dict[str, float]] = [{} for _ in EPOCHS]
    database = sqlite3.connect(folder / "mlflow.db")
    try:
        rows = database.execute("SELECT step, key, value FROM metrics").fetchall()
        tags = dict(database.execute("SELECT key, value FROM tags").fetchall())
    finally:
        database.close()
    for step, key, value in rows:
        logged[step][key.removeprefix("val_unseen/")] = value
    assert logged == expected
    assert tags["val_unseen/signature"].startswith("split:val_unseen|protocol:official-v1|data:")


def test_wandb(folder: Path, expected: list[Mapping[str, float]]) -> None:
    """Its file is a log of records; names and numbers stand in it as text."""
    log_to("wandb", "wandb", folder)
    (file,) = (folder / "wandb").glob("offline-run-*/*.wandb")
    content = file.read_bytes()
    for epoch in expected:
        for name, value in epoch.items():
            written = rb"%s.{1,9}%s" % (
                re.escape(f"val_unseen/{name}".encode()),
                re.escape(json.dumps(value).removesuffix(".0").encode()),
            )
            assert re.search(written, content, re.DOTALL), name


# Another Python, which has no package of ours.

OLD = """
import json, sys
from score_from_old_python import evaluate

with open(sys.argv[1]) as file:
    records = json.load(file)
print(json.dumps(evaluate(records, split="val_unseen", protocol="paper")))
records[0]["trajectory"] = []
try:
    evaluate(records, split="val_unseen")
except ValueError as rejected:
    print(str(rejected).count("[0].trajectory: "))
"""


def old_python() -> str:
    """Return a Python 3.8, or skip the test: few machines have one."""
    for found in (*PYENV.glob("versions/3.8.*/bin/python"), shutil.which("python3.8")):
        if found and not subprocess.run([found, "-c", ""], check=False, stderr=-1).returncode:
            return str(found)
    pytest.skip("there is no Python 3.8")


def test_what_runs_in_an_old_python_is_old_python() -> None:
    code = (EXAMPLES / "score_from_old_python.py").read_text()
    ast.parse(code, feature_version=(3, 6))


def test_a_python_that_is_too_old_scores_by_the_command(folder: Path) -> None:
    sample = SAMPLES / "good.json"
    said = subprocess.check_output(
        [old_python(), "-c", OLD, str(sample)],
        cwd=folder,
        env={
            **os.environ,
            "REVERIE_EVAL_COMMAND": str(Path(sys.executable).with_name("reverie-eval")),
        },
        text=True,
    )
    report, rejections = said.splitlines()
    scores = rv.evaluate(sample, split="val_unseen", protocol="paper")
    assert json.loads(report) == scores.to_report().model_dump(mode="json")
    assert int(rejections) == 1


def test_each_task_of_a_job_array_scores_a_file(folder: Path) -> None:
    runs = folder / "my runs"
    runs.mkdir()
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    for name in ("good", "mediocre"):
        shutil.copy(SAMPLES / f"{name}.json", runs)
    for task, name in enumerate(("good", "mediocre")):
        subprocess.run(
            ["bash", "score_each.sbatch", "my runs/*.json", "val_unseen"],
            cwd=folder,
            env={**os.environ, "PATH": path, "SLURM_ARRAY_TASK_ID": str(task)},
            check=True,
        )
        scores = rv.evaluate(SAMPLES / f"{name}.json", split="val_unseen")
        assert json.loads((runs / f"{name}.scores").read_text())["scores"] == scores.to_dict()
