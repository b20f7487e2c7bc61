"""The scripted demonstrator: its prediction, its cost, its bounds, and that it reaches."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import backend_names, principal_engines
from controllers.jacobian import JacobianController
from controllers.rollout import rollout
from tests.support.controllers import Stepper
from tests.support.engines import each_engine
from tests.support.physics import with_parts


@pytest.mark.parametrize(
    ("robot", "least", "backend"),
    [
        param
        for case in (("paper", 8), ("three-segment", 8), ("three-cable", 7))
        for param in each_engine(*case)
    ],
)
def test_reaches_anchor_targets(backend: str, robot: str, least: int) -> None:
    env = TaskVectorEnv(8, robot, backend, "anchor", autoreset_mode="Disabled")
    observation, _ = env.reset(seed=4)
    result = rollout(JacobianController(env.robot), env, observation)
    env.close()
    assert result.success.sum() >= least


@pytest.mark.parametrize("backend", principal_engines())
def test_reaches_targets_with_servos_that_are_told_a_length(backend: str) -> None:
    """They give way by 1 mm under 5 N, and a command of the tension as of a soft servo fails."""
    robot = with_parts(
        load_robot("paper"), servo={"kind": "displacement", "gain": 5e3, "eta": 0.05}
    )
    env = TaskVectorEnv(4, robot, backend, "anchor", autoreset_mode="Disabled")
    observation, _ = env.reset(seed=4)
    result = rollout(JacobianController(robot), env, observation)
    env.close()
    assert result.success.all()


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


Array = NDArray[np.float64]


@pytest.mark.parametrize("backend", backend_names())
def test_predicts_the_hinges_rates_of_the_next_step(backend: str) -> None:
    """With the tensions of a step, the prediction before it gives the rates after it."""
    env = TaskVectorEnv(1, "paper", backend, "anchor", task="capture", autoreset_mode="Disabled")
    controller = JacobianController(env.robot)
    stepper, errors, rates = Stepper(controller, env, seed=1), [], []
    for _ in range(60):
        offset, slope = controller._predict_hinges(env.simulation.dynamics(), env.robot.time_step)
        stepper.step()
        state = env.simulation.state()
        errors.append(
            np.linalg.norm(offset[0] + slope[0] @ state.cable_tension[0] - state.joint_rates[0])
        )
        rates.append(np.linalg.norm(state.joint_rates[0]))
    env.close()
    assert np.mean(errors[5:]) < 0.02 * np.max(rates)


@pytest.mark.parametrize(
    ("task", "frame_skip"), [("reach", 4), ("follow-line", 1), ("capture-drift", 4)]
)
def test_the_cost_of_tensions_is_that_of_missing_the_wish_and_of_moving_hinges(
    task: str, frame_skip: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    env = TaskVectorEnv(
        2, "paper", "mujoco", "anchor", task=task, frame_skip=frame_skip, autoreset_mode="Disabled"
    )
    controller = JacobianController(env.robot, gain=10.0, speed=0.8, calm=0.03, calm_within=0.2)
    stepper, rng = Stepper(controller, env, seed=2), np.random.default_rng(0)
    stepper.step(8)
    tip = env.simulation.state().tip_position
    # The first target is 7 cm away: 0.7 m/s. The other one is too far for its gain.
    env.targets[0] = tip[0] + [0.02, 0.03, 0.06]
    env.target_velocity[:] = [[0.01, 0.02, 0.03], [0.0, -0.1, 0.2]]
    asked: list[tuple[Array, Array]] = []
    tensions = controller._tensions

    def noted(slope: Array, wish: Array) -> Array:
        asked.append((slope, wish))
        return tensions(slope, wish)

    monkeypatch.setattr(controller, "_tensions", noted)
    stepper.command()
    dynamics, period = env.simulation.dynamics(), 0.0025 * frame_skip
    offset, slope = controller._predict(dynamics, period)
    rates, by_tension = controller._predict_hinges(dynamics, period)
    for i, (matrix, goal) in enumerate(asked):
        pull = rng.uniform(0, 50, env.robot.num_cables)
        error = env.targets[i] - tip[i]
        distance = np.linalg.norm(error)
        wanted = error / distance * min(10 * distance, 0.8) + env.target_velocity[i]
        cost = np.sum((offset[i] + slope[i] @ pull - wanted) ** 2)
        if task != "reach":
            weight = 0.03 * 0.2**2 / (0.2**2 + distance**2)
            cost += weight * np.sum((rates[i] + by_tension[i] @ pull) ** 2)
        assert np.sum((matrix @ pull - goal) ** 2) == pytest.approx(cost, rel=1e-9)
    env.close()
    assert len(asked) == 2
    assert (
        10 * np.linalg.norm(env.targets[0] - tip[0])
        < 0.8
        < 10 * np.linalg.norm(env.targets[1] - tip[1])
    )


def test_each_copy_is_given_its_own_command_whoever_else_acts() -> None:
    env = TaskVectorEnv(4, "paper", "mujoco", "anchor", autoreset_mode="Disabled")
    controller = JacobianController(env.robot)
    stepper = Stepper(controller, env, seed=5)
    stepper.step(10)
    whole = stepper.command()
    assert np.ptp(whole, axis=0).max() > 0.1
    some = np.array([False, True, False, True])
    part = stepper.command(some)
    np.testing.assert_allclose(part[some], whole[some], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(part[~some], 0)
    np.testing.assert_array_equal(stepper.command(np.zeros(4, dtype=bool)), 0)
    env.close()


@pytest.mark.parametrize("period", [0.0025, 0.05])
def test_the_prediction_is_an_implicit_step_of_springs_and_dampers(period: float) -> None:
    """Solve M (v+ - v) = h (forces at the hinges' next angles and rates - L^T t) for v+."""
    env = TaskVectorEnv(1, "paper", "mujoco", "anchor", task="capture", autoreset_mode="Disabled")
    controller = JacobianController(env.robot)
    Stepper(controller, env, seed=1).step(40)
    d, cables = env.simulation.dynamics(), env.robot.num_cables
    springs = [(joint.stiffness, joint.damping) for _, joint in env.robot.links for _ in range(2)]
    env.close()
    keep = [*range(6), *range(6 + cables, env.robot.num_coordinates)]
    stiffness, damping = np.zeros((2, len(keep)))
    stiffness[6:], damping[6:] = np.array(springs).T
    mass, rate, tension = (
        d.mass_matrix[0][np.ix_(keep, keep)],
        d.velocity[0, keep],
        np.linspace(0, 40, cables),
    )
    # The forces of springs and dampers at the next angles and rates are linear in v+.
    rest = (
        d.passive_force[0, keep]
        + damping * rate
        - d.bias_force[0, keep]
        - d.cable_jacobian[0][:, keep].T @ tension
    )
    after = np.linalg.solve(
        mass + np.diag(period * damping + period**2 * stiffness), mass @ rate + period * rest
    )
    offset, slope = controller._predict(d, period)
    np.testing.assert_allclose(
        offset[0] + slope[0] @ tension, d.tip_jacobian[0][:, keep] @ after, rtol=1e-9
    )
    offset, slope = controller._predict_hinges(d, period)
    np.testing.assert_allclose(offset[0] + slope[0] @ tension, after[6:], rtol=1e-8, atol=1e-8)
