"""Every codebase's form of the same results scores the same, and says how it was read.

``forms.py`` writes the forms from ``good.json``. What is no known form stays a problem with its
place, and what is sound but suspicious gets a remark.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from reverie_eval import (
    GroundTruth,
    Problem,
    Scores,
    SubmissionError,
    diagnose,
    evaluate,
    evaluate_protocols,
    validate,
)
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle
from reverie_eval.submissions import read_predictions
from reverie_eval.submissions._hints import UNNAMED_ANSWERS
from tests.conftest import SAMPLES
from tests.support.forms import FORMS, NAVIGATION_ONLY, OFFICIAL, Form, Record, hops, viewpoints
from tests.support.worlds import SPLIT

Values = Mapping[str, list[float]]

DUET = FORMS["E DUET with details"]
KEYED = Form(hops, DUET.answer, document=FORMS["M write_results"].document)
ABSENT_FROM_ALL = {"rgs", "rgspl"}

every_form = pytest.mark.parametrize("form", FORMS.values(), ids=list(FORMS))


def values_of(scores: Scores) -> Values:
    """Return the value of every metric and episode."""
    return {key: column.tolist() for key, column in scores.episodes.items()}


@pytest.fixture(scope="module")
def official(demo: GroundTruth) -> Mapping[str, Scores]:
    """Score the official file under every protocol."""
    return evaluate_protocols(SAMPLES / "good.json", split=SPLIT, ground_truth=demo)


# What the forms have in common.


@every_form
def test_every_form_scores_as_the_official_one_does(
    form: Form, official: Mapping[str, Scores], demo: GroundTruth
) -> None:
    """Under every protocol; what its form does not say is not compared."""
    results = evaluate_protocols(form.bytes(), split=SPLIT, ground_truth=demo)
    if form.meaning() != OFFICIAL:
        official = evaluate_protocols(form.meaning(), split=SPLIT, ground_truth=demo)
    assert results.keys() == official.keys()
    for name, scores in results.items():
        unsaid = _unsaid(form, name)
        told = {key: value for key, value in values_of(scores).items() if key not in unsaid}
        assert told == {
            key: value for key, value in values_of(official[name]).items() if key not in unsaid
        }
        assert all(scores.get(key, 0) == 0 for key in unsaid)
        assert ("rgs" in scores) == (bool(form.answer(1)) and "rgs" in official[name])


def _unsaid(form: Form, protocol: str) -> set[str]:
    """Return what a form scores 0 in: no answers, or text where ids have to be numbers."""
    answer = form.answer(1)
    key = next((key for key in ("predObjId", "pred_objid", "pred_obj_id") if key in answer), None)
    is_text = key is not None and isinstance(answer[key], str)
    counts = key is not None and not (is_text and protocol == "challenge-2022")
    return set() if counts else ABSENT_FROM_ALL


@every_form
def test_differences_from_the_official_form_are_reported(form: Form, demo: GroundTruth) -> None:
    read_as = [f"read as: {'; '.join(form.read_as)}"] if form.read_as else []
    ignored = ", ".join(f"{field} ({len(OFFICIAL)})" for field in form.dropped)
    remarks = [f"ignored fields: {ignored}"] if ignored else []
    if form.dropped and form in (FORMS[name] for name in NAVIGATION_ONLY):
        remarks.append(UNNAMED_ANSWERS)
    scores = evaluate(form.bytes(), split=SPLIT, ground_truth=demo)
    pointer = [note for note in scores.notes if "--diagnose" in note]
    assert len(pointer) == any("hops with more" in each for each in form.read_as)
    assert scores.notes == [*read_as, *remarks, *pointer]


@every_form
def test_validating_says_it_too(form: Form, demo: GroundTruth) -> None:
    checked = validate(form.bytes(), split=SPLIT, ground_truth=demo)
    assert [note for note in checked.notes if note.startswith("read as: ")] == (
        [f"read as: {'; '.join(form.read_as)}"] if form.read_as else []
    )


@pytest.mark.parametrize(
    "form",
    [form for name, form in FORMS.items() if name not in NAVIGATION_ONLY],
    ids=[name for name in FORMS if name not in NAVIGATION_ONLY],
)
def test_the_grounding_track_reads_every_form(form: Form, demo: GroundTruth) -> None:
    expected, scores = (
        evaluate(submission, split=SPLIT, ground_truth=demo, track="grounding")
        for submission in (form.meaning(), form.bytes())
    )
    assert values_of(scores) == values_of(expected)
    assert list(scores) == ["rgs"]


@every_form
def test_python_objects_of_every_form(form: Form, demo: GroundTruth) -> None:
    """An agent's output need not go through a file."""
    scores = evaluate(form.write(), split=SPLIT, ground_truth=demo)
    assert values_of(scores) == values_of(evaluate(form.bytes(), split=SPLIT, ground_truth=demo))


