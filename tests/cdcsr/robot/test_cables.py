"""Cable lengths against guide-by-guide geometry, and their Jacobian against finite differences."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot, parse_robot, shipped_robots
from cdcsr.robot.poses import link_poses
from cdcsr.robot.routing import Array, cable_jacobian, cable_lengths, routing


@pytest.fixture(params=shipped_robots())
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


def random_state(robot: Robot, seed: int, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
    """Return travel in [m] and hinge angles in [rad] that the robot can reach."""
    random = np.random.default_rng(seed)
    room = min(0.05, *(servo.stop for servo in robot.servos))
    travel = random.uniform(-room, room, (*shape, robot.num_cables))
    return travel, random.uniform(-0.8, 0.8, (*shape, robot.num_hinges))


def transform(rotation: Array, translation: tuple[float, float, float]) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


def turn_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def turn_y(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def brute_force_length(robot: Robot, cable: int, travel: Array, hinges: Array) -> float:
    """Return a cable's length from the positions of its slider and of each of its guides."""
    owners = [s for s, segment in enumerate(robot.segments) for _ in segment.cables.angles_deg]
    own = owners[cable]
    cables, servo = robot.segments[own].cables, robot.segments[own].servo
    angle = np.deg2rad(cables.angles_deg[cable - owners.index(own)])
    x, y = cables.pitch_radius * np.cos(angle), cables.pitch_radius * np.sin(angle)
    offset = cables.guide_offset
    start = robot.base.size[2] / 2 - offset
    points = [np.array([x, y, start - servo.offset + travel[cable]]), np.array([x, y, start])]
    frame = transform(np.eye(3), (0, 0, robot.base.size[2] / 2))
    joint = 0
    for segment in robot.segments[: own + 1]:
        for _ in range(segment.links):
            frame = frame @ transform(turn_x(hinges[2 * joint]), (0, 0, 0))
            frame = frame @ transform(turn_y(hinges[2 * joint + 1]), (0, 0, 0))
            for height in (offset, segment.link.length - offset):
                points.append((frame @ np.array([x, y, height, 1]))[:3])
            frame = frame @ transform(np.eye(3), (0, 0, segment.link.length))
            joint += 1
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def test_rest_lengths_of_the_paper_robot() -> None:
    # 0.2 m from slider to first guide, and 6 or 12 links of 0.2 m: the first guide lies as far
    # below the face of the base as the anchor lies below the end of the last link.
    route = routing(load_robot("paper"))
    np.testing.assert_allclose(route.rest_length, [1.4] * 4 + [2.6] * 4, rtol=1e-15)


def test_at_rest_a_cable_has_its_rest_length(robot: Robot) -> None:
    route = routing(robot)
    length = cable_lengths(route, np.zeros(robot.num_cables), np.zeros(robot.num_hinges))
    np.testing.assert_allclose(length, route.rest_length, rtol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_length_is_the_distance_along_the_guides(robot: Robot, seed: int) -> None:
    travel, hinges = random_state(robot, seed)
    expected = [brute_force_length(robot, c, travel, hinges) for c in range(robot.num_cables)]
    np.testing.assert_allclose(cable_lengths(routing(robot), travel, hinges), expected, rtol=1e-13)


@pytest.mark.parametrize("seed", range(3))
def test_jacobian_is_the_derivative_of_length(robot: Robot, seed: int) -> None:
    route = routing(robot)
    travel, hinges = random_state(robot, seed)
    both = np.concatenate([travel, hinges])
    step = 1e-6
    columns = []
    for i in range(len(both)):
        moved = np.stack([both, both])
        moved[0, i] += step
        moved[1, i] -= step
        ahead, behind = cable_lengths(
            route, moved[:, : robot.num_cables], moved[:, robot.num_cables :]
        )
        columns.append((ahead - behind) / (2 * step))
    # Rounding of lengths near 3 m, divided by the step, is a few 1e-10.
    np.testing.assert_allclose(
        cable_jacobian(route, travel, hinges), np.stack(columns, axis=-1), atol=2e-9
    )


def test_cables_over_joints_of_any_kind_against_the_poses_of_their_guides() -> None:
    """A rod whose joints twist too, and bend about x or about y first."""
    data = load_robot("three-segment").model_dump()
    keep = {name: data["segments"][0][name] for name in ("links", "cables", "servo")}
    backbone = {"length": 1.0, "radius": 0.02, "youngs_modulus": 1e7, "poissons_ratio": 0.3}
    keep["backbone"] = {**backbone, "density": 1000.0, "damping_time": 0.1}
    robot = Robot.model_validate(data | {"segments": [keep, *data["segments"][1:]]})
    route = routing(robot)
    assert not route.is_universal
    travel, hinges = random_state(robot, 3, (2,))
    position = np.concatenate(
        [np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), travel, hinges], 1
    )
    for row in range(2):
        poses = link_poses(robot, position[row])
        for c, joints in enumerate(route.joints):
            place, offset = np.append(route.place[c], 0.0), np.array([0, 0, route.guide_offset[c]])
            slider = place - offset - [0, 0, route.slider_offset[c] - travel[row, c]]
            points = [poses.joint[0] + slider]
            for n in range(joints):
                points.append(poses.joint[n] + poses.axes[n] @ (place - offset))
                points.append(poses.joint[n] + poses.axes[n + 1] @ (place + offset))
            last = poses.joint[joints] + poses.axes[joints] @ (place - offset)
            expected = np.linalg.norm(np.diff([*points, last], axis=0), axis=1).sum()
            found = cable_lengths(route, travel[row], hinges[row])[c]
            assert found == pytest.approx(expected, rel=1e-13)
    step, jacobian = 1e-6, cable_jacobian(route, travel, hinges)
    for i in range(robot.num_hinges):
        ahead, behind = hinges.copy(), hinges.copy()
        ahead[:, i] += step
        behind[:, i] -= step
        change = cable_lengths(route, travel, ahead) - cable_lengths(route, travel, behind)
        column = jacobian[..., robot.num_cables + i]
        np.testing.assert_allclose(column, change / (2 * step), atol=2e-9)


