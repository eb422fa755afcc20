"""Protocols: their pinned definitions, and each rule at its threshold."""

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval import PROTOCOLS, GroundTruth, Scores, evaluate, evaluate_protocols
from reverie_eval.scoring import DEFAULT_PROTOCOL, scored_metrics
from reverie_eval.tasks import find_task
from tests.conftest import SAMPLES
from tests.support.metrics import BOX_METRICS
from tests.support.oracle import Item, Position, Prediction, Scan, Viewpoint, World
from tests.support.worlds import SPLIT, ground_truth_by_hand, ground_truth_of, records_of

GOOD = SAMPLES / "good.json"

# What a protocol is.

REVERIE = find_task("reverie")
RELEASED: Mapping[str, Mapping[str, Any]] = {
    "official-v1": {
        "goal": "visible",
        "spl_numerator": "shortest",
        "spl_floor": 0.0,
        "rgspl_floor": 0.0,
        "grounding": "anywhere",
        "text_ids_count": True,
        "nested_hops": "first viewpoint",
    },
    "paper": {
        "goal": "visible",
        "spl_numerator": "shortest",
        "spl_floor": 0.0,
        "rgspl_floor": 0.0,
        "grounding": "only with success",
        "text_ids_count": True,
        "nested_hops": "no evaluator",
    },
    "paper-3m": {
        "goal": "at most 3 m from the object",
        "spl_numerator": "shortest",
        "spl_floor": 0.0,
        "rgspl_floor": 0.0,
        "grounding": "only with success",
        "text_ids_count": True,
        "nested_hops": "no evaluator",
    },
    "challenge-2022": {
        "goal": "visible and near the object",
        "spl_numerator": "shortest",
        "spl_floor": 0.01,
        "rgspl_floor": 0.0,
        "grounding": "anywhere",
        "text_ids_count": False,
        "nested_hops": "first viewpoint",
    },
    "airbert": {
        "goal": "visible",
        "spl_numerator": "shortest",
        "spl_floor": 0.01,
        "rgspl_floor": 0.0,
        "grounding": "anywhere",
        "text_ids_count": True,
        "nested_hops": "first viewpoint",
    },
    "duet": {
        "goal": "visible",
        "spl_numerator": "annotated",
        "spl_floor": 0.01,
        "rgspl_floor": 0.01,
        "grounding": "anywhere",
        "text_ids_count": True,
        "nested_hops": "every viewpoint",
    },
    "scalevln": {
        "goal": "visible",
        "spl_numerator": "annotated",
        "spl_floor": 0.01,
        "rgspl_floor": 0.01,
        "grounding": "only with success",
        "text_ids_count": True,
        "nested_hops": "every viewpoint",
    },
    "r2r-style": {
        "goal": "near the path's end",
        "spl_numerator": "shortest",
        "spl_floor": 0.0,
        "rgspl_floor": 0.0,
        "grounding": "not scored",
        "text_ids_count": True,
        "nested_hops": "rejected",
    },
    "navrag": {
        "goal": "near the path's end",
        "spl_numerator": "annotated",
        "spl_floor": 0.01,
        "rgspl_floor": 0.0,
        "grounding": "not scored",
        "text_ids_count": True,
        "nested_hops": "every viewpoint",
    },
}
"""A released protocol never changes: a correction is a new protocol with another name."""
OF_OTHER_ITEMS: Mapping[str, Any] = {
    "reference": "",
    "repeated_outlines": "first",
    "point_errors": "detections",
    "measures": frozenset(),
    "scored_instructions": None,
    "rejects_jumps": False,
}
"""Rules that none of REVERIE's protocols has."""
PROSE = ("name", "summary", "source")


@pytest.mark.parametrize("name", RELEASED)
def test_a_released_protocol_never_changes(name: str) -> None:
    fields = asdict(PROTOCOLS[name])
    rules = {field: fields[field] for field in fields if field not in PROSE}
    assert rules == {**RELEASED[name], **OF_OTHER_ITEMS}


def test_every_protocol_is_pinned_in_table_order() -> None:
    assert list(PROTOCOLS) == list(RELEASED)
    assert [rules.name for rules in PROTOCOLS.values()] == list(RELEASED)
    assert DEFAULT_PROTOCOL == "official-v1"


