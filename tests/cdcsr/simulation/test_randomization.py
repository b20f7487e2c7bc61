"""Domain randomization: its ranges, which copies get new plants, and what it must not change."""

from __future__ import annotations

import numpy as np
import pytest

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.routing import routing
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.randomization import COMMAND_DELAY, FACTORS, REST_LENGTH_OFFSET, Randomization


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("planar-single")


def _randomization(robot: Robot, num: int, scale: float, seed: int = 0) -> Randomization:
    return Randomization(robot, num, scale, np.random.default_rng(seed))


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_draws_fill_their_ranges(robot: Robot, scale: float) -> None:
    num = 2000
    randomization = _randomization(robot, num, scale)
    drawn = randomization.draw(num)
    for name, width in FACTORS.items():
        logarithm = np.log(drawn[name]) / (scale * np.log(width))
        assert 0.97 < logarithm.max() <= 1
        assert -1 <= logarithm.min() < -0.97
        # Four standard errors of the mean of a uniform variable.
        assert abs(logarithm.mean()) < 4 / np.sqrt(3 * num)
    offset = drawn["rest_length_offset"]
    assert 0.99 * scale * REST_LENGTH_OFFSET < np.abs(offset).max() <= scale * REST_LENGTH_OFFSET
    assert set(drawn["command_delay"]) == set(range(round(scale * COMMAND_DELAY) + 1))


def test_cables_of_a_small_robot_differ_by_as_much_less() -> None:
    """The pitch radius of the arm of 0.12 m is a twentieth of the paper's, 20 mm."""
    offset = _randomization(load_robot("bench-arm"), 200, 1.0).draw(200)["rest_length_offset"]
    assert 0.99e-3 < np.abs(offset).max() <= 1e-3


def test_soft_cables_stretch_and_nothing_else_changes(robot: Robot) -> None:
    """All cables of a copy stretch alike, by up to 1e-4 of their length for each newton."""
    plain = _randomization(robot, 500, 1.0).draw(500)
    random = np.random.default_rng(0)
    soft = Randomization(robot, 500, 1.0, random, softness=2.0).draw(500)
    strain = soft.pop("cable_strain")
    assert strain.shape == (500, robot.num_cables)
    assert (strain == strain[:, :1]).all()
    assert 0 <= strain.min() < 2e-6
    assert 1.98e-4 < strain.max() <= 2e-4
    assert plain.keys() == soft.keys()
    for name, values in plain.items():
        np.testing.assert_array_equal(values, soft[name])


def test_a_softened_cable_stretches_by_its_tension_in_a_simulation(robot: Robot) -> None:
    simulation = make_simulation(robot, "mujoco", 2)
    randomization = Randomization(robot, 2, 0.0, np.random.default_rng(3), softness=1.0)
    randomization.begin(simulation, np.arange(2))
    command = np.zeros((2, robot.num_cables))
    command[:, 0] = -1.0
    simulation.step(command, 2000)
    excess = simulation.dynamics().cable_length[:, 0] - routing(robot).rest_length[0]
    tension = simulation.state().cable_tension[:, 0]
    simulation.close()
    assert (tension > 1).all()
    strain = randomization.drawn["cable_strain"][:, 0]
    np.testing.assert_allclose(excess, strain * routing(robot).rest_length[0] * tension, rtol=1e-3)
    assert excess[0] != excess[1]


def test_only_copies_that_begin_an_episode_get_a_new_plant(robot: Robot) -> None:
    simulation = make_simulation(robot, "mujoco", 4)
    randomization = _randomization(robot, 4, 1.0)
    randomization.begin(simulation, np.arange(4))
    before = simulation.plant.link_mass.copy()
    randomization.begin(simulation, np.array([1, 3]))
    changed = (simulation.plant.link_mass != before).any(axis=1)
    assert changed.tolist() == [False, True, False, True]
    masses = [link.mass for link, _ in robot.links]
    expected = randomization.drawn["link_mass"][:, None] * masses
    np.testing.assert_allclose(simulation.plant.link_mass, expected, rtol=1e-15)
    simulation.close()


def test_targets_do_not_depend_on_randomization(robot: Robot) -> None:
    targets = []
    for randomization in (None, _randomization(robot, 3, 1.0)):
        env = TaskVectorEnv(3, robot, max_steps=2, randomization=randomization)
        env.reset(seed=5)
        first = env.targets.copy()
        for _ in range(2):  # with the second step all episodes end, and the next begin
            env.step(np.zeros((3, robot.num_cables)))
        targets.append([first, env.targets.copy()])
        env.close()
    np.testing.assert_array_equal(targets[0], targets[1])
    assert (targets[0][0] != targets[0][1]).any()


@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_scale_zero_changes_no_bit_and_scale_one_does(robot: Robot, scale: float) -> None:
    commands = np.random.default_rng(1).uniform(-1, 0, (20, 2, robot.num_cables))
    observations = []
    for randomization in (None, _randomization(robot, 2, scale)):
        env = TaskVectorEnv(2, robot, randomization=randomization)
        env.reset(seed=0)
        observations.append(np.array([env.step(command)[0] for command in commands]))
        env.close()
    assert np.array_equal(*observations) == (scale == 0)


def test_restored_plants_are_those_that_were_in_force(robot: Robot) -> None:
    simulations = [make_simulation(robot, "mujoco", 3) for _ in range(2)]
    old, new = _randomization(robot, 3, 1.0, 1), _randomization(robot, 3, 1.0, 2)
    for randomization, simulation in zip((old, new), simulations, strict=True):
        randomization.begin(simulation, np.arange(3))
    new.restore(simulations[1], old.drawn)
    for mine, other in zip(simulations[0].plant, simulations[1].plant, strict=True):
        np.testing.assert_array_equal(mine, other)
    commands = np.random.default_rng(1).uniform(-1, 0, (10, 3, robot.num_cables))
    for simulation in simulations:  # command delays are in force too
        simulation.reset()
        for command in commands:
            simulation.step(command)
    positions = [simulation.get_snapshot().position for simulation in simulations]
    np.testing.assert_array_equal(positions[0], positions[1])
    for simulation in simulations:
        simulation.close()


@pytest.mark.parametrize("scale", [-0.1, 5.1, float("nan")])
def test_a_scale_outside_its_range_is_refused(robot: Robot, scale: float) -> None:
    with pytest.raises(CdcsrError, match=r"must lie in \[0, 5\]"):
        _randomization(robot, 1, scale)


def test_cables_shorter_than_their_sliders_room_are_refused(robot: Robot) -> None:
    segment = robot.segments[0]
    tight = segment.model_copy(
        update={"own_servo": segment.servo.model_copy(update={"offset": 0.03})}
    )
    with pytest.raises(
        CdcsrError, match=r"by up to 0\.04 m, and the sliders .* have room for 0\.02 m"
    ):
        _randomization(robot.model_copy(update={"segments": (tight, *robot.segments[1:])}), 1, 2.0)
