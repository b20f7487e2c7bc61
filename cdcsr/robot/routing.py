"""Cable routing in closed form: the length of each cable, and its derivatives.

Between the two guides of one link the length of a cable is constant; it changes only where the
cable crosses a joint. So the length is a sum of crossings, each a function of the hinge angles of
one joint, plus the straight part between slider and first guide. Base motion does not change it.
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
    bent: Array
    """How much longer the cables are at the start than along the straight arm, shape (C,), in
    [m]; zero without rest angles."""
    hinges: NDArray[np.int64]
    """The numbers of each joint's hinges, the lowest first, shape (J, 3); -1 is no hinge."""
    axes: NDArray[np.int64]
    """The axis of each of these hinges: 0, 1, 2 for x, y, z; shape (J, 3)."""

    @property
    def is_universal(self) -> bool:
        """Whether every joint bends about x, then about y, and does not twist."""
        return bool((self.hinges[:, 2] < 0).all() and (self.axes[:, :2] == (0, 1)).all())


def routing(robot: Robot) -> Routing:
    """Return the routing of every cable, segment by segment in the order of the description."""
    place, offset, joints, slider, rest = [], [], [], [], []
    crossed, links = 0, robot.links
    for segment in robot.segments:
        crossed += segment.links
        straight = sum(link.length for link, _ in links[:crossed])
        for angle in np.deg2rad(segment.cable_angles):
            place.append(segment.cables.pitch_radius * np.array([np.cos(angle), np.sin(angle)]))
            offset.append(segment.cables.guide_offset)
            joints.append(crossed)
            slider.append(segment.servo.offset)
            # From the slider up to the first guide, into the arm, and up to the anchor's guide.
            rest.append(segment.servo.offset + straight)
    hinges, axes = np.full((2, len(links), 3), -1)
    count = 0
    for j, (_, joint) in enumerate(links):
        for k, hinge in enumerate(joint.hinges):
            hinges[j, k], axes[j, k] = count, "xyz".index(hinge.axis)
            count += 1
    route = Routing(
        np.array(place, dtype=float).reshape(-1, 2),
        np.array(offset, dtype=float),
        np.array(joints, dtype=np.int64),
        np.array(slider, dtype=float),
        np.array(rest, dtype=float),
        np.zeros(len(rest)),
        hinges,
        axes,
    )
    start = np.array(robot.start_angles)
    if not start.any():
        return route
    bent = cable_lengths(route, np.zeros(len(rest)), start) - route.rest_length
    return route._replace(rest_length=route.rest_length + bent, bent=bent)


def cable_lengths(route: Routing, travel: Array, hinges: Array) -> Array:
    """Return the length of every cable.

    Args:
        route: from :func:`routing`.
        travel: slider positions, shape (..., C), in [m]; negative is pulled.
        hinges: hinge angles, shape (..., H), in [rad], root to tip.

    Returns:
        Shape (..., C), in [m].
    """
    length, _ = _crossings(route, hinges)
    excess = (length - 2 * route.guide_offset[:, None]).sum(axis=-1)
    straight = route.rest_length - route.bent - route.slider_offset
    return straight + np.abs(route.slider_offset - travel) + excess


def cable_jacobian(route: Routing, travel: Array, hinges: Array) -> Array:
    """Return the derivatives of every cable's length with respect to sliders and hinges.

    Args:
        route, travel, hinges: as for :func:`cable_lengths`.

    Returns:
        Shape (..., C, C + H): columns are sliders, then hinges; [m/m] and [m/rad].
    """
    _, by_hinge = _crossings(route, hinges)
    num_cables = len(route.joints)
    jacobian = np.zeros((*hinges.shape[:-1], num_cables, num_cables + hinges.shape[-1]))
    own = np.arange(num_cables)
    jacobian[..., own, own] = -np.sign(route.slider_offset - travel)
    jacobian[..., num_cables:] = by_hinge
    return jacobian


def _crossings(route: Routing, hinges: Array) -> tuple[Array, Array]:
    """Return the length at each cable and joint, shape (..., C, J), and its derivatives with
    respect to the hinges, shape (..., C, H).

    Where a cable does not cross a joint, the length is that at rest and the derivatives are zero.
    """
    o, crossed = route.guide_offset[:, None], np.arange(len(route.axes)) < route.joints[:, None]
    by_hinge = np.zeros((*hinges.shape[:-1], len(route.joints), hinges.shape[-1]))
    if route.is_universal:
        sin, cos = np.sin(hinges)[..., None, :], np.cos(hinges)[..., None, :]
        px, py = route.place[:, :1], route.place[:, 1:]
        length, by_x, by_y = crossing(
            sin[..., ::2], cos[..., ::2], sin[..., 1::2], cos[..., 1::2], px, py, o
        )
        by_hinge[..., ::2], by_hinge[..., 1::2] = by_x * crossed, by_y * crossed
    else:
        length, by_slot = _any_crossings(route, hinges)
        for slot in range(3):
            there = route.hinges[:, slot] >= 0
            by_hinge[..., route.hinges[there, slot]] = (by_slot[slot] * crossed)[..., there]
    return np.where(crossed, length, 2 * o), by_hinge


def _any_crossings(route: Routing, hinges: Array) -> tuple[Array, Array]:
    """Return what :func:`crossing` does, at joints of any hinges.

    The upper guide is turned by R = R_1 R_2 R_3. A unit rate of the hinge with the axis a, as it
    stands in the frame below the joint, moves it by a x R u.

    Returns:
        The length at each cable and joint, shape (..., C, J), and its derivative with respect to
        the first, the second and the third hinge of the joint, shape (3, ..., C, J).
    """
    angles = np.where(route.hinges >= 0, hinges[..., route.hinges], 0.0)
    turn, axes = np.eye(3), []
    for slot in range(3):
        axis = np.eye(3)[route.axes[:, slot]]
        axes.append(np.einsum("...ij,...j->...i", turn, axis))
        turn = turn @ _about(axis, angles[..., slot])
    low = np.column_stack([route.place, -route.guide_offset])[:, None]
    high = np.column_stack([route.place, route.guide_offset])[:, None]
    above = np.einsum("...jab,cxb->...cja", turn, high)
    along = above - low
    length = np.linalg.norm(along, axis=-1)
    moves = [np.cross(axis[..., None, :, :], above) for axis in axes]
    return length, np.array([(along * move).sum(axis=-1) / length for move in moves])


def _about(axis: Array, angle: Array) -> Array:
    """Return the rotations by `angle`, shape (..., J), about unit axes (J, 3), by Rodrigues'
    formula."""
    cross = np.cross(axis[:, None], np.eye(3)).swapaxes(-1, -2)  # cross @ v = axis x v
    sin, cos = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + sin * cross + (1 - cos) * (cross @ cross)
