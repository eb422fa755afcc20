"""The HTML report: what is in it, that it is sound, and that a browser is content with it."""

import re
from dataclasses import replace
from html import escape
from pathlib import Path
from xml.etree import ElementTree as ET

import html5lib
import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.analysis import GROUPINGS, episodes_won, near_misses, with_different_routes
from reverie_eval.reporting import report_sections as sections
from reverie_eval.reporting.report import report_html
from reverie_eval.reporting.report_sections import BEST_OUTCOME_FIRST, Bar, Breakdown, GroupRow
from reverie_eval.scoring import OUTCOMES
from tests.conftest import SAMPLES
from tests.support.flat_world import Run, words
from tests.support.home_world import LAMP, OTHER_WALKS, WALKS, home_log, home_scores, perfect
from tests.support.terminals import on_terminal

HTML = "{http://www.w3.org/1999/xhtml}"
SVG = "{http://www.w3.org/2000/svg}"
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'none'"
)
MARKUP = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> rv.Scores:
    """Score an episode of every outcome."""
    return home_scores(tmp_path_factory.mktemp("home")).with_intervals()


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> rv.Scores:
    """Score another submission for the same episodes."""
    return home_scores(tmp_path_factory.mktemp("home"), OTHER_WALKS).with_intervals()


@pytest.fixture(scope="module")
def single(home: rv.Scores) -> str:
    """Write the report of one submission."""
    return report_html({"mine": home})


@pytest.fixture(scope="module")
def both(home: rv.Scores, other: rv.Scores) -> str:
    """Write the report of two."""
    return report_html({"mine": home, "theirs": other})


