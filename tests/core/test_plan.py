"""Planning a comparison: power by formula, in simulated worlds, and on the command line."""

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import scipy

import reverie_eval as rv
from fixtures.clustered_worlds import (
    simulated_power,
    simulated_power_against,
    simulated_power_of_runs,
)
from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import power
from reverie_eval.metrics.power import Design, PublishedDesign
from tests.conftest import SAMPLES
from tests.support.flat_world import Run

SPLIT = "val_unseen"
MANY = Design(np.ones(10_000, dtype=int), discordance=0.25)
FEW = Design(np.full(30, 4), 0.4)
RUNS = Design(np.full(500, 2), 0.2, 0.1, n_runs=3, run_deviation=0.03)


@pytest.fixture
def fewer_worlds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate less, where the digits do not matter."""
    for name in ("WORLDS", "_FEWER_WORLDS"):
        monkeypatch.setattr(power, name, 400)


def test_power_of_many_independent_episodes() -> None:
    """By hand: the standard error is sqrt(0.25 - 0.0002) / 100 = 0.004998.

    So 0.014 is 2.801 of them, and the normal distribution is above 1.96 - 2.801 in 79.98 %. Swaps
    allow for the effect too, 0.005 instead of 0.004998, which makes no difference here.
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
        pytest.param(RUNS, 0.1, id="three runs"),
        pytest.param(replace(RUNS, n_runs=2), 0.1, id="two runs"),
        pytest.param(replace(RUNS, n_runs=5, run_deviation=0.08), 0.1, id="runs that differ more"),
    ],
)
def test_power_is_how_often_drawn_estimates_are_significant(design: Design, effect: float) -> None:
    """Estimates of the variances of each method's runs are drawn, and judged as runs are."""
    draws, random = 100_000, np.random.default_rng(0)
    clusters = (design.discordance - effect**2) * (1 + design.correlation) / 1000
    runs = design.run_deviation**2 / design.n_runs
    freedom = design.n_runs - 1
    estimated = runs * random.chisquare(freedom, (2, draws)) / freedom
    total = estimated.sum(axis=0) + clusters
    joint = estimated.sum(axis=0) ** 2 / (estimated**2 / freedom).sum(axis=0)
    critical, of_clusters = scipy.stats.t.ppf(0.975, joint), scipy.stats.t.ppf(0.975, 499)
    critical = of_clusters + (1 - clusters / total) ** 1.35 * (critical - of_clusters)
    standard_error = np.sqrt(clusters + 2 * runs)
    expected = scipy.stats.norm.sf(critical * np.sqrt(total), effect, standard_error).mean()
    assert design.power(effect) == pytest.approx(expected, abs=0.006)


def test_one_episode_fewer_would_be_too_few() -> None:
    needed = MANY.episodes_needed(0.02)
    assert needed is not None
    powers = [MANY.with_episodes(number).power(0.02) for number in (needed - 1, needed)]
    assert powers[0] < 0.8 <= powers[1]


def test_more_or_fewer_episodes_have_clusters_of_the_same_sizes() -> None:
    design = Design(np.array([1, 2, 6]), 0.5)
    assert sorted(design.with_episodes(18).sizes.tolist()) == [1, 1, 2, 2, 6, 6]
    assert design.with_episodes(1000).n_episodes == 1000
    assert design.with_episodes(9).n_clusters == 3


@pytest.mark.usefixtures("fewer_worlds")
def test_what_is_needed_of_few_clusters_has_the_power() -> None:
    smallest, needed = FEW.smallest_effect(), FEW.episodes_needed(0.15)
    assert smallest is not None
    assert needed is not None
    assert FEW.power(smallest) == pytest.approx(0.8, abs=0.06)
    assert FEW.with_episodes(needed).power(0.15) == pytest.approx(0.8, abs=0.06)


@pytest.mark.usefixtures("fewer_worlds")
def test_with_five_clusters_nothing_is_significant() -> None:
    """Two of the 32 swaps are as extreme: p is at least 0.0625."""
    design = Design(np.full(5, 20), 0.5)
    assert (design.power(0.5), design.smallest_effect()) == (0.0, None)


@pytest.mark.parametrize(("deviation", "needed"), [(0.005, 2), (0.03, 3)])
def test_the_fewest_runs_that_are_enough(deviation: float, needed: int) -> None:
    design = replace(RUNS, run_deviation=deviation)
    powers = [replace(design, n_runs=number).power(0.12) for number in (2, 3)]
    assert [power >= 0.8 for power in powers] == [number >= needed for number in (2, 3)]
    assert design.runs_needed(0.12) == needed