def test_every_protocol_gives_its_source() -> None:
    assert all(rules.summary and rules.source for rules in PROTOCOLS.values())


@pytest.mark.parametrize(
    ("alias", "name"),
    [("hamt", "duet"), ("navillm", "duet"), ("hm3d", "scalevln"), ("mapgpt", "navrag")],
)
def test_an_alias(alias: str, name: str) -> None:
    assert REVERIE.protocol(alias) is PROTOCOLS[name]
    assert evaluate(GOOD, split=SPLIT, protocol=alias) == evaluate(GOOD, split=SPLIT, protocol=name)


def test_aliases_are_not_protocols() -> None:
    assert dict(REVERIE.aliases) == {
        "hamt": "duet",
        "navillm": "duet",
        "hm3d": "scalevln",
        "mapgpt": "navrag",
    }
    assert not REVERIE.aliases.keys() & PROTOCOLS.keys()
    assert dict(REVERIE.hops_by_alias) == {"hamt": "first viewpoint"}


def test_the_signature_has_the_protocol_not_its_alias() -> None:
    assert "|protocol:duet|" in evaluate(GOOD, split=SPLIT, protocol="hamt").signature


@pytest.mark.parametrize(
    ("name", "guess"),
    [
        pytest.param("mine", "choose", id="nothing like it"),
        pytest.param("", "choose", id="empty"),
        pytest.param("DUET", "did you mean duet? Choose", id="in capitals"),
        pytest.param("official", "did you mean official-v1? Choose", id="without its version"),
    ],
)
def test_an_unknown_protocol(name: str, guess: str) -> None:
    with pytest.raises(rv.ProtocolError) as error:
        evaluate(GOOD, split=SPLIT, protocol=name)
    assert str(error.value) == (
        f"unknown protocol {name!r}; {guess} one of: {', '.join([*PROTOCOLS, *REVERIE.aliases])}"
    )


# At the boundaries: a corridor along the x axis with a goal at 0 m that shows the target.

TARGET = 7
GOAL, STOP, START = "goal", "stop", "start"
ORIGIN: Position = (0.0, 0.0, 0.0)


def corridor(stop: float = 2.0, centre: Position | None = ORIGIN) -> World:
    """Return a world whose agent stops this far from the goal; the target is visible at both."""
    seen = {TARGET: [0]}
    viewpoints = {
        GOAL: Viewpoint(ORIGIN, views=seen),
        STOP: Viewpoint((stop, 0.0, 0.0), views=seen),
        START: Viewpoint((10.0, 0.0, 0.0)),
    }
    edges = frozenset({(GOAL, STOP), (STOP, START)})
    centres = {} if centre is None else {TARGET: centre}
    scan = Scan(viewpoints, edges, centres)
    return World({"house": scan}, [Item("1_7", "house", [START, STOP, GOAL], TARGET)])


def scored(
    world: World, protocol: str, *way: str, answer: int = TARGET, as_text: bool = False
) -> Scores:
    """Score an agent with this trajectory in a world compiled from files."""
    submission = records_of({"1_7_0": Prediction([*way], answer, as_text=as_text)})
    truth = ground_truth_of(world)
    return evaluate(submission, split=SPLIT, ground_truth=truth, protocol=protocol)


JUST_BELOW, JUST_ABOVE = float(np.nextafter(3.0, 0.0)), float(np.nextafter(3.0, 4.0))


@pytest.mark.parametrize(
    ("metres", "success"),
    [
        pytest.param(0.0, 1.0, id="on its end"),
        pytest.param(JUST_BELOW, 1.0, id="just below 3 m"),
        pytest.param(3.0, 0.0, id="exactly 3 m"),
        pytest.param(JUST_ABOVE, 0.0, id="just above 3 m"),
    ],
)
def test_r2r_style_success_is_less_than_3_m_from_the_paths_end(
    metres: float, success: float
) -> None:
    """Strictly less, as in every evaluator of Room-to-Room."""
    scores = scored(corridor(stop=metres), "r2r-style", START, STOP)
    assert (scores["success"], scores["oracle_success"]) == (success, success)