def test_one_or_two_cables_on_any_way_against_a_line_through_their_guides() -> None:
    """A cone, a helix, and a cable in a sheath past the first two links that ends in the next
    segment: lengths against the guides turned by plain rotations, derivatives against differences.
    Radius and direction are linear in the height between the first guide and the anchor."""
    data = load_robot("paper").model_dump()
    helix = {"angle_deg": 10.0, "end_pitch_radius": 0.01, "twist_deg": 200.0}
    led = {"angle_deg": 130.0, "first_link": 2, "last_link": 9, "twist_deg": -50.0}
    cables = {"pitch_radius": 0.02, "guide_offset": 0.02}
    ways = ({"paths": (helix, led)}, {"paths": ({"angle_deg": 80.0},)})
    lengths = [0.2, 0.14, 0.23, 0.17, 0.2, 0.26, *6 * [0.19]]
    lower, upper = data["segments"]
    link = lower.pop("link")
    lower["chain"] = [link | {"length": length} for length in lengths[:6]]
    upper["link"]["length"] = 0.19
    both = zip((lower, upper), ways, strict=True)
    segments = [segment | {"cables": cables | way} for segment, way in both]
    robot = Robot.model_validate(data | {"segments": segments})
    assert parse_robot(robot.to_toml()) == robot
    route, (travel, hinges) = routing(robot), random_state(robot, 4, (1,))
    place, turn, frames = np.array([0, 0, robot.first_joint]), np.eye(3), []
    for n, length in enumerate(lengths):
        turn = turn @ Rotation.from_euler("XY", hinges[0, 2 * n : 2 * n + 2]).as_matrix()
        frames.append((place, turn))
        place = place + turn @ [0, 0, length]
    foot = np.cumsum([0.0, *lengths])  # of each link, above the first joint
    spans = [(0, 6, 10, 200, 0.02, 0.01), (2, 10, 130, -50, 0.02, 0.02), (0, 12, 80, 0, 0.02, 0.02)]
    for c, (first, end, angle, twist, near, far) in enumerate(spans):
        points = []
        for n in range(first - 1, end):
            origin, axes = frames[n] if n >= 0 else (np.array([0, 0, robot.top]), np.eye(3))
            length, start = (lengths[n], foot[n]) if n >= 0 else (0.0, 0.0)
            for z in [length - 0.02] if n < first else [0.02, length - 0.02]:
                part = (start + z + 0.02 - foot[first]) / (foot[end] - foot[first])
                radius, phi = near + (far - near) * part, np.deg2rad(angle + twist * part)
                point = [radius * np.cos(phi), radius * np.sin(phi), z]
                points.append(origin + axes @ point)
        line = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        expected = 0.2 - travel[0, c] + line
        assert cable_lengths(route, travel, hinges)[0, c] == pytest.approx(expected, rel=1e-12)
    jacobian, step = cable_jacobian(route, travel, hinges), 1e-6
    for i in range(24):
        apart = step * np.eye(24)[i]
        change = cable_lengths(route, travel, hinges + apart) - cable_lengths(
            route, travel, hinges - apart
        )
        np.testing.assert_allclose(jacobian[0, :, 3 + i], change[0] / (2 * step), atol=2e-9)


