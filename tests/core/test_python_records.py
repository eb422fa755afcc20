"""What an agent has in memory is read as a file of it would be: numpy's numbers, tuples, anything.

Python records have a fast lane too. It declines, or says what the careful one says.
"""

from collections import UserList, deque, namedtuple
from decimal import Decimal
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from reverie_eval.submissions import read_predictions
from reverie_eval.submissions._fast import convert_official
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._records import read_carefully
from tests.support.amounts import amount
from tests.support.json_records import boxes_of, columns_of, places_of, problems_of

Pose = namedtuple("Pose", ["viewpoint_id", "heading", "elevation"])  # noqa: PYI024  # as agents do
POSE = ("hall", 1.5, 0.25)


def record(**fields: Any) -> dict[str, Any]:
    """Return a right record, with other values for some of its fields."""
    return {"instr_id": "7_1_0", "trajectory": [POSE], "predObjId": 3} | fields


def ending_in(pose: Any) -> dict[str, Any]:
    """Return a record whose trajectory ends in this pose."""
    return record(trajectory=[POSE, pose])


class Text(str):
    """A text that is more than that."""

    __slots__ = ()


class Deep(NamedTuple):
    """An answer that is no number."""

    number: int


# What agents have.


@pytest.mark.parametrize(
    "written",
    [
        pytest.param(record(), id="lists of tuples"),
        pytest.param(record(trajectory=[list(POSE)]), id="lists of lists"),
        pytest.param(record(trajectory=(POSE,)), id="tuples of tuples"),
        pytest.param(
            record(trajectory=[("hall", np.float64(1.5), np.float64(0.25))]), id="float64"
        ),
        pytest.param(
            record(trajectory=[("hall", np.float32(1.5), np.float32(0.25))]), id="float32"
        ),
        pytest.param(record(predObjId=np.int64(3)), id="object as int64"),
        pytest.param(record(predObjId=np.int32(3)), id="object as int32"),
    ],
)
def test_the_fast_lane_takes_what_agents_have(written: dict[str, Any]) -> None:
    predictions = convert_official([written])
    assert predictions is not None
    assert columns_of(predictions) == (["7_1_0"], ["hall"], [0, 1], [3], False)


@pytest.mark.parametrize(
    "written",
    [
        pytest.param(record(trajectory=[Pose(*POSE)]), id="named tuples"),
        pytest.param(record(trajectory=[("hall", np.float16(1.5), 0.25)]), id="float16"),
        pytest.param(record(trajectory=[("hall", Fraction(3, 2), 0.25)]), id="fraction"),
        pytest.param(record(trajectory=[("hall", 1.5, 0.25, 7.0)]), id="further number"),
        pytest.param(record(instr_id=Text("7_1_0")), id="kind of text"),
        pytest.param(record(predObjId=np.uint8(3)), id="kind of whole number"),
        pytest.param(record(instr_id="reverie_7_1_0"), id="prefix"),
        pytest.param(record(scores=[0.5]), id="further field"),
        pytest.param(record(predObjId="3"), id="object as text"),
    ],
)
def test_the_careful_lane_takes_what_is_like_it(written: dict[str, Any]) -> None:
    assert convert_official([written]) is None
    columns = columns_of(read_predictions([written]))
    assert columns == (["7_1_0"], ["hall"], [0, 1], [3], False)


@pytest.mark.parametrize("pose", [("bath",), ("bath", 1.5, 0.25, 7.0)], ids=["shorter", "longer"])
def test_poses_of_several_lengths(pose: tuple[Any, ...]) -> None:
    assert convert_official([ending_in(pose)]) is None
    assert [*read_predictions([ending_in(pose)]).viewpoint_ids] == ["hall", "bath"]


