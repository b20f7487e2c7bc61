"""The numbers of a copy on which its cables depend, and the rows of the cables, compiled."""

from __future__ import annotations

from copy import deepcopy
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from cdcsr.compiled import compiled
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import crossing, routing
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.plant import Parameters, Plant

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Number = TypeVar("Number", np.float64, np.int64)

_crossing = compiled()(crossing)
_DAMPER_STEP = 0.0025
"""That of :class:`Rig` for the paper's robot; those of others are in proportion to their pace."""


class Rig(NamedTuple):
    """The cables and hinges of one copy as plain arrays; C cables, J joints, H hinges.

    :func:`unpacked` takes the numbers in this order, first those that are not whole.
    """

    place: Array
    """Position across the arm, shape (C, 2), in [m]."""
    guide_offset: Array
    """Shape (C,), in [m]."""
    low: Array
    """The guides just below the joints, shape (C, J, 3), in [m]."""
    high: Array
    """The guides just above the joints, shape (C, J, 3), in [m]."""
    chord: Array
    """Their distance while the joint is straight, shape (C, J), in [m]."""
    slider_offset: Array
    """Shape (C,), in [m]."""
    slider_mass: Array
    """Shape (C,), in [kg]."""
    bent: Array
    """How much longer the cables are at the start than along the straight arm, shape (C,), in
    [m]."""
    rest: Array
    """Rest angles of the hinges, shape (H,), in [rad]."""
    lower: Array
    """Minus infinity for each slider, which nothing stops on its way down, then the lowest angle of
    each hinge in [rad], shape (C + H,)."""
    upper: Array
    """The largest travel of each slider in [m], then angle of each hinge in [rad], (C + H,)."""
    sign: Array
    """Minus one for a servo whose commands are tensions, else one; shape (C,)."""
    returns: Array
    """One for a servo whose force falls as its slider moves, else zero; shape (C,)."""
    pretension: Array
    """Shape (C,), in [N]."""
    force_limit: Array
    """The largest force of each servo, shape (C,), in [N]."""
    recovery_time: float
    """The time constant with which an excess of length decays, in [s]."""
    damper_step: float
    """Which dampers are implicit is decided for a step of at least this, in [s]."""
    base_inertia: Array
    """Shape (3,), in [kg m^2]; this and the numbers below are a row of :class:`Plant`."""
    link_inertia: Array
    """Shape (J, 3), in [kg m^2]."""
    stiffness: Array
    """Shape (H,), in [N m/rad]."""
    damping: Array
    """The dampers of sliders and hinges, shape (C + H,), in [N s/m] and [N m s/rad]."""
    servo_gain: Array
    """Shape (C,), in [N/m]; one for a tension servo."""
    rest_length_offset: Array
    """Shape (C,), in [m]."""
    cable_compliance: Array
    """Shape (C,), in [m/N]."""
    plain: bool
    """Whether every joint bends about x, then about y, and does not twist, and all cables run
    straight along the arm."""
    universal: bool
    """Whether every joint bends about x, then about y, and does not twist."""
    hinges: Ints
    """The numbers of each joint's hinges, the lowest first, shape (J, 3); -1 is no hinge."""
    axes: Ints
    """The axis of each of these hinges: 0, 1, 2 for x, y, z; shape (J, 3)."""
    joints: Ints
    """One more than the last joint that each cable crosses, shape (C,)."""
    first: Ints
    """The first joint that each cable crosses, shape (C,)."""
    leader: Ints
    """The hinge whose angle each hinge always has, mostly its own, shape (H,)."""


def rig(robot: Robot, plant: Plant | None = None, copy: int = 0) -> Rig:
    """Return the numbers that the tensions of a copy depend on.

    Args:
        robot: the description.
        plant: how copies differ from it; by default they do not.
        copy: the row of `plant`.
    """
    route = deepcopy(routing(robot))  # compiled functions take read-only arrays for another type
    made = Rig(
        place=route.place,
        guide_offset=route.guide_offset,
        low=route.low,
        high=route.high,
        chord=route.chord,
        slider_offset=route.slider_offset,
        slider_mass=np.array([servo.mass for servo in robot.servos], dtype=float),
        bent=route.bent,
        rest=np.array(robot.start_angles),
        lower=np.array([-np.inf] * robot.num_cables + [h.lower for h in robot.hinges]),
        upper=np.array([s.stop for s in robot.servos] + [h.upper for h in robot.hinges]),
        sign=np.array([s.sign for s in robot.servos], dtype=float),
        returns=np.array([float(servo.stiffness > 0) for servo in robot.servos]),
        pretension=np.array([servo.pretension for servo in robot.servos], dtype=float),
        force_limit=np.array([servo.force_limit or np.inf for servo in robot.servos]),
        recovery_time=robot.constraint.recovery_time,
        damper_step=_DAMPER_STEP * ruler(robot).pace,
        **_row(Parameters().plant(robot, 1), 0),
        plain=route.is_universal and route.parallel,
        universal=route.is_universal,
        hinges=route.hinges,
        axes=route.axes,
        joints=route.joints,
        first=route.first,
        leader=np.array(robot.leaders, dtype=int),
    )
    return made if plant is None else of_copy(made, plant, copy)


def of_copy(rig: Rig, plant: Plant, copy: int) -> Rig:
    """Return a rig with the numbers in a row of `plant`."""
    return rig._replace(**_row(plant, copy))


def _row(plant: Plant, copy: int) -> dict[str, Array]:
    return {name: part[copy] for name, part in plant._asdict().items() if name in Rig._fields}


