"""Cable routing in closed form: the length of each cable, and its derivatives.

Between the two guides of one link the length of a cable is constant; it changes only where the
cable crosses a joint. So the length is a sum of crossings, each a function of the two hinge angles
of one joint, plus the straight part between slider and first guide. Base motion does not change it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot

Array = NDArray[np.float64]


def crossing(
    sx: Array, cx: Array, sy: Array, cy: Array, px: Array, py: Array, o: Array
) -> tuple[Array, Array, Array]:
    """Return a cable's length between the guides just below and just above one universal joint.

    Below the joint the guide is at (px, py, -o) in the lower body's frame at the joint; above it at
    (px, py, o) in the upper body's, which is turned by Rx(qx) Ry(qy). Arguments are arrays that
    broadcast or, where an engine compiles the function, scalars.

    Args:
        sx, cx, sy, cy: sine and cosine of the two hinge angles.
        px, py: the cable's position across the arm in [m].
        o: distance of either guide from the joint in [m].

    Returns:
        The length in [m] and its derivatives with respect to qx and qy in [m/rad].
    """
    x = px * cy + o * sy  # the upper guide after Ry ...
    z = o * cy - px * sy
    dx = x - px  # ... and the vector between the guides after Rx
    dy = py * cx - z * sx - py
    dz = py * sx + z * cx + o
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    by_x = (dy * (-py * sx - z * cx) + dz * (py * cx - z * sx)) / length
    by_y = (dx * z + dy * x * sx - dz * x * cx) / length
    return length, by_x, by_y


class Routing(NamedTuple):
    """The paths of the cables as plain arrays; C cables."""

    place: Array
    """Position across the arm, shape (C, 2), in [m]."""
    guide_offset: Array
    """Distance of the guides from the joints, shape (C,), in [m]."""
    joints: NDArray[np.int64]
    """How many joints each cable crosses, counted from the base, shape (C,)."""
    slider_offset: Array
    """Distance of the slider below the first guide at rest, shape (C,), in [m]."""
    rest_length: Array
    """Length at the start, shape (C,), in [m]."""


def routing(robot: Robot) -> Routing:
    """Return the routing of every cable, segment by segment in the order of the description."""
    place, offset, joints, slider, rest = [], [], [], [], []
    crossed = 0
    for segment in robot.segments:
        crossed += segment.links
        straight = sum(link.length for link, _ in robot.links[:crossed])
        for angle in np.deg2rad(segment.cables.angles_deg):
            place.append(segment.cables.pitch_radius * np.array([np.cos(angle), np.sin(angle)]))
            offset.append(segment.cables.guide_offset)
            joints.append(crossed)
            slider.append(segment.servo.offset)
            # From the slider up to the first guide, into the arm, and up to the anchor's guide.
            rest.append(segment.servo.offset + straight)
    return Routing(
        np.array(place), np.array(offset), np.array(joints), np.array(slider), np.array(rest)
    )


def cable_lengths(route: Routing, travel: Array, hinges: Array) -> Array:
    """Return the length of every cable.

    Args:
        route: from :func:`routing`.
        travel: slider positions, shape (..., C), in [m]; negative is pulled.
        hinges: hinge angles, shape (..., 2 J), in [rad], x before y, root to tip.

    Returns:
        Shape (..., C), in [m].
    """
    length, _, _ = _crossings(route, hinges)
    excess = (length - 2 * route.guide_offset[:, None]).sum(axis=-1)
    return route.rest_length - route.slider_offset + np.abs(route.slider_offset - travel) + excess


def cable_jacobian(route: Routing, travel: Array, hinges: Array) -> Array:
    """Return the derivatives of every cable's length with respect to sliders and hinges.

    Args:
        route, travel, hinges: as for :func:`cable_lengths`.

    Returns:
        Shape (..., C, C + 2 J): columns are sliders, then hinges; [m/m] and [m/rad].
    """
    _, by_x, by_y = _crossings(route, hinges)
    num_cables = len(route.joints)
    jacobian = np.zeros((*hinges.shape[:-1], num_cables, num_cables + hinges.shape[-1]))
    own = np.arange(num_cables)
    jacobian[..., own, own] = -np.sign(route.slider_offset - travel)
    jacobian[..., num_cables::2] = by_x
    jacobian[..., num_cables + 1 :: 2] = by_y
    return jacobian


def _crossings(route: Routing, hinges: Array) -> tuple[Array, Array, Array]:
    """Return length and derivatives at each cable and joint, shape (..., C, J).

    Where a cable does not cross a joint, the length is that at rest and the derivatives are zero.
    """
    sin, cos = np.sin(hinges)[..., None, :], np.cos(hinges)[..., None, :]
    px, py, o = route.place[:, :1], route.place[:, 1:], route.guide_offset[:, None]
    length, by_x, by_y = crossing(
        sin[..., ::2], cos[..., ::2], sin[..., 1::2], cos[..., 1::2], px, py, o
    )
    crossed = np.arange(hinges.shape[-1] // 2) < route.joints[:, None]
    return np.where(crossed, length, 2 * o), by_x * crossed, by_y * crossed
