"""``reverie-eval server COMMAND FOLDER``: set up, run and hand over an evaluation server."""

from reverie_eval_cli.groups import LazyGroup

server = LazyGroup(
    "reverie_eval_cli.commands.server",
    {
        "Set up": {
            "init": "folder:init",
            "check": "folder:check",
            "upgrade": "folder:upgrade",
        },
        "People": {
            "team": "people:team",
            "person": "people:person",
            "request": "people:request",
            "token": "credentials:token",
            "invite": "credentials:invite",
            "grant": "people:grant",
        },
        "Results": {
            "submit": "results:submit",
            "submissions": "results:submissions",
            "review": "results:review",
            "rescore": "results:rescore",
            "import": "results:import_results",
            "reported": "results:reported",
        },
        "Look into submissions": {
            "inspect": "exports:inspect",
            "evidence": "exports:evidence",
            "download": "exports:download",
            "export": "exports:export_tables",
        },
        "Phases": {
            "phase": "phases:phase",
            "notice": "phases:notice",
            "diff": "phases:diff",
            "snapshot": "phases:snapshot",
        },
        "Keep": {
            "doctor": "folder:doctor",
            "tidy": "folder:tidy",
            "audit": "folder:audit",
            "key": "credentials:key",
            "news": "phases:news",
            "notify": "folder:notify",
            "backup": "folder:backup",
            "restore": "folder:restore",
            "export-site": "exports:export_site",
        },
        "Other platforms": {
            "export-codabench": "exports:export_codabench",
            "export-evalai": "exports:export_evalai",
            "evalai-worker": "exports:evalai_worker",
        },
    },
    help="Set up, manage and hand over an evaluation server.",
)
