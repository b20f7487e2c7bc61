"""Links and joints follow from a backbone's material; older descriptions keep their meaning."""

from __future__ import annotations

import re

import numpy as np
import pytest
import trimesh
from pydantic import ValidationError

from backends.contract_suite.states import running
from cdcsr.errors import CdcsrError
from cdcsr.robot.backbone import Backbone
from cdcsr.robot.description import Robot, load_robot, parse_robot
from cdcsr.simulation.engines import backend_names
from tests.support.physics import walk
from tests.support.rods import rod_robot

STEEL = {
    "length": 0.6,
    "youngs_modulus": 200e9,
    "poissons_ratio": 0.33,
    "density": 7870.0,
    "radius": 0.0008,
    "inner_radius": 0.0004,
    "damping_time": 0.004,
}


def test_joints_are_in_the_middle_of_equal_cells() -> None:
    robot = rod_robot(4, STEEL)
    assert robot.first_joint - robot.top == pytest.approx(0.075)
    assert [link.length for link, _ in robot.links] == pytest.approx([0.15, 0.15, 0.15, 0.075])
    assert robot.arm_length == pytest.approx(0.6)


def test_stiffness_and_damping_follow_from_the_material() -> None:
    """By hand: I = pi (0.8^4 - 0.4^4) / 4 mm^4 = 0.301593 mm^4, E I = 0.0603186 N m^2, times 4 /
    0.6 m is 0.402124 N m; G J = 2 E I / (2 * 1.33) = 0.0453523 N m^2, times 4 / 0.6 m is 0.302349
    N m."""
    for _, joint in rod_robot(4, STEEL).links:
        bend, _, twist = joint.hinges
        assert (bend.stiffness, twist.stiffness) == pytest.approx((0.402124, 0.302349), rel=1e-5)
        assert (bend.damping, twist.damping) == pytest.approx((0.0016085, 0.0012094), rel=1e-4)
        assert twist.axis == "z"


def test_orders_of_bending_cancel_their_twists() -> None:
    orders = [joint.order for _, joint in rod_robot(8, STEEL).links]
    assert orders == ["xy", "yx", "yx", "xy", "yx", "xy", "xy", "yx"]


def test_all_pieces_together_have_the_mass_and_the_inertia_of_the_rod() -> None:
    """About the clamp, the half cell that belongs to the base included: m L^2 / 3 + m (R^2 + r^2) /
    4 across the rod, and m (R^2 + r^2) / 2 along it."""
    robot = rod_robot(5, STEEL)
    stub = robot.segments[0].stub
    assert stub is not None
    mass = across = along = height = 0.0
    for link in (stub, *(link for link, _ in robot.links)):
        mass += link.mass
        across += link.inertia[0] + link.mass * (height + link.center_of_mass) ** 2
        along += link.inertia[2]
        height += link.length
    whole = 7870 * np.pi * (0.0008**2 - 0.0004**2) * 0.6
    squares = 0.0008**2 + 0.0004**2
    assert mass == pytest.approx(whole)
    assert across == pytest.approx(whole * (0.6**2 / 3 + squares / 4))
    assert along == pytest.approx(whole * squares / 2)


def test_a_tapered_rod_has_the_mass_inertia_and_compliance_of_its_shape() -> None:
    """Against sums over 20,000 discs: mass, centre and moments of all pieces about the clamp, and
    the bending under a torque at the tip, l / (E I), of each cell."""
    robot = rod_robot(3, STEEL | {"end_radius": 0.0005})
    stub = robot.segments[0].stub
    assert stub is not None
    found, height = np.zeros(4), 0.0
    for link in (stub, *(link for link, _ in robot.links)):
        z = height + link.center_of_mass
        across = link.inertia[0] + link.mass * z**2
        found += link.mass, link.mass * z, across, link.inertia[2]
        height += link.length
    z = (np.arange(20_000) + 0.5) * 0.6 / 20_000
    outer = 0.0008 - 0.0003 * z / 0.6
    squares = outer**2 * (1 + 0.5**2)
    mass = 7870 * np.pi * outer**2 * (1 - 0.5**2) * 0.6 / 20_000
    expected = [mass, mass * z, mass * (squares / 4 + z**2), mass * squares / 2]
    np.testing.assert_allclose(found, np.sum(expected, axis=1), rtol=1e-7)
    compliance = 0.6 / 20_000 / (200e9 * np.pi / 4 * outer**4 * (1 - 0.5**4))
    for n, (_, joint) in enumerate(robot.links):
        cell = compliance[(z > 0.2 * n) & (z < 0.2 * (n + 1))].sum()
        assert joint.stiffness == pytest.approx(1 / cell, rel=1e-3)


