"""Random streams of an environment do not disturb each other; plants and moving targets act."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cdcsr.envs.disturbances import Channel, Disturbances
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import load_robot
from cdcsr.simulation.contract import Array
from cdcsr.simulation.engines import backend_names, make_simulation
from cdcsr.simulation.plant import Parameters
from cdcsr.simulation.randomization import Randomization
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import BASE_POSITION, CABLE_TRAVEL, TIP_POSITION, observation_size
from cdcsr.tasks.spaces import make_space

SMALL = load_robot("planar-single")
ALL = Disturbances(action_noise=0.1, base_noise=0.01, packet_loss=0.3, observation_delay=2)


def targets(disturbances: Disturbances | None, seed: int, episodes: int) -> list[Array]:
    """Return the targets of two copies in one episode after the other."""
    env = TaskVectorEnv(2, SMALL, max_steps=3, disturbances=disturbances)
    env.reset(seed=seed)
    found = [env.targets.copy()]
    for _ in range(3 * (episodes - 1)):
        _, _, terminated, truncated, _ = env.step(np.zeros((2, SMALL.num_cables)))
        if (terminated | truncated).all():
            found.append(env.targets.copy())
    env.close()
    return found


@pytest.mark.parametrize("seed", [0, 5])
@pytest.mark.parametrize("disturbances", [None, ALL])
def test_targets_depend_on_the_seed_and_not_on_disturbances(
    seed: int, disturbances: Disturbances | None
) -> None:
    """In the first episode and in later ones; the test draws them again."""
    rng, space = np.random.default_rng(seed), make_space("anchor", SMALL)
    expected = [space.sample(rng, 2) for _ in range(4)]
    np.testing.assert_array_equal(targets(disturbances, seed, 4), expected)


@pytest.mark.parametrize("seed", [0, 5])
def test_the_same_seed_again_repeats_the_disturbances(seed: int) -> None:
    env, runs = TaskVectorEnv(2, SMALL, disturbances=ALL), []
    for _ in range(2):
        first, _ = env.reset(seed=seed)
        runs.append([first, *(env.step(np.full((2, SMALL.num_cables), -1.0))[0] for _ in range(8))])
    env.close()
    np.testing.assert_array_equal(runs[0], runs[1])


@pytest.mark.parametrize("frame_skip", [1, 4])
def test_a_target_moves_by_the_time_step_of_its_robot(frame_skip: int) -> None:
    robot = SMALL.model_copy(update={"time_step": 0.001})
    env = TaskVectorEnv(
        3, robot, task="follow-line", frame_skip=frame_skip, autoreset_mode="Disabled"
    )
    env.reset(seed=1)
    start, velocity = env.targets.copy(), env.target_velocity.copy()
    for _ in range(10):
        env.step(np.zeros((3, robot.num_cables)))
    np.testing.assert_allclose(
        env.targets, start + velocity * 10 * frame_skip * 0.001, rtol=0, atol=1e-12
    )
    env.close()


@pytest.mark.parametrize(("speed", "expected"), [(0.04, False), (0.11, True)])
def test_a_task_judges_the_speed_relative_to_the_target(speed: float, expected: bool) -> None:
    """The tip is idle, and the target passes it at 0.05 to 0.1 m/s."""
    task = replace(make_task("capture", motion="line"), speed=speed)
    env = TaskVectorEnv(2, SMALL, task=task, autoreset_mode="Disabled")
    observation, _ = env.reset(seed=0)
    _, info = env.reset(options={"targets": observation[:, TIP_POSITION]})
    assert info["on_target"].tolist() == [expected] * 2
    for _ in range(5):
        *_, info = env.step(np.zeros((2, SMALL.num_cables)))
        assert (info["distance"] <= 0.03).all()
        assert info["on_target"].tolist() == [expected] * 2
    env.close()


def test_the_first_observation_is_repeated_until_a_late_one_arrives() -> None:
    """Its noise is not drawn again: noise belongs to the measurement, before the delay."""
    through = Channel(Disturbances(base_noise=0.1, observation_delay=3), np.random.default_rng(0))
    size = observation_size(load_robot("paper"))
    sent = np.arange(6 * 2 * size, dtype=float).reshape(6, 2, size)
    first = through.start(sent[0], np.ones(2, dtype=bool))
    assert (first[:, BASE_POSITION] != sent[0, :, BASE_POSITION]).all()
    for row in sent[1:4]:
        np.testing.assert_array_equal(through.observe(row), first)
    assert (through.observe(sent[4]) != first).any()


@pytest.mark.parametrize("backend", backend_names())
def test_an_episode_has_its_own_plant_from_the_first_step(backend: str) -> None:
    """Nothing of the previous plant is left, nor of the commands that were under way to it."""
    randomization = Randomization(SMALL, 2, 1.0, np.random.default_rng(0))
    env = TaskVectorEnv(2, SMALL, backend, max_steps=6, randomization=randomization)
    commands = np.random.default_rng(1).uniform(-3, 0, (6, 2, SMALL.num_cables))
    env.reset(seed=0)
    for _ in range(3):
        for command in commands:
            env.step(command)
        plain = make_simulation(SMALL, backend, 2)
        plain.set_parameters(
            None, Parameters(**{name: rows.copy() for name, rows in randomization.drawn.items()})
        )
        plain.reset()
        for command in commands[:5]:
            observation, *_ = env.step(command)
            plain.step(command)
            np.testing.assert_allclose(
                observation[:, TIP_POSITION], plain.state().tip_position, rtol=0, atol=1e-9
            )
            np.testing.assert_allclose(
                observation[:, CABLE_TRAVEL], plain.state().cable_travel, rtol=0, atol=1e-9
            )
        plain.close()
        env.step(commands[5])
    env.close()
