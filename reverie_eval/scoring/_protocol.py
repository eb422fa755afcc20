"""Protocols by task and name, and what they score."""

from collections.abc import Mapping
from types import MappingProxyType

from reverie_eval.ground_truth import GroundTruth
from reverie_eval.tasks import DEFAULT_TASK, Protocol, find_task

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType(
    {protocol.name: protocol for protocol in find_task(DEFAULT_TASK).protocols}
)
"""Every released protocol of REVERIE by its name; the default comes first."""

ALIASES: Mapping[str, str] = find_task(DEFAULT_TASK).aliases
"""Other names of these protocols: codebases that score the same way."""


def find_protocol(name: str, task: str = DEFAULT_TASK) -> Protocol:
    """Return the protocol of a task with this name or alias.

    Raises
    ------
    ProtocolError
        If there is no such task, or it has no such protocol.
    """
    return find_task(task).protocol(name)


def scored_by(protocol: Protocol, truth: GroundTruth) -> GroundTruth:
    """Return the ground truth of the episodes and annotated paths that a protocol scores by."""
    return truth.first_instructions(protocol.scored_instructions).along(protocol.reference)


def basis_of(protocol: Protocol) -> tuple[int | None, str]:
    """Return what :func:`scored_by` depends on besides the ground truth."""
    return protocol.scored_instructions, protocol.reference
