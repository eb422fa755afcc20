"""The splits of a server: which can be scored, what they are called, and what they compare."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from reverie_eval.errors import GroundTruthError, Problem, SubmissionError
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle, GroundTruth
from reverie_eval.runner import run_agent
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.scoring.boards import Board, find_board, load_board, load_boards, tasks_of
from reverie_eval.server.settings import BoardRules, SettingsError, Split
from reverie_eval.version import __version__
from tests.support.serving import GOOD, GROUNDING, OPEN, OTHER_BOARDS, PRIVATE, STRICT, settings_of
from tests.support.worlds import with_arrays

R2R = "r2r-val_unseen"


def opened(name: str, task: str = "reverie", **others: BoardRules) -> Board:
    """Load an open split of the demo world."""
    folder = DEMO_BUNDLES if task == "reverie" else DEMO_BUNDLES / task
    path = folder / f"{name.removeprefix(f'{task}-')}.npz"
    return load_board(name, Split(visibility="open", bundle=path, task=task, boards=others), path)


@pytest.fixture(scope="module")
def several() -> Board:
    """Load a split with other leaderboards."""
    return opened(OPEN, grounding=OTHER_BOARDS[GROUNDING], strict=OTHER_BOARDS[STRICT])


def as_private(board: Board) -> Board:
    return replace(board, settings=board.settings.model_copy(update={"visibility": "private"}))


@pytest.mark.parametrize(
    ("own", "other", "expected"),
    [
        pytest.param("REVERIE v2", "v2", True, id="the version"),
        pytest.param("REVERIE v2", "reverie-V2", True, id="with the benchmark"),
        pytest.param("v2", "REVERIE - v2", True, id="of the split without it"),
        pytest.param("REVERIE v2", "", True, id="unknown"),
        pytest.param("REVERIE v2", "REVERIE", True, id="the benchmark alone: unknown"),
        pytest.param("REVERIE v2", "v1", False, id="another version"),
        pytest.param("REVERIE v2", "v", False, id="part of it"),
        pytest.param("v2", "R2R v2", False, id="of another benchmark"),
        pytest.param("v2", "my REVERIE v2", False, id="the benchmark is not at the beginning"),
    ],
)
def test_which_version_of_the_dataset_is_the_split_s(
    own: str, other: str, *, expected: bool, several: Board
) -> None:
    header = replace(several.truth.header, dataset=own)
    board = replace(several, truth=replace(several.truth, header=header))
    assert board.is_on(other) is expected


def test_a_board_that_is_not_there(several: Board) -> None:
    boards = {OPEN: several, R2R: opened(R2R, "r2r")}
    assert find_board(boards, OPEN) is several
    assert find_board(boards, OPEN, STRICT) is several.others[STRICT]
    for split, name, told in (
        (
            "r2r-val_unsen",
            "",
            (
                "there is no split 'r2r-val_unsen' here; did you mean r2r-val_unseen? "
                "Choose one of: val_unseen, r2r-val_unseen"
            ),
        ),
        (
            OPEN,
            "none",
            f"{OPEN} has no leaderboard 'none'; its other leaderboards: "
            + ", ".join(several.others),
        ),
        (
            R2R,
            STRICT,
            "r2r-val_unseen has no leaderboard 'strict'; it has only its main one",
        ),
    ):
        with pytest.raises(NotFoundError) as missing:
            find_board(boards, split, name)
        assert str(missing.value) == told


def test_a_board_has_the_fingerprint_of_what_participants_may_have(several: Board) -> None:
    public = Bundle.load(DEMO_BUNDLES / f"{OPEN}.npz").public().header.fingerprint
    assert {board.public_fingerprint for board in several.all} == {public}
    assert {board.truth.origin for board in several.all} == {OPEN}
    assert several.main is None
    assert [board.main and board.main.path for board in several.others.values()] == [OPEN, OPEN]


def test_intervals_are_computed_if_asked_for(several: Board) -> None:
    without = several.scored(GOOD)
    scores = several.scored(GOOD, has_intervals=True).scores
    assert (without.scores is None, without.report.intervals) == (False, None)
    assert scores is not None
    assert scores.intervals is not None
    assert several.scored(GOOD, has_intervals=True).report.intervals is not None


def test_another_leaderboard_has_the_episodes_of_its_protocol() -> None:
    """R2R's own script never scores a path's fourth instruction, and DUET's does."""
    boards = opened("r2r-val_seen", "r2r", duet=BoardRules(protocol="hamt")).all
    assert [len(board.truth.episodes.instr_ids) for board in boards] == [34, 35]


def test_a_file_for_another_split_is_told_its_name_on_the_server() -> None:
    sent = run_agent("shortest", GroundTruth.load(DEMO_BUNDLES / "r2r" / "val_seen.npz"))
    content = json.dumps(sent).encode()
    with pytest.raises(SubmissionError) as refused:
        opened(R2R, "r2r").read(content)
    assert [each.split for each in refused.value.problems] == ["r2r-val_seen"]
    assert opened("r2r-val_seen", "r2r").read(content).validation().notes == []


def test_what_only_the_solution_tells_is_not_said_of_a_private_split(several: Board) -> None:
    records = [{**each, "predObjId": each["predObjId"] + 5000} for each in json.loads(GOOD)]
    content = json.dumps(records).encode()
    private = as_private(several)
    (note,) = several.read(content).validation().notes
    assert note.startswith("no predicted object is visible where its agent stops")
    assert private.read(content).validation().notes == []
    assert several.check(content).validation().notes == []


