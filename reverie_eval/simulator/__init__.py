"""The Matterport3D simulator without its C++: ``MatterSim`` has its states and pictures.

``import MatterSim`` finds the same file if :data:`FOLDER` is on ``PYTHONPATH``.
"""

from pathlib import Path

from reverie_eval.simulator.on_path import MatterSim

FOLDER = Path(__file__).parent / "on_path"
"""The folder with ``MatterSim.py``, and nothing else that could be imported by mistake."""

__all__ = ["FOLDER", "MatterSim"]
