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

Dampers that would be too stiff are implicit: see :mod:`backends.pybullet.dampers`.

Limits are Bullet's, of hinges and of sliders at their stops. A joint that is past its limit has a
row in the problem, because Bullet's push there changes the tensions; but only tensions are handed
on.

Coupled hinges, which always have the same angle, have rows E a = -(E v + E q / h) / h in the same
problem, with forces of either sign, which are handed on. Their limits are rows too, one for each
set of them, and not Bullet's, which does not know that the other hinges move along.

Coordinates are Bullet's: base angular, base linear, sliders, hinges, with the base's in the base's
frame. No cable touches the base, so nothing has to be turned. The equations are solved with the
base last: the mass matrix couples no slider to another or to a hinge, and so does not its factor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backends.pybullet.dampers import damp, fill_mass, stiff_dampers
from backends.pybullet.lcp import (
    factor,
    solve_boxed,
    solve_complementarity,
    solve_with_equalities,
)
from backends.pybullet.rig import Packed, Rig, cable_rows, unpacked
from cdcsr.compiled import compiled

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_CREEP = 1e-5
"""A cable that sticks in a guide creeps by this part of what its friction would move it by alone.
There are more guides than coordinates, so that without it friction would have many solutions."""
LIMIT_RECOVERY = 0.2
"""The part of the excess that Bullet takes back in a step from a joint past its limit. A joint that
has not passed it yet moves freely."""


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
    softness: Array,
    whole: Array,
    room: Array,
    apart: Array,
    pull: Array,
    pushes: Array,
    force: Array,
) -> None:
    """Find the forces of cables and limits, and those of linkages.

    Args:
        rig: the robot's numbers.
        limited: the joints that are past their limits.
        softness: c / h^2 of each cable, shape (C,).
        whole: U, the factor of the mass matrix; U'^-1 times what drives, to which linkages are
            added; U'^-1 times the rows of cables, limits and linkages.
        room: what the rows of cables and limits may reach; what drives is taken off.
        apart: what the rows of linkages must reach.
        pull: replaced by the forces of cables and limits; the old ones are a first guess.
        pushes: all rows.
        force: the forces on the joints; those that Bullet does not know are added, but for cables.
    """
    size, count, cables = whole.shape[1], pull.size, softness.size
    rest, white, held = whole[size], whole[size + 1 : size + 1 + count], whole[size + 1 + count :]
    matrix = white @ white.T
    for c in range(cables):
        matrix[c, c] += softness[c]
    room -= white @ rest
    if not len(held):
        solve_complementarity(matrix, room, pull)
        return
    linkage = solve_with_equalities(matrix, white, held, room, apart - held @ rest, pull)
    rest -= linkage @ held
    force -= linkage @ pushes[count:]
    _push_coupled(rig, limited, pull, pushes, force)


@compiled()
def _push_coupled(rig: Rig, limited: Ints, pull: Array, pushes: Array, force: Array) -> None:
    """Add the forces of the limits of coupled hinges, which Bullet does not know."""
    cables = pull.size - limited.size
    for i, k in enumerate(limited):
        if k >= cables and (rig.leader == rig.leader[k - cables]).sum() > 1:
            force -= pull[cables + i] * pushes[cables + i]


@compiled()
def _solve_rubbing(
    rig: Rig,
    limited: Ints,
    softness: Array,
    whole: Array,
    room: Array,
    bound: Array,
    pull: Array,
    pushes: Array,
    force: Array,
    friction: Array,
) -> None:
    """Do what :func:`_solve` does, where cables rub in their guides.

    Args:
        rig, limited, softness, pull, pushes, force: as there.
        whole: as there; the last rows are those of friction.
        room: what all rows may or must reach; what drives is taken off.
        bound: the largest friction of each place, shape (R,), in [N].
        friction: as for :func:`joint_forces`.
    """
    size, count = whole.shape[1], pull.size
    rest, white = whole[size], whole[size + 1 :]
    total, held = len(white), len(white) - bound.size
    matrix = white @ white.T
    for c in range(softness.size):
        matrix[c, c] += softness[c]
    for i in range(held, total):
        matrix[i, i] *= 1 + _CREEP
    lower, upper, solution = np.zeros(total), np.full(total, np.inf), np.zeros(total)
    lower[count:held], lower[held:], upper[held:] = -np.inf, -bound, bound
    solution[:count], solution[held:] = pull, -friction
    solve_boxed(matrix, room - white @ rest, lower, upper, solution)
    pull[:] = solution[:count]
    friction[:] = -solution[held:]
    rest -= solution[count:] @ white[count:]
    force -= solution[count:] @ pushes[count:]
    _push_coupled(rig, limited, pull, pushes, force)


@compiled()
def _cable_slack(rig: Rig, excess: Array, step: float, slack: Array) -> None:
    """Fill in how fast each cable may get longer, in [m/s]."""
    for c in range(excess.size):
        gap = rig.rest_length_offset[c] - excess[c]
        springs = rig.cable_compliance[c] > 0
        slack[c] = gap / (step if gap >= 0 or springs else rig.recovery_time)


