"""Build the MuJoCo model of a robot as an MjSpec. Cables are spatial tendons that may not exceed
their rest length.

In stock MuJoCo, so in the model files, in viewers and in the engine `mujoco-stock`, this is a limit
of the tendon. The engine `mujoco` replaces it by equalities, which are inactive here: see
:mod:`backends.mujoco.active_cables`.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from cdcsr.robot.colors import (
    BACKGROUND,
    CABLE,
    HULL,
    METAL,
    TIP,
    Color,
    link_parts,
    segment_color,
    share,
)
from cdcsr.robot.description import Robot
from cdcsr.robot.parts import Joint, Link
from cdcsr.robot.routing import Routing, routing
from cdcsr.simulation.rotations import at_start

INTEGRATORS = {
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
}
"""MuJoCo's integrators, by their names in MJCF."""
UNLIMITED = 1e6
"""The travel in [m] of a slider away from its guide, where nothing stops it."""
TOUCH = 1e-9
"""MuJoCo sees a limit only once it is exceeded. The cables of the robot at its start exceed it by
this, in [m], so that in the first step a pull acts on the arm and not on a free slider."""
RIGID_SOLIMP = [0.9999, 0.9999, 0.001, 0.5, 2]
"""The softness of the largest impedance that MuJoCo allows."""


def build_spec(robot: Robot, meshes: Mapping[str, str] | None = None) -> mujoco.MjSpec:
    """Build the robot's MjSpec, ready to compile or to write as MJCF.

    The degrees of freedom have the contract's order: base, if it is free, sliders, hinges root to
    tip.

    Args:
        robot: the description.
        meshes: the files of visual meshes by the names of :func:`cdcsr.robot.meshes.visual_meshes`;
            without them a part looks like a box, a cylinder or a ball.
    """
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    spec.compiler.degree = False
    _set_options(spec, robot)
    for part, file in (meshes or {}).items():
        # As a shell, open and flat ones are meshes too; nothing reads their inertia.
        spec.add_mesh(name=part, file=file, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    base = spec.worldbody.add_body(
        name="base",
        pos=robot.base.position,
        quat=robot.base.quaternion,
        mass=robot.base.mass,
        inertia=robot.base.inertia,
        ipos=[0, 0, 0],
        explicitinertial=True,
    )
    if robot.base.mount == "free":
        base.add_freejoint(name="base")
    _draw(base, meshes, "base", mujoco.mjtGeom.mjGEOM_BOX, [s / 2 for s in robot.base.size], HULL)
    route = routing(robot)
    _add_sliders(base, robot, route, meshes)
    guides = _add_arm(base, robot, route, meshes)
    _add_cables(spec, robot, route, guides)
    _add_couplings(spec, robot)
    _add_sensors(spec, robot)
    _add_scenery(spec, robot)
    return spec


def rigid_solref(robot: Robot) -> list[float]:
    """Return the solref with which a step ends without any excess, wherever it began: a = -v / h -
    excess / h^2."""
    return [-1 / robot.time_step**2, -1 / robot.time_step]


def _set_options(spec: mujoco.MjSpec, robot: Robot) -> None:
    option = spec.option
    option.timestep = robot.time_step
    option.gravity = robot.gravity
    option.integrator = INTEGRATORS[robot.mujoco.integrator]
    # With few constraints and many coordinates it is cheaper than Newton, and as exact.
    option.solver = mujoco.mjtSolver.mjSOL_PGS
    if any(leader != hinge for hinge, leader in enumerate(robot.leaders)):
        option.solver = mujoco.mjtSolver.mjSOL_NEWTON  # PGS would need thousands of iterations
    # Nothing collides. An automatic reset would hide divergence, which must be an error.
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def _draw(
    body: mujoco.MjsBody,
    meshes: Mapping[str, str] | None,
    part: str,
    shape: mujoco.mjtGeom,
    size: list[float],
    color: Color,
    pos: tuple[float, float, float] = (0, 0, 0),
) -> None:
    """Add a visual geom, which has no mass and touches nothing."""
    looks = {"rgba": share(color), "contype": 0, "conaffinity": 0, "density": 0.0, "group": 1}
    if meshes and part in meshes:
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=part, **looks)
    else:
        body.add_geom(type=shape, size=[*size, 0, 0][:3], pos=pos, **looks)