def test_only_rounded_means_of_a_private_split_may_be_kept(several: Board) -> None:
    private = as_private(several)
    exact, rounded = several.scored(GOOD).report, private.scored(GOOD).report
    assert list(rounded.scores) == [metric.key for metric in several.headline]
    assert (several.may_keep(exact), private.may_keep(exact)) == (True, False)
    assert (several.may_keep(rounded), private.may_keep(rounded)) == (True, True)


def test_tasks_begin_with_reverie(several: Board) -> None:
    boards = {R2R: opened(R2R, "r2r"), OPEN: several, "again": several}
    assert [task.name for task in tasks_of(boards)] == ["reverie", "r2r"]


def test_scores_compare_whatever_version_computed_them(several: Board) -> None:
    fingerprint = several.truth.fingerprint
    signature = f"split:val_unseen|protocol:official-v1|data:{fingerprint[:12]}|n:84|version:"
    assert several.signature == f"{signature}{__version__}"
    assert several.is_current(f"{signature}9", fingerprint)
    assert not several.is_current(f"{signature}9", fingerprint[:-1])
    assert not several.is_current(f"{signature}9".replace("official-v1", "paper"), fingerprint)


def test_a_file_without_what_is_scored_is_reported_without_scores(several: Board) -> None:
    walks = [
        {key: record[key] for key in ("instr_id", "trajectory")} for record in json.loads(GOOD)
    ]
    report = several.others[GROUNDING].scored(json.dumps(walks).encode()).report
    (note,) = report.notes
    assert note.startswith("this file cannot be ranked here: no record has an answer")
    assert report.model_dump(exclude={"notes"}, exclude_defaults=True) == {
        "signature": several.others[GROUNDING].signature,
        "split": OPEN,
        "protocol": "official-v1",
        "dataset": "demo",
        "fingerprint": several.truth.fingerprint,
        "version": __version__,
        "episodes": 84,
        "scores": {},
    }


# What cannot be scored.


def problems(folder: Path) -> list[Problem]:
    """Return why the splits of a folder cannot be scored."""
    with pytest.raises(SettingsError) as refused:
        load_boards(settings_of(folder))
    return list(refused.value.problems)


def test_every_split_that_cannot_be_scored_is_named(folder: Path) -> None:
    places = {name: folder / "bundles" / f"{name}.npz" for name in (PRIVATE, "val_seen", OPEN)}
    places[PRIVATE].chmod(0o640)
    places["val_seen"].unlink()
    places[OPEN].write_bytes((DEMO_BUNDLES / "val_seen.npz").read_bytes())
    told = {
        PRIVATE: f"others can read the solution; run `chmod 600 {places[PRIVATE]}`",
        "val_seen": f"{places['val_seen']}: No such file or directory; put it there, or create it "
        "with `reverie-eval compile`",
        OPEN: f"{places[OPEN]}: this is the ground truth of val_seen, not of val_unseen",
    }
    assert sorted(problems(folder), key=lambda problem: problem.where) == [
        Problem("no-ground-truth", f"splits.{name}.bundle", reason) for name, reason in told.items()
    ]


def test_a_bundle_without_the_solution_is_named_by_its_place() -> None:
    place = DEMO_BUNDLES / f"{PRIVATE}.public.npz"
    with pytest.raises(GroundTruthError) as refused:
        load_board(PRIVATE, Split(bundle=place), place)
    assert str(refused.value).startswith(f"{place} is a public bundle")


def test_a_split_of_another_task_is_named_with_what_to_set() -> None:
    place = DEMO_BUNDLES / "r2r" / "val_unseen.npz"
    with pytest.raises(GroundTruthError) as refused:
        load_board(OPEN, Split(visibility="open", bundle=place), place)
    assert str(refused.value) == (
        "this is the ground truth of R2R, but the split is of REVERIE; set "
        'task = "r2r", or use another bundle'
    )


def test_rules_that_need_positions_are_accepted_with_them() -> None:
    board = opened(OPEN, camera=BoardRules(protocol="challenge-2022"))
    assert board.others["camera"].protocol.goal == "visible and near the object"


def test_rules_that_cannot_score_the_split_are_refused() -> None:
    place = DEMO_BUNDLES / f"{OPEN}.npz"
    split = Split(visibility="open", bundle=place, track="grounding", protocol="r2r-style")
    with pytest.raises(GroundTruthError) as refused:
        load_board(OPEN, split, place)
    told = "r2r-style does not score grounding, the only score of this track"
    assert str(refused.value) == told


@pytest.mark.parametrize(
    ("change", "is_refused"),
    [
        pytest.param(lambda bundle: bundle, True, id="the same solution"),
        pytest.param(
            lambda bundle: with_arrays(bundle, task_target=bundle.arrays["task_target"] + 1),
            False,
            id="the same paths to other targets",
        ),
    ],
)
def test_a_private_split_has_a_solution_of_its_own(
    change: Callable[[Bundle], Bundle], folder: Path, *, is_refused: bool
) -> None:
    place = folder / "bundles" / f"{PRIVATE}.npz"
    bundle = change(Bundle.load(folder / "bundles" / f"{OPEN}.npz"))
    place.unlink()
    replace(bundle, header=replace(bundle.header, split=PRIVATE)).save(place)
    if not is_refused:
        assert list(load_boards(settings_of(folder))) == [PRIVATE, "val_seen", OPEN]
        return
    assert problems(folder) == [
        Problem(
            "public-solution",
            f"splits.{PRIVATE}.bundle",
            f"{place}: has the solution of the open split {OPEN}; compile the private annotations "
            f"(`reverie-eval compile --annotations`), or do not open {OPEN}",
        )
    ]
