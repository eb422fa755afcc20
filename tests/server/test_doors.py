"""An action comes out at three doors, route, page and command, and is in the audit log.

Actions are the functions of ``service`` that take a :class:`Transaction`; see
docs/decisions/0014-one-action-three-doors.md. They are found in the source, and so is where they
are called: by name, so one that shares its name with something else may be missed at a door.
"""

import ast
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import reverie_eval_cli
from reverie_eval import server

SERVER, COMMANDS = Path(server.__path__[0]), Path(reverie_eval_cli.__path__[0])
DOORS = {
    "route": SERVER / "routes",
    "page": SERVER / "pages",
    "command": COMMANDS / "commands/server",
}
OF_OTHER_ACTIONS = {
    "announce_same_file",
    "announce",
    "announce_fault",
    "replace_at_once",
    "append_rules",
    "record_inspection",
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
    # Pages and routes set all of a notice, commands one part of it: `change`.
    "post": {"route", "page"},
    # Those who are invited, not organisers.
    "accept_invitation": {"route", "page"},
    # At the desk and over the API, tokens are revoked one by one.
    "revoke_tokens_of_team": {"command"},
    "revoke_tokens_of_person": {"command"},
    # Where the key's file is.
    "revoke_key": {"command"},
    "replace_key": set(),  # by `server.operations`, which the command calls
    # `import_people` calls it; the command has an option of the same name.
    "invite": {"command"},
}
RECORDED_BY_THEIR_CALLERS = {"announce", "announce_fault", "check_organiser_left"}
"""They only leave messages, or raise."""


def functions(folder: Path) -> Iterable[ast.FunctionDef]:
    for file in sorted(folder.rglob("*.py")):
        nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        yield from (node for node in nodes if isinstance(node, ast.FunctionDef))


def names(node: ast.AST) -> set[str]:
    """Return the names that are used in code."""
    nodes = list(ast.walk(node))
    attributes = {each.attr for each in nodes if isinstance(each, ast.Attribute)}
    return attributes | {each.id for each in nodes if isinstance(each, ast.Name)}


@cache
def actions() -> Mapping[str, ast.FunctionDef]:
    return {
        each.name: each
        for each in functions(SERVER / "service")
        if not each.name.startswith("_")
        and any(
            argument.annotation is not None and ast.unparse(argument.annotation) == "Transaction"
            for argument in each.args.args
        )
    }


def test_every_action_comes_out_at_its_doors() -> None:
    used = {
        door: set().union(
            *(names(ast.parse(file.read_text(encoding="utf-8"))) for file in folder.rglob("*.py"))
        )
        for door, folder in DOORS.items()
    }
    found = {name: {door for door in DOORS if name in used[door]} for name in actions()}
    expected = {
        name: set() if name in OF_OTHER_ACTIONS else AT_SOME_DOORS.get(name, set(DOORS))
        for name in actions()
    }
    assert found == expected
    assert OF_OTHER_ACTIONS | AT_SOME_DOORS.keys() <= actions().keys(), "an exception that is none"


def test_every_action_is_in_the_audit_log() -> None:
    bodies = {each.name: names(each) for each in functions(SERVER / "service")}

    def records(name: str, above: frozenset[str] = frozenset()) -> bool:
        """Whether a function records something, itself or by one of ours that it calls."""
        called = (each for each in bodies[name] if each in actions() or each.startswith("_"))
        below = above | {name}
        return bool({"record", "audit_log"} & bodies[name]) or any(
            records(each, below) for each in called if each in bodies and each not in below
        )

    silent = {name for name in actions() if not records(name)}
    assert silent == RECORDED_BY_THEIR_CALLERS