@pytest.fixture(scope="module")
def spoiled(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Write a report with markup in every text that comes from a file."""
    folder = tmp_path_factory.mktemp("home")
    mine = home_scores(folder, go_there=MARKUP).with_intervals()
    mine = replace(mine, ground_truth=replace(mine.ground_truth, origin="/home/<b>home.npz"))
    mine = mine.with_run(home_log(folder, said=MARKUP))
    theirs = home_scores(folder / "again", OTHER_WALKS, go_there=MARKUP).with_intervals()
    return report_html({"<i>mine": mine, "<i>theirs": theirs})


def parsed(page: str) -> ET.Element:
    """Parse a page; fails on anything that is not sound HTML."""
    parser = html5lib.HTMLParser(strict=True)
    root: ET.Element = parser.parse(page)
    return root


def section(page: str, identifier: str) -> ET.Element:
    """Return a section of a page."""
    return next(each for each in parsed(page).iter() if each.get("id") == identifier)


def cells(table: ET.Element) -> list[list[str]]:
    """Return the words of a table's body, its bars left out."""
    return [
        [" ".join("".join(cell.itertext()).split()) for cell in row if cell.get("class") != "bars"]
        for row in table.iter(f"{HTML}tr")
        if row.find(f"{HTML}td") is not None
    ]


def tables(page: str, identifier: str) -> list[list[list[str]]]:
    """Return the words of a section's tables."""
    return [cells(table) for table in section(page, identifier).iter(f"{HTML}table")]


@pytest.fixture(scope="module")
def runs(
    tmp_path_factory: pytest.TempPathFactory, home: rv.Scores, other: rv.Scores
) -> dict[str, rv.Scores]:
    """Attach the logs of three runs, the last of which is that of the second once more."""
    mine = home_log(tmp_path_factory.mktemp("mine"), said="There is a lamp.")
    theirs = home_log(tmp_path_factory.mktemp("theirs"), OTHER_WALKS)
    return {"a": home.with_run(mine), "b": other.with_run(theirs), "c": other.with_run(theirs)}


# What is in it.


def test_what_runs_cost(runs: dict[str, rv.Scores], single: str) -> None:
    page = report_html(runs)
    # 10 steps of a, 11 of b and c, in 5 episodes.
    assert tables(page, "costs") == [
        [
            ["a", "2", "1", "20", "0.200"],
            ["b", "2.20", "1.10", "22", "0.220"],
            ["c", "2.20", "1.10", "22", "0.220"],
        ]
    ]
    costs = section(page, "costs")
    kinds = [each.get("class", "").split()[0] for each in costs.iter(f"{SVG}path")]
    assert (kinds.count("band"), kinds.count("curve")) == (3, 3)
    text = "".join(costs.itertext())
    assert "on the Pareto front of SR and money: " in text
    assert [row[0] for row in tables(page, "comparison")[0]] == ["a", "b", "c"]
    assert [len(tables(page, each)[0]) for each in ("scores", "outcomes")] == [3, 4]
    assert 'id="changes"' not in page
    assert 'id="costs"' not in single
    alone = report_html({"a": runs["a"]}, "scan")
    assert "no success within a budget: all episodes share one scan" in alone


def test_a_replay_lists_what_the_agent_did_and_said(runs: dict[str, rv.Scores]) -> None:
    episode = runs["a"].episode("1_3_1")
    shown = parsed(f"<!DOCTYPE html><title>x</title>{episode._repr_html_()}")
    steps, views = told(shown)
    assert views == [
        "Seen from a step, heading 0°, level.",
        "Seen from a step, heading 0°, level. The target is object 3.",
        "Seen from a step, heading 0°, level. The target is object 3.",
    ]
    after = "0.500 s, 10 input tokens, 0.100 US dollarssaid There is a lamp."
    assert steps == [
        f"hall, facing 0°; 2 neighbours; 1 object; 6.0 m to the goalGo room {after}",
        f"room, facing 0°; 2 neighbours; 2 objects; 0.0 m to the goalGo porch {after}",
        f"porch, facing 0°; 1 neighbour; 1 object; 0.0 m to the goalAnswer object 4 {after}",
    ]
    labels = [each.text for each in shown.iter(f"{SVG}text") if each.get("class") == "level"]
    assert labels == ["1", "2", "3"]
    page = report_html({"a": runs["a"]})
    assert steps[0] in told(parsed(page))[0]


def told(page: ET.Element) -> tuple[list[str], list[str]]:
    """Return the texts of a page's lists, and the captions of the views in them."""
    items = list(page.iter(f"{HTML}li"))
    views = [view for item in items for view in item.iter(f"{HTML}div")]
    captions = [str(view.findtext(f"{SVG}svg/{SVG}title")) for view in views]
    for view in views:
        view.clear()
    return ["".join(item.itertext()) for item in items], captions


def test_scores_with_their_intervals(single: str, home: rv.Scores) -> None:
    ((row,),) = tables(single, "scores")
    assert [cell[:5] for cell in row[1:]] == ["40.00", "60.00", "31.99", "40.00", "40.00"]
    assert home.intervals is not None
    rgspl = home.intervals["rgspl"]
    assert row[-1] == f"40.00{100 * rgspl.low:.2f} to {100 * rgspl.high:.2f}"
    text = "".join(section(single, "scores").itertext())
    assert home.signature in text
    assert home.intervals.caption in text
    assert "protocol official-v1: the dataset's own script" in text


def test_the_finding(single: str) -> None:
    assert (
        "1 of 5 episodes (20.0\u00a0%) stopped at the goal and predicted the target. Most "
        "common failure: 1 of the other 4 (25.0\u00a0%) did not get to the goal."
    ) in single


def test_funnel_and_outcomes(single: str) -> None:
    funnel, outcomes = tables(single, "outcomes")
    assert funnel == [
        ["all episodes", "5", "100.0 %"],
        ["reached the goal", "3", "60.0 %"],
        ["stopped at the goal", "2", "66.7 %"],
        ["predicted the target", "1", "50.0 %"],
    ]
    assert [row[1:] for row in outcomes] == [["1", "20.0 %"]] * 5
    assert [
        next(outcome for outcome, meaning in OUTCOMES.items() if row[0] == outcome + meaning)
        for row in outcomes
    ] == [
        "correct",
        "correct object at the wrong stop",
        "wrong object",
        "overshot",
        "never reached",
    ]


def test_an_agent_that_never_comes_near(tmp_path: Path) -> None:
    stays = {instr_id: (walk[:1], -1) for instr_id, (walk, _) in WALKS.items()}
    page = report_html({"stop": home_scores(tmp_path, stays)})
    assert tables(page, "outcomes")[0] == [
        ["all episodes", "5", "100.0 %"],
        ["reached the goal", "0", "0.0 %"],
        ["stopped at the goal", "0", "-"],
        ["predicted the target", "0", "-"],
    ]
    parsed(page)


def test_bars_are_as_long_as_they_say(single: str) -> None:
    rows = list(section(single, "outcomes").iter(f"{HTML}tr"))
    bars = [each.get("width") for row in rows for each in row.iter(f"{SVG}rect")]
    assert bars[:4] == ["100.00%", "60.00%", "40.00%", "20.00%"]
    stack = next(section(single, "outcomes").iter(f"{SVG}svg"))
    pieces = [(each.get("x"), each.get("width")) for each in stack.iter(f"{SVG}rect")]
    assert pieces == [(f"{20 * n:.2f}%", "20.00%") for n in range(5)]


def test_breakdowns(single: str) -> None:
    headings = [each.text for each in section(single, "strengths").iter(f"{HTML}h3")]
    assert headings == ["By length"]  # both targets are seen from two places
    said = [each.text for each in section(single, "strengths").iter(f"{HTML}p")]
    assert said[-1] == "The shortest length to the goal."
    ((near, far),) = tables(single, "strengths")
    assert near == ["6 to 8 m", "3", "66.67", "66.67"]
    assert far == ["10 to 12 m", "2", "0.00", "0.00"]


def test_a_group_without_episodes_of_the_other_has_no_score_of_it() -> None:
    """Only the mediocre sample's trajectories have jumps."""
    scores = {
        name: rv.evaluate(SAMPLES / f"{name}.json", split="val_unseen")
        for name in ("mediocre", "good")
    }
    table = sections.breakdown_by(scores, GROUPINGS["jumps"])
    (_, without), (mediocre, missing) = (row.bars for row in table.rows)
    assert [row.name for row in table.rows] == ["no jump", "jumps"]
    assert without is not None
    assert without.value == pytest.approx(100 * scores["good"]["rgspl"])
    assert mediocre is not None
    assert missing is None


def test_groups_have_intervals_where_the_scores_have_them() -> None:
    scores = rv.evaluate(SAMPLES / "good.json", split="val_unseen").with_intervals()
    page = report_html({"good": scores})
    shown = {row[0]: row[-1] for table in tables(page, "strengths") for row in table}
    found = scores.breakdown("level", intervals=True).to_dict("index")["level 2"]
    ends = " to ".join(f"{100 * found[f'rgspl_{end}']:.1f}" for end in ("low", "high"))
    assert shown["level 2"] == f"{100 * found['rgspl']:.2f}{ends}"
    whiskers = [
        (each.get("x1"), each.get("x2")) for each in section(page, "strengths").iter(f"{SVG}line")
    ]
    drawn = tuple(f"{100 * found[f'rgspl_{end}']:.2f}%" for end in ("low", "high"))
    assert drawn in whiskers
    assert "95\u00a0% intervals over targets below RGSPL" in page.replace("&nbsp;", "\u00a0")


def test_groups_of_few_targets_have_none(single: str) -> None:
    assert not list(section(single, "strengths").iter(f"{SVG}line"))


def test_scans_come_from_the_worst() -> None:
    scores = rv.evaluate(SAMPLES / "drawn.json", split="val_unseen")
    ((*rows,),) = tables(report_html({"drawn": scores}), "scans")
    assert [row[0] for row in rows] == ["DemoRectory", "DemoMansion"]
    assert float(rows[0][-1]) < float(rows[1][-1])


def test_small_scans_come_last(home: rv.Scores) -> None:
    sizes = (("a", 9, 0.0), ("b", 10, 50.0), ("c", 10, 40.0))
    rows = [GroupRow(name, episodes, "", [Bar(percent)]) for name, episodes, percent in sizes]
    table = Breakdown(GROUPINGS["scan"], rows)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sections, "breakdown_by", lambda *_: table)
        ordered = sections.scans_worst_first({"mine": home}).rows
    assert [row.name for row in ordered] == ["c", "b", "a"]


