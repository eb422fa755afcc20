"""Sweeps: rows from paths, luck by hand, and a thesis's 180 files from training to a table."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.analysis._ranks import covariance_of_rows, largest_error
from reverie_eval.reporting.scores import selection_printout
from reverie_eval.submissions import find_fields
from tests.conftest import SAMPLES
from tests.support.flat_world import Run
from tests.support.trained import write_checkpoints

SEEN, UNSEEN = "val_seen", "val_unseen"
STEPS = range(1000, 31000, 1000)
PATTERN = "{root}/seed{{seed}}/{{step}}_{{split}}.json"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Write 180 files: three seeds, thirty checkpoints, two splits; return their pattern."""
    root = tmp_path_factory.mktemp("runs")
    truths = [rv.Evaluator(split=split).ground_truth for split in (SEEN, UNSEEN)]
    write_checkpoints(root, truths, 3, STEPS)
    return PATTERN.format(root=root)


@pytest.fixture(scope="module")
def seen(trained: str) -> rv.Sweep:
    return rv.sweep(trained, split=SEEN, jobs=1)


# Luck.


@pytest.mark.parametrize(
    ("covariance", "expected"),
    [
        # The larger of two independent normal errors: 1 / sqrt(pi); of three: 3 / (2 sqrt(pi)).
        pytest.param(np.eye(2), 0.5642, id="two"),
        pytest.param(np.eye(3), 0.8463, id="three"),
        # Half of the difference's mean absolute value, sqrt(2 x 0.4 / pi) / 2.
        pytest.param(np.array([[1, 0.8], [0.8, 1]]), 0.2523, id="two that share most"),
        pytest.param(np.ones((2, 2)), 0.0, id="two that share all"),
        pytest.param(np.ones((1, 1)), 0.0, id="one"),
    ],
)
def test_the_largest_error_by_hand(covariance: np.ndarray, expected: float) -> None:
    assert largest_error(covariance) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(
    ("seeds", "training"), [(1, 0.0), (3, 0.0), (3, 0.05)], ids=["files", "seeds", "far seeds"]
)
def test_the_expected_luck_is_that_of_drawn_worlds(seeds: int, training: float) -> None:
    """Twelve equally good rows; episodes are as hard for all, and seeds as good."""
    random, rows, clusters, expected, met = np.random.default_rng(0), 12, 100, [], []
    cluster = np.repeat(np.arange(clusters), 2)
    for _ in range(60):
        shared = random.normal(0, 1, clusters)[cluster] + random.normal(0, 1, (1, seeds, 1))
        own = random.normal(0, 0.3, (rows, 1, clusters))[:, :, cluster]
        own = own + random.normal(0, 0.5, (rows, seeds, 2 * clusters))
        own = own + random.normal(0, training, (rows, seeds, 1))
        expected.append(largest_error(covariance_of_rows(shared + own, cluster)))
        met.append(own.mean(axis=(1, 2)).max())
    assert np.mean(expected) == pytest.approx(np.mean(met), rel=0.1)


