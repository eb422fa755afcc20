"""Declared subsets: the same values as on the whole split, another signature, never mixed."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.errors import Problem
from reverie_eval.ground_truth import draw_subset, find_ground_truth, read_episode_ids
from reverie_eval.ground_truth._truth import subset_digest
from reverie_eval.reporting import results_table
from tests.conftest import SAMPLES
from tests.support.flat_world import Run

if TYPE_CHECKING:
    from reverie_eval.submissions import Submission

SPLIT = "val_unseen"
GOOD, DRAWN = SAMPLES / "good.json", SAMPLES / "drawn.json"


@pytest.fixture
def ids(demo: rv.GroundTruth) -> list[str]:
    """Choose every third episode, in another order."""
    return list(demo.episodes.instr_ids[::-3])


@pytest.fixture
def records() -> list[dict[str, Any]]:
    return list(json.loads(DRAWN.read_bytes()))


def rows_of(ids: list[str], truth: rv.GroundTruth) -> list[int]:
    return sorted(truth.episodes.index[each] for each in ids)


@pytest.mark.parametrize("protocol", list(rv.PROTOCOLS))
def test_values_are_those_of_the_whole_split(
    protocol: str, ids: list[str], demo: rv.GroundTruth, records: list[dict[str, Any]]
) -> None:
    """Bit for bit, whether or not the file has the other episodes."""
    whole = rv.evaluate(DRAWN, split=SPLIT, protocol=protocol)
    rows = rows_of(ids, demo)
    chosen = [record for record in records if record["instr_id"] in ids]
    files: list[Submission] = [DRAWN, chosen]
    for file in files:
        scores = rv.evaluate(file, split=SPLIT, protocol=protocol, subset=ids)
        assert list(scores) == list(whole)
        for key, column in scores.episodes.items():
            assert column.tolist() == whole.episodes[key][rows].tolist()
            assert scores[key] == whole.episodes[key][rows].mean()
        assert scores.box_outcomes == [whole.box_outcomes[row] for row in rows]
        assert scores.instr_ids == tuple(demo.episodes.instr_ids[row] for row in rows)


def test_the_grounding_track(ids: list[str], demo: rv.GroundTruth) -> None:
    whole = rv.evaluate(GOOD, split=SPLIT, track="grounding")
    scores = rv.Evaluator(split=SPLIT, track="grounding", subset=ids)(GOOD)
    rows = rows_of(ids, demo)
    assert scores.episodes["rgs"].tolist() == whole.episodes["rgs"][rows].tolist()
    assert "|track:grounding|subset:" in scores.signature


def test_a_subset_is_validated(ids: list[str]) -> None:
    assert rv.validate(GOOD, split=SPLIT, subset=ids[:5]).abstained.shape == (5,)


def test_the_signature_names_the_subset(ids: list[str], demo: rv.GroundTruth) -> None:
    scores = rv.evaluate(GOOD, split=SPLIT, subset=ids)
    again = rv.evaluate(GOOD, split=SPLIT, subset=reversed(ids))
    other = rv.evaluate(GOOD, split=SPLIT, subset=ids[1:])
    digest = scores.ground_truth.subset_digest
    assert f"|protocol:official-v1|subset:{digest}|data:b29e8e6d06f6|n:28|" in scores.signature
    assert scores.signature == again.signature != other.signature
    assert demo.subset(ids).subset(ids[:5]).subset_digest == demo.subset(ids[:5]).subset_digest
    assert repr(demo.subset(ids)).startswith("<GroundTruth of val_unseen, 28 episodes, subset ")


def test_episodes_keep_their_instructions_and_groups(ids: list[str]) -> None:
    whole = rv.evaluate(GOOD, split=SPLIT)
    scores = rv.evaluate(GOOD, split=SPLIT, subset=ids)
    assert scores.episode(ids[3]).instruction == whole.episode(ids[3]).instruction
    assert scores.episode(ids[3]).outcome == whole.episode(ids[3]).outcome
    assert scores.breakdown(by="category")["episodes"].sum() == len(ids)
    assert scores.with_intervals().intervals is not None


def test_every_episode_of_the_subset_needs_a_prediction(
    ids: list[str], records: list[dict[str, Any]]
) -> None:
    chosen = [record for record in records if record["instr_id"] in ids]
    with pytest.raises(rv.SubmissionError) as rejected:
        rv.evaluate(chosen[1:], split=SPLIT, subset=ids)
    (problem,) = rejected.value.problems
    assert problem.code == "missing-episode"
    first = chosen[0]
    assert problem.message == (
        f"episode {first['instr_id']} has no prediction; every episode of the subset "
        f"{subset_digest(ids)} of val_unseen needs one; if the agent gave none, list a stop at the "
        f"start {first['trajectory'][0][0]} without an answer: it counts as a failure"
    )


def test_other_episodes_are_checked_as_well(ids: list[str], records: list[dict[str, Any]]) -> None:
    (other, *_) = [record for record in records if record["instr_id"] not in ids]
    twice = [*records, {**other, "trajectory": other["trajectory"] * 2}]
    with pytest.raises(rv.SubmissionError, match="already has a prediction"):
        rv.evaluate(twice, split=SPLIT, subset=ids)


def test_a_subset_is_never_mixed_with_the_whole_split(ids: list[str]) -> None:
    whole = rv.evaluate(GOOD, split=SPLIT)
    some = rv.evaluate(GOOD, split=SPLIT, subset=ids)
    with pytest.raises(rv.ProtocolError, match=r"not comparable: .*subset:"):
        rv.compare(whole, some, names=["a", "b"])
    with pytest.raises(rv.ProtocolError, match=r"not comparable: .*subset:"):
        results_table({"a": whole, "b": some})
    with pytest.raises(rv.ProtocolError, match=r"not comparable: .*subset:"):
        rv.Runs.of({"a": whole, "b": some})
    assert "(28 episodes of subset " in results_table({"a": some}).caption


def test_a_list_with_problems_is_refused_with_all_of_them(ids: list[str]) -> None:
    with pytest.raises(rv.SubsetError) as refused:
        rv.Evaluator(split=SPLIT, subset=[*ids, "nowhere_1_0", ids[2], ids[2]])
    assert [(each.code, each.where, each.position) for each in refused.value.problems] == [
        ("unknown-episode", "entry 29", (29,)),
        ("duplicate-episode", "entry 30", (30,)),
        ("duplicate-episode", "entry 31", (31,)),
    ]
    assert "listed already, in entry 3;" in refused.value.problems[1].message
    with pytest.raises(rv.SubsetError, match="no episode is listed") as refused:
        rv.Evaluator(split=SPLIT, subset=[])
    assert [(each.code, each.where) for each in refused.value.problems] == [("no-episode", "list")]


def test_a_list_that_is_not_text_is_refused(tmp_path: Path) -> None:
    ids = tmp_path / "ids.txt"
    ids.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(rv.SubsetError) as refused:
        read_episode_ids(ids)
    message = "is not a text file; expected an instr_id on each line"
    assert list(refused.value.problems) == [Problem("not-text", "file", message)]


IDS = ["1196_0_0", "1196_8_1"]
LISTS: Mapping[str, bytes] = {
    "lines": b"1196_0_0\n1196_8_1\n",
    "lines of Windows": b"1196_0_0\r\n\r\n1196_8_1",
    "lines with a byte order mark": b"\xef\xbb\xbf1196_0_0\n1196_8_1",
    "lines in UTF-16": "1196_0_0\n1196_8_1".encode("utf-16"),
    "lines in UTF-16, big end first": "1196_0_0\n1196_8_1".encode("utf-16-be"),
    "JSON": b'["1196_0_0", "1196_8_1"]',
    "JSON with a byte order mark": b'\xef\xbb\xbf ["1196_0_0", "1196_8_1"]',
    "JSON in UTF-16": '["1196_0_0", "1196_8_1"]'.encode("utf-16"),
    "JSON Lines": b'"1196_0_0"\n"1196_8_1"\n',
    "objects": b'[{"instr_id": "1196_0_0"}, {"instr_id": "1196_8_1", "scan": "s"}]',
    "objects, JSON Lines": b'{"id": "1196_0_0"}\n{"id": "1196_8_1"}',
    "under a key": b'{"val_unseen": ["1196_0_0", "1196_8_1 "]}',
}


@pytest.mark.parametrize("content", LISTS.values(), ids=list(LISTS))
def test_forms_of_a_list(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "ids"
    path.write_bytes(content)
    assert list(read_episode_ids(path)) == IDS


@pytest.mark.parametrize(
    ("content", "where"),
    [
        (b'["1196_0_0", ["1196_8_1"]]', "entry 2"),
        (b"[1.5]", "entry 1"),
        (b"[true]", "entry 1"),
        (b'[{"scan": "s"}]', "entry 1"),
        (b'{"a": [], "b": []}', "file"),
        (b'["1196_0_0",', "file"),
        (b"['1196_0_0']", "file"),
        (b"[" * 100_000, "file"),
    ],
)
def test_json_that_is_no_list_of_ids_has_one_short_line(
    content: bytes, where: str, tmp_path: Path
) -> None:
    path = tmp_path / "ids.json"
    path.write_bytes(content)
    with pytest.raises(rv.SubsetError) as refused:
        read_episode_ids(path)
    message = 'is not a JSON list of ids; write ["...", "..."], or an id on each line'
    assert list(refused.value.problems) == [Problem("not-a-list", where, message)]


@pytest.mark.parametrize(
    ("task", "content", "number"),
    [
        pytest.param("ndh", b"[1196, 1200]", 2, id="numbers of NDH"),
        pytest.param("ndh", b'[{"inst_idx": 1196}]', 1, id="objects of NDH"),
        pytest.param("soon", b"[1196, 1200]", 6, id="items of SOON, with all their starts"),
        pytest.param("soon", b'["1196#1"]', 1, id="a start of SOON"),
        pytest.param("rxr", b"[3588]", 1, id="instructions of RxR"),
        pytest.param("rxr", b'["1196_3588"]', 1, id="an id of RxR"),
    ],
)
def test_ids_of_other_tasks(task: str, content: bytes, number: int, tmp_path: Path) -> None:
    path = tmp_path / "ids.json"
    path.write_bytes(content)
    truth = find_ground_truth(None, SPLIT, task).subset(read_episode_ids(path))
    assert len(truth.episodes.instr_ids) == number


def test_a_list_for_something_else_has_one_problem(run: Run, tmp_path: Path) -> None:
    listed = tmp_path / "ids.json"
    listed.write_text(json.dumps([f"none_{row}" for row in range(2_000)]))
    err = run(str(GOOD), "--split", SPLIT, "--episodes-from", str(listed)).err
    assert err == (
        f"{listed}: subset rejected, 1 problem\nlist: none of its 2,000 entries is an episode of "
        f"{SPLIT}, the first is 'none_0'; choose their split\n"
    )


def test_the_digest_of_a_subset() -> None:
    r"""By ``printf 'e1\ne2' | sha256sum``."""
    assert subset_digest(["e2", "e1"]) == "c5a9367884b7"


def test_many_files_in_several_processes(ids: list[str]) -> None:
    alone = rv.evaluate(GOOD, split=SPLIT, subset=ids)
    scored = rv.evaluate_many([GOOD, DRAWN], split=SPLIT, subset=ids, jobs=2)
    found = scored[str(GOOD)]
    assert (dict(found), found.signature) == (dict(alone), alone.signature)


# Drawing.


def test_draws_are_the_same_for_ever() -> None:
    """By ``printf 0:e1 | sha256sum``: e2 is 6bd7..., e3 is b4d2..., e1 is e312..."""
    strata = dict.fromkeys(["e1", "e2", "e3"], "")
    drawn = [set(draw_subset(strata, number, 0, SPLIT)) for number in (1, 2, 3)]
    assert drawn[0] < drawn[1] < drawn[2] == set(strata)
    assert list(draw_subset(strata, 2, 0, SPLIT)) == ["e2", "e3"]


@pytest.mark.parametrize(
    ("number", "shares"),
    [
        pytest.param(7, [4, 2, 1], id="4.2, 2.1 and 0.7"),
        pytest.param(3, [2, 1, 0], id="1.8, 0.9 and 0.3"),
    ],
)
def test_strata_have_their_share(number: int, shares: list[int]) -> None:
    strata = {f"e{number}": scan for number, scan in enumerate("aaaaaabbbc")}
    drawn = draw_subset(strata, number, 0, SPLIT)
    assert [sum(strata[each] == scan for each in drawn) for scan in "abc"] == shares
    assert list(drawn) == [each for each in strata if each in drawn]


@pytest.mark.parametrize("number", [0, 85, -1])
def test_more_than_there_are_cannot_be_drawn(number: int, run: Run) -> None:
    status, out, err = run("subset", "--split", SPLIT, "--n", str(number))
    assert (status, out) == (2, "")
    assert f"has 84 episodes; choose between 1 and all of them, got {number}" in err


# The command line.


def test_a_subset_is_drawn_and_scored(run: Run, tmp_path: Path) -> None:
    ids = tmp_path / "ids.txt"
    drawn = run("subset", "--split", SPLIT, "--n", "20", "--stratify", "scan", "-o", str(ids))
    assert (drawn.status, drawn.out) == (0, "")
    assert run("subset", "--split", SPLIT, "--n", "20", "--stratify", "scan").out == ids.read_text()
    options = ("--split", SPLIT, "--episodes-from", str(ids))
    subset, n = drawn.err.strip().split("|")
    for words in (
        ["score", str(GOOD)],
        ["compare", str(GOOD), str(DRAWN)],
        ["score", f"a={GOOD},{DRAWN}"],
    ):
        status, out, err = run(*words, *options)
        assert (status, err) == (0, "")
        assert f"|{subset}|" in out
        assert f"|{n}|" in out
    assert "each of the 20 chosen episodes" in run("validate", str(GOOD), *options).out
    assert subset in run("report", str(GOOD), *options).out
    scores = rv.evaluate(GOOD, split=SPLIT, subset=ids.read_text().split())
    assert f"{100 * scores['rgspl']:.2f}" in run(str(GOOD), *options).out
    assert np.isclose(scores["success"] * 20 % 1, 0)


def test_a_list_that_is_wrong_names_its_file(run: Run, tmp_path: Path) -> None:
    ids = tmp_path / "ids.txt"
    ids.write_text("nowhere_1_0\n\nelsewhere_2_0\n")
    status, out, err = run(str(GOOD), "--split", SPLIT, "--episodes-from", str(ids))
    assert (status, out) == (1, "")
    assert err.startswith(f"{ids}: subset rejected, 2 problems\nentry 1: 'nowhere_1_0' is not")
    ids.write_bytes(b"\xff\xfe\x00")
    assert "is not a text file" in run(str(GOOD), "--split", SPLIT, "--episodes-from", str(ids)).err
    gone = run(str(GOOD), "--split", SPLIT, "--episodes-from", str(tmp_path / "gone.txt"))
    assert (gone.status, gone.err.strip()[-26:]) == (2, ": No such file or directory"[-26:])
