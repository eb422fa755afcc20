"""The page about the architecture names what exists."""

import pkgutil
import re
import sys
import tomllib

import pytest

from reverie_eval import evaluate
from tests.conftest import FOLDERS_THAT_SHARE, REPOSITORY, SHARED_FIXTURES

PAGE = (REPOSITORY / "docs" / "explanation" / "architecture.md").read_text()
NAMES = re.findall(r"`((?:\w+\.)+\w+)`", PAGE.partition("## The path")[2].partition("## A new")[0])


def contracts() -> dict[str, list[str]]:
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    found = settings["tool"]["importlinter"]["contracts"]
    return {each["name"]: each["layers"] for each in found if "layers" in each}


PICTURES = dict(zip(contracts(), PAGE.split("```")[1::2], strict=False))


@pytest.mark.parametrize("name", contracts())
def test_the_picture_shows_the_rooms_of_the_contract(name: str) -> None:
    for layer in contracts()[name]:
        rooms = [room for room in layer.split(" | ") if room != "__main__"]
        if rooms:
            assert any(set(rooms) <= set(line.split()) for line in PICTURES[name].splitlines())


@pytest.mark.parametrize(
    "name", [name for name in NAMES if not name.endswith((".py", ".md", ".json"))]
)
def test_a_function_that_is_named_exists(name: str) -> None:
    full = name if name.startswith("reverie_eval") else f"reverie_eval.{name}"
    assert callable(pkgutil.resolve_name(full))


def test_a_submission_takes_the_steps_of_the_page() -> None:
    page = PAGE.partition("## The path of a submission")[2]
    steps = re.findall(r"^\| \d \| `([\w.]+)` \|", page, re.MULTILINE)
    assert len(steps) == 8
    named = [pkgutil.resolve_name(f"reverie_eval.{step}") for step in steps]
    codes = [
        (vars(each)["__init__"] if isinstance(each, type) else each).__code__ for each in named
    ]
    called: dict[object, None] = {}
    sys.setprofile(lambda frame, *_: called.setdefault(frame.f_code))
    try:
        evaluate(REPOSITORY / "fixtures" / "submissions" / "good.json", split="val_unseen")
    finally:
        sys.setprofile(None)
    assert [code for code in called if code in codes] == codes


def test_private_modules_are_imported_within_their_package_alone() -> None:
    """A module whose name begins with an underscore is reached through its package's `__init__`."""
    private = re.compile(
        r"^ *from (reverie_eval[a-z_.]*?)(?:\._[a-z]\w*| import _[a-z]\w*)", re.MULTILINE
    )
    roots = REPOSITORY / "reverie_eval", REPOSITORY / "cli" / "reverie_eval_cli"
    reached = [
        (str(file.relative_to(REPOSITORY)), package)
        for root in roots
        for file in root.rglob("*.py")
        for package in private.findall(file.read_text("utf-8"))
        if not file.is_relative_to(root.parent.joinpath(*package.split(".")))
    ]
    assert reached == []


SERVER = REPOSITORY / "reverie_eval" / "server"
DOOR = re.compile(
    r"\w+\.py|(http|platforms)/.*|"
    r"\w+/(access|routes|pages|desk|room|uploads|health|\w+_page)\.py"
)
"""Where the server knows HTTP: the doors of its rooms, what they share, what puts it together."""


def test_only_doors_of_the_server_know_http() -> None:
    """What a room does is the same over the API, in the browser and on the command line."""
    http = re.compile(
        r"^ *(from|import) (fastapi|starlette|reverie_eval\.server\.http)", re.MULTILINE
    )
    for file in SERVER.rglob("*.py"):
        name = str(file.relative_to(SERVER))
        if not DOOR.fullmatch(name):
            assert not http.search(file.read_text("utf-8")), name


def test_only_what_doors_call_writes_into_the_audit_log() -> None:
    """What other parts change goes through its functions, which record it."""
    writing = re.compile(r"transaction\.record\(|audit_log\.append\(")
    sources = [*(REPOSITORY / "reverie_eval").rglob("*.py"), *(REPOSITORY / "cli").rglob("*.py")]
    for path in sources:
        if writing.search(path.read_text("utf-8")):
            assert path.is_relative_to(SERVER)
            assert not DOOR.fullmatch(str(path.relative_to(SERVER)))


def test_tests_that_need_no_server_import_none() -> None:
    """Pytest imports shared fixtures itself, and has to be the first, whichever folders it runs."""
    tests = REPOSITORY / "tests"
    alone = {each.name for each in tests.iterdir()} - FOLDERS_THAT_SHARE - {"support"}
    files = [file for folder in sorted(alone) for file in (tests / folder).glob("*.py")]
    assert len(files) > 100  # an empty list would let everything pass
    names = re.compile("|".join(map(re.escape, SHARED_FIXTURES)))
    assert [str(file) for file in files if names.search(file.read_text())] == []