def test_a_piece_that_is_as_wide_as_long_has_the_inertia_of_its_shape() -> None:
    """Against the integral over a mesh of 2,000 corners around."""
    tube = Backbone(
        length=1.0,
        youngs_modulus=1e9,
        poissons_ratio=0.3,
        density=1000.0,
        radius=0.1,
        inner_radius=0.06,
        damping_time=0.0,
    )
    piece = tube.piece(0.2)
    mesh = trimesh.creation.annulus(0.06, 0.1, 0.2, sections=2_000)
    mesh.density = 1000.0
    assert piece.mass == pytest.approx(mesh.mass, rel=1e-4)
    assert piece.inertia == pytest.approx(mesh.moment_inertia.diagonal(), rel=1e-4)


def test_where_two_segments_meet_two_half_cells_are_one_link() -> None:
    """A half cell of 0.1 m below one of 0.05 m of twice the density: masses 1 to 1."""
    dense = STEEL | {"density": 2 * 7870.0, "length": 0.3}
    robot = rod_robot(3, STEEL, dense)
    link = robot.links[2][0]
    assert link.length == pytest.approx(0.15)
    assert link.center_of_mass == pytest.approx((0.05 + 0.125) / 2)
    piece, half = link.mass / 2, 0.0375  # distance of each half's centre from the common one
    slender = piece * (0.1**2 + 0.05**2) / 12 + 2 * piece * half**2
    assert link.inertia[0] == pytest.approx(slender, rel=1e-3)
    assert len(robot.links) == 6


def test_a_description_with_all_sections_survives_a_round_trip() -> None:
    robot = rod_robot(3, STEEL, STEEL, gravity=(0.0, 0.0, -9.81))
    again = parse_robot(robot.to_toml())
    assert again == robot
    assert again.fingerprint == robot.fingerprint
    lighter = robot.model_copy(update={"gravity": (0.0, 0.0, -1.6)})
    assert lighter.fingerprint != robot.fingerprint


@pytest.mark.parametrize(
    ("name", "fingerprint"),
    [
        ("paper", "fcc8bbe13d09f342"),
        ("planar-single", "172362f5c430dd93"),
        ("three-cable", "331c7cf424882514"),
        ("three-segment", "d5df2bd2fa5783d1"),
    ],
)
def test_fingerprints_from_the_first_version_on(name: str, fingerprint: str) -> None:
    """Policies name the robot that they belong to by it."""
    assert load_robot(name).fingerprint == fingerprint


def _refused(old: str, new: str) -> str:
    text = rod_robot(3, STEEL).to_toml()
    assert old in text
    with pytest.raises(CdcsrError) as caught:
        parse_robot(text.replace(old, new, 1))
    return str(caught.value)


def test_broken_backbones_are_refused() -> None:
    assert "inner_radius must be below radius" in _refused(
        "inner_radius = 0.0004", "inner_radius = 0.1"
    )
    for more in ("curvature = [0.0, 1e3]", "twist = -1e3"):
        message = _refused("radius = 0.0008", f"radius = 0.0008\n{more}")
        assert "curvature and twist must be at most" in message
    assert "less than or equal to 0.5" in _refused("poissons_ratio = 0.33", "poissons_ratio = 0.6")
    assert "did you mean 'backbone'" in _refused("segments.backbone", "segments.backbon")
    message = _refused("[segments.backbone]", "[segments.joint]\nstiffness = 1.0")
    assert "segments[0].joint.damping: Field required" in message


