"""The plant: the robot as it really is in a copy, which may differ from its description."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import routing
from cdcsr.simulation.delay_line import check_delay

Array = NDArray[np.float64]


class Plant(NamedTuple):
    """The numbers of n copies that :class:`Parameters` change; C cables, J joints, H
    hinges."""

    base_mass: Array
    """Shape (n,), in [kg]."""
    base_inertia: Array
    """Shape (n, 3), in [kg m^2]."""
    link_mass: Array
    """Shape (n, J), in [kg]."""
    link_inertia: Array
    """Shape (n, J, 3), in [kg m^2]."""
    stiffness: Array
    """The hinges' stiffness, shape (n, H), in [N m/rad]."""
    damping: Array
    """The sliders' friction and their servos' dampers in [N s/m], then the hinges' damping in
    [N m s/rad], (n, C + H)."""
    servo_gain: Array
    """Servo force by command, shape (n, C), in [N/m]; one for a tension servo."""
    rest_length_offset: Array
    """How much longer each cable is than described, shape (n, C), in [m]."""
    cable_compliance: Array
    """How much longer each cable gets by tension, its rest length over E A, shape (n, C), in [m/N];
    zero if it does not stretch."""
    guide_friction: Array
    """Coefficient of friction of each cable in its guides, shape (n, C)."""

    @property
    def start_travel(self) -> Array:
        """Where the sliders begin, shape (n, C), in [m]: at zero, or higher for a short cable."""
        return np.maximum(-self.rest_length_offset, 0.0)