def test_r2r_style_measures_along_the_graph() -> None:
    """2 m from the goal in a straight line, 18 m along the graph."""
    world = corridor(stop=2.0)
    scan = world.scans["house"]
    walled = replace(scan, unobstructed=frozenset({(GOAL, START), (START, STOP)}))
    scores = scored(replace(world, scans={"house": walled}), "r2r-style", START, STOP)
    assert (scores["success"], scores["navigation_error"]) == (0.0, 18.0)


def test_r2r_style_does_not_require_visibility() -> None:
    blind = corridor(stop=2.0)
    scan = blind.scans["house"]
    stop = replace(scan.viewpoints[STOP], views={})
    blind = replace(
        blind, scans={"house": replace(scan, viewpoints={**scan.viewpoints, STOP: stop})}
    )
    assert scored(blind, "r2r-style", START, STOP)["success"] == 1.0
    assert scored(blind, "official-v1", START, STOP)["success"] == 0.0


@pytest.mark.parametrize(
    ("centre", "success"),
    [
        pytest.param((2.0, 0.0, 0.0), 1.0, id="at the camera"),
        pytest.param((2.0, JUST_BELOW, 0.0), 1.0, id="just below 3 m"),
        pytest.param((2.0, 0.0, -3.0), 1.0, id="exactly 3 m below the camera"),
        pytest.param((3.0, 2.0, 2.0), 1.0, id="exactly 3 m across"),
        pytest.param((2.0, 0.0, JUST_ABOVE), 0.0, id="just above 3 m"),
        pytest.param(None, 0.0, id="not known where"),
    ],
)
def test_challenge_2022_success_is_at_most_3_m_from_the_object(
    centre: Position | None, success: float
) -> None:
    """At most, unlike Room-to-Room's "less than"."""
    scores = scored(corridor(stop=2.0, centre=centre), "challenge-2022", START, STOP)
    assert (scores["success"], scores["oracle_success"]) == (success, success)
    assert scored(corridor(stop=2.0, centre=centre), "official-v1", START, STOP)["success"] == 1.0


@pytest.mark.parametrize(("metres", "success"), [(JUST_BELOW, 1.0), (3.0, 1.0), (JUST_ABOVE, 0.0)])
def test_the_papers_text_counts_3_m_from_the_object(metres: float, success: float) -> None:
    """Exactly 3 m is within 3 m."""
    world = corridor(stop=2.0, centre=(2.0, metres, 0.0))
    assert scored(world, "paper-3m", START, STOP)["success"] == success


def test_the_papers_text_does_not_ask_for_visibility() -> None:
    world = corridor(centre=(9.5, 0.0, 0.0))
    found = {name: scored(world, name, START)["success"] for name in ("paper", "paper-3m")}
    assert found == {"paper": 0.0, "paper-3m": 1.0}


def test_challenge_2022_requires_visibility_too() -> None:
    assert scored(corridor(centre=(10.0, 0.0, 0.0)), "challenge-2022", START)["success"] == 0.0


@pytest.mark.parametrize("as_text", [False, True], ids=["number", "text"])
@pytest.mark.parametrize(
    "protocol", [name for name, it in PROTOCOLS.items() if it.grounding != "not scored"]
)
def test_an_id_as_text_is_correct_except_in_challenge_2022(protocol: str, *, as_text: bool) -> None:
    scores = scored(corridor(), protocol, START, STOP, GOAL, as_text=as_text)
    assert scores["rgs"] == float(not (as_text and protocol == "challenge-2022"))


@pytest.mark.parametrize(
    ("protocol", "rgs"),
    [
        ("official-v1", 1.0),
        ("paper", 0.0),
        ("challenge-2022", 1.0),
        ("airbert", 1.0),
        ("duet", 1.0),
        ("scalevln", 0.0),
    ],
)
def test_the_correct_object_at_the_wrong_stop(protocol: str, rgs: float) -> None:
    """The agent never leaves the start, so its path is no longer than the shortest one."""
    scores = scored(corridor(), protocol, START)
    assert (scores["success"], scores["rgs"], scores["rgspl"]) == (0.0, rgs, rgs)