def test_a_segment_has_either_links_or_a_backbone() -> None:
    data = load_robot("planar-single").model_dump()
    data["segments"][0]["backbone"] = STEEL
    with pytest.raises(ValueError, match="needs either link and joint, or backbone"):
        Robot.model_validate(data)
    del data["segments"][0]["backbone"], data["segments"][0]["servo"]
    with pytest.raises(ValueError, match="needs cables and servo, or neither"):
        Robot.model_validate(data)


CHAIN = """
name = "hand-made"
time_step = 0.001
base = { size = [0.3, 0.3, 0.3], mass = 10.0, inertia = [0.2, 0.2, 0.2] }
constraint = { recovery_time = 0.002 }
workspace = { center = [0.0, 0.0, 0.3], size = [0.1, 0.1, 0.1] }
[[segments]]
joint = { stiffness = 1.0, damping = 0.1, limit = 1.0, lower = -0.1, order = "y", rest = [0.2] }
[[segments.chain]]
length = 0.1
radius = 0.01
mass = 0.1
inertia = [1e-4, 1e-4, 1e-5]
[[segments.chain]]
length = 0.2
radius = 0.01
mass = 0.1
inertia = [1e-4, 1e-4, 1e-5]
[segments.chain.joint]
stiffness = 2.0
damping = 0.1
limit = 1.0
rest = [0.1, -0.3]
"""


def test_links_one_by_one_have_their_own_numbers_and_joints() -> None:
    robot = parse_robot(CHAIN)
    assert [link.length for link, _ in robot.links] == [0.1, 0.2]
    hinges = [(h.axis, h.stiffness, h.lower, h.upper, h.rest) for h in robot.hinges]
    assert hinges == [("y", 1, -0.1, 1, 0.2), ("x", 2, -1, 1, 0.1), ("y", 2, -1, 1, -0.3)]
    assert parse_robot(robot.to_toml()) == robot


def test_torsion_stops_at_its_own_limits() -> None:
    """One limit holds to both sides, unless the lower one is given."""
    torsion = "torsion = { stiffness = 3.0, damping = 0.1, limit = 0.5 }\n"
    both = parse_robot(CHAIN + torsion).hinges[-1]
    one = parse_robot(CHAIN + torsion.replace(" }", ", lower = -0.2, rest = 0.3 }")).hinges[-1]
    assert (both.axis, both.stiffness, both.lower, both.upper, both.rest) == ("z", 3, -0.5, 0.5, 0)
    assert (one.lower, one.upper, one.rest) == (-0.2, 0.5, 0.3)
    with pytest.raises(CdcsrError, match=r"torsion: rest must lie between -0\.2 and 0\.5 rad"):
        parse_robot(CHAIN + torsion.replace(" }", ", lower = -0.2, rest = -0.3 }"))


@pytest.mark.parametrize("engine", backend_names())
def test_an_arm_starts_at_its_rest_angles_and_stays_there(engine: str) -> None:
    """Without gravity and with free servos nothing moves, because no spring pulls; pushed hard, a
    hinge stops at the lower of its two limits."""
    servo = load_robot("paper").segments[0].servo.model_dump()
    cables = {"angles_deg": [0.0, 180.0], "pitch_radius": 0.02, "guide_offset": 0.01}
    data = parse_robot(CHAIN).model_dump()
    driven = data["segments"][0] | {"cables": cables, "servo": servo | {"offset": 0.1}}
    robot = Robot.model_validate(data | {"segments": [driven]})
    with running(robot, engine) as simulation:
        simulation.step(np.zeros((1, 2)), 100)
        state = simulation.state()
        np.testing.assert_allclose(state.joint_angles, [robot.start_angles], atol=1e-5)
        place = walk(robot, np.array(robot.start_angles))[-1]
        tip = place[0] + place[1] @ [0, 0, 0.2]
        np.testing.assert_allclose(state.tip_position[0], tip, atol=1e-6)
        simulation.step(np.array([[0.0, -2.0]]), 300)
        # Stock MuJoCo gives way by up to 0.08 rad; the other limit is 1 rad away.
        assert -0.2 < simulation.state().joint_angles[0, 0] < -0.09


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mass = 0.1", "mass = -0.1", "line 12, segments[0].chain[0].mass: should be greater"),
        ("rest = [0.1, -0.3]", "rest = [0.1]", "rest must have 2 angles"),
        ("rest = [0.1, -0.3]", "rest = [0.1, 1.3]", "rest must lie between -1 and 1 rad"),
        ("lower = -0.1", "lower = 0.1", "joint.lower: should be less than or equal to 0"),
        ('order = "y"', 'order = "z"', "joint.order: should be 'xy', 'yx', 'x' or 'y'"),
        ("[[segments]]", "[[segments]]\nlinks = 3", "links must be 2, as many as chain lists"),
        ("joint = {", "taper = { mass = 0.5 }\njoint = {", "taper needs link"),
    ],
)
def test_impossible_chains_are_refused(old: str, new: str, message: str) -> None:
    with pytest.raises(CdcsrError, match=re.escape(message)):
        parse_robot(CHAIN.replace(old, new, 1))


