"""Write a robot as URDF, and beside it a file of what URDF cannot describe: cables, servos,
springs.

URDF has no universal joint, so each is two hinges with a massless link (`cross_<j>`) between them.
A third hinge, for torsion, has one more (`cross_<j>_1`) below it. The text holds all that URDF can
describe, joint limits and damping too; a simulation that computes those itself switches them off
after loading.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np

from cdcsr.robot.colors import HULL, METAL, segment_color, share
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import routing

UNLIMITED = 1e6
"""The limits that URDF demands and the description does not have: effort, velocity, and the travel
of a slider away from its guide."""


def joint_names(robot: Robot) -> list[str]:
    """Names of the moving joints in the order of coordinates: sliders, then hinges root to tip."""
    hinges = zip(robot.link_of_hinge, robot.hinges, strict=True)
    sliders = [f"slide_{c}" for c in range(robot.num_cables)]
    return sliders + [f"hinge_{j}_{hinge.axis}" for j, hinge in hinges]


def slider_places(robot: Robot) -> np.ndarray:
    """Return where the sliders rest in the base's frame, shape (C, 3), in [m]."""
    route = routing(robot)
    height = robot.first_joint - route.guide_offset - route.slider_offset
    return np.column_stack([route.place, height])


def urdf(
    robot: Robot,
    mesh_files: Mapping[str, str] | None = None,
    world: bool = False,
    solid: bool = False,
) -> str:
    """Return the robot as URDF text.

    Args:
        robot: the description.
        mesh_files: the visual mesh of a link by its name (``"base"``, ``"link_3"``, ...), in metres
            and in the link's frame; links without one look like boxes, cylinders and balls.
        world: whether the text is for others than our engine: a fixed base then hangs on a link
            `world`, which is how URDF fixes it, and coupled hinges have limits. A free base starts
            anywhere; URDF does not say where.
        solid: whether base and links can touch, as the box and the cylinders that they look like.
    """
    model = _Model(robot.name, mesh_files or {})
    base = robot.base
    box = ("box", {"size": _text(*base.size)})
    element = model.link("base", base.mass, base.inertia, box, share(HULL))
    if solid:
        _add_shape(element, "collision", box, 0.0)
    if world and base.mount == "fixed":
        from scipy.spatial.transform import Rotation  # an import of 0.4 s

        ET.SubElement(model.root, "link", name="world")
        turn = Rotation.from_quat(base.quaternion, scalar_first=True).as_euler("xyz")
        model.place("mount", "fixed", "world", "base", base.position, tuple(turn))
    for c, (servo, place) in enumerate(zip(robot.servos, slider_places(robot), strict=True)):
        name, moment = f"slider_{c}", 0.4 * servo.mass * servo.radius**2
        ball = ("sphere", {"radius": _text(servo.radius)})
        model.link(name, servo.mass, (moment, moment, moment), ball, share(METAL))
        damping = servo.damping + servo.servo_damping(robot.time_step)
        joint = ("prismatic", "0 0 1", (-UNLIMITED, servo.stop), damping)
        model.joint(f"slide_{c}", joint, "base", name, tuple(place))

    segment_of = [s for s, segment in enumerate(robot.segments) for _ in range(segment.links)]
    parent, height, number = "base", robot.first_joint, 0
    names, leaders = joint_names(robot)[robot.num_cables :], robot.leaders
    for j, (part, bends) in enumerate(robot.links):
        ball = ("sphere", {"radius": _text(1.15 * part.radius)})
        for k, hinge in enumerate(bends.hinges):
            child = f"cross_{j}" + f"_{k}" * (k > 0)
            if k < len(bends.hinges) - 1:
                model.link(child, 0.0, (0.0, 0.0, 0.0), ball, share(METAL))
            else:
                child = f"link_{j}"
                shape = {"radius": _text(part.radius), "length": _text(part.length)}
                color = share(segment_color(segment_of[j]))
                heights = part.center_of_mass, part.length / 2
                solid_part = ("cylinder", shape)
                element = model.link(child, part.mass, part.inertia, solid_part, color, heights)
                if solid:
                    _add_shape(element, "collision", solid_part, heights[1])
            axis = " ".join(str(int(a == hinge.axis)) for a in "xyz")
            limits, leader = (hinge.lower, hinge.upper), leaders[number]
            if not world and (leader != number or leaders.count(number) > 1):
                limits = -UNLIMITED, UNLIMITED
            joint = ("revolute", axis, limits, hinge.damping)
            element = model.joint(names[number], joint, parent, child, (0, 0, height))
            if leader != number:
                ET.SubElement(element, "mimic", joint=names[leader])
            parent, height, number = child, 0.0, number + 1
        height = part.length
    ET.indent(model.root)  # Bullet's parser fails on very long lines
    return '<?xml version="1.0"?>\n' + ET.tostring(model.root, encoding="unicode") + "\n"


