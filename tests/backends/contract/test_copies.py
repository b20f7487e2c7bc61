"""Copies do not affect each other, resets affect only the copies they name, and a snapshot
determines the future.

An engine that is declared as bit-exact is exact here too. Others are exact within 1e-10 over the
steps made here; PyBullet for example stores the base's pose in another form than it returns.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Array, Simulation, State
from cdcsr.simulation.engines import load_backend
from cdcsr.simulation.plant import Parameters
from tests.support.physics import assert_same, commands_of, moving, running, straight

COPIES = 64


def tolerance(engine: str) -> float:
    return 0.0 if "bit_exact" in load_backend(engine).capabilities else 1e-10


def same(one: State, other: State, engine: str) -> None:
    """Compare every measured quantity, tensions included."""
    assert_same(one, other, rtol=tolerance(engine), atol=tolerance(engine))


def only(state: State, copy: int) -> State:
    return State(
        **{f.name: getattr(state, f.name)[copy : copy + 1] for f in dataclasses.fields(State)}
    )


def advance(simulation: Simulation, commands: Array) -> State:
    for command in commands:
        simulation.step(command)
    return simulation.state()


def test_copies_of_64_move_as_if_alone_also_when_others_are_reset(
    paper: Robot, engine: str
) -> None:
    commands = commands_of(paper, 30, COPIES, hold=5)
    gone, kept = list(range(3, COPIES, 5)), [n for n in range(COPIES) if n % 5 != 3]
    with running(paper, engine, COPIES) as batch:
        before = advance(batch, commands[:15])
        batch.reset(gone)
        assert_same(batch.state(), before, kept)  # exact in every engine
        assert not batch.state().time[gone].any()
        together = advance(batch, commands[15:])
    for copy, since in ((0, 0), (17, 0), (63, 15), (3, 15)):
        assert (copy in gone) == (since > 0)
        with running(paper, engine) as alone:
            after = advance(alone, commands[since:, copy : copy + 1])
        assert after.cable_tension.max() > 1
        same(after, only(together, copy), engine)


def test_a_snapshot_continues_as_if_never_stopped(robot: Robot, engine: str) -> None:
    """In another simulation that has another past, and again in the same one."""
    commands = commands_of(robot, 60, 3, hold=10)
    with running(robot, engine, 3) as first, running(robot, engine, 3) as second:
        stopped = advance(first, commands[:30])
        assert stopped.cable_tension.max() > 1
        snapshot = first.get_snapshot()
        advance(second, commands[:7])
        second.set_snapshot(snapshot)
        same(second.state(), stopped, engine)
        never_stopped = advance(first, commands[30:])
        same(advance(second, commands[30:]), never_stopped, engine)
        first.set_snapshot(snapshot)
        same(advance(first, commands[30:]), never_stopped, engine)


def test_a_snapshot_of_something_else_is_an_error(paper: Robot, engine: str) -> None:
    with running(paper, engine, 2) as simulation:
        with pytest.raises(CdcsrError, match="holds 3 copies; this simulation has 2"):
            simulation.set_snapshot(straight(paper, 3))
        with pytest.raises(CdcsrError, match="is of robot"):
            simulation.set_snapshot(straight(load_robot("planar-single"), 2))


def test_substeps_are_steps_under_one_command(paper: Robot, engine: str) -> None:
    command = commands_of(paper, 1, 2)[0]
    with running(paper, engine, 2) as at_once, running(paper, engine, 2) as one_by_one:
        at_once.step(command, 7)
        same(at_once.state(), advance(one_by_one, np.array([command] * 7)), engine)


def test_commands_that_are_not_finite_are_errors(paper: Robot, engine: str) -> None:
    with running(paper, engine, 2) as simulation:
        before = simulation.state()
        commands = np.full((2, paper.num_cables), -0.01)
        commands[1, 3] = np.nan
        with pytest.raises(CdcsrError, match="that of copy 1 is"):
            simulation.step(commands)
        assert_same(simulation.state(), before)


def test_an_unknown_camera_is_an_error(paper: Robot, engine: str) -> None:
    with (
        running(paper, engine) as simulation,
        pytest.raises(CdcsrError, match=r"Unknown camera 'sid'\. Did you mean 'side'"),
    ):
        simulation.render(camera="sid")


def test_placed_copies_are_in_their_state_and_the_others_go_on(paper: Robot, engine: str) -> None:
    commands, ids = commands_of(paper, 40, 5, hold=5), [1, 3]
    with running(paper, engine, 5) as simulation, running(paper, engine, 2) as placed:
        simulation.set_parameters(ids, Parameters(command_delay=3))
        before = advance(simulation, commands[:20])
        given = moving(paper, 2)
        simulation.place(ids, given.position, given.velocity)
        placed.place(None, given.position, given.velocity)
        placed.set_parameters(None, Parameters(command_delay=3))
        assert_same(simulation.state(), before, [0, 2, 4])
        found = simulation.get_snapshot()
        np.testing.assert_allclose(found.position[ids], given.position, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.velocity[ids], given.velocity, rtol=0, atol=1e-12)
        assert not found.time[ids].any()
        assert found.commands is not None
        assert not found.commands[ids].any()
        both = advance(simulation, commands[20:]), advance(placed, commands[20:, ids])
        for row, copy in enumerate(ids):
            same(only(both[0], copy), only(both[1], row), engine)


@pytest.mark.parametrize(("name", "width"), [("position", 31), ("velocity", 30)])
def test_a_state_that_does_not_fit_is_not_placed(
    paper: Robot, engine: str, name: str, width: int
) -> None:
    given = straight(paper)
    wrong = {"position": given.position, "velocity": given.velocity}
    with running(paper, engine, 2) as simulation:
        before = simulation.state()
        for array in (np.zeros((1, width + 1)), np.full((1, width), np.nan)):
            with pytest.raises(CdcsrError, match=f"The {name} must (have the shape|be finite)"):
                simulation.place([1], **(wrong | {name: array}))
        assert_same(simulation.state(), before)
