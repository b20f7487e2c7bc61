"""The PyBullet engine: limits, divergence and worker processes; physics is tested in every
engine."""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import os
import pickle
import signal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backends.contract_suite.states import assert_same, commands_of, random_parameters, straight
from backends.pybullet.benchmarks import step_cost
from backends.pybullet.cables import joint_forces
from backends.pybullet.dampers import stiff_dampers
from backends.pybullet.equation import Equation
from backends.pybullet.options import PybulletOptions, PybulletStockOptions
from backends.pybullet.rig import of_copy, rig
from backends.pybullet.simulation import PybulletSimulation, PybulletStock
from backends.pybullet.workers import Pool
from backends.pybullet.world import World
from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Snapshot
from cdcsr.simulation.plant import Parameters
from tests.support.physics import changed, finer, momentum


def test_hinge_limit_stops_the_arm(paper: Robot) -> None:
    segments = [s | {"joint": s["joint"] | {"limit": 0.05}} for s in paper.model_dump()["segments"]]
    reach = []
    for robot in (paper, changed(paper, segments=segments)):
        simulation = PybulletSimulation(robot)
        command = np.zeros((1, robot.num_cables))
        command[0, 0] = -5
        simulation.step(command, 80)
        reach.append(np.abs(simulation.state().joint_angles).max())
        simulation.close()
    assert reach[0] > 0.1
    # Bullet notices a limit only once it is passed, so by up to a step at about 1 rad/s.
    assert reach[1] == pytest.approx(0.05, abs=1.0 * paper.time_step)
    assert reach[1] > 0.049


@pytest.mark.parametrize(
    "command",
    [(-2.0, -1.0, -0.5, -3.0, -1.0, -1.0, -2.0, 0.0), (-5.0, 0.0, 0.0, 0.0, -5.0, 0.0, 0.0, 0.0)],
)
def test_a_curled_arm_does_not_shake(paper: Robot, command: tuple[float, ...]) -> None:
    """Links bent by nearly a right angle turn about their thin axes, where an explicit damper would
    grow by 1.6 in a step; held commands end in rest."""
    simulation = PybulletSimulation(paper)
    simulation.step(np.array([command]), 1700)
    state = simulation.state()
    simulation.close()
    assert np.abs(state.joint_angles).max() > 1.4
    assert np.abs(state.joint_rates).max() < 1.5


@pytest.mark.parametrize("damping", [0.04, 0.4])
def test_bullets_damping_takes_momentum_at_its_rate(paper: Robot, damping: float) -> None:
    """Bodies of mass m and moment I are slowed by d (1 + |v|) m v and d (1 + |w|) I w, so both
    momenta of a slow robot fall as exp(-d t)."""
    simulation = PybulletStock(paper, options=PybulletStockOptions(damping=damping))
    start = straight(paper, travel=0.05)
    start.velocity[0, :6] = [2e-4, 1e-4, -3e-4, 1e-4, 2e-4, -1e-4]
    simulation.set_snapshot(start)
    linear, angular, _ = momentum(simulation)
    simulation.step(np.full((1, paper.num_cables), 0.05), 400)
    now, turning, _ = momentum(simulation)
    simulation.close()
    left = np.exp(-damping * 400 * paper.time_step)
    np.testing.assert_allclose(now, left * linear, atol=1e-3 * float(np.abs(linear).max()))
    np.testing.assert_allclose(turning, left * angular, atol=1e-3 * float(np.abs(angular).max()))


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, -0.48, 0.64)])
def test_the_sign_of_a_quaternion_does_not_jump(paper: Robot, axis: tuple[float, ...]) -> None:
    """Bullet's is arbitrary; ours is that of the state before, all the way around twice."""
    simulation = PybulletSimulation(paper)
    snapshot = simulation.get_snapshot()
    for angle in np.arange(0.0, 4 * np.pi, 0.3):
        given = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * np.array(axis))])
        snapshot.position[0, 3:7] = given
        simulation.set_snapshot(snapshot)
        np.testing.assert_allclose(simulation.state().base_quaternion[0], given, atol=1e-12)
    simulation.close()


