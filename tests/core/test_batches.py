"""Predictions that come in batches are scored as one submission, in one process or in several."""

import json
import pickle
import random
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import reverie_eval as rv
from tests.conftest import SAMPLES
from tests.support.forms import FORMS

SPLIT = "val_unseen"
GOOD = SAMPLES / "good.json"
Record = dict[str, Any]


@pytest.fixture
def evaluator() -> rv.Evaluator:
    """Create an evaluator that has collected nothing."""
    return rv.Evaluator(split=SPLIT)


@pytest.fixture
def records() -> list[Record]:
    """Read the good sample."""
    return records_of(GOOD)


def records_of(file: Path) -> list[Record]:
    """Read the records of a file in the official form."""
    return list(json.loads(file.read_bytes()))


def values_of(scores: rv.Scores) -> Mapping[str, Sequence[float]]:
    """Return the value of every metric and episode."""
    return {key: column.tolist() for key, column in scores.episodes.items()}


# The scores are those of one submission.

FORMS_IN_LISTS = {
    **{name: records_of(SAMPLES / f"{name}.json") for name in ("good", "mediocre", "drawn")},
    **{name: form.write() for name, form in FORMS.items() if isinstance(form.write(), list)},
}


@settings(max_examples=12)
@given(
    form=st.sampled_from(sorted(FORMS_IN_LISTS)),
    size=st.integers(1, 90),
    seed=st.integers(0, 99),
    repeated=st.integers(0, 3),
)
def test_batches_are_scored_as_one_submission(
    form: str, size: int, seed: int, repeated: int
) -> None:
    """Batches have any size and order, and repeat some records, as samplers do."""
    written = FORMS_IN_LISTS[form]
    evaluator = rv.Evaluator(split=SPLIT)
    shuffled = random.Random(seed).sample(written, len(written))
    for begin in range(0, len(shuffled), size):
        evaluator.update(shuffled[begin : begin + size])
    evaluator.update(shuffled[:repeated])
    scores = evaluator.compute()
    expected = rv.evaluate(written, split=SPLIT)
    assert values_of(scores) == values_of(expected)
    assert (scores.signature, scores.notes) == (expected.signature, expected.notes)


def test_the_grounding_track(records: list[Record]) -> None:
    """Trajectories may be missing."""
    for record in records:
        del record["trajectory"]
    evaluator = rv.Evaluator(split=SPLIT, track="grounding")
    evaluator.update(records[40:])
    evaluator.update(records[:41])
    expected = rv.evaluate(GOOD, split=SPLIT, track="grounding")
    assert evaluator.compute().to_dict() == expected.to_dict()


def test_records_by_id(evaluator: rv.Evaluator, records: list[Record]) -> None:
    """The ids may be the keys only."""
    evaluator.update({record.pop("instr_id"): record for record in records})
    assert values_of(evaluator.compute()) == values_of(rv.evaluate(GOOD, split=SPLIT))


def test_a_subset(records: list[Record]) -> None:
    """Records of other episodes are checked and left out, as in a file."""
    chosen = [record["instr_id"] for record in records[10:20]]
    evaluator = rv.Evaluator(split=SPLIT, subset=chosen)
    evaluator.update(records[:5])
    evaluator.update(records[8:25])
    expected = rv.evaluate(GOOD, split=SPLIT, subset=chosen)
    assert evaluator.compute().to_dict() == expected.to_dict()


# Two real loops.


class Agent:
    """Plays recorded walks as a network would produce them: batch by batch, better each epoch."""

    def __init__(self, *walks: Sequence[Record]) -> None:
        self.walks = walks

    def rollouts(self, epoch: int, batch_size: int) -> Iterator[list[Record]]:
        """Yield the predictions of an epoch in random order."""
        walks = list(self.walks[epoch])
        random.Random(epoch).shuffle(walks)
        for begin in range(0, len(walks), batch_size):
            yield walks[begin : begin + batch_size]


def test_a_training_loop(evaluator: rv.Evaluator) -> None:
    files = [SAMPLES / "mediocre.json", GOOD]
    agent = Agent(*map(records_of, files))
    history = []
    for epoch in range(2):
        evaluator.reset()
        for batch in agent.rollouts(epoch, batch_size=16):
            evaluator.update(batch)
        history.append(evaluator.compute().to_dict())
    assert history == [rv.evaluate(file, split=SPLIT).to_dict() for file in files]


SHARE = f"""
import json, sys
import reverie_eval as rv
rank = int(sys.argv[1])
records = json.load(open({str(GOOD)!r}))
share = [*records[rank::2], records[1 - rank]]  # one is repeated, as samplers do
evaluator = rv.Evaluator(split="{SPLIT}")
for begin in range(0, len(share), 8):
    evaluator.update(share[begin : begin + 8])
json.dump(evaluator.records, sys.stdout)
"""