def test_the_last_pose_of_each_record_is_its_stop() -> None:
    in_degrees, in_radians = ("bath", 90.0, 0.0), ("hall", 3, 0.5)
    written = [record(trajectory=[POSE, in_degrees]), ending_in(in_degrees), record()]
    predictions = convert_official(written)
    assert predictions is not None
    assert predictions.offsets.tolist() == [0, 2, 4, 5]
    assert predictions.has_degrees
    turned = convert_official([record(trajectory=[in_degrees, in_radians])])
    assert turned is not None
    assert not turned.has_degrees


# What is none.


@pytest.mark.parametrize(
    ("written", "code", "where"),
    [
        pytest.param(ending_in(("a", np.nan, 0.0)), "not-finite", "trajectory[1]", id="NaN"),
        pytest.param(ending_in(("a", 0.0, -np.inf)), "not-finite", "trajectory[1]", id="-inf"),
        pytest.param(
            ending_in(("a", np.float32("nan"), 0.0)), "not-finite", "trajectory[1]", id="NaN, 32"
        ),
        pytest.param(
            ending_in(("a", 10**400, 0)), "not-finite", "trajectory[1]", id="beyond floats"
        ),
        pytest.param(ending_in(("a", True, 0)), "wrong-type", "trajectory[1]", id="truth"),
        pytest.param(ending_in(("a", Decimal(1), 0)), "wrong-type", "trajectory[1]", id="decimal"),
        pytest.param(ending_in({"a", 1.0, 2.0}), "wrong-type", "trajectory[1]", id="set for pose"),
        pytest.param(record(trajectory={POSE}), "wrong-type", "trajectory", id="set of poses"),
        pytest.param(
            record(trajectory=deque([POSE])), "wrong-type", "trajectory", id="deque of poses"
        ),
        pytest.param(
            record(trajectory=np.zeros(3)), "wrong-type", "trajectory", id="array of poses"
        ),
        pytest.param(record(trajectory=[]), "empty-trajectory", "trajectory", id="no pose"),
        pytest.param(record(predObjId=np.array(3)), "wrong-type", "predObjId", id="array"),
        pytest.param(record(predObjId=np.float64(3)), "wrong-type", "predObjId", id="float"),
        pytest.param(record(predObjId=np.True_), "wrong-type", "predObjId", id="numpy's truth"),
        pytest.param(record(predObjId=-2), "wrong-type", "predObjId", id="below -1"),
        pytest.param(record(predObjId=2**31), "wrong-type", "predObjId", id="beyond 32 bits"),
        pytest.param(record(predObjId=2**70), "wrong-type", "predObjId", id="beyond 64 bits"),
        pytest.param(record(predObjId=Deep(3)), "wrong-type", "predObjId", id="tuple"),
    ],
)
def test_a_python_value_that_is_none_of_the_format(
    written: dict[str, Any], code: str, where: str
) -> None:
    (problem,) = problems_of([record(), written])
    assert (problem.code, problem.where) == (code, f"[1].{where}")


class Tensor:
    """A number as torch holds it."""

    ndim = 0

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        return np.array(3, dtype=dtype)

    def tolist(self) -> int:
        """Return the number."""
        return 3


@pytest.mark.parametrize(
    ("written", "remedy"),
    [
        pytest.param(record(predObjId=np.array(3)), "use .item()", id="array"),
        pytest.param(record(predObjId=Tensor()), "use .item()", id="tensor"),
        pytest.param(record(predObjId=np.array([3])), "use .item()", id="array of one"),
        pytest.param(record(predObjId=np.array([3, 4])), "use .tolist()", id="array of two"),
        pytest.param(ending_in(("a", np.array(1.5), 0.0)), "use .item()", id="array in a pose"),
        pytest.param(ending_in(np.zeros(3)), "use .tolist()", id="array as a pose"),
        pytest.param(record(trajectory=np.zeros(3)), "use .tolist()", id="array of poses"),
        pytest.param(record(predObjId=np.True_), "predicts no object", id="number of numpy's"),
        pytest.param(
            {"instr_id": "7_1_0", "trajectory": [POSE], "predBox": [1, 2, 3, 4]}
            | {"predView": np.array(4)},
            "use .item()",
            id="view",
        ),
    ],
)
def test_arrays_and_tensors_are_refused_with_the_remedy(
    written: dict[str, Any], remedy: str
) -> None:
    """Which number an array of several means is for the agent to say."""
    (problem,) = problems_of([record(), written])
    assert problem.message.endswith(remedy)