@pytest.mark.parametrize(
    "answers",
    [
        pytest.param({"predObjId": 402, "pred_objid": "402"}, id="number and text"),
        pytest.param({"pred_obj_id": "402"}, id="the old one alone"),
        pytest.param({"predObjId": 402, "pred_objid": "402", "pred_obj_id": 402}, id="three"),
    ],
)
def test_answers_under_several_keys_may_agree(answers: Mapping[str, Any]) -> None:
    predictions = read_predictions(answering(**answers))
    assert not predictions.problems
    assert predictions.predicted_object.tolist() == [402]


@pytest.mark.parametrize(
    "answers",
    [
        pytest.param({"predObjId": 402, "pred_objid": "7"}, id="two objects"),
        pytest.param({"pred_obj_id": 7, "pred_objid": "402"}, id="neither key official"),
        pytest.param({"predObjId": -1, "pred_objid": "402"}, id="an object and none"),
        pytest.param({"predObjId": "None", "pred_objid": "402"}, id="an object and HAMT's none"),
        pytest.param({"predObjId": 4, "pred_objid": 5, "pred_obj_id": None}, id="two, and null"),
        pytest.param({"predObjId": 402, "predObjid": "7"}, id="two spellings of a key"),
        pytest.param({"pred_objid": "402", "PredObjID": -1}, id="two spellings, DUET's key"),
    ],
)
def test_answers_under_several_keys_must_agree(answers: Mapping[str, Any]) -> None:
    """Codebases read different keys: any choice of ours would score what the agent did not say."""
    (problem,) = problems_of(answering(**answers) * 2)
    assert (problem.code, problem.where) == ("two-answers", "[0]")
    assert problem.message.startswith("2 records have different answers under two keys, such as {")
    assert problem.message.endswith("; keep one of the keys")


ABSENT = object()


@pytest.mark.parametrize("answer", [402, "402", 0, -1, "None"], ids=repr)
@pytest.mark.parametrize(
    "keys",
    [
        pytest.param(("predObjId", "pred_objid"), id="official, DUET's null"),
        pytest.param(("pred_objid", "predObjId"), id="DUET's, official null"),
        pytest.param(("pred_obj_id", "predObjId", "pred_objid"), id="older, both null"),
    ],
)
def test_null_beside_an_answer_is_not_a_second_answer(keys: Sequence[str], answer: object) -> None:
    """NaviLLM writes ``predObjId: 0`` where it has ``pred_objid: null``."""
    right, *others = keys
    predictions = read_predictions(answering(**dict.fromkeys(others), **{right: answer}) * 3)
    alone = read_predictions(answering(**{right: answer}) * 3)
    assert not predictions.problems
    assert predictions.predicted_object.tolist() == alone.predicted_object.tolist()
    assert predictions.answer_is_text.tolist() == alone.answer_is_text.tolist()
    assert predictions.read_as == [
        *alone.read_as,
        *(f"3 records with null under {key}, beside an answer" for key in sorted(others)),
    ]


def test_null_under_every_key_predicts_no_object() -> None:
    predictions = read_predictions(answering(predObjId=None, pred_objid=None))
    assert predictions.predicted_object.tolist() == [-1]
    assert predictions.read_as[1:] == ["1 answers that predict no object, not written as -1"]


