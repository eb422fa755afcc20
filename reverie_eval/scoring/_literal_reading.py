"""How a protocol's own evaluator reads a file that is not in the official form.

We read every form as its authors meant it. Published evaluators read literally: some take only the
first viewpoint of a nested hop, one never matches an object id that is written as text, and all
stop at records that they do not expect.
"""

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType

from reverie_eval.errors import ProtocolError
from reverie_eval.scoring._scores import Scores
from reverie_eval.submissions import Predictions
from reverie_eval.tasks import HopReading, Protocol, Task

_FIRST_ONLY = "it reads only the first viewpoint of each hop"
_NO_TEXT = "no object id written as text is correct"

_STOPPING: Mapping[str, str] = MappingProxyType(
    {
        "keyed": "it expects a list of records",
        "prefixed": 'it knows no instr_id with the prefix "reverie_"',
        "bare viewpoints": "it expects each pose to be a list",
        "empty hops": "it expects a viewpoint in each hop",
        "other key": "it reads only predObjId",
        "navigation only": "it expects predObjId in each record",
    }
)
"""The differences from the official form at which the 2022 challenge's script fails."""

_NOT_DIAGNOSED: Mapping[HopReading, str] = MappingProxyType(
    {
        "every viewpoint": "its evaluators read every viewpoint of a nested hop, as reverie-eval "
        "does",
        "rejected": "its evaluator rejects trajectories with skipped viewpoints",
        "no evaluator": "it is the text of a paper, and has no evaluator",
    }
)


# HAMT's evaluator differs from DUET's in nothing else.
_HOPS_BY_ALIAS: Mapping[str, HopReading] = MappingProxyType({"hamt": "first viewpoint"})


def check_first_of_hop(name: str, task: Task) -> None:
    """Raise ProtocolError if a protocol's evaluator does not truncate nested hops."""
    names = [name, *(rules.name for rules in task.protocols), *task.aliases]
    readings = {each: _HOPS_BY_ALIAS.get(each, task.protocol(each).nested_hops) for each in names}
    if readings[name] != "first viewpoint":
        found = [each for each, reading in readings.items() if reading == "first viewpoint"]
        others = ", ".join(found) or "none of its protocols"
        raise ProtocolError(
            f"{name} has nothing to diagnose: {_NOT_DIAGNOSED[readings[name]]}; evaluators that "
            f"read only the first viewpoint of a hop are those of {others}"
        )


def literal_reading_notes(
    predictions: Predictions, rules: Protocol, score_truncated: Callable[[], Scores]
) -> Iterator[str]:
    """Yield a note if the protocol's own evaluator would read the file differently.

    ``score_truncated`` returns the scores by the first viewpoints of hops; it is called only if the
    note states them.
    """
    # Where ids are read literally and hops are not, no evaluator prints the table's scores.
    if not rules.text_ids_count:
        yield from _literal_scores(predictions, rules, score_truncated)
    elif _is_truncated(predictions, rules):
        yield (
            "evaluators that read only the first viewpoint of each hop give other scores, which "
            "`reverie-eval --diagnose` shows"
        )


def _literal_scores(
    predictions: Predictions,
    rules: Protocol,
    score_truncated: Callable[[], Scores],
) -> Iterator[str]:
    evaluator = f"{rules.name}'s own evaluator"
    is_truncated = _is_truncated(predictions, rules)
    has_text = bool(predictions.answer_is_text.any())
    stopping = [text for key, text in _STOPPING.items() if predictions.differences.get(key)]
    reasons = [_FIRST_ONLY] * is_truncated + [_NO_TEXT] * has_text
    if stopping:
        yield f"{evaluator} ends with an error for this very file: {' and '.join(stopping)}"
    elif len(predictions.boxes.row):
        yield f"{evaluator} reads no boxes: answers by box are incorrect there"
    elif is_truncated:
        scores = score_truncated()
        values = ", ".join(f"{m.label} {m.display(scores[m.key])}" for m in scores.headline)
        yield f"{evaluator} gives this very file {values}: {' and '.join(reasons)}"
    elif has_text:
        yield f"{evaluator} gives this very file the same scores: {_NO_TEXT}"


def _is_truncated(predictions: Predictions, rules: Protocol) -> bool:
    return rules.nested_hops == "first viewpoint" and predictions.has_long_hops
