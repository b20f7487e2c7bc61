"""Cable routing in closed form: the length of each cable, and its derivatives.

Between the two guides of one link the length of a cable is constant; it changes only where the
cable crosses a joint. So the length is a sum of crossings, each a function of the hinge angles of
one joint, plus the straight part between slider and first guide. Base motion does not change it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.robot.segments import Path, Segment

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


class Guide(NamedTuple):
    """A guide of a cable."""

    body: int
    """0 is the base, j + 1 the link j."""
    place: tuple[float, float, float]
    """In the frame of the base or of the link, in [m]."""


class Routing(NamedTuple):
    """The paths of the cables as plain arrays; C cables."""

    place: Array
    """Position across the arm, shape (C, 2), in [m]."""
    guide_offset: Array
    """Distance of the guides from the joints, shape (C,), in [m]."""
    joints: NDArray[np.int64]
    """One more than the last joint that each cable crosses, shape (C,)."""
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
    first: NDArray[np.int64]
    """The first joint that each cable crosses, shape (C,)."""
    low: Array
    """The guide just below each joint, in the lower link's frame there, (C, J, 3), in [m]."""
    high: Array
    """The guide just above each joint, in the upper link's frame, (C, J, 3), in [m]."""
    chord: Array
    """The distance between these two while the joint is straight, shape (C, J), in [m]."""
    reach: Array
    """The length of each link, shape (J,), in [m]."""
    guides: tuple[tuple[Guide, ...], ...]
    """The guides of each cable from the base to its anchor. Where the first joint that a cable
    crosses is not the arm's first, a sheath leads it from the first guide to the second."""
    parallel: bool
    """Whether all cables run straight along the arm, from the base on."""

    @property
    def is_universal(self) -> bool:
        """Whether every joint bends about x, then about y, and does not twist."""
        return bool((self.hinges[:, 2] < 0).all() and (self.axes[:, :2] == (0, 1)).all())


@lru_cache(maxsize=64)
def routing(robot: Robot) -> Routing:
    """Return the routing of every cable, in the order of the description; it is kept, read-only."""
    runs: list[_Run] = []
    crossed, links = 0, [link.length for link, _ in robot.links]
    for segment in robot.segments:
        crossed += segment.links
        if segment.cable_angles:
            runs += [
                _run(robot.first_joint, links, segment, way, crossed) for way in segment.cables.ways
            ]
    (hinges, axes), count = np.full((2, len(links), 3), -1), 0
    for j, (_, joint) in enumerate(robot.links):
        for k, hinge in enumerate(joint.hinges):
            hinges[j, k], axes[j, k] = count, "xyz".index(hinge.axis)
            count += 1
    route = Routing(
        place=np.array([run.place for run in runs], dtype=float).reshape(-1, 2),
        guide_offset=np.array([run.guide_offset for run in runs], dtype=float),
        joints=np.array([run.end for run in runs], dtype=np.int64),
        slider_offset=np.array([run.slider_offset for run in runs], dtype=float),
        rest_length=np.array([run.length for run in runs], dtype=float),
        bent=np.zeros(len(runs)),
        hinges=hinges,
        axes=axes,
        first=np.array([run.first for run in runs], dtype=np.int64),
        low=np.array([run.low for run in runs], dtype=float).reshape(-1, len(links), 3),
        high=np.array([run.high for run in runs], dtype=float).reshape(-1, len(links), 3),
        chord=np.array([run.chord for run in runs], dtype=float).reshape(-1, len(links)),
        reach=np.array(links, dtype=float),
        guides=tuple(run.guides for run in runs),
        parallel=all(run.parallel for run in runs),
    )
    if (start := np.array(robot.start_angles)).any():
        bent = cable_lengths(route, np.zeros(len(runs)), start) - route.rest_length
        route = route._replace(rest_length=route.rest_length + bent, bent=bent)
    for part in route:
        if isinstance(part, np.ndarray):
            part.setflags(write=False)
    return route


class _Run(NamedTuple):
    """One cable; the fields are rows of :class:`Routing`."""

    place: Array
    guide_offset: float
    first: int
    end: int
    slider_offset: float
    length: float
    low: Array
    high: Array
    chord: Array
    guides: tuple[Guide, ...]
    parallel: bool


