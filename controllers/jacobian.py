"""The scripted demonstrator: resolved-rate control through the generalized (momentum-coupled) Jacobian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, nnls

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Dynamics
from controllers.controller import Controller

Array = NDArray[np.float64]


class JacobianController(Controller):
    """Finds the tensions whose tip velocity, one control step ahead, comes nearest to a wish.

    The tip velocity after a control period h is predicted as linear in the cable tensions t:
    v+ = J (qd + h (M + h D + h^2 K)^-1 (f - L^T t)), with M, J (base columns included, so the momentum
    exchanged with the base is in it) and the cable Jacobian L without the sliders, D and K the hinges' damping
    and stiffness, and f = passive - bias - h K qd. The wish is v* = gain (target - tip), its norm capped, plus the
    target's velocity, which this controller may know and a policy may not: so the tip slows down and stays.
    The command makes each servo pull with its tension: a = travel - t / servo gain.

    The tip is three numbers of the many in which the arm moves, so at a target the rest of the arm may go on moving
    until no tension can hold the tip. A reach is over by then; in the other tasks the wish is also that, near the
    target, the hinges stand still.

    Args:
        robot: the description.
        gain: [1/s].
        speed: largest tip speed wished for, in [m/s].
        regularization: weight of |t|^2 against |v+ - v*|^2, in [(m/s/N)^2].
        calm: weight of the hinges' squared rates against |v+ - v*|^2, at the target, in [m^2]; only where the tip is
            to stay there.
        calm_within: distance from the target at which that weight is half as large, in [m].
    """

    name = "jacobian"

    def __init__(
        self,
        robot: Robot,
        gain: float = 14.0,
        speed: float = 2.0,
        regularization: float = 1e-8,
        calm: float = 0.02,
        calm_within: float = 0.1,
    ) -> None:
        self.gain, self.speed, self.regularization = gain, speed, regularization
        self.calm, self.calm_within = calm, calm_within
        num_cables = robot.num_cables
        self._without_sliders = np.r_[0:6, 6 + num_cables : robot.num_coordinates]
        hinges = np.repeat([(j.stiffness, j.damping) for _, j in robot.links], 2, axis=0)
        self._stiffness = np.concatenate([np.zeros(6), hinges[:, 0]])
        self._damping = np.concatenate([np.zeros(6), hinges[:, 1]])
        self._servo_gain = np.array([servo.gain for servo in robot.servos])
        self._eta = np.array([servo.eta for servo in robot.servos])

    def act(self, env: TaskVectorEnv, observation: Array, active: NDArray[np.bool_]) -> Array:
        ids = np.flatnonzero(active)
        state = env.simulation.state()
        command = np.zeros((env.num_envs, len(self._eta)))
        if len(ids) == 0:
            return command
        error = env.targets[ids] - state.tip_position[ids]
        wish = self.gain * error
        wish *= np.minimum(
            1, self.speed / np.maximum(np.linalg.norm(wish, axis=1, keepdims=True), 1e-12)
        )
        wish += env.target_velocity[ids]
        period = env.robot.time_step * env.frame_skip
        dynamics = env.simulation.dynamics(ids)
        offset, slope = self._predict(dynamics, period)
        wish -= offset
        if env.task.kind != "reach":
            rates, by_tension = self._predict_hinges(dynamics, period)
            near = 1 / (1 + np.sum(error**2, axis=1) / self.calm_within**2)
            weight = np.sqrt(self.calm * near)[:, None]
            wish = np.concatenate([wish, -weight * rates], axis=1)
            slope = np.concatenate([slope, weight[:, None] * by_tension], axis=1)
        tension = np.array([self._tensions(s, w) for s, w in zip(slope, wish, strict=True)])
        command[ids] = np.clip(state.cable_travel[ids] - tension / self._servo_gain, -self._eta, 0)
        return command

    def _predict(self, dynamics: Dynamics, period: float) -> tuple[Array, Array]:
        """Tip velocity after one period as offset (n, 3) + slope (n, 3, C) @ tensions."""
        implicit, force, rate, cables = self._equation(dynamics, period)
        tip = dynamics.tip_jacobian[:, :, self._without_sliders]
        # One solve for the tip's three rows serves both the force and all cables: (M~)^-1 J^T, M~ symmetric.
        response = np.linalg.solve(implicit, tip.swapaxes(1, 2))
        offset = np.einsum("nij,nj->ni", tip, rate) + period * np.einsum(
            "nji,nj->ni", response, force
        )
        return offset, -period * np.einsum("nji,ncj->nic", response, cables)

    def _predict_hinges(self, dynamics: Dynamics, period: float) -> tuple[Array, Array]:
        """Hinge rates after one period as offset (n, 2 J) + slope (n, 2 J, C) @ tensions."""
        implicit, force, rate, cables = self._equation(dynamics, period)
        pulls = np.concatenate([force[:, :, None], -cables.swapaxes(1, 2)], axis=2)
        after: Array = np.linalg.solve(implicit, period * pulls).astype(np.float64)
        return rate[:, 6:] + after[:, 6:, 0], after[:, 6:, 1:]

    def _equation(self, dynamics: Dynamics, period: float) -> tuple[Array, Array, Array, Array]:
        """M + h D + h^2 K, f, qd and L of base and hinges."""
        keep = self._without_sliders
        rate = dynamics.velocity[:, keep]
        force = (dynamics.passive_force - dynamics.bias_force)[
            :, keep
        ] - period * self._stiffness * rate
        implicit = dynamics.mass_matrix[:, keep[:, None], keep]
        implicit = implicit + np.diag(period * self._damping + period**2 * self._stiffness)
        return implicit, force, rate, dynamics.cable_jacobian[:, :, keep]

    def _tensions(self, slope: Array, wish: Array) -> Array:
        """The bounded least squares min |slope t - wish|^2 + regularization |t|^2, 0 <= t <= what the servo can."""
        limit = self._servo_gain * self._eta
        matrix = np.vstack([slope, np.sqrt(self.regularization) * np.eye(len(limit))])
        goal = np.concatenate([wish, np.zeros(len(limit))])
        tension, _ = nnls(matrix, goal)
        if (tension > limit).any():  # rare; the non-negative optimum is the bounded one otherwise
            tension = lsq_linear(matrix, goal, (0, limit), method="bvls").x
        return tension
