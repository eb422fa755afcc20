"""Let public codebases look around on ``MatterSim``, and compare what they find with the original.

``scripts/evidence simulator CLONE...`` takes clones, in folders named like the repositories. Their
own functions make the simulator, sweep the 36 views of every viewpoint, and keep for each neighbour
the view in which it is nearest to the centre. The original gave every view beforehand.
"""

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from fixtures.published import published_folder, simulator_folder, unpack_dataset
from reverie_eval.simulator import MatterSim
from tests.support.writers import Names, execute, functions, parse


class Found(NamedTuple):
    """A neighbour, as a sweep finds it."""

    view: int
    """Where it is nearest to the centre."""
    distance: float
    """Radians from there."""


Sweep = Callable[[str, str], Mapping[str, Found]]
"""What finds the neighbours of a viewpoint in a building."""


@dataclass(frozen=True)
class Candidates:
    """``make_candidate`` of an environment."""

    environment: str
    simulator: str

    def __call__(self, clone: Path) -> Sweep:
        """Return the sweep of a clone."""
        (making, *_) = functions([parse(clone / self.simulator)], "new_simulator")
        names = execute([making], names_of_a_module())
        given = {"connectivity_dir": "./connectivity"} if making.args.args else {}
        sim = names["new_simulator"](**given)
        (method, *_) = functions([parse(clone / self.environment)], "make_candidate")
        make_candidate = execute([method], names_of_a_module())["make_candidate"]
        features = np.zeros((36, 0))

        def sweep(scan: str, viewpoint: str) -> Mapping[str, Found]:
            env = SimpleNamespace(sim=sim, buffered_state_dict={}, angle_feat_size=0)
            candidates = make_candidate(env, features, scan, viewpoint, 0)
            return {it["viewpointId"]: Found(it["pointId"], it["distance"]) for it in candidates}

        return sweep


@dataclass(frozen=True)
class Panorama:
    """``_get_panorama_states`` of REVERIE's environment, which looks around from where it is."""

    environment: str

    def __call__(self, clone: Path) -> Sweep:
        """Return the sweep of a clone."""
        names = names_of_a_module()
        used = ("_loc_distance", "_canonical_angle", "_adjust_heading", "_adjust_elevation")
        for name in (*used, "_get_panorama_states", "make_sim"):
            execute(functions([parse(clone / self.environment)], name)[:1], names)
        sim = names["make_sim"](image_w=640, image_h=480, vfov=60)

        def sweep(scan: str, viewpoint: str) -> Mapping[str, Found]:
            sim.newEpisode(scan, viewpoint, 0, 0)
            _, (_, *found) = names["_get_panorama_states"](sim)
            return {
                it["nextViewpointId"]: Found(it["absViewIndex"], it["distance"]) for it in found
            }

        return sweep


SWEEPS: Mapping[str, Callable[[Path], Sweep]] = MappingProxyType(
    {
        "NaviLLM": Candidates("tasks/datasets/mp3d_dataset.py", "tasks/datasets/mp3d_envs.py"),
        "R2R-EnvDrop": Candidates("r2r_src/env.py", "r2r_src/utils.py"),
        "REVERIE": Panorama("tasks/REVERIE/env.py"),
        "Recurrent-VLN-BERT": Candidates("r2r_src/env.py", "r2r_src/utils.py"),
        "VLN-DUET": Candidates("map_nav_src/reverie/env.py", "map_nav_src/utils/data.py"),
        "VLN-HAMT": Candidates("finetune_src/r2r/env.py", "finetune_src/r2r/data_utils.py"),
    }
)
"""The sweep of each codebase, by the name of its repository."""


def names_of_a_module() -> Names:
    """Return what the functions take from the top of their modules."""
    sys.modules["MatterSim"] = MatterSim  # new_simulator imports it

    def angle_feature(*_: object) -> np.ndarray[Any, Any]:
        return np.zeros(0)

    return Names(
        np=np,
        math=math,
        MatterSim=MatterSim,
        angle_inc=np.pi / 6.0,
        angle_feature=angle_feature,
        utils=SimpleNamespace(angle_feature=angle_feature),
    )


def expected() -> Iterator[tuple[str, int, Mapping[int, Found]]]:
    """Yield each viewpoint, as building and index, with what the original's views come to."""
    folder = simulator_folder()
    if folder is None:
        raise SystemExit("what the original simulator gave is not here")
    with np.load(folder / "all_states.npz") as packed:
        recorded = {name: packed[name] for name in packed}
    # As the codebases compute it: numpy's squares would have other last bits.
    angles = zip(recorded["rel_heading"].tolist(), recorded["rel_elevation"].tolist(), strict=True)
    distances = [math.sqrt(heading**2 + elevation**2) for heading, elevation in angles]
    offset, neighbours = recorded["offset"].tolist(), recorded["nav_ix"].tolist()
    for first in np.flatnonzero(recorded["view"] == 0).tolist():
        found: dict[int, Found] = {}
        for view in range(36):
            for entry in range(offset[first + view] + 1, offset[first + view + 1]):
                nearest = found.get(neighbours[entry])
                if nearest is None or distances[entry] < nearest.distance:
                    found[neighbours[entry]] = Found(view, distances[entry])
        yield str(recorded["scans"][recorded["scan"][first]]), int(recorded["ix"][first]), found


def main() -> None:
    """Print how many neighbours each clone finds, and how many of them otherwise.

    Of R2R, it prints the scores of its agents.
    """
    folder = published_folder()
    if folder is None:
        raise SystemExit("the published REVERIE files are not here")
    clones = [Path(word).resolve() for word in sys.argv[1:]]
    with TemporaryDirectory() as temporary:
        os.chdir(unpack_dataset(folder, Path(temporary)))
        for clone in clones:
            revision = ["git", "-C", str(clone), "log", "-1", "--format=%h", "--abbrev=7"]
            commit = subprocess.run(revision, capture_output=True, text=True, check=True).stdout
            for line in lines_of(clone):
                sys.stdout.write(f"{clone.name} {commit.strip()}: {line}\n")


def lines_of(clone: Path) -> Iterable[str]:
    """Yield what a clone did."""
    if clone.name == "Matterport3DSimulator":
        from tests.support.r2r_agents import run_agents  # which needs networkx

        return run_agents(clone)
    return [compared(SWEEPS[clone.name](clone))]


def compared(sweep: Sweep) -> str:
    """Compare a sweep at every viewpoint with what the original gave."""
    names: dict[str, list[str]] = {}
    viewpoints = neighbours = differences = 0
    for scan, ix, found in expected():
        if scan not in names:
            content = Path("connectivity", f"{scan}_connectivity.json").read_bytes()
            names[scan] = [each["image_id"] for each in json.loads(content)]
        wanted = {names[scan][other]: it for other, it in found.items()}
        given = sweep(scan, names[scan][ix])
        viewpoints += 1
        neighbours += len(wanted)
        differences += len(wanted.items() ^ given.items())
    return f"{viewpoints:,} viewpoints, {neighbours:,} neighbours, {differences} differences"


if __name__ == "__main__":
    main()
