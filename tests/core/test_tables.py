"""Score tables in every format: for one protocol, several protocols, a diagnosis, both tracks."""

import csv
import io
import json
from pathlib import Path

import pytest

from reverie_eval import __version__, evaluate
from reverie_eval.tasks import find_task
from tests.support.flat_world import NOTE, SCORE, TABLE, Run, fingerprint, signature, words
from tests.support.metrics import BOX_METRICS
from tests.support.worlds import SPLIT

MARKDOWN = f"""\
| TL m | SR % | OSR % | SPL % | RGS % | RGSPL % |
| ---: | ---: | ---: | ---: | ---: | ---: |
| 22.00 | 60.00 | 80.00 | 35.42 | 40.00 | 29.33 |

SIGNATURE

ground truth: full.npz (custom)

{NOTE}
"""
LATEX = rf"""% SIGNATURE
% ground truth: full.npz (custom)
% {NOTE}
\begin{{tabular}}{{rrrrrr}}
\toprule
TL m & SR \% & OSR \% & SPL \% & RGS \% & RGSPL \% \\
\midrule
22.00 & 60.00 & 80.00 & 35.42 & 40.00 & 29.33 \\
\bottomrule
\end{{tabular}}
"""


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        pytest.param([], TABLE, id="table without asking"),
        pytest.param(["--format", "table"], TABLE, id="table"),
        pytest.param(["--format", "markdown"], MARKDOWN, id="markdown"),
        pytest.param(["--format", "latex"], LATEX, id="latex"),
    ],
)
def test_the_formats_for_people(options: list[str], expected: str, run: Run) -> None:
    assert run(*SCORE, *options) == (0, expected.replace("SIGNATURE", signature()), "")


@pytest.mark.usefixtures("here")
def test_json(run: Run) -> None:
    status, out, err = run(*SCORE, "--format", "json")
    assert (status, err) == (0, "")
    assert json.loads(out) == {
        "schema_version": 1,
        "signature": signature(),
        "split": SPLIT,
        "protocol": "official-v1",
        "dataset": "custom",
        "fingerprint": fingerprint(),
        "version": __version__,
        "episodes": 5,
        "scores": dict(evaluate("submit.json", split=SPLIT, ground_truth="full.npz")),
        "boxes": None,
        "intervals": None,
        "notes": [NOTE.removeprefix("note: ")],
    }


@pytest.mark.usefixtures("here")
def test_csv(run: Run) -> None:
    status, out, err = run(*SCORE, "--format", "csv")
    headings, values = csv.reader(io.StringIO(out))
    scores = evaluate("submit.json", split=SPLIT, ground_truth="full.npz")
    assert (status, err) == (0, "")
    assert headings == [*find_task("reverie").metrics, "signature"]
    written = dict(zip(headings, values, strict=True))
    assert {key: float(written[key]) for key in scores} == dict(scores)
    assert {written[key] for key in BOX_METRICS} == {""}
    assert values[-1] == signature()


def test_scores_are_written_to_a_file(here: Path, run: Run) -> None:
    assert run(*SCORE, "--output", "scores.txt") == (0, "", "")
    assert (here / "scores.txt").read_text() == TABLE.replace("SIGNATURE", signature())


def test_episodes_are_written_to_a_file_with_all_digits(here: Path, run: Run) -> None:
    assert run(*SCORE, "--episodes", "episodes.csv") == run(*SCORE)
    headings, *rows = csv.reader((here / "episodes.csv").read_text().splitlines())
    scores = evaluate("submit.json", split=SPLIT, ground_truth="full.npz")
    columns = dict(zip(headings, zip(*rows, strict=True), strict=True))
    assert headings == ["instr_id", *scores.episodes, *scores.texts]
    assert columns["instr_id"] == tuple(scores.instr_ids)
    for key, values in scores.episodes.items():
        assert [float(value) for value in columns[key]] == values.tolist()
    for name, texts in scores.texts.items():
        assert columns[name] == tuple(texts)


# Several rows: all protocols, or both readings of hops.

