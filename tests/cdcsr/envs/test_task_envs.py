"""Invariants of every task in every engine; an environment resumes from its state to the bit."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from cdcsr.envs.disturbances import Disturbances
from cdcsr.envs.gym_env import Info, TaskVectorEnv
from cdcsr.envs.options import EnvOptions
from cdcsr.envs.rng_state import pack_generator, unpack_generator
from cdcsr.envs.single_env import TaskEnv
from cdcsr.errors import CdcsrError
from cdcsr.simulation.contract import Array
from cdcsr.simulation.plant import Parameters
from cdcsr.tasks.catalogue import TASKS
from cdcsr.tasks.observation import DISTANCE, TARGET, TIP_POSITION, observation_size
from tests.support.engines import each_engine

engines = pytest.mark.parametrize("backend", each_engine())
every_task = pytest.mark.parametrize("task", TASKS)
_SMALL = "planar-single"


@pytest.mark.parametrize(
    ("name", "arguments", "task", "steps"),
    [
        ("Reach", {}, "reach", 250),
        ("Capture", {}, "capture", 500),
        ("Capture", {"motion": "tumble"}, "capture-tumble", 500),
        ("Capture", {"max_steps": 80}, "capture", 80),
        ("Follow", {}, "follow-line", 1000),
        ("Follow", {"motion": "circle"}, "follow-circle", 1000),
    ],
)
def test_ids_give_tasks(name: str, arguments: Info, task: str, steps: int) -> None:
    one = gymnasium.make(f"cdcsr/{name}-v0", robot=_SMALL, **arguments).unwrapped
    many = gymnasium.make_vec(f"cdcsr/{name}-v0", num_envs=2, robot=_SMALL, **arguments)
    assert isinstance(one, TaskEnv)
    for env in (one.batch, many):
        assert isinstance(env, TaskVectorEnv)
        assert env.task.name == task
        assert env.max_actions == steps
        env.close()


@engines
@every_task
def test_the_target_moves_and_the_policy_observes_its_position(task: str, backend: str) -> None:
    """The path does not depend on the number of steps in an action."""
    seen: list[Array] = []
    for skip in (1, 4):
        env = TaskVectorEnv(3, _SMALL, backend, task=task, frame_skip=skip)
        observation, info = env.reset(seed=3)
        rows = [observation[:, TARGET]]
        for _ in range(40 // skip):
            observation, _, terminated, truncated, info = env.step(
                np.zeros((3, env.robot.num_cables))
            )
            assert not (terminated | truncated).any()
            np.testing.assert_array_equal(observation[:, TARGET], env.targets)
            distance = np.linalg.norm(observation[:, TIP_POSITION] - env.targets, axis=1)
            np.testing.assert_allclose(observation[:, DISTANCE], distance, atol=1e-12)
            np.testing.assert_array_equal(info["distance"], observation[:, DISTANCE])
            rows.append(observation[:, TARGET])
        seen.append(np.array(rows))
        assert observation.shape == (3, observation_size(env.robot))
        env.close()
    np.testing.assert_allclose(seen[0][::4], seen[1], rtol=0, atol=1e-12)
    assert (seen[0][0] != seen[0][-1]).any() == (TASKS[task].motion != "rest")


@engines
@every_task
def test_an_environment_goes_on_from_its_state_to_the_bit(task: str, backend: str) -> None:
    """With late and noisy observations, late commands, and episodes that end meanwhile."""
    arguments: EnvOptions = {
        "backend": backend,
        "task": task,
        "max_steps": 12,
        "disturbances": Disturbances(
            action_noise=0.1, base_noise=0.01, packet_loss=0.3, observation_delay=2
        ),
        "robot": _SMALL,
    }
    first, second = TaskVectorEnv(3, **arguments), TaskVectorEnv(3, **arguments)
    for env in (first, second):
        env.simulation.set_parameters(range(3), Parameters(command_delay=np.array([0, 2, 3])))
    actions = np.random.default_rng(0).uniform(-3, 0, (40, 3, first.robot.num_cables))
    first.reset(seed=1)
    # Episodes of different copies end at different times.
    first.reset(options={"reset_mask": [True, False, False]})
    for action in actions[:17]:
        first.step(action)
    state = first.get_state()
    assert all(isinstance(rows, np.ndarray) and rows.dtype.kind in "fi" for rows in state.values())
    kept = {name: rows.copy() for name, rows in state.items()}
    second.set_state(state)
    for action in actions[17:]:
        ours, theirs = first.step(action), second.step(action)
        tolerance = 0.0 if backend == "mujoco" else 1e-9
        for a, b in zip(ours[:4], theirs[:4], strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)
        assert ours[4].keys() == theirs[4].keys()
        np.testing.assert_allclose(
            ours[4]["distance"], theirs[4]["distance"], rtol=0, atol=tolerance
        )
    for name, rows in kept.items():
        np.testing.assert_array_equal(rows, state[name])  # a state does not change later
    first.close()
    second.close()


def test_there_is_no_state_before_the_first_episode() -> None:
    env = TaskVectorEnv(1, _SMALL)
    with pytest.raises(CdcsrError, match="no state before its first reset"):
        env.get_state()
    env.close()


def test_a_restored_generator_draws_the_same_numbers() -> None:
    rng, other = np.random.default_rng(5), np.random.default_rng(6)
    rng.integers(10, dtype=np.int32)  # half of a 64-bit draw is left
    unpack_generator(other, pack_generator(rng))
    assert other.bit_generator.state == rng.bit_generator.state
    np.testing.assert_array_equal(other.random(5), rng.random(5))


@engines
def test_capture_of_a_target_at_the_idle_tip(backend: str) -> None:
    """It takes 40 steps, or 5 actions of 8 steps; the next episode counts from zero."""
    for skip, actions in ((1, 40), (8, 5)):
        env = TaskVectorEnv(2, backend=backend, task="capture", frame_skip=skip)
        _, info = env.reset(options={"targets": np.array([[0, 0, 2.7], [0, 1, 1]])})
        for k in range(1, actions + 1):
            _, reward, terminated, _, info = env.step(np.zeros((2, 8)))
            assert terminated.tolist() == [k == actions, False]
            assert reward.tolist() == [float(k == actions), 0.0]
            assert info["on_target"].tolist() == [True, False]
            np.testing.assert_allclose(info["dwelt"], [k * skip * 0.0025, 0])
        assert info["final_info"]["is_success"].tolist() == [True, False]
        assert env.step(np.zeros((2, 8)))[4]["dwelt"].tolist() == [0, 0]
        env.close()


@engines
def test_follow_ends_when_time_is_up_and_reports_success(backend: str) -> None:
    """One idle tip is on a target at rest, and one is not."""
    env = TaskVectorEnv(
        2, backend=backend, task="follow-line", motion="rest", max_steps=300, frame_skip=10
    )
    env.reset(options={"targets": np.array([[0, 0, 2.7], [0, 1, 1]])})
    total, info = np.zeros(2), {}
    for k in range(1, 31):
        _, reward, terminated, truncated, info = env.step(np.zeros((2, 8)))
        total += reward
        assert not terminated.any()
        assert truncated.tolist() == [k == 30] * 2
    assert total.tolist() == [30, 0]
    assert info["final_info"]["is_success"].tolist() == [True, False]
    np.testing.assert_allclose(info["final_info"]["share_on_target"], [1, 0])
    np.testing.assert_allclose(info["base_position_error"], 0, atol=1e-9)
    env.close()
