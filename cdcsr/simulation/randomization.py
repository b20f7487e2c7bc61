"""Domain randomization: every episode has a plant of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import Simulation
from cdcsr.simulation.plant import Parameters

Drawn = dict[str, NDArray[np.float64] | NDArray[np.int64]]
FACTORS = {
    "base_mass": 1.5,
    "base_inertia": 1.5,
    "link_mass": 1.5,
    "link_inertia": 2.0,
    "joint_stiffness": 2.0,
    "joint_damping": 2.0,
    "slider_damping": 2.0,
    "servo_gain": 1.5,
}
"""At scale 1 a factor lies between 1 over this and this; its logarithm is uniform. All parts of a
copy have the same factor."""
REST_LENGTH_OFFSET = 0.02
"""At scale 1 each cable of the paper's robot is longer or shorter by up to this, uniform, in [m];
those of another robot in proportion to its pitch radius."""
ELASTIC = 2.0
"""At scale 1 the stiffness of elastic cables is multiplied as by a factor of :data:`FACTORS`."""
SOFT = 1e-4
"""At softness 1 the cables of a copy of the paper's robot stretch by up to this part of their
length for each newton, uniform, in [1/N]; those of another robot by as much under the largest force
of its servos. MuJoCo's default softness lets cables of `paper` be longer by 5e-5 of their length
for each newton (median along ten demonstrations in `mujoco-stock`)."""
ROUGH = 2.0
"""At scale 1 the friction of cables in their guides is multiplied likewise."""
COMMAND_DELAY = 4
"""At scale 1 commands are late by 0 to this many time steps, uniform."""
MAX_SCALE = 5.0


class Randomization:
    """Draw :class:`Parameters` for the copies that begin an episode, and set them.

    Args:
        robot: the description.
        num: how many copies.
        scale: 0 draws the description itself, 1 the ranges above; logarithms, offsets and delays
            are proportional to it.
        rng: a stream of its own, so that the targets do not depend on it.
        softness: how soft the cables of a copy may be, as a multiple of :data:`SOFT`.

    Attributes:
        rng: that stream.
        drawn: the parameters in force, by the names of :class:`Parameters`, one row for each copy.

    Raises:
        CdcsrError: the scale is out of range, or cables would become too short.
    """

    def __init__(
        self,
        robot: Robot,
        num: int,
        scale: float,
        rng: np.random.Generator,
        softness: float = 0.0,
    ) -> None:
        check_scale(scale)
        check_scale(softness)
        shortest = min(servo.stop for servo in robot.servos)
        self._offset = REST_LENGTH_OFFSET * ruler(robot).travel
        if scale * self._offset > shortest:
            raise CdcsrError(
                f"A randomization of {scale:g} shortens cables by up to "
                f"{scale * self._offset:g} m, and the sliders of {robot.name!r} have room "
                f"for {shortest:g} m; choose a smaller one."
            )
        self.rng, self._scale, self._cables = rng, scale, robot.num_cables
        self.drawn: Drawn = {name: np.ones(num) for name in FACTORS}
        self.drawn["rest_length_offset"] = np.zeros((num, robot.num_cables))
        self.drawn["command_delay"] = np.zeros(num, np.int64)
        self._strain = np.array(robot.strain_by_tension)
        self._softest = softness * SOFT / ruler(robot).pull
        if self._strain.any() or softness:
            self.drawn["cable_strain"] = np.zeros((num, robot.num_cables))
        self._friction = np.array(robot.guide_friction)
        if self._friction.any():
            self.drawn["guide_friction"] = np.zeros((num, robot.num_cables))

    def begin(self, simulation: Simulation, ids: NDArray[np.int64]) -> None:
        """Give copies `ids` new plants, before they are reset."""
        new = self.draw(len(ids))
        for name, values in new.items():
            self.drawn[name][ids] = values
        simulation.set_parameters(ids, Parameters(**new))

    def restore(self, simulation: Simulation, drawn: Drawn) -> None:
        """Give all copies the plants that were in force when `drawn` was copied."""
        for name, values in self.drawn.items():
            values[:] = drawn[name]
        simulation.set_parameters(None, Parameters(**self.drawn))

    def draw(self, num: int) -> Drawn:
        """Draw plants for `num` copies, by the names of :class:`Parameters`."""
        widths = self._scale * np.log(list(FACTORS.values()))
        factors = np.exp(self.rng.uniform(-1, 1, (num, len(FACTORS))) * widths)
        offset = self.rng.uniform(-1, 1, (num, self._cables)) * self._scale * self._offset
        delay = self.rng.integers(0, round(self._scale * COMMAND_DELAY), num, endpoint=True)
        drawn: Drawn = {
            **dict(zip(FACTORS, factors.T, strict=True)),
            "rest_length_offset": offset,
            "command_delay": delay,
        }
        if self._strain.any():
            exponent = self.rng.uniform(-1, 1, (num, 1)) * self._scale
            drawn["cable_strain"] = (ELASTIC**exponent - 1) * self._strain
        if self._softest:
            soft = np.tile(self.rng.uniform(0, self._softest, (num, 1)), self._cables)
            drawn["cable_strain"] = drawn.get("cable_strain", 0.0) + soft
        if self._friction.any():
            exponent = self.rng.uniform(-1, 1, (num, 1)) * self._scale
            drawn["guide_friction"] = (ROUGH**exponent - 1) * self._friction
        return drawn


def check_scale(scale: float) -> None:
    """Check a scale of randomization.

    Raises:
        CdcsrError: it does not lie in [0, MAX_SCALE].
    """
    if not 0 <= scale <= MAX_SCALE:
        raise CdcsrError(
            f"The scale of randomization must lie in [0, {MAX_SCALE:g}], not {scale:g}."
        )
