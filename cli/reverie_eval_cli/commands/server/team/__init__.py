"""``reverie-eval server team add|list|revoke FOLDER``."""

from collections.abc import Mapping
from types import ModuleType

SUMMARY = "add and list teams, and revoke their tokens"


def commands() -> Mapping[str, ModuleType]:
    """Return the commands."""
    from reverie_eval_cli.commands.server.team import add, list_all, revoke

    return {"add": add, "list": list_all, "revoke": revoke}