@pytest.mark.parametrize(
    ("official", "respelt", "code"),
    [
        pytest.param(402, 402, None, id="equal"),
        pytest.param(402, "402", None, id="equal, as text"),
        pytest.param(402, None, None, id="null beside it"),
        pytest.param(None, 402, "misspelt-field", id="beside null"),
        pytest.param(None, None, None, id="two nulls"),
        pytest.param(ABSENT, None, "misspelt-field", id="alone"),
    ],
)
@pytest.mark.parametrize("spelling", ["predObjid", "predobjid", "PRED_OBJ_ID"])
def test_another_spelling_beside_an_answer(
    spelling: str, official: object, respelt: object, code: str | None
) -> None:
    """No answer is lost behind a null."""
    answers = {spelling: respelt} | ({} if official is ABSENT else {"predObjId": official})
    problems = problems_of(answering(**answers) * 2)
    assert [problem.code for problem in problems] == [code] * (code is not None)


def test_ids_with_leading_zeros_are_never_correct(demo: GroundTruth) -> None:
    """The published evaluators compare texts, or accept numbers only; a note says so."""
    padded = [
        {**record, "predObjId": f"00{record['predObjId']}"}
        if record["predObjId"] >= 0
        else dict(record)
        for record in OFFICIAL
    ]
    count = sum(record["predObjId"] >= 0 for record in OFFICIAL)
    for name, scores in evaluate_protocols(padded, split=SPLIT, ground_truth=demo).items():
        assert scores.get("rgs", 0) == 0, name
        assert (
            f"read as: {count} object ids written as text; {count} of these with leading zeros, "
            "which no published evaluator counts as correct"
        ) in scores.notes


def test_further_numbers_in_a_pose_are_counted() -> None:
    (record,) = walking(["a", 1, 2, 3], ["b", 1, 2], ["c", 1, 2, 3, 4])
    assert read_predictions([record]).read_as == [
        "2 poses with extra numbers after heading and elevation, ignored"
    ]


@pytest.mark.parametrize(
    ("trajectory", "viewpoint_ids", "places"),
    [
        pytest.param([["a"], ["b", "c"]], "abc", ["0.0", "1.0", "1.1"], id="hops"),
        pytest.param([["a"], [], ["b", "c"], []], "abc", ["0.0", "2.0", "2.1"], id="empty hops"),
        pytest.param([[], ["a"]], "a", ["1.0"], id="empty hop first"),
        pytest.param([["a", 0, 0], [], ["b", 0, 0]], "ab", ["0.0", "2.0"], id="among poses"),
        pytest.param(["a", [], "b"], "ab", ["0", "2"], id="among bare viewpoints"),
        pytest.param([["a", "b", "c", "d"]], "abcd", ["0.0", "0.1", "0.2", "0.3"], id="one hop"),
        pytest.param(["a", "b"], "ab", ["0", "1"], id="bare viewpoints"),
        pytest.param([["a", 0.5, 0], "b", ["c"], ["d", "a"]], "abcda", None, id="each its own"),
        pytest.param([["a", "a"]], "aa", ["0.0", "0.1"], id="waiting inside a hop"),
        pytest.param([["a", 1, 2, 3]], "a", ["0.0"], id="more numbers than angles"),
        pytest.param((("a",), ("b", "c")), "abc", ["0.0", "1.0", "1.1"], id="tuples"),
    ],
)
def test_a_trajectory_is_walked_from_first_to_last(
    trajectory: Any, viewpoint_ids: str, places: list[str] | None
) -> None:
    record = {"instr_id": "7_1_0", "trajectory": trajectory, "predObjId": 3}
    predictions = read_predictions([record])
    assert not predictions.problems
    assert list(predictions.viewpoint_ids) == list(viewpoint_ids)
    told = [predictions.pose_location(0, pose) for pose in range(len(viewpoint_ids))]
    assert places is None or [".".join(map(str, path)) for path in told] == places


# What nested hops lose.


def first_of_hops(record: Record) -> list[list[str]]:
    """Return hops cut to their first viewpoints, as many an evaluator reads them."""
    return [hop[:1] for hop in hops(record)]