class _Model:
    """A URDF model to which links and joints are added."""

    def __init__(self, name: str, meshes: Mapping[str, str]) -> None:
        self.root = ET.Element("robot", name=name)
        self._meshes = meshes

    def link(
        self,
        name: str,
        mass: float,
        inertia: tuple[float, float, float],
        shape: tuple[str, dict[str, str]],
        color: tuple[float, ...],
        heights: tuple[float, float] = (0.0, 0.0),
    ) -> ET.Element:
        """Add a link whose centre of mass and shape are at `heights` above its frame."""
        element = ET.SubElement(self.root, "link", name=name)
        inertial = ET.SubElement(element, "inertial")
        ET.SubElement(inertial, "origin", xyz=_text(0, 0, heights[0]), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=_text(mass))
        ixx, iyy, izz = (_text(moment) for moment in inertia)
        ET.SubElement(inertial, "inertia", ixx=ixx, ixy="0", ixz="0", iyy=iyy, iyz="0", izz=izz)
        if name in self._meshes:
            visual = ET.SubElement(element, "visual")
            ET.SubElement(visual, "origin", xyz="0 0 0", rpy="0 0 0")
            geometry = ET.SubElement(visual, "geometry")
            ET.SubElement(geometry, "mesh", filename=self._meshes[name], scale="1 1 1")
        else:
            visual = _add_shape(element, "visual", shape, heights[1])
        material = ET.SubElement(visual, "material", name=f"{name}_color")
        ET.SubElement(material, "color", rgba=_text(*color))
        return element

    def place(
        self,
        name: str,
        kind: str,
        parent: str,
        child: str,
        place: tuple[float, ...],
        turn: tuple[float, ...] = (0, 0, 0),
    ) -> ET.Element:
        """Add a joint at `place` in the parent's frame, turned by roll, pitch and yaw."""
        element = ET.SubElement(self.root, "joint", name=name, type=kind)
        ET.SubElement(element, "parent", link=parent)
        ET.SubElement(element, "child", link=child)
        ET.SubElement(element, "origin", xyz=_text(*place), rpy=_text(*turn))
        return element

    def joint(
        self,
        name: str,
        joint: tuple[str, str, tuple[float, float], float],
        parent: str,
        child: str,
        place: tuple[float, ...],
    ) -> ET.Element:
        """Add a joint that moves; `joint` is type, axis, limits and damping."""
        kind, axis, (lower, upper), damping = joint
        element = self.place(name, kind, parent, child, place)
        ET.SubElement(element, "axis", xyz=axis)
        limits = {"lower": _text(lower), "upper": _text(upper)}
        limits |= {"effort": _text(UNLIMITED), "velocity": _text(UNLIMITED)}
        ET.SubElement(element, "limit", limits)
        ET.SubElement(element, "dynamics", damping=_text(damping), friction="0")
        return element


def _add_shape(
    link: ET.Element, use: str, shape: tuple[str, dict[str, str]], height: float
) -> ET.Element:
    """Give a link a shape to look like or to touch with, `height` above its frame."""
    element = ET.SubElement(link, use)
    ET.SubElement(element, "origin", xyz=_text(0, 0, height), rpy="0 0 0")
    ET.SubElement(ET.SubElement(element, "geometry"), shape[0], shape[1])
    return element


def cable_file(robot: Robot) -> dict[str, object]:
    """Return what URDF cannot describe: cables with their guides and servos, hinge springs, which
    hinge follows which, the tip, gravity, and where the base starts.

    Links and joints have the URDF's names. The guides of a cable are in order from the base to its
    anchor, each with its place in its link's frame; a sheath, which keeps its length, may lead it
    from the first to the second. Lengths are in [m].
    """
    route, names = routing(robot), joint_names(robot)
    cables = []
    for c, servo in enumerate(robot.servos):
        cables.append(
            {
                "name": f"cable_{c}",
                "slider_joint": names[c],
                "guides": [
                    {"link": f"link_{guide.body - 1}" if guide.body else "base", "xyz": guide.place}
                    for guide in route.guides[c]
                ],
                "sheath": bool(route.first[c]),
                "rest_length": float(route.rest_length[c]),
                "strain_by_tension": robot.strain_by_tension[c],
                "servo": {
                    "kind": servo.kind,
                    "mass": servo.mass,
                    "full_command": servo.full,
                    "force_by_command": servo.sign * servo.gain,
                    "stiffness": servo.stiffness,
                    "pretension": servo.pretension,
                    "force_limit": UNLIMITED if servo.force_limit is None else servo.force_limit,
                },
            }
        )
    hinges = {
        name: hinge._asdict()
        for name, hinge in zip(names[robot.num_cables :], robot.hinges, strict=True)
    }
    last, hinge_names = robot.num_links - 1, names[robot.num_cables :]
    return {
        "robot": robot.name,
        "fingerprint": robot.fingerprint,
        "time_step": robot.time_step,
        "recovery_time": robot.constraint.recovery_time,
        "gravity": list(robot.gravity),
        "base": {
            "mount": robot.base.mount,
            "position": list(robot.base.position),
            "quaternion": list(robot.base.quaternion),
        },
        "cables": cables,
        "hinges": hinges,
        "linkages": {
            hinge_names[hinge]: hinge_names[leader]
            for hinge, leader in enumerate(robot.leaders)
            if hinge != leader
        },
        "tip": {"link": f"link_{last}", "xyz": [0.0, 0.0, robot.links[last][0].length]},
    }


def _text(*numbers: float) -> str:
    """Return numbers as URDF writes vectors; `repr` keeps every bit."""
    return " ".join(repr(float(number)) for number in numbers)
