"""Runs: an agent walks the episodes of a split, and what it does is kept until it is scored.

A run's folder has what :class:`Identity` says in ``run.json``, a line for each :class:`Attempt` in
``episodes.jsonl``, one for each :class:`Step` in ``steps.jsonl``, and the submission.
"""

from reverie_eval.errors import RunError
from reverie_eval.logs import SUBMISSION, Attempt, Step, read_attempts, read_steps
from reverie_eval.runner._folder import (
    RUN_SCHEMAS,
    Identity,
    Limits,
    RunCard,
    Totals,
    read_card,
    run_schema,
)
from reverie_eval.runner._run import AttemptEnd, Record, run, run_agent
from reverie_eval.runner._walking import (
    FAILED_IN_A_ROW,
    TREATMENTS,
    WAITS,
    RunPlan,
    TransientError,
    check_agent,
)

__all__ = [
    "FAILED_IN_A_ROW",
    "RUN_SCHEMAS",
    "SUBMISSION",
    "TREATMENTS",
    "WAITS",
    "Attempt",
    "AttemptEnd",
    "Identity",
    "Limits",
    "Record",
    "RunCard",
    "RunError",
    "RunPlan",
    "Step",
    "Totals",
    "TransientError",
    "check_agent",
    "read_attempts",
    "read_card",
    "read_steps",
    "run",
    "run_agent",
    "run_schema",
]