def test_the_diagnosis_is_the_score_of_the_cut_file(
    official: Mapping[str, Scores], demo: GroundTruth
) -> None:
    whole, cut = diagnose(DUET.bytes(), split=SPLIT, ground_truth=demo)
    cut_file = Form(first_of_hops, DUET.answer).bytes()
    assert values_of(whole) == values_of(official["official-v1"])
    assert values_of(cut) == values_of(evaluate(cut_file, split=SPLIT, ground_truth=demo))


def test_the_diagnosis_names_what_would_be_lost(demo: GroundTruth) -> None:
    """Success goes, grounding stays: the pattern of the threads that ask why."""
    whole, cut = diagnose(DUET.bytes(), split=SPLIT, ground_truth=demo)
    assert cut["success"] < whole["success"]
    assert cut["path_length"] < whole["path_length"]
    assert cut["rgs"] == whole["rgs"]
    assert whole.qualifier == ""
    assert cut.signature == whole.signature.replace("|data:", "|reading:first-of-hop|data:")


@pytest.mark.parametrize(
    "name", [name for name, form in FORMS.items() if not any("hops" in it for it in form.read_as)]
)
def test_without_hops_nothing_is_lost(name: str, demo: GroundTruth) -> None:
    whole, cut = diagnose(FORMS[name].bytes(), split=SPLIT, ground_truth=demo)
    assert values_of(cut) == values_of(whole)


def test_a_rejected_file_is_not_diagnosed(demo: GroundTruth) -> None:
    """Also where nothing is left of the last trajectory to cut."""
    empty = [*DUET.write()[:-1], {**DUET.write()[-1], "trajectory": []}]
    with pytest.raises(SubmissionError) as rejected:
        diagnose(empty, split=SPLIT, ground_truth=demo)
    assert [problem.code for problem in rejected.value.problems] == ["empty-trajectory"]


# What remains a problem.


def problems_of(document: object) -> Sequence[Problem]:
    """Return what reading finds, in the order in which it is told."""
    content = document if isinstance(document, bytes) else json.dumps(document).encode()
    try:
        return SubmissionError(read_predictions(content).problems).problems
    except SubmissionError as error:
        return error.problems


def walking(*trajectory: object) -> list[Record]:
    """Return a document whose only trajectory has these elements."""
    return [{"instr_id": "7_1_0", "trajectory": list(trajectory), "predObjId": 3}]


def answering(**answers: object) -> list[Record]:
    """Return a document whose only record has these answers."""
    return [{"instr_id": "7_1_0", "trajectory": [["a"]], **answers}]


RECORD = walking(["a", 0, 0])[0]
NO_ANSWER = {"instr_id": "7_1_1", "trajectory": [["a", 0, 0]]}


