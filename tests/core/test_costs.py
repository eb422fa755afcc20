"""What runs cost: their logs beside the scores, success within a budget, and the Pareto front."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from reverie_eval import Comparison, GroundTruth, ProtocolError, Scores, evaluate
from reverie_eval.analysis import is_on_front
from reverie_eval.errors import LogError
from reverie_eval.logs import COSTS, RunLog
from reverie_eval.reporting.comparisons import comparison_table
from reverie_eval.reporting.scores import write_episodes
from reverie_eval.scoring import clusters_of
from tests.conftest import SAMPLES
from tests.support.flat_world import Run
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.worlds import ground_truth_of

WORLD = World(
    {
        "house": Scan(
            {
                "hall": Viewpoint((0.0, 0.0, 1.5), views={8: [12]}),
                "north": Viewpoint((0.0, 2.0, 1.5), views={5: [0]}),
                "far": Viewpoint((0.0, 9.0, 1.5), views={6: [1]}),
            },
            frozenset({("hall", "north"), ("north", "far")}),
        )
    },
    [
        Item("1_1", "house", ["hall", "north"], 5, instructions=2),
        Item("2_2", "house", ["north", "hall"], 8),
        Item("3_3", "house", ["hall", "north", "far"], 6),
    ],
)
WALKS = {
    "1_1_0": ["hall", "north"],
    "1_1_1": ["hall"],  # fails
    "2_2_0": ["north", "hall"],
    "3_3_0": ["hall", "north", "far"],
}
LOG = [
    {"episode": "1_1_0", "steps": 3, "seconds": 1.5, "input_tokens": 30, "money": 0.25},
    {"episode": "1_1_1", "steps": 9, "seconds": 0.5, "input_tokens": 10, "money": 0.0},
    {"episode": "2_2_0", "steps": 2, "seconds": 1.0, "input_tokens": 5, "state": "failed"},
    {"episode": "2_2_0", "steps": 1, "seconds": 1.0, "input_tokens": 5, "money": 1.0, "attempt": 2},
    {"episode": "3_3_0", "steps": 6, "seconds": 0.0},
]
"""The first attempt at 2_2_0 has tokens without a price, and nothing is known of 3_3_0's."""


def write_log(
    folder: Path, rows: Sequence[Mapping[str, Any]], name: str = "episodes.jsonl"
) -> Path:
    folder.mkdir(exist_ok=True)
    usual = {"attempt": 1, "state": "ended", "seconds": 0.0}
    (folder / name).write_text("".join(f"{json.dumps({**usual, **row})}\n" for row in rows))
    return folder


@pytest.fixture
def small() -> Scores:
    records = [
        {"instr_id": instr_id, "trajectory": [[each, 0, 0] for each in walk]}
        for instr_id, walk in WALKS.items()
    ]
    return evaluate(records, split="val_unseen", ground_truth=ground_truth_of(WORLD))


@pytest.fixture
def logged(small: Scores, tmp_path: Path) -> Scores:
    return small.with_run(write_log(tmp_path / "run", LOG))


def known(values: Any) -> list[float | None]:
    return [None if np.isnan(value) else value for value in values]


# Beside the scores.


def test_a_cost_is_that_of_all_attempts_and_unknown_is_not_0(logged: Scores) -> None:
    assert {key: known(values) for key, values in logged.costs.items()} == {
        "actions": [3, 9, 3, 6],
        "seconds": [1.5, 0.5, 2.0, 0.0],
        "input_tokens": [30, 10, 10, None],
        "cached_tokens": [None] * 4,
        "output_tokens": [None] * 4,
        "reasoning_tokens": [None] * 4,
        "money": [0.25, 0.0, None, None],
    }
    assert logged.to_report().costs == {
        **dict.fromkeys(COSTS),
        "actions": 5.25,
        "seconds": 1.0,
    }
    assert logged.notes[-1] == (
        "cost per episode: 5.25 actions, 1 s; unknown: input tokens of 1 episode, cached "
        "tokens, output tokens, reasoning tokens, money of 2 episodes"
    )


