"""The scripted demonstrator: its prediction, its bounds, and that it reaches."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import backend_names
from controllers.jacobian import JacobianController
from controllers.rollout import rollout
from tests.support.controllers import Stepper


@pytest.mark.parametrize("backend", backend_names())
@pytest.mark.parametrize(
    ("robot", "least"), [("paper", 8), ("three-segment", 8), ("three-cable", 7)]
)
def test_reaches_anchor_targets(backend: str, robot: str, least: int) -> None:
    env = TaskVectorEnv(8, robot, backend, "anchor", autoreset_mode="Disabled")
    observation, _ = env.reset(seed=4)
    result = rollout(JacobianController(env.robot), env, observation)
    env.close()
    assert result.success.sum() >= least


def test_planar_robot_stays_in_its_plane() -> None:
    env = TaskVectorEnv(10, "planar-single", "mujoco", "anchor", autoreset_mode="Disabled")
    observation, _ = env.reset(seed=4)
    result = rollout(JacobianController(env.robot), env, observation)
    assert result.success.all()
    assert np.abs(result.observations[:, :, 1]).max() < 1e-6


@pytest.mark.parametrize("backend", backend_names())
def test_predicts_the_tip_velocity_of_the_next_step(backend: str) -> None:
    """With the tensions of a step, the prediction before it gives the velocity after it."""
    env = TaskVectorEnv(1, "paper", backend, "anchor", autoreset_mode="Disabled")
    controller = JacobianController(env.robot)
    stepper = Stepper(controller, env, seed=1)
    errors, speeds = [], []
    for _ in range(60):
        offset, slope = controller._predict(env.simulation.dynamics(), env.robot.time_step)
        stepper.step()
        state = env.simulation.state()
        predicted = offset[0] + slope[0] @ state.cable_tension[0]
        errors.append(np.linalg.norm(predicted - state.tip_velocity[0]))
        speeds.append(np.linalg.norm(state.tip_velocity[0]))
    env.close()
    assert np.mean(errors[5:]) < 0.02 * np.max(speeds)


def test_tensions_are_the_bounded_optimum() -> None:
    robot = load_robot("paper")
    controller = JacobianController(robot, regularization=1e-4)
    rng = np.random.default_rng(0)
    limit = np.array([servo.gain * servo.eta for servo in robot.servos])
    for scale in (1.0, 100.0):  # the second wants more than the servos can give
        slope, wish = rng.normal(size=(3, 8)) * 0.05, rng.normal(size=3) * scale
        found = controller._tensions(slope, wish)

        def cost(t: np.ndarray, slope: np.ndarray = slope, wish: np.ndarray = wish) -> float:
            return float(np.sum((slope @ t - wish) ** 2) + 1e-4 * t @ t)

        best = minimize(cost, np.full(8, 10.0), bounds=[(0, x) for x in limit], tol=1e-12)
        assert (found >= 0).all()
        assert (found <= limit + 1e-9).all()
        assert cost(found) <= best.fun * (1 + 1e-6) + 1e-9