@pytest.mark.parametrize(
    ("document", "code", "where", "fragment"),
    [
        pytest.param(
            [RECORD, NO_ANSWER],
            "missing-field",
            "[1]",
            "has neither predObjId nor predBox; add one",
            id="an answer here, none there",
        ),
        pytest.param(
            {"7_1_1": RECORD},
            "key-mismatch",
            '["7_1_1"].instr_id',
            "is '7_1_0' under the key '7_1_1'; make them equal",
            id="filed under another id",
        ),
        pytest.param(
            {"predictions": [RECORD]},
            "not-a-list",
            "file",
            "has the records under the key 'predictions'; write only the list of records",
            id="list in a wrapper",
        ),
        pytest.param(
            {"7_1_0": RECORD, "7_1_1": NO_ANSWER},
            "missing-field",
            '["7_1_1"]',
            "has neither predObjId nor predBox",
            id="the same, keyed",
        ),
        pytest.param(
            walking(["a"], ["b", "c", 3]),
            "wrong-type",
            "[0].trajectory[1]",
            "got ['b', 'c', 3]; expected [viewpoint_id, heading, elevation]",
            id="number in a hop",
        ),
        pytest.param(
            walking(["a"], ["b", None]), "wrong-type", "[0].trajectory[1]", "", id="null in a hop"
        ),
        pytest.param(
            walking(["a"], [["b"], ["c"]]),
            "wrong-type",
            "[0].trajectory[1]",
            "",
            id="hop in a hop",
        ),
        pytest.param(
            walking([], []), "empty-trajectory", "[0].trajectory", "is empty", id="empty hops only"
        ),
        pytest.param(
            walking({"path": [["a", 0, 0]]}),
            "wrong-type",
            "[0].trajectory",
            "a trajectory that is an object with a path, as in SOON",
            id="SOON",
        ),
        pytest.param(
            [{**RECORD, "trajectory": {"path": [["a"]]}}],
            "wrong-type",
            "[0].trajectory",
            "a trajectory that is an object with a path, as in SOON",
            id="SOON as DUET writes it",
        ),
        pytest.param(
            {"7_1_0": {**RECORD, "instr_id": None}},
            "wrong-type",
            '["7_1_0"].instr_id',
            "got null",
            id="keyed, id null",
        ),
        pytest.param(
            {"7_1_0": RECORD, "7_1_1": [["a", 0, 0]]},
            "wrong-type",
            '["7_1_1"]',
            "expected an object with instr_id, trajectory and predObjId",
            id="keyed trajectories",
        ),
        pytest.param(
            {"7_1_0": {**RECORD, "trajectory": [["a"], ["b", 1, None]]}},
            "wrong-type",
            '["7_1_0"].trajectory[1]',
            "got ['b', 1, None]",
            id="keyed, wrong pose",
        ),
        pytest.param(
            b'{"7_1_0": %b, "7_1_0": %b}' % ((json.dumps(RECORD).encode(),) * 2),
            "repeated-field",
            "file",
            "has '7_1_0' twice; keep the right one",
            id="keyed, id twice",
        ),
        pytest.param(
            RECORD, "not-a-list", "file", "expected a list of predictions", id="record alone"
        ),
        pytest.param(
            answering(pred_objid=["402", "17"]),
            "wrong-type",
            "[0].pred_objid",
            "got ['402', '17']; expected an object id",
            id="list under DUET's key",
        ),
        pytest.param(
            answering(pred_obj_id="chair"),
            "wrong-type",
            "[0].pred_obj_id",
            "got 'chair'",
            id="word under the old key",
        ),
        pytest.param(
            answering(predObjId="none"), "wrong-type", "[0].predObjId", "got 'none'", id="none"
        ),
        pytest.param(
            answering(predObjId="402.0"), "wrong-type", "[0].predObjId", "", id="float as text"
        ),
        pytest.param(
            answering(predObjId=402.0), "wrong-type", "[0].predObjId", "such as 402.0", id="float"
        ),
        pytest.param(
            answering(objId=402, predObjId=None) + answering(objId=402),
            "misspelt-field",
            "[1]",
            "has the field 'objId', which is not read; did you mean predObjId?",
            id="the dataset's key for the target",
        ),
    ],
)
def test_what_is_no_known_form(document: object, code: str, where: str, fragment: str) -> None:
    (problem,) = problems_of(document)
    assert (problem.code, problem.where) == (code, where)
    assert fragment in problem.message


def places_of(document: object, truth: GroundTruth) -> list[tuple[str, str]]:
    """Return code and place of everything that is wrong with a submission."""
    with pytest.raises(SubmissionError) as rejected:
        validate(json.dumps(document).encode(), split=SPLIT, ground_truth=truth)
    return [(problem.code, problem.where) for problem in rejected.value.problems]


WALKER = next(record for record in OFFICIAL if len(record["trajectory"]) >= 5)
ID = WALKER["instr_id"]
ROW = OFFICIAL.index(WALKER)


@pytest.mark.parametrize(
    ("form", "element", "where"),
    [
        pytest.param(FORMS["A official"], [2, 0], f"[{ROW}].trajectory[2][0]", id="official"),
        pytest.param(FORMS["J LAD"], [2, 0], f"[{ROW}].trajectory[2][0]", id="single viewpoints"),
        pytest.param(FORMS["bare viewpoints"], [2], f"[{ROW}].trajectory[2]", id="bare viewpoints"),
        pytest.param(DUET, [2, 1], f"[{ROW}].trajectory[2][1]", id="in a hop"),
        pytest.param(KEYED, [2, 1], f'["{ID}"].trajectory[2][1]', id="in a hop, keyed"),
        pytest.param(
            FORMS["M write_results"], [1, 0], f'["{ID}"].trajectory[1][0]', id="pose, keyed"
        ),
    ],
)
def test_the_place_of_an_unknown_viewpoint(
    form: Form, element: list[int], where: str, demo: GroundTruth
) -> None:
    document = form.write()
    parent = document[ID if isinstance(document, dict) else ROW]["trajectory"]
    *path, last = element
    for number in path:
        parent = parent[number]
    assert parent[last] in viewpoints(WALKER)
    parent[last] = "cellar"
    assert places_of(document, demo) == [("unknown-viewpoint", where)]


