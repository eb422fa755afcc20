"""Protocols by task and name, what they score, and how their evaluators read nested hops."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from reverie_eval.ground_truth import GroundTruth
from reverie_eval.tasks import DEFAULT_TASK, HopReading, Protocol, find_task

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType(
    {rules.name: rules for rules in find_task(DEFAULT_TASK).protocols}
)
"""Every released protocol of REVERIE by its name; the default comes first."""

ALIASES: Mapping[str, str] = find_task(DEFAULT_TASK).aliases
"""Other names of these protocols: codebases that score the same way."""

# HAMT's evaluator differs from DUET's in nothing else.
_HOPS_BY_ALIAS: Mapping[str, HopReading] = MappingProxyType({"hamt": "first viewpoint"})


def find_protocol(name: str, task: str = DEFAULT_TASK) -> Protocol:
    """Return the protocol of a task with this name or alias.

    Raises
    ------
    ProtocolError
        If there is no such task, or it has no such protocol.
    """
    return find_task(task).protocol(name)


def scored_by(rules: Protocol, truth: GroundTruth) -> GroundTruth:
    """Return the ground truth of the episodes and annotated paths that a protocol scores by."""
    return truth.first_instructions(rules.scored_instructions).along(rules.reference)


def basis_of(rules: Protocol) -> tuple[int | None, str]:
    """Return what :func:`scored_by` depends on besides the ground truth."""
    return rules.scored_instructions, rules.reference


def hop_reading(name: str, task: str = DEFAULT_TASK) -> HopReading:
    """Return how the evaluator of a protocol or alias reads nested hops.

    Raises
    ------
    ProtocolError
        If there is no such protocol.
    """
    return _HOPS_BY_ALIAS.get(name, find_protocol(name, task).nested_hops)


def first_of_hop(task: str) -> Sequence[str]:
    """Return a task's protocols and aliases whose evaluators read the first viewpoint of hops."""
    names = [*(rules.name for rules in find_task(task).protocols), *find_task(task).aliases]
    return [name for name in names if hop_reading(name, task) == "first viewpoint"]