@compiled()
def _take_off(rows: Array, velocity: Array, slack: Array) -> None:
    """Take how fast the rows move already off how fast they may."""
    for i in range(slack.size):
        for k in range(velocity.size):
            slack[i] -= rows[i, k] * velocity[k]


@compiled()
def _servo_forces(rig: Rig, command: Array, travel: Array) -> Array:
    """Return the forces of the servos on their sliders, shape (C,), in [N]."""
    force = rig.servo_gain * (rig.sign * command - rig.returns * travel) - rig.pretension
    return np.minimum(np.maximum(force, -rig.force_limit), rig.force_limit)


@compiled()
def _drive(
    rig: Rig, bias: Array, velocity: Array, servo: Array, force: Array, drive: Array
) -> None:
    """Fill in all that moves sliders, hinges and base but cables, limits and linkages."""
    moving = velocity.size
    drive[:moving] = force - rig.damping * velocity - bias[6:]
    drive[: servo.size] += servo
    drive[moving:] = -bias[:6]


@compiled()
def joint_forces(
    numbers: Packed,
    mass: Array,
    bias: Array,
    joints: Array,
    velocity: Array,
    command: Array,
    step: float,
    tails: Array,
    bound: Array,
    tension: Array,
    friction: Array,
    motors: bool,
    servo: Array,
    force: Array,
) -> None:
    """Find the tensions of the coming step of one copy, and the joint forces to hand to Bullet.

    Args:
        numbers: the copy's.
        mass: M, shape (nv, nv), in Bullet's coordinates.
        bias: shape (nv,).
        joints: positions of sliders and hinges, shape (C + H,), in [m] and [rad].
        velocity: of sliders and hinges, shape (C + H,), in [m/s] and [rad/s].
        command: of the servos, shape (C,), in [m] or [N].
        step: h in [s].
        tails: derivatives of the cables' lengths from each place where one rubs to its anchor by
            the hinges, shape (R, H); no rows where nothing rubs.
        bound: the largest friction of each place, shape (R,), in [N].
        tension: shape (C,), in [N]; replaced. The old ones are a first guess of which cables pull.
        friction: by how much the tension before each place exceeds that behind it, shape (R,), in
            [N]; replaced likewise.
        motors: whether Bullet's motors are the servos.
        servo: filled with the servos' forces on the sliders, shape (C,), in [N].
        force: filled with the forces on sliders and hinges, shape (C + H,), in [N] and [N m]:
            springs, cables, servos unless Bullet's motors are these, and what makes stiff dampers
            implicit; not Bullet's own dampers and hinge limits.
    """
    rig, cables, size = unpacked(numbers), tension.size, mass.shape[0]
    hinges = joints[cables:]
    servo[:] = _servo_forces(rig, command, joints[:cables])
    force[:cables] = 0.0
    force[cables:] = -rig.stiffness * (hinges - rig.rest)

    # Rows of `whole`: the mass matrix, what drives, the cables, the limits of joints past them.
    limited = np.flatnonzero((joints > rig.upper) | (joints < rig.lower))
    followers = np.flatnonzero(rig.leader != np.arange(hinges.size))
    if followers.size:
        limited = _first_of_each(rig.leader, limited, cables)
    count = cables + limited.size
    whole = np.zeros((size + 1 + count + followers.size + bound.size, size))
    rows = whole[size + 1 :, : velocity.size]
    excess = cable_rows(rig, joints[:cables], hinges, rows)
    slack, pull = np.empty(count), np.zeros(count)
    _cable_slack(rig, excess, step, slack)
    _limit_rows(rig, limited, joints, step, rows[cables:], slack[cables:])
    _take_off(rows[:count], velocity, slack)
    slack /= step
    rates, linked = velocity[cables:], rows[count : count + followers.size, cables:]
    apart = _linkage_rows(rig, followers, hinges, rates, step, linked)
    rows[count + followers.size :, cables:] = tails

    stiff = step * stiff_dampers(rig, hinges, step)
    fill_mass(whole, mass, stiff)
    _drive(rig, bias, velocity, servo, force, whole[size])
    pushes = rows.copy()
    inverse = factor(whole)
    pull[:cables] = tension
    softness = rig.cable_compliance / step**2
    if bound.size:
        room = np.concatenate((slack, apart, -(tails @ rates) / step))
        _solve_rubbing(rig, limited, softness, whole, room, bound, pull, pushes, force, friction)
    else:
        _solve(rig, limited, softness, whole, slack, apart, pull, pushes, force)
    tension[:] = pull[:cables]
    for c in range(cables):
        force -= tension[c] * pushes[c]
    if stiff.any():
        damp(whole, inverse, pull, stiff, force)
    if not motors:
        force[:cables] += servo
