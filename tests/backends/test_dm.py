"""The dm_env interface: its conformance suite, equality with the Gymnasium environment, and what the viewer needs."""

from __future__ import annotations

import unittest
from collections.abc import Generator, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from dm_control.rl import control
from dm_control.viewer import runtime
from dm_env import StepType, TimeStep, test_utils

import cdcsr  # noqa: F401 (makes the environment known to Gymnasium)
from backends.dm_env import MujocoPhysics, make_dm_environment
from cdcsr.errors import CdcsrError, Diverged
from cdcsr.simulation.contract import Array

BACKENDS = ("mujoco", "pybullet")
both = pytest.mark.parametrize("backend", BACKENDS)


class Conformance(test_utils.EnvironmentTestMixin):
    backend: str

    def make_object_under_test(self, **_: Any) -> control.Environment:
        return make_dm_environment(backend=self.backend, max_steps=10)

    def make_action_sequence(self) -> Generator[Any, Any, None]:
        """Over the end of one episode and into the next."""
        for _ in range(14):
            yield self.make_action()


class MujocoConformanceTest(Conformance, unittest.TestCase):
    backend = "mujoco"


class PybulletConformanceTest(Conformance, unittest.TestCase):
    backend = "pybullet"


def joined(step: TimeStep) -> Array:
    return np.concatenate(list(step.observation.values()))


@both
@pytest.mark.parametrize("frame_skip", [1, 4])
def test_it_is_the_gymnasium_environment(backend: str, frame_skip: int) -> None:
    """To the bit, with the same seed; in a second episode too, and beyond the action's bounds."""
    kwargs = {"backend": backend, "frame_skip": frame_skip, "max_steps": 40, "reward": "dense"}
    ours = make_dm_environment(seed=7, **kwargs)
    theirs = gymnasium.make("cdcsr/Reach-v0", **kwargs)
    rng = np.random.default_rng(0)
    for episode in range(2):
        step = ours.reset()
        seed, options = (
            (7, None) if episode == 0 else (None, {"target": step.observation["target"]})
        )
        observation, _ = theirs.reset(seed=seed, options=options)
        np.testing.assert_array_equal(joined(step), observation)
        while not step.last():
            action = rng.uniform(-6, 1, 8)
            step = ours.step(action)
            observation, reward, terminated, truncated, _ = theirs.step(action)
            np.testing.assert_array_equal(joined(step), observation)
            assert step.reward == reward
            assert step.last() == (terminated or truncated)
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
    env = make_dm_environment(robot)
    spec = env.action_spec()
    eta = [servo.eta for servo in env.physics.simulation.robot.servos]
    np.testing.assert_array_equal(spec.minimum, -np.array(eta))
    np.testing.assert_array_equal(spec.maximum, np.zeros(len(eta)))
    env.close()


@both
def test_success_ends_with_discount_0_and_time_with_1(backend: str) -> None:
    far, near = (
        make_dm_environment(backend=backend, max_steps=11, frame_skip=5),
        make_dm_environment(threshold=9.0),
    )
    far.reset()
    steps = [far.step(np.zeros(8)) for _ in range(2)]
    assert [(s.step_type, s.discount, s.reward) for s in steps] == [
        (StepType.MID, 1.0, 0.0),
        (StepType.LAST, 1.0, 0.0),
    ]
    assert far.physics.time() == pytest.approx(2 * 5 * 0.0025)
    near.reset()
    step = near.step(np.zeros(8))
    assert (step.step_type, step.discount, step.reward) == (StepType.LAST, 0.0, 1.0)
    far.close()
    near.close()


def test_success_with_the_last_action_is_success() -> None:
    env = make_dm_environment(max_steps=1, threshold=9.0)
    env.reset()
    assert env.step(np.zeros(8)).discount == 0.0
    env.close()


def test_seed_decides_the_targets() -> None:
    def targets(seed: int) -> list[tuple[float, ...]]:
        env = make_dm_environment(seed=seed)
        found = [tuple(env.reset().observation["target"]) for _ in range(3)]
        env.close()
        return found

    assert targets(1) == targets(1)
    assert len({*targets(1), *targets(2)}) == 6


def test_divergence_is_dm_controls_error(monkeypatch: pytest.MonkeyPatch) -> None:
    env = make_dm_environment(backend="pybullet")
    env.reset()

    def diverge(*_: object) -> None:
        raise Diverged("pybullet", 0, 0.5, "a speed of 1e+09")

    monkeypatch.setattr(env.physics.simulation, "step", diverge)
    with pytest.raises(control.PhysicsError, match=r"copy 0 diverged at t = 0\.5000 s"):
        env.step(np.zeros(8))
    env.close()


def test_mistakes_are_told() -> None:
    with pytest.raises(CdcsrError, match="frame_skip must be between 1 and max_steps"):
        make_dm_environment(frame_skip=0)
    with pytest.raises(CdcsrError, match="Did you mean 'pybullet'"):
        make_dm_environment(backend="pybulet")


# --- what dm_control's viewer and wrappers ask of the physics ----------------------------------------------------


@pytest.fixture
def viewed() -> Iterator[control.Environment]:
    env = make_dm_environment(max_steps=20)
    yield env
    env.close()


def test_the_viewer_runs_an_episode(viewed: control.Environment) -> None:
    """Its runtime steps until the episode ends, and starts another one on the same data."""
    errors, reloads = [], []
    run = runtime.Runtime(viewed, policy=lambda _: np.full(8, -1.0))
    run.on_error += errors.append
    run.on_physics_changed += lambda: reloads.append(True)
    run.tick(0.02, paused=False)
    assert run.state is runtime.State.RUNNING
    assert run.get_time() == pytest.approx(0.02)  # frames are paid for in time of `data`
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


def test_data_shows_the_robot_and_the_target(viewed: control.Environment) -> None:
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


def test_a_force_of_the_viewers_mouse_acts(viewed: control.Environment) -> None:
    """10 N on the whole robot for one step: momentum is force times time."""
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


def test_a_pose_set_while_resetting_is_where_the_robot_starts(viewed: control.Environment) -> None:
    physics = viewed.physics
    assert isinstance(physics, MujocoPhysics)
    with physics.reset_context():
        physics.named.data.qpos["base"][:3] = [0.5, 0, 0]
    np.testing.assert_allclose(physics.measured.tip_position, [[0.5, 0, 2.7]])
    np.testing.assert_allclose(physics.named.data.site_xpos["tip"], [0.5, 0, 2.7])
