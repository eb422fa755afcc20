"""Every number of ``MatterSim`` is that of the original simulator, which was recorded."""

import gzip
import json
import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.published import simulator_folder
from reverie_eval.simulator import MatterSim
from tests.conftest import unavailable
from tests.support.amounts import is_evidence
from tests.support.buildings import forget_buildings

EACH_IN_SUITE = 20
"""The suite stands at one of so many viewpoints."""


@pytest.fixture
def recorded() -> Path:
    folder = simulator_folder()
    if folder is None:
        unavailable("what the original simulator gave is not here")
    return folder


@pytest.fixture
def connectivity(published: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the published graphs, for simulators that keep nothing for later ones."""
    monkeypatch.setenv("MATTERSIM_CACHE", str(tmp_path))
    forget_buildings(monkeypatch)
    return published / "reverie-v1" / "connectivity"


@pytest.mark.dataset
def test_walks_are_those_that_were_recorded(recorded: Path, connectivity: Path) -> None:
    with gzip.open(recorded / "recorded.json.gz") as file:
        walks = json.load(file)
    for walk in walks["episodes"]:
        simulator = configured(walks["configs"][walk["config"]], connectivity)
        simulator.newEpisode(*(walk[name] for name in ("scanId", "viewpointId", *ANGLES)))
        states = [list(map(described, simulator.getState()))]
        for action in walk["actions"]:
            simulator.makeAction(*action)
            states.append(list(map(described, simulator.getState())))
        assert states == walk["states"]


@pytest.mark.dataset
def test_all_views_from_all_viewpoints_are_those_that_were_recorded(
    recorded: Path, connectivity: Path
) -> None:
    with np.load(recorded / "all_states.npz") as packed:
        expected = {name: packed[name] for name in packed}
    scans, offset = expected["scans"].tolist(), expected["offset"]
    simulator = configured(VIEWS, connectivity)
    first = np.flatnonzero(expected["view"] == 0)[:: 1 if is_evidence() else EACH_IN_SUITE]
    for start in first.tolist():
        scan = scans[expected["scan"][start]]
        names = viewpoints(connectivity, scan)
        simulator.newEpisode([scan], [names[expected["ix"][start]]], [0], [math.radians(-30)])
        entries = []
        for view in range(36):
            if view:
                simulator.makeAction([0], [1.0], [float(view % 12 == 0)])
            (state,) = simulator.getState()
            assert state.viewIndex == view
            assert len(state.navigableLocations) == offset[start + view + 1] - offset[start + view]
            entries += [
                (each.ix, each.rel_heading, each.rel_elevation, each.rel_distance)
                for each in state.navigableLocations
            ]
        here = slice(offset[start], offset[start + 36])
        columns = ("nav_ix", "rel_heading", "rel_elevation", "rel_distance")
        wanted = zip(*(expected[name][here].tolist() for name in columns), strict=True)
        assert entries == list(wanted)


ANGLES = ("heading", "elevation")
VIEWS = {
    "discretizedViewingAngles": True,
    "restrictedNavigation": True,
    "width": 640,
    "height": 480,
    "vfov": math.radians(60),
    "batch": 1,
    "limits": None,
}


def configured(config: Mapping[str, Any], connectivity: Path) -> MatterSim.Simulator:
    simulator = MatterSim.Simulator()
    simulator.setNavGraphPath(str(connectivity))
    simulator.setRenderingEnabled(False)
    simulator.setDiscretizedViewingAngles(config["discretizedViewingAngles"])
    simulator.setRestrictedNavigation(config["restrictedNavigation"])
    simulator.setCameraResolution(config["width"], config["height"])
    simulator.setCameraVFOV(config["vfov"])
    simulator.setBatchSize(config["batch"])
    assert config["limits"] is None or simulator.setElevationLimits(*config["limits"])
    simulator.initialize()
    return simulator


def described(state: MatterSim.SimState) -> Mapping[str, Any]:
    here = state.location
    return {
        "scanId": state.scanId,
        "step": state.step,
        "viewpointId": here.viewpointId,
        "ix": here.ix,
        "x": here.x,
        "y": here.y,
        "z": here.z,
        "rel": [here.rel_heading, here.rel_elevation, here.rel_distance],
        "heading": state.heading,
        "elevation": state.elevation,
        "viewIndex": state.viewIndex,
        "navigable": [
            [v.viewpointId, v.ix, v.x, v.y, v.z, v.rel_heading, v.rel_elevation, v.rel_distance]
            for v in state.navigableLocations
        ],
    }


@lru_cache(maxsize=1)
def viewpoints(connectivity: Path, scan: str) -> list[str]:
    content = (connectivity / f"{scan}_connectivity.json").read_bytes()
    return [each["image_id"] for each in json.loads(content)]
