"""The MuJoCo engine: threads, shared arrays, divergence, active cables; physics is tested in every
engine."""

from __future__ import annotations

import copy
import dataclasses
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest

from backends.contract_suite.states import assert_same, commands_of, moving, running, straight
from backends.mujoco.active_cables import CURRENT, Cables
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.errors import Diverged
from cdcsr.robot.colors import TARGET
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.cameras import CAMERAS
from cdcsr.simulation.capstan import Capstan
from cdcsr.simulation.contract import Array
from cdcsr.simulation.plant import Parameters
from tests.support.physics import slack, with_parts


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in another folder, because MuJoCo writes its warnings to a file in the current one."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("threads", [1, 2])
def test_each_copy_moves_as_if_alone(paper: Robot, threads: int) -> None:
    commands = commands_of(paper, 60, num=9)
    batch = MujocoSimulation(paper, 9, threads=threads)
    for command in commands:
        batch.step(command, 2)
    together = batch.state()
    for index in (0, 4, 8):
        alone = MujocoSimulation(paper)
        for command in commands:
            alone.step(command[index : index + 1], 2)
        state = alone.state()
        for field in dataclasses.fields(together):
            found, expected = getattr(state, field.name)[0], getattr(together, field.name)[index]
            np.testing.assert_array_equal(found, expected)


def test_a_state_does_not_change_when_the_simulation_goes_on(paper: Robot) -> None:
    simulation = MujocoSimulation(paper)
    state = simulation.state()
    before = copy.deepcopy(state)
    simulation.step(commands_of(paper, 1)[0], 50)
    assert_same(state, before)


@pytest.mark.parametrize("engine", ["mujoco", "mujoco-stock"])
def test_copies_that_are_put_elsewhere_have_no_tension_yet(paper: Robot, engine: str) -> None:
    with running(paper, engine, 3) as simulation:
        simulation.step(np.full((3, paper.num_cables), -1.0), 20)
        pulled = simulation.state().cable_tension
        simulation.reset([0])
        snapshot = simulation.get_snapshot()
        simulation.place([2], snapshot.position[[1]], snapshot.velocity[[1]])
        tension = simulation.state().cable_tension
        assert (pulled > 1).all()
        assert not tension[[0, 2]].any()
        np.testing.assert_array_equal(tension[1], pulled[1])
        simulation.set_snapshot(dataclasses.replace(snapshot, engine="by hand"))
        assert not simulation.state().cable_tension.any()


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize("bad", [1e6, np.nan])
def test_divergence_names_copy_and_time(paper: Robot, bad: float) -> None:
    simulation = MujocoSimulation(paper, 4)
    command = np.zeros((4, paper.num_cables))
    simulation.step(command, 10)
    snapshot = simulation.get_snapshot()
    velocity = np.zeros_like(snapshot.velocity)
    velocity[2, 0] = bad
    simulation.set_snapshot(dataclasses.replace(snapshot, engine="by hand", velocity=velocity))
    with pytest.raises(Diverged, match=r"mujoco: copy 2 diverged at t = 0\.0275 s") as caught:
        simulation.step(command)
    assert (caught.value.copy, caught.value.time) == (2, pytest.approx(0.0275))


@pytest.mark.usefixtures("elsewhere")
def test_an_impossible_time_step_diverges(paper: Robot) -> None:
    coarse = paper.model_dump() | {"time_step": 0.1, "constraint": {"recovery_time": 0.2}}
    simulation = MujocoSimulation(Robot.model_validate(coarse))
    with pytest.raises(Diverged, match="smaller time_step"):
        simulation.step(commands_of(paper, 1)[0], 2000)


@pytest.mark.parametrize("friction", [0.0, 0.2])
@pytest.mark.parametrize("guess", [0.0, 1.0])
def test_the_active_cables_do_not_depend_on_the_first_guess(
    paper: Robot, guess: float, friction: float
) -> None:
    """Slack, taut and too long cables: tensions and motion are the same if the first guess is that
    all pull or that none does. So is the friction in guides, whose bounds follow from the tensions
    of the step before and not from those of a wrong guess."""
    robot = with_parts(paper, cables={"guide_friction": friction})
    start, command = moving(robot, 6), commands_of(robot, 1, num=6)[0]
    simulations = MujocoSimulation(robot, 6), MujocoSimulation(robot, 6)
    for simulation in simulations:
        simulation.set_snapshot(start)
    for _ in range(20):
        simulations[1].batch.bind("eq_active")[:] = guess
        simulations[1].batch.forward(stage=CURRENT)
        for simulation in simulations:
            simulation.step(command)
    one, other = (simulation.state() for simulation in simulations)
    assert (one.cable_tension > 1).any()
    assert (one.cable_tension == 0).any()
    assert_same(one, other, rtol=1e-3, atol=1e-3)


