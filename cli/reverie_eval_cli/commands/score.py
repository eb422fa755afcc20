"""``reverie-eval SUBMISSION --split SPLIT``: print the score table of a submission."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from reverie_eval import PROTOCOLS, ReverieEvalError, Scores, diagnose, evaluate, evaluate_protocols
from reverie_eval.ground_truth import find_ground_truth
from reverie_eval.reporting._tables import FORMATS, write_episodes
from reverie_eval.scoring import ALIASES, DEFAULT_PROTOCOL
from reverie_eval_cli.arguments import add_clustering, add_ground_truth, add_split, add_submission
from reverie_eval_cli.outputs import check_outputs

_ALL = "all"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_submission(parser)
    add_split(parser)
    add_ground_truth(parser)
    parser.add_argument(
        "--protocol",
        choices=[*PROTOCOLS, *ALIASES, _ALL],
        default=DEFAULT_PROTOCOL,
        metavar="NAME",
        help=f"the rules to score by: {', '.join([*PROTOCOLS, *ALIASES])}, or {_ALL} of them side "
        "by side (default: %(default)s)",
    )
    parser.add_argument(
        "--track",
        choices=("full", "grounding"),
        default="full",
        help="grounding: the agent stands at the goal, only its answer is scored "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--diagnose",
        action="store_true",
        help="also show what evaluators that read only the first viewpoint of a hop would give",
    )
    parser.add_argument("--ci", action="store_true", help="also show 95 %% confidence intervals")
    add_clustering(parser, default=None)  # whoever says of what wants intervals
    parser.add_argument(
        "--format", choices=FORMATS, default="table", help="of the scores (default: %(default)s)"
    )
    parser.add_argument("--output", metavar="FILE", help="write the scores to FILE")
    parser.add_argument(
        "--episodes",
        metavar="FILE",
        help="also write every episode's values to FILE, as CSV; with several rows the first's",
    )


def run(arguments: argparse.Namespace) -> int:
    """Score the submission and put the scores where they were asked for."""
    check_outputs(
        [arguments.output, arguments.episodes], [arguments.submission, arguments.ground_truth]
    )
    results = _evaluate(arguments)
    if arguments.ci or arguments.cluster:
        results = [scores.with_intervals(arguments.cluster or "target") for scores in results]
    if arguments.episodes:
        with Path(arguments.episodes).open("w", encoding="utf-8", newline="") as file:
            write_episodes(results[0], file)
    if arguments.output:
        text = FORMATS[arguments.format](results)
        Path(arguments.output).write_text(text + "\n", encoding="utf-8")
    elif arguments.format == "table" and sys.stdout.isatty():
        _show_on_terminal(results)
    else:
        print(FORMATS[arguments.format](results))
    return 0


def _evaluate(arguments: argparse.Namespace) -> Sequence[Scores]:
    submission = arguments.submission
    truth = find_ground_truth(arguments.ground_truth, arguments.split)
    where = {"split": arguments.split, "ground_truth": truth}
    if arguments.diagnose:
        if arguments.protocol == _ALL or arguments.track != "full":
            raise ReverieEvalError("--diagnose goes with one protocol, on the full track")
        return diagnose(submission, **where, protocol=arguments.protocol)
    if arguments.protocol == _ALL:
        return list(evaluate_protocols(submission, **where, track=arguments.track).values())
    return [evaluate(submission, **where, protocol=arguments.protocol, track=arguments.track)]


def _show_on_terminal(results: Sequence[Scores]) -> None:
    from rich.console import Console

    from reverie_eval.reporting._terminal import show

    show(results, Console())
