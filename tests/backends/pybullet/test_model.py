"""The URDF and the file of cables hold the robot, and PyBullet loads it as written."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from itertools import combinations, pairwise

import numpy as np
import pybullet
import pytest
from numpy.typing import NDArray

from backends.pybullet.client import connect, load_robot_body
from backends.pybullet.options import PybulletOptions
from backends.pybullet.rig import cable_rows, rig
from backends.pybullet.simulation import PybulletSimulation
from backends.pybullet.urdf import cable_file, joint_names, urdf
from cdcsr.errors import CdcsrError
from cdcsr.robot.colors import HULL, METAL, segment_color
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.poses import link_poses
from cdcsr.robot.routing import cable_jacobian, cable_lengths, routing
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


def test_bodies_look_and_joints_move_as_described(paper: Robot) -> None:
    """Parts without a mesh are boxes, balls and cylinders in their own colours."""
    root = ET.fromstring(urdf(paper))
    drawn = {link.attrib["name"]: link.find("visual") for link in root.findall("link")}

    def looks(name: str) -> tuple[str, list[float], list[float], list[float]]:
        visual = drawn[name]
        assert visual is not None
        shape = visual.find("geometry/*")
        origin, color = visual.find("origin"), visual.find("material/color")
        assert shape is not None
        assert origin is not None
        assert color is not None
        assert origin.attrib["rpy"] == "0 0 0"
        sizes = [float(x) for text in shape.attrib.values() for x in text.split()]
        colors = [255 * float(x) for x in color.attrib["rgba"].split()]
        return shape.tag, sizes, [float(x) for x in origin.attrib["xyz"].split()], colors

    still = [0.0, 0.0, 0.0]
    assert looks("base") == ("box", [0.6] * 3, still, pytest.approx(HULL))
    assert looks("slider_7") == ("sphere", [0.01], still, pytest.approx(METAL))
    ball = pytest.approx([1.15 * 0.02]), still, pytest.approx(METAL)
    assert looks("cross_11") == ("sphere", *ball)
    for link, segment in ((0, 0), (5, 0), (6, 1), (11, 1)):
        color = pytest.approx(segment_color(segment))
        assert looks(f"link_{link}") == ("cylinder", [0.02, 0.2], [0.0, 0.0, 0.1], color)
    height, cables = 0.3, ["base"] * 8
    assert [_joint(root, f"slide_{c}")[1] for c in range(8)] == cables
    for j, (_, joint) in enumerate(paper.links):
        below = f"link_{j - 1}" if j else "base"
        bend = joint.limit, joint.damping
        place = [0.0, 0.0, height]
        x = "revolute", below, f"cross_{j}", place, "1 0 0", -bend[0], *bend
        y = "revolute", f"cross_{j}", f"link_{j}", still, "0 1 0", -bend[0], *bend
        assert (_joint(root, f"hinge_{j}_x"), _joint(root, f"hinge_{j}_y")) == (x, y)
        height = 0.2
    servo = paper.servos[4]
    place = [*np.multiply(0.02, [np.sqrt(0.5)] * 2), 0.3 - 0.02 - 0.2]
    slide = _joint(root, "slide_4")
    assert slide[:3] == ("prismatic", "base", "slider_4")
    assert slide[3] == pytest.approx(place)
    assert slide[4:] == ("0 0 1", -1e6, servo.stop, servo.damping)


def _joint(root: ET.Element, name: str) -> tuple[object, ...]:
    """Return type, parent, child, place, axis, limits and damping of a joint."""
    (joint,) = (one for one in root.findall("joint") if one.get("name") == name)
    parts = {part.tag: part.attrib for part in joint}
    place = [float(x) for x in parts["origin"]["xyz"].split()]
    limits = (float(parts["limit"][key]) for key in ("lower", "upper"))
    ends = parts["parent"]["link"], parts["child"]["link"]
    damping = float(parts["dynamics"]["damping"])
    return joint.get("type"), *ends, place, parts["axis"]["xyz"], *limits, damping


def test_what_others_get_of_mounts_and_couplings(paper: Robot) -> None:
    """Others need a link for the mount, and limits of hinges that follow, which ours has itself."""
    base = paper.model_dump()["base"] | {"mount": "fixed", "position": (1.0, 2.0, 3.0)}
    robot = changed(load_robot("paper-coupled"), base=base | {"quaternion": (0.6, 0.8, 0.0, 0.0)})
    theirs, ours = ET.fromstring(urdf(robot, world=True)), ET.fromstring(urdf(robot))
    mount = theirs.find("joint[@name='mount']")
    assert mount is not None
    assert ours.find("joint[@name='mount']") is None
    origin = mount.find("origin")
    assert origin is not None
    assert [float(x) for x in origin.attrib["xyz"].split()] == [1, 2, 3]
    turn = 2 * np.arccos(0.6), 0.0, 0.0
    assert [float(x) for x in origin.attrib["rpy"].split()] == pytest.approx(turn)
    limit = robot.links[0][1].limit
    for hinge, leader in enumerate(robot.leaders):
        name, first = (joint_names(robot)[8 + number] for number in (hinge, leader))
        assert _joint(theirs, name)[5:7] == (-limit, limit)
        assert _joint(ours, name)[5:7] == (-1e6, 1e6)
        mimic = theirs.find(f"joint[@name='{name}']/mimic")
        assert (mimic is None) == (hinge == leader)
        assert mimic is None or mimic.get("joint") == first
    file = cable_file(robot)
    assert file["linkages"] == {
        joint_names(robot)[8 + hinge]: joint_names(robot)[8 + leader]
        for hinge, leader in enumerate(robot.leaders)
        if hinge != leader
    }
    assert file["tip"] == {"link": "link_11", "xyz": [0.0, 0.0, 0.2]}


def test_as_many_joints_as_pybullet_moves(paper: Robot) -> None:
    lower, upper = paper.model_dump()["segments"]
    passive = {**upper, "cables": None, "servo": None, "links": 1}
    for order, count in (("x", 127), ("xy", 128)):
        last = passive | {"joint": passive["joint"] | {"order": order}}
        long = changed(paper, segments=[lower | {"links": 53}, upper, last])
        client = connect(long)
        if count == 127:
            body = load_robot_body(long, client)
            assert pybullet.getNumJoints(body, physicsClientId=client) == count
        else:
            message = "at most 127 joints in a body; paper has 128, of 8 cables and 120 hinges of"
            with pytest.raises(CdcsrError, match=message):
                load_robot_body(long, client)
        pybullet.disconnect(physicsClientId=client)


def test_when_pybullet_has_no_client_left(paper: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pybullet, "connect", lambda _: -1)
    with pytest.raises(CdcsrError, match="no free physics client left"):
        connect(paper)


@pytest.mark.parametrize("order", ["xy", "yx", "y"])
def test_compiled_cables_are_those_of_the_routing(order: str, paper: Robot) -> None:
    """Straight ones, a helix, one in a sheath; joints with and without torsion."""
    lower, upper = paper.model_dump()["segments"]
    torsion = {"stiffness": 1.0, "damping": 0.1, "limit": 0.5}
    helix = {"angle_deg": 10.0, "end_pitch_radius": 0.01, "twist_deg": 200.0}
    led = {"angle_deg": 130.0, "first_link": 2, "last_link": 9, "twist_deg": -50.0}
    ways = lower["cables"] | {"angles_deg": (10.0, 130.0), "paths": (helix, led)}
    twisting = lower["joint"] | {"order": order, "torsion": torsion, "rest": (0.1,) * len(order)}
    curved = [lower | {"joint": twisting, "cables": ways}, upper]
    random = np.random.default_rng(0)
    for robot in (paper, changed(paper, segments=curved)):
        travel = random.uniform(-0.5, 0.005, robot.num_cables)
        hinges = random.uniform(-0.8, 0.8, robot.num_hinges)
        found = np.zeros((robot.num_cables, robot.num_cables + robot.num_hinges))
        excess, route = cable_rows(rig(robot), travel, hinges, found), routing(robot)
        expected = cable_lengths(route, travel, hinges) - route.rest_length
        np.testing.assert_allclose(excess, expected, rtol=0, atol=1e-13)
        np.testing.assert_allclose(found, cable_jacobian(route, travel, hinges), atol=1e-13)


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


def _least_gap(robot: Robot, position: NDArray[np.float64]) -> float:
    """Return how near the axes of two links that are no neighbours come, less their radii, in [m];
    along each axis 21 points are tried."""
    place, share = link_poses(robot, position).joint, np.linspace(0, 1, 21)[:, None]
    axes = [a + share * (b - a) for a, b in pairwise(place)]
    radius = [link.radius for link, _ in robot.links]
    return min(
        float(np.linalg.norm(axes[i][:, None] - axes[j], axis=2).min() - radius[i] - radius[j])
        for i, j in combinations(range(robot.num_links), 2)
        if j - i > 1
    )


def test_links_touch_each_other_if_asked_and_no_other_copy(paper: Robot) -> None:
    """The arm is curled up until its links would be 39 mm inside each other."""
    command = np.zeros((2, 8))
    command[:, [0, 4]] = -5.0
    gaps, ends = [], []
    for contact, num in ((False, 1), (True, 2), (True, 1)):
        simulation, least = PybulletSimulation(paper, num, PybulletOptions(contact=contact)), 1.0
        for _ in range(100):
            simulation.step(command[:num], 10)
            least = min(least, _least_gap(paper, simulation.get_snapshot().position[0]))
        ends.append(simulation.get_snapshot().position)
        gaps.append(least)
        simulation.close()
    assert gaps[0] < -0.03
    assert -0.002 < gaps[1] < 0.001
    np.testing.assert_array_equal(ends[1], np.repeat(ends[2], 2, axis=0))


@pytest.mark.parametrize(
    "option", ["substeps=0", "substeps=101", "damping=-0.1", "damping=1.1", "max_joint_speed=0"]
)
@pytest.mark.parametrize("engine", ["pybullet", "pybullet-stock"])
def test_options_out_of_range_are_refused(engine: str, option: str, paper: Robot) -> None:
    with pytest.raises(CdcsrError, match=option.partition("=")[0]):
        make_simulation(paper, f"{engine}:{option}")


@pytest.mark.parametrize("option", ["substeps=1", "substeps=100", "damping=0", "damping=1"])
def test_options_at_their_bounds_are_taken(option: str, paper: Robot) -> None:
    make_simulation(paper, f"pybullet:{option}").close()
