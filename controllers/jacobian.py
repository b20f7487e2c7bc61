"""The scripted demonstrator: resolved-rate control with the momentum-coupled Jacobian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, nnls

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import Dynamics, State
from controllers.controller import Conditions, Controller, Target

Array = NDArray[np.float64]


class JacobianController(Controller):
    """Finds the tensions whose tip velocity, one control period ahead, comes nearest to a wish.

    The tip velocity after a control period h is predicted as linear in the cable tensions t:
    v+ = J (qd + h (M + h D + h^2 K)^-1 (f - L^T t)). M and J include the base's columns, so the
    momentum exchanged with the base is in them. L is the cable Jacobian without the sliders, D and
    K are the hinges' damping and stiffness, and f = passive - bias - h K qd. The wish is
    v* = gain (target - tip), its norm capped, plus the target's velocity: so the tip slows down
    near the target and stays. The command makes each servo pull with its tension:
    a = travel - t / servo gain; of a tension servo, a = t. A displacement servo so gets a length of
    its cable that is shorter by what it gives way under the tension.

    The tip is three of the many coordinates in which the arm moves. At a target the rest of the
    arm may go on moving until no tension can hold the tip. A reach is over by then. Where the tip
    has to stay, the controller also wishes, near the target, that the hinges stand still.

    Args:
        robot: the description.
        gain: in [1/s]; by default 14 for the paper's robot, and in proportion to its pace for
            another one, as all numbers here are to size, pace and pull.
        speed: largest tip speed wished for, in [m/s]; by default the robot's own, 2 m/s for that of
            the paper.
        regularization: weight of the squared tensions against the squared error of the tip's
            velocity, in [(m/s/N)^2]; by default 1e-8.
        calm: weight of the hinges' squared rates against that error at the target, in [m^2]; used
            only where the tip has to stay there; by default 0.02.
        calm_within: distance from the target at which that weight is half as large, in [m]; by
            default 0.1.
    """

    name = "jacobian"
    privileged = True

    def __init__(
        self,
        robot: Robot,
        gain: float | None = None,
        speed: float | None = None,
        regularization: float | None = None,
        calm: float | None = None,
        calm_within: float | None = None,
    ) -> None:
        own = ruler(robot)
        softness = (own.speed / own.pull) ** 2
        self.frame_skip = own.frame_skip
        self.gain = 14.0 / own.pace if gain is None else gain
        self.speed = own.tip_speed if speed is None else speed
        self.regularization = 1e-8 * softness if regularization is None else regularization
        self.calm = 0.02 * own.size**2 if calm is None else calm
        self.calm_within = 0.1 * own.size if calm_within is None else calm_within
        num_cables = robot.num_cables
        self._without_sliders = np.r_[0:6, 6 + num_cables : robot.num_coordinates]
        self._merged = _merged(robot)
        hinges = np.array([(hinge.stiffness, hinge.damping) for hinge in robot.hinges])
        self._stiffness = np.concatenate([np.zeros(6), hinges[:, 0]])
        self._damping = np.concatenate([np.zeros(6), hinges[:, 1]])
        self._servo_gain = np.array([servo.gain for servo in robot.servos])
        self._returns = np.array([float(servo.stiffness > 0) for servo in robot.servos])
        self._pretension = np.array([servo.pretension for servo in robot.servos])
        self._limit = np.array([servo.pull for servo in robot.servos])
        self._sign = np.array([servo.sign for servo in robot.servos])
        self._range = robot.command_range

    def begin(self, conditions: Conditions) -> None:
        """Note the period and where to find the equation of motion.

        Raises:
            CdcsrError: the conditions bring no equation of motion.
        """
        if conditions.dynamics is None:
            raise CdcsrError(
                "The controller 'jacobian' needs the robot's equation of motion, and none is given "
                "here; pass the dynamics of a simulation in the conditions."
            )
        self._dynamics, self._period = conditions.dynamics, conditions.period
        self._stays = conditions.stays

    def act(self, state: State, target: Target, time: Array) -> Array:
        ids = np.flatnonzero(~np.isnan(time))
        command = np.zeros((len(time), len(self._sign)))
        if len(ids) == 0:
            return command
        error = target.position[ids] - state.tip_position[ids]
        wish = self.gain * error
        wish *= np.minimum(
            1, self.speed / np.maximum(np.linalg.norm(wish, axis=1, keepdims=True), 1e-12)
        )
        wish += target.velocity[ids]
        dynamics = self._dynamics(ids)
        offset, slope = self._predict(dynamics, self._period)
        wish -= offset
        if self._stays:
            rates, by_tension = self._predict_hinges(dynamics, self._period)
            near = 1 / (1 + np.sum(error**2, axis=1) / self.calm_within**2)
            weight = np.sqrt(self.calm * near)[:, None]
            wish = np.concatenate([wish, -weight * rates], axis=1)
            slope = np.concatenate([slope, weight[:, None] * by_tension], axis=1)
        tension = np.array([self._tensions(s, w) for s, w in zip(slope, wish, strict=True)])
        travel = self._returns * state.cable_travel[ids]
        pull = (tension - self._pretension) / self._servo_gain
        command[ids] = np.clip(self._sign * (travel - pull), *self._range)
        return command

    def _predict(self, dynamics: Dynamics, period: float) -> tuple[Array, Array]:
        """Predict the tip velocity after one period: offset (n, 3) + slope (n, 3, C) @ tensions."""
        implicit, force, rate, cables = self._equation(dynamics, period)
        tip = dynamics.tip_jacobian[:, :, self._without_sliders]
        if self._merged is not None:
            tip = tip @ self._merged
        # M~ is symmetric, so one solve for the tip's three rows, (M~)^-1 J^T, serves both the force
        # and all cables.
        response = np.linalg.solve(implicit, tip.swapaxes(1, 2))
        offset = np.einsum("nij,nj->ni", tip, rate) + period * np.einsum(
            "nji,nj->ni", response, force
        )
        return offset, -period * np.einsum("nji,ncj->nic", response, cables)

    def _predict_hinges(self, dynamics: Dynamics, period: float) -> tuple[Array, Array]:
        """Predict the hinge rates after one period: offset (n, H) + slope (n, H, C) @ t."""
        implicit, force, rate, cables = self._equation(dynamics, period)
        pulls = np.concatenate([force[:, :, None], -cables.swapaxes(1, 2)], axis=2)
        after: Array = np.linalg.solve(implicit, period * pulls).astype(np.float64)
        return rate[:, 6:] + after[:, 6:, 0], after[:, 6:, 1:]

    def _equation(self, dynamics: Dynamics, period: float) -> tuple[Array, Array, Array, Array]:
        """Return M + h D + h^2 K, f, qd and L of base and hinges; coupled hinges count as one."""
        keep = self._without_sliders
        rate = dynamics.velocity[:, keep]
        force = (dynamics.passive_force - dynamics.bias_force)[
            :, keep
        ] - period * self._stiffness * rate
        implicit = dynamics.mass_matrix[:, keep[:, None], keep]
        implicit = implicit + np.diag(period * self._damping + period**2 * self._stiffness)
        cables = dynamics.cable_jacobian[:, :, keep]
        if self._merged is not None:
            merged = self._merged
            implicit, force, cables = merged.T @ implicit @ merged, force @ merged, cables @ merged
            rate = rate @ merged / merged.sum(axis=0)
        return implicit, force, rate, cables

    def _tensions(self, slope: Array, wish: Array) -> Array:
        """Minimise |slope t - wish|^2 + regularization |t|^2 over 0 <= t <= the largest pull."""
        limit = self._limit
        matrix = np.vstack([slope, np.sqrt(self.regularization) * np.eye(len(limit))])
        goal = np.concatenate([wish, np.zeros(len(limit))])
        tension, _ = nnls(matrix, goal)
        # This is rare; otherwise the non-negative optimum is the bounded one.
        if (tension > limit).any():
            tension = lsq_linear(matrix, goal, (0, limit), method="bvls").x
        return tension


def _merged(robot: Robot) -> Array | None:
    """Return how base and hinges move with the base and the hinges that are free, one for each set
    of coupled ones, shape (6 + H, 6 + F); None if no hinges are coupled."""
    leaders = np.array([*range(6), *(6 + leader for leader in robot.leaders)])
    free = np.unique(leaders)
    return None if len(free) == len(leaders) else (leaders[:, None] == free).astype(np.float64)
