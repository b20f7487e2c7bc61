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

Coupled hinges, which always have the same angle, have rows E a = -(E v + E q / h) / h in the same
problem, with forces of either sign, which are handed on. Their limits are rows too, one for each
set of them, and not Bullet's, which does not know that the other hinges move along.

Coordinates are Bullet's: base angular, base linear, sliders, hinges, with the base's in the base's
frame. No cable touches the base, so nothing has to be turned.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backends.pybullet.lcp import (
    factor,
    solve_complementarity,
    solve_transposed,
    solve_with_equalities,
)
from backends.pybullet.rig import Rig, cable_rows
from cdcsr.compiled import compiled
from cdcsr.simulation.plant import Plant

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LIMIT_RECOVERY = 0.2
"""The part of the excess that Bullet takes back in a step from a joint past its limit. A joint that
has not passed it yet moves freely."""


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
def _limit_rows(
    rig: Rig, limited: Ints, joints: Array, step: float, rows: Array, slack: Array
) -> None:
    """Fill in the rows of joints that are past their limits, and how fast they may go on."""
    for i, k in enumerate(limited):
        above = joints[k] > rig.upper[k]
        rows[i, k] = 1.0 if above else -1.0
        gap = rig.upper[k] - joints[k] if above else joints[k] - rig.lower[k]
        slack[i] = LIMIT_RECOVERY * gap / step


@compiled()
def _first_of_each(leader: Ints, limited: Ints, cables: int) -> Ints:
    """Keep only the first of the coupled joints that are past their limits.

    Args:
        leader: of each hinge.
        limited: numbers of joints, sliders first, in order.
        cables: the number of sliders.
    """
    seen = np.zeros(leader.size, np.bool_)
    keep = np.ones(limited.size, np.bool_)
    for i, k in enumerate(limited):
        if k >= cables:
            keep[i] = not seen[leader[k - cables]]
            seen[leader[k - cables]] = True
    return limited[keep]


@compiled()
def _linkage_rows(
    rig: Rig, followers: Ints, hinges: Array, rates: Array, step: float, rows: Array
) -> Array:
    """Fill in E, a row for each hinge that follows another, shape (K, H), and return what E a must
    be, shape (K,), so that the step ends at equal angles."""
    wanted = np.empty(followers.size)
    for i, hinge in enumerate(followers):
        leader = rig.leader[hinge]
        rows[i, hinge], rows[i, leader] = 1.0, -1.0
        apart = hinges[hinge] - hinges[leader]
        wanted[i] = -((rates[hinge] - rates[leader]) + apart / step) / step
    return wanted


@compiled()
def _solve(
    rig: Rig,
    limited: Ints,
    matrix: Array,
    white: Array,
    held: Array,
    room: Array,
    apart: Array,
    rest: Array,
    pull: Array,
    pushes: Array,
    force: Array,
) -> None:
    """Find the forces of cables and limits, and those of linkages.

    Args:
        rig: the robot's numbers.
        limited: the joints that are past their limits.
        matrix: of the forces of cables and limits.
        white: L^-1 times the rows of cables and limits, where L is the factor of the mass matrix.
        held: the same of linkages.
        room: what these rows may reach beyond what drives.
        apart: what the rows of linkages must reach.
        rest: L^-1 times what drives; linkages are added.
        pull: replaced by the forces of cables and limits; the old ones are a first guess.
        pushes: all rows.
        force: the forces on the joints; those that Bullet does not know are added, but for cables.
    """
    if not len(held):
        solve_complementarity(matrix, room, pull)
        return
    linkage = solve_with_equalities(matrix, white, held, room, apart - held @ rest, pull)
    rest -= linkage @ held
    force -= linkage @ pushes[len(white) :]
    cables = len(white) - limited.size
    for i, k in enumerate(limited):
        if k >= cables and rig.coupled[k - cables]:
            force -= pull[cables + i] * pushes[cables + i]


