"""Copies that differ from the description move as robots that are described so; parameters last
through resets and snapshots, and can be set back."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from backends.contract_suite.states import (
    Make,
    assert_same,
    commands_of,
    moving,
    random_parameters,
    rounding,
    stretch,
    tolerance,
)
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array, Snapshot
from cdcsr.simulation.plant import Parameters

STEPS = 60


FACTORS = (1.3, 0.8)
"""The factors for the two segments of the paper's robot; the base has the first."""
PLACES = {
    "base_mass": ("base", "mass"),
    "base_inertia": ("base", "inertia"),
    "link_mass": ("link", "mass"),
    "link_inertia": ("link", "inertia"),
    "joint_stiffness": ("joint", "stiffness"),
    "joint_damping": ("joint", "damping"),
    "slider_damping": ("servo", "damping"),
    "servo_gain": ("servo", "gain"),
}


def written(robot: Robot, name: str) -> tuple[Robot, Array]:
    """Return the robot with a factor written into its description, and the factor of each part,
    shape (1, parts)."""
    section, key = PLACES[name]
    data = robot.model_dump()
    if section == "base":
        tables, factors = [data["base"]], [FACTORS[0]]
    else:
        tables = [segment[section] for segment in data["segments"]]
        each = [len(s.cables.angles_deg) if section == "servo" else s.links for s in robot.segments]
        factors = np.repeat(FACTORS, each).tolist()
    for table, factor in zip(tables, FACTORS, strict=False):
        value = table[key]
        table[key] = (
            tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value
        )
    return Robot.model_validate(data), np.array([factors])


def row_of(snapshot: Snapshot, copy: int) -> Snapshot:
    """Return the snapshot of one copy."""
    rows = {
        field.name: rows[copy : copy + 1]
        for field in dataclasses.fields(snapshot)
        if isinstance(rows := getattr(snapshot, field.name), np.ndarray)
    }
    return dataclasses.replace(snapshot, **rows)


