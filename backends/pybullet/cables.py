"""The cables as unilateral constraints between PyBullet's steps, compiled.

Bullet moves the robot; it has no cables. Before each of its steps the tensions are found under
which no cable ends the step longer than at rest, from Bullet's own mass matrix M and bias force b
(:mod:`backends.pybullet.equation`) and the routing's Jacobian L:

    M a + b = f - L^T t,    0 <= t  complementary to  L (v + h a) <= (gap + c t) / h

where c is the compliance of each cable, zero if it does not stretch, and f are servos, springs and
dampers, explicit as Bullet's own joint damping is. Then f - L^T t,
without the dampers, is given to Bullet as joint torques. What Bullet alone knows of (the damping of
its bodies, its clamp on speeds) is not in f, so that a cable may end a step longer by as much as
these move it; the next step takes it back.

An explicit damper c oscillates where h c exceeds the inertia that it acts on. So it is for a link
bent by nearly a right angle, which its first hinge then turns about its own thin axis. There, and
only there, the damper is made implicit: M + h c takes the place of M, and -h c a is a torque more.
At joints of another kind, whose links may be thin rods, all dampers are implicit.

Limits are Bullet's, of hinges and of sliders at their stops. A joint that is past its limit has a
row in the problem, because Bullet's push there changes the tensions; but only tensions are handed
on.

Coordinates are Bullet's: base angular, base linear, sliders, hinges, with the base's in the base's
frame. No cable touches the base, so nothing has to be turned.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backends.pybullet.lcp import factor, solve_complementarity, solve_transposed
from cdcsr.compiled import compiled
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import crossing, routing
from cdcsr.simulation.plant import Plant

Array = NDArray[np.float64]

LIMIT_RECOVERY = 0.2
"""The part of the excess that Bullet takes back in a step from a joint past its limit. A joint that
has not passed it yet moves freely."""

_crossing = compiled()(crossing)


class Rig(NamedTuple):
    """The cables and hinges of a robot as plain arrays; C cables, J joints, H hinges."""

    universal: bool
    """Whether every joint bends about x, then about y, and does not twist."""
    hinges: NDArray[np.int64]
    """The numbers of each joint's hinges, the lowest first, shape (J, 3); -1 is no hinge."""
    axes: NDArray[np.int64]
    """The axis of each of these hinges: 0, 1, 2 for x, y, z; shape (J, 3)."""
    place: Array
    """Position across the arm, shape (C, 2), in [m]."""
    guide_offset: Array
    """Shape (C,), in [m]."""
    joints: NDArray[np.int64]
    """How many joints each cable crosses, shape (C,)."""
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
    recovery_time: float
    """The time constant with which an excess of length decays, in [s]."""


