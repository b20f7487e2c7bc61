"""Dampers that an explicit step would let oscillate, compiled.

An explicit damper c oscillates where h c exceeds the inertia that it acts on. So it is for a link
bent by nearly a right angle, which its first hinge then turns about its own thin axis. There, and
only there, the damper is made implicit: M + h c takes the place of M, and -h c a is a torque more.
At joints of another kind, whose links may be thin rods, all dampers are implicit.

That is decided for a step of the robot's own, or for the step itself if that is longer: dampers
that became explicit as the step is refined would keep the motion from converging.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backends.pybullet.lcp import solve_transposed
from backends.pybullet.rig import Rig
from cdcsr.compiled import compiled

Array = NDArray[np.float64]


@compiled()
def stiff_dampers(rig: Rig, hinges: Array, step: float) -> Array:
    """Return the dampers that must be implicit, others as zero, shape (C + H,).

    A damper turns the two bodies at its hinge against each other. Alone in space, moments I and J
    about its axis, it would change their relative speed by h c (1 / I + 1 / J) of itself in a step;
    an explicit step is stable below 2. In the chain up to four dampers act on one link about one
    axis, so that a damper is explicit below 1/2.

    Args:
        rig: the copy's numbers.
        step: h in [s].
        hinges: shape (H,), in [rad].
    """
    cables, damping, step = rig.slider_mass.size, rig.damping, max(step, rig.damper_step)
    if not rig.universal:
        return damping.copy()
    stiff = np.zeros(damping.size)
    for c in range(cables):
        if step * damping[c] / rig.slider_mass[c] > 0.5:
            stiff[c] = damping[c]
    lower = rig.base_inertia
    for j in range(hinges.size // 2):
        upper = rig.link_inertia[j]
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
def fill_mass(whole: Array, mass: Array, stiff: Array) -> None:
    """Fill in M + h C for sliders and hinges, then the base.

    Args:
        whole: its upper triangle is filled.
        mass: M, with the base first.
        stiff: the diagonal of h C for sliders and hinges.
    """
    joints, size = stiff.size, len(mass)
    whole[:joints, :joints] = mass[6:, 6:]
    whole[:joints, joints:] = mass[6:, :6]
    whole[joints:size, joints:] = mass[:6, :6]
    for k in range(joints):
        whole[k, k] += stiff[k]


@compiled()
def damp(whole: Array, inverse: Array, pull: Array, stiff: Array, force: Array) -> None:
    """Add -h C a to the joint forces, with which Bullet makes the step of M + h C.

    Args:
        whole: U, the factor of M + h C; U'^-1 times what drives, which is replaced by a; U'^-1
            times the rows of cables and limits, and others.
        inverse: from :func:`backends.pybullet.lcp.factor`.
        pull: the forces of cables and limits.
        stiff: the diagonal of h C for sliders and hinges.
        force: on sliders and hinges.
    """
    size = whole.shape[1]
    rest = whole[size]
    rest -= pull @ whole[size + 1 : size + 1 + pull.size]
    solve_transposed(whole, inverse, rest)
    force -= stiff * rest[: stiff.size]
