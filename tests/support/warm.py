"""Works out what servers need for their first requests; those that are forked later have it."""

import gc
import os
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from fastapi.routing import iter_route_contexts

from fixtures.servers import make_folder
from reverie_eval.agents import AGENTS
from reverie_eval.server.app import create_app
from reverie_eval.server.explore import episodes
from reverie_eval.server.http.rendering import _environment
from reverie_eval.server.opening import open_server
from reverie_eval.server.settings import load_settings
from tests.support.serving import sharing


def _prepare_server() -> None:
    with TemporaryDirectory() as name, patch.dict(os.environ, clear=True):
        folder = Path(name, "server")
        make_folder(folder)
        state = open_server(load_settings(folder))
        with closing(state.database):
            list(iter_route_contexts(create_app(state).routes))
        for board in state.boards.values():
            for agent in AGENTS:
                episodes.run_agent(agent, board.truth)  # type: ignore[attr-defined]


def _prepare_templates() -> None:
    environment = _environment()
    for name in environment.list_templates(["atom", "html", "jinja"]):  # not what Python compiled
        environment.get_template(name)


_for_ever = ExitStack()
_for_ever.enter_context(sharing())
_prepare_server()
_prepare_templates()
gc.freeze()
