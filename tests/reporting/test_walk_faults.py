"""Where the walks of several methods end and turn wrong, counted by hand and drawn."""

from pathlib import Path
from xml.etree import ElementTree as ET

from reverie_eval.analysis import WalkOutcomes
from reverie_eval.reporting.outcomes import STOPS, WalkFaults
from tests.support.home_world import OTHER_WALKS, WALKS, home_scores


def test_stops_and_wrong_turns_of_two_methods(tmp_path: Path) -> None:
    both = [home_scores(tmp_path / f"{n}", each) for n, each in enumerate((WALKS, OTHER_WALKS))]
    truth = both[0].ground_truth
    faults = WalkFaults.of(truth, "home", [WalkOutcomes.of(each) for each in both])
    ids = truth.graph.viewpoint_ids
    counts = {
        kind: {ids[row]: number for row, number in enumerate(numbers) if number}
        for kind, numbers in zip(STOPS, faults.stops.tolist(), strict=True)
    }
    assert counts == {
        "at-goal": {"hall": 1, "room": 1, "porch": 2},
        "moved-on": {"porch": 1},
        "gave-up": {"shelf": 1, "hall": 2, "porch": 2},
    }
    assert [tuple(ids[row] for row in turn) for turn in faults.turns] == [("hall", "stairs")]
    assert faults.times.tolist() == [1]

    below, above = faults.pictures()
    assert (below[0], above[0]) == ("level 1 of 2", "level 2 of 2")
    titles = [ET.fromstring(picture).findtext("title", "") for _, picture in (below, above)]
    assert titles == [
        "Walks in home, level 1 of 2: 0 stops at the goal, 0 after it, 1 without reaching it",
        "Walks in home, level 2 of 2: 4 stops at the goal, 1 after it, 4 without reaching it",
    ]
    circles = [each.get("class") for each in ET.fromstring(above[1]).iter("circle")]
    assert sorted(map(str, circles)) == [
        *["stops at-goal"] * 3,
        *["stops gave-up"] * 2,
        "stops moved-on",
    ]
    (turn,) = (each for each in ET.fromstring(above[1]).iter("path") if each.get("class") == "turn")
    assert turn.findtext("title") == "1 wrong turn"
