"""The largest stable time step, against the fastest mode of the assembled robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cdcsr.cli import run
from cdcsr.errors import CdcsrWarning, Diverged
from cdcsr.robot.description import load_robot, shipped_robots
from cdcsr.robot.stability import stable_step
from cdcsr.simulation.engines import backend_names, make_simulation
from tests.support.physics import with_parts
from training.commands.build_model import build_model


@pytest.mark.parametrize("name", shipped_robots())
def test_the_bound_is_safe_and_near_the_fastest_mode(name: str) -> None:
    """The modes are the eigenvalues of M^-1 K, straight and with every hinge at a limit or zero."""
    robot, random, num = load_robot(name), np.random.default_rng(0), 64
    simulation = make_simulation(robot, "mujoco", num)
    first = 6 + robot.num_cables
    limit = np.repeat([joint.limit for _, joint in robot.links], 2)
    position, velocity = simulation.get_snapshot().position, np.zeros((num, first + limit.size))
    position[1:, first + 1 :] = limit * random.choice([-1, 0, 1], (num - 1, limit.size))
    simulation.place(None, position, velocity)
    mass = simulation.dynamics().mass_matrix
    simulation.close()
    stiffness = np.zeros(velocity.shape[1])
    stiffness[6:first] = [servo.gain for servo in robot.servos]
    stiffness[first:] = np.repeat([joint.stiffness for _, joint in robot.links], 2)
    fastest = np.linalg.eigvals(np.linalg.solve(mass, np.diag(stiffness))).real.max()
    largest = 2 / np.sqrt(fastest)
    assert stable_step(robot) <= largest <= 4 * stable_step(robot)


@pytest.mark.parametrize("engine", [*backend_names(), "pybullet-stock:max_joint_speed=20"])
@pytest.mark.parametrize("limit", [0.1, 1.5])
def test_no_tip_passes_for_a_result_while_springs_shake(engine: str, limit: float) -> None:
    """Limits of hinges hide how far they shake, and Bullet's clamp how fast."""
    robot = with_parts(load_robot("paper"), joint={"stiffness": 2e4, "limit": limit})
    with pytest.warns(CdcsrWarning, match="Below that no spring shakes"):
        simulation = make_simulation(robot, engine)
    with pytest.raises(Diverged, match=r"springs are stable below a time_step of 0\.000"):
        simulation.step(np.tile([-5.0, 0.0], (1, 4)), 200)
    simulation.close()


def test_a_servo_can_be_too_stiff_for_the_step() -> None:
    """It shakes its slider alone where h sqrt(gain / mass) > 2, here above 0.00283 s."""
    stiff = with_parts(load_robot("paper"), servo={"gain": 1e5})
    with pytest.warns(CdcsrWarning, match=r"above 0\.00\d+ s"):
        make_simulation(stiff, "mujoco").close()
    make_simulation(stiff, "pybullet:substeps=20").close()


def test_a_command_warns_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = with_parts(load_robot("planar-single"), joint={"stiffness": 2e4, "limit": 0.1})
    path = tmp_path / "stiff.toml"
    path.write_text(robot.to_toml())
    assert run(build_model, "cdcsr build-model", [str(path), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr()
    assert shown.err.count("cdcsr: warning: The time_step of 'planar-single' is above") == 1
    assert len(shown.err.splitlines()) == 1
    assert shown.out.count("at the robot's own step, at which it diverges") == len(backend_names())
    stable = f"{stable_step(robot):.2g}"
    assert f"time step           0.0025 s; no spring shakes below {stable} s" in shown.out
