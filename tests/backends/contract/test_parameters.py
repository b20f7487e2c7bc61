"""Copies that differ from the description, compared with robots that are described so."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Array, Snapshot
from cdcsr.simulation.engines import backend_names
from cdcsr.simulation.plant import Parameters
from tests.support.physics import Make, assert_same, commands_of, random_parameters, stretch

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


@pytest.mark.parametrize("name", PLACES)
def test_a_parameter_is_as_if_written_into_the_description(
    make: Make, engine: str, paper: Robot, name: str
) -> None:
    """In every step and in the equation of motion. It is set while the copies move, and does not
    change the other copies."""
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
        mine = row_of(copies.get_snapshot(), 1)
        assert_same(mine, apart.get_snapshot(), atol=0 if engine == "mujoco" else 1e-9)
    found = copies.dynamics([1])
    assert_same(found, apart.dynamics(), rtol=1e-11, atol=1e-9)
    changed = np.abs(copies.get_snapshot().position[1] - alike.get_snapshot().position[1])
    assert changed.max() > 1e-7
    if "mass" in name or "inertia" in name:
        assert not np.allclose(found.mass_matrix, before.mass_matrix)
    np.testing.assert_array_equal(
        copies.dynamics([0, 2]).mass_matrix, alike.dynamics([0, 2]).mass_matrix
    )


@pytest.mark.parametrize("factor", [0.7, 1.4])
@pytest.mark.parametrize(
    "name", ["base_mass", "base_inertia", "link_mass", "link_inertia", "joint_damping"]
)
def test_heavier_and_lighter_parts_are_as_if_written(
    make: Make, paper: Robot, name: str, factor: float
) -> None:
    """MuJoCo makes constraints softer or harder by masses, and must do it again if one changes,
    up or down."""
    section, key = PLACES[name]
    data = paper.model_dump()
    tables = [data["base"]] if section == "base" else [s[section] for s in data["segments"]]
    for table in tables:
        table[key] = (np.array(table[key]) * factor).tolist()
    copy, described = make("mujoco", paper), make("mujoco", Robot.model_validate(data))
    parts = 1 if section == "base" else paper.num_links
    copy.set_parameters(None, Parameters(**{name: np.full((1, parts), factor)}))
    for command in commands_of(paper, 30, 1, hold=10):
        copy.step(command)
        described.step(command)
    np.testing.assert_array_equal(copy.get_snapshot().position, described.get_snapshot().position)


def test_a_longer_cable_is_one_whose_slider_begins_further_down(
    make: Make, engine: str, paper: Robot
) -> None:
    """If a cable is longer by d, its slider at -d is where the slider of a robot rests whose offset
    is larger by d."""
    stretch = 0.004
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
        np.testing.assert_allclose(one.tip_position, other.tip_position, atol=1e-8)
        np.testing.assert_allclose(one.cable_travel, other.cable_travel - stretch, atol=1e-8)
        np.testing.assert_allclose(one.cable_tension, other.cable_tension, rtol=1e-5, atol=1e-5)
    assert np.linalg.norm(rested.state().tip_position[0, :2]) > 0.01


def test_a_longer_cable_pulls_late_and_a_shorter_one_at_once(
    make: Make, engine: str, paper: Robot
) -> None:
    simulation = make(engine, paper, 2)
    simulation.set_parameters(None, Parameters(rest_length_offset=[0.01, -0.01]))
    simulation.reset([0])
    simulation.reset([1])
    np.testing.assert_array_equal(
        simulation.state().cable_travel, np.repeat([[0.0], [0.01]], paper.num_cables, 1)
    )
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


def test_dynamics_follows_every_change_in_all_engines(make: Make, robot: Robot) -> None:
    """The equation that an engine reports and the one that it steps with agree with the first
    engine's."""
    num, engines = 3, backend_names()
    simulations = [make(engine, robot, num) for engine in engines]
    for command in commands_of(robot, 30, num, hold=10):
        simulations[0].step(command)
    snapshot = dataclasses.replace(simulations[0].get_snapshot(), engine="none")
    for simulation in simulations[1:]:
        simulation.set_snapshot(snapshot)
    seen = []
    for seed in range(4):
        for simulation in simulations:
            simulation.set_parameters(None, random_parameters(robot, num, seed))
        first, *others = (simulation.dynamics() for simulation in simulations)
        assert len(others) >= len(engines) - 1
        for other in others:
            for field in dataclasses.fields(other):
                value, found = getattr(first, field.name), getattr(other, field.name)
                atol = 1e-10 * max(1, np.abs(value).max())
                np.testing.assert_allclose(found, value, rtol=0, atol=atol, err_msg=field.name)
        seen.append(first.mass_matrix)
    assert min(np.abs(np.subtract(a, b)).max() for i, a in enumerate(seen) for b in seen[:i]) > 0.1


def test_engines_move_alike_with_the_same_parameters(make: Make, paper: Robot) -> None:
    """They are as near to each other as without parameters; the parameters move the tip much
    further."""
    parameters, tips = random_parameters(paper, 2), {}
    for differ in (False, True):
        for engine in ("mujoco", "pybullet"):
            simulation = make(engine, paper, 2)
            if differ:
                simulation.set_parameters(None, parameters)
            for command in commands_of(paper, STEPS, 2, hold=10):
                simulation.step(command)
            tips[engine, differ] = simulation.state().tip_position
    apart = {
        d: np.linalg.norm(tips["mujoco", d] - tips["pybullet", d], axis=1).max()
        for d in (False, True)
    }
    moved = np.linalg.norm(tips["mujoco", True] - tips["mujoco", False], axis=1).min()
    assert apart[True] < 3 * apart[False] + 1e-3
    assert moved > 5 * apart[True]