def test_clusters_weigh_as_fewer_episodes() -> None:
    """Six episodes in clusters of 4, 1 and 1 have 18 / 6 = 3 in their own cluster."""
    design = Design.of(np.array([0, 0, 0, 0, 1, 2]), 0.5, 0.5)
    assert (design.n_episodes, design.n_clusters, design.size_of_own_cluster) == (6, 3, 3.0)
    clustered = Design(np.full(4_000, 3), 0.25, correlation=0.5)
    halved = Design(np.ones(6_000, dtype=int), 0.25)
    assert clustered.power(0.015) == pytest.approx(halved.power(0.015), abs=1e-3)


@pytest.mark.usefixtures("fewer_worlds")
def test_what_cannot_be_reached() -> None:
    assert Design(np.ones(4, dtype=int), 0.01).smallest_effect() is None
    assert MANY.episodes_needed(0.00001) is None
    assert Design(np.ones(10, dtype=int), 0.5, run_deviation=0.01).runs_needed(0.02) is None
    assert Design(np.ones(500, dtype=int), 1.0).power(1.0) == 1.0


@pytest.mark.usefixtures("fewer_worlds")
@pytest.mark.parametrize(
    ("clusters", "effect", "correlation"), [(30, 0.16, 0.0), (100, 0.08, 0.1)], ids=["30", "100"]
)
def test_the_planned_power_is_that_of_simulated_comparisons(
    clusters: int, effect: float, correlation: float
) -> None:
    """A short form of ``benchmarks/power.py``."""
    planned, simulated = simulated_power(300, clusters, effect, 0.4, correlation, largest=6)
    assert 0.4 < planned < 0.9
    assert simulated == pytest.approx(planned, abs=0.1)


def test_the_planned_power_of_runs_is_that_of_simulated_comparisons() -> None:
    planned, simulated = simulated_power_of_runs(300, 100, 0.05, 5)
    assert 0.4 < planned < 0.9
    assert simulated == pytest.approx(planned, abs=0.08)


def test_the_planned_power_against_a_published_rate_is_that_of_simulated_comparisons() -> None:
    planned, simulated = simulated_power_against(300, 100, 0.4, 0.15, 0.3)
    assert 0.4 < planned < 0.9
    assert simulated == pytest.approx(planned, abs=0.08)


def test_power_against_a_published_rate_by_hand() -> None:
    """10,000 independent episodes each: both rates vary by 0.4899 / 100, together by 0.006928.

    So 0.0194 is 2.80 of them, and found in 80 %. Score intervals and 0.4194 x 0.5806 change little.
    """
    each = np.ones(10_000, dtype=int)
    design = PublishedDesign(each, each, 0.4, 0.0)
    assert design.power(0.0194) == pytest.approx(0.8, abs=0.01)
    assert design.smallest_effect() == pytest.approx(0.0194, abs=1e-4)
    needed = design.episodes_needed(0.0194)
    assert needed is not None
    assert abs(needed - 10_000) < 300
    # None of 10,000 may be 0.0384 %, and 3 of 10,000 may be 0.0102 %: together 0.0432 points apart,
    # which is 0.763 standard errors (0.0173 %) above 0.03 %.
    assert replace(design, published=0.0).power(0.0003) == pytest.approx(0.2227, abs=1e-3)
    # Four of a target that are alike count as one.
    alike = PublishedDesign(np.full(10_000, 4), each, 0.4, 1.0)
    assert alike.power(0.0194) == pytest.approx(design.power(0.0194), abs=1e-3)


@pytest.mark.usefixtures("fewer_worlds")
def test_a_plan_says_whether_a_split_shows_an_effect(run: Run) -> None:
    words = ("plan", "--split", SPLIT)
    status, out, err = run(*words, "--effect", "10", "--discordance", "40")
    assert (status, err) == (0, "")
    found = re.fullmatch(
        f"{SPLIT} cannot show a difference of 10 points: found in ([0-9]+) % of comparisons\n"
        r"smallest difference at 80 % power  ([0-9]+\.[0-9]{2}) points\n"
        f"episodes for 10 points             ([0-9]+); {SPLIT} has 84\n"
        "assumed: 84 episodes, 29 targets; discordance 40 %, correlation 0; 1 run of each method\n",
        out,
    )
    assert found
    power, smallest, needed = map(float, found.groups())
    assert (power < 80, smallest > 10, needed > 84) == (True, True, True)
    out = run(*words, "--effect", "35", "--run-deviation", "3", "--runs", "4").out
    assert out.startswith(f"{SPLIT} can show a difference of 35 points: ")
    assert out.endswith("; 4 runs of each method, deviation 3 points\n")
    assert out.splitlines()[-2].startswith("runs of each method for 35 points  ")
    out = run(*words, "--effect", "20", "--run-deviation", "3", "--cluster", "scan").out
    assert "2 scans; discordance 50 %" in out
    assert "no number is enough: there are too few episodes\n" in out


