"""The project's own kernels, which run between those of MuJoCo Warp, once for each copy.

MuJoCo Warp keeps the constraints of a copy as rows of the arrays efc; a row has a kind, and the
number of its cable or joint. The order of the rows may change in each step.
"""

# Warp reads the types of arguments itself, so here they must not become text.
import mujoco
import warp as wp

_CABLE = wp.constant(int(mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON))
_EXCESS = wp.constant(5e-5)
"""As in :mod:`backends.mujoco.active_cables`, in [m]."""


@wp.kernel(enable_backward=False)
def aim_cables(
    rows: wp.array(dtype=wp.int32),
    kind: wp.array2d(dtype=wp.int32),
    number: wp.array2d(dtype=wp.int32),
    rate: wp.array2d(dtype=wp.float32),
    length: wp.array2d(dtype=wp.float32),
    rest: wp.array2d(dtype=wp.float32),
    compliance: wp.array2d(dtype=wp.float32),
    keep: wp.float32,
    step: wp.float32,
    goal: wp.array2d(dtype=wp.float32),
    hardness: wp.array2d(dtype=wp.float32),
):
    """Ask of each cable that it ends the step no longer than at rest.

    The solver finds forces t >= 0 and accelerations with -J a - goal + t / hardness >= 0, where J
    is the derivative of the cable's length; where t > 0 this is zero. So a goal of
    -rate(-length) / h - (rest - length) / h^2 ends the step at the rest length or below it.
    """
    copy, row = wp.tid()
    if row >= rows[copy] or kind[copy, row] != _CABLE:
        return
    cable = number[copy, row]
    excess = length[copy, cable] - rest[copy, cable]
    if compliance[copy, cable] > 0.0:  # what is longer is a spring
        hardness[copy, row] = wp.min(hardness[copy, row], step * step / compliance[copy, cable])
    elif excess > _EXCESS:  # it comes back with the recovery time
        excess -= keep * excess
    goal[copy, row] = (excess / step - rate[copy, row]) / step


@wp.kernel(enable_backward=False)
def end_step(
    rows: wp.array(dtype=wp.int32),
    kind: wp.array2d(dtype=wp.int32),
    number: wp.array2d(dtype=wp.int32),
    force: wp.array2d(dtype=wp.float32),
    fastest: wp.array(dtype=wp.float32),
    start: wp.array2d(dtype=wp.float32),
    step: wp.float64,
    position: wp.array2d(dtype=wp.float32),
    velocity: wp.array2d(dtype=wp.float32),
    guess: wp.array2d(dtype=wp.float32),
    tension: wp.array2d(dtype=wp.float32),
    time: wp.array(dtype=wp.float64),
    diverged: wp.array(dtype=wp.bool),
    culprit: wp.array(dtype=wp.int32),
    speed: wp.array(dtype=wp.float32),
):
    """Note tensions and time; put a copy that has diverged to the start, where it does no harm.

    The solver would go on with numbers that are not finite until its last iteration, in every step
    and for all copies.
    """
    copy = wp.tid()
    time[copy] = time[copy] + step
    for row in range(rows[copy]):
        if kind[copy, row] == _CABLE:
            tension[copy, number[copy, row]] = wp.max(force[copy, row], 0.0)
    wrong = wp.int32(-1)
    for i in range(fastest.shape[0]):
        if not (wp.abs(velocity[copy, i]) < fastest[i]):  # so NaN is wrong too
            wrong = i
    if wrong < 0:
        return
    if not diverged[copy]:
        diverged[copy] = True
        culprit[copy] = wrong
        speed[copy] = velocity[copy, wrong]
    for i in range(position.shape[1]):
        position[copy, i] = start[copy, i]
    for i in range(velocity.shape[1]):
        velocity[copy, i] = 0.0
        guess[copy, i] = 0.0


@wp.kernel(enable_backward=False)
def restart(
    chosen: wp.array(dtype=wp.bool),
    start: wp.array2d(dtype=wp.float32),
    speed: wp.array2d(dtype=wp.float32),
    position: wp.array2d(dtype=wp.float32),
    velocity: wp.array2d(dtype=wp.float32),
    guess: wp.array2d(dtype=wp.float32),
    tension: wp.array2d(dtype=wp.float32),
    time: wp.array(dtype=wp.float64),
    diverged: wp.array(dtype=wp.bool),
):
    """Put the chosen copies to the start, a position and a velocity."""
    copy = wp.tid()
    if not chosen[copy]:
        return
    time[copy] = wp.float64(0.0)
    diverged[copy] = False
    for i in range(position.shape[1]):
        position[copy, i] = start[copy, i]
    for i in range(velocity.shape[1]):
        velocity[copy, i] = speed[copy, i]
        guess[copy, i] = 0.0
    for i in range(tension.shape[1]):
        tension[copy, i] = 0.0


@wp.kernel(enable_backward=False)
def apply_loads(
    first: wp.int32,
    force: wp.array3d(dtype=wp.vec3),
    torque: wp.array3d(dtype=wp.vec3),
    point: wp.array3d(dtype=wp.vec3),
    turn: wp.array2d(dtype=wp.mat33),
    wrench: wp.array2d(dtype=wp.spatial_vector),
):
    """Sum the loads of each link up at its centre of mass, as
    :meth:`cdcsr.simulation.loads.Loads.at_centers` does."""
    copy, link = wp.tid()
    total = wp.vec3(0.0)
    moment = wp.vec3(0.0)
    for slot in range(force.shape[2]):
        one = force[copy, link, slot]
        total += one
        arm = turn[copy, first + link] @ point[copy, link, slot]
        moment += torque[copy, link, slot] + wp.cross(arm, one)
    wrench[copy, first + link] = wp.spatial_vector(total, moment)


@wp.kernel(enable_backward=False)
def measure(
    site: wp.int32,
    link: wp.int32,
    base: wp.int32,
    place: wp.array2d(dtype=wp.vec3),
    center: wp.array2d(dtype=wp.vec3),
    motion: wp.array2d(dtype=wp.spatial_vector),
    tip: wp.array(dtype=wp.vec3),
    tip_velocity: wp.array(dtype=wp.vec3),
    base_turning: wp.array(dtype=wp.vec3),
):
    """Measure the tip and the base's angular velocity, in the world frame.

    A body's motion, angular then linear, is about the centre of mass of the whole robot.
    """
    copy = wp.tid()
    tip[copy] = place[copy, site]
    turning = wp.spatial_top(motion[copy, link])
    arm = place[copy, site] - center[copy, base]
    tip_velocity[copy] = wp.spatial_bottom(motion[copy, link]) + wp.cross(turning, arm)
    base_turning[copy] = wp.spatial_top(motion[copy, base])
