"""Skyboxes of noise, for the demo world."""

from pathlib import Path

import numpy as np
from PIL import Image

from reverie_eval import GroundTruth


def write_skybox(folder: Path, truth: GroundTruth) -> Path:
    """Write the skybox of the viewpoint at which the first episode begins; return the folder."""
    graph, here = truth.graph, int(truth.episodes.start[0])
    skyboxes = folder / graph.scan_of(here) / "matterport_skybox_images"
    skyboxes.mkdir(parents=True)
    noise = np.random.default_rng(0).integers(0, 256, (16, 96, 3), np.uint8)
    Image.fromarray(noise).save(skyboxes / f"{graph.viewpoint_ids[here]}_skybox_small.jpg")
    return folder