def test_many_groups_are_folded() -> None:
    page = report_html({"good": rv.evaluate(SAMPLES / "good.json", split="val_unseen")})
    categories = rv.evaluate(SAMPLES / "good.json", split="val_unseen").breakdown("category")
    folded = len(categories) - 10
    (details,) = section(page, "strengths").iter(f"{HTML}details")
    assert details.findtext(f"{HTML}summary") == f"and {folded} more"
    assert len(cells(details)) == folded


@pytest.mark.parametrize(
    ("walk", "note"),
    [
        pytest.param(["hall"], "", id="never came"),
        pytest.param(
            ["hall", "room", "hall"],
            "1 of the 1 episodes with the correct object at the wrong stop had reached the goal "
            "before.",
            id="came and went on",
        ),
    ],
)
def test_who_is_right_from_afar_may_have_come_to_the_goal(
    walk: list[str], note: str, tmp_path: Path
) -> None:
    scores = home_scores(tmp_path, {**WALKS, "1_3_2": (walk, LAMP)})
    page = report_html({"mine": scores})
    (said,) = re.findall(r"counts as success\.(.*)</p>", page)
    assert said.strip() == note
    assert scores.failure_modes.funnel["reached the goal"] == 3 + bool(note)


def test_distributions_are_drawn(single: str) -> None:
    titles = [each.text for each in section(single, "distributions").iter(f"{HTML}h3")]
    assert titles == ["Walked and shortest length", "Distance at stop"]
    text = "".join(section(single, "distributions").itertext())
    assert "20.0 % are above it" in text  # 1_3_1 alone makes a detour
    assert "median 6.00 m. 20.0 % of episodes stop exactly there" in text
    charts = list(section(single, "distributions").iter(f"{SVG}svg"))
    dots = {each.get("class"): each.get("d", "") for each in charts[0].iter(f"{SVG}path")}
    assert [dots[kind].count("M") for kind in ("dot miss", "dot hit")] == [3, 2]


