"""What a release says of itself is the same everywhere, and its sources are whole."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml
from hatchling.builders.sdist import SdistBuilder
from packaging.requirements import Requirement

from reverie_eval import __version__
from tests.conftest import REPOSITORY

CITATION = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
FORMS = sorted((REPOSITORY / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
KINDS = {"input", "textarea", "markdown"}


def test_the_version_is_the_same_everywhere() -> None:
    changelog = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## (.*)$", changelog, re.MULTILINE)
    # Until the first release, nothing has a date.
    dated = [f"{__version__} - {CITATION['date-released']}"] if "date-released" in CITATION else []
    assert headings[:2] == ["Unreleased", *dated]
    assert CITATION["version"] == __version__
    assert CITATION["license"] == PROJECT["license"]


def test_each_dependency_has_a_lowest_version() -> None:
    optional = [each for group in PROJECT["optional-dependencies"].values() for each in group]
    for requirement in (*PROJECT["dependencies"], *optional):
        assert re.fullmatch(
            r"[a-z0-9-]+(\[\w+\])?>=[0-9.]+(,<[0-9.]+)?(; .+)?|reverie-eval\[[a-z,]+\]", requirement
        )


@pytest.mark.parametrize(
    ("python", "is_allowed"),
    [
        pytest.param("3.10", False, id="one that shapely 2.2 does not support"),
        pytest.param("3.11", False, id="the newest that a numpy before 1.26 supports"),
        pytest.param("3.12", True, id="one that has numpy 1.26 at least"),
    ],
)
def test_an_old_numpy_stays_as_it_is(python: str, *, is_allowed: bool) -> None:
    """Shapely 2.2 refuses it, and pip would replace it, which breaks a torch made for it."""
    named = [each for each in map(Requirement, PROJECT["dependencies"]) if each.name == "shapely"]
    valid = [
        each for each in named if each.marker and each.marker.evaluate({"python_version": python})
    ]
    assert [each.specifier.contains("2.2.0") for each in valid] == [is_allowed]


def test_a_release_is_tried_with_each_declared_python() -> None:
    script = (REPOSITORY / "scripts" / "release").read_text(encoding="utf-8")
    (tried,) = re.findall(r"^for python in (.*); do$", script, re.MULTILINE)
    declared = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert tried.split() == [f"python{version}" for version in declared]
    assert PROJECT["requires-python"] == f">={declared[0]}"


@pytest.mark.parametrize("form", FORMS, ids=lambda path: path.stem)
def test_a_form_for_issues_asks_for_what_it_takes(form: Path) -> None:
    content = yaml.safe_load(form.read_text(encoding="utf-8"))
    if form.stem == "config":
        assert content == {"blank_issues_enabled": True}
        return
    assert {"name", "description", "body"} <= content.keys()
    assert {each["type"] for each in content["body"]} <= KINDS
    labels = [each["attributes"]["label"] for each in content["body"] if each["type"] != "markdown"]
    assert len(labels) == len(set(labels))
    assert any(each.get("validations", {}).get("required") for each in content["body"])


def test_the_source_distribution_has_what_its_tests_need() -> None:
    included = SdistBuilder(str(REPOSITORY)).recurse_included_files()
    names = {Path(each.distribution_path).as_posix() for each in included}
    needed = {"scripts/test", "README.md", "SECURITY.md", "CITATION.cff", "docs/index.md"}
    assert {*needed, ".ci/run"} <= names
    tests = {path.relative_to(REPOSITORY).as_posix() for path in REPOSITORY.glob("tests/**/*.py")}
    assert tests <= names
