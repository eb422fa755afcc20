"""A flat with five walks in it: the folder that the command line is tried in."""

import json
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from reverie_eval import GroundTruth, __version__
from reverie_eval.dataset import DatasetFiles, compile_split
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.worlds import SPLIT, write_world

TUB, SINK = 5, 6
FLAT = World(
    {
        "flat": Scan(
            {
                "door": Viewpoint((0.0, 0.0, 0.0)),
                "hall": Viewpoint((8.0, 0.0, 0.0)),
                "bath": Viewpoint((8.0, 6.0, 0.0), views={TUB: [12], SINK: [13]}),
            },
            frozenset({("door", "hall"), ("hall", "bath")}),
        )
    },
    [Item("7_1", "flat", ["door", "hall", "bath"], TUB, instructions=5)],
)
WALKS = [
    (["door", "hall", "bath"], TUB),  # 14 m, the shortest route
    (["door", "bath", "hall"], SINK),  # 20 m, with a jump and past the goal
    (["door", "hall", "door", "hall", "bath"], TUB),  # 30 m, a detour
    (["door"], -1),  # nowhere
    (["door", "hall", "door", "hall", "door", "bath"], -1),  # 46 m, with a jump at the end
]
FROM_AFAR = [*WALKS[:3], (["door"], TUB), WALKS[4]]
"""The fourth agent names the target without having moved."""
HOPS = [
    ([["door"], ["hall", "bath"]], TUB),  # cut to 8 m, short of the goal
    ([["door"], ["bath"], ["hall"]], SINK),  # nothing to cut
    ([["door"], ["hall"], ["door"], ["hall", "bath"]], TUB),  # cut to 24 m, short of the goal
    ([["door"]], -1),
    ([["door"], ["hall", "door", "hall"], ["door", "bath"]], -1),  # cut to 16 m, back at the start
]
"""These walks as hops; cut, what a reader of each hop's first viewpoint takes them for."""


class Outcome(NamedTuple):
    """What a command came to."""

    status: int
    out: str
    err: str


Run = Callable[..., Outcome]


def write_flat(folder: Path) -> None:
    """Write the flat as a dataset, its bundles and submissions into a folder."""
    write_world(FLAT, folder / "dataset")
    bundle = compile_split(DatasetFiles.find(folder / "dataset", split=SPLIT), SPLIT)
    bundle.save(folder / "full.npz")
    bundle.public().save(folder / "public.npz")
    for name, walks in (("submit", WALKS), ("afar", FROM_AFAR)):
        write_submission(
            folder / f"{name}.json",
            [([[place, 0, 0] for place in walk], answer) for walk, answer in walks],
        )
    write_submission(folder / "hops.json", HOPS)
    (folder / "folder").mkdir()


def write_submission(file: Path, walks: Sequence[tuple[Sequence[object], int]]) -> None:
    """Write trajectories and answers as the submission for the flat's episodes."""
    records = [
        {"instr_id": f"7_1_{k}", "trajectory": trajectory, "predObjId": answer}
        for k, (trajectory, answer) in enumerate(walks)
    ]
    file.write_text(json.dumps(records))


def words(line: str) -> list[str]:
    """Split a command line that works in the folder."""
    text = line.format(split=f"--split {SPLIT}", full="--ground-truth full.npz")
    return shlex.split(text)


SCORE = words("submit.json {split} {full}")


def fingerprint() -> str:
    """Return the fingerprint of the bundle in the folder."""
    return GroundTruth.load("full.npz").fingerprint


def signature(rules: str = "official-v1") -> str:
    """Return what every table of the folder's submission is signed with."""
    data = fingerprint()[:12]
    return f"split:{SPLIT}|protocol:{rules}|data:{data}|n:5|version:{__version__}"


NOTE = (
    "note: 2 jumps in 2 episodes: "
    "moves between unconnected viewpoints, counted at shortest-path distance"
)
TABLE = f"""\
 TL m   SR %  OSR %  SPL %  RGS %  RGSPL %
22.00  60.00  80.00  35.42  40.00    29.33

SIGNATURE
ground truth: full.npz (custom)
{NOTE}
"""