@pytest.mark.parametrize(
    ("protocol", "spl", "rgspl"),
    [
        ("official-v1", 1.0, 1.0),
        ("paper", 1.0, 1.0),
        ("challenge-2022", 0.5, 1.0),
        ("airbert", 0.5, 1.0),
        ("duet", 0.5, 0.5),
        ("scalevln", 0.5, 0.5),
    ],
)
def test_a_route_of_half_a_centimetre(protocol: str, spl: float, rgspl: float) -> None:
    """The protocols with a smallest denominator of 1 cm, in SPL or RGSPL."""
    world = replace(corridor(stop=0.005), items=[Item("1_7", "house", [STOP, GOAL], TARGET)])
    scores = scored(world, protocol, STOP, GOAL)
    assert (scores["spl"], scores["rgspl"]) == (spl, rgspl)


@pytest.mark.parametrize(
    ("protocol", "weight"),
    [
        ("official-v1", 0.5),
        ("paper", 0.5),
        ("challenge-2022", 0.5),
        ("airbert", 0.5),
        ("duet", 0.75),
        ("scalevln", 0.75),
    ],
)
def test_an_annotated_detour(protocol: str, weight: float) -> None:
    """The shortest route is 10 m long, the annotated path 15 m, the trajectory 20 m."""
    world = replace(
        corridor(stop=2.5),
        items=[Item("1_7", "house", [START, STOP, GOAL, STOP, GOAL], TARGET)],
    )
    way = [START, STOP, GOAL, STOP, GOAL, STOP, GOAL]
    scores = scored(world, protocol, *way)
    assert (scores["path_length"], scores["shortest_length"]) == (20.0, 10.0)
    assert (scores["spl"], scores["rgspl"]) == (weight, weight)


def test_sdtw_uses_the_protocols_success() -> None:
    world = corridor(stop=4.0)
    likeness = scored(world, "official-v1", START, STOP)["ndtw"]
    found = {
        name: scored(world, name, START, STOP)["sdtw"] for name in ("official-v1", "r2r-style")
    }
    assert found == {"official-v1": likeness, "r2r-style": 0.0}


# What a bundle can serve.


@pytest.fixture(scope="module")
def unmeasured(demo: GroundTruth) -> GroundTruth:
    """Return the demo world compiled without object positions."""
    assert demo.solution is not None
    solution = replace(demo.solution, candidate_distance=None, target_position=None)
    return replace(demo, solution=solution, origin="val_unseen.npz")


@pytest.mark.parametrize("protocol", ["challenge-2022", "paper-3m"])
def test_a_protocol_without_its_object_positions(protocol: str, unmeasured: GroundTruth) -> None:
    with pytest.raises(rv.GroundTruthError) as error:
        evaluate(GOOD, split=SPLIT, ground_truth=unmeasured, protocol=protocol)
    assert str(error.value) == (
        f"{protocol} needs object positions, which val_unseen.npz was compiled without; "
        "compile it again with --object-positions"
    )


def test_all_protocols_side_by_side() -> None:
    scored = evaluate_protocols(GOOD, split=SPLIT)
    assert list(scored) == list(RELEASED)
    for name, scores in scored.items():
        assert scores == evaluate(GOOD, split=SPLIT, protocol=name)
        assert scores.signature == evaluate(GOOD, split=SPLIT, protocol=name).signature


def test_protocols_that_cannot_be_scored_are_left_out(unmeasured: GroundTruth) -> None:
    scored = evaluate_protocols(GOOD, split=SPLIT, ground_truth=unmeasured)
    assert list(scored) == [name for name in RELEASED if name not in {"challenge-2022", "paper-3m"}]
    for scores in scored.values():
        notes = [note for note in scores.notes if note.startswith("left out: ")]
        needs = "needs object positions, which val_unseen"
        assert [note.partition(needs)[:2] for note in notes] == [
            (f"left out: {name} ", needs) for name in ("paper-3m", "challenge-2022")
        ]


def test_a_public_bundle_cannot_be_scored(demo: GroundTruth) -> None:
    public = replace(demo, solution=None)
    with pytest.raises(rv.GroundTruthError, match="public bundle"):
        evaluate_protocols(GOOD, split=SPLIT, ground_truth=public)


def test_r2r_style_does_not_score_grounding() -> None:
    scores = evaluate(GOOD, split=SPLIT, protocol="r2r-style")
    unscored = {"rgs", "rgspl", *BOX_METRICS}
    assert list(scores) == [key for key in find_task("reverie").metrics if key not in unscored]
    for key in ("rgs", "rgspl"):
        assert key not in scores
        with pytest.raises(KeyError, match=key):
            scores[key]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_spl_never_exceeds_success(protocol: str) -> None:
    scores = evaluate(SAMPLES / "mediocre.json", split=SPLIT, protocol=protocol)
    assert scores["spl"] <= scores["success"] <= scores["oracle_success"]


