"""``reverie-eval server COMMAND FOLDER``: set up, run and hand over an evaluation server."""

from reverie_eval_cli.groups import LazyGroup

server = LazyGroup(
    "reverie_eval_cli.commands.server",
    {
        "Set up": {
            "init": "folder:init",
            "upgrade": "folder:upgrade",
        },
        "People": {
            "team": "people:team",
            "person": "people:person",
            "request": "people:request",
            "token": "credentials:token",
            "grant": "people:grant",
        },
        "Submissions": {
            "submit": "results:submit",
            "submissions": "results:submissions",
            "inspect": "exports:inspect",
            "evidence": "exports:evidence",
            "review": "results:review",
            "rescore": "results:rescore",
        },
        "Leaderboards": {
            "phase": "phases:phase",
            "news": "phases:news",
            "snapshot": "phases:snapshot",
            "import": "results:import_results",
            "reported": "results:reported",
            "export": "exports:export",
        },
        "Keep": {
            "doctor": "folder:doctor",
            "audit": "folder:audit",
            "key": "credentials:key",
            "notify": "folder:notify",
            "backup": "folder:backup",
            "restore": "folder:restore",
        },
    },
    help="Set up, manage and hand over an evaluation server.",
)
