"""Links and joints follow from a backbone's material; older descriptions keep their meaning."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot, parse_robot
from cdcsr.robot.parts import Backbone
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