def test_an_excess_is_taken_back_with_the_recovery_time(paper: Robot) -> None:
    """A cable begins 2 mm too long. The first step takes back the share h / recovery time. The
    motion that this starts goes on, so later steps take back at least as large a share."""
    start = straight(paper)
    start.position[0, 7] = -2e-3
    simulation = MujocoSimulation(paper)
    simulation.set_snapshot(start)
    keep, excess = 1 - paper.time_step / paper.constraint.recovery_time, [2e-3]
    for _ in range(8):
        simulation.step(np.zeros((1, paper.num_cables)))
        excess.append(-slack(paper, simulation)[0, 0])
    assert excess[1] == pytest.approx(keep * 2e-3, rel=1e-3)
    for before, after in pairwise(excess):
        assert after < max(keep * before, 0) + 6e-6


def test_a_cable_that_stays_taut_gives_back_the_same_share_in_every_step(paper: Robot) -> None:
    """It begins 2 mm too long, and its servo pulls."""
    start, command = straight(paper), np.zeros((1, paper.num_cables))
    start.position[0, 7], command[0, 0] = -2e-3, -1.0
    simulation = MujocoSimulation(paper)
    simulation.set_snapshot(start)
    keep, excess = 1 - paper.time_step / paper.constraint.recovery_time, []
    for _ in range(6):
        simulation.step(command)
        excess.append(-slack(paper, simulation)[0, 0])
    np.testing.assert_allclose(excess, 2e-3 * keep ** np.arange(1, 7), rtol=0, atol=1e-6)


def test_cables_that_would_change_in_a_circle_are_changed_one_by_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The robot's matrix is replaced by a positive definite one of three cables for which changing
    all wrong ones at once comes back to where it was. The end solves 0 <= t, 0 <= w = M t + q,
    t w = 0. The other copy's cables are slack."""
    robot = load_robot("planar-single")
    cables, step = MujocoSimulation(robot, 2)._cables, robot.time_step
    assert isinstance(cables, Cables)
    assert cables.friction is None  # which no cable has
    matrix, q = np.eye(4), np.array([[1, 1, 1, 1.0], [-4, 3, 1, 1]])
    matrix[:3, :3] = [[12, -10, -8], [-10, 13, 13], [-8, 13, 14]]
    held, rest = np.zeros((2, 4)), np.ones((2, 4))
    length = rest.copy()
    seen: list[list[int]] = []

    def advance(_: Array, ids: Array | None = None) -> Array:
        force = np.zeros((2, 4))
        for copy_, on in enumerate(map(np.flatnonzero, held)):
            force[copy_, on] = np.linalg.solve(matrix[np.ix_(on, on)], -q[copy_, on])
        length[:] = rest - step * (force @ matrix + q)
        seen.append([0, 1] if ids is None else list(ids))
        return force

    for name, value in {"_held": held, "_length": length, "_advance": advance}.items():
        monkeypatch.setattr(cables, name, value)
    monkeypatch.setattr(cables, "_aim", lambda: rest)
    cables.step()
    short = cables.tension @ matrix + q
    assert not cables.tension[0].any()
    assert short.min() > -1e-9
    np.testing.assert_allclose(cables.tension * short, 0, atol=1e-9)
    assert seen[0] == [0, 1]
    assert len(seen) > 5
    assert all(ids == [1] for ids in seen[1:])


def test_a_copy_that_becomes_smooth_or_is_reset_forgets_its_friction(paper: Robot) -> None:
    robot = with_parts(paper, cables={"guide_friction": 0.2})
    simulation, places = MujocoSimulation(robot, 2), len(Capstan(robot).cable)
    for command in commands_of(robot, 20, 2):
        simulation.step(command)
    before = simulation.get_snapshot().private[:, -places:]
    simulation.set_parameters([0], Parameters(guide_friction=-0.2))
    after = simulation.get_snapshot().private[:, -places:]
    assert before.max() > 0.01
    assert not after[0].any()
    np.testing.assert_array_equal(after[1], before[1])
    simulation.reset([1])
    assert not simulation.get_snapshot().private[:, -places:].any()


