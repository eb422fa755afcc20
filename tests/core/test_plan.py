"""Planning a comparison: power by formula, in simulated worlds, and on the command line."""

from dataclasses import fields, replace

import numpy as np
import pytest
import scipy

from fixtures.clustered_worlds import simulated_power, simulated_power_of_runs
from reverie_eval.errors import ProtocolError
from reverie_eval.metrics.power import Design
from tests.support.flat import Run

SPLIT = "val_unseen"
MANY = Design(n_episodes=10_000, n_clusters=10_000, size_of_own_cluster=1.0, discordance=0.25)
FEW = Design(100, 5, 3.0, 0.3)
RUNS = Design(1_000, 50, 20.0, 0.2, 0.1, n_runs=3, run_deviation=0.03)


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


@pytest.mark.parametrize(
    ("design", "effect"),
    [
        pytest.param(FEW, 0.2, id="few clusters"),
        pytest.param(replace(FEW, correlation=0.5), 0.25, id="few correlated clusters"),
        pytest.param(RUNS, 0.1, id="three runs"),
        pytest.param(replace(RUNS, n_runs=2), 0.1, id="two runs"),
        pytest.param(replace(RUNS, n_runs=5, run_deviation=0.08), 0.1, id="runs that differ more"),
        pytest.param(Design(200, 6, 20.0, 0.4, 0.05, 4, 0.1), 0.3, id="few clusters, four runs"),
    ],
)
def test_power_is_how_often_drawn_estimates_are_significant(design: Design, effect: float) -> None:
    """Estimates of variances are drawn: one of the clusters, and one of each method's runs."""
    draws, random = 100_000, np.random.default_rng(0)
    spread = 1 + design.correlation * (design.size_of_own_cluster - 1)
    variances = [(design.discordance - effect**2) * spread / design.n_episodes]
    freedoms = [design.n_clusters - 1]
    if design.run_deviation:
        variances += [design.run_deviation**2 / design.n_runs] * 2
        freedoms += [design.n_runs - 1] * 2
    drawn = [
        variance * random.chisquare(freedom, draws) / freedom
        for variance, freedom in zip(variances, freedoms, strict=True)
    ]
    total = sum(drawn, np.zeros(draws))
    squares = sum(
        (part**2 / freedom for part, freedom in zip(drawn, freedoms, strict=True)), np.zeros(draws)
    )
    critical = scipy.stats.t.ppf(0.975, total**2 / squares) * np.sqrt(total)
    power = scipy.stats.norm.sf(critical, effect, np.sqrt(sum(variances))).mean()
    assert design.power(effect) == pytest.approx(power, abs=0.006)


@pytest.mark.parametrize(
    ("design", "effect"),
    [
        pytest.param(FEW, 0.25, id="few clusters"),
        pytest.param(replace(FEW, discordance=0.96), 0.95, id="too few episodes for two clusters"),
    ],
)
def test_one_episode_fewer_would_be_too_few(design: Design, effect: float) -> None:
    needed = design.episodes_needed(effect)
    assert needed is not None
    powers = [
        replace(design, n_episodes=number, n_clusters=max(number / 20, 2)).power(effect)
        for number in (needed - 1, needed)
    ]
    assert powers[0] < 0.8 <= powers[1]


@pytest.mark.parametrize(
    ("effect", "needed"), [pytest.param(0.18, 2, id="two"), pytest.param(0.15, 3, id="three")]
)
def test_the_fewest_runs_that_are_enough(effect: float, needed: int) -> None:
    powers = [replace(RUNS, n_runs=number).power(effect) for number in (2, 3)]
    assert [power >= 0.8 for power in powers] == [number >= needed for number in (2, 3)]
    assert RUNS.runs_needed(effect) == needed


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
        (["--effect", "nan"], "'--effect': nan is not a finite number"),
        (["--discordance", "nan"], "'--discordance': nan is not a finite number"),
        (["--correlation", "NaN"], "'--correlation': NaN is not a finite number"),
        (["--run-deviation", "nan"], "'--run-deviation': nan is not a finite number"),
        (["--run-deviation", "inf"], "not in the range"),
    ],
)
def test_what_cannot_be_planned(words: list[str], said: str, run: Run) -> None:
    status, out, err = run("plan", "--split", SPLIT, *words)
    assert (status, out) == (2, "")
    assert said in err


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0])
@pytest.mark.parametrize("field", [each.name for each in fields(Design)])
def test_a_design_out_of_range_is_refused(field: str, value: float) -> None:
    with pytest.raises(ProtocolError, match=f"^no comparison to plan: {field} is {value:g}, "):
        replace(MANY, **{field: value})  # type: ignore[arg-type]


def test_everything_that_is_out_of_range_is_named_at_once() -> None:
    with pytest.raises(ProtocolError) as refused:
        Design(1, 2, 1.0, np.nan, correlation=1.5)
    assert str(refused.value) == (
        "no comparison to plan: n_episodes is 1, expected 2 or more; discordance is nan, expected "
        "more than 0, and at most 1; correlation is 1.5, expected 0 to 1"
    )


@pytest.mark.parametrize("effect", [np.nan, np.inf, 0.26])
def test_an_impossible_effect_is_refused(effect: float) -> None:
    with pytest.raises(ProtocolError, match="is impossible: methods that disagree in"):
        MANY.power(effect)


def test_a_public_bundle_has_no_targets(run: Run) -> None:
    status, _, err = run("plan", "--split", "test")
    assert (status, "is a public bundle" in err) == (2, True)
    assert run("plan", "--split", "test", "--cluster", "scan").status == 0
