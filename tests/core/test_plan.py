"""Planning a comparison: power by formula, in simulated worlds, and on the command line."""

import numpy as np
import pytest

from fixtures.clustered_worlds import simulated_power, simulated_power_of_runs
from reverie_eval.metrics.power import Design
from tests.support.flat import Run

SPLIT = "val_unseen"
MANY = Design(n_episodes=10_000, n_clusters=10_000, size_of_own_cluster=1.0, discordance=0.25)


def test_power_of_many_independent_episodes() -> None:
    """By hand: the standard error is sqrt(0.25 - 0.0002) / 100 = 0.004998.

    So 0.014 is 2.801 of them, and the normal distribution is above 1.96 - 2.801 in 79.98 %.
    """
    assert MANY.power(0.014) == pytest.approx(0.7998, abs=5e-4)
    assert MANY.smallest_effect() == pytest.approx(0.0140, abs=5e-5)
    needed = MANY.episodes_needed(0.014)
    assert needed is not None
    assert abs(needed - 10_000) < 60


def test_no_effect_is_found_in_one_direction_as_often_as_the_test_allows() -> None:
    assert MANY.power(0.0) == pytest.approx(0.025, abs=1e-4)


def test_clusters_weigh_as_fewer_episodes() -> None:
    """Six episodes in clusters of 4, 1 and 1 have 18 / 6 = 3 in their own cluster."""
    design = Design.of(np.array([0, 0, 0, 0, 1, 2]), 0.5, 0.5)
    assert (design.n_episodes, design.n_clusters, design.size_of_own_cluster) == (6, 3, 3.0)
    clustered = Design(10_000, 5_000, 3.0, 0.25, correlation=0.5)
    halved = Design(5_000, 5_000, 1.0, 0.25)
    assert clustered.power(0.02) == pytest.approx(halved.power(0.02), abs=1e-9)


def test_what_cannot_be_reached() -> None:
    assert Design(4, 4, 1.0, 0.01).smallest_effect() is None
    assert MANY.episodes_needed(0.00001) is None
    assert Design(10, 10, 1.0, 0.5, run_deviation=0.01).runs_needed(0.02) is None
    assert Design(10, 10, 1.0, 1.0).power(1.0) == 1.0


def test_the_predicted_power_is_that_of_simulated_comparisons() -> None:
    """A short form of ``benchmarks/power.py``."""
    predicted, simulated = simulated_power(300, 100, 0.06, 0.3, 0.1)
    assert 0.4 < predicted < 0.9
    assert simulated == pytest.approx(predicted, abs=0.1)
    predicted, simulated = simulated_power_of_runs(200, 100, 0.05, 5)
    assert 0.4 < predicted < 0.9
    assert simulated == pytest.approx(predicted, abs=0.1)


def test_the_plan_of_a_split(run: Run) -> None:
    words = ("plan", "--split", SPLIT, "--effect", "20", "--discordance", "40")
    status, out, err = run(*words)
    assert (status, err) == (0, "")
    first, *rows = out.splitlines()
    assert first == f"{SPLIT}: 84 episodes, 29 targets; discordance 40 %, correlation 0"
    assert [row.rsplit("  ", 1)[0].strip() for row in rows] == [
        "smallest difference at 80 % power",
        "power for 20 points",
        "episodes for 20 points",
    ]
    more = run(*words, "--run-deviation", "3", "--correlation", "0.2", "--cluster", "scan").out
    assert "2 scans; discordance 40 %, correlation 0.2" in more
    assert (
        "runs of each method for 20 points  no number of runs: there are too few episodes" in more
    )
    assert run(*words, "--run-deviation", "3").out.splitlines()[-1].split()[-1].isdecimal()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--effect", "30", "--discordance", "20"], "larger than the discordance (20 %)"),
        (["--effect", "0"], "not in the range"),
        (["--correlation", "2"], "not in the range"),
    ],
)
def test_what_cannot_be_planned(words: list[str], said: str, run: Run) -> None:
    status, out, err = run("plan", "--split", SPLIT, *words)
    assert (status, out) == (2, "")
    assert said in err


def test_a_public_bundle_has_no_targets(run: Run) -> None:
    status, _, err = run("plan", "--split", "test")
    assert (status, "is a public bundle" in err) == (2, True)
    assert run("plan", "--split", "test", "--cluster", "scan").status == 0
