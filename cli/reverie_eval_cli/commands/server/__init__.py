"""``reverie-eval server COMMAND FOLDER``: make, look after and hand on an evaluation server."""

from collections.abc import Mapping
from types import ModuleType

SUMMARY = "make, look after and hand on an evaluation server"


def commands() -> Mapping[str, ModuleType]:
    """Return the commands; they are imported when some command is to be parsed."""
    from reverie_eval_cli.commands.server import (
        audit,
        backup,
        check,
        doctor,
        grant,
        init,
        invite,
        person,
        restore,
        team,
        token,
        upgrade,
    )

    return {
        "init": init,
        "check": check,
        "doctor": doctor,
        "upgrade": upgrade,
        "backup": backup,
        "restore": restore,
        "team": team,
        "person": person,
        "token": token,
        "invite": invite,
        "grant": grant,
        "audit": audit,
    }
