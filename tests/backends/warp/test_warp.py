"""The engine `warp` meets the contract in single precision and moves as `mujoco` does, on a CPU.

Kernels are compiled once for each robot, which takes about a minute; so most tests are slow ones.
"""

from __future__ import annotations

import pytest

from backends.contract_suite import EngineContract
from cdcsr.robot.description import Robot, load_robot

pytest.importorskip("mujoco_warp", reason="the extra gpu is not installed")
pytest.importorskip("warp", reason="the extra gpu is not installed")


@pytest.mark.slow
class TestWarp(EngineContract):
    backend = "warp:device=cpu"
    copies = 4

    @pytest.fixture(params=["paper", "planar-single"])
    def robot(self, request: pytest.FixtureRequest) -> Robot:
        """Return a robot with a free base and one with a fixed base."""
        return load_robot(request.param)
