"""The largest time step at which the springs of a robot are stable, and speeds that no step can
follow."""

from __future__ import annotations

from itertools import pairwise
from math import inf, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot

MAX_TURN = 0.5
"""A step in which a hinge or the base turns by more than this, in [rad], means nothing."""

_IMMOVABLE = 1e100
"""The moment of inertia that a fixed base acts as, in [kg m^2]."""


def highest_speeds(robot: Robot) -> NDArray[np.float64]:
    """Return the speed of each coordinate above which a copy has diverged, shape (nv,), in [m/s]
    and [rad/s].

    In one time step the base and sliders move by less than the arm's length, and bodies turn by
    less than :data:`MAX_TURN`; a hinge by less than from one of its limits to the other. So limits
    do not hide a hinge that shakes between them.
    """
    hinges = [min(MAX_TURN, hinge.upper - hinge.lower) for hinge in robot.hinges]
    length = [robot.arm_length]
    turns = [*3 * length, *3 * [MAX_TURN], *robot.num_cables * length, *hinges]
    return np.array(turns) / robot.time_step


def too_fast(speeds: NDArray[np.float64], highest: NDArray[np.float64]) -> str:
    """Say which coordinate has made a copy diverge.

    Args:
        speeds: shape (nv,), in [m/s] and [rad/s].
        highest: from :func:`highest_speeds`.
    """
    if not np.isfinite(speeds).all():
        return "velocities are no longer finite"
    worst = int(np.argmax(np.abs(speeds) / highest))
    least = f"more than {highest[worst]:.3g}"
    return f"coordinate {worst} moves at {abs(speeds[worst]):.3g}, {least}"


def stable_step(robot: Robot) -> float:
    """Return a time step in [s] below which no spring of hinges or servos shakes the robot.

    Semi-implicit Euler is stable for a mode of angular frequency w while h w < 2. Two bodies with
    moments I and J, alone in space, swing against each other on a spring k with
    w^2 = k (1 / I + 1 / J). In the chain up to four springs act on one link about one axis, which
    gives w^2 <= 4 k (1 / I + 1 / J), at the bend within the limits at which J is smallest. The true
    limit is up to four times as large. Dampers make it no smaller: those of MuJoCo are implicit,
    and so are Bullet's where they are stiff.
    """
    fastest = 0.0
    base = robot.base.inertia if robot.base.mount == "free" else 3 * (_IMMOVABLE,)
    bodies = [base] + [link.inertia for link, _ in robot.links]
    passing = robot.num_cables  # a cable that is held stiffens each hinge that it passes
    # A servo with a damper of its own is implicit.
    springs = [(0.0 if s.servo_damping(1.0) else s.stiffness, s.mass) for s in robot.servos]
    pull = max((spring for spring, _ in springs), default=0.0)
    radius = max((s.cables.widest for s in robot.segments if s.cable_angles), default=0.0)
    for (lower, upper), (_, joint) in zip(pairwise(bodies), robot.links, strict=True):
        furthest = max(max(hinge.upper, -hinge.lower) for hinge in joint.hinges)
        tilt = sin(min(furthest, pi / 2)) ** 2
        stiffness = joint.stiffness + passing * pull * radius**2
        for axis in (0, 1):
            least = [
                min(body[axis], body[axis] * (1 - tilt) + body[2] * tilt) for body in (lower, upper)
            ]
            fastest = max(fastest, 4 * stiffness * (1 / least[0] + 1 / least[1]))
        if joint.torsion is not None:
            twist = 4 * joint.torsion.stiffness
            fastest = max(fastest, twist * (1 / lower[2] + 1 / upper[2]))
    for spring, mass in springs:
        fastest = max(fastest, spring / mass)
    return 2 / sqrt(fastest) if fastest else inf
