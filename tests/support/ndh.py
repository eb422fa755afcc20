"""Random worlds of NDH: goal regions and further paths on the worlds of :mod:`worlds`."""

from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

import numpy as np

from reverie_eval import GroundTruth
from reverie_eval.ground_truth import Bundle
from tests.support.oracle import Item, World
from tests.support.worlds import SPLIT, ground_truth_arrays, instructions_of


@dataclass(frozen=True)
class Region:
    """What NDH annotates of an item beside the trusted path."""

    goals: Sequence[str]
    planner: Sequence[str]
    player: Sequence[str]


def truth_of(world: World, regions: Sequence[Region]) -> GroundTruth:
    """Return a world's ground truth as NDH's."""
    arrays = {
        name: array
        for name, array in ground_truth_arrays(world).items()
        if not name.startswith(("task_target", "candidate", "box"))
    }
    row = {viewpoint_id: index for index, viewpoint_id in enumerate(arrays["viewpoint_id"])}
    kinds = {
        ("path/planner", "path_offsets/planner"): [each.planner for each in regions],
        ("path/player", "path_offsets/player"): [each.player for each in regions],
        ("goal_viewpoint", "goal_offsets"): [each.goals for each in regions],
    }
    for (name, offsets), lists in kinds.items():
        arrays |= {
            name: np.array([row[it] for each in lists for it in each]),
            offsets: np.cumsum([0, *map(len, lists)]),
        }
    texts = instructions_of(world)
    return GroundTruth.from_bundle(
        Bundle.build(SPLIT, "custom", {}, arrays, {}, texts=texts, task="ndh")
    )


def random_region(random: Random, world: World, item: Item) -> Region:
    """Draw goals and two paths among what can be reached from the start."""
    reachable = list(world.scans[item.scan_id].routes[item.path[0]])
    return Region(
        random.choices(reachable, k=random.randint(1, 3)),
        [item.path[0], *random.choices(reachable, k=random.randint(0, 2))],
        [item.path[0], *random.choices(reachable, k=random.randint(0, 2))],
    )