def test_costs_are_columns_and_no_scores(small: Scores, logged: Scores) -> None:
    assert logged.signature == small.signature
    assert dict(logged) == dict(small)
    frame = logged.to_pandas()
    assert frame["actions"].tolist() == [3, 9, 3, 6]
    assert frame["input_tokens"].isna().tolist() == [False, False, False, True]
    assert frame.attrs["units"]["money"] == "US dollars"
    written = io.StringIO()
    write_episodes(logged, written)
    rows = list(csv.DictReader(written.getvalue().splitlines()))
    assert [row["money"] for row in rows] == ["0.25", "0.0", "", ""]
    assert "costs" not in small.to_report().model_dump()
    assert logged.subset(["2_2_0", "3_3_0"]).costs["actions"].tolist() == [3, 6]


def test_episodes_of_the_log_or_the_split_alone_are_said(small: Scores, tmp_path: Path) -> None:
    rows = [LOG[0], {"episode": "9_9_0", "steps": 1, "read": ["names"]}]
    scores = small.with_run(write_log(tmp_path / "run", rows))
    assert known(scores.costs["actions"]) == [3, None, None, None]
    assert list(scores.notes[-3:]) == [
        "the agent read names; names and boxes are annotators' labels: perfect perception",
        "the run's log has no attempt at 3 episodes, such as 1_1_1, 2_2_0, 3_3_0",
        "the run's log has 1 episode of another split, such as 9_9_0",
    ]


@pytest.mark.parametrize(
    ("trajectory", "is_elsewhere"),
    [
        pytest.param([["hall", 0.0, 0.0], ["north", 0.0, 0.0]], False, id="poses"),
        pytest.param([["hall"], ["far", "north"]], False, id="hops"),
        pytest.param(["hall", "north"], False, id="viewpoints"),
        pytest.param([[["hall", 0.0, 0.0]], [["north", 0.0, 0.0]]], False, id="segments"),
        pytest.param([], False, id="nothing is said"),
        pytest.param([["north", 0.0, 0.0], ["hall", 0.0, 0.0]], True, id="another stop"),
    ],
)
def test_a_log_that_ends_elsewhere_is_said(
    trajectory: list[Any], *, is_elsewhere: bool, small: Scores, tmp_path: Path
) -> None:
    failed = {"episode": "1_1_0", "steps": 1, "record": {"trajectory": [["far", 0, 0]]}}
    last = {"episode": "1_1_0", "steps": 1, "attempt": 2, "record": {"trajectory": trajectory}}
    scores = small.with_run(write_log(tmp_path / "run", [last, failed]))
    said = "the run's log has another stop for 1 episode, such as 1_1_0: it may be the log of "
    assert (f"{said}another run" in scores.notes) is is_elsewhere


def test_the_log_of_another_split_is_refused(small: Scores, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="it has no episode of val_unseen"):
        small.with_run(write_log(tmp_path / "run", [{"episode": "9_9_0", "steps": 1}]))


def test_all_bad_lines_are_listed_with_their_fields(tmp_path: Path) -> None:
    lines = [
        b'{"episode":"1_1_0","attempt":1,"state":"ended","steps":1,"seconds":0}',
        b'{"episode":"1_1_0","attempt":1,"state":"ended","steps":1,"seconds":0}',
        b'{"episode":"1_1_1","attempt":1,"state":"ended","steps":"1","seconds":0}',
        b'{"episode":"1_1_1","attempt":1,"state":"done","steps":1,"seconds":0}',
        b'{"episode":"1_1_1","attempt":1,"state":"ended","steps":1,"seconds":0,"money":-1}',
        b'{"episode":"1_1_1","attempt":1,"steps":1,"seconds":0}',
        b"[]",
        b'{"episode":"1_1_1"',
        b'{"episode":"1_1_1"',  # the last line may have been cut off
    ]
    states = "ended, cut_off, failed, interrupted"
    file = tmp_path / "episodes.jsonl"
    file.write_bytes(b"\n".join(lines))
    with pytest.raises(LogError) as caught:
        RunLog.read(tmp_path)
    assert str(caught.value).splitlines() == [
        "log rejected, 7 problems",
        f"{file}: 2 lines of attempt 1 at 1_1_0; expected one",
        f"{file}, line 3, steps: Expected int, got str",
        f"{file}, line 4, state: Invalid enum value 'done'; expected {states}",
        f"{file}, line 5, money: Expected float >= 0.0",
        f"{file}, line 6: Object missing required field state",
        f"{file}, line 7: Expected object, got array",
        f"{file}, line 8: Input data was truncated",
    ]


