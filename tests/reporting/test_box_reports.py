"""What is said of answers by box: below the table, in every format, and before it is sent."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from reverie_eval import evaluate, validate
from reverie_eval.tasks import find_task
from tests.support.flat_world import NOTE as JUMPS
from tests.support.flat_world import TUB, WALKS, Run, signature, words
from tests.support.metrics import BOX_METRICS
from tests.support.worlds import SPLIT

METRICS = find_task("reverie").metrics
USUAL = [1, 2, 30, 40]
"""Where every object of the flat is, in the views that show it: the tub in view 12."""
ANSWERS: Sequence[dict[str, Any]] = (
    {"predBox": USUAL, "predView": 12},
    {"predBox": USUAL, "predView": 12},  # from the hall, which sees nothing
    {"predBox": USUAL, "predView": 13},  # the sink
    {"predObjId": -1},
    {"predBox": [31, 2, 30, 40], "predView": 12},  # beside the tub
)
NOTE = (
    "note: 4 boxes predicted, 1 correct (misses: 1 low IoU, 1 wrong view, 1 target not visible), "
    "mean IoU 25.00 %; a box around the whole image would be correct in 0.00 %; 0.00 % of the "
    "views that show the target are ambiguous"
)
BOX_TABLE = f"""\
 TL m   SR %  OSR %  SPL %  RGS %  RGSPL %  IoU %  IoU>=.25 %  IoU>=.5 %  IoU>=.75 %
22.00  60.00  80.00  35.42  20.00    20.00  20.00       20.00      20.00       20.00

SIGNATURE
ground truth: full.npz (custom)
{NOTE}
{JUMPS}
"""
BOX_REPORT = {
    "answers": 4,
    "correct": 1,
    "mean_iou": 0.25,
    "whole_image": 0.0,
    "ambiguous_views": 0.0,
    "misses": {"low IoU": 1, "wrong view": 1, "target not visible": 1},
}
OUTCOMES = ["correct", "target not visible", "wrong view", "", "low IoU"]
SCORE = words("boxes.json {split} {full}")


def write(name: str, answers: Sequence[dict[str, Any]], trajectories: Sequence[Any] = ()) -> None:
    """Write a submission with these answers at the end of the flat's walks."""
    walks = trajectories or [[[place, 0, 0] for place in walk] for walk, _ in WALKS]
    records = [
        {"instr_id": f"7_1_{row}", "trajectory": walk, **answer}
        for row, (walk, answer) in enumerate(zip(walks, answers, strict=True))
    ]
    Path(name).write_text(json.dumps(records))


@pytest.fixture
def boxes(here: Path) -> Path:
    """Work in the flat's folder, with a submission that answers by box."""
    write("boxes.json", ANSWERS)
    return here


# The score command.


@pytest.mark.usefixtures("boxes")
def test_the_table_and_its_note(run: Run) -> None:
    assert run(*SCORE) == (0, BOX_TABLE.replace("SIGNATURE", signature()), "")


@pytest.mark.usefixtures("boxes")
@pytest.mark.parametrize(
    ("style", "headings"),
    [
        ("markdown", "| RGSPL % | IoU % | IoU>=.25 % | IoU>=.5 % | IoU>=.75 % |"),
        ("latex", r"& RGSPL \% & IoU \% & IoU\textgreater{}=.25 \% & IoU\textgreater{}=.5 \% &"),
    ],
)
def test_the_columns_in_other_formats(style: str, headings: str, run: Run) -> None:
    assert headings in run(*SCORE, "--format", style).out


@pytest.mark.usefixtures("boxes")
def test_the_columns_under_every_protocol(run: Run) -> None:
    """Boxes are judged alike; where grounding is not scored, they are not either."""
    headings, *rows = run(*SCORE, "--protocol", "all").out.partition("\n\n")[0].splitlines()
    values = {name: row[-4:] for name, *row in map(str.split, rows)}
    assert headings.endswith("  IoU %  IoU>=.25 %  IoU>=.5 %  IoU>=.75 %")
    assert [values.pop(name) for name in ("r2r-style", "navrag")] == [["-"] * 4] * 2
    assert values == dict.fromkeys(values, ["20.00"] * 4)


@pytest.mark.usefixtures("boxes")
@pytest.mark.parametrize(("style", "prefix"), [("markdown", ""), ("latex", "% ")])
def test_the_note_in_other_formats(style: str, prefix: str, run: Run) -> None:
    assert prefix + NOTE in run(*SCORE, "--format", style).out.splitlines()


