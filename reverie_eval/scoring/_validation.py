"""Validation: what is known about a valid submission without the answers."""

from collections.abc import Sequence
from dataclasses import dataclass

from reverie_eval.arrays import Array, BoolArray
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import CATALOGUE
from reverie_eval.tasks import Protocol
from reverie_eval.text import count_text


@dataclass(frozen=True, eq=False)
class Validation:
    """The result of checking a valid submission, without using the answers."""

    ground_truth: GroundTruth
    abstained: BoolArray
    """Shape (n_episodes,): whether the answer predicts neither an object nor a box."""
    jumps: Array
    """Shape (n_episodes,): moves between unconnected viewpoints."""
    hints: Sequence[str] = ()
    """How the file was read, and what in it looks like a mistake."""

    @property
    def notes(self) -> Sequence[str]:
        """What the participant should know before submitting, one sentence each."""
        abstained, total = int(self.abstained.sum()), len(self.abstained)
        some_abstain = 0 < abstained < total  # if all do, there is a hint already
        answers = count_text(total, "answer")
        notes = [f"{abstained:,} of {answers} predict no object"] if some_abstain else []
        return [*notes, *self.hints, *jump_notes(self.jumps)]


def jump_notes(jumps: Array, rules: Protocol | None = None) -> Sequence[str]:
    """Count the moves between unconnected viewpoints, and say how a protocol treats them."""
    if not jumps.any():
        return ()
    episodes = count_text(int((jumps > 0).sum()), "episode")
    remark = ""
    if rules is not None and rules.rejects_jumps:
        remark = f"; {rules.name}'s own evaluator stops at a jump"
    jumps_text = count_text(int(jumps.sum()), "jump")
    return (f"{jumps_text} in {episodes}: {CATALOGUE['jumps'].definition}{remark}",)