def rig(robot: Robot) -> Rig:
    """Return the numbers of a robot that its tensions depend on and that no copy changes."""
    route = routing(robot)
    return Rig(
        universal=route.is_universal,
        hinges=route.hinges,
        axes=route.axes,
        place=route.place,
        guide_offset=route.guide_offset,
        joints=route.joints,
        slider_offset=route.slider_offset,
        slider_mass=np.array([servo.mass for servo in robot.servos], dtype=float),
        bent=route.bent,
        rest=np.array(robot.start_angles),
        lower=np.array([-np.inf] * robot.num_cables + [h.lower for h in robot.hinges]),
        upper=np.array([s.stop for s in robot.servos] + [h.upper for h in robot.hinges]),
        recovery_time=robot.constraint.recovery_time,
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
        for n in range(rig.joints[c]):
            if not rig.universal:
                low, high = np.array([px, py, -offset]), np.array([px, py, offset])
                row = jacobian[c, travel.size :]
                total += _any_crossing(rig, n, sine, cosine, low, high, row) - 2 * offset
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


@compiled()
def stiff_dampers(rig: Rig, plant: Plant, copy: int, hinges: Array, step: float) -> Array:
    """Return the dampers that must be implicit, others as zero, shape (C + H,).

    A damper turns the two bodies at its hinge against each other. Alone in space, moments I and J
    about its axis, it would change their relative speed by h c (1 / I + 1 / J) of itself in a step;
    an explicit step is stable below 2. In the chain up to four dampers act on one link about one
    axis, so that a damper is explicit below 1/2.

    Args:
        rig, plant, copy, step: as for :func:`joint_forces`.
        hinges: shape (H,), in [rad].
    """
    cables, damping = rig.slider_mass.size, plant.damping[copy]
    if not rig.universal:
        return damping.copy()
    stiff = np.zeros(damping.size)
    for c in range(cables):
        if step * damping[c] / rig.slider_mass[c] > 0.5:
            stiff[c] = damping[c]
    lower = plant.base_inertia[copy]
    for j in range(hinges.size // 2):
        upper = plant.link_inertia[copy, j]
        # The x axis belongs to the lower body and is tilted in the upper one; y the other way.
        tilt_x, tilt_y = np.sin(hinges[2 * j + 1]) ** 2, np.sin(hinges[2 * j]) ** 2
        about_x = upper[0] * (1 - tilt_x) + upper[2] * tilt_x
        about_y = lower[1] * (1 - tilt_y) + lower[2] * tilt_y
        x, y = cables + 2 * j, cables + 2 * j + 1
        if step * damping[x] * (1 / lower[0] + 1 / about_x) > 0.5:
            stiff[x] = damping[x]
        if step * damping[y] * (1 / about_y + 1 / upper[1]) > 0.5:
            stiff[y] = damping[y]
        lower = upper
    return stiff


@compiled()
def joint_forces(
    rig: Rig,
    plant: Plant,
    copy: int,
    mass: Array,
    bias: Array,
    joints: Array,
    velocity: Array,
    command: Array,
    step: float,
    tension: Array,
    servo: Array,
    force: Array,
) -> None:
    """Find the tensions of the coming step of one copy, and the joint forces to hand to Bullet.

    Args:
        rig: the robot's numbers.
        plant: the numbers of all copies.
        copy: the row of `plant` to use.
        mass: M, shape (nv, nv), in Bullet's coordinates.
        bias: shape (nv,).
        joints: positions of sliders and hinges, shape (C + H,), in [m] and [rad].
        velocity: of sliders and hinges, shape (C + H,), in [m/s] and [rad/s].
        command: servo set-points, shape (C,), in [m].
        step: h in [s].
        tension: shape (C,), in [N]; replaced. The old ones are a first guess of which cables pull.
        servo: filled with the servos' forces on the sliders, shape (C,), in [N].
        force: filled with all other forces on sliders and hinges, shape (C + H,), in [N] and [N m]:
            springs, cables, and what makes stiff dampers implicit; not Bullet's own dampers
            and hinge limits.
    """
    cables, size = tension.size, mass.shape[0]
    hinges = joints[cables:]
    servo[:] = plant.servo_gain[copy] * (command - joints[:cables])
    force[:cables] = 0.0
    force[cables:] = -plant.stiffness[copy] * (hinges - rig.rest)

    # Rows of `whole`: the mass matrix, what drives, the cables, the limits of joints past them.
    limited = np.flatnonzero((joints > rig.upper) | (joints < rig.lower))
    count = cables + limited.size
    whole = np.zeros((size + 1 + count, size))
    rows = whole[size + 1 :, 6:]
    excess = cable_rows(rig, joints[:cables], hinges, rows)
    slack, pull = np.empty(count), np.zeros(count)
    for c in range(cables):
        gap = plant.rest_length_offset[copy, c] - excess[c]
        springs = plant.cable_compliance[copy, c] > 0
        slack[c] = gap / (step if gap >= 0 or springs else rig.recovery_time)
    for i, k in enumerate(limited):
        above = joints[k] > rig.upper[k]
        rows[cables + i, k] = 1.0 if above else -1.0
        gap = rig.upper[k] - joints[k] if above else joints[k] - rig.lower[k]
        slack[cables + i] = LIMIT_RECOVERY * gap / step
    for i in range(count):
        for k in range(velocity.size):
            slack[i] -= rows[i, k] * velocity[k]
    slack /= step

    stiff = step * stiff_dampers(rig, plant, copy, hinges, step)
    whole[:size] = mass
    whole[size] = -bias
    whole[size, 6:] += force - plant.damping[copy] * velocity
    whole[size, 6 : 6 + cables] += servo
    for k in range(stiff.size):
        whole[6 + k, 6 + k] += stiff[k]
    pushes = rows[:cables].copy()
    inverse = factor(whole)
    white, rest = whole[size + 1 :], whole[size]
    pull[:cables] = tension
    matrix = white @ white.T
    for c in range(cables):
        matrix[c, c] += plant.cable_compliance[copy, c] / step**2
    solve_complementarity(matrix, slack - white @ rest, pull)
    tension[:] = pull[:cables]
    for c in range(cables):
        force -= tension[c] * pushes[c]
    if stiff.any():
        rest -= pull @ white
        solve_transposed(whole, inverse, rest)
        force -= stiff * rest[6:]