class ParametersContract:
    """Tests of the plant and of the equation of motion."""

    @pytest.mark.parametrize("name", PLACES)
    def test_a_parameter_is_as_if_written_into_the_description(
        self, make: Make, engine: str, paper: Robot, name: str
    ) -> None:
        """In every step and in the equation of motion. It is set while the copies move, and does
        not change the other copies."""
        other, factors = written(paper, name)
        commands = commands_of(paper, STEPS, 3, hold=10)
        copies, alike, apart = make(engine, paper, 3), make(engine, paper, 3), make(engine, other)
        for command in commands[:20]:
            copies.step(command)
            alike.step(command)
        start = copies.get_snapshot()
        before = copies.dynamics([1])
        copies.set_parameters([1], Parameters(**{name: factors}))
        assert_same(copies.get_snapshot(), start)
        apart.set_snapshot(dataclasses.replace(row_of(start, 1), robot=other.fingerprint))
        for command in commands[20:]:
            for simulation, own in ((copies, command), (alike, command), (apart, command[1:2])):
                simulation.step(own)
            assert_same(copies.get_snapshot(), alike.get_snapshot(), copies=[0, 2])
            mine, alone = row_of(copies.get_snapshot(), 1), apart.get_snapshot()
            near = 1e-9 + 10 * rounding(engine)
            np.testing.assert_allclose(mine.position, alone.position, rtol=0, atol=near)
            # Within one step a rounded length of 2 m moves a slider by up to 1 mm/s.
            near = 1e-9 + 300 * rounding(engine)
            np.testing.assert_allclose(mine.velocity, alone.velocity, rtol=0, atol=near)
        found, near = copies.dynamics([1]), 10 * rounding(engine)
        if near:
            mine = row_of(copies.get_snapshot(), 1)
            apart.set_snapshot(dataclasses.replace(mine, robot=other.fingerprint))
        assert_same(found, apart.dynamics(), rtol=1e-11 + near, atol=1e-9 + near)
        changed = np.abs(copies.get_snapshot().position[1] - alike.get_snapshot().position[1])
        assert changed.max() > 1e-7
        if "mass" in name or "inertia" in name:
            assert not np.allclose(found.mass_matrix, before.mass_matrix)
        np.testing.assert_array_equal(
            copies.dynamics([0, 2]).mass_matrix, alike.dynamics([0, 2]).mass_matrix
        )

    def test_a_longer_cable_is_one_whose_slider_begins_further_down(
        self, make: Make, engine: str, paper: Robot
    ) -> None:
        """If a cable is longer by d, its slider at -d is where the slider of a robot rests whose
        offset is larger by d."""
        stretch, near = 0.004, rounding(engine)
        data = paper.model_dump()
        for segment in data["segments"]:
            segment["servo"]["offset"] += stretch
        lower = Robot.model_validate(data)
        stretched, rested = make(engine, paper), make(engine, lower)
        stretched.set_parameters(None, Parameters(rest_length_offset=stretch))
        start = stretched.get_snapshot()
        start.position[:, 7 : 7 + paper.num_cables] -= stretch
        stretched.set_snapshot(dataclasses.replace(start, engine="by hand"))
        for command in commands_of(paper, STEPS, hold=10):
            stretched.step(command - stretch)
            rested.step(command)
            one, other = stretched.state(), rested.state()
            np.testing.assert_allclose(one.tip_position, other.tip_position, atol=1e-8 + near)
            np.testing.assert_allclose(
                one.cable_travel, other.cable_travel - stretch, atol=1e-8 + near
            )
            # A rounded length changes a tension by some hundredths of a newton.
            np.testing.assert_allclose(
                one.cable_tension, other.cable_tension, rtol=1e-5, atol=1e-5 + 2e4 * near
            )
        assert np.linalg.norm(rested.state().tip_position[0, :2]) > 0.01

    def test_a_longer_cable_pulls_late_and_a_shorter_one_at_once(
        self, make: Make, engine: str, paper: Robot
    ) -> None:
        simulation = make(engine, paper, 2)
        simulation.set_parameters(None, Parameters(rest_length_offset=[0.01, -0.01]))
        simulation.reset([0])
        simulation.reset([1])
        expected = np.repeat([[0.0], [0.01]], paper.num_cables, 1)
        found = simulation.state().cable_travel
        np.testing.assert_allclose(found, expected, rtol=0, atol=rounding(engine))
        simulation.step(np.zeros((2, paper.num_cables)), 40)
        long, short = simulation.state().cable_travel
        np.testing.assert_allclose(long, 0.0, atol=1e-6)
        allowed = stretch(simulation, paper.servos[0].gain * 0.01)
        np.testing.assert_allclose(short, 0.01, atol=allowed)  # the straight arm holds them there
        assert simulation.state().cable_tension[1] == pytest.approx(
            paper.servos[0].gain * 0.01, rel=0.02
        )
        command = np.zeros((2, paper.num_cables))
        command[:, 0] = -0.005
        tension = []
        for _ in range(40):
            simulation.step(command)
            tension.append(simulation.state().cable_tension[:, 0])
        assert np.max(tension, axis=0)[0] == pytest.approx(0.0, abs=1e-6)
        assert np.min(tension, axis=0)[1] > 0.1

    def test_the_equation_of_motion_is_that_of_mujoco_after_every_change(
        self, make: Make, engine: str, robot: Robot
    ) -> None:
        """Mass matrix, forces, and the Jacobians of tip and cables, each to rounding."""
        num = 3
        reference, tested = make("mujoco", robot, num), make(engine, robot, num)
        for command in commands_of(robot, 30, num, hold=10):
            reference.step(command)
        tested.set_snapshot(dataclasses.replace(reference.get_snapshot(), engine="none"))
        seen = []
        for seed in range(4):
            for simulation in (reference, tested):
                simulation.set_parameters(None, random_parameters(robot, num, seed))
            expected, found = reference.dynamics(), tested.dynamics()
            for name in (field.name for field in dataclasses.fields(expected)):
                value = getattr(expected, name)
                atol = (1e-10 + rounding(engine)) * max(1, np.abs(value).max())
                np.testing.assert_allclose(
                    getattr(found, name), value, rtol=0, atol=atol, err_msg=name
                )
            seen.append(found.mass_matrix)
        apart = [np.abs(np.subtract(a, b)).max() for i, a in enumerate(seen) for b in seen[:i]]
        assert min(apart) > 0.1

    def test_a_step_follows_the_equation_of_motion(
        self, make: Make, engine: str, robot: Robot
    ) -> None:
        """With slack cables and no dampers, (v' - v) / h = M^-1 (springs + servos + load - bias).

        Engines that make this step differently are allowed a tenth in the norm of M; those that
        damp by themselves, a third.
        """
        cables, start, copies = robot.num_cables, moving(robot, 3), make(engine, robot, 3)
        start.position[:, 7 : 7 + cables] = 0.04
        start.velocity[:, 6:] *= 0.1
        copies.set_parameters(None, Parameters(joint_damping=0.0, slider_damping=0.0))
        copies.set_snapshot(start)
        copies.set_loads(None, -1, force=(1, 2, 3))
        equation = copies.dynamics()
        force = equation.passive_force - equation.bias_force
        force[:, 6 : 6 + cables] -= copies.plant.servo_gain * 0.04
        expected = np.linalg.solve(equation.mass_matrix, force[..., None])
        copies.step(np.zeros((3, cables)))
        assert not copies.state().cable_tension.any()
        found = (copies.get_snapshot().velocity - start.velocity) / robot.time_step
        error, size = (
            np.sqrt((each.swapaxes(1, 2) @ equation.mass_matrix @ each).ravel())
            for each in (found[..., None] - expected, expected)
        )
        assert (error < size * (0.1 if copies.ideal else 0.35)).all()

    def test_reset_keeps_parameters_and_snapshots_continue(
        self, make: Make, engine: str, paper: Robot
    ) -> None:
        parameters = dataclasses.replace(random_parameters(paper, 2), command_delay=[0, 3])
        commands = commands_of(paper, 40, 2, hold=10)
        first, second = make(engine, paper, 2), make(engine, paper, 2)
        for simulation in (first, second):
            simulation.set_parameters(None, parameters)
            simulation.reset()
        for command in commands:
            first.step(command)
        first.reset([1])
        first.reset([0])
        for command in commands:
            first.step(command)
            second.step(command)
        assert_same(first.get_snapshot(), second.get_snapshot(), atol=tolerance(engine))
        snapshot = first.get_snapshot()
        for command in commands:
            first.step(command)
        second.reset()
        second.set_snapshot(snapshot)
        for command in commands:
            second.step(command)
        assert_same(first.get_snapshot(), second.get_snapshot(), atol=tolerance(engine))

    def test_default_parameters_restore_the_first_bits(
        self, make: Make, engine: str, paper: Robot
    ) -> None:
        commands = commands_of(paper, 30, 2, hold=10)
        plain, back = make(engine, paper, 2), make(engine, paper, 2)
        back.set_parameters(None, dataclasses.replace(random_parameters(paper, 2), command_delay=2))
        back.set_parameters([0], Parameters())
        back.set_parameters([1], Parameters())
        for command in commands:
            plain.step(command)
            back.step(command)
            assert_same(plain.get_snapshot(), back.get_snapshot())
        assert back.get_snapshot().commands is None
        for ours, theirs in zip(back.plant, plain.plant, strict=True):
            np.testing.assert_array_equal(ours, theirs)

    def test_an_empty_list_of_copies_is_no_error(
        self, make: Make, engine: str, paper: Robot
    ) -> None:
        simulation = make(engine, paper, 2)
        before = simulation.get_snapshot()
        simulation.set_parameters([], random_parameters(paper, 0))
        simulation.set_parameters([], Parameters(command_delay=np.zeros(0, int)))
        assert_same(simulation.get_snapshot(), before)

    def test_damping_and_stiffness_may_be_zero(self, make: Make, engine: str, paper: Robot) -> None:
        simulation = make(engine, paper)
        simulation.set_parameters(
            None, Parameters(joint_damping=0, joint_stiffness=0, slider_damping=0)
        )
        simulation.step(commands_of(paper, 1, hold=10)[0])
        assert not simulation.dynamics().passive_force.any()
