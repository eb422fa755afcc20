"""``reverie-eval agent NAME --split SPLIT -o FILE``: write a reference agent's submission."""

import argparse

from reverie_eval_cli.arguments import add_ground_truth, add_output, add_split
from reverie_eval_cli.outputs import check_outputs
from reverie_eval_cli.submissions import write_submission

SUMMARY = "write the submission of a reference agent: shortest, random or stop"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.add_argument("name", choices=("shortest", "random", "stop"))
    add_split(parser)
    add_ground_truth(parser)
    parser.add_argument(
        "--seed", type=int, default=0, help="of the random agent (default: %(default)s)"
    )
    add_output(parser)


def run(arguments: argparse.Namespace) -> int:
    """Let the agent walk and write what it did."""
    from reverie_eval.agents import run_agent
    from reverie_eval.ground_truth import find_ground_truth

    check_outputs([arguments.output], [arguments.ground_truth])
    truth = find_ground_truth(arguments.ground_truth, arguments.split)
    write_submission(run_agent(arguments.name, truth, arguments.seed), arguments.output)
    return 0