@pytest.mark.parametrize("submission", [UserList([record()]), range(3)], ids=["user list", "range"])
def test_a_collection_that_is_no_list(submission: Any) -> None:
    (problem,) = problems_of(submission)
    assert (problem.code, problem.where) == ("not-a-list", "file")


# The lanes.

texts = st.text(max_size=3) | st.sampled_from(["reverie_", "reverie_7_1_0", Text("a")])
floats = st.one_of(
    st.floats(-1e6, 1e6),
    st.integers(-(2**70), 2**70),
    st.floats(-1e6, 1e6).map(np.float64),
    st.floats(-1e6, 1e6).map(np.float32),
)
wholes = st.integers(-1, 2**31 - 1)
poses = st.tuples(texts, floats, floats)
right_records = st.fixed_dictionaries(
    {
        "instr_id": st.text(max_size=3),
        "trajectory": st.lists(poses | poses.map(list), min_size=1, max_size=3),
        "predObjId": wholes | wholes.map(np.int64) | wholes.map(np.int32),
    }
)
strange = st.one_of(
    st.none() | st.booleans() | st.integers() | st.floats() | texts | st.binary(max_size=2),
    st.sampled_from([Decimal(3), Fraction(1, 3), np.float16(1.5), np.uint8(3), np.array(3)]),
    st.sampled_from([2**70, 10**400, -2, np.int64(-2), np.float32("inf"), np.str_("hall")]),
    st.frozensets(poses, max_size=1),
    st.sampled_from([Pose(*POSE), [], (), {}, ["hall"], ("hall", "bath"), UserList([POSE])]),
)
wrong_records = st.one_of(
    strange,
    st.builds(lambda field, value: record(**{field: value}), st.sampled_from([*record()]), strange),
    st.builds(lambda value: record(note=value), strange),
    st.sampled_from([*record()]).map(lambda gone: {k: v for k, v in record().items() if k != gone}),
    strange.map(ending_in),
    st.tuples(strange, strange, strange).map(ending_in),
    st.tuples(st.just("hall"), strange, st.just(0.5)).map(ending_in),
)
submissions: Any = st.builds(
    lambda before, wrong, after, form: form([*before, *wrong, *after]),
    st.lists(right_records, max_size=2),
    st.lists(wrong_records, max_size=1),
    st.lists(right_records, max_size=2),
    st.sampled_from([list, tuple, deque]),
)


@settings(max_examples=amount(150))
@given(submission=submissions)
def test_the_fast_lane_declines_or_agrees(submission: Any) -> None:
    predictions = convert_official(submission)
    event("taken" if predictions else "declined")
    if predictions:
        carefully = read_carefully(submission, ReadingLog())
        assert columns_of(predictions) == columns_of(carefully)
        assert places_of(predictions) == places_of(carefully)
        assert boxes_of(predictions) == boxes_of(carefully) == []
        assert predictions.answer_is_text.tolist() == carefully.answer_is_text.tolist()
        assert not [*carefully.read_as, *carefully.problems]


@given(submission=st.lists(right_records.filter(lambda it: it["instr_id"]), min_size=1, max_size=3))
def test_plain_records_take_the_fast_lane(submission: Any) -> None:
    """But for what a text of another type, or a prefix, may mean."""
    viewpoints = [pose[0] for one in submission for pose in one["trajectory"]]
    plain = all(type(text) is str for text in viewpoints)
    prefixed = any(one["instr_id"].startswith("reverie_") for one in submission)
    assert (convert_official(submission) is not None) == (plain and not prefixed)
