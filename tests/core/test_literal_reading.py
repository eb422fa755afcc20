"""What protocols' own evaluators make of files that are not in the official form."""

from pathlib import Path

import pytest

from reverie_eval import PROTOCOLS, GroundTruth, ProtocolError, diagnose, evaluate
from reverie_eval.scoring import PreparedSubmission
from reverie_eval.submissions import read_predictions
from reverie_eval.tasks import find_task
from tests.support.flat_world import Run, words
from tests.support.forms import FORMS, Form, hops, written
from tests.support.worlds import SPLIT

STRICT = "challenge-2022"
POINTER = (
    "evaluators that read only the first viewpoint of each hop give other scores, which "
    "`reverie-eval --diagnose` shows"
)


def notes_of(form: str, protocol: str, demo: GroundTruth) -> list[str]:
    """Return the notes on a form but those on how it was read."""
    scores = evaluate(FORMS[form].bytes(), split=SPLIT, ground_truth=demo, protocol=protocol)
    return [note for note in scores.notes if not note.startswith(("read as:", "ignored"))]


@pytest.mark.parametrize(
    ("form", "note"),
    [
        pytest.param("A official", None, id="the official form"),
        pytest.param("J LAD", None, id="poses without angles"),
        pytest.param("C HAMT", "the same scores: no object id written as text", id="text ids"),
        pytest.param("E DUET", "an error for this very file: it reads only predObjId", id="key"),
        pytest.param("empty hops", "an error for this very file: it expects a vi", id="empty hops"),
        pytest.param("K NaviLLM", None, id="null beside answers"),
        pytest.param(
            "NaviLLM's ids in memory", "an error for this very file: it knows n", id="prefix"
        ),
        pytest.param(
            "bare viewpoints", "it expects each pose to be a list and it expects", id="bare"
        ),
        pytest.param("keyed, with answers", "it expects a list of records", id="keyed"),
    ],
)
def test_what_the_2022_challenge_s_evaluator_makes_of_a_form(
    form: str, note: str | None, demo: GroundTruth
) -> None:
    notes = notes_of(form, STRICT, demo)
    own = [each for each in notes if each.startswith(f"{STRICT}'s own evaluator ")]
    assert len(own) == (note is not None)
    assert note is None or note in own[0]


@pytest.mark.parametrize(
    ("form", "rgs", "reasons"),
    [
        pytest.param(
            "F KERM, G DSRG",
            "RGS 0.00, RGSPL 0.00",
            "it reads only the first viewpoint of each hop and no object id written as text is "
            "correct",
            id="nested hops and text ids",
        ),
        pytest.param(
            "H DSRG, GOAT",
            "RGS 65.48, RGSPL 59.69",
            "it reads only the first viewpoint of each hop",
            id="nested hops alone",
        ),
    ],
)
def test_the_scores_that_the_challenge_s_evaluator_prints_are_stated(
    form: str, rgs: str, reasons: str, demo: GroundTruth
) -> None:
    """They are the scores of the file cut to the first viewpoint of each hop."""
    cut = Form(lambda record: [hop[:1] for hop in hops(record)], written("predObjId", int, None))
    scores = evaluate(cut.bytes(), split=SPLIT, ground_truth=demo, protocol=STRICT)
    navigation = ("path_length", "success", "oracle_success", "spl")
    metres, *percents = (scores[key] for key in navigation)
    rest = [f"{100 * value:.2f}" for value in percents]
    stated = f"TL {metres:.2f}, SR {rest[0]}, OSR {rest[1]}, SPL {rest[2]}, {rgs}"
    (note,) = notes_of(form, STRICT, demo)
    assert note == f"{STRICT}'s own evaluator gives this very file {stated}: {reasons}"


@pytest.mark.parametrize(
    ("protocol", "expected"),
    [
        pytest.param("official-v1", [POINTER], id="the dataset's own"),
        pytest.param("airbert", [POINTER], id="Airbert's"),
        pytest.param("duet", [], id="DUET's reads every viewpoint"),
        pytest.param("paper", [], id="a text is no evaluator"),
    ],
)
def test_nested_hops_point_to_the_diagnosis(
    protocol: str, expected: list[str], demo: GroundTruth
) -> None:
    assert notes_of("E DUET", protocol, demo) == expected
    assert notes_of("J LAD", protocol, demo) == []


def test_nothing_of_other_scores_is_stated_where_answers_are_private(demo: GroundTruth) -> None:
    content = FORMS["F KERM, G DSRG"].bytes()
    prepared = PreparedSubmission.of(read_predictions(content), demo)
    scores = prepared.without_answer_hints().score(PROTOCOLS[STRICT])
    assert not any("own evaluator" in note for note in scores.notes)


def test_a_diagnosis_states_no_third_reading(demo: GroundTruth) -> None:
    """If the evaluator stops at the file, both scores are shown without that note."""
    content = FORMS["E DUET"].bytes()
    for scores in diagnose(content, split=SPLIT, ground_truth=demo, protocol=STRICT):
        assert not any("own evaluator" in note for note in scores.notes)


REVERIE = find_task("reverie")
NAMES = [*PROTOCOLS, *REVERIE.aliases]
READ_FIRST = [name for name in NAMES if REVERIE.hop_reading(name) == "first viewpoint"]
"""Protocols that read the first viewpoint of a hop alone; test_protocols.py pins them."""


@pytest.mark.parametrize("name", NAMES)
def test_only_evaluators_that_read_the_first_of_a_hop_are_diagnosed(
    name: str, demo: GroundTruth
) -> None:
    content = FORMS["F KERM, G DSRG"].bytes()
    if name in READ_FIRST:
        whole, cut = diagnose(content, split=SPLIT, ground_truth=demo, protocol=name)
        assert cut["success"] < whole["success"]
        assert POINTER not in whole.notes
        assert "|reading:first-of-hop|" in cut.signature
        assert "|reading:" not in whole.signature
    else:
        with pytest.raises(ProtocolError, match=f"those of {', '.join(READ_FIRST)}$"):
            diagnose(content, split=SPLIT, ground_truth=demo, protocol=name)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("duet", "its evaluators read every viewpoint of a nested hop, as reverie-eval does"),
        ("scalevln", "its evaluators read every viewpoint of a nested hop"),
        ("r2r-style", "its evaluator rejects trajectories with skipped viewpoints"),
        ("paper", "it is the text of a paper, and has no evaluator"),
    ],
)
@pytest.mark.usefixtures("here")
def test_the_command_says_why_there_is_no_diagnosis(name: str, reason: str, run: Run) -> None:
    status, out, err = run(*words(f"hops.json {{split}} {{full}} --diagnose --protocol {name}"))
    assert (status, out) == (2, "")
    assert f"{name} has nothing to diagnose: {reason}" in err


def test_all_protocols_have_their_notes(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "kerm.json"
    file.write_bytes(FORMS["F KERM, G DSRG"].bytes())
    _, out, _ = run(str(file), "--split", SPLIT, "--protocol", "all")
    assert out.count("note: read as:") == out.count(POINTER) == 1
    assert out.count(f"note: {STRICT}'s own evaluator gives this very file TL ") == 1