def _add_sliders(
    base: mujoco.MjsBody, robot: Robot, route: Routing, meshes: Mapping[str, str] | None
) -> None:
    parts = [
        f"slider_{s}" for s, segment in enumerate(robot.segments) for _ in segment.cable_angles
    ]
    for c, servo in enumerate(robot.servos):
        height = robot.first_joint - route.guide_offset[c] - route.slider_offset[c]
        slider = base.add_body(
            name=f"slider_{c}",
            pos=[*route.place[c], height],
            mass=servo.mass,
            inertia=[0.4 * servo.mass * servo.radius**2] * 3,
            ipos=[0, 0, 0],  # without this it would become the body's position
            explicitinertial=True,
        )
        slider.add_joint(
            name=f"slide_{c}",
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[0, 0, 1],
            damping=servo.damping + servo.servo_damping(robot.time_step),
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=[-UNLIMITED, servo.stop],
        )
        slider.add_site(name=f"pull_{c}", size=[0.002, 0, 0])
        _draw(slider, meshes, parts[c], mujoco.mjtGeom.mjGEOM_SPHERE, [servo.radius], METAL)


def _add_arm(
    base: mujoco.MjsBody, robot: Robot, route: Routing, meshes: Mapping[str, str] | None
) -> list[list[str]]:
    """Add the links with their guides, and return the names of each cable's guides, base to
    anchor."""
    guides: list[list[str]] = [[] for _ in robot.servos]

    def add_guides(body: mujoco.MjsBody, number: int, length: float) -> None:
        for c, path in enumerate(route.guides):
            for place in (guide.place for guide in path if guide.body == number):
                side = "low" if place[2] < length / 2 else "high"
                name = f"guide_{c}_{number - 1}_{side}" if number else f"guide_{c}_base"
                body.add_site(name=name, pos=place, size=[0.002, 0, 0])
                guides[c].append(name)

    add_guides(base, 0, 0.0)
    body, joint_at = base, robot.first_joint
    for j, ((link, joint), part) in enumerate(zip(robot.links, link_parts(robot), strict=True)):
        body = _add_link(body, link, joint, j, joint_at)
        _draw(
            body,
            meshes,
            part,
            mujoco.mjtGeom.mjGEOM_CYLINDER,
            [link.radius, link.length / 2],
            segment_color(int(part.split("_")[1])),
            (0, 0, link.length / 2),
        )
        add_guides(body, j + 1, link.length)
        joint_at = link.length
    body.add_site(name="tip", pos=[0, 0, joint_at], size=[0.01, 0, 0], rgba=share(TIP))
    return guides


def _add_link(
    parent: mujoco.MjsBody, link: Link, joint: Joint, j: int, height: float
) -> mujoco.MjsBody:
    body = parent.add_body(
        name=f"link_{j}",
        pos=[0, 0, height],
        mass=link.mass,
        inertia=link.inertia,
        ipos=[0, 0, link.center_of_mass],
        explicitinertial=True,
    )
    for hinge in joint.hinges:
        body.add_joint(
            name=f"hinge_{j}_{hinge.axis}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[float(axis == hinge.axis) for axis in "xyz"],
            stiffness=hinge.stiffness,
            springref=hinge.rest,
            damping=hinge.damping,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=[hinge.lower, hinge.upper],
        )
    return body


