"""``reverie-eval run AGENT``: from an agent to a scored submission."""

import gc
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TextIO, get_args

import click

from reverie_eval import GroundTruth, evaluate
from reverie_eval.agents import AgentSource
from reverie_eval.agents.chat import History, InputClass
from reverie_eval.files import read_toml
from reverie_eval.logs import read_text
from reverie_eval.reporting.scores import scores_printout
from reverie_eval.runner import SUBMISSION, AttemptEnd, Limits, RunPlan, Totals, read_attempts, run
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.options import TruthOptions
from reverie_eval_cli.output import episode_bar, note, show_printout

_DEFAULTS = Limits()
# The agent that is a language model.
_CHAT = "chat"


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
        kept = {"cache": str(folder)} if agent == _CHAT else {}
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
        help="chat: stop the run once replies have cost this much; a higher limit continues it.",
    ),
    click.option(
        "--cache",
        metavar="FOLDER",
        type=click.Path(),
        help="chat: where replies are kept, so that runs can share them.  [default: the run's "
        "folder]",
    ),
)


@dataclass(frozen=True)
class RunOptions:
    """How an agent is run."""

    option: Mapping[str, Any]
    options_from: Path | None
    boxes: Path | None
    pictures: Path | None
    seed: int
    max_steps: int
    max_seconds: float | None

    def plan(self, agent: str, truth: GroundTruth, named: Mapping[str, Any]) -> RunPlan:
        """Return what is to be run; some of the agent's options have names of their own."""
        return RunPlan(
            agent=AgentSource(agent, {**named, **self.agent_options()}),
            ground_truth=truth,
            boxes=self.boxes,
            pictures=self.pictures,
            seed=self.seed,
            limits=Limits(steps=self.max_steps, seconds=self.max_seconds),
        )

    def agent_options(self) -> Mapping[str, Any]:
        """Return the agent's options: those of the file, and then those of the command line."""
        given = {} if self.options_from is None else read_toml(self.options_from)
        return {**given, **self.option}


@click.command("run")
@click.argument("agent")
@options.truth
@options.new_path("FOLDER", "The run's folder: a new one, or one to go on with.")
@options.episodes_from
@options.grouped(
    "run_options",
    RunOptions,
    options.agent_option,
    click.option(
        "--options-from", metavar="FILE", type=options.PATH, help="Options of the agent, as TOML."
    ),
    click.option(
        "--boxes",
        metavar="PATH",
        type=options.PATH,
        help="Where objects are visible: the BBox folder, BBoxes.json, or a bundle with the "
        "solution.  [default: the bundle]",
    ),
    click.option(
        "--pictures",
        metavar="FOLDER",
        type=options.PATH,
        help="The folder of the scans with their skyboxes.",
    ),
    options.with_default("--seed", type=int, default=0, help="Seed of the agent's random choices."),
    options.with_default(
        "--max-steps",
        metavar="N",
        type=options.Number(min=1),
        default=_DEFAULTS.steps,
        help="Actions after which an episode is cut off.",
    ),
    click.option(
        "--max-seconds",
        metavar="S",
        type=options.Decimal(0, min_open=True),
        help="Seconds after which an episode is cut off, once the action that was begun has ended.",
    ),
)
@chat_options
@options.with_default(
    "--jobs", metavar="N", type=options.Number(min=1), default=1, help="Number of processes."
)
@click.option(
    "--threads",
    is_flag=True,
    help="Threads instead of processes, for an agent that waits for an endpoint, as chat always "
    "does.",
)
@click.option(
    "--fill-missing",
    is_flag=True,
    help="Run nothing more: write the submission, with a stop at the start for each episode that "
    "has no answer.",
)
def run_agent(
    *,
    agent: str,
    truth_options: TruthOptions,
    output: Path,
    episodes_from: Path | None,
    run_options: RunOptions,
    chat_options: ChatOptions,
    jobs: int,
    threads: bool,
    fill_missing: bool,
) -> None:
    """Run an agent on a split, and score it.

    AGENT is a file.py with a class `Agent`, file.py:Name, module:Name, the name of an agent that a
    package offers, the folder of a trained model, or one of ours: shortest, random, stop,
    nearest-first, word-match, or chat, a language model.

    The same command goes on with a run that was killed or stopped. FOLDER gets submission.json,
    run.json, episodes.jsonl and steps.jsonl.
    """
    gc.enable()  # off in this command, which pays off in short lives only
    truth = truth_options.find(episodes_from)
    named = chat_options.given_to(agent, output, run_options.pictures)
    plan = run_options.plan(agent, truth, named)
    if truth.solution is None and run_options.boxes is None and truth.task.has_targets:
        note("the agent is shown no objects: the bundle is public, and there is no --boxes")
    episodes, done = len(truth.episodes.instr_ids), _done_in(output)
    with episode_bar(episodes, done) as advance:

        def show(end: AttemptEnd) -> None:
            if end.wait is None:
                advance()
            else:
                note(f"{end.attempt.episode}: {end.attempt.reason}; again in {end.wait:g} s")

        try:
            # What an agent prints is not a result, and it may close what it prints to.
            open_errors: Any = _Unclosable(sys.stderr)
            with redirect_stdout(open_errors), redirect_stderr(open_errors):
                totals = run(
                    plan,
                    output,
                    jobs=jobs,
                    threads=threads or agent == _CHAT,
                    fill_missing=fill_missing,
                    on_attempt=show,
                )
        except KeyboardInterrupt:
            note("the same command goes on with this run")
            raise
    if done == episodes:
        note("nothing was left to run")
    for line in (*_outcome(totals), *_reasons(output)):
        note(line)
    _print_scores(output / SUBMISSION, truth, totals)


class _Unclosable:
    """A stream that stays open."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def close(self) -> None:
        """Do nothing."""


def _done_in(folder: Path) -> int:
    """Return how many episodes of a run are done, to begin counting there."""
    try:
        return sum(attempt.record is not None for attempt in read_attempts(folder))
    except (FileNotFoundError, NotADirectoryError):
        return 0


def _outcome(totals: Totals) -> Iterable[str]:
    states = {"ended": totals.ended, "cut off": totals.cut_off, "failed": totals.failed}
    ended = ", ".join(f"{number:,} {state}" for state, number in states.items() if number)
    steps = count_text(totals.steps, "step")
    yield f"{ended}; {count_text(totals.attempts, 'attempt')}, {steps}, {totals.seconds:,.1f} s"
    if totals.read:
        yield f"the agent read {read_text(totals.read)}"
    tokens = (totals.input_tokens, totals.output_tokens)
    if tokens != (None, None):
        money = "unknown" if totals.money is None else f"${totals.money:,.2f}"
        sent, back = (0 if each is None else each for each in tokens)
        yield f"{sent:,} tokens in, {back:,} out, cost {money}"


def _reasons(folder: Path) -> Iterable[str]:
    """Say why most of the episodes ended that the agent did not end."""
    cut_off = [each.reason for each in read_attempts(folder) if each.state == "cut_off"]
    for reason, number in Counter(cut_off).most_common(1):
        yield f"{number:,} of the {len(cut_off):,} cut off: {reason}"


def _print_scores(submission: Path, truth: GroundTruth, totals: Totals) -> None:
    if truth.solution is None:
        print(submission)
        return
    scores = evaluate(submission, split=truth.split, ground_truth=truth)
    if totals.filled:
        filled = count_text(totals.filled, "episode")
        hint = f"{filled} without an answer of the agent, filled with a stop at the start"
        scores = replace(scores, hints=[*scores.hints, hint])
    show_printout(scores_printout([scores]), "table", None)
