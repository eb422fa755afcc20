"""Options of ``reverie-eval run`` for language models, and for other agents that have the same."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, get_args

import click

from reverie_eval.agents.chat import History, InputClass
from reverie_eval_cli import options

CHAT = "chat"
"""The name of the agent."""


@dataclass(frozen=True)
class ChatOptions:
    """Options of an agent that have names of their own on the command line."""

    model: str | None
    endpoint: str | None
    key_from: str | None
    observe: str | None
    history: str | None
    prompts: str | None
    prices: str | None
    max_cost: float | None
    cache: str | None

    def given_to(self, agent: str, folder: Path, pictures: Path | None) -> Mapping[str, Any]:
        """Return those that were given, and where replies are kept otherwise."""
        if self.observe == "views" and pictures is None:
            raise click.UsageError("--observe views needs --pictures FOLDER")
        kept = {"cache": str(folder)} if agent == CHAT else {}
        return kept | {name: value for name, value in asdict(self).items() if value is not None}


chat_options = options.grouped(
    "chat_options",
    ChatOptions,
    click.option("--model", metavar="NAME", help="chat: the model, as the endpoint calls it."),
    click.option(
        "--endpoint",
        metavar="URL",
        help="chat: the address of an OpenAI-compatible endpoint, such as "
        "http://localhost:11434/v1.",
    ),
    click.option(
        "--key-from",
        metavar="NAME",
        help="chat: the environment variable that has the endpoint's key.",
    ),
    click.option(
        "--observe",
        type=options.Choice(get_args(InputClass)),
        help="chat: the input class. objects are annotators' labels, so perfect perception; views "
        "are pictures of skyboxes.",
    ),
    click.option(
        "--history",
        type=options.Choice(get_args(History)),
        help="chat: send all messages of the episode again, or a map of it.  [default: full]",
    ),
    click.option(
        "--prompts",
        metavar="FOLDER",
        type=click.Path(),
        help="chat: texts that replace ours.",
    ),
    click.option(
        "--prices",
        metavar="FILE",
        type=click.Path(),
        help="chat: what tokens cost, as TOML.",
    ),
    click.option(
        "--max-cost",
        metavar="USD",
        type=options.Decimal(0, min_open=True),
        help="chat: stop the run once replies have cost as much; a higher limit goes on with it.",
    ),
    click.option(
        "--cache",
        metavar="FOLDER",
        type=click.Path(),
        help="chat: where replies are kept, so that runs can share them.  [default: the run's "
        "folder]",
    ),
)
