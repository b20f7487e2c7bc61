"""Commands that arrive late, in every engine."""

from __future__ import annotations

import numpy as np
import pytest

from cdcsr.errors import Diverged
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Array
from cdcsr.simulation.engines import backend_names
from cdcsr.simulation.plant import Parameters
from tests.support.physics import Make


@pytest.fixture(scope="module")
def paper() -> Robot:
    return load_robot("paper")


def commands_of(robot: Robot, steps: int, num: int = 1) -> Array:
    """Random set-points that jump every ten steps, shape (steps, num, C)."""
    eta = np.array([servo.eta for servo in robot.servos])
    draws = np.random.default_rng(0).uniform(-1, 0, (-(-steps // 10), num, robot.num_cables)) * eta
    return np.repeat(draws, 10, axis=0)[:steps]


@pytest.mark.parametrize("substeps", [1, 3])
def test_a_delay_shifts_the_response_by_so_many_steps(
    make: Make, engine: str, paper: Robot, substeps: int
) -> None:
    """At rest nothing moves, so that a copy k steps late is where a punctual one was k steps before."""
    delays = [0, 1, 4]
    late, punctual = make(engine, paper, 3), make(engine, paper, 1)
    late.set_parameters(None, Parameters(command_delay=delays))
    past = [punctual.get_snapshot().position[0]]
    for command in commands_of(paper, 30):
        late.step(np.repeat(command, 3, axis=0), substeps)
        for _ in range(substeps):
            punctual.step(command)
            past.append(punctual.get_snapshot().position[0])
        for copy, delay in enumerate(delays):
            expected = past[max(len(past) - 1 - delay, 0)]
            # A robot at rest keeps still to 1e-9 only where MuJoCo's cables are taut from the start.
            np.testing.assert_allclose(
                late.get_snapshot().position[copy], expected, rtol=0, atol=1e-7
            )


def test_commands_under_way_are_in_the_snapshot_of_any_engine(
    make: Make, engine: str, paper: Robot
) -> None:
    delays, commands = [5, 2], commands_of(paper, 20, 2)
    for other in backend_names():
        first, second = make(engine, paper, 2), make(other, paper, 2)
        for simulation in (first, second):
            simulation.set_parameters(None, Parameters(command_delay=delays))
        for command in commands:
            first.step(command)
        sent = first.get_snapshot().commands
        assert sent is not None
        np.testing.assert_array_equal(sent, commands[-5:].swapaxes(0, 1))
        second.set_snapshot(first.get_snapshot())
        received = second.get_snapshot().commands
        assert received is not None
        np.testing.assert_array_equal(received, sent)
        # Both go on with the old commands, whatever comes now.
        for _ in range(2):
            first.step(np.zeros((2, paper.num_cables)))
            second.step(np.zeros((2, paper.num_cables)))
        np.testing.assert_allclose(
            second.state().cable_travel,
            first.state().cable_travel,
            atol=1e-8 if engine == other else 1e-2,
        )
        first.reset([0])
        sent = first.get_snapshot().commands
        assert sent is not None
        assert not sent[0].any()
        assert sent[1].any()


def test_a_copy_that_diverges_does_not_cost_the_others_their_late_commands(
    make: Make, paper: Robot
) -> None:
    commands = commands_of(paper, 10, 2)
    one, other = make("pybullet", paper, 2), make("pybullet", paper, 2)
    for simulation in (one, other):
        simulation.set_parameters(None, Parameters(command_delay=[2, 1]))
        for command in commands:
            simulation.step(command)
    snapshot = one.get_snapshot()
    snapshot.velocity[1, -1] = 1e6
    one.set_snapshot(snapshot)
    with pytest.raises(Diverged, match="copy 1"):
        one.step(commands[0], 5)
    other.step(commands[0], 5)
    np.testing.assert_allclose(
        one.get_snapshot().position[0], other.get_snapshot().position[0], atol=1e-10
    )
