"""Copies that differ from the description, in every engine: against descriptions with their numbers written in."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from backends.pybullet.dynamics import bias_force, chain, forward_kinematics, mass_matrix, own_chain
from cdcsr.robot.description import Robot, load_robot, shipped_robots
from cdcsr.simulation.contract import Array, Simulation, Snapshot
from cdcsr.simulation.plant import Parameters
from tests.support.physics import Make, assert_same, commands_of, random_parameters

STEPS = 60


@pytest.fixture(scope="module")
def paper() -> Robot:
    return load_robot("paper")


def snapshot_of(simulation: Simulation) -> Snapshot:
    """A snapshot in which `private` is what can be compared between engines: nothing."""
    return dataclasses.replace(simulation.get_snapshot(), private=np.zeros((simulation.num, 0)))


# --- against descriptions ----------------------------------------------------------------------------------------

FACTORS = (1.3, 0.8)
"""Of the two segments of the paper's robot; the base has the first."""
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
    """The robot with a factor written into its description, and that factor by part, shape (1, parts)."""
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


@pytest.mark.parametrize("name", PLACES)
def test_a_parameter_is_as_if_written_into_the_description(
    make: Make, engine: str, paper: Robot, name: str
) -> None:
    """Step by step and in the equation of motion; set in mid-motion, with neighbours that do not notice."""
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
    only = {
        f.name: v[1:2]
        for f in dataclasses.fields(start)
        if isinstance(v := getattr(start, f.name), np.ndarray)
    }
    apart.set_snapshot(dataclasses.replace(start, robot=other.fingerprint, **only))
    for command in commands[20:]:
        for simulation, own in ((copies, command), (alike, command), (apart, command[1:2])):
            simulation.step(own)
        assert_same(copies.get_snapshot(), alike.get_snapshot(), copies=[0, 2])
        mine, theirs = copies.get_snapshot(), apart.get_snapshot()
        for field in ("time", "position", "velocity"):
            np.testing.assert_allclose(
                getattr(mine, field)[1],
                getattr(theirs, field)[0],
                rtol=0,
                atol=0 if engine == "mujoco" else 1e-9,
            )
    found, expected = copies.dynamics([1]), apart.dynamics()
    for field in dataclasses.fields(found):
        np.testing.assert_allclose(
            getattr(found, field.name),
            getattr(expected, field.name),
            rtol=1e-11,
            atol=1e-9,
            err_msg=field.name,
        )
    assert (
        np.abs(copies.get_snapshot().position[1] - alike.get_snapshot().position[1]).max() > 1e-7
    )  # it matters
    if "mass" in name or "inertia" in name:
        assert not np.allclose(found.mass_matrix, before.mass_matrix)
    np.testing.assert_array_equal(
        copies.dynamics([0, 2]).mass_matrix, alike.dynamics([0, 2]).mass_matrix
    )


def test_a_stretched_cable_is_one_whose_slider_begins_further_down(
    make: Make, engine: str, paper: Robot
) -> None:
    """A slider at -d that pulls a cable longer by d is where the slider of a description with offset + d rests."""
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


def test_a_stretched_cable_pulls_late_and_a_short_one_at_once(
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
    np.testing.assert_allclose(short, 0.01, atol=5e-5)  # the straight arm holds them there
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


# --- both engines, any parameters --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", shipped_robots())
def test_dynamics_is_current_in_both_engines(make: Make, name: str) -> None:
    """PyBullet's own functions, MuJoCo's and the compiled kernel's, after every change; PyBullet caches masses."""
    robot, num = load_robot(name), 3
    simulations = [make(engine, robot, num) for engine in ("mujoco", "pybullet")]
    for command in commands_of(robot, 30, num, hold=10):
        simulations[0].step(command)
    snapshot = snapshot_of(simulations[0])
    simulations[1].set_snapshot(snapshot)
    seen = []
    for seed in range(4):
        parameters = random_parameters(robot, num, seed)
        for simulation in simulations:
            simulation.set_parameters(None, parameters)
        theirs, ours = (simulation.dynamics() for simulation in simulations)
        for field in dataclasses.fields(ours):
            value = getattr(theirs, field.name)
            np.testing.assert_allclose(
                getattr(ours, field.name),
                value,
                rtol=0,
                atol=1e-10 * max(1, np.abs(value).max()),
                err_msg=field.name,
            )
        for n in range(num):
            own = own_chain(chain(robot), simulations[1].plant, n)
            frames = forward_kinematics(own, snapshot.position[n])
            np.testing.assert_allclose(
                mass_matrix(own, frames), ours.mass_matrix[n], rtol=1e-9, atol=1e-9
            )
            np.testing.assert_allclose(
                bias_force(own, frames, snapshot.velocity[n]),
                ours.bias_force[n],
                rtol=1e-9,
                atol=1e-9,
            )
        seen.append(ours.mass_matrix)
    assert min(np.abs(np.subtract(a, b)).max() for i, a in enumerate(seen) for b in seen[:i]) > 0.1


def test_pybullet_forgets_old_masses_however_many_there_were(
    make: Make, paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("backends.pybullet.equation._MOST_BODIES", 2)
    simulation = make("pybullet", paper)
    for factor in np.linspace(1, 3, 12):
        simulation.set_parameters(None, Parameters(base_mass=factor, link_mass=factor))
        sliders = sum(servo.mass for servo in paper.servos)
        expected = factor * (paper.total_mass - sliders) + sliders
        assert simulation.dynamics().mass_matrix[0, 0, 0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", shipped_robots())
def test_pybullet_steps_with_the_masses_of_each_copy(make: Make, name: str) -> None:
    """Without cables and dampers in play, one step is the equation of motion: nothing pushes but springs."""
    robot, num = load_robot(name), 3
    simulation = make("pybullet", robot, num)
    random = dataclasses.replace(
        random_parameters(robot, num), joint_damping=0, slider_damping=0, rest_length_offset=0.05
    )
    simulation.set_parameters(None, random)
    snapshot = simulation.get_snapshot()
    generator = np.random.default_rng(1)
    snapshot.position[:, 7 + robot.num_cables :] = generator.uniform(
        -0.05, 0.05, (num, robot.num_hinges)
    )
    snapshot.velocity[:] = generator.normal(size=snapshot.velocity.shape) * 0.3
    simulation.set_snapshot(snapshot)
    equation = simulation.dynamics()
    simulation.step(np.zeros((num, robot.num_cables)))
    np.testing.assert_allclose(simulation.state().cable_tension, 0, atol=1e-9)
    load = equation.passive_force - equation.bias_force
    expected = (
        snapshot.velocity
        + robot.time_step * np.linalg.solve(equation.mass_matrix, load[..., None])[..., 0]
    )
    np.testing.assert_allclose(simulation.get_snapshot().velocity, expected, rtol=1e-8, atol=1e-8)


def test_engines_move_alike_with_the_same_parameters(make: Make, paper: Robot) -> None:
    """As near as they are without any; where the parameters take the tip is much further apart."""
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
