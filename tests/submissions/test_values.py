"""Values in forms that Python prints or that are in lists: one mistake, and convertible."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from reverie_eval import GroundTruth, SubmissionError, evaluate, validate
from reverie_eval.submissions import convert
from reverie_eval.submissions._fields import unwrap, unwrap_numbers
from tests.conftest import SAMPLES
from tests.support.forms import OFFICIAL, Record
from tests.support.worlds import SPLIT

PRINTED, LISTED, PADDED = (
    "a tensor, an array or a list printed as text",
    "a value in a list of one",
    "spaces or a line end around a value",
)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        # As PyTorch 2, TensorFlow 2, JAX and numpy 1 and 2 print them.
        ("tensor(402)", 402),
        ("tensor(402, device='cuda:0')", 402),
        ("tensor(402, dtype=torch.int32)", 402),
        ("tensor(402., device='cuda:1', dtype=torch.float64)", 402.0),
        ("tensor([402])", 402),
        ("tensor([[402]], device='mps:0')", 402),
        ("tensor(0.2500, grad_fn=<SelectBackward0>)", 0.25),
        ("tensor(1.5000e-05, requires_grad=True)", 1.5e-05),
        ("Parameter containing:\ntensor([0.5000], requires_grad=True)", 0.5),
        ("tf.Tensor(402, shape=(), dtype=int64)", 402),
        ("tf.Tensor([402], shape=(1,), dtype=int32)", 402),
        ("<tf.Tensor: shape=(), dtype=int64, numpy=402>", 402),
        ("<tf.Tensor: shape=(1,), dtype=int32, numpy=array([402], dtype=int32)>", 402),
        ("<tf.Variable 'v:0' shape=() dtype=float32, numpy=0.5>", 0.5),
        ("Array(402, dtype=int32)", 402),
        ("array(402)", 402),
        ("array([402], dtype=int32)", 402),
        ("array([[-0.5]])", -0.5),
        ("np.int64(402)", 402),
        ("np.float64(0.5)", 0.5),
        ("np.str_('7_1_0')", "7_1_0"),
        ("array(['7_1_0'], dtype='<U5')", "7_1_0"),
        ("b'7_1_0'", "7_1_0"),
        ("[402]", 402),
        ("[[402.]]", 402.0),
        ("(402,)", "(402,)"),  # a trailing comma is not JSON
        ("['7_1_0']", "7_1_0"),
        (" tensor(402)\r\n", 402),
        # What is not printed, or does not tell a value, stays.
        ("402", "402"),
        ("", ""),
        ("None", "None"),
        ("tensor(True)", "tensor(True)"),
        ("tensor([], dtype=torch.int64)", []),
        ("tensor(", "tensor("),
        ("chair (402)", "chair (402)"),
        ("[402", "[402"),
        ("]" * 100, "]" * 100),
        ("[" * 100_000 + "]" * 100_000, "[" * 100_000 + "]" * 100_000),
    ],
)
def test_what_was_printed(text: str, meant: object) -> None:
    found, fault = unwrap(text)
    assert (found, type(found)) == (meant, type(meant))
    assert (fault is None) == (meant == text)


@pytest.mark.parametrize("levels", range(1, 8))
@pytest.mark.parametrize("value", [402, 0.5, "7_1_0", -1])
def test_lists_of_one_at_any_depth(levels: int, value: object) -> None:
    given = value
    for _ in range(levels):
        given = [given]
    found, fault = unwrap(given)
    assert found == value
    assert fault is not None
    assert fault.what.startswith(LISTED)


@pytest.mark.parametrize("around", [" {}", "{} ", "\t{}", "{}\n", "{}\r\n", "\n {}\t"])
def test_spaces_and_line_ends(around: str) -> None:
    found, fault = unwrap(around.format("402"))
    assert found == "402"
    assert fault is not None
    assert fault.what.startswith(PADDED)


@pytest.mark.parametrize(
    ("box", "meant"),
    [
        ("tensor([10., 20., 30., 40.])", [10.0, 20.0, 30.0, 40.0]),
        ("[10. 20. 30. 40.]", [10.0, 20.0, 30.0, 40.0]),
        ("[10, 20, 30, 40]", [10, 20, 30, 40]),
        ([[10, 20, 30, 40]], [10, 20, 30, 40]),
        ([[10], [20], [30], [40]], [10, 20, 30, 40]),
        (["10", "20.5", "30", "40"], [10.0, 20.5, 30.0, 40.0]),
        ([10, "tensor(20)", 30, 40], [10, 20, 30, 40]),
    ],
)
def test_boxes(box: object, meant: object) -> None:
    found, fault = unwrap_numbers(box)
    assert found == meant
    assert fault is not None


def test_no_text_takes_more_than_its_length_to_read() -> None:
    """Each is as long as a file may have for a value, and would take hours in squares of it."""
    for text in (
        "tensor(" + " " * 300_000 + "x)",
        "tensor(" + ",a" * 150_000 + ")",
        "tensor(" + "(" * 100_000 + ")",
    ):
        assert unwrap(text)[1] is None


# In files.


def changed(**fields: Callable[[Any], object]) -> list[Record]:
    """Return the good records with some fields changed."""
    return [
        {**record, **{name: change(record[name]) for name, change in fields.items()}}
        for record in OFFICIAL
    ]


def angles(change: Callable[[float], object]) -> Callable[[Any], object]:
    """Return what changes the angles of a trajectory."""
    return lambda trajectory: [[pose[0], *map(change, pose[1:])] for pose in trajectory]


ONE_PROBLEM = {
    "object ids of PyTorch": changed(predObjId="tensor({}, device='cuda:0')".format),
    "object ids of TensorFlow": changed(predObjId="tf.Tensor({}, shape=(), dtype=int64)".format),
    "object ids of numpy": changed(predObjId="[{}]".format),
    "object ids as floats of PyTorch": changed(predObjId="tensor({}.)".format),
    "object ids in lists": changed(predObjId=lambda it: [[it]]),
    "object ids in lists as text": changed(predObjId=lambda it: [f"{it}\n"]),
    "object ids with a line end": changed(predObjId="{}\r\n".format),
    "object ids with a tab": changed(predObjId="\t{}".format),
    "angles of PyTorch": changed(trajectory=angles("tensor({})".format)),
    "angles of numpy": changed(trajectory=angles("[{}]".format)),
    "angles in lists": changed(trajectory=angles(lambda it: [[it]])),
    "angles with a line end": changed(trajectory=angles("{}\n".format)),
    "viewpoints in lists": changed(
        trajectory=lambda it: [[[viewpoint], *rest] for viewpoint, *rest in it]
    ),
    "viewpoints as bytes": changed(
        trajectory=lambda it: [[f"b'{viewpoint}'", *rest] for viewpoint, *rest in it]
    ),
    "viewpoints with a line end": changed(
        trajectory=lambda it: [[f"{viewpoint}\r\n", *rest] for viewpoint, *rest in it]
    ),
    "poses in lists": changed(trajectory=lambda it: [[[pose]] for pose in it]),
    "trajectories in lists": changed(trajectory=lambda it: [[it]]),
    "trajectories as text": changed(trajectory=str),
    "ids in lists": changed(instr_id=lambda it: [[it]]),
    "ids of numpy": changed(instr_id="np.str_('{}')".format),
    "ids as bytes": changed(instr_id="b'{}'".format),
    "ids with a line end": changed(instr_id="{}\r\n".format),
}


@pytest.mark.parametrize("name", ONE_PROBLEM)
def test_a_mistake_of_all_values_is_one_problem_and_can_be_converted(
    name: str, demo: GroundTruth
) -> None:
    content = json.dumps(ONE_PROBLEM[name]).encode()
    with pytest.raises(SubmissionError) as rejected:
        validate(content, split=SPLIT, ground_truth=demo)
    (problem,) = rejected.value.problems
    assert problem.message.startswith(f"{len(OFFICIAL)} records have ")
    assert "reverie-eval convert" in problem.message
    fixed = convert(content, split=SPLIT, ground_truth=demo)
    assert len(fixed.fixed) == 1
    assert fixed.records == [
        {**record, "trajectory": [[it, float(a), float(b)] for it, a, b in record["trajectory"]]}
        for record in OFFICIAL
    ]


@pytest.mark.parametrize("shape", [(), (1,), (1, 1)])
@pytest.mark.parametrize("field", ["predObjId", "trajectory", "instr_id"])
def test_arrays_of_one_in_python_are_one_problem(
    field: str, shape: tuple[int, ...], demo: GroundTruth
) -> None:
    def array(value: Any) -> object:
        return np.array(value).reshape(shape)

    write = angles(array) if field == "trajectory" else array
    records = changed(**{field: write})
    with pytest.raises(SubmissionError) as rejected:
        validate(records, split=SPLIT, ground_truth=demo)
    (problem,) = rejected.value.problems
    assert problem.message.startswith(f"{len(OFFICIAL)} records have a tensor or an array instead")
    assert problem.message.endswith("; use .item()")


def test_a_mistake_in_several_fields_is_one_problem(demo: GroundTruth) -> None:
    records = changed(instr_id=lambda it: [it], predObjId=lambda it: [it])
    with pytest.raises(SubmissionError) as rejected:
        validate(records, split=SPLIT, ground_truth=demo)
    (problem,) = rejected.value.problems
    assert problem.message.startswith(f"{len(OFFICIAL)} records have {LISTED}")


@pytest.mark.parametrize(
    ("value", "told"),
    [
        pytest.param("tensor(0.25)", "got 'tensor(0.25)'; expected an object id", id="a fraction"),
        pytest.param("tensor([1, 2])", "got 'tensor([1, 2])'; expected", id="two"),
        pytest.param([[1, 2]], "got [[1, 2]]; expected an object id", id="two in a list"),
        pytest.param([[]], "got [[]]; expected an object id", id="none in a list"),
        pytest.param("tensor(True)", "got 'tensor(True)'; expected an object id", id="true"),
    ],
)
def test_what_does_not_tell_an_object_is_shown_as_it_is(
    value: object, told: str, demo: GroundTruth
) -> None:
    records = [{**OFFICIAL[0], "predObjId": value}, *OFFICIAL[1:]]
    with pytest.raises(SubmissionError) as rejected:
        validate(records, split=SPLIT, ground_truth=demo)
    (problem,) = rejected.value.problems
    assert (problem.code, problem.where) == ("wrong-type", "[0].predObjId")
    assert problem.message.startswith(told)


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_soons_points_in_lists_are_read(levels: int) -> None:
    """DUET writes lists of one, and a public converter lists of those."""
    records = json.loads((SAMPLES / "soon.json").read_bytes())
    expected = evaluate(records, split=SPLIT, task="soon")
    count = 0
    for record in records:
        for walk in record["trajectory"]:
            for key in ("obj_heading", "obj_elevation"):
                for _ in range(levels):
                    walk[key] = [walk[key]]
                count += 1
    scores = evaluate(json.dumps(records).encode(), split=SPLIT, task="soon")
    assert dict(scores) == dict(expected)
    assert f"{count} angles in lists of one" in scores.notes[0]


@pytest.mark.parametrize(
    ("write", "told"),
    [
        pytest.param("tensor([{}])".format, PRINTED, id="PyTorch"),
        pytest.param("{}".format, "numbers written as text", id="text"),
        pytest.param("{}\n".format, "numbers written as text", id="lines"),
    ],
)
def test_soons_points_as_text_are_one_problem(write: Callable[[float], str], told: str) -> None:
    records = json.loads((SAMPLES / "soon.json").read_bytes())
    expected = evaluate(records, split=SPLIT, task="soon")
    for record in records:
        for walk in record["trajectory"]:
            for key in ("obj_heading", "obj_elevation"):
                walk[key] = None if walk[key] is None else write(walk[key])
    with pytest.raises(SubmissionError) as rejected:
        evaluate(records, split=SPLIT, task="soon")
    (problem,) = rejected.value.problems
    assert told in problem.message
    converted = convert(records, task="soon").records
    assert dict(evaluate(converted, split=SPLIT, task="soon")) == dict(expected)