def test_two_processes_with_half_of_the_episodes_each(evaluator: rv.Evaluator) -> None:
    processes = [
        subprocess.Popen([sys.executable, "-c", SHARE, str(rank)], stdout=subprocess.PIPE)
        for rank in range(2)
    ]
    for process in processes:
        part, _ = process.communicate()
        evaluator.update(json.loads(part))
    assert evaluator.compute().to_dict() == rv.evaluate(GOOD, split=SPLIT).to_dict()


def test_collected_predictions_survive_json_and_pickle(
    evaluator: rv.Evaluator, records: list[Record]
) -> None:
    evaluator.update(records)
    assert evaluator.records == records
    assert json.loads(json.dumps(evaluator.records)) == records
    assert (
        pickle.loads(pickle.dumps(evaluator)).compute().to_dict() == evaluator.compute().to_dict()
    )


# What is wrong is said at once.


def test_missing_episodes(evaluator: rv.Evaluator, records: list[Record]) -> None:
    evaluator.update(records[:40])
    with pytest.raises(rv.SubmissionError, match="44 of the 84 episodes of val_unseen have no"):
        evaluator.compute()
    evaluator.update(records[40:])
    assert evaluator.compute()["success"] > 0.8


def test_an_invalid_batch_is_refused_as_a_whole(
    evaluator: rv.Evaluator, records: list[Record]
) -> None:
    evaluator.update(records[:10])
    bad = records[10:20]
    bad[1] = bad[1] | {"instr_id": "1_2_3"}
    bad[2] = bad[2] | {"trajectory": bad[2]["trajectory"][1:]}
    bad[4] = bad[4] | {"trajectory": [["nowhere", 0.0, 0.0]]}
    with pytest.raises(rv.SubmissionError) as rejected:
        evaluator.update(bad)
    assert [(each.code, each.where) for each in rejected.value.problems] == [
        ("unknown-episode", "[1].instr_id"),
        ("wrong-start", "[2].trajectory[0]"),
        ("unknown-viewpoint", "[4].trajectory[0][0]"),
    ]
    assert evaluator.records == records[:10]


def test_the_next_epoch_without_a_reset(evaluator: rv.Evaluator, records: list[Record]) -> None:
    evaluator.update(records[:10])
    evaluator.update(records[10:20])
    changed = records[3] | {"predObjId": 77}
    with pytest.raises(rv.SubmissionError) as rejected:
        evaluator.update([records[2], changed])
    (problem,) = rejected.value.problems
    assert (problem.code, problem.where) == ("duplicate-episode", "[1].instr_id")
    assert "call reset() before the next epoch" in problem.message
    evaluator.reset()
    evaluator.update([changed])
    assert evaluator.records == [changed]


def test_two_predictions_in_a_batch(evaluator: rv.Evaluator, records: list[Record]) -> None:
    changed = records[0] | {"predObjId": 77}
    with pytest.raises(rv.SubmissionError, match="already has a different prediction"):
        evaluator.update([records[0], changed])


def test_another_point_is_another_prediction() -> None:
    """In SOON, agents point at the target."""
    item = json.loads((SAMPLES / "soon.json").read_bytes())[0]
    evaluator = rv.Evaluator(split=SPLIT, task="soon")
    evaluator.update([item])
    evaluator.update([item])
    (first, *others) = item["trajectory"]
    changed = first | {"obj_heading": first["obj_heading"] + 0.25}
    with pytest.raises(rv.SubmissionError, match="already has a different prediction"):
        evaluator.update([item | {"trajectory": [changed, *others]}])


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        pytest.param(GOOD, type(GOOD).__name__, id="a path"),
        pytest.param(str(GOOD), "str", id="its text"),
        pytest.param(b"[]", "bytes", id="a file's bytes"),
        pytest.param(None, "NoneType", id="nothing"),
        pytest.param(iter(()), "tuple_iterator", id="an iterator"),
    ],
)
def test_what_is_no_batch(given: Any, kind: str, evaluator: rv.Evaluator) -> None:
    with pytest.raises(TypeError) as refused:
        evaluator.update(given)
    assert str(refused.value) == (
        f"update takes a list of records, got {kind}; to score a file, call the evaluator with its "
        "path"
    )


def test_an_empty_share(evaluator: rv.Evaluator) -> None:
    evaluator.update([])
    with pytest.raises(rv.SubmissionError, match="file: "):
        evaluator.compute()