def test_no_axis_says_less_than_zero() -> None:
    """All of these agents stop right at the end of the path."""
    page = report_html({"perfect": rv.evaluate(perfect(), split="val_unseen")})
    _, stops = section(page, "distributions").iter(f"{SVG}svg")
    words = [each.text for each in stops.iter(f"{SVG}text")]
    assert words[:3] == ["0", "1", "0"]  # across, and the first upwards


def test_overlaps_of_boxes_are_drawn_where_there_are_some() -> None:
    page = report_html({"drawn": rv.evaluate(SAMPLES / "drawn.json", split="val_unseen")})
    titles = [each.text for each in section(page, "distributions").iter(f"{HTML}h3")]
    assert titles[-1] == "Overlap of boxes"
    assert "58.0 % of 81 boxes reach 50 % and are correct" in page


@pytest.mark.parametrize("first", ["drawn", "good"])
def test_overlaps_are_drawn_of_whoever_has_boxes(first: str) -> None:
    names = ["drawn", "good"] if first == "drawn" else ["good", "drawn"]
    scores = {name: rv.evaluate(SAMPLES / f"{name}.json", split="val_unseen") for name in names}
    page = report_html(scores)
    *_, overlaps = section(page, "distributions").iter(f"{SVG}svg")
    assert overlaps.findtext(f"{SVG}title") == "Distribution of intersection over union (%)"
    kinds = {each.get("class") for each in overlaps.iter(f"{SVG}path")} - {"axis"}
    assert kinds == ({"mark series-1"} if first == "drawn" else {"outline series-2"})
    about = r"median of drawn \d+\.\d\d %\. 58\.0 % of 81 boxes of drawn reach 50 %"
    assert re.search(about, page)


def test_a_map_for_each_failure(single: str) -> None:
    shown = section(single, "near-misses")
    assert shown.findtext(f"{HTML}h2") == "Near misses"
    kinds = [each.text for each in shown.iter(f"{HTML}h3")]
    assert kinds == [
        "never reached",
        "overshot",
        "wrong object",
        "correct object at the wrong stop",
    ]
    titles = [each.findtext(f"{SVG}title") for each in shown.iter(f"{SVG}svg") if each.get("role")]
    target_from_the_end = {
        "2_4_1": ["porch", "hall"],
        "2_4_0": ["porch", "hall"],
        "1_3_1": ["porch"],
        "1_3_2": ["hall", "room"],
    }
    assert titles == [
        title
        for episode, viewpoints in target_from_the_end.items()
        for title in (
            f"Map of episode {episode}",
            *(f"What is visible from viewpoint {each}" for each in viewpoints),
        )
    ]


