"""``reverie-eval server token add|list|revoke FOLDER``."""

from collections.abc import Mapping
from types import ModuleType

SUMMARY = "make, list and revoke tokens"


def commands() -> Mapping[str, ModuleType]:
    """Return the commands."""
    from reverie_eval_cli.commands.server.token import add, list_all, revoke

    return {"add": add, "list": list_all, "revoke": revoke}
