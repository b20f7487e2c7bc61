"""The URDF and the file of cables hold the robot, and PyBullet loads it as written."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pybullet
import pytest

from backends.pybullet.client import connect, load_robot_body
from backends.pybullet.urdf import cable_file, joint_names, urdf
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.engines import make_simulation
from tests.support.physics import changed


def test_urdf_holds_the_whole_robot(robot: Robot) -> None:
    text = urdf(robot)
    assert max(len(line) for line in text.splitlines()) < 300
    root = ET.fromstring(text)
    assert [joint.get("name") for joint in root.findall("joint")] == joint_names(robot)
    assert sum(float(mass.attrib["value"]) for mass in root.iter("mass")) == pytest.approx(
        robot.total_mass, rel=1e-14
    )


def test_urdf_names_the_meshes_that_are_given(paper: Robot) -> None:
    root = ET.fromstring(urdf(paper, {"base": "base.obj"}))
    assert [mesh.get("filename") for mesh in root.iter("mesh")] == ["base.obj"]


def test_guides_of_the_cable_file_span_the_rest_length(robot: Robot) -> None:
    file = json.loads(json.dumps(cable_file(robot)))
    heights = {"base": 0.0} | {
        f"link_{j}": robot.top + sum(link.length for link, _ in robot.links[:j])
        for j in range(robot.num_links)
    }
    for cable, servo in zip(file["cables"], robot.servos, strict=True):
        points = np.array(
            [np.add(guide["xyz"], (0, 0, heights[guide["link"]])) for guide in cable["guides"]]
        )
        along = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        assert along + servo.offset == pytest.approx(cable["rest_length"], rel=1e-12)


def test_an_import_prints_nothing_and_leaves_the_standard_error_as_it_was() -> None:
    """PyBullet greets with its build time. The lowest free descriptor is the same afterwards."""
    code = (
        "import os; free = os.dup(2); os.close(free); import backends.pybullet as ours; "
        "os.write(2, b'still there'); assert os.dup(2) == free; print(ours.pybullet.__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("pybullet\n", "still there")


def test_pybullet_has_the_masses_and_inertias_that_were_written(robot: Robot) -> None:
    client = connect(robot)
    body = load_robot_body(robot, client)
    found = [
        pybullet.getDynamicsInfo(body, i, physicsClientId=client)
        for i in range(-1, len(joint_names(robot)))
    ]
    pybullet.disconnect(physicsClientId=client)
    expected = [(robot.base.mass, robot.base.inertia)]
    expected += [(servo.mass, (0.4 * servo.mass * servo.radius**2,) * 3) for servo in robot.servos]
    for link, _ in robot.links:
        expected += [(0.0, (0.0, 0.0, 0.0)), (link.mass, link.inertia)]
    for info, (mass, inertia) in zip(found, expected, strict=True):
        assert info[0] == pytest.approx(mass, rel=1e-14)
        assert info[2] == pytest.approx(inertia, rel=1e-14)


def test_a_body_with_too_many_joints_for_pybullet_is_refused_by_number(paper: Robot) -> None:
    segments = paper.model_dump()["segments"]
    long = changed(paper, segments=[segments[0] | {"links": 54}, segments[1]])
    with pytest.raises(CdcsrError, match="at most 127 joints in a body; paper has 128"):
        make_simulation(long, "pybullet")
