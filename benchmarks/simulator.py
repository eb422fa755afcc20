"""How long ``MatterSim`` takes for a state, and to read the buildings.

``python benchmarks/simulator.py`` sweeps the 36 views of every tenth viewpoint of the 90 published
buildings, as training code does, and reads every attribute that such code reads. The original took
0.13 ms a state on another machine, where it took 9.9 s to read the buildings. They are read twice
here: from the connectivity files, and from the tables that were kept of them.
Needs the published files (see ``fixtures/published.py``).
"""

import math
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.published import published_folder, unpack_dataset
from reverie_eval.simulator import MatterSim

EACH = 10
"""One of so many viewpoints is swept."""
ORIGINAL = 130
"""Microseconds a state."""
BAR = 1.0
FIRST, LATER = 2.5, 0.05
"""Seconds to read all buildings, at most."""


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
    microseconds = 1e6 * seconds / states
    print(f"a state: {microseconds:.1f} us of {states:,}, where the original took {ORIGINAL}")
    print(f"the {len(scans)} buildings: {times[0]:.2f} s at first, {1000 * times[1]:.0f} ms later")
    is_slow = microseconds > BAR * ORIGINAL or times[0] > FIRST or times[1] > LATER
    return int(is_slow)


def simulator(graphs: Path) -> MatterSim.Simulator:
    """Return a simulator as training code sets it up."""
    sim = MatterSim.Simulator()
    sim.setNavGraphPath(str(graphs))
    sim.setRenderingEnabled(False)
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


def look(sim: MatterSim.Simulator) -> None:
    """Read what training code reads of a state."""
    (state,) = sim.getState()
    _ = state.viewIndex, state.heading, state.elevation, state.scanId, state.location.viewpointId
    for each in state.navigableLocations[1:]:
        _ = each.viewpointId, each.rel_heading, each.rel_elevation, each.rel_distance
        _ = each.x, each.y, each.z


if __name__ == "__main__":
    sys.exit(main())
