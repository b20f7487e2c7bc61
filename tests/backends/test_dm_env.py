"""The dm_env interface: its conformance suite, equality with the Gymnasium environment, and what
the viewer needs."""

from __future__ import annotations

import itertools
import unittest
from collections.abc import Generator, Iterator
from typing import Any

import numpy as np
import pytest
from dm_control.rl import control
from dm_control.viewer import runtime
from dm_env import StepType, TimeStep, test_utils

from backends.dm_env import MujocoPhysics, TaskEnvironment, make_dm_environment
from cdcsr.envs.single_env import TaskEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.simulation.contract import Array
from cdcsr.simulation.engines import backend_names
from cdcsr.tasks.catalogue import TASKS

_SMALL, _SAMPLE = "planar-single", ("capture-tumble", "pybullet")


class Conformance(test_utils.EnvironmentTestMixin, unittest.TestCase):
    __test__ = False
    task: str
    backend: str

    def make_object_under_test(self, **_: object) -> control.Environment:
        return make_dm_environment(self.task, _SMALL, self.backend, max_steps=10)

    def make_action_sequence(self) -> Generator[Any, Any, None]:  # the type of the base class
        """Act over the end of one episode and into the next."""
        for _ in range(14):
            yield self.make_action()


@pytest.mark.parametrize(
    ("task", "backend"),
    [
        pytest.param(*case, marks=[] if "mujoco" in case or case == _SAMPLE else [pytest.mark.slow])
        for case in itertools.product(TASKS, backend_names())
    ],
)
def test_every_task_passes_the_suite_of_dm_env(task: str, backend: str) -> None:
    case = type("Case", (Conformance,), {"task": task, "backend": backend})
    result = unittest.TestResult()
    unittest.defaultTestLoader.loadTestsFromTestCase(case).run(result)
    assert result.testsRun >= 4
    assert [text for _, text in (*result.errors, *result.failures)] == []


def joined(step: TimeStep) -> Array:
    return np.concatenate(list(step.observation.values()))


@pytest.mark.parametrize(("threshold", "frame_skip"), [(None, 1), (9.0, 4)])
@pytest.mark.parametrize("task", TASKS)
def test_every_task_is_that_of_gymnasium(
    engine: str, task: str, threshold: float | None, frame_skip: int
) -> None:
    """The same seed and the same commands give the same bits, in two episodes, the first of which
    begins at rest. With a threshold of 9 m every task that ends succeeds."""
    robot = load_robot("paper")
    options = {"frame_skip": frame_skip, "max_steps": 40, "threshold": threshold, "reward": "dense"}
    ours = make_dm_environment(task, robot, engine, seed=7, **options)
    theirs = TaskEnv(task=task, robot=robot, backend=engine, **options)
    rng, ends = np.random.default_rng(0), []
    for episode in range(2):
        step = ours.reset()
        observation, _ = theirs.reset(seed=None if episode else 7)
        np.testing.assert_array_equal(joined(step), observation)
        for _ in range(50):
            action = rng.uniform(-6, 1, 8) * episode
            step = ours.step(action)
            observation, reward, terminated, truncated, _ = theirs.step(action)
            np.testing.assert_array_equal(joined(step), observation)
            assert step.reward == reward
            assert step.last() == (terminated or truncated)
            if step.last():
                assert step.discount == (0.0 if terminated else 1.0)
                ends.append(terminated)
                break
    assert ends[0] == (threshold is not None and TASKS[task].ends)
    assert len(ends) == 2
    ours.close()
    theirs.close()


def test_observation_has_the_parts_of_eq_1_by_name_or_flat() -> None:
    flat, parts = make_dm_environment(flat_observation=True), make_dm_environment()
    assert {name: spec.shape for name, spec in parts.observation_spec().items()} == {
        "tip_position": (3,),
        "tip_velocity": (3,),
        "target": (3,),
        "distance": (1,),
        "base_position": (3,),
        "base_quaternion": (4,),
        "base_velocity": (3,),
        "base_angular_velocity": (3,),
        "cable_travel": (8,),
    }
    np.testing.assert_array_equal(flat.reset().observation["observations"], joined(parts.reset()))
    flat.close()
    parts.close()


@pytest.mark.parametrize("robot", ["paper", "planar-single"])
def test_actions_are_bounded_by_eta(robot: str) -> None:
    env = make_dm_environment(robot=robot)
    spec = env.action_spec()
    eta = [servo.eta for servo in env.physics.simulation.robot.servos]
    np.testing.assert_array_equal(spec.minimum, -np.array(eta))
    np.testing.assert_array_equal(spec.maximum, np.zeros(len(eta)))
    env.close()


def test_time_ends_an_episode_with_discount_1(engine: str) -> None:
    env = make_dm_environment(backend=engine, max_steps=11, frame_skip=5)
    env.reset()
    steps = [env.step(np.zeros(8)) for _ in range(2)]
    assert [(s.step_type, s.discount, s.reward) for s in steps] == [
        (StepType.MID, 1.0, 0.0),
        (StepType.LAST, 1.0, 0.0),
    ]
    assert env.physics.time() == pytest.approx(2 * 5 * 0.0025)
    env.close()


