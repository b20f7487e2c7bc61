"""The largest stable time step, against the fastest mode of the assembled robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cdcsr.cli import run
from cdcsr.errors import CdcsrWarning, Diverged
from cdcsr.robot.description import Robot, load_robot, shipped_robots
from cdcsr.robot.stability import highest_speeds, stable_step, too_fast
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


def test_the_bound_of_one_joint_by_hand() -> None:
    """A base and a link of unequal moments on a spring, and each kind of spring the stiffest."""
    mass, inertia = 1.0, (0.0205, 0.02, 0.001)
    weak = {"stiffness": 0.0, "damping": 0.0, "limit": 0.1}
    servo = {"mass": 0.25, "damping": 1.0, "gain": 1e-9, "eta": 1.0, "radius": 0.01, "offset": 0.1}

    def made(joint: dict[str, object], **changes: object) -> Robot:
        robot = load_robot("planar-single").model_dump()
        link = {"length": 0.2, "radius": 0.02, "mass": mass, "inertia": inertia}
        (segment,) = robot["segments"]
        segment |= {"links": 1, "link": link, "joint": weak | joint, "servo": {**servo, **changes}}
        robot["base"] |= {"inertia": (0.06, 0.05, 0.08), "mass": 1.0, "size": (0.4, 0.4, 0.4)}
        return Robot.model_validate(robot)

    def least(body: tuple[float, float, float], axis: int) -> float:
        """Return the least moment about an axis that is tilted by up to 0.1 rad towards z."""
        return min(body[axis], body[axis] * np.cos(0.1) ** 2 + body[2] * np.sin(0.1) ** 2)

    base = (0.06, 0.05, 0.08)
    moments = max(sum(1 / least(body, axis) for body in (base, inertia)) for axis in (0, 1))
    bent = made({"stiffness": 7.0})
    assert stable_step(bent) == pytest.approx(2 / np.sqrt(4 * 7 * moments), rel=1e-6)
    torsion = {"stiffness": 3.0, "damping": 0.0, "limit": 0.1}
    twisted = made({"torsion": torsion})
    expected = 2 / np.sqrt(4 * 3 * (1 / 0.08 + 1 / 0.001))
    assert stable_step(twisted) == pytest.approx(expected, rel=1e-6)
    pulled = made({}, gain=900.0)  # each of the four cables, 0.02 m aside, is a spring
    across = 4 * (4 * 900 * 0.02**2) * moments
    assert stable_step(pulled) == pytest.approx(2 / np.sqrt(max(across, 900 / 0.25)), rel=1e-6)
    light = made({}, gain=1.0, mass=0.3)
    assert stable_step(light) == pytest.approx(2 / np.sqrt(1 / 0.3), rel=1e-6)
    fixed = bent.base.model_copy(update={"mount": "fixed"})
    alone = max(1 / least(inertia, axis) for axis in (0, 1))
    held = stable_step(bent.model_copy(update={"base": fixed}))
    assert held == pytest.approx(2 / np.sqrt(4 * 7 * alone), rel=1e-6)


def test_speeds_that_no_step_can_follow() -> None:
    """In one step of 2.5 ms: the arm's 2.4 m, half a radian, and less between narrow limits."""
    robot = load_robot("paper")
    highest = highest_speeds(robot)
    assert highest[:3].tolist() == [2.4 / 0.0025] * 3
    assert highest[3:6].tolist() == [0.5 / 0.0025] * 3
    assert highest[6:14].tolist() == [2.4 / 0.0025] * 8
    assert highest[14:].tolist() == [0.5 / 0.0025] * 24
    narrow = highest_speeds(with_parts(robot, joint={"limit": 0.1}))
    assert narrow[14:].tolist() == [0.2 / 0.0025] * 24
    speeds = np.zeros(len(highest))
    speeds[2], speeds[20] = 950.0, -300.0  # 0.99 and 1.5 of what is possible
    text = too_fast(speeds, highest)
    assert text == "coordinate 20 moves at 300, more than 200"
    speeds[0] = np.nan
    assert too_fast(speeds, highest) == "velocities are no longer finite"


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