# The grounding track.


@pytest.mark.parametrize(
    "record",
    [
        pytest.param({"predObjId": TARGET}, id="without a trajectory"),
        pytest.param({"predObjId": TARGET, "trajectory": []}, id="empty trajectory"),
        pytest.param({"predObjId": TARGET, "trajectory": [["nowhere", 0, 0]]}, id="other world"),
        pytest.param({"pred_objid": str(TARGET)}, id="other key, as text"),
    ],
)
def test_the_grounding_track_scores_answers_only(record: Mapping[str, Any]) -> None:
    submission = [{"instr_id": "1_7_0", **record}]
    truth = ground_truth_by_hand(corridor())
    scores = evaluate(submission, split=SPLIT, ground_truth=truth, track="grounding")
    assert dict(scores) == {"rgs": 1.0}


@pytest.mark.parametrize("answer", [TARGET + 1, -1, None], ids=["other object", "-1", "null"])
def test_a_wrong_answer_in_the_grounding_track(answer: int | None) -> None:
    submission = [{"instr_id": "1_7_0", "predObjId": answer}]
    truth = ground_truth_by_hand(corridor())
    scores = evaluate(submission, split=SPLIT, ground_truth=truth, track="grounding")
    assert dict(scores) == {"rgs": 0.0}


def test_the_grounding_track_does_not_depend_on_the_order_of_records(demo: GroundTruth) -> None:
    """Scores records in reverse order."""
    answers = demo.require_solution().target_object.tolist()
    answers[0] += 1
    submission = [
        {"instr_id": instr_id, "predObjId": answer}
        for instr_id, answer in zip(demo.episodes.instr_ids, answers, strict=True)
    ]
    scores = evaluate(submission[::-1], split=SPLIT, ground_truth=demo, track="grounding")
    assert scores.episodes["rgs"].tolist() == [0.0] + [1.0] * (len(answers) - 1)


def test_a_submission_is_expected_to_have_answers_and_no_boxes() -> None:
    """What a leaderboard shows before anything was submitted."""
    rules = REVERIE.protocol("official-v1")
    full = scored_metrics(rules, "full")
    assert set(full) == set(scored_metrics(rules, "full", has_boxes=True)) - set(BOX_METRICS)
    assert {"success", "rgs", "rgspl"} <= set(full)
    assert scored_metrics(rules, "grounding") == ("rgs",)


def test_the_signature_includes_the_grounding_track() -> None:
    scores = evaluate(GOOD, split=SPLIT, track="grounding")
    assert "|protocol:official-v1|track:grounding|data:" in scores.signature
    assert "track:" not in evaluate(GOOD, split=SPLIT).signature


def test_the_grounding_track_has_no_hints_about_trajectories() -> None:
    assert not evaluate(GOOD, split=SPLIT, track="grounding").notes


def test_the_grounding_track_reports_missing_episodes() -> None:
    *submission, last = json.loads(GOOD.read_bytes())
    with pytest.raises(rv.SubmissionError) as rejected:
        evaluate(submission, split=SPLIT, track="grounding")
    (problem,) = rejected.value.problems
    assert problem.code == "missing-episode"
    assert last["instr_id"] in str(problem)


def test_the_grounding_track_needs_answers(demo: GroundTruth) -> None:
    with pytest.raises(rv.GroundTruthError, match="public bundle"):
        evaluate(GOOD, split=SPLIT, ground_truth=replace(demo, solution=None), track="grounding")


def test_the_grounding_track_needs_a_protocol_that_scores_grounding() -> None:
    with pytest.raises(rv.GroundTruthError, match="r2r-style does not score grounding"):
        evaluate(GOOD, split=SPLIT, protocol="r2r-style", track="grounding")
    assert "r2r-style" not in evaluate_protocols(GOOD, split=SPLIT, track="grounding")


def test_an_unknown_track() -> None:
    with pytest.raises(rv.ProtocolError, match="did you mean grounding"):
        evaluate(GOOD, split=SPLIT, track="ground")  # type: ignore[arg-type]
