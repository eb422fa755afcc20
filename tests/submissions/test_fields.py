"""Fields whose names are misspelt, and those that only resemble a known one."""

from collections.abc import Mapping
from typing import Any

import pytest

from reverie_eval.submissions import read_predictions
from reverie_eval.submissions._fields import fields_of, find_misspelt
from reverie_eval.tasks import find_task

FIELDS = fields_of(find_task("reverie"))
BOX = [10, 20, 30, 40]


@pytest.mark.parametrize(
    ("record", "expected"),
    [
        pytest.param({"predObjId": 5, "bbox": BOX}, {}, id="a box beside an answer"),
        pytest.param({"pred_objid": "5", "bbox": BOX}, {}, id="a box beside an answer of DUET"),
        pytest.param({"predObjId": -1, "bbox": BOX}, {"bbox": "predBox"}, id="a box alone"),
        pytest.param({"predObjId": 5, "objId": 7}, {}, id="an id beside an answer"),
        pytest.param({"pred_objid": "5", "objId": 7}, {}, id="an id beside an answer of DUET"),
        pytest.param({"predBox": BOX, "objId": 7}, {}, id="an id beside a box"),
        pytest.param({"predBox": None, "objId": 7}, {"objId": "predObjId"}, id="an id alone"),
        pytest.param({"predObjId": None, "objId": 7}, {}, id="an id beside a null answer"),
        pytest.param(
            {"predObjId": None, "predObjid": 7}, {"predObjid": "predObjId"}, id="behind a null"
        ),
        pytest.param(
            {"pred_objid": None, "predObjid": 7},
            {"predObjid": "predObjId"},
            id="behind DUET's null",
        ),
        pytest.param({"predObjId": None, "predObjid": None}, {}, id="null behind a null"),
        pytest.param(
            {"predBox": None, "pred_box": BOX}, {"pred_box": "predBox"}, id="a box behind a null"
        ),
        pytest.param(
            {"predBox": BOX, "predView": None, "pred_view": 3},
            {"pred_view": "predView"},
            id="a view behind a null",
        ),
        pytest.param(
            {"trajectory": None, "Trajectory": []},
            {"Trajectory": "trajectory"},
            id="a trajectory behind a null",
        ),
        pytest.param({"instrId": "7_1_0"}, {"instrId": "instr_id"}, id="an instr_id"),
        pytest.param({"id": 4}, {"id": "instr_id"}, id="an id of something"),
        pytest.param(
            {"id": 4, "instrId": "7_1_0"}, {"instrId": "instr_id"}, id="an instr_id beside it"
        ),
        pytest.param({"predObjId": -1, "view": 3}, {}, id="a view without a box"),
        pytest.param(
            {"predObjId": -1, "bbox": BOX, "view": 3},
            {"bbox": "predBox", "view": "predView"},
            id="a view beside a box",
        ),
    ],
)
def test_a_field_counts_as_misspelt_if_the_record_lacks_what_it_is_for(
    record: Mapping[str, Any], expected: Mapping[str, str]
) -> None:
    assert find_misspelt(record, FIELDS) == expected


def test_a_record_that_has_a_key_needs_no_instr_id() -> None:
    assert find_misspelt({"instrId": "7_1_0"}, FIELDS, {"instr_id"}) == {}


def test_answers_alone_need_no_trajectory() -> None:
    records = [{"instr_id": "7_1_0", "path": [["door", 0, 0]], "predObjId": 5}]
    predictions = read_predictions(records, answers_only=True)
    assert not predictions.problems
    assert predictions.ignored_fields == {"path": 1}


def test_names_are_compared_as_long_as_there_are_few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reverie_eval.submissions._records.MAX_COMPARED", 6)
    record = {"instr_id": "7_1_0", "trajectory": [["door", 0, 0]]}
    records = [{**record, f"pred-obj-id{'-' * row}": 5} for row in range(9)]
    predictions = read_predictions(records)
    assert [problem.code for problem in predictions.problems].count("misspelt-field") == 4
    assert len(predictions.ignored_fields) == 5
