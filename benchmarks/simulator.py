"""How long ``MatterSim`` takes for a state, for a picture, and to read the buildings.

``python benchmarks/simulator.py`` sweeps the 36 views of every tenth viewpoint of the 90 published
buildings, as training code does, and reads every attribute that such code reads. The original took
0.13 ms a state on another machine, where it took 9.9 s to read the buildings. They are read twice
here: from the connectivity files, and from the tables that were kept of them. Pictures are
rendered from a skybox of noise. The Random agent walks val_unseen in an ``Environment``.
Needs the published files (see ``fixtures/published.py``).
"""

import math
import os
import statistics
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.published import published_folder, unpack_dataset
from reverie_eval import GroundTruth
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.runner import run_agent
from reverie_eval.simulator import MatterSim

EACH = 10
"""One of so many viewpoints is swept."""
ORIGINAL = 130
"""Microseconds a state."""
BAR = 1.0
FIRST, LATER = 2.5, 0.05
"""Seconds to read all buildings, at most."""
PICTURE = 50
"""Milliseconds of the processor for one of 640 x 480 pixels, at most."""
FACE = 512
"""Pixels of a side of the skybox, as the original's script makes them."""


def main() -> int:
    """Print every figure; exit with 1 if one misses its bar."""
    folder = published_folder()
    if folder is None:
        print("the published REVERIE files are not here (REVERIE_DATA names their folder)")
        return 2
    with TemporaryDirectory() as temporary:
        os.environ["MATTERSIM_CACHE"] = str(Path(temporary, "cache"))
        graphs = unpack_dataset(folder, Path(temporary)) / "connectivity"
        scans = (graphs / "scans.txt").read_text().split()
        times = [read(graphs, scans) for _ in range(2)]
        states, seconds = sweep(graphs, scans)
        milliseconds = picture(graphs, scans[0], Path(temporary))
        walked, walking = walk(Path(temporary, "reverie-v1"))
    microseconds = 1e6 * seconds / states
    print(f"a state: {microseconds:.1f} us of {states:,}, where the original took {ORIGINAL}")
    print(f"the {len(scans)} buildings: {times[0]:.2f} s at first, {1000 * times[1]:.0f} ms later")
    print(f"a step in an environment: {1e6 * walking / walked:.1f} us of {walked:,}")
    print(f"a picture: {milliseconds:.0f} ms of a processor, at most {PICTURE}")
    is_slow = (
        milliseconds > PICTURE
        or microseconds > BAR * ORIGINAL
        or times[0] > FIRST
        or times[1] > LATER
    )
    return int(is_slow)


def simulator(graphs: Path, skyboxes: Path | None = None) -> MatterSim.Simulator:
    """Return a simulator as training code sets it up; it renders if there are skyboxes."""
    sim = MatterSim.Simulator()
    sim.setNavGraphPath(str(graphs))
    sim.setDatasetPath(str(skyboxes))
    sim.setRenderingEnabled(skyboxes is not None)
    sim.setDiscretizedViewingAngles(True)
    sim.setCameraResolution(640, 480)
    sim.setCameraVFOV(math.radians(60))
    sim.initialize()
    return sim


def read(graphs: Path, scans: list[str]) -> float:
    """Return the seconds that it takes to read all buildings."""
    MatterSim._BUILDINGS.clear()
    began = time.perf_counter()
    for scan in scans:
        MatterSim._building(f"{graphs}/{scan}_connectivity.json")
    return time.perf_counter() - began


def sweep(graphs: Path, scans: list[str]) -> tuple[int, float]:
    """Return the number of states that were looked at, and the seconds for all of them."""
    sim = simulator(graphs)
    names = {
        scan: [
            name
            for name, included in zip(building._ids, building._included, strict=True)
            if included
        ][::EACH]
        for scan in scans
        for building in [MatterSim._building(f"{graphs}/{scan}_connectivity.json")]
    }
    states = 0
    began = time.perf_counter()
    for scan in scans:
        for name in names[scan]:
            sim.newEpisode([scan], [name], [0], [math.radians(-30)])
            for view in range(36):
                if view:
                    sim.makeAction([0], [1.0], [float(view % 12 == 0)])
                look(sim)
            states += 36
    return states, time.perf_counter() - began


def walk(dataset: Path) -> tuple[int, float]:
    """Return the steps that the Random agent takes through val_unseen, and the seconds for them."""
    truth = GroundTruth.from_bundle(
        compile_split(DatasetFiles.find(dataset, split="val_unseen"), "val_unseen")
    )
    began = time.perf_counter()
    records = run_agent("random", truth)
    seconds = time.perf_counter() - began
    return sum(len(record["trajectory"]) for record in records), seconds


def picture(graphs: Path, scan: str, folder: Path) -> float:
    """Return the median of the milliseconds of the processor that a picture takes."""
    (viewpoint, *_) = MatterSim._building(f"{graphs}/{scan}_connectivity.json")._ids
    skyboxes = folder / scan / "matterport_skybox_images"
    skyboxes.mkdir(parents=True)
    noise = np.random.default_rng(0).integers(0, 256, (FACE, 6 * FACE, 3), np.uint8)
    Image.fromarray(noise).save(skyboxes / f"{viewpoint}_skybox_small.jpg")
    sim = simulator(graphs, folder)
    sim.newEpisode([scan], [viewpoint], [0], [math.radians(-30)])
    times = []
    for view in range(1, 36):
        began = time.process_time()
        sim.makeAction([0], [1.0], [float(view % 12 == 0)])
        times.append(1000 * (time.process_time() - began))
    return statistics.median(times)


def look(sim: MatterSim.Simulator) -> None:
    """Read what training code reads of a state."""
    (state,) = sim.getState()
    _ = state.viewIndex, state.heading, state.elevation, state.scanId, state.location.viewpointId
    for each in state.navigableLocations[1:]:
        _ = each.viewpointId, each.rel_heading, each.rel_elevation, each.rel_distance
        _ = each.x, each.y, each.z


if __name__ == "__main__":
    sys.exit(main())