def _add_cables(spec: mujoco.MjSpec, robot: Robot, route: Routing, guides: list[list[str]]) -> None:
    solref = [robot.constraint.recovery_time, 1.0]
    impedance = robot.mujoco.impedance
    solimp = [impedance, impedance, 0.001, 0.5, 2]
    for joint in spec.joints:
        if joint.type != mujoco.mjtJoint.mjJNT_FREE:
            joint.solref_limit, joint.solimp_limit = solref, solimp
    for c, servo in enumerate(robot.servos):
        rest, strain = route.rest_length[c], robot.strain_by_tension[c]
        tendon = spec.add_tendon(
            name=f"cable_{c}",
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=[0, UNLIMITED if strain else rest - TOUCH],
            solref_limit=solref,
            solimp_limit=solimp,
            width=0.002,
            rgba=share(CABLE),
        )
        if strain:  # a spring that only pulls
            tendon.stiffness, tendon.springlength = [1 / (strain * rest), 0, 0], [0, rest]
        for n, site in enumerate((f"pull_{c}", *guides[c])):
            if n == 2 and route.first[c]:
                tendon.wrap_pulley(1.0)  # the sheath between them keeps its length
            tendon.wrap_site(site)
        spec.add_equality(
            name=f"held_{c}",
            type=mujoco.mjtEq.mjEQ_TENDON,
            objtype=mujoco.mjtObj.mjOBJ_TENDON,
            name1=tendon.name,
            active=False,
            solref=rigid_solref(robot),
            solimp=RIGID_SOLIMP,
        )
        actuator = spec.add_actuator(
            name=f"servo_{c}",
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=f"slide_{c}",
            ctrllimited=mujoco.mjtLimited.mjLIMITED_FALSE,
        )
        actuator.set_to_position(kp=servo.gain)
        actuator.gainprm = [servo.sign * servo.gain, *9 * [0.0]]
        actuator.biasprm = [-servo.pretension, -servo.stiffness, *8 * [0.0]]
        if servo.force_limit is not None:
            actuator.forcelimited = True
            actuator.forcerange = [-servo.force_limit, servo.force_limit]


def _add_couplings(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Hold hinges at the angles of their leaders, as softly as other limits."""
    names = [joint.name for joint in spec.joints if joint.name.startswith("hinge_")]
    impedance = robot.mujoco.impedance
    for hinge, leader in enumerate(robot.leaders):
        if hinge != leader:
            spec.add_equality(
                name=f"linkage_{hinge}",
                type=mujoco.mjtEq.mjEQ_JOINT,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name1=names[hinge],
                name2=names[leader],
                data=[0, 1, *(mujoco.mjNEQDATA - 2) * [0]],  # a polynomial of the leader's angle
                solref=[robot.constraint.recovery_time, 1.0],
                solimp=[impedance, impedance, 0.001, 0.5, 2],
            )


def _add_sensors(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add what State needs and qpos and qvel do not hold, in the order in which simulation.py
    reads it; last the forces of the sliders' stops, which active_cables.py reads."""
    sensor, site, body = mujoco.mjtSensor, mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_XBODY
    spec.add_sensor(name="tip_position", type=sensor.mjSENS_FRAMEPOS, objtype=site, objname="tip")
    spec.add_sensor(
        name="tip_velocity", type=sensor.mjSENS_FRAMELINVEL, objtype=site, objname="tip"
    )
    spec.add_sensor(
        name="base_angular_velocity", type=sensor.mjSENS_FRAMEANGVEL, objtype=body, objname="base"
    )
    for c in range(robot.num_cables):
        spec.add_sensor(
            name=f"stop_{c}",
            type=sensor.mjSENS_JOINTLIMITFRC,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=f"slide_{c}",
        )


def _add_scenery(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add light, and what viewers look at; neither has any influence on the motion."""
    spec.stat.center = at_start(robot, [0, 0, (robot.top + robot.arm_length) / 2])
    spec.stat.extent = float(np.hypot(robot.arm_length, robot.base.size[0]))
    spec.worldbody.add_light(
        pos=[2, -3, robot.arm_length + 2],
        dir=[-0.4, 0.6, -0.7],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    )
    spec.visual.headlight.ambient = [0.4, 0.4, 0.4]
    background = [part / 255 for part in BACKGROUND]
    spec.add_texture(
        name="background",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=background,
        rgb2=background,  # of the lower half
        width=8,
        height=48,
    )
