"""The PyBullet engine: limits, divergence and worker processes; physics is tested in every
engine."""

from __future__ import annotations

import dataclasses
import gc
import os
import signal

import numpy as np
import pytest

from backends.pybullet.benchmarks import step_cost
from backends.pybullet.simulation import PybulletSimulation
from backends.pybullet.workers import Pool
from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Snapshot
from tests.support.physics import assert_same, changed, commands_of


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
    assert reach[1] == pytest.approx(0.05, abs=1e-9)


def test_joint_speed_is_not_clamped(paper: Robot) -> None:
    simulation = PybulletSimulation(paper)
    snapshot = simulation.get_snapshot()
    snapshot.velocity[0, -1] = 150.0
    simulation.set_snapshot(snapshot)
    simulation.step(np.zeros((1, paper.num_cables)))
    rate = simulation.state().joint_rates[0, -1]
    simulation.close()
    assert rate > 101


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
    commands = commands_of(paper, 20, 5, hold=10)
    here, there = PybulletSimulation(paper, 5, workers=0), PybulletSimulation(paper, 5, workers=2)
    for command in commands:
        here.step(command, 2)
        there.step(command, 2)
    here.reset([0, 4])
    there.reset([0, 4])
    assert_same(here.state(), there.state())
    assert_same(here.dynamics([1]), there.dynamics([1]))
    here.close()
    there.close()


def test_workers_end_with_their_pool(paper: Robot) -> None:
    pool = Pool(paper, 2, workers=2)
    processes = pool.processes
    del pool
    gc.collect()
    assert all(process.poll() is not None for process in processes)


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_a_lost_worker_is_an_error_and_no_hang(paper: Robot) -> None:
    pool = Pool(paper, 4, workers=2)
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
    assert step < 6 * bare
