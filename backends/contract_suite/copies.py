"""Copies do not affect each other, resets affect only the copies they name, a snapshot determines
the future, and commands may arrive late."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import ClassVar

import numpy as np
import pytest

from backends.contract_suite.states import (
    Make,
    assert_same,
    commands_of,
    moving,
    rounding,
    running,
    straight,
    tolerance,
)
from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Array, Simulation, State
from cdcsr.simulation.engines import backend_names
from cdcsr.simulation.plant import Parameters


def same(one: State, other: State, engine: str) -> None:
    """Compare every measured quantity, tensions included.

    In single precision a rounded length changes the tension of a cable by some tenths of a
    newton.
    """
    if rounding(engine):
        np.testing.assert_allclose(one.cable_tension, other.cable_tension, rtol=0.01, atol=0.3)
        one = dataclasses.replace(one, cable_tension=other.cable_tension)
    assert_same(one, other, rtol=tolerance(engine), atol=tolerance(engine))


def only(state: State, copy: int) -> State:
    return State(
        **{f.name: getattr(state, f.name)[copy : copy + 1] for f in dataclasses.fields(State)}
    )


def advance(simulation: Simulation, commands: Array) -> State:
    for command in commands:
        simulation.step(command)
    return simulation.state()


class CopiesContract:
    """Tests of stepping, resets, snapshots and delays."""

    copies: ClassVar[int] = 64
    """How many copies are compared with lone ones; at least 4."""

    def test_coordinates_are_in_the_contracts_order(self, robot: Robot, engine: str) -> None:
        """The state has the numbers of a snapshot under the right names."""
        snapshot, cables = moving(robot, 3), robot.num_cables
        with running(robot, engine, 3) as simulation:
            simulation.set_snapshot(snapshot)
            state, again = simulation.state(), simulation.get_snapshot()
            flow = simulation.dynamics().velocity
        position, velocity = snapshot.position, snapshot.velocity
        same_numbers = partial(np.testing.assert_allclose, rtol=0, atol=1e-12 + rounding(engine))
        exactly = partial(np.testing.assert_allclose, rtol=0, atol=rounding(engine))
        exactly(state.base_position, position[:, :3])
        same_numbers(state.base_quaternion, position[:, 3:7])
        exactly(state.cable_travel, position[:, 7 : 7 + cables])
        exactly(state.joint_angles, position[:, 7 + cables :])
        same_numbers(state.base_velocity, velocity[:, :3])
        same_numbers(state.base_angular_velocity, velocity[:, 3:6])
        exactly(state.joint_rates, velocity[:, 6 + cables :])
        same_numbers(flow, velocity)
        same_numbers(again.velocity, velocity)
        same_numbers(again.position, position)

    def test_copies_move_as_if_alone_also_when_others_are_reset(
        self, paper: Robot, engine: str
    ) -> None:
        num = self.copies
        commands = commands_of(paper, 30, num, hold=5)
        gone, kept = list(range(3, num, 5)), [n for n in range(num) if n % 5 != 3]
        with running(paper, engine, num) as batch:
            before = advance(batch, commands[:15])
            batch.reset(gone)
            assert_same(batch.state(), before, kept)  # exact in every engine
            assert not batch.state().time[gone].any()
            together = advance(batch, commands[15:])
        for copy in {0, min(17, num - 2), 3, num - 1}:
            since = 15 if copy in gone else 0
            with running(paper, engine) as alone:
                after = advance(alone, commands[since:, copy : copy + 1])
            assert after.cable_tension.max() > 1
            same(after, only(together, copy), engine)

    def test_a_snapshot_continues_as_if_never_stopped(self, robot: Robot, engine: str) -> None:
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

    def test_a_snapshot_of_something_else_is_an_error(self, paper: Robot, engine: str) -> None:
        with running(paper, engine, 2) as simulation:
            with pytest.raises(CdcsrError, match="holds 3 copies; this simulation has 2"):
                simulation.set_snapshot(straight(paper, 3))
            with pytest.raises(CdcsrError, match="is of robot"):
                simulation.set_snapshot(straight(load_robot("planar-single"), 2))

    def test_substeps_are_steps_under_one_command(self, paper: Robot, engine: str) -> None:
        command = commands_of(paper, 1, 2)[0]
        with running(paper, engine, 2) as at_once, running(paper, engine, 2) as one_by_one:
            at_once.step(command, 7)
            same(at_once.state(), advance(one_by_one, np.array([command] * 7)), engine)

    def test_commands_that_are_not_finite_are_errors(self, paper: Robot, engine: str) -> None:
        with running(paper, engine, 2) as simulation:
            before = simulation.state()
            commands = np.full((2, paper.num_cables), -0.01)
            commands[1, 3] = np.nan
            with pytest.raises(CdcsrError, match="that of copy 1 is"):
                simulation.step(commands)
            assert_same(simulation.state(), before)

    def test_an_unknown_camera_is_an_error(self, paper: Robot, engine: str) -> None:
        with (
            running(paper, engine) as simulation,
            pytest.raises(CdcsrError, match=r"Unknown camera 'sid'\. Did you mean 'side'"),
        ):
            simulation.render(camera="sid")

    def test_placed_copies_are_in_their_state_and_the_others_go_on(
        self, paper: Robot, engine: str
    ) -> None:
        commands, ids = commands_of(paper, 40, 5, hold=5), [1, 3]
        near = 1e-12 + rounding(engine)
        with running(paper, engine, 5) as simulation, running(paper, engine, 2) as placed:
            simulation.set_parameters(ids, Parameters(command_delay=3))
            before = advance(simulation, commands[:20])
            given = moving(paper, 2)
            simulation.place(ids, given.position, given.velocity)
            placed.place(None, given.position, given.velocity)
            placed.set_parameters(None, Parameters(command_delay=3))
            assert_same(simulation.state(), before, [0, 2, 4])
            found = simulation.get_snapshot()
            np.testing.assert_allclose(found.position[ids], given.position, rtol=0, atol=near)
            np.testing.assert_allclose(found.velocity[ids], given.velocity, rtol=0, atol=near)
            assert not found.time[ids].any()
            assert found.commands is not None
            assert not found.commands[ids].any()
            both = advance(simulation, commands[20:]), advance(placed, commands[20:, ids])
            for row, copy in enumerate(ids):
                same(only(both[0], copy), only(both[1], row), engine)

    @pytest.mark.parametrize(("name", "width"), [("position", 31), ("velocity", 30)])
    def test_a_state_that_does_not_fit_is_not_placed(
        self, paper: Robot, engine: str, name: str, width: int
    ) -> None:
        given = straight(paper)
        wrong = {"position": given.position, "velocity": given.velocity}
        with running(paper, engine, 2) as simulation:
            before = simulation.state()
            for array in (np.zeros((1, width + 1)), np.full((1, width), np.nan)):
                with pytest.raises(CdcsrError, match=f"The {name} must (have the shape|be finite)"):
                    simulation.place([1], **(wrong | {name: array}))
            assert_same(simulation.state(), before)

    @pytest.mark.parametrize("substeps", [1, 3])
    def test_a_delay_shifts_the_response_by_so_many_steps(
        self, make: Make, engine: str, paper: Robot, substeps: int
    ) -> None:
        """At rest nothing moves, so a copy with a delay of k steps is where a copy without was k
        steps before."""
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
                found = late.get_snapshot().position[copy]
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 + rounding(engine))

    def test_a_snapshot_holds_the_commands_under_way_in_any_engine(
        self, make: Make, engine: str, paper: Robot
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
        self, make: Make, engine: str, paper: Robot
    ) -> None:
        commands = commands_of(paper, 10, 2, hold=10)
        one, other = make(engine, paper, 2), make(engine, paper, 2)
        for simulation in (one, other):
            simulation.set_parameters(None, Parameters(command_delay=[2, 1]))
            for command in commands:
                simulation.step(command)
        snapshot = one.get_snapshot()
        snapshot.velocity[1, -1] = 1e6
        one.set_snapshot(dataclasses.replace(snapshot, engine="by hand"))
        with pytest.raises(Diverged, match="copy 1"):
            one.step(commands[0], 5)
        other.step(commands[0], 5)
        found, expected = (each.get_snapshot().position[0] for each in (one, other))
        np.testing.assert_allclose(found, expected, atol=1e-10 + rounding(engine))