def test_hinges_are_numbered_from_the_base_to_the_tip() -> None:
    """A joint may have one, two or three; only joints of two, about x and then y, are universal."""
    data = load_robot("planar-single").model_dump()
    (segment,) = data["segments"]
    link, joint = segment.pop("link"), segment.pop("joint")
    torsion = {"stiffness": 1.0, "damping": 0.1, "limit": 0.5}
    joints = ({"order": "y"}, {"torsion": torsion}, {"order": "yx"}, {})
    segment |= {"links": 4, "taper": None, "chain": [link | {"joint": joint | j} for j in joints]}
    route = routing(Robot.model_validate(data))
    assert route.hinges.tolist() == [[0, -1, -1], [1, 2, 3], [4, 5, -1], [6, 7, -1]]
    assert route.axes[route.hinges >= 0].tolist() == [1, 0, 1, 2, 1, 0, 0, 1]
    assert not route.is_universal
    for chosen, universal in ((joints[1], False), (joints[2], False), (joints[3], True)):
        segment["chain"] = 4 * [link | {"joint": joint | chosen}]
        assert routing(Robot.model_validate(data)).is_universal == universal


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ({"last_link": 12}, "paths[0].last_link: must be at most 11, the last link"),
        ({"first_link": 6}, "paths[0].first_link: must be at most 5, the link it ends on"),
        ({"first_link": 1, "last_link": 0}, "first_link: must be at most 0, the link it ends"),
        ({"pitch_radius": 0.4}, "paths[0].pitch_radius: puts a cable outside the base"),
        ({"twist_deg": 1e6}, "paths[0].twist_deg: should be less than or equal to 36000"),
        ({"twist": 1.0}, "paths[0].twist: unknown key, did you mean 'twist_deg'?"),
    ],
)
def test_impossible_ways_are_refused(path: dict[str, float], message: str) -> None:
    keys = "".join(f", {key} = {value}" for key, value in path.items())
    text = load_robot("paper").to_toml().replace("angles_deg = [", "unused = [", 1)
    start, end = text.index("unused"), text.index("]", text.index("unused"))
    listed = f"paths = [{{ angle_deg = 0.0{keys} }}, {{ angle_deg = 90.0 }}]"
    with pytest.raises(CdcsrError, match=re.escape(message)):
        parse_robot(text[:start] + listed + text[end + 1 :])


def test_pulling_a_slider_lengthens_its_own_cable_and_no_other(robot: Robot) -> None:
    travel, hinges = random_state(robot, 0)
    jacobian = cable_jacobian(routing(robot), travel, hinges)
    np.testing.assert_array_equal(jacobian[:, : robot.num_cables], -np.eye(robot.num_cables))


def test_a_cable_does_not_depend_on_joints_beyond_its_anchor(robot: Robot) -> None:
    route = routing(robot)
    travel, hinges = random_state(robot, 0)
    _, others = random_state(robot, 1)
    jacobian = cable_jacobian(route, travel, hinges)[:, robot.num_cables :]
    for c, joints in enumerate(route.joints):
        changed = np.concatenate([hinges[: 2 * joints], others[2 * joints :]])
        assert cable_lengths(route, travel, changed)[c] == cable_lengths(route, travel, hinges)[c]
        assert not jacobian[c, 2 * joints :].any()
        assert jacobian[c, : 2 * joints].all()


def test_cables_end_on_their_own_segment(robot: Robot) -> None:
    ends = np.cumsum([segment.links for segment in robot.segments])
    expected = [
        end for end, s in zip(ends, robot.segments, strict=True) for _ in s.cables.angles_deg
    ]
    np.testing.assert_array_equal(routing(robot).joints, expected)


def test_batches_give_the_same_as_single_states(robot: Robot) -> None:
    route = routing(robot)
    travel, hinges = random_state(robot, 0, (2, 3))
    lengths, jacobians = cable_lengths(route, travel, hinges), cable_jacobian(route, travel, hinges)
    assert lengths.shape == (2, 3, robot.num_cables)
    assert jacobians.shape == (2, 3, robot.num_cables, robot.num_cables + robot.num_hinges)
    for i in np.ndindex(2, 3):
        np.testing.assert_allclose(
            lengths[i], cable_lengths(route, travel[i], hinges[i]), rtol=1e-15
        )
        np.testing.assert_allclose(
            jacobians[i], cable_jacobian(route, travel[i], hinges[i]), atol=1e-16
        )


def test_a_routing_is_kept_and_nobody_can_change_it(robot: Robot) -> None:
    kept = routing(robot)
    assert kept is routing(robot.model_copy())
    with pytest.raises(ValueError, match="read-only"):
        kept.rest_length[0] = 1.0


def test_a_slider_has_room_below_its_guide() -> None:
    text = load_robot("planar-single").to_toml()
    short = text.replace("offset = 0.2\n", "offset = 0.01\n")
    message = r"puts the slider into its guide: must be above its radius \(0\.01 m\)"
    with pytest.raises(CdcsrError, match=message):
        parse_robot(short)
    assert parse_robot(text.replace("offset = 0.2\n", "offset = 0.011\n")).servos[0].stop < 0.0011