@compiled()
def _cable_slack(
    rig: Rig, plant: Plant, copy: int, excess: Array, step: float, slack: Array
) -> None:
    """Fill in how fast each cable may get longer, in [m/s]."""
    for c in range(excess.size):
        gap = plant.rest_length_offset[copy, c] - excess[c]
        springs = plant.cable_compliance[copy, c] > 0
        slack[c] = gap / (step if gap >= 0 or springs else rig.recovery_time)


@compiled()
def _fill_mass(whole: Array, mass: Array, stiff: Array) -> None:
    """Fill in M + h C, where `stiff` is the diagonal of h C for sliders and hinges."""
    whole[: len(mass)] = mass
    for k in range(stiff.size):
        whole[6 + k, 6 + k] += stiff[k]


@compiled()
def _servo_forces(rig: Rig, gain: Array, command: Array, travel: Array) -> Array:
    """Return the forces of the servos on their sliders, shape (C,), in [N]."""
    force = gain * (rig.sign * command - rig.returns * travel) - rig.pretension
    return np.minimum(np.maximum(force, -rig.force_limit), rig.force_limit)


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
        command: of the servos, shape (C,), in [m] or [N].
        step: h in [s].
        tension: shape (C,), in [N]; replaced. The old ones are a first guess of which cables pull.
        servo: filled with the servos' forces on the sliders, shape (C,), in [N].
        force: filled with all other forces on sliders and hinges, shape (C + H,), in [N] and [N m]:
            springs, cables, and what makes stiff dampers implicit; not Bullet's own dampers
            and hinge limits.
    """
    cables, size = tension.size, mass.shape[0]
    hinges = joints[cables:]
    servo[:] = _servo_forces(rig, plant.servo_gain[copy], command, joints[:cables])
    force[:cables] = 0.0
    force[cables:] = -plant.stiffness[copy] * (hinges - rig.rest)

    # Rows of `whole`: the mass matrix, what drives, the cables, the limits of joints past them.
    limited = np.flatnonzero((joints > rig.upper) | (joints < rig.lower))
    followers = np.flatnonzero(rig.leader != np.arange(hinges.size))
    if followers.size:
        limited = _first_of_each(rig.leader, limited, cables)
    count = cables + limited.size
    whole = np.zeros((size + 1 + count + followers.size, size))
    rows = whole[size + 1 :, 6:]
    excess = cable_rows(rig, joints[:cables], hinges, rows)
    slack, pull = np.empty(count), np.zeros(count)
    _cable_slack(rig, plant, copy, excess, step, slack)
    _limit_rows(rig, limited, joints, step, rows[cables:], slack[cables:])
    for i in range(count):
        for k in range(velocity.size):
            slack[i] -= rows[i, k] * velocity[k]
    slack /= step
    apart = _linkage_rows(rig, followers, hinges, velocity[cables:], step, rows[count:, cables:])

    stiff = step * stiff_dampers(rig, plant, copy, hinges, step)
    whole[size] = -bias
    whole[size, 6:] += force - plant.damping[copy] * velocity
    whole[size, 6 : 6 + cables] += servo
    _fill_mass(whole, mass, stiff)
    pushes = rows.copy()
    inverse = factor(whole)
    white, rest = whole[size + 1 : size + 1 + count], whole[size]
    pull[:cables] = tension
    matrix = white @ white.T
    for c in range(cables):
        matrix[c, c] += plant.cable_compliance[copy, c] / step**2
    slack -= white @ rest
    held = whole[size + 1 + count :]
    _solve(rig, limited, matrix, white, held, slack, apart, rest, pull, pushes, force)
    tension[:] = pull[:cables]
    for c in range(cables):
        force -= tension[c] * pushes[c]
    if stiff.any():
        rest -= pull @ white
        solve_transposed(whole, inverse, rest)
        force -= stiff * rest[6:]
