"""How copies of a robot differ from its description: for domain randomization and studies of robustness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.delay_line import check_delay

Array = NDArray[np.float64]


class Plant(NamedTuple):
    """The numbers of n copies of a robot that :class:`Parameters` change, in their own units (C cables, J joints)."""

    base_mass: Array
    """(n,) [kg]."""
    base_inertia: Array
    """(n, 3) [kg m^2]."""
    link_mass: Array
    """(n, J) [kg]."""
    link_inertia: Array
    """(n, J, 3) [kg m^2]."""
    stiffness: Array
    """(n, 2 J) of the hinges in [N m/rad]."""
    damping: Array
    """(n, C + 2 J) of sliders in [N s/m], then of hinges in [N m s/rad]."""
    servo_gain: Array
    """(n, C) [N/m]."""
    rest_length_offset: Array
    """(n, C) how much longer each cable is than described, in [m]."""

    @property
    def start_travel(self) -> Array:
        """Where sliders begin, shape (n, C), in [m]: at zero, or as far up as the straight arm's short cable asks."""
        return np.maximum(-self.rest_length_offset, 0.0)


@dataclass(frozen=True, eq=False)
class Parameters:
    """How n copies differ from the description; by default in nothing.

    Each is a number for all copies, or an array of shape (n,) with one for each copy, or of shape (n, parts) with
    one for each copy's every link, joint or cable. Unless they say otherwise they are factors on the
    description's numbers. An observation that is late belongs to what lies between robot and policy: see
    :class:`cdcsr.envs.disturbances.Disturbances`.
    """

    base_mass: ArrayLike = 1.0
    base_inertia: ArrayLike = 1.0
    """On all three moments."""
    link_mass: ArrayLike = 1.0
    """By link."""
    link_inertia: ArrayLike = 1.0
    """By link, on all three moments; the mass does not change it."""
    joint_stiffness: ArrayLike = 1.0
    """By joint, on both of its hinges. May be zero."""
    joint_damping: ArrayLike = 1.0
    """By joint, on both of its hinges. May be zero."""
    slider_damping: ArrayLike = 1.0
    """By cable, on the friction of its slider. May be zero."""
    servo_gain: ArrayLike = 1.0
    """By cable."""
    rest_length_offset: ArrayLike = 0.0
    """By cable, added to its rest length, in [m]; positive is a stretched cable. A shorter one moves the place where
    its slider begins, so set it before a reset; in mid-motion it jerks the arm."""
    command_delay: ArrayLike = 0
    """By copy: how many time steps pass before a command acts."""

    def plant(self, robot: Robot, num: int) -> Plant:
        """What they make of `num` copies of a robot.

        Raises:
            CdcsrError: one has a shape that does not fit, or lies outside its range.
        """
        links = [link for link, _ in robot.links]
        hinges = np.repeat(
            [(joint.stiffness, joint.damping) for _, joint in robot.links], 2, axis=0
        )
        slider_damping, gain, room = np.array(
            [(s.damping, s.gain, s.offset) for s in robot.servos]
        ).T
        offset = self._values("rest_length_offset", num, robot.num_cables)
        if not (offset > -room).all():
            raise CdcsrError(
                f"rest_length_offset must be above {-room.min():g} m, where the slider would meet its guide; "
                f"found {offset.min():g} m."
            )
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
            stiffness=np.repeat(stiffness, 2, axis=1) * hinges[:, 0],
            damping=np.hstack(
                [friction * slider_damping, np.repeat(damping, 2, axis=1) * hinges[:, 1]]
            ),
            servo_gain=self._factors("servo_gain", num, robot.num_cables) * gain,
            rest_length_offset=offset,
        )

    def delay(self, num: int) -> NDArray[np.int64]:
        """The command delay of `num` copies, shape (num,), in time steps.

        Raises:
            CdcsrError: it has a shape that does not fit, or lies outside its range.
        """
        steps = check_delay("command_delay", self.command_delay)
        if steps.shape not in ((), (num,)):
            raise CdcsrError(
                f"command_delay must be a number or have the shape ({num},), not {steps.shape}."
            )
        return np.broadcast_to(steps, num)

    def _values(self, name: str, num: int, parts: int) -> Array:
        """One parameter for every copy's every part, shape (num, parts)."""
        try:
            values = np.asarray(getattr(self, name), dtype=float)
        except (TypeError, ValueError):
            raise CdcsrError(f"{name} must be a number or an array of numbers.") from None
        if values.shape not in ((), (num,), (num, parts)):
            raise CdcsrError(
                f"{name} must be a number or have the shape ({num},) or ({num}, {parts}), not {values.shape}."
            )
        if not np.isfinite(values).all():
            raise CdcsrError(f"{name} must be finite.")
        return np.array(
            np.broadcast_to(values[:, None] if values.ndim == 1 else values, (num, parts))
        )

    def _factors(self, name: str, num: int, parts: int, zero: bool = False) -> Array:
        """One factor for every copy's every part, shape (num, parts)."""
        values = self._values(name, num, parts)
        if not (values >= 0 if zero else values > 0).all():
            raise CdcsrError(f"{name} must be {'zero or ' * zero}positive; found {values.min():g}.")
        return values