def test_the_place_of_a_wrong_start_behind_an_empty_hop(demo: GroundTruth) -> None:
    document = KEYED.write()
    document[ID]["trajectory"][:1] = [[], [viewpoints(WALKER)[1]]]
    assert places_of(document, demo) == [("wrong-start", f'["{ID}"].trajectory[0]')]


def test_a_prefix_makes_no_other_episode(demo: GroundTruth) -> None:
    again = {**OFFICIAL[0], "instr_id": f"reverie_{OFFICIAL[0]['instr_id']}"}
    where = f"[{len(OFFICIAL)}].instr_id"
    assert places_of([*OFFICIAL, again], demo) == [("duplicate-episode", where)]


# Sound, and perhaps not what was meant.


def answering_all(object_id: int, of: slice = slice(None)) -> list[Record]:
    """Return the good results with this object named in the records of a slice."""
    changed = range(len(OFFICIAL))[of]
    return [
        {**record, "predObjId": object_id} if row in changed else record
        for row, record in enumerate(OFFICIAL)
    ]


def turned(
    turn: Callable[[float, float], tuple[float, float]], of: slice = slice(None)
) -> list[Record]:
    """Return the good results with other angles in the records of a slice."""
    changed = range(len(OFFICIAL))[of]
    return [
        {
            **record,
            "trajectory": [
                [viewpoint_id, *(turn(*angles) if row in changed else angles)]
                for viewpoint_id, *angles in record["trajectory"]
            ],
        }
        for row, record in enumerate(OFFICIAL)
    ]


def staying(moves: int = 0) -> list[Record]:
    """Return the good results of agents that stay, but for the first so many that move."""
    movers = [record for record in OFFICIAL if len(record["trajectory"]) > 1][:moves]
    return [
        record if record in movers else {**record, "trajectory": record["trajectory"][:1]}
        for record in OFFICIAL
    ]


def in_degrees(heading: float, elevation: float) -> tuple[float, float]:
    """Return angles as agents write them that were trained on degrees."""
    return math.degrees(heading) + 360, math.degrees(elevation)


HALF = len(OFFICIAL) // 2
NONE = "no answer predicts an object: RGS will be 0"
ZERO = (
    "most answers predict object 0, which is an object like any other; write -1 where the agent "
    "predicts no object"
)
NOWHERE = "no predicted object is visible where its agent stops"
STILL = "every trajectory has a single pose: no agent moves"
DEGREES = "most headings or elevations exceed a full turn: angles are radians, not degrees"


@pytest.mark.parametrize(
    ("submission", "beginnings"),
    [
        pytest.param(OFFICIAL, [], id="nothing suspicious"),
        pytest.param(answering_all(-1), [NONE], id="no object"),
        pytest.param(answering_all(-1, slice(1, None)), [], id="one object"),
        pytest.param(answering_all(0, slice(HALF + 1)), [ZERO], id="object 0 in over half"),
        pytest.param(answering_all(0, slice(HALF - 10)), [], id="object 0 in under half"),
        pytest.param(answering_all(999_999), [NOWHERE], id="ids of something else"),
        pytest.param(
            answering_all(999_999, slice(1, None)),
            ["of 84 predicted objects, only 1 can be seen"],
            id="one id is right",
        ),
        pytest.param(answering_all(999_999, slice(HALF, None)), [], id="half of the ids are right"),
        pytest.param(turned(in_degrees), [DEGREES], id="degrees"),
        pytest.param(turned(in_degrees, slice(HALF + 1)), [DEGREES], id="over half in degrees"),
        pytest.param(turned(in_degrees, slice(HALF)), [], id="under half in degrees"),
        pytest.param(turned(lambda *_: (0.0, -90.0)), [DEGREES], id="elevation in degrees"),
        pytest.param(turned(lambda *_: (math.tau, -math.tau)), [], id="a full turn"),
        pytest.param(
            turned(lambda *_: (math.nextafter(math.tau, 7), 0)), [DEGREES], id="just beyond it"
        ),
    ],
)
def test_a_remark(
    submission: Sequence[Record], beginnings: Sequence[str], demo: GroundTruth
) -> None:
    notes = evaluate(submission, split=SPLIT, ground_truth=demo).notes
    assert [note for note in notes if not any(map(note.startswith, beginnings))] == []
    assert len(notes) == len(beginnings)