def _run(first_joint: float, links: list[float], segment: Segment, way: Path, end: int) -> _Run:
    """Lay one cable along the straight arm.

    Args:
        first_joint: its height in the base's frame, in [m].
        links: their lengths, in [m].
        segment: the cable's.
        way: the cable's.
        end: how many links the arm has up to the end of the segment.
    """
    near = segment.cables.pitch_radius if way.pitch_radius is None else way.pitch_radius
    far = near if way.end_pitch_radius is None else way.end_pitch_radius
    end = end if way.last_link is None else way.last_link + 1
    o, joints = segment.cables.guide_offset, np.cumsum([0.0, *links])
    angle, bottom = np.deg2rad(way.angle_deg), joints[way.first_link] - o
    place = near * np.array([np.cos(angle), np.sin(angle)])
    straight = far == near and way.twist_deg == 0

    def at(height: Array) -> Array:
        """Return x and y of the cable at heights above the first joint."""
        if straight:
            return np.tile(place, (len(height), 1))
        along = (height - bottom) / (joints[end] - o - bottom)
        turn, radius = angle + np.deg2rad(way.twist_deg) * along, near + (far - near) * along
        return radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])

    below, above = at(joints - o), at(joints[:-1] + o)
    low = np.column_stack([below[:-1], np.full(len(links), -o)])
    high = np.column_stack([above, np.full(len(links), o)])
    chord = np.linalg.norm(high - low, axis=1)
    guides = [Guide(0, (float(place[0]), float(place[1]), first_joint - o))]
    if way.first_link:
        x, y = below[way.first_link].tolist()
        guides.append(Guide(way.first_link, (x, y, links[way.first_link - 1] - o)))
    length = segment.servo.offset
    for j in range(way.first_link, end):
        (x, y), (u, v) = above[j].tolist(), below[j + 1].tolist()
        guides += [Guide(j + 1, (x, y, o)), Guide(j + 1, (u, v, links[j] - o))]
        length += chord[j] + np.hypot(np.hypot(u - x, v - y), links[j] - 2 * o)
    parallel = straight and way.first_link == 0
    if parallel:
        # From the slider up to the first guide, into the arm, and up to the anchor's guide.
        length, chord = segment.servo.offset + sum(links[:end]), np.full(len(links), 2 * o)
    return _Run(
        *(place, o, way.first_link, end, segment.servo.offset, float(length)),
        *(low, high, chord, tuple(guides), parallel),
    )


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
    excess = (length - route.chord).sum(axis=-1)
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
    o, joint = route.guide_offset[:, None], np.arange(len(route.axes))
    crossed = (joint < route.joints[:, None]) & (joint >= route.first[:, None])
    by_hinge = np.zeros((*hinges.shape[:-1], len(route.joints), hinges.shape[-1]))
    if route.is_universal and route.parallel:
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
    return np.where(crossed, length, route.chord), by_hinge


def _any_crossings(route: Routing, hinges: Array) -> tuple[Array, Array]:
    """Return what :func:`crossing` does, at joints of any hinges.

    Returns:
        The length at each cable and joint, shape (..., C, J), and its derivative with respect to
        the first, the second and the third hinge of the joint, shape (3, ..., C, J).
    """
    turn, axes = _turns(route, hinges)
    above = np.einsum("...jab,cjb->...cja", turn, route.high)
    along = above - route.low
    length = np.linalg.norm(along, axis=-1)
    moves = [np.cross(axis[..., None, :, :], above) for axis in axes]
    return length, np.array([(along * move).sum(axis=-1) / length for move in moves])


def _turns(route: Routing, hinges: Array) -> tuple[Array, list[Array]]:
    """Return how the link above each joint is turned from the one below, R = R_1 R_2 R_3, shape
    (..., J, 3, 3), and the axes of the three hinges in the frame below, shapes (..., J, 3).

    A unit rate of a hinge with the axis a moves a guide at u above the joint by a x R u.
    """
    angles = np.where(route.hinges >= 0, hinges[..., route.hinges], 0.0)
    turn, axes = np.eye(3), []
    for slot in range(3):
        axis = np.eye(3)[route.axes[:, slot]]
        axes.append(np.einsum("...ij,...j->...i", turn, axis))
        turn = turn @ _about(axis, angles[..., slot])
    return turn, axes


def turning_angles(route: Routing, hinges: Array) -> Array:
    """Return by how much every cable changes its direction in the guides of one body before each
    joint that it crosses, shape (..., C, J), in [rad].

    Before the first joint this is the base's guide, where the cable comes along +z from its slider.
    A sheath, and what a cable does not cross, have zero.

    Args:
        route: from :func:`routing`.
        hinges: hinge angles, shape (..., H), in [rad], root to tip.
    """
    turn, _ = _turns(route, hinges)
    below = np.einsum("...jab,cjb->...cja", turn, route.high) - route.low
    above = np.einsum("...jba,...cjb->...cja", turn, below)
    inside = route.low.copy()
    inside[:, 0] = 0.0, 0.0, 1.0
    inside[:, 1:] += route.reach[:-1, None] * (0.0, 0.0, 1.0) - route.high[:, :-1]
    angles = _angle(inside, below)
    angles[..., 1:] += _angle(above[..., :-1, :], inside[:, 1:])
    return np.where(rubbing(route), angles, 0.0)


def rubbing(route: Routing) -> NDArray[np.bool_]:
    """Return before which joints each cable passes guides that turn it, shape (C, J)."""
    joint, first = np.arange(len(route.axes)), route.first[:, None]
    return (joint < route.joints[:, None]) & (joint >= first + (first > 0))


def _angle(one: Array, other: Array) -> Array:
    """Return the angles between vectors, shape (...), in [rad]."""
    across = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.arctan2(across, (one * other).sum(axis=-1))


def tail_jacobian(route: Routing, hinges: Array) -> Array:
    """Return the derivatives of every cable's length from each joint to its anchor, shape
    (..., C, J, H), in [m/rad].

    Args:
        route, hinges: as for :func:`turning_angles`.
    """
    _, by_hinge = _crossings(route, hinges)
    joint_of_hinge = np.zeros(by_hinge.shape[-1], int)
    for joint, numbers in enumerate(route.hinges):
        joint_of_hinge[numbers[numbers >= 0]] = joint
    return by_hinge[..., None, :] * (joint_of_hinge >= np.arange(len(route.axes))[:, None])


def _about(axis: Array, angle: Array) -> Array:
    """Return the rotations by `angle`, shape (..., J), about unit axes (J, 3), by Rodrigues'
    formula."""
    cross = np.cross(axis[:, None], np.eye(3)).swapaxes(-1, -2)  # cross @ v = axis x v
    sin, cos = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + sin * cross + (1 - cos) * (cross @ cross)
