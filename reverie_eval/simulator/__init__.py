"""The simulator without its C++: ``MatterSim`` for code of today, ``Environment`` for new code.

``MatterSim`` has the states and pictures of the Matterport3D simulator; ``import MatterSim`` finds
the same file if :data:`FOLDER` is on ``PYTHONPATH``. An :class:`Environment` has the episodes of a
split, and writes the submission.
"""

from pathlib import Path

from reverie_eval.errors import ActionError
from reverie_eval.simulator._environment import Environment
from reverie_eval.simulator._observation import (
    Action,
    Answer,
    AnswerBox,
    Box,
    Candidate,
    Go,
    Neighbour,
    Observation,
    Part,
    Point,
    Stop,
    Turn,
    colours_of_skybox,
    jpeg_url,
)
from reverie_eval.simulator.on_path import MatterSim

FOLDER = Path(__file__).parent / "on_path"
"""The folder with ``MatterSim.py``, and nothing else that could be imported by mistake."""

__all__ = [
    "FOLDER",
    "Action",
    "ActionError",
    "Answer",
    "AnswerBox",
    "Box",
    "Candidate",
    "Environment",
    "Go",
    "MatterSim",
    "Neighbour",
    "Observation",
    "Part",
    "Point",
    "Stop",
    "Turn",
    "colours_of_skybox",
    "jpeg_url",
]
