"""How the walks of a method are summarised, to be compared with those of many others."""

from pathlib import Path

import numpy as np
import pytest

from reverie_eval.analysis import WalkOutcomes
from reverie_eval.scoring import OUTCOMES
from tests.support.home_world import LAMP, SOFA, WALKS, home_scores

OTHER = {
    # Away from the room, where the path ends; back; then past the goal, which is no wrong turn.
    "1_3_0": (["hall", "stairs", "hall", "room", "porch"], LAMP),
    # Turns around on the spot first, which leads nowhere.
    "1_3_1": (["hall", "hall", "stairs", "shelf"], -1),
    "1_3_2": (["hall"], SOFA),
    # The sofa is seen from the room, so what follows is no wrong turn but going on.
    "2_4_0": (["porch", "room", "porch"], SOFA),
    "2_4_1": (["porch", "room", "hall", "stairs"], LAMP),
}


@pytest.mark.parametrize(
    ("walks", "ends", "stops", "turns"),
    [
        pytest.param(
            WALKS,
            [
                "correct",
                "wrong object",
                "correct object at the wrong stop",
                "overshot",
                "never reached",
            ],
            ["room", "porch", "hall", "porch", "porch"],
            [None] * 5,
            id="one of every outcome, none of which turns wrong before it is there",
        ),
        pytest.param(
            OTHER,
            [
                "correct",
                "never reached",
                "never reached",
                "correct object at the wrong stop",
                "overshot",
            ],
            ["porch", "shelf", "hall", "porch", "stairs"],
            [("hall", "stairs"), ("hall", "stairs"), None, None, None],
            id="only the first move away from the goal, and none once it was reached",
        ),
    ],
)
def test_walks(
    tmp_path: Path,
    walks: dict[str, tuple[list[str], int]],
    ends: list[str],
    stops: list[str],
    turns: list[tuple[str, str] | None],
) -> None:
    scores = home_scores(tmp_path, walks)
    found = WalkOutcomes.of(scores)
    ids = np.array(scores.ground_truth.graph.viewpoint_ids)
    assert [list(OUTCOMES)[number] for number in found.outcome] == ends
    assert ids[found.stop].tolist() == stops
    assert [None if turn[0] < 0 else tuple(ids[turn]) for turn in found.wrong_turn] == turns
    assert found.is_correct.tolist() == [end == "correct" for end in ends]
    assert found.path_length.tolist() == scores.episodes["path_length"].tolist()
