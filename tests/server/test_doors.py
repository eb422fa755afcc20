"""An action comes out at three doors, route, page and command, and is in the audit log.

Actions are the functions of the rooms of the server that take a :class:`Transaction`; see
docs/decisions/0014-one-action-three-doors.md. They are found in the source, and so is where they
are used: as an imported name or an attribute. One that shares its name with another attribute, as
``change`` does, may be missed at a door.
"""

import ast
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import reverie_eval_cli
from reverie_eval import server

SERVER, COMMANDS = Path(server.__path__[0]), Path(reverie_eval_cli.__path__[0])
ROOMS = [SERVER / "identity.py", *SERVER.glob("*/*.py")]
IS_DOOR = re.compile(r"routes|access|desk|(.*_)?pages?")
OVER_HTTP = [file for file in ROOMS if IS_DOOR.fullmatch(file.stem)]
COMMAND_FILES = [*(COMMANDS / "commands/server").rglob("*.py")]
DOORS = ("route", "page", "command")
ELSEWHERE = {SERVER / "operations", SERVER / "audit", SERVER / "store"}
"""Folders with commands' functions, and with what every action uses."""
OF_OTHER_ACTIONS = {
    "notify_of_same_file",
    "notify",
    "notify_of_fault",
    "replace_results",
    "append_rules",
    "take_due",
    "revoke_all",
    "check_organiser_left",
}
"""What only other actions and jobs call, within their transactions."""
AT_SOME_DOORS: Mapping[str, set[str]] = {
    # One request over the API, several at the desk and on the command line.
    "accept_request": {"route"},
    "reject_request": {"route"},
    "accept_requests": {"page", "command"},
    "reject_requests": {"page", "command"},
    # The command imports a file of one row.
    "add_reported": {"route", "page"},
    # Pages and routes set all of a notice, commands one part of it: `change_notice`.
    "post_notice": {"route", "page"},
    "change_notice": {"command"},
    # Those who are invited, not organisers.
    "accept_invitation": {"route", "page"},
    # At the desk and over the API, tokens are revoked one by one.
    "revoke_tokens_of_team": {"command"},
    "revoke_tokens_of_person": {"command"},
    # Where the key's file is.
    "revoke_key": {"command"},
    "replace_key": set(),  # by `server.operations`, which the command calls
    # Pages and commands `change` a schedule, of which they may set a part.
    "set": {"route"},
    "invite": set(),  # by `import_people`
}
RECORDING = {"record", "transaction.audit_log.append"}
RECORDED_BY_THEIR_CALLERS = {"notify", "notify_of_fault", "check_organiser_left"}
"""Functions that only leave messages, or raise."""


def functions(file: Path) -> Iterable[ast.FunctionDef]:
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    return (node for node in nodes if isinstance(node, ast.FunctionDef))


@cache
def actions() -> Mapping[str, Path]:
    """Return the file of each action."""
    return {
        each.name: file
        for file in sorted(set(ROOMS) - {*OVER_HTTP})
        if file.parent not in ELSEWHERE or file == SERVER / "operations" / "keys.py"
        for each in functions(file)
        if not each.name.startswith("_")
        and any(
            argument.annotation is not None and ast.unparse(argument.annotation) == "Transaction"
            for argument in each.args.args
        )
    }


def imported_by(tree: ast.AST) -> set[str]:
    """Return the names that are imported from modules."""
    imports = (each for each in ast.walk(tree) if isinstance(each, ast.ImportFrom))
    return {alias.name for each in imports for alias in each.names}


def used_by(tree: ast.AST, imported: set[str]) -> set[str]:
    """Return imported names and attributes, except those that decorate (``router.post``)."""
    nodes = list(ast.walk(tree))
    decorators = [each for node in nodes for each in getattr(node, "decorator_list", ())]
    decorating = {id(each) for decorator in decorators for each in ast.walk(decorator)}
    used = [each for each in nodes if id(each) not in decorating]
    names = {each.id for each in used if isinstance(each, ast.Name)}
    return names & imported | {each.attr for each in used if isinstance(each, ast.Attribute)}


def is_route(door: ast.AST, file: Path) -> bool:
    """Whether a function is a route of the API; in some files, it is beside its page."""
    decorators = getattr(door, "decorator_list", ())
    return file.stem == "routes" or any("routes." in ast.unparse(each) for each in decorators)


def used_at_doors() -> Mapping[str, set[str]]:
    """Return the imported names, and the attributes, that are used at each door."""
    used: dict[str, set[str]] = {door: set() for door in DOORS}
    for file in OVER_HTTP:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        imported = imported_by(tree)
        for each in tree.body:
            used["route" if is_route(each, file) else "page"] |= used_by(each, imported)
    for file in COMMAND_FILES:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        used["command"] |= used_by(tree, set()) | imported_by(tree)
    return used


def test_every_action_comes_out_at_its_doors() -> None:
    used = used_at_doors()
    found = {name: {door for door in DOORS if name in used[door]} for name in actions()}
    expected = {
        name: set() if name in OF_OTHER_ACTIONS else AT_SOME_DOORS.get(name, set(DOORS))
        for name in actions()
    }
    assert found == expected
    assert OF_OTHER_ACTIONS | AT_SOME_DOORS.keys() <= actions().keys(), "an exception that is none"


def calls(function: ast.FunctionDef) -> set[str]:
    """Return what a function calls, methods with and without what they are called on."""
    called = {ast.unparse(each.func) for each in ast.walk(function) if isinstance(each, ast.Call)}
    return called | {each.rpartition(".")[2] for each in called}


def test_every_action_is_in_the_audit_log() -> None:
    called = {
        (file, each.name): calls(each) for file in {*actions().values()} for each in functions(file)
    }

    def records(file: Path, name: str, above: frozenset[str] = frozenset()) -> bool:
        """Whether a function records something, itself or by one of ours that it calls."""
        names = called[file, name]
        return not names.isdisjoint(RECORDING) or any(
            records(actions().get(each, file), each, above | {name})
            for each in names - above
            if each in actions() or (each.startswith("_") and (file, each) in called)
        )

    silent = {name for name, file in actions().items() if not records(file, name)}
    assert silent == RECORDED_BY_THEIR_CALLERS