# Rows.


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("r/seed{seed}/{ckpt}.json", {"r/seed1/9_a.json": "1 9_a", "r/seed2/9_b.json": "2 9_b"}),
        ("r/seed{seed}/{ckpt}_a.json", {"r/seed1/9_a.json": "1 9"}),
        ("r/seed{n}/9_{n}.json", {}),
        ("r/{x}.json", {"r/[1].json": "[1]"}),
        ("r/{braces}.txt", {"r/{braces}.txt": ""}),
        ("r/none.json", {}),
    ],
)
def test_fields_of_paths(
    pattern: str, found: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("seed1/9_a.json", "seed2/9_b.json", "[1].json", "{braces}.txt"):
        file = Path("r", name)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    assert {file: " ".join(parts.values()) for file, parts in find_fields(pattern).items()} == found


def test_rows_are_means_over_seeds_in_the_order_of_numbers(seen: rv.Sweep) -> None:
    assert list(seen) == [str(step) for step in STEPS]
    runs = seen["9000"]
    assert isinstance(runs, rv.Runs)
    assert list(runs.runs) == ["seed 1", "seed 2", "seed 3"]
    assert seen.mean("9000", "rgspl") == runs["rgspl"]
    assert seen.to_pandas()["rgspl"].idxmax() == seen.best
    assert f"<td>{runs['rgspl'] * 100:.2f}</td>" in seen._repr_html_()


def test_a_row_without_a_seed_is_not_chosen(tmp_path: Path, run: Run) -> None:
    """Fewer seeds vary more, so the luckiest of such rows would win; it is shown."""
    for name, sample in {"a1": "good", "b1": "mediocre", "b2": "mediocre", "a2": "broken"}.items():
        shutil.copy(SAMPLES / f"{sample}.json", tmp_path / f"{name}.json")
    pattern = f"{tmp_path}/{{ours}}{{seed}}.json"
    status, out, err = run(pattern, "--split", UNSEEN)
    assert (status, err.startswith(f"{tmp_path}/a2.json: submission rejected: ")) == (1, True)
    heading, a, b, *_ = out.splitlines()
    assert (heading.split()[:2], a.split()[-1]) == (["ours", "runs"], "57.22")
    assert b.split()[-1] == "34.52*"
    assert "\nb is best of 1 by RGSPL on val_unseen: 34.52, the mean of 2 runs\n" in out
    assert "\nnote: not candidates, because they have fewer runs: a\n" in out
    assert run(pattern, "--split", UNSEEN, "--format", "csv").out.count("\na,1,") == 1


def test_the_best_of_rows_with_more_runs_than_most_is_a_contender(tmp_path: Path) -> None:
    """Its first two runs, as many as most rows have, are by far the worst."""
    runs = {"a": ["mediocre"] * 2 + ["good"] * 4, "b": ["drawn"] * 2, "c": ["drawn"] * 2}
    for name, samples in runs.items():
        for seed, sample in enumerate(samples):
            shutil.copy(SAMPLES / f"{sample}.json", tmp_path / f"{name}{seed}.json")
    sweep = rv.sweep(f"{tmp_path}/{{x}}{{seed}}.json", split=UNSEEN, jobs=1)
    assert (sweep.n_runs, sweep.best, sweep.contenders[0]) == (2, "a", "a")


def test_files_without_seeds_are_rows_of_their_own(trained: str, run: Run) -> None:
    words = (trained.replace("{seed}", "2"), "--select", SEEN, "--report", UNSEEN, "--jobs", "1")
    status, out, err = run(*words, "--confidence", "0.9")
    assert (status, err) == (0, "")
    (answer,) = (line for line in out.splitlines() if ", chosen on " in line)
    files = out.splitlines()[-1]
    scores = rv.evaluate(files.removeprefix("files: "), split=UNSEEN)
    assert f": RGSPL {scores['rgspl'] * 100:.2f} on {UNSEEN}, 90 % interval " in answer


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            "{name}.json --curve c.pdf",
            "one field of numbers besides {seed}, such as {checkpoint}; got ",
        ),
        ("{name}{seed}.json --curve c.pdf", "such as {checkpoint}; got g, m\n"),
        ("{a}o{b}.json --curve c.pdf", "such as {checkpoint}; got g od, medi cre\n"),
        ("{name}.json --curve c.doc", "c.doc: expected a name that ends in .svg, .pdf or .png"),
        ("{n}.json --curve none/c.svg", "none/c.svg: No such file or directory"),
    ],
)
def test_what_cannot_be_drawn_is_not_scored(
    words: str, says: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("good", "mediocre"):
        # Scoring would reject them.
        Path(f"{name}.json").touch()
    status, out, err = run(*words.split(), "--split", UNSEEN)
    assert (status, out) == (2, "")
    assert says in err
    assert "rejected" not in err


def test_a_ranking_of_many_files_points_to_sweeps(trained: str, run: Run) -> None:
    files = trained.format(seed=1, step="*", split=SEEN)
    status, out, err = run(files, "--split", SEEN, "--jobs", "1")
    assert (status, out.splitlines()[1].split()[0]) == (0, "1")
    assert err.startswith("note: the best of 30 is partly luck; ")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["{x}.json", "--split", SEEN], "{x}.json: no submission found; each {name} stands for"),
        (["{x}.json", "b.json", "--split", SEEN], "give the pattern of a sweep alone"),
        (["{x}.json", "--split", SEEN, "--ci"], "--ci cannot be combined with a sweep without"),
        (["{x}.json", "--select", SEEN, "--report", UNSEEN], "--select needs {split}"),
        (["{split}.json", "--select", SEEN, "--report", SEEN], "are both val_seen; report another"),
        (["a.json", "--select", SEEN, "--report", UNSEEN], "--select cannot be combined with a "),
    ],
)
def test_what_cannot_be_swept(words: list[str], said: str, run: Run) -> None:
    status, out, err = run("score", *words)
    assert (status, out) == (2, "")
    assert said in err


# From the files of a thesis to its table.


def test_180_files_to_a_table(trained: str, seen: rv.Sweep, run: Run, tmp_path: Path) -> None:
    """Choose on one split, report on the other, compare with two baselines, and print both."""
    curve = tmp_path / "curve.svg"
    words = (trained, "--select", SEEN, "--report", UNSEEN, "--jobs", "1")
    status, out, err = run(*words, "--curve", str(curve))
    assert (status, err, f"30 checkpoints on {SEEN}" in curve.read_text()) == (0, "", True)
    ((_, ours),) = rv.sweep(seen.best_pattern, split=UNSEEN).items()
    value = f"{ours['rgspl'] * 100:.2f}"
    assert f"\n{seen.best}, chosen on {SEEN}: RGSPL {value} on {UNSEEN}, the mean of 3 runs" in out
    assert f"\ncaution: on {SEEN}, {len(seen.contenders)} of 30 are not significantly diff" in out
    files = out.splitlines()[-1].removeprefix("files: ")

    baselines = {"early": 1000, "middle": 9000}
    steps = {name: trained.replace("{step}", str(step)) for name, step in baselines.items()}
    named = [f"{name}={pattern.replace('{seed}', '1')}" for name, pattern in steps.items()]
    alone = [word.replace("{split}", UNSEEN) for word in named]
    compared = run("compare", f"ours={files}", *alone, "--split", UNSEEN)
    assert (compared.status, compared.err) == (0, "")
    verdicts = {line.split()[0]: line.split()[-1] for line in compared.out.splitlines()[1:4]}
    assert verdicts == {"ours": "baseline", "middle": "worse", "early": "worse"}

    marked = ("--baseline", "early", "--baseline", "middle", "--format", "csv")
    both = f"{SEEN},{UNSEEN}"
    table = run("table", f"ours={seen.best_pattern}", *named, "--split", both, *marked)
    assert (table.status, table.err) == (0, "")
    (row,) = [line.split(",") for line in table.out.splitlines() if line.startswith("ours")]
    assert row[-1].startswith(f"{value}†‡ (")
    assert row[6].startswith(f"{seen.mean(seen.best, 'rgspl') * 100:.2f}†‡ (")

    printout = selection_printout(seen, ours)
    told = json.loads(printout.text("json"))
    assert told["selection"]["best"] == seen.best in seen.contenders
    assert told["selection"]["excess"] == seen.excess > 0
    assert told["report"]["scores"]["rgspl"] == ours["rgspl"]
    assert printout.text("csv").count("\n") == len(seen) == 30
    assert value in printout.text("latex")