def test_a_few_copies_are_stepped_by_one_thread(
    paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("backends.mujoco.simulation.processors", lambda: 3)
    threads = [MujocoSimulation(paper, num).batch.nthread for num in (7, 8, 9)]
    assert threads == [1, 3, 3]
    assert MujocoSimulation(paper, 8, threads=2).batch.nthread == 2


def test_a_copy_in_plain_data_goes_on_as_in_the_batch(paper: Robot) -> None:
    """Out to MuJoCo's own data and back, of one copy of three, with a force that acts on it."""
    batch, commands = MujocoSimulation(paper, 3), commands_of(paper, 20, 3)
    for command in commands[:10]:
        batch.step(command)
    data = mujoco.MjData(batch.model)
    batch.write_to(data, 1)
    np.testing.assert_array_equal(data.qpos, batch.get_snapshot().position[1])
    assert data.time == pytest.approx(10 * paper.time_step)
    other = MujocoSimulation(paper, 2)
    data.xfrc_applied[-1, 0] = 3.0
    other.read_from(data, 1)
    np.testing.assert_array_equal(other.state().tip_position[1], batch.state().tip_position[1])
    batch.set_loads([1], -1, force=(3.0, 0.0, 0.0))
    for command in commands[10:]:
        batch.step(command)
        other.step(command[[0, 1]])
    np.testing.assert_allclose(
        other.state().tip_position[1], batch.state().tip_position[1], rtol=0, atol=1e-9
    )


def test_loads_on_inner_links_are_those_of_plain_mechanics(paper: Robot) -> None:
    """MuJoCo's generalized force against sums over links in NumPy, of turned and bent robots, with
    two loads on one link."""
    simulation, start = MujocoSimulation(paper, 3), moving(paper, 3)
    simulation.set_snapshot(start)
    before = simulation.dynamics().passive_force
    simulation.set_loads([1, 2], 4, (3.0, -2.0, 1.0), point=(0.02, -0.03, 0.05))
    simulation.set_loads([1], 4, torque=(0.5, 0.1, -0.7), slot=1)
    simulation.set_loads([0], 0, (0.0, 4.0, 0.0))
    found = simulation.dynamics().passive_force - before
    expected = simulation.loads.generalized(start.position, np.arange(3))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert (np.abs(expected).max(axis=1) > 1).all()


def test_pictures_without_a_display_fail_in_one_line_as_often_as_they_are_asked_for() -> None:
    # A second start of OpenGL would end the process.
    code = (
        "from cdcsr.errors import CdcsrError\n"
        "from cdcsr.robot.description import load_robot\n"
        "from cdcsr.simulation.engines import make_simulation\n"
        "for _ in range(2):\n"
        "    simulation = make_simulation(load_robot('paper'), 'mujoco')\n"
        "    try: simulation.render(0)\n"
        "    except CdcsrError as error: print(error)\n"
    )
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        env=env | {"MUJOCO_GL": "glfw"},
        capture_output=True,
        text=True,
        check=True,
    )
    first, second = done.stdout.splitlines()
    assert first == second
    assert first.startswith("MuJoCo cannot draw here: it found no OpenGL (set MUJOCO_GL to egl")


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_picture_shows_the_posed_arm_and_the_target(
    camera: str, paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Checked in MuJoCo's own scene, which needs no display: azimuth 0 and elevation 0 look along
    +y, and the straight robot of 2.7 m above its middle height fills most of the picture."""
    simulation, target = MujocoSimulation(paper, 2), np.array([0.3, -0.2, 1.7])

    class Scene:
        def __init__(self, model: mujoco.MjModel) -> None:
            self.model, self.scene = model, mujoco.MjvScene(model, 1000)

        def update_scene(self, data: mujoco.MjData, view: mujoco.MjvCamera) -> None:
            every, options = int(mujoco.mjtCatBit.mjCAT_ALL), mujoco.MjvOption()
            mujoco.mjv_updateScene(self.model, data, options, None, view, every, self.scene)

        def render(self) -> Array:
            return np.array([[*g.pos, g.size[0], *g.rgba] for g in self._geoms()])

        def _geoms(self) -> list[mujoco.MjvGeom]:
            return list(self.scene.geoms[: self.scene.ngeom])

        def close(self) -> None: ...

    monkeypatch.setattr("backends.mujoco.simulation._make_renderer", Scene)
    simulation.set_snapshot(moving(paper, 2))
    drawn = simulation.render(1, camera, target)
    renderer, tip = simulation._renderer, simulation.state().tip_position[1]
    assert isinstance(renderer, Scene)
    assert len(simulation.render(1, camera)) == len(drawn) - 1
    simulation.close()
    color = np.divide(TARGET, 255)
    np.testing.assert_allclose(drawn[-1], [*target, 0.018, *color], rtol=0, atol=1e-6)
    assert np.linalg.norm(drawn[:-1, :3] - tip, axis=1).min() < 0.11  # the middle of the last link
    eye, gaze = renderer.scene.camera[0], np.deg2rad(CAMERAS[camera])
    ahead = np.array([-np.sin(gaze[0]), np.cos(gaze[0])]) * np.cos(gaze[1])
    np.testing.assert_allclose(eye.forward, [*ahead, np.sin(gaze[1])], atol=1e-6)
    away = np.array([0, 0, 1.35]) - eye.pos
    np.testing.assert_allclose(np.cross(away, eye.forward), 0, atol=0.05)
    half = np.linalg.norm(away) * eye.frustum_top / eye.frustum_near
    assert 0.6 < 1.5 / half < 0.9
