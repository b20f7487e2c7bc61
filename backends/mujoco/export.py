"""The MJCF file of a robot: the exporter that MuJoCo brings to `cdcsr build-model`."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

from backends.mujoco.model import build_spec
from cdcsr.files import write_text
from cdcsr.robot.description import Robot


def write_mjcf(robot: Robot, folder: Path, meshes: Mapping[str, str]) -> None:
    """Write `<robot>.xml`; see :data:`backends.export.model_files.Exporter`."""
    spec = build_spec(robot, meshes)
    spec.modelfiledir = str(folder)
    spec.compile()
    root = ET.fromstring(spec.to_xml())
    # MuJoCo writes six digits. Positions and rest lengths must fit each other better than that, or
    # a cable that is straight at the start hangs loose in the first step.
    exact = {("body", body.name): ("pos", body.pos) for body in spec.bodies}
    exact |= {("site", site.name): ("pos", site.pos) for site in spec.sites}
    exact |= {("spatial", tendon.name): ("range", tendon.range) for tendon in spec.tendons}
    for element in root.iter():
        attribute, numbers = exact.get((element.tag, element.get("name", "")), ("", ()))
        if attribute in element.attrib:
            element.set(attribute, " ".join(repr(float(number)) for number in numbers))
    write_text(folder / f"{robot.name}.xml", ET.tostring(root, encoding="unicode") + "\n")