def test_object_0_everywhere(demo: GroundTruth) -> None:
    """As some write where they name none; it is right once in a while."""
    few_zeros = [record for record in OFFICIAL if record["predObjId"] != 0][: HALF - 10]
    named = [record if record in few_zeros else {**record, "predObjId": 0} for record in OFFICIAL]
    (zero,) = evaluate(named, split=SPLIT, ground_truth=demo).notes
    assert zero.startswith(ZERO)
    assert "where the agent predicts no object" in zero


def test_agents_that_stay(demo: GroundTruth) -> None:
    notes = evaluate(staying(), split=SPLIT, ground_truth=demo).notes
    assert STILL in notes
    assert STILL not in evaluate(staying(moves=1), split=SPLIT, ground_truth=demo).notes


def test_several_remarks_in_order(demo: GroundTruth) -> None:
    submission = [{**record, "predObjId": None} for record in turned(in_degrees)]
    read, silent, degrees = evaluate(submission, split=SPLIT, ground_truth=demo).notes
    assert read == f"read as: {len(OFFICIAL)} answers that predict no object, not written as -1"
    assert silent.startswith(NONE)
    assert degrees == DEGREES


def test_the_grounding_track_remarks_on_answers_alone(demo: GroundTruth) -> None:
    records = [{**record, "trajectory": []} for record in answering_all(999_999)]
    scores = evaluate(records, split=SPLIT, ground_truth=demo, track="grounding")
    (note,) = scores.notes
    assert note.startswith(NOWHERE)


def test_the_good_sample_gives_no_note() -> None:
    assert evaluate(SAMPLES / "good.json", split=SPLIT).notes == []


@pytest.fixture(scope="module")
def public() -> GroundTruth:
    """Load the demo world's val_unseen split without its answers."""
    return GroundTruth.from_bundle(Bundle.load(DEMO_BUNDLES / f"{SPLIT}.npz").public())


@pytest.mark.parametrize(
    ("submission", "note"),
    [
        pytest.param(answering_all(-1), NONE, id="no object"),
        pytest.param(answering_all(0), ZERO, id="object 0"),
        pytest.param(staying(), STILL, id="single poses"),
        pytest.param(turned(in_degrees), DEGREES, id="degrees"),
    ],
)
def test_a_public_bundle_remarks_on_what_the_file_says(
    submission: Sequence[Record], note: str, public: GroundTruth
) -> None:
    notes = validate(submission, split=SPLIT, ground_truth=public).notes
    assert [it for it in notes if it.startswith(note)]


def test_a_public_bundle_gives_no_remark_that_needs_answers(
    public: GroundTruth, demo: GroundTruth
) -> None:
    submission = answering_all(999_999)
    (with_answers,) = validate(submission, split=SPLIT, ground_truth=demo).notes
    assert with_answers.startswith(NOWHERE)
    assert validate(submission, split=SPLIT, ground_truth=public).notes == []


def test_notes_reach_the_report(tmp_path: Path, demo: GroundTruth) -> None:
    file = tmp_path / "submit.json"
    file.write_bytes(DUET.bytes())
    scores = evaluate(file, split=SPLIT, ground_truth=demo)
    assert scores.to_report().notes == list(scores.notes)
    assert scores.notes[0].startswith("read as: ")