def test_linkages_that_are_apart_are_together_after_a_step() -> None:
    robot = load_robot("paper-coupled")
    simulation = PybulletSimulation(robot)
    snapshot, random = simulation.get_snapshot(), np.random.default_rng(0)
    snapshot.position[0, -24:] = 0.1 + random.uniform(-1e-3, 1e-3, 24)
    snapshot.velocity[0, -24:] = random.uniform(-0.1, 0.1, 24)
    simulation.set_snapshot(snapshot)
    simulation.step(np.zeros((1, 8)))
    angles = simulation.state().joint_angles[0]
    simulation.close()
    np.testing.assert_allclose(angles, angles[list(robot.leaders)], rtol=0, atol=1e-12)
    assert len(set(angles.round(6))) == 4  # two segments, each about two axes


def test_no_explicit_damper_is_unstable(robot: Robot) -> None:
    """Explicit dampers shrink speeds by the eigenvalues of h (M + h D)^-1 C, where D holds the
    implicit ones; above 2 they would grow. Without D this reaches 14."""
    random, equation, numbers = np.random.default_rng(0), Equation(robot), rig(robot)
    plant, sliders = Parameters().plant(robot, 1), robot.num_cables
    damping, step = np.diag(np.r_[np.zeros(6), plant.damping[0]]), robot.time_step
    still, worst, unstable = np.zeros(robot.num_coordinates), 0.0, 0.0
    for trial in range(60):
        side = random.choice([-1, 0, 1], robot.num_hinges)
        bend = side if trial % 2 else random.uniform(-1, 1, robot.num_hinges)
        position = np.r_[np.zeros(3), 1.0, np.zeros(3 + sliders), bend * numbers.upper[sliders:]]
        mass = equation.dynamics(position[None], still[None], plant).mass_matrix[0]
        stiff = stiff_dampers(numbers, position[7 + sliders :], step)
        heavy = mass + step * np.diag(np.r_[np.zeros(6), stiff])
        shrink = np.linalg.eigvals(step * np.linalg.solve(heavy, damping)).real.max()
        worst = max(worst, float(shrink))
        whole = np.linalg.eigvals(step * np.linalg.solve(mass, damping)).real.max()
        unstable = max(unstable, float(whole))
    equation.close()
    assert unstable > 2
    assert worst < 2


def test_a_damper_is_implicit_where_it_would_turn_two_bodies_too_fast(paper: Robot) -> None:
    """That is where h c (1 / I + 1 / J) is above 1/2, with the moments of the two bodies about the
    axis a as it stands in each, a' I a; and of a slider where h c / m is."""
    random, numbers, step = np.random.default_rng(0), rig(paper), paper.time_step
    plant, implicit = Parameters().plant(paper, 2), 0
    for _ in range(30):
        plant.link_inertia[1] = random.uniform(0.01, 0.02, (12, 3))
        plant.base_inertia[1] = random.uniform(0.01, 0.02, 3)
        plant.damping[1] = random.uniform(0, 2, 32)
        plant.damping[1, :8] *= numbers.slider_mass / step / 2
        bend = random.uniform(-1.5, 1.5, 24)
        moments = np.concatenate([plant.base_inertia[1:], plant.link_inertia[1]])
        shake = step * plant.damping[1, :8] / numbers.slider_mass
        expected = (shake > 0.5).tolist()
        for j, (x, y) in enumerate(bend.reshape(-1, 2)):
            turn = Rotation.from_euler("XY", [x, y]).as_matrix()
            lower, upper = np.diag(moments[j]), np.diag(moments[j + 1])
            about_x, about_y = np.eye(3)[0], turn @ np.eye(3)[1]  # in the frame of the lower body
            for axis, c in zip((about_x, about_y), plant.damping[1, 8 + 2 * j :], strict=False):
                inner = turn.T @ axis
                shake = step * c * (1 / (axis @ lower @ axis) + 1 / (inner @ upper @ inner))
                expected.append(shake > 0.5)
        found = stiff_dampers(of_copy(numbers, plant, 1), bend, step)
        np.testing.assert_array_equal(found, np.where(expected, plant.damping[1], 0.0))
        finer = stiff_dampers(of_copy(numbers, plant, 1), bend, step / 8)
        np.testing.assert_array_equal(finer, found)  # or the motion would not converge
        implicit += np.count_nonzero(found)
    assert 0.3 < implicit / 30 / 32 < 0.9
    twisting = of_copy(numbers, plant, 1)._replace(universal=False)  # links may be thin rods
    np.testing.assert_array_equal(stiff_dampers(twisting, np.zeros(24), step), plant.damping[1])