def test_a_replay_is_of_the_last_attempt(tmp_path: Path) -> None:
    where = {"viewpoint_id": "hall", "heading": 0, "elevation": 0, "arguments": {}}
    steps = [(1, 1, "Go"), (1, 2, "Go"), (2, 1, "Stop")]
    rows = [
        {"episode": "1_1_0", "attempt": attempt, "step": step, "action": action, **where}
        for attempt, step, action in steps
    ]
    log = RunLog.read(write_log(write_log(tmp_path, LOG), rows, "steps.jsonl"))
    assert [step.action for step in log.steps("1_1_0")] == ["Stop"]
    assert log.steps("2_2_0") == ()


# Success against cost.


@pytest.mark.parametrize(
    ("cost", "metric", "budget", "share"),
    [
        pytest.param("actions", None, [3, 6, 9], [0.5, 0.75, 0.75], id="solved at the budget"),
        pytest.param("seconds", None, [0, 1.5, 2], [0.25, 0.5, 0.75], id="free ones first"),
        pytest.param("actions", "oracle_success", [3, 6, 9], [0.5, 0.75, 0.75], id="metric"),
        pytest.param(None, None, [3, 6, 9], [0.5, 0.75, 0.75], id="the cost that is known"),
    ],
)
def test_the_budget_curve(
    cost: str | None, metric: str | None, budget: list[float], share: list[float], logged: Scores
) -> None:
    curve = logged.success_within(cost, metric)
    assert curve.budget.tolist() == budget
    assert curve.share.tolist() == share
    assert curve.to_pandas()["share"].tolist() == share
    assert ((curve.low <= curve.share) & (curve.share <= curve.high)).all()


@pytest.mark.parametrize(
    ("cost", "metric", "message"),
    [
        pytest.param("money", None, "money: unknown for 2 episodes", id="unknown"),
        pytest.param("mony", None, "no cost 'mony'; did you mean money", id="misspelt"),
        pytest.param(None, "spl", "'spl' is not yes or no for each episode", id="not yes or no"),
    ],
)
def test_a_curve_that_would_be_wrong(
    cost: str | None, metric: str | None, message: str, logged: Scores
) -> None:
    with pytest.raises(ProtocolError, match=message):
        logged.success_within(cost, metric)


def test_a_curve_needs_a_log(small: Scores) -> None:
    with pytest.raises(ProtocolError, match="no log of a run"):
        small.success_within()


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        pytest.param([1, 2], [2, 1], [True, True], id="each is better in one"),
        pytest.param([1, 2], [1, 2], [True, False], id="better in both"),
        pytest.param([1, 1], [1, 2], [True, False], id="as good in one"),
        pytest.param([1, 1], [2, 2], [True, True], id="equal"),
        pytest.param([1, 1 + 1e-12], [2, 2], [True, True], id="equal up to rounding"),
        pytest.param([3, 1, 2, 2], [1, 3, 2, 3], [True, True, True, False], id="several"),
        pytest.param([5], [5], [True], id="alone"),
    ],
)
def test_the_pareto_front(x: list[float], y: list[float], expected: list[bool]) -> None:
    assert is_on_front(np.array(x, float), np.array(y, float)).tolist() == expected
    shifted = np.array([x, x[::-1]], float), np.array([y, y[::-1]], float)
    assert is_on_front(*shifted).tolist() == [expected, expected[::-1]]


# Intervals, by the definition: clusters are drawn one by one.


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory, demo: GroundTruth) -> Mapping[str, Scores]:
    rng = np.random.default_rng(5)
    found = {}
    for name in ("mediocre", "good", "drawn"):
        rows = [
            {"episode": each, "steps": int(rng.integers(1, 20)), "seconds": float(rng.random())}
            for each in demo.episodes.instr_ids
        ]
        scores = evaluate(SAMPLES / f"{name}.json", split="val_unseen", ground_truth=demo)
        found[name] = scores.with_run(write_log(tmp_path_factory.mktemp("runs") / name, rows))
    return found


def resamples(truth: GroundTruth, number: int, seed: int) -> list[list[int]]:
    """Draw clusters as the engine does, and return the rows of the episodes of each resample."""
    cluster = clusters_of(truth, "target")
    members = [np.flatnonzero(cluster == each).tolist() for each in np.unique(cluster)]
    rng, drawn = np.random.default_rng(seed), []
    for start in range(0, number, 500):
        size = min(500, number - start), len(members)
        drawn += rng.integers(len(members), size=size, dtype=np.int32).tolist()
    return [[row for each in one for row in members[each]] for one in drawn]


