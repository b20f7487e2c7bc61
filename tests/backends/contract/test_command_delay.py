"""Commands that arrive late, in every engine."""

from __future__ import annotations

import numpy as np
import pytest

from cdcsr.errors import Diverged
from cdcsr.robot.description import Robot
from cdcsr.simulation.engines import backend_names
from cdcsr.simulation.plant import Parameters
from tests.support.physics import Make, commands_of


@pytest.mark.parametrize("substeps", [1, 3])
def test_a_delay_shifts_the_response_by_so_many_steps(
    make: Make, engine: str, paper: Robot, substeps: int
) -> None:
    """At rest nothing moves, so a copy with a delay of k steps is where a copy without was k steps
    before."""
    delays = [0, 1, 4]
    late, prompt = make(engine, paper, 3), make(engine, paper, 1)
    late.set_parameters(None, Parameters(command_delay=delays))
    past = [prompt.get_snapshot().position[0]]
    for command in commands_of(paper, 30, hold=10):
        late.step(np.repeat(command, 3, axis=0), substeps)
        for _ in range(substeps):
            prompt.step(command)
            past.append(prompt.get_snapshot().position[0])
        for copy, delay in enumerate(delays):
            expected = past[max(len(past) - 1 - delay, 0)]
            # In MuJoCo a robot at rest keeps still to 1e-9 only if its cables are taut.
            np.testing.assert_allclose(
                late.get_snapshot().position[copy], expected, rtol=0, atol=1e-7
            )


def test_a_snapshot_holds_the_commands_under_way_in_any_engine(
    make: Make, engine: str, paper: Robot
) -> None:
    delays, commands = [5, 2], commands_of(paper, 20, 2, hold=10)
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
        # Both go on with the old commands, and not with these.
        for _ in range(2):
            first.step(np.zeros((2, paper.num_cables)))
            second.step(np.zeros((2, paper.num_cables)))
        np.testing.assert_allclose(
            second.state().cable_travel,
            first.state().cable_travel,
            # A stretched cable comes back to its rest length at another pace in another engine.
            atol=1e-8 if engine == other else 2e-2,
        )
        first.reset([0])
        sent = first.get_snapshot().commands
        assert sent is not None
        assert not sent[0].any()
        assert sent[1].any()


def test_after_a_copy_diverges_the_others_still_get_their_late_commands(
    make: Make, paper: Robot
) -> None:
    commands = commands_of(paper, 10, 2, hold=10)
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
