"""Simulators that know no buildings yet, as in a new process."""

import pytest

from reverie_eval.simulator import MatterSim


def forget_buildings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget all buildings that simulators of this process have read, and the first folder."""
    monkeypatch.setattr(MatterSim, "_BUILDINGS", {})
    monkeypatch.setattr(MatterSim._Buildings, "_first", None)  # noqa: SLF001