def test_success_with_the_last_action_is_success() -> None:
    env = make_dm_environment(max_steps=1, threshold=9.0)
    env.reset()
    step = env.step(np.zeros(8))
    assert (step.step_type, step.discount, step.reward) == (StepType.LAST, 0.0, 1.0)
    env.close()


def test_seed_decides_the_targets() -> None:
    def targets(seed: int) -> list[tuple[float, ...]]:
        env = make_dm_environment(seed=seed)
        found = [tuple(env.reset().observation["target"]) for _ in range(3)]
        env.close()
        return found

    assert targets(1) == targets(1)
    assert len({*targets(1), *targets(2)}) == 6


def test_divergence_is_an_error_of_dm_control() -> None:
    env = make_dm_environment(backend="pybullet")
    env.reset()
    snapshot = env.physics.simulation.get_snapshot()
    snapshot.velocity[0, -1] = 1e6
    env.physics.simulation.set_snapshot(snapshot)
    with pytest.raises(control.PhysicsError, match=r"copy 0 diverged at t = 0\.0025 s"):
        env.step(np.zeros(8))
    env.close()


def test_mistakes_are_errors() -> None:
    with pytest.raises(CdcsrError, match="frame_skip must be a whole number from 1 to"):
        make_dm_environment(frame_skip=0)
    with pytest.raises(CdcsrError, match="Did you mean 'pybullet'"):
        make_dm_environment(backend="pybulet")
    with pytest.raises(CdcsrError, match="Did you mean 'capture'"):
        make_dm_environment("captur")


# --- what the viewer and the wrappers of dm_control ask of the physics ----------------------------


@pytest.fixture
def viewed() -> Iterator[TaskEnvironment]:
    env = make_dm_environment(max_steps=20)
    yield env
    env.close()


def test_the_viewer_runs_an_episode(viewed: TaskEnvironment) -> None:
    """Its runtime steps until the episode ends, and begins another one on the same data."""
    errors, reloads = [], []
    run = runtime.Runtime(viewed, policy=lambda _: np.full(8, -1.0))
    run.on_error += errors.append
    run.on_physics_changed += lambda: reloads.append(True)
    run.tick(0.02, paused=False)
    assert run.state is runtime.State.RUNNING
    assert run.get_time() == pytest.approx(0.02)  # by the time in `data`
    run.tick(0.02, paused=True)
    assert run.get_time() == pytest.approx(0.02)
    run.tick(0.2, paused=False)
    assert run.state is runtime.State.STOPPED
    assert run.get_time() == pytest.approx(20 * 0.0025)
    run.restart()
    run.tick(0.01, paused=False)
    assert run.get_time() == pytest.approx(0.01)
    assert not errors
    assert not reloads


def test_data_shows_the_robot_and_the_target(viewed: TaskEnvironment) -> None:
    viewed.reset()
    pull = np.array([-5.0, 0, 0, 0, 0, 0, 0, 0])
    viewed.step(pull)
    step = viewed.step(pull)
    data, simulation = viewed.physics.named.data, viewed.physics.simulation
    np.testing.assert_array_equal(data.site_xpos["target"], step.observation["target"])
    assert viewed.physics.named.model.site_size["target", 0] == 0.03
    np.testing.assert_allclose(data.site_xpos["tip"], step.observation["tip_position"], atol=1e-15)
    np.testing.assert_array_equal(data.ctrl, pull)
    np.testing.assert_array_equal(viewed.physics.data.qpos, simulation.get_snapshot().position[0])
    assert step.observation["cable_travel"][0] < 0
    target = viewed.reset().observation["target"]
    np.testing.assert_array_equal(data.site_xpos["target"], target)
    np.testing.assert_array_equal(data.site_xpos["tip"], [0, 0, 2.7])


def test_a_moving_target_is_shown_where_it_is() -> None:
    env = make_dm_environment("follow-line")
    first = env.reset().observation["target"]
    step = env.step(np.zeros(8))
    shown = env.physics.named.data.site_xpos["target"]
    np.testing.assert_array_equal(shown, step.observation["target"])
    assert shown[2] < first[2]
    env.close()


def test_a_force_of_the_viewers_mouse_acts(viewed: TaskEnvironment) -> None:
    """10 N act on the whole robot for one step: momentum is force times time."""
    viewed.reset()
    viewed.physics.named.data.xfrc_applied["base", :3] = [10, 0, 0]
    viewed.step(np.zeros(8))
    viewed.physics.data.xfrc_applied[:] = 0
    after = viewed.physics.simulation.dynamics()
    momentum = (after.mass_matrix[0] @ after.velocity[0])[:3]
    np.testing.assert_allclose(momentum, [10 * 0.0025, 0, 0], atol=1e-6)
    viewed.step(np.zeros(8))
    later = viewed.physics.simulation.dynamics()
    np.testing.assert_allclose((later.mass_matrix[0] @ later.velocity[0])[:3], momentum, atol=1e-6)


def test_a_pose_set_while_resetting_is_where_the_robot_starts(viewed: TaskEnvironment) -> None:
    physics = viewed.physics
    assert isinstance(physics, MujocoPhysics)
    with physics.reset_context():
        physics.named.data.qpos["base"][:3] = [0.5, 0, 0]
    np.testing.assert_allclose(physics.measured.tip_position, [[0.5, 0, 2.7]])
    np.testing.assert_allclose(physics.named.data.site_xpos["tip"], [0.5, 0, 2.7])