ALL = ("official-v1", "paper", "airbert", "duet", "scalevln", "r2r-style", "navrag")
"""Without those of distances to objects, because this bundle has no object positions."""
REASONS = [
    f"left out: {name} needs object positions, which full.npz was compiled without; "
    "compile it again with --object-positions"
    for name in ("paper-3m", "challenge-2022")
]
LEFT_OUT = "\n".join(f"note: {reason}" for reason in REASONS)
ALL_TABLE = f"""\
protocol      TL m   SR %  OSR %  SPL %  RGS %   RGSPL %
official-v1  22.00  60.00  80.00  35.42  60.00    49.33
paper        22.00  60.00  80.00  35.42  40.00*   29.33*
airbert      22.00  60.00  80.00  35.42  60.00    49.33
duet         22.00  60.00  80.00  35.42  60.00    49.33
scalevln     22.00  60.00  80.00  35.42  40.00*   29.33*
r2r-style    22.00  60.00  80.00  35.42      -        -
navrag       22.00  60.00  80.00  35.42      -        -

* differs from official-v1

SIGNATURES
ground truth: full.npz (custom)
{LEFT_OUT}
{NOTE}
"""
ALL_MARKDOWN = r"""| protocol | TL m | SR % | OSR % | SPL % | RGS % | RGSPL % |
| :--- | ---: | ---: | ---: | ---: | ---: | ---: |
| official-v1 | 22.00 | 60.00 | 80.00 | 35.42 | 60.00 | 49.33 |
| paper | 22.00 | 60.00 | 80.00 | 35.42 | 40.00\* | 29.33\* |
| airbert | 22.00 | 60.00 | 80.00 | 35.42 | 60.00 | 49.33 |
| duet | 22.00 | 60.00 | 80.00 | 35.42 | 60.00 | 49.33 |
| scalevln | 22.00 | 60.00 | 80.00 | 35.42 | 40.00\* | 29.33\* |
| r2r-style | 22.00 | 60.00 | 80.00 | 35.42 | - | - |
| navrag | 22.00 | 60.00 | 80.00 | 35.42 | - | - |

\* differs from official-v1
"""
ALL_LATEX = r"""\begin{tabular}{lrrrrrr}
\toprule
protocol & TL m & SR \% & OSR \% & SPL \% & RGS \% & RGSPL \% \\
\midrule
official-v1 & 22.00 & 60.00 & 80.00 & 35.42 & 60.00 & 49.33 \\
paper & 22.00 & 60.00 & 80.00 & 35.42 & 40.00{*} & 29.33{*} \\
airbert & 22.00 & 60.00 & 80.00 & 35.42 & 60.00 & 49.33 \\
duet & 22.00 & 60.00 & 80.00 & 35.42 & 60.00 & 49.33 \\
scalevln & 22.00 & 60.00 & 80.00 & 35.42 & 40.00{*} & 29.33{*} \\
r2r-style & 22.00 & 60.00 & 80.00 & 35.42 & - & - \\
navrag & 22.00 & 60.00 & 80.00 & 35.42 & - & - \\
\bottomrule
\end{tabular}
"""
DIAGNOSIS = """\
protocol                           TL m    SR %   OSR %   SPL %   RGS %  RGSPL %
official-v1                       22.00   60.00   80.00   35.42   40.00   29.33
official-v1 reading:first-of-hop  13.60*   0.00*  20.00*   0.00*  40.00   31.67*
"""
ALL_PROTOCOLS = words("afar.json {split} {full} --protocol all")


@pytest.mark.usefixtures("here", "printed_protocols")
def test_all_protocols_side_by_side(run: Run) -> None:
    """Under ``paper`` grounding needs success, and one target is predicted at the wrong stop."""
    status, out, err = run(*ALL_PROTOCOLS)
    assert (status, err) == (0, "")
    assert out == ALL_TABLE.replace("SIGNATURES", "\n".join(map(signature, ALL)))


@pytest.mark.usefixtures("here", "printed_protocols")
def test_all_protocols_as_markdown(run: Run) -> None:
    status, out, _ = run(*ALL_PROTOCOLS, "--format", "markdown")
    assert (status, out.startswith(ALL_MARKDOWN)) == (0, True)
    captions = out.removeprefix(ALL_MARKDOWN).split("\n\n")
    assert [caption.strip() for caption in captions] == [
        *map(signature, ALL),
        "ground truth: full.npz (custom)",
        *LEFT_OUT.splitlines(),
        NOTE,
    ]


