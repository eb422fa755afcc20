"""What is public: the names of the package, and the files of the distribution."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZipFile

import mypy.api
import pytest
from hatchling.build import build_wheel

import reverie_eval
from tests.conftest import REPOSITORY

NAMES = [
    "CATALOGUE",
    "PROTOCOLS",
    "Comparison",
    "DatasetError",
    "Evaluator",
    "GroundTruth",
    "GroundTruthError",
    "Problem",
    "ProtocolError",
    "RejectedError",
    "ReverieEvalError",
    "Runs",
    "ScoredFiles",
    "Scores",
    "SubmissionError",
    "SubsetError",
    "Sweep",
    "Validation",
    "__version__",
    "compare",
    "diagnose",
    "evaluate",
    "evaluate_many",
    "evaluate_protocols",
    "plan",
    "published_results",
    "sweep",
    "validate",
]
"""All names that notebooks use. Removing one breaks users' code."""


def test_the_names_of_the_package() -> None:
    assert reverie_eval.__all__ == NAMES


def test_every_public_name_can_be_imported() -> None:
    namespace: dict[str, object] = {}
    exec("from reverie_eval import *", namespace)
    assert namespace.keys() - {"__builtins__"} == set(NAMES)


def test_completion_offers_these_names() -> None:
    assert dir(reverie_eval) == sorted(NAMES)


def test_a_misspelt_name_is_found_by_a_type_checker(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text("import reverie_eval as rv\n\nrv.compare\nrv.evalute\n")
    package = str(REPOSITORY / "reverie_eval" / "__init__.py")
    options = ["--follow-imports=skip", f"--cache-dir={tmp_path}"]
    found, _, status = mypy.api.run([*options, package, str(script)])
    assert status == 1
    assert found.splitlines()[0].endswith(
        'script.py:4: error: Module has no attribute "evalute"; maybe "evaluate"?  [attr-defined]'
    )


@pytest.mark.parametrize("name", NAMES)
def test_every_public_class_and_function_has_a_docstring(name: str) -> None:
    value = getattr(reverie_eval, name)
    assert not callable(value) or value.__doc__


@pytest.mark.parametrize("name", ["cli", "tests", "fixtures", "benchmarks"])
def test_the_repository_is_not_importable(name: str, tmp_path: Path) -> None:
    """`import cli` must fail: other packages may want such common names."""
    process = subprocess.run(
        [sys.executable, "-c", f"import {name}"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={},
    )
    assert f"No module named '{name}'" in process.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ZipFile]:
    """Build the wheel of this working copy."""
    folder = tmp_path_factory.mktemp("wheel")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(REPOSITORY)
        name = build_wheel(str(folder))
    with ZipFile(folder / name) as archive:
        yield archive


def test_the_wheel_contains_exactly_these_top_level_names(wheel: ZipFile) -> None:
    assert {name.partition("/")[0] for name in wheel.namelist()} == {
        "reverie_eval",
        "reverie_eval_cli",
        f"reverie_eval-{reverie_eval.__version__}.dist-info",
    }


@pytest.mark.parametrize(
    "package", [Path("reverie_eval"), Path("cli", "reverie_eval_cli")], ids=lambda path: path.name
)
def test_the_wheel_contains_all_files_of_a_package(package: Path, wheel: ZipFile) -> None:
    folder = REPOSITORY / package
    expected = {
        path.relative_to(folder.parent).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {name for name in wheel.namelist() if name.startswith(f"{package.name}/")} == expected


@pytest.mark.parametrize(
    "name",
    [
        "reverie_eval/py.typed",
        "reverie_eval_cli/py.typed",
        "reverie_eval/ground_truth/demo/train.npz",
        "reverie_eval/ground_truth/demo/val_seen.npz",
        "reverie_eval/ground_truth/demo/val_unseen.npz",
        "reverie_eval/ground_truth/demo/test.public.npz",
        "reverie_eval/ground_truth/demo/private/test.npz",
        f"reverie_eval-{reverie_eval.__version__}.dist-info/licenses/LICENSE",
    ],
)
def test_the_wheel_contains_data_files(name: str, wheel: ZipFile) -> None:
    assert name in wheel.namelist()


def test_links_of_the_description_lead_to_a_host(wheel: ZipFile) -> None:
    metadata = wheel.read(f"reverie_eval-{reverie_eval.__version__}.dist-info/METADATA").decode()
    links = re.findall(r"\]\(([^)]+)\)", metadata)
    assert len(links) > 10
    assert [link for link in links if not link.startswith("https://")] == []


def test_the_wheel_installs_the_command(wheel: ZipFile) -> None:
    entry_points = wheel.read(f"reverie_eval-{reverie_eval.__version__}.dist-info/entry_points.txt")
    assert b"reverie-eval = reverie_eval_cli.__main__:run" in entry_points


IMPORTED = """
import sys
own = set(sys.modules)
import reverie_eval
names = {name.partition(".")[0] for name in sys.modules.keys() - own if "cython" not in name}
alias = "__mp_main__"  # multiprocessing's name of the main module
print(sorted(names - sys.stdlib_module_names - {alias, "typing_extensions"}))
"""


def test_the_import_brings_numpy_and_msgspec_alone() -> None:
    """Beside another project's packages, nothing that could be in their way."""
    printed = subprocess.check_output([sys.executable, "-c", IMPORTED], text=True)
    assert printed == "['msgspec', 'numpy', 'reverie_eval']\n"


def test_the_python_of_readme_runs_where_the_wheel_is_installed(
    wheel: ZipFile, beside_the_demo: Path, tmp_path: Path
) -> None:
    wheel.extractall(tmp_path)
    readme = (REPOSITORY / "README.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    program = [sys.executable, "-c", f"{block}\nprint(rv.__file__)"]
    environment = {"PYTHONPATH": str(tmp_path), "HOME": str(tmp_path)}
    printed = subprocess.check_output(program, cwd=beside_the_demo, env=environment, text=True)
    assert printed == f"{tmp_path}/reverie_eval/__init__.py\n"


def test_examples_in_docstrings_run_where_the_wheel_is_installed(
    wheel: ZipFile, beside_the_demo: Path, tmp_path: Path
) -> None:
    """Examples that read files; the suite runs all examples in the repository."""
    wheel.extractall(tmp_path)
    modules = [path for path in tmp_path.rglob("*.py") if '("demo/' in path.read_text()]
    assert modules
    command = f"-m pytest --quiet --doctest-modules --import-mode=importlib --rootdir {tmp_path}"
    subprocess.run(
        [sys.executable, *command.split(), "-c", "/dev/null", *modules],
        cwd=beside_the_demo,
        env={"PYTHONPATH": str(tmp_path), "HOME": str(tmp_path)},
        check=True,
    )