def test_without_failures_there_are_no_maps() -> None:
    scores = rv.evaluate(perfect(), split="val_unseen")
    page = report_html({"perfect": scores})
    assert "84 of 84 episodes (100.0\u00a0%) stopped at the goal and predicted the target." in page
    assert "All episodes are correct." in page
    assert "Map of episode" not in page


# Which episodes are shown.


@pytest.mark.parametrize("sample", ["good", "mediocre", "drawn"])
def test_failures_are_the_nearest_of_their_kind(sample: str) -> None:
    scores = rv.evaluate(SAMPLES / f"{sample}.json", split="val_unseen")
    outcome, error = np.array(scores.outcomes), scores.episodes["navigation_error"]
    for kind, chosen in near_misses(scores).items():
        episodes = [scores.episode(instr_id) for instr_id in chosen]
        assert {episode.outcome for episode in episodes} <= {kind}
        ways = {(episode.start, episode.goal) for episode in episodes}
        assert len(ways) == len(chosen) <= 3
        if kind in ("overshot", "correct object at the wrong stop") and chosen:
            nearest = float(error[outcome == kind].min())
            assert episodes[0].values["navigation_error"] == nearest
    assert near_misses(scores) == near_misses(scores)


def test_a_wrong_box_that_overlaps_most_is_nearest() -> None:
    scores = rv.evaluate(SAMPLES / "drawn.json", split="val_unseen")
    wrong = np.array(scores.outcomes) == "wrong object"
    first = scores.episode(near_misses(scores)["wrong object"][0])
    assert first.values["iou"] == scores.episodes["iou"][wrong].max() > 0


def test_won_and_lost(home: rv.Scores, other: rv.Scores) -> None:
    assert episodes_won(home, other) == ["2_4_1"]
    assert episodes_won(other, home) == ["1_3_0"]
    assert with_different_routes(home, ["1_3_0", "1_3_1", "2_4_1"]) == ["1_3_0", "2_4_1"]


def test_the_clearest_change_comes_first() -> None:
    mediocre, good = (
        rv.evaluate(SAMPLES / f"{name}.json", split="val_unseen") for name in ("mediocre", "good")
    )
    for chosen, sign in ((episodes_won(mediocre, good), 1), (episodes_won(good, mediocre), -1)):
        episodes = [(mediocre.episode(each).values, good.episode(each).values) for each in chosen]
        assert {sign * (after["rgs"] - before["rgs"]) for before, after in episodes} == {1.0}
        changes = [sign * (after["rgspl"] - before["rgspl"]) for before, after in episodes]
        assert changes == sorted(changes, reverse=True)
        assert len(set(changes)) > 1
    comparison = rv.compare(mediocre, good, names=["mediocre", "good"])
    assert len(episodes_won(mediocre, good)) == comparison["good"]["rgs"].higher


# Two submissions.


def test_a_comparison(both: str, home: rv.Scores, other: rv.Scores) -> None:
    comparison = rv.compare(home, other, names=["mine", "theirs"])
    grid, changes = tables(both, "comparison")
    assert [row[0] for row in grid[:3]] == ["mine", "theirs", "theirs - mine"]
    assert comparison.sentence("theirs").replace(" %", "\u00a0%") in both
    assert changes == [
        ["correct", "0", "0", "0", "0", "1"],
        ["correct object at the wrong stop", "0", "1", "0", "0", "0"],
        ["wrong object", "0", "0", "1", "0", "0"],
        ["overshot", "0", "0", "0", "0", "1"],
        ["never reached", "1", "0", "0", "0", "0"],
    ]