class Packed(NamedTuple):
    """The numbers of a rig in two arrays; Numba takes a fifth of a microsecond for each array that
    a call brings."""

    real: Array
    whole: Ints


def packed(rig: Rig) -> Packed:
    """Return the numbers of a rig, from which :func:`unpacked` makes it again."""
    cables, joints = rig.chord.shape
    parts = [np.ravel(part) for part in rig]
    count = Rig._fields.index("plain")
    sizes = np.array([cables, joints, len(rig.rest)])
    whole = np.concatenate([sizes, *parts[count:]]).astype(np.int64)
    return Packed(np.concatenate(parts[:count]), whole)


@compiled()
def _take(numbers: NDArray[Number], place: Ints, count: int) -> NDArray[Number]:
    """Return the next numbers, and move the place in `numbers` on."""
    start = place[0]
    place[0] += count
    return numbers[start : place[0]]


@compiled()
def unpacked(numbers: Packed) -> Rig:
    """Return the rig whose numbers :func:`packed` has put together; its arrays are views."""
    real, whole = numbers
    at, now = np.zeros(1, np.int64), np.full(1, 3)
    c, j, h = whole[0], whole[1], whole[2]
    return Rig(
        _take(real, at, 2 * c).reshape(c, 2),
        _take(real, at, c),
        _take(real, at, 3 * c * j).reshape(c, j, 3),
        _take(real, at, 3 * c * j).reshape(c, j, 3),
        _take(real, at, c * j).reshape(c, j),
        _take(real, at, c),
        _take(real, at, c),
        _take(real, at, c),
        _take(real, at, h),
        _take(real, at, c + h),
        _take(real, at, c + h),
        _take(real, at, c),
        _take(real, at, c),
        _take(real, at, c),
        _take(real, at, c),
        _take(real, at, 1)[0],
        _take(real, at, 1)[0],
        _take(real, at, 3),
        _take(real, at, 3 * j).reshape(j, 3),
        _take(real, at, h),
        _take(real, at, c + h),
        _take(real, at, c),
        _take(real, at, c),
        _take(real, at, c),
        _take(whole, now, 1)[0] > 0,
        _take(whole, now, 1)[0] > 0,
        _take(whole, now, 3 * j).reshape(j, 3),
        _take(whole, now, 3 * j).reshape(j, 3),
        _take(whole, now, c),
        _take(whole, now, c),
        _take(whole, now, h),
    )


@compiled()
def cable_rows(rig: Rig, travel: Array, hinges: Array, jacobian: Array) -> Array:
    """Return how much longer than at rest every cable is, as described, shape (C,), in [m].

    Args:
        rig: the robot's numbers.
        travel: shape (C,), in [m].
        hinges: shape (H,), in [rad].
        jacobian: filled with the derivatives by sliders and hinges, shape (C, C + H).
    """
    excess = np.empty(travel.size)
    sine, cosine = np.sin(hinges), np.cos(hinges)
    for c in range(travel.size):
        px, py, offset = rig.place[c, 0], rig.place[c, 1], rig.guide_offset[c]
        below = rig.slider_offset[c] - travel[c]
        jacobian[c, c] = -np.sign(below)
        total = abs(below) - rig.slider_offset[c] - rig.bent[c]
        for n in range(rig.first[c], rig.joints[c]):
            if not rig.plain:
                row, low, high = jacobian[c, travel.size :], rig.low[c, n], rig.high[c, n]
                total += _any_crossing(rig, n, sine, cosine, low, high, row) - rig.chord[c, n]
                continue
            x, y = 2 * n, 2 * n + 1
            length, by_x, by_y = _crossing(sine[x], cosine[x], sine[y], cosine[y], px, py, offset)
            total += length - 2 * offset
            jacobian[c, travel.size + x], jacobian[c, travel.size + y] = by_x, by_y
        excess[c] = total
    return excess


@compiled()
def _any_crossing(
    rig: Rig, joint: int, sine: Array, cosine: Array, low: Array, high: Array, row: Array
) -> float:
    """Return the length between the guides below and above a joint of any hinges, in [m].

    The upper guide is turned by R = R_1 R_2 R_3. With w_k = R_k ... R_3 high, a unit rate of the
    hinge k moves it by R_1 ... R_(k-1) (a_k x w_k).

    Args:
        rig: the robot's numbers.
        joint: its number.
        sine, cosine: of all hinges.
        low, high: the places of the guides in their links' frames at the joint, shape (3,), in [m].
        row: filled with the derivatives by the joint's hinges, shape (H,), in [m/rad].
    """
    turned, point = np.empty((3, 3)), high.copy()
    for k in range(2, -1, -1):
        hinge = rig.hinges[joint, k]
        if hinge >= 0:
            _turn(point, rig.axes[joint, k], sine[hinge], cosine[hinge])
            turned[k] = point
    along = point - low
    length = np.sqrt(along[0] ** 2 + along[1] ** 2 + along[2] ** 2)
    for k in range(3):
        hinge, a = rig.hinges[joint, k], rig.axes[joint, k]
        if hinge >= 0:
            b, c = (a + 1) % 3, (a + 2) % 3  # a_k x w has -w_c along b, and w_b along c
            row[hinge] = (turned[k, b] * along[c] - turned[k, c] * along[b]) / length
            _turn(along, a, -sine[hinge], cosine[hinge])
    return length


@compiled()
def _turn(vector: Array, axis: int, sine: Array, cosine: Array) -> None:
    """Turn a vector about a coordinate axis by the angle of a sine and a cosine."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    first, second = vector[b], vector[c]
    vector[b], vector[c] = cosine * first - sine * second, sine * first + cosine * second