@pytest.mark.usefixtures("here", "printed_protocols")
def test_all_protocols_as_latex(run: Run) -> None:
    status, out, _ = run(*ALL_PROTOCOLS, "--format", "latex")
    comments, begin, _ = out.partition(r"\begin")
    assert (status, out.removeprefix(comments)) == (0, ALL_LATEX)
    assert begin
    assert all(line.startswith("%") for line in comments.splitlines())
    assert [line for line in comments.splitlines() if "split:" in line] == [
        f"% {signature(rules)}" for rules in ALL
    ]


@pytest.mark.usefixtures("here", "printed_protocols")
def test_all_protocols_as_csv(run: Run) -> None:
    status, out, _ = run(*ALL_PROTOCOLS, "--format", "csv")
    headings, *rows = csv.reader(io.StringIO(out))
    assert (status, headings) == (0, [*find_task("reverie").metrics, "signature"])
    assert [row[-1] for row in rows] == [*map(signature, ALL)]
    column = headings.index("rgs")
    assert [row[column] for row in rows] == ["0.6", "0.4", "0.6", "0.6", "0.4", "", ""]


@pytest.mark.usefixtures("here", "printed_protocols")
def test_all_protocols_as_json(run: Run) -> None:
    """A list of the reports that each protocol gives on its own."""
    status, out, _ = run(*ALL_PROTOCOLS, "--format", "json")
    one_by_one = [
        json.loads(run(*ALL_PROTOCOLS[:-1], rules, "--format", "json").out) for rules in ALL
    ]
    for report in one_by_one:
        report["notes"] = [*REASONS, *report["notes"]]
    assert (status, json.loads(out)) == (0, one_by_one)


@pytest.mark.usefixtures("here")
def test_a_diagnosis_shows_both_readings_of_hops(run: Run) -> None:
    status, out, err = run(*words("hops.json {split} {full} --diagnose"))
    assert (status, err) == (0, "")
    assert out.startswith(DIAGNOSIS)
    assert signature() in out
    assert signature("official-v1|reading:first-of-hop") in out
    assert (
        "note: read as: 3 trajectories of nested hops; 4 hops with more than one viewpoint" in out
    )


@pytest.mark.usefixtures("here")
def test_the_episodes_file_has_the_first_row_only(run: Run) -> None:
    run(*words("hops.json {split} {full} --episodes alone.csv"))
    run(*words("hops.json {split} {full} --diagnose --episodes first.csv"))
    assert Path("first.csv").read_bytes() == Path("alone.csv").read_bytes()


@pytest.mark.usefixtures("here")
def test_a_diagnosis_of_a_file_without_hops_marks_no_difference(run: Run) -> None:
    _, out, _ = run(*words("submit.json {split} {full} --diagnose"))
    _, whole, cut, *_ = out.splitlines()
    assert whole.split()[1:] == cut.split()[2:] == TABLE.splitlines()[1].split()
    assert "*" not in out


@pytest.mark.usefixtures("here")
def test_a_diagnosis_by_another_protocol(run: Run) -> None:
    _, out, _ = run(*words("hops.json {split} {full} --diagnose --protocol hamt"))
    assert signature("duet|reading:first-of-hop") in out


def test_the_grounding_track_scores_answers_only(here: Path, run: Run) -> None:
    records = json.loads((here / "submit.json").read_text())
    for record in records:
        del record["trajectory"]
    (here / "answers.json").write_text(json.dumps(records))
    outcome = run(*words("answers.json {split} {full} --track grounding"))
    expected = f"RGS %\n40.00\n\n{signature('official-v1|track:grounding')}\n"
    assert outcome == (0, f"{expected}ground truth: full.npz (custom)\n", "")
    assert run(*words("submit.json {split} {full} --track grounding")) == outcome


@pytest.mark.usefixtures("here", "printed_protocols")
def test_the_grounding_track_under_all_protocols(run: Run) -> None:
    """With every agent at its goal, rules about the stop make no difference."""
    status, out, _ = run(*ALL_PROTOCOLS, *words("--track grounding --format csv"))
    headings, *rows = csv.reader(io.StringIO(out))
    scored = [dict(zip(headings, row, strict=True)) for row in rows]
    assert (status, [row["rgs"] for row in scored]) == (0, ["0.6"] * 5)
    assert {row["success"] for row in scored} == {""}