@pytest.mark.usefixtures("boxes")
def test_the_report(run: Run) -> None:
    report = json.loads(run(*SCORE, "--format", "json").out)
    assert report["boxes"] == BOX_REPORT
    assert list(report["scores"]) == list(METRICS)
    assert {key: report["scores"][key] for key in sorted(BOX_METRICS)} == {
        "iou": 0.2,
        "iou_25": 0.2,
        "iou_50": 0.2,
        "iou_75": 0.2,
    }
    assert report["notes"][0] == NOTE.removeprefix("note: ")


def test_the_episode_table(boxes: Path, run: Run) -> None:
    run(*SCORE, "--episodes", "episodes.csv")
    headings, *rows = csv.reader((boxes / "episodes.csv").read_text().splitlines())
    assert headings[: len(METRICS) + 3] == ["instr_id", *METRICS, "outcome", "box_outcome"]
    assert [row[headings.index("box_outcome")] for row in rows] == OUTCOMES
    assert [row[headings.index("iou")] for row in rows] == ["1.0", "0.0", "0.0", "0.0", "0.0"]


@pytest.mark.usefixtures("boxes")
def test_the_data_frame() -> None:
    frame = evaluate("boxes.json", split=SPLIT, ground_truth="full.npz").to_pandas()
    assert frame["box_outcome"].tolist() == OUTCOMES
    assert frame["iou_50"].tolist() == [1, 0, 0, 0, 0]
    assert frame.index.tolist() == [f"7_1_{row}" for row in range(5)]


def test_a_file_without_boxes_says_nothing_of_them(boxes: Path, run: Run) -> None:
    run(*words("submit.json {split} {full} --episodes episodes.csv"))
    scored = [key for key in METRICS if key not in BOX_METRICS]
    scores = evaluate("submit.json", split=SPLIT, ground_truth="full.npz")
    columns = [*scored, "outcome", "scan", "category", "instruction"]
    headings = (boxes / "episodes.csv").read_text().splitlines()[0]
    assert headings.split(",") == ["instr_id", *columns]
    assert list(scores.to_pandas().columns) == columns
    assert list(scores) == scored
    assert scores.to_report().boxes is None
    assert not [note for note in scores.notes if "box" in note]


@pytest.mark.usefixtures("boxes")
def test_all_protocols(run: Run) -> None:
    status, out, err = run(*SCORE, "--protocol", "all", "--format", "json")
    reports = {report["protocol"]: report for report in json.loads(out)}
    assert (status, err) == (0, "")
    unscored = {name for name, report in reports.items() if report["boxes"] is None}
    assert unscored == {"r2r-style", "navrag"}
    assert all(report["boxes"] in (None, BOX_REPORT) for report in reports.values())
    assert {report["scores"].get("rgs") for report in reports.values()} == {0.2, None}
    assert not any("by box" in note for note in reports["r2r-style"]["notes"])
    table = run(*SCORE, "--protocol", "all").out.splitlines()
    assert table.count(NOTE) == 1


@pytest.mark.usefixtures("here")
def test_a_diagnosis(run: Run) -> None:
    """A reader of each hop's first viewpoint stops in the hall, from where no box is right."""
    hops = [[["door"], ["hall", "bath"]], *([["door"]] for _ in range(4))]
    right, nowhere = ANSWERS[0], {"predObjId": -1}
    write("hops.json", [right, *[nowhere] * 4], hops)
    whole, cut = run(*words("hops.json {split} {full} --diagnose")).out.splitlines()[1:3]
    assert whole.split()[-2:] == ["20.00", "20.00"]
    assert cut.split()[-2:] == ["0.00*", "0.00*"]


@pytest.mark.usefixtures("boxes")
def test_the_grounding_track(run: Run) -> None:
    """At the goal the second box is right too."""
    status, out, err = run(*SCORE, "--track", "grounding")
    headings, values, _, signed, *_ = out.splitlines()
    assert (status, err) == (0, "")
    assert (headings.split()[:2], values.split()[0]) == (["RGS", "%"], "40.00")
    assert signed == signature("official-v1|track:grounding")
    assert "note: 4 boxes predicted, 2 correct (misses: 1 low IoU, 1 wrong view, 0 target" in out


@pytest.mark.usefixtures("boxes")
def test_a_box_in_a_notebook() -> None:
    html = evaluate("boxes.json", split=SPLIT, ground_truth="full.npz")._repr_html_()
    assert NOTE.removeprefix("note: ") in html