def test_the_comparison_s_table_is_the_notebook_s(
    both: str, home: rv.Scores, other: rv.Scores
) -> None:
    comparison = rv.compare(home, other, names=["mine", "theirs"])
    shown = comparison._repr_html_()  # what Jupyter calls
    (table,) = (each for each in parsed(f"<!DOCTYPE html>{shown}").iter(f"{HTML}table"))
    assert cells(table) == tables(both, "comparison")[0]
    assert f"<strong>{escape(comparison.sentence('theirs'))}.</strong>" in shown


def test_the_notebook_s_comparison_is_sound_html() -> None:
    files = [SAMPLES / "mediocre.json", SAMPLES / "good.json"]
    shown = rv.compare(*files, split="val_unseen")._repr_html_()
    assert "<td>&lt; 0.001</td>" in shown
    parsed(f"<!DOCTYPE html>{shown}")


def test_both_are_side_by_side(both: str) -> None:
    funnel, outcomes = tables(both, "outcomes")
    assert funnel[1] == ["reached the goal", "3", "60.0 %", "2", "40.0 %"]
    assert outcomes[0][1:] == ["1", "20.0 %", "1", "20.0 %"]
    assert tables(both, "strengths")[0][0] == ["6 to 8 m", "3", "66.67", "66.67", "33.33"]
    (heads,) = (each for each in section(both, "strengths").iter(f"{HTML}thead"))
    assert [each.text for each in heads.iter(f"{HTML}th")] == [
        "length",
        "episodes",
        "mine SR\u00a0%",
        "mine RGSPL\u00a0%",
        "theirs RGSPL\u00a0%",
        "RGSPL",
    ]


def test_the_head_says_who_is_better_and_whose_finding_follows(
    both: str, home: rv.Scores, other: rv.Scores
) -> None:
    comparison = rv.compare(home, other, names=["mine", "theirs"])
    header = next(parsed(both).iter(f"{HTML}header"))
    said = ["".join(each.itertext()) for each in header.iter(f"{HTML}p")]
    assert said[1].replace("\u00a0", " ") == f"{comparison.sentence('theirs')}."
    assert said[2].startswith("mine: 1 of 5 episodes")


def test_episodes_won_and_lost_are_overlaid(both: str) -> None:
    shown = section(both, "changes")
    headings = [each.text for each in shown.iter(f"{HTML}h3")]
    assert headings == [
        "1 episode that only theirs got right",
        "1 episode that only mine got right",
    ]
    pictures = [each for each in shown.iter(f"{SVG}svg") if each.get("role")]
    maps = [each for each in pictures if each.get("class", "").startswith("episode-map")]
    assert [each.findtext(f"{SVG}title") for each in maps] == [
        "Map of episode 2_4_1",
        "Map of episode 1_3_0",
    ]
    stops = [[each.get("class") for each in one.iter(f"{SVG}rect")] for one in maps]
    assert stops == [["ground", "stop route-1", "stop route-2"]] * 2
    answers = [each.get("class") for each in pictures if each not in maps]
    both_and_target = [f"answer-view route-{number} in-room" for number in (1, 2, 3)]
    assert answers == 2 * both_and_target


# Sound, safe, and the same again.


@pytest.mark.parametrize("page", ["single", "both", "spoiled"])
def test_it_is_sound_html(page: str, request: pytest.FixtureRequest) -> None:
    root = parsed(request.getfixturevalue(page))
    identifiers = [each.get("id") for each in root.iter() if each.get("id")]
    assert len(set(identifiers)) == len(identifiers)
    links = [*root.iter(f"{HTML}a"), *root.iter(f"{SVG}use")]
    assert {each.get("href", "") for each in links} == {f"#{each}" for each in identifiers}


@pytest.mark.parametrize("page", ["single", "both", "spoiled"])
def test_it_loads_nothing(page: str, request: pytest.FixtureRequest) -> None:
    text = request.getfixturevalue(page)
    root = parsed(text)
    assert not re.search(r"https?:|url\(|@import", text)
    assert not {each.tag for each in root.iter()} & {
        f"{HTML}{name}" for name in ("script", "iframe", "object", "embed", "img", "form", "base")
    }
    (link,) = root.iter(f"{HTML}link")
    assert link.attrib == {"rel": "icon", "href": "data:,"}
    policies = [
        each.get("content")
        for each in root.iter(f"{HTML}meta")
        if each.get("http-equiv") == "Content-Security-Policy"
    ]
    assert policies == [POLICY]
    assert not [name for each in root.iter() for name in each.attrib if name.startswith("on")]


