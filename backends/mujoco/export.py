"""The MJCF file of a robot: the exporter that MuJoCo brings to `cdcsr build-model`."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from backends.mujoco.model import build_spec
from cdcsr.files import write_text
from cdcsr.robot.colors import TARGET, TARGET_RADIUS, share
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.cameras import CAMERAS, camera_angles


def write_mjcf(robot: Robot, folder: Path, meshes: Mapping[str, str]) -> None:
    """Write `<robot>.xml`; see :data:`backends.export.model_files.Exporter`."""
    spec = build_spec(robot, meshes)
    _add_conveniences(spec, robot)
    spec.modelfiledir = str(folder)
    spec.compile()
    root = ET.fromstring(spec.to_xml())
    # MuJoCo writes six digits. Positions and rest lengths must fit each other better than that, or
    # a cable that is straight at the start hangs loose in the first step.
    exact = {("body", body.name): ("pos", body.pos) for body in spec.bodies}
    exact |= {("site", site.name): ("pos", site.pos) for site in spec.sites}
    exact |= {
        ("spatial", t.name): ("springlength", t.springlength)
        if t.stiffness[0]
        else ("range", t.range)
        for t in spec.tendons
    }
    for element in root.iter():
        attribute, numbers = exact.get((element.tag, element.get("name", "")), ("", ()))
        if attribute in element.attrib:
            element.set(attribute, " ".join(repr(float(number)) for number in numbers))
    write_text(folder / f"{robot.name}.xml", ET.tostring(root, encoding="unicode") + "\n")


def _add_conveniences(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add what helps to use the file, and has no influence on the motion within the servos' range:
    that range, cameras, a target to move by hand, and the start as a keyframe."""
    for actuator, servo in zip(spec.actuators, robot.servos, strict=True):
        actuator.ctrllimited, actuator.ctrlrange = True, sorted((servo.full, 0.0))
    for name in CAMERAS:
        azimuth, elevation = np.deg2rad(np.add(camera_angles(name), (90.0, 0.0)))
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        forward = np.cos(elevation) * level + np.sin(elevation) * np.array([0.0, 0.0, 1.0])
        spec.worldbody.add_camera(
            name=name,
            pos=np.array(spec.stat.center) - 1.6 * spec.stat.extent * forward,
            xyaxes=[*right, *np.cross(right, forward)],
        )
    target = spec.worldbody.add_body(name="target", pos=robot.workspace.center, mocap=True)
    radius = ruler(robot).size * TARGET_RADIUS
    target.add_site(name="target", size=[radius, 0, 0], rgba=share(TARGET))
    base = [*robot.base.position, *robot.base.quaternion] if robot.base.mount == "free" else []
    still = robot.num_cables * [0.0]
    spec.add_key(name="start", qpos=[*base, *still, *robot.start_angles], ctrl=still)