def test_joint_speed_is_not_clamped(paper: Robot) -> None:
    simulation = PybulletSimulation(paper)
    snapshot = simulation.get_snapshot()
    snapshot.velocity[0, -1] = 150.0
    simulation.set_snapshot(snapshot)
    simulation.step(np.zeros((1, paper.num_cables)))
    rate = simulation.state().joint_rates[0, -1]
    simulation.close()
    assert rate > 101


def test_a_joint_that_bullet_clamps_has_diverged(paper: Robot) -> None:
    """The stock engine clamps at 100 rad/s."""
    simulation = PybulletStock(paper)
    start = simulation.get_snapshot()
    for speed in (90.0, 150.0):
        start.velocity[0, -1] = speed
        simulation.set_snapshot(start)
        with pytest.raises(Diverged) if speed > 100 else contextlib.nullcontext():
            simulation.step(np.zeros((1, paper.num_cables)))
    simulation.close()


def test_substeps_of_bullet_are_smaller_time_steps(paper: Robot) -> None:
    """Four in a step are four steps of a quarter under the same command."""
    coarse = PybulletSimulation(paper, 2, PybulletOptions(substeps=4), workers=0)
    fine = PybulletSimulation(finer(paper, 4), 2, workers=0)
    for command in commands_of(paper, 12, 2, hold=4):
        coarse.step(command)
        fine.step(command, 4)
    assert_same(coarse.state(), fine.state(), rtol=1e-9, atol=1e-12)
    coarse.close()
    fine.close()


def test_kernels_are_compiled_once_for_all_robots() -> None:
    """Compiling anew takes ten seconds for each combination of types; read-only is a type too."""
    found = set[int]()
    for name, force in (("paper", 0.0), ("paper", 1.0), ("hanging-arm", 0.0)):
        simulation = PybulletSimulation(load_robot(name))
        simulation.set_loads(None, -1, force=(force, 0.0, 0.0))
        simulation.step(np.zeros((1, 8)))
        found.add(len(joint_forces.signatures))  # type: ignore[attr-defined]  # Numba's
        simulation.close()
    assert len(found) == 1


def with_velocity(snapshot: Snapshot, copy: int, speed: float) -> Snapshot:
    velocity = snapshot.velocity.copy()
    velocity[copy, -1] = speed
    return dataclasses.replace(snapshot, velocity=velocity)


@pytest.mark.parametrize("workers", [0, 2])
def test_divergence_names_copy_and_time_and_spares_the_others(paper: Robot, workers: int) -> None:
    commands = commands_of(paper, 10, 4, hold=10)
    simulation = PybulletSimulation(paper, 4, workers=workers)
    other = PybulletSimulation(paper, 4, workers=0)
    for command in commands:
        simulation.step(command)
        other.step(command)
    for bad in (1e6, np.nan):
        simulation.set_snapshot(with_velocity(other.get_snapshot(), 3, bad))
        with pytest.raises(Diverged, match=r"pybullet: copy 3 diverged at t = 0\.0275 s") as caught:
            simulation.step(commands[0], 5)
        assert (caught.value.copy, caught.value.time) == (3, pytest.approx(0.0275))
    other.step(commands[0], 5)
    np.testing.assert_allclose(
        simulation.state().tip_position[:3], other.state().tip_position[:3], atol=1e-12
    )
    np.testing.assert_allclose(
        simulation.state().tip_position[3], [0, 0, paper.top + paper.arm_length], atol=1e-12
    )
    simulation.step(commands[0])  # and it goes on
    simulation.close()
    other.close()


def test_an_impossible_time_step_diverges(paper: Robot) -> None:
    simulation = PybulletSimulation(
        changed(paper, time_step=0.1, constraint={"recovery_time": 0.2})
    )
    with pytest.raises(Diverged, match="smaller time_step"):
        simulation.step(-5.0 * np.arange(float(paper.num_cables))[None], 50)
    simulation.close()