def test_every_text_is_escaped(spoiled: str) -> None:
    text = "".join(parsed(spoiled).itertext())
    assert MARKUP in text
    assert "<i>theirs compared with <i>mine" in text
    assert "<b>home" in text
    assert not re.search(r"<script|<i>|<b>home", spoiled)


def test_the_same_scores_have_the_same_page(both: str, home: rv.Scores, other: rv.Scores) -> None:
    assert report_html({"mine": home, "theirs": other}) == both


# The command.

REPORT = ("report", str(SAMPLES / "good.json"), "--split", "val_unseen")


def test_the_command_writes_a_file(tmp_path: Path, run: Run) -> None:
    page = tmp_path / "report.html"
    assert run(*REPORT, "-o", str(page)) == (0, "", "")
    scores = rv.evaluate(SAMPLES / "good.json", split="val_unseen").with_intervals()
    assert page.read_text() == report_html({"good": scores})


def test_the_command_prints(run: Run) -> None:
    status, out, err = run(*REPORT[:2], str(SAMPLES / "mediocre.json"), *REPORT[2:])
    assert (status, err) == (0, "")
    assert "<title>good and mediocre on val_unseen: reverie-eval report</title>" in out


def test_a_terminal_is_no_place_for_it() -> None:
    shown = on_terminal(200, *REPORT)
    assert "a report is a page for a browser; name its file: -o report.html" in shown
    assert "<html" not in shown


def test_a_report_is_not_a_pdf(tmp_path: Path, run: Run) -> None:
    page = tmp_path / "report.pdf"
    status, out, err = run(*REPORT, "-o", str(page))
    assert (status, out, page.exists()) == (2, "", False)
    assert "expected a name that ends in .html; a browser prints the page as PDF" in err


@pytest.mark.parametrize("by", ["target", "scan"])
@pytest.mark.usefixtures("here")
def test_one_cluster_has_a_report_without_intervals(by: str, run: Run) -> None:
    options = words(f"{{split}} {{full}} --cluster {by}")
    status, one, err = run("report", "submit.json", *options)
    assert (status, err) == (0, "")
    assert f"no intervals: all episodes share one {by}" in one
    two = run("report", "submit.json", "afar.json", *options).out
    parsed(two)
    assert f"not compared: all episodes share one {by}" in two
    ((*changes,),) = tables(two, "comparison")
    assert [row[0] for row in changes] == list(BEST_OUTCOME_FIRST)
    assert "1 episode that only afar got right" in two


@pytest.mark.parametrize(
    ("names", "says"),
    [
        pytest.param([], "one submission or more; got none", id="none"),
        pytest.param([1], "names of submissions must be text; got 1", id="a number"),
    ],
)
def test_a_report_is_about_one_or_more(names: list[str], says: str, home: rv.Scores) -> None:
    with pytest.raises(rv.ProtocolError, match=says):
        report_html(dict.fromkeys(names, home))


@pytest.mark.parametrize(
    ("words", "status", "reason"),
    [
        pytest.param(
            [str(SAMPLES / "broken.json")], 1, "broken.json: submission rejected", id="2nd"
        ),
        pytest.param(["-o", str(SAMPLES / "good.json")], 2, "good.json", id="over its input"),
    ],
)
def test_the_command_refuses(words: list[str], status: int, reason: str, run: Run) -> None:
    outcome = run(*REPORT[:2], *words, *REPORT[2:])
    assert (outcome.status, outcome.out) == (status, "")
    assert reason in outcome.err


def test_a_report_names_files_without_their_folders(here: Path, run: Run) -> None:
    given = [str(here / name) for name in ("submit.json", "afar.json")]
    page = run("report", *given, "--split", "val_unseen", "--ground-truth", str(here / "full.npz"))
    assert page.status == 0
    assert "ground truth: full.npz (custom)" in page.out
    assert str(here) not in page.out