def test_how_often_a_run_is_on_the_front(runs: Mapping[str, Scores], demo: GroundTruth) -> None:
    comparison = Comparison.of(runs, resamples=300, seed=3)
    front = comparison.front("actions", "rgs")
    on_front = dict.fromkeys(runs, 0)
    for rows in resamples(demo, 300, 3):
        points = {
            name: (it.costs["actions"][rows].mean(), it.episodes["rgs"][rows].mean())
            for name, it in runs.items()
        }
        for name, (cost, score) in points.items():
            on_front[name] += not any(
                other <= cost and better >= score and (other < cost or better > score)
                for other, better in points.values()
            )
    assert {name: point.share for name, point in front.items()} == {
        name: times / 300 for name, times in on_front.items()
    }
    assert 0 < front["mediocre"].share < 1  # so that the question is not idle
    assert front["good"].score == runs["good"]["rgs"]


def test_the_interval_of_a_cost_and_of_a_budget(
    runs: Mapping[str, Scores], demo: GroundTruth
) -> None:
    n_clusters = len(np.unique(clusters_of(demo, "target")))
    outermost = stats.t.ppf(0.025, n_clusters - 1) * np.sqrt(n_clusters / (n_clusters - 1))
    tails = [stats.norm.cdf(outermost), stats.norm.cdf(-outermost)]
    drawn = resamples(demo, 10_000, 0)

    def ends(values: Any) -> Any:
        return pytest.approx(np.quantile([values[rows].mean() for rows in drawn], tails), rel=1e-9)

    first, other = runs["mediocre"], runs["good"]
    found = Comparison.of(runs).costs["good"]["seconds"]
    difference = other.costs["seconds"] - first.costs["seconds"]
    assert found.mean == pytest.approx(difference.mean())
    assert (found.first, found.value) == (
        first.costs["seconds"].mean(),
        other.costs["seconds"].mean(),
    )
    assert [found.interval.low, found.interval.high] == ends(difference)
    curve = other.success_within("actions")
    (at,) = np.flatnonzero(curve.budget == 12)
    within = (other.episodes["success"] > 0) & (other.costs["actions"] <= 12)
    assert curve.share[at] == within.mean()
    assert [curve.low[at], curve.high[at]] == ends(within)


def test_a_comparison_has_the_costs(runs: Mapping[str, Scores]) -> None:
    comparison = Comparison.of(runs, baseline="good")
    notes = comparison_table(comparison).notes
    (note,) = [each for each in notes if each.startswith("cost per episode, mediocre - good: ")]
    assert note.count(" to ") == 2
    assert notes[-1].startswith("on the Pareto front of SR and actions: ")
    frame = comparison.to_pandas()
    assert frame.loc[("mediocre", "actions"), "value"] == runs["mediocre"].costs["actions"].mean()
    report = json.loads(comparison.to_report().model_dump_json())
    assert report["costs"]["mediocre"].keys() == {"actions", "seconds"}


def test_a_comparison_of_files_has_no_costs(small: Scores) -> None:
    comparison = Comparison.of({"a": small, "b": small})
    assert (comparison.costs, "costs" in comparison.to_report().model_dump()) == ({}, False)


# At the command line.


@pytest.mark.parametrize(
    "where",
    [
        pytest.param(("x/submission.json",), id="beside the submission"),
        pytest.param(("copy.json", "--run", "x"), id="named"),
    ],
)
def test_the_score_table_has_what_the_run_cost(
    where: tuple[str, ...], run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "x", [{"episode": "1_1_0", "steps": 3}])
    for name in ("x/submission.json", "copy.json"):
        Path(name).write_text((SAMPLES / "good.json").read_text())
    status, _, err = run(*where, "--split", "val_unseen")
    assert status == 1
    assert err.endswith("x: it has no episode of val_unseen; give the run of this submission\n")
    episode = json.loads(Path("copy.json").read_text())[0]["instr_id"]
    write_log(tmp_path / "x", [{"episode": episode, "steps": 3}])
    status, out, _ = run(*where, "--split", "val_unseen", "--episodes", "episodes.csv")
    assert status == 0
    assert "note: cost per episode: unknown: actions of 83 episodes, s" in out
    assert "note: the run's log has no attempt at 83 episodes" in out
    rows = list(csv.DictReader(Path("episodes.csv").read_text().splitlines()))
    assert [row["actions"] for row in rows if row["actions"]] == ["3.0"]
