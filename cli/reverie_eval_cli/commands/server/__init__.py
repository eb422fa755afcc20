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
            "person": "person:person",
            "request": "request:request",
            "token": "token:token",
            "invite": "token:invite",
            "grant": "grant:grant",
        },
        "Results": {
            "submit": "submit:submit",
            "submissions": "review:submissions",
            "review": "review:review",
            "rescore": "rescore:rescore",
            "import": "reported:import_results",
            "reported": "reported:reported",
        },
        "Look into submissions": {
            "inspect": "inspect:inspect",
            "evidence": "evidence:evidence",
            "download": "download:download",
            "export": "export:export_tables",
        },
        "Phases": {
            "phase": "phase:phase",
            "diff": "phase:diff",
            "snapshot": "snapshot:snapshot",
        },
        "Keep": {
            "doctor": "folder:doctor",
            "tidy": "tidy:tidy",
            "audit": "audit:audit",
            "key": "key:key",
            "news": "news:news",
            "notify": "notify:notify",
            "backup": "backup:backup",
            "restore": "backup:restore",
            "export-site": "site:export_site",
        },
        "Other platforms": {
            "export-codabench": "codabench:export_codabench",
            "export-evalai": "evalai:export_evalai",
            "evalai-worker": "evalai:evalai_worker",
        },
    },
    help="Set up, manage and hand over an evaluation server.",
)