def test_workers_give_the_same_numbers(paper: Robot) -> None:
    """With parameters, loads and states of some copies, which two workers share as 2 and 3."""
    here, there = PybulletSimulation(paper, 5, workers=0), PybulletSimulation(paper, 5, workers=2)
    position = here.get_snapshot().position[[0, 3]]
    position[:, -2:] = [[0.1, -0.2], [0.3, 0.05]]
    parameters = dataclasses.replace(random_parameters(paper, 2), command_delay=[2, 1])
    for simulation in (here, there):
        simulation.set_parameters([1, 4], parameters)
        simulation.set_loads([0, 3], 4, force=(3.0, 0.0, 1.0))
        simulation.set_loads([2, 4], -1, torque=(0.0, 2.0, 0.0))
        simulation.place([0, 3], position, np.zeros((2, paper.num_coordinates)))
        for command in commands_of(paper, 10, 5, hold=5):
            simulation.step(command, 2)
    assert_same(here.state(), there.state())
    assert len({tuple(tip) for tip in here.state().tip_position.round(6).tolist()}) == 5
    assert_same(here.dynamics([4]), there.dynamics([4]))
    saved = here.get_snapshot()
    for simulation in (here, there):
        simulation.reset([0, 4])
    assert_same(here.state(), there.state())
    for simulation in (here, there):
        simulation.reset()
        simulation.set_snapshot(saved)
        simulation.step(np.zeros((5, 8)))
    assert_same(here.state(), there.state())
    here.close()
    there.close()


def test_workers_are_as_many_as_copies_and_processors_allow(
    paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From 16 copies on, one for each 8 of them, but no more than processors, and never one."""
    asked: list[tuple[int, int]] = []

    class Counted(World):
        def __init__(self, robot: Robot, num: int, options: PybulletOptions, workers: int = 0):
            super().__init__(robot, 1, options)
            asked.append((num, workers))

    monkeypatch.setattr("backends.pybullet.simulation.World", Counted)
    monkeypatch.setattr("backends.pybullet.simulation.Pool", Counted)
    for processors in (1, 3):
        monkeypatch.setattr("backends.pybullet.simulation.processors", lambda n=processors: n)
        for num in (15, 16, 17, 40):
            PybulletSimulation(paper, num).close()
    alone = [(15, 0), (16, 0), (17, 0), (40, 0)]
    assert asked == [*alone, (15, 0), (16, 2), (17, 3), (40, 3)]


def test_workers_end_with_their_pool(paper: Robot) -> None:
    pool = Pool(paper, 2, PybulletOptions(), workers=2)
    processes = pool.processes
    del pool
    gc.collect()
    assert all(process.poll() is not None for process in processes)


def test_a_worker_whose_caller_is_gone_ends_without_a_word(
    paper: Robot, capfd: pytest.CaptureFixture[str]
) -> None:
    """It reads no more requests, or nothing takes its answer."""
    ends = Pool(paper, 2, PybulletOptions(), workers=2)
    waiting, answering = ends.processes
    assert waiting.stdin is not None
    waiting.stdin.close()
    assert answering.stdin is not None
    assert answering.stdout is not None
    answering.stdout.close()
    answering.stdin.write(pickle.dumps(("reset", [0])))
    answering.stdin.flush()
    assert [process.wait(30) for process in ends.processes] == [0, 0]
    assert capfd.readouterr().err == ""


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_a_lost_worker_is_an_error_and_no_hang(paper: Robot) -> None:
    pool = Pool(paper, 4, PybulletOptions(), workers=2)
    os.kill(pool.processes[1].pid, signal.SIGKILL)
    command = np.zeros((4, paper.num_cables))
    with pytest.raises(CdcsrError, match="worker process of copies 2 to 3 ended unexpectedly"):
        pool.step(command, 1)
    with pytest.raises(CdcsrError, match="make a new one"):
        pool.step(command, 1)
    pool.close()


def test_mistakes_are_errors(paper: Robot) -> None:
    with pytest.raises(CdcsrError, match="0 to 2 worker processes, not 3"):
        PybulletSimulation(paper, 2, workers=3)
    simulation = PybulletSimulation(paper, 2)
    with pytest.raises(CdcsrError, match=r"\(2, 8\), not \(8,\)"):
        simulation.step(np.zeros(8))
    simulation.close()


@pytest.mark.slow
def test_cables_cost_little(paper: Robot) -> None:
    step, bare = step_cost(paper)
    assert step < 8 * bare  # measured 6.10 to 6.50; half of it is Bullet's mass matrix
