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
            "team": "team:team",
            "person": "people:person",
            "request": "people:request",
            "token": "credentials:token",
            "invite": "credentials:invite",
            "grant": "team:grant",
        },
        "Results": {
            "submit": "submissions:submit",
            "submissions": "submissions:submissions",
            "review": "submissions:review",
            "rescore": "rescore:rescore",
            "import": "reported:import_results",
            "reported": "reported:reported",
        },
        "Look into submissions": {
            "inspect": "inspection:inspect",
            "evidence": "inspection:evidence",
            "download": "inspection:download",
            "export": "exports:export_tables",
        },
        "Phases": {
            "phase": "phase:phase",
            "notice": "announcements:notice",
            "diff": "phase:diff",
            "snapshot": "phase:snapshot",
        },
        "Keep": {
            "doctor": "folder:doctor",
            "tidy": "folder:tidy",
            "audit": "folder:audit",
            "key": "credentials:key",
            "news": "announcements:news",
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