def test_a_sample_is_planned_as_it_is_drawn(run: Run, tmp_path: Path) -> None:
    """What is asked in Python is answered as on the command line."""
    ids = tmp_path / "ids.txt"
    assert run("subset", "--split", SPLIT, "--n", "40", "-o", str(ids)).status == 0
    words = ("plan", "--split", SPLIT, "--effect", "25", "--against", "41.2")
    drawn = run(*words, "--n", "40").out
    assert drawn == run(*words, "--episodes-from", str(ids)).out
    assert drawn == f"{rv.plan(split=SPLIT, effect=0.25, n=40, against=0.412)}\n"
    assert drawn.startswith(f"40 episodes of {SPLIT} cannot show 25 points above 41.2 %: ")
    assert "\nassumed: 40 episodes, 25 targets, correlation 0.3; the published mean" in drawn
    assert (
        "no number is enough: the published mean is uncertain too"
        in run(*words, "--effect", "2").out
    )


def test_a_planned_sample_to_a_sentence(run: Run, tmp_path: Path) -> None:
    """Plan it, draw it, score it, and say how it compares with a published mean."""
    ids, words = tmp_path / "ids.txt", ("--split", SPLIT)
    planned = run("plan", *words, "--n", "60", "--effect", "40", "--against", "41.2")
    assert planned.out.startswith(f"60 episodes of {SPLIT} can show 40 points above 41.2 %: ")
    drawn = run("subset", *words, "--n", "60", "-o", str(ids)).err.split("|")[0]
    good, sample = str(SAMPLES / "good.json"), ("--episodes-from", str(ids))
    assert f"|{drawn}|" in run(good, *words, *sample, "--ci").out
    compared = run("compare", good, *words, *sample, "--against", "SR=41.2")
    assert (compared.status, compared.err) == (0, "")
    assert "\nBetter than the published mean by " in compared.out
    assert f"; on {SPLIT} itself, 95 % interval " in compared.out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--effect", "30", "--discordance", "20"], "larger than the discordance (20 %)"),
        (["--effect", "0"], "not in the range"),
        (["--correlation", "2"], "not in the range"),
        (["--n", "85"], "val_unseen has 84 episodes; choose between 1 and all of them, got 85"),
        (["--n", "9", "--episodes-from", "ids"], "both choose episodes; give one of them"),
        (["--against", "99"], "no rate is 2 points higher than 99 %"),
        (["--against", "41", "--run-deviation", "1"], "cannot be combined with --against"),
        (["--runs", "3"], "--runs needs --run-deviation"),
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
@pytest.mark.parametrize("field", [each.name for each in fields(Design)[1:]])
def test_a_design_out_of_range_is_refused(field: str, value: float) -> None:
    with pytest.raises(ProtocolError, match=f"^no comparison to plan: {field} is {value:g}, "):
        replace(MANY, **{field: value})  # type: ignore[arg-type]


def test_everything_that_is_out_of_range_is_named_at_once() -> None:
    with pytest.raises(ProtocolError) as refused:
        Design(np.array([0]), np.nan, correlation=1.5)
    assert str(refused.value) == (
        "no comparison to plan: the number of clusters is 1, expected 2 or more; the size of a "
        "cluster is 0, expected 1 or more; discordance is nan, expected more than 0, and at most "
        "1; correlation is 1.5, expected 0 to 1"
    )


@pytest.mark.parametrize("effect", [np.nan, np.inf, 0.26])
def test_an_impossible_effect_is_refused(effect: float) -> None:
    with pytest.raises(ProtocolError, match="is impossible: methods that disagree in"):
        MANY.power(effect)
    with pytest.raises(ProtocolError, match=r"no rate is higher than 0\.9 by so much"):
        PublishedDesign(MANY.sizes, MANY.sizes, 0.9, 0.0).power(effect)


def test_a_published_rate_out_of_range_is_refused() -> None:
    with pytest.raises(ProtocolError, match=r"^the rate is 41\.2, expected 0 to 1$"):
        rv.plan(split=SPLIT, against=41.2)
    with pytest.raises(ProtocolError, match="n and subset both choose episodes"):
        rv.plan(split=SPLIT, n=3, subset=["1196_0_0"])


@pytest.mark.usefixtures("fewer_worlds")
def test_a_public_bundle_has_no_targets(run: Run) -> None:
    status, _, err = run("plan", "--split", "test")
    assert (status, "is a public bundle" in err) == (2, True)
    assert run("plan", "--split", "test", "--cluster", "scan").status == 0