def test_radius_and_mass_of_a_taper_change_from_the_first_link_to_the_last() -> None:
    """By hand, for the middle one of three links: 0.75 of the radius, 0.9 of the mass; moments
    across go with the mass, that along it with the mass and the radius squared, 0.5625."""
    data = load_robot("planar-single").model_dump()
    link = {"length": 0.2, "radius": 0.02, "mass": 2.0, "inertia": (0.008, 0.006, 0.012)}
    taper = {"radius": 0.5, "mass": 0.8}
    (segment,) = data["segments"]
    segment |= {"links": 3, "link": link, "taper": taper}
    first, middle, last = (each for each, _ in Robot.model_validate(data).links)
    assert (first.radius, first.mass, first.inertia) == (0.02, 2.0, (0.008, 0.006, 0.012))
    assert (middle.radius, middle.mass) == pytest.approx((0.015, 1.8))
    assert middle.inertia == pytest.approx((0.0072, 0.0054, 0.9 * 0.5625 * 0.012))
    assert (last.radius, last.mass) == pytest.approx((0.01, 1.6))
    assert last.inertia == pytest.approx((0.0064, 0.0048, 0.0024))
    assert {each.length for each in (first, middle, last)} == {0.2}
    segment |= {"taper": {"mass": 0.5}}
    assert [each.radius for each, _ in Robot.model_validate(data).links] == [0.02] * 3
    segment |= {"links": 1, "taper": taper}
    ((only, _),) = Robot.model_validate(data).links
    assert (only.radius, only.mass) == (0.02, 2.0)


def test_a_taper_that_leaves_no_rigid_body_is_refused_when_it_is_read() -> None:
    """The moment along the arm falls with the radius squared, those across do not: 0.003 is more
    than 0.0017 + 0.64 x 0.0014."""
    data = load_robot("planar-single").model_dump()
    data["segments"][0]["link"]["inertia"] = (0.003, 0.0017, 0.0014)
    Robot.model_validate(data)
    data["segments"][0]["taper"] = {"radius": 0.8}
    with pytest.raises(ValidationError, match="taper makes an impossible link: no rigid body"):
        Robot.model_validate(data)


def test_a_payload_and_the_last_link_turn_as_two_bodies_do() -> None:
    """Mass, first moment and moments about the joint are sums; other links have no part in it."""
    robot = load_robot("paper")
    moments = np.array([0.01, 0.02, 0.03])
    payload = {"mass": 0.5, "inertia": moments.tolist(), "offset": 0.1}
    laden = Robot.model_validate(robot.model_dump() | {"payload": payload})
    bare, last, height = robot.links[-1][0], laden.links[-1][0], robot.links[-1][0].length + 0.1
    assert laden.links[:-1] == robot.links[:-1]
    assert last.length == bare.length
    assert last.mass == pytest.approx(bare.mass + 0.5)
    first = bare.mass * bare.center_of_mass + 0.5 * height
    assert last.mass * last.center_of_mass == pytest.approx(first)
    for axis in range(3):
        across = axis < 2
        about = [
            moments[axis] + across * 0.5 * height**2,
            bare.inertia[axis] + across * bare.mass * bare.center_of_mass**2,
        ]
        found = last.inertia[axis] + across * last.mass * last.center_of_mass**2
        assert found == pytest.approx(sum(about))
    assert parse_robot(laden.to_toml()) == laden
    assert laden.fingerprint != robot.fingerprint