@pytest.mark.usefixtures("here")
def test_one_answer_by_box() -> None:
    write("boxes.json", [ANSWERS[0], *[{"predObjId": TUB}] * 4])
    note, *_ = evaluate("boxes.json", split=SPLIT, ground_truth="full.npz").notes
    assert note == (
        "1 box predicted, 1 correct (misses: 0 low IoU, 0 wrong view, 0 target not visible), mean "
        "IoU 100.00 %; a box around the whole image would be correct in 0.00 %; 0.00 % of the "
        "views that show the target are ambiguous"
    )


# Before it is sent.


@pytest.mark.usefixtures("boxes")
@pytest.mark.parametrize("bundle", ["public.npz", "full.npz"])
def test_validating_tells_no_outcome(bundle: str, run: Run) -> None:
    status, out, err = run(*words(f"validate boxes.json {{split}} --ground-truth {bundle}"))
    verdict, _, *notes = out.splitlines()
    assert (status, err) == (0, "")
    assert verdict.startswith("boxes.json: valid")
    assert notes == ["note: 1 of 5 answers predict no object", JUMPS]


@pytest.mark.usefixtures("here")
def test_an_answer_by_box_is_no_abstention() -> None:
    write("boxes.json", [ANSWERS[0]] * 5)
    checked = validate("boxes.json", split=SPLIT, ground_truth="full.npz")
    assert checked.abstained.tolist() == [False] * 5
    assert not [note for note in checked.notes if "no object" in note or "no answer" in note]
    assert not [
        note
        for note in evaluate("boxes.json", split=SPLIT, ground_truth="full.npz").notes
        if "no answer names" in note
    ]


@pytest.mark.usefixtures("here")
def test_boxes_that_are_null_are_abstentions() -> None:
    write("boxes.json", [{"predBox": None, "predObjId": -1}] * 5)
    checked = validate("boxes.json", split=SPLIT, ground_truth="full.npz")
    assert checked.abstained.tolist() == [True] * 5
    assert "no answer predicts an object: RGS will be 0" in checked.notes


# Remarks on boxes that were probably not meant so.

FRACTIONS = (
    "most boxes lie within two pixels of the upper left corner; if they are fractions of the "
    'image, add "predImageSize": [1, 1]; predBox is [x, y, width, height], not two corners'
)
CORNERS = (
    "most boxes reach beyond the image; predBox is [x, y, width, height], not two corners, in an "
    "image of 640 x 480 unless predImageSize says otherwise"
)
FRACTION = [0.25, 0.5, 0.75, 0.5]
TWO_CORNERS = [400, 300, 500, 400]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("drawn", "expected"),
    [
        pytest.param([FRACTION] * 5, [FRACTIONS], id="fractions"),
        pytest.param([FRACTION] * 3 + [USUAL] * 2, [FRACTIONS], id="fractions in over half"),
        pytest.param([FRACTION] * 2 + [USUAL] * 2, [], id="fractions in half"),
        pytest.param([[0.25, 0.5, 0.75, 1.0]] * 5, [FRACTIONS], id="corners in fractions"),
        pytest.param([[0.5, 0.5, 0.5, 1.6]] * 5, [], id="a little farther down"),
        pytest.param([[0.5, 0.5, 1.6, 0.5]] * 5, [], id="a little farther across"),
        pytest.param([TWO_CORNERS] * 5, [CORNERS], id="corners"),
        pytest.param([TWO_CORNERS] * 3 + [USUAL] * 2, [CORNERS], id="corners in over half"),
        pytest.param([TWO_CORNERS] * 2 + [USUAL] * 2, [], id="corners in half"),
        pytest.param([TWO_CORNERS], [CORNERS], id="the only box of the file"),
        pytest.param([USUAL] * 5, [], id="nothing suspicious"),
    ],
)
@pytest.mark.parametrize("bundle", ["public.npz", "full.npz"])
def test_a_remark(drawn: Sequence[list[float]], expected: list[str], bundle: str) -> None:
    answers = [{"predBox": box, "predView": 12} for box in drawn]
    write("boxes.json", [*answers, *[{"predObjId": TUB}] * (5 - len(answers))])
    notes = validate("boxes.json", split=SPLIT, ground_truth=bundle).notes
    assert [note for note in notes if note.startswith("most boxes")] == expected


@pytest.mark.usefixtures("here")
def test_fractions_that_are_said_to_be_some() -> None:
    write("boxes.json", [{"predBox": FRACTION, "predView": 12, "predImageSize": [1, 1]}] * 5)
    notes = validate("boxes.json", split=SPLIT, ground_truth="full.npz").notes
    assert "read as: 5 boxes scaled from another image size to 640 x 480" in notes
    assert not [note for note in notes if note.startswith("most boxes")]