@dataclass(frozen=True, eq=False)
class Parameters:
    """How n copies differ from the description; by default they do not.

    Each parameter is a number for all copies, or an array of shape (n,) or (n, parts), where parts
    are links, joints or cables. Unless it says otherwise, it is a factor on the number of the
    description. Late observations are no parameter of the plant: see
    :class:`cdcsr.envs.disturbances.Disturbances`.
    """

    base_mass: ArrayLike = 1.0
    base_inertia: ArrayLike = 1.0
    """Acts on all three moments."""
    link_mass: ArrayLike = 1.0
    """For each link."""
    link_inertia: ArrayLike = 1.0
    """For each link, acts on all three moments; link_mass does not change the inertia."""
    joint_stiffness: ArrayLike = 1.0
    """For each joint, acts on all of its hinges. May be zero."""
    joint_damping: ArrayLike = 1.0
    """For each joint, acts on all of its hinges. May be zero."""
    slider_damping: ArrayLike = 1.0
    """For each cable, acts on the friction of its slider, not on its servo. May be zero."""
    servo_gain: ArrayLike = 1.0
    """For each cable; of a tension servo acts on the force."""
    rest_length_offset: ArrayLike = 0.0
    """For each cable, is added to its rest length, in [m]; positive is a stretched cable. A shorter
    cable changes where its slider begins, so set it before a reset: later it would jerk the arm."""
    cable_strain: ArrayLike = 0.0
    """For each cable, is added to its strain by tension 1 / (E A), in [1/N]; 1e-5 for a steel wire
    of 0.8 mm. May be negative, down to a cable that does not stretch."""
    guide_friction: ArrayLike = 0.0
    """For each cable, is added to its coefficient of friction in its guides. May be negative, down
    to none."""
    command_delay: ArrayLike = 0
    """For each copy: how many time steps pass before a command acts."""

    def plant(self, robot: Robot, num: int) -> Plant:
        """Return the numbers of `num` copies of a robot.

        Raises:
            CdcsrError: a parameter has the wrong shape, or is out of range.
        """
        links = [link for link, _ in robot.links]
        hinges = np.array([(hinge.stiffness, hinge.damping) for hinge in robot.hinges])
        of_hinge = list(robot.link_of_hinge)
        slider_damping, gain, room = (
            np.array([(s.damping, s.gain, s.stop) for s in robot.servos], dtype=float)
            .reshape(-1, 3)
            .T
        )
        offset = self._values("rest_length_offset", num, robot.num_cables)
        if not (offset >= -room).all():
            raise CdcsrError(
                f"rest_length_offset must be at least {-room.min():g} m, where the slider meets "
                f"its guide; found {offset.min():g} m."
            )
        described = np.array(robot.strain_by_tension, dtype=float)
        strain = self._above("cable_strain", num, described, " 1/N, where a cable does not stretch")
        rough = np.array(robot.guide_friction, dtype=float)
        rough = self._above("guide_friction", num, rough, ", where nothing rubs")
        length = routing(robot).rest_length if strain.any() else 0.0
        servos = np.array([servo.servo_damping(robot.time_step) for servo in robot.servos])
        stiffness = self._factors("joint_stiffness", num, robot.num_links, zero=True)
        damping = self._factors("joint_damping", num, robot.num_links, zero=True)
        friction = self._factors("slider_damping", num, robot.num_cables, zero=True)
        return Plant(
            base_mass=self._factors("base_mass", num, 1)[:, 0] * robot.base.mass,
            base_inertia=self._factors("base_inertia", num, 1) * np.array(robot.base.inertia),
            link_mass=self._factors("link_mass", num, len(links))
            * np.array([link.mass for link in links]),
            link_inertia=self._factors("link_inertia", num, len(links))[..., None]
            * np.array([link.inertia for link in links]),
            stiffness=stiffness[:, of_hinge] * hinges[:, 0],
            damping=np.hstack(
                [friction * slider_damping + servos, damping[:, of_hinge] * hinges[:, 1]]
            ),
            servo_gain=self._factors("servo_gain", num, robot.num_cables) * gain,
            rest_length_offset=offset,
            cable_compliance=(length + offset) * strain,
            guide_friction=rough,
        )

    def delay(self, num: int) -> NDArray[np.int64]:
        """Return the command delay of `num` copies, shape (num,), in time steps.

        Raises:
            CdcsrError: it has the wrong shape, or is out of range.
        """
        steps = check_delay("command_delay", self.command_delay)
        if steps.shape not in ((), (num,)):
            raise CdcsrError(
                f"command_delay must be a number or have the shape ({num},), not {steps.shape}."
            )
        return np.broadcast_to(steps, num)

    def _values(self, name: str, num: int, parts: int) -> Array:
        """Return a parameter for each part of each copy, shape (num, parts)."""
        try:
            values = np.asarray(getattr(self, name), dtype=float)
        except (TypeError, ValueError):
            raise CdcsrError(f"{name} must be a number or an array of numbers.") from None
        if values.shape not in ((), (num,), (num, parts)):
            raise CdcsrError(
                f"{name} must be a number or have the shape ({num},) or ({num}, {parts}), "
                f"not {values.shape}."
            )
        if not np.isfinite(values).all():
            raise CdcsrError(f"{name} must be finite.")
        return np.array(
            np.broadcast_to(values[:, None] if values.ndim == 1 else values, (num, parts))
        )

    def _above(self, name: str, num: int, described: Array, meaning: str) -> Array:
        """Return the sum of a parameter and the described number of each cable, shape (num, C)."""
        total = self._values(name, num, len(described)) + described
        total[np.abs(total) < 1e-12 * described] = 0.0  # the described one taken off, but rounded
        if not (total >= 0).all():
            raise CdcsrError(
                f"{name} must be at least {-described.min():g}{meaning}; found one of "
                f"{total.min():g} below that."
            )
        return total

    def _factors(self, name: str, num: int, parts: int, zero: bool = False) -> Array:
        """Return a factor for each part of each copy, shape (num, parts)."""
        values = self._values(name, num, parts)
        if not (values >= 0 if zero else values > 0).all():
            raise CdcsrError(f"{name} must be {'zero or ' * zero}positive; found {values.min():g}.")
        return values
