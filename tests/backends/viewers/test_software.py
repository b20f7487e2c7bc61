"""The software renderer draws the robot's pose and the targets; cables are drawn as they run."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pybullet
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from backends.contract_suite.states import moving, straight
from backends.mujoco.simulation import MujocoSimulation
from backends.viewers.cable_paths import CablePaths
from backends.viewers.software import Renderer, _turn_to
from cdcsr.robot.colors import BACKGROUND, TARGET, TIP
from cdcsr.robot.description import Robot, load_robot, shipped_robots
from cdcsr.robot.meshes import link_parts, visual_meshes
from cdcsr.robot.poses import link_poses, tip_at_start
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.cameras import CAMERAS
from cdcsr.simulation.contract import Array
from cdcsr.tasks.debris import load_surface


def test_pictures_show_the_pose_and_the_targets(paper: Robot) -> None:
    position = straight(paper, 2).position
    position[1, -paper.num_hinges :] = 0.05
    renderer = Renderer(paper)
    plain, bent = renderer.draw(position[0]), renderer.draw(position[1])
    marked = renderer.draw(position[0], targets=[[0.2, 0.1, 2.45]])
    renderer.close()
    assert plain.shape == (640, 480, 3)
    assert plain.dtype == np.uint8
    assert (plain != bent).any(axis=2).sum() > 500
    rows, columns = np.nonzero((plain != marked).any(axis=2))
    assert 10 < len(rows) < 200
    assert rows.mean() < 200  # high up
    assert columns.mean() > 240  # to the right of the arm, as this camera sees it


def test_debris_is_drawn_and_is_seen_through(paper: Robot, tmp_path: Path) -> None:
    """A slab between the camera and a target changes the white behind it by half of what an opaque
    one would, and leaves the target redder than the rest."""
    target, file = np.array([0.2, 0.1, 2.45]), tmp_path / "slab.ply"
    slab = trimesh.creation.box((0.4, 0.02, 0.4)).apply_translation(target - (0.0, 0.1, 0.0))
    slab.export(file)
    pictures = []
    for debris in (None, load_surface(str(file), paper)):
        renderer = Renderer(paper, debris)
        pictures.append(renderer.draw(straight(paper).position[0], targets=target).astype(int))
        again = renderer.draw(straight(paper).position[0], targets=target)
        np.testing.assert_array_equal(again, pictures[-1])  # it comes back
        renderer.close()
    plain, behind = pictures
    changed = (plain != behind).any(axis=2)
    assert changed.sum() > 1000
    white = changed & (plain == plain[0, 0]).all(axis=2)
    assert behind[white].min() > 120  # the mean of white and of the debris
    red = plain[..., 0] > 2 * plain[..., 1:].max(axis=2)
    assert (red & changed).sum() > 10
    assert (behind[red, 0] - behind[red, 2]).min() > 40


def test_a_near_view_of_a_small_robot_shows_its_tip() -> None:
    """The eye is 40 mm from it, nearer than what a robot of the paper's size would hide."""
    robot = load_robot("bench-arm")
    renderer = Renderer(robot)
    tip = tip_at_start(robot)
    near = renderer.draw(straight(robot, 1).position[0], size=(64, 64), focus=(tip, 0.02))
    renderer.close()
    assert (near != near[0, 0]).any(axis=2).mean() > 0.05


def test_a_picture_holds_arms_that_hang_and_bases_that_are_wide() -> None:
    """The hanging arm is seen below its base, and the panels of the lab arm's end within."""
    for name in ("hanging-arm", "lab-arm"):
        robot = load_robot(name)
        position = straight(robot, 2).position
        position[:, 3:7] = robot.base.quaternion
        position[1, -robot.num_hinges :] = 0.05
        renderer = Renderer(robot)
        plain, bent = (renderer.draw(each, size=(240, 180)) for each in position)
        renderer.close()
        rows = np.flatnonzero((plain != bent).any(axis=(1, 2)))
        assert np.ptp(rows) > 0.2 * 240
        assert (plain[:, [0, -1]] == plain[0, 0]).all()
        assert (plain[[0, -1]] == plain[0, 0]).all()
        drawn = (plain != plain[0, 0]).any(axis=2)
        wide, high = (np.ptp(np.flatnonzero(drawn.any(axis=k))) for k in (0, 1))
        assert max(wide / 180, high / 240) > 0.8
    data = load_robot("planar-single").model_dump()
    lying = Robot.model_validate(data | {"base": data["base"] | {"quaternion": (0.6, 0, 0.8, 0)}})
    position = straight(lying).position[0]
    position[3:7] = lying.base.quaternion
    renderer = Renderer(lying)
    for camera in CAMERAS:  # a panel comes nearer to the eye, and is seen as far as its end
        drawn = (renderer.draw(position, camera, size=(120, 90)) != BACKGROUND).any(axis=2)
        columns = np.flatnonzero(drawn.any(axis=0))
        assert not drawn[[0, -1]].any()
        assert columns[-1] < 89
        assert 0 < columns[0] < 3
    renderer.close()


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_point_is_seen_where_a_pinhole_camera_has_it(camera: str, paper: Robot) -> None:
    """Far from the robot a target alone is in the picture. Azimuth 0 and elevation 0 look along
    +y; the picture is as high as the part of the world that is asked for, at the depth of its
    middle. The light comes from above and from the right."""
    azimuth, elevation = np.deg2rad(CAMERAS[camera])
    flat = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    gaze = np.cos(elevation) * flat + np.sin(elevation) * np.array([0.0, 0.0, 1.0])
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    up, center = np.cross(right, gaze), np.array([7.0, -9.0, 3.0])
    renderer, position = Renderer(paper), straight(paper).position[0]
    high, wide, radius = 96, 64, 0.018  # a target of the paper's robot, in [m]
    for across, above, span in ((0.0, 0.0, 0.1), (0.05, 0.1, 0.4), (-0.06, -0.12, 0.4)):
        target, focus = center + across * right + above * up, (center, span)
        drawn = renderer.draw(position, camera, target, (high, wide), focus).astype(float)
        ball = (drawn != drawn[0, 0]).any(axis=2)
        rows, columns = np.nonzero(ball)
        pixel = high / span
        assert np.mean(columns) + 0.5 == pytest.approx(wide / 2 + across * pixel, abs=0.7)
        assert np.mean(rows) + 0.5 == pytest.approx(high / 2 - above * pixel, abs=0.7)
        # The eye is span / 2 / tan(12.5 degrees) away, so a ball looks hardly larger than its disc.
        assert np.sqrt(ball.sum() / np.pi) == pytest.approx(radius * pixel, abs=0.7)
        if span == 0.1:
            red = drawn[..., 0]
            upper, lower = rows < high / 2 - 8, rows > high / 2 + 8
            later, sooner = columns > wide / 2 + 8, columns < wide / 2 - 8
            light = red[rows, columns]
            assert light[upper].mean() > 1.1 * light[lower].mean()
            # Light from the eye, as much and 0.6 from the right, and 0.8 from above.
            bright = light[later].mean() - light[sooner].mean()
            steep = (light[upper].mean() - light[lower].mean()) / bright
            assert bright > 0
            assert 1.2 < steep < 1.9  # 0.8 / 0.6, and as much as the ball hides
            share = np.percentile(drawn[ball], [0, 60], axis=0) / TARGET[:3]
            np.testing.assert_allclose(share[0], 0.55, atol=0.03)  # of its colour, in the shade
            assert (np.abs(share[1] - 0.85) < 0.15).all()
    far = 4.9 * (2 * paper.top + paper.arm_length)  # so far is drawn
    behind = renderer.draw(position, camera, center + far * gaze, (4 * high, 4 * wide), focus)
    assert (behind != behind[0, 0]).any()
    renderer.close()


def test_a_mesh_of_several_colours_is_drawn_once_and_in_its_colours(
    paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: Counter[tuple[int, ...]] = Counter()
    inner = pybullet.createVisualShape

    def make(*given: Any, **more: Any) -> int:
        color = tuple(np.round(np.multiply(more["rgbaColor"], 255)).astype(int).tolist())
        triangles = np.reshape(more["vertices"], (-1, 3, 3))
        drawn[color] += len(triangles)
        assert more["indices"] == list(range(3 * len(triangles)))
        # Each corner is lit as its own triangle is.
        first, second = np.diff(triangles, axis=1).swapaxes(0, 1)
        across = np.cross(first, second)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        np.testing.assert_allclose(more["normals"], np.repeat(across, 3, axis=0), atol=1e-6)
        if color == TIP:  # a ball: it looks round, and is drawn in no time
            far = np.linalg.norm(triangles.mean(axis=1), axis=1)
            assert far.min() > 0.98 * np.linalg.norm(triangles, axis=2).max()
            assert len(far) < 1000
        return inner(*given, **more)

    monkeypatch.setattr(pybullet, "createVisualShape", make)
    Renderer(paper).close()
    expected: Counter[tuple[int, ...]] = Counter()
    meshes = visual_meshes(paper)
    for part in ("base", *link_parts(paper)):
        visual: Any = meshes[part].visual
        expected.update(map(tuple, visual.face_colors.tolist()))
    assert len(expected) > 3  # metal, panels and both segments
    assert {color: drawn[color] for color in expected} == dict(expected)


def test_bodies_are_where_mujoco_has_them(paper: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Base, links, the ball at the tip and the pieces of cables, which lie along their z axis and
    are as long as the ways between guides."""
    made: dict[str, list[float]] = {"cylinder": [], "icosphere": []}
    for kind, sizes in made.items():
        inner = getattr(trimesh.creation, kind)

        def make(
            *given: Any, inner: Any = inner, sizes: list[float] = sizes, **more: Any
        ) -> trimesh.Trimesh:
            sizes += [float(each) for each in given]
            return inner(*given, **more)

        monkeypatch.setattr(trimesh.creation, kind, make)
    simulation, start = MujocoSimulation(paper), moving(paper, 1)
    simulation.set_snapshot(start)
    data = mujoco.MjData(simulation.model)
    simulation.write_to(data)
    mujoco.mj_forward(simulation.model, data)
    renderer = Renderer(paper)
    lines = np.reshape(made["cylinder"], (-1, 2))[-len(renderer._cables) :]
    assert set(lines[:, 0]) == {0.002}
    assert set(np.round(lines[:, 1], 9)) == {0.04, 0.16}  # from link to link, and along one
    assert made["icosphere"][-1] == pytest.approx(0.01)
    renderer.draw(start.position[0], targets=np.ones((2, 3)), size=(8, 6))
    renderer.draw(start.position[0], targets=[[0.5, 0.0, 2.0]], size=(8, 6))

    def pose(body: int) -> tuple[Array, Rotation]:
        place, turn = pybullet.getBasePositionAndOrientation(body, renderer._client)
        return np.array(place), Rotation.from_quat(turn)

    names = ["base", *(f"link_{n}" for n in range(12))]
    for name, bodies in zip(names, renderer._parts, strict=True):
        number = simulation.model.body(name).id
        for place, turn in map(pose, bodies):
            np.testing.assert_allclose(place, data.body(name).xpos, atol=1e-6)
            expected = data.xmat[number].reshape(3, 3)
            np.testing.assert_allclose(turn.as_matrix(), expected, atol=1e-6)
    np.testing.assert_allclose(pose(renderer._tip)[0], data.site("tip").xpos, atol=1e-6)
    first, second = (pose(ball)[0] for ball in renderer._targets)
    np.testing.assert_allclose(first, [0.5, 0.0, 2.0])
    assert np.linalg.norm(second) > 100  # out of sight
    low, high = (data.site(f"guide_0_0_{side}").xpos for side in ("low", "high"))
    poses = [pose(line) for line in renderer._cables]
    place, turn = min(poses, key=lambda each: np.linalg.norm(each[0] - (low + high) / 2))
    np.testing.assert_allclose(place, (low + high) / 2, atol=1e-6)
    along = (high - low) / np.linalg.norm(high - low)
    np.testing.assert_allclose(turn.apply([0, 0, 1]), along, atol=1e-6)
    renderer.close()
    for direction in np.append(np.random.default_rng(0).normal(size=(5, 3)), [[0, 0, -2.0]], 0):
        turned = Rotation.from_quat(_turn_to(direction)).apply([0, 0, np.linalg.norm(direction)])
        np.testing.assert_allclose(turned, direction, atol=1e-9)


def test_the_whole_robot_is_seen_with_a_rim(paper: Robot) -> None:
    """The rim above and below is an eighth of the robot's height."""
    renderer = Renderer(paper)
    large = renderer.draw(straight(paper).position[0], "front", size=(240, 180))
    renderer.close()
    rows = np.flatnonzero((large != large[0, 0]).any(axis=(1, 2)))
    high = np.ptp(rows) + 1
    assert rows[0] / high == pytest.approx(0.12, abs=0.03)
    assert 0.03 < (239 - rows[-1]) / high < 0.12  # the base is nearer to the eye


def test_a_pixel_is_the_mean_of_four(paper: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no body is, all is background; the field of view is 25 degrees high."""
    seen: list[dict[str, Any]] = []
    random = np.random.default_rng(0)
    pixels, mask = random.integers(0, 256, (24, 16, 4)), random.integers(-1, 2, (24, 16))

    def shoot(width: int, height: int, **more: Any) -> tuple[Any, ...]:
        seen.append(more)
        assert (width, height) == (16, 24)
        return width, height, pixels.ravel().tolist(), (), mask.ravel().tolist()

    renderer = Renderer(paper)
    monkeypatch.setattr(pybullet, "getCameraImage", shoot)
    drawn = renderer.draw(straight(paper).position[0], "front", size=(12, 8))
    renderer.close()
    whole = np.where(mask[..., None] < 0, BACKGROUND, pixels[..., :3])
    expected = whole.reshape(12, 2, 8, 2, 3).mean(axis=(1, 3))
    np.testing.assert_array_equal(drawn, np.floor(expected))
    (more,) = seen
    lens = np.reshape(more["projectionMatrix"], (4, 4))
    assert lens[1, 1] == pytest.approx(1 / np.tan(np.deg2rad(12.5)))
    np.testing.assert_allclose(more["lightDirection"], (0.6, -1.0, 0.8), atol=1e-9)
    assert more["shadow"] == 0


@pytest.mark.parametrize("name", shipped_robots())
def test_cables_are_drawn_as_long_as_they_are(name: str) -> None:
    robot, random = load_robot(name), np.random.default_rng(0)
    paths, travel = CablePaths(robot), random.uniform(-0.01, 0.01, robot.num_cables)
    hinges = random.uniform(-0.2, 0.2, robot.num_hinges)
    quaternion = random.normal(size=4)
    base = [*random.normal(size=3), *(quaternion / np.linalg.norm(quaternion))]
    poses = link_poses(robot, np.concatenate([base, travel, hinges]))
    pieces, sliders = paths.pieces(poses), paths.sliders(poses, travel)
    length = np.linalg.norm(sliders[:, 1] - sliders[:, 0], axis=1)
    outside = np.bincount(paths.cable, np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1))
    expected = cable_lengths(routing(robot), travel, hinges)
    np.testing.assert_allclose(length + outside, expected, atol=1e-12)
    slack = np.full(robot.num_cables, 0.0015 * robot.arm_length)
    lines = paths.bowed(pieces, poses, slack)
    owner = paths.of_lines(np.arange(float(robot.num_cables))).astype(int)
    drawn = np.bincount(owner, np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1))
    np.testing.assert_allclose(drawn - outside, slack, rtol=0.08)  # of four straight lines


@pytest.mark.parametrize("name", ["paper", "three-segment"])
def test_slack_cables_bow_outward_by_half_a_sine(name: str) -> None:
    """Along the straight arm the middle of a piece of length d that is e too long lies 2 / pi
    sqrt(d e) farther from the axis, at the same height; a turned robot is drawn turned."""
    robot = load_robot(name)
    some = [0.01, 0.0, 0.004, -0.01, 0.02, 0.03, 0.0, 0.001]
    paths, slack = CablePaths(robot), np.resize(some, robot.num_cables)
    straight = np.zeros(7 + robot.num_cables + robot.num_hinges)
    straight[3] = 1
    poses = link_poses(robot, straight)
    pieces = paths.pieces(poses)
    lines = paths.bowed(pieces, poses, slack)
    count = np.bincount(paths.cable)[paths.cable]
    long = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1)
    height = 2 / np.pi * np.sqrt(long * np.maximum(slack[paths.cable], 0) / count)
    middle = lines.reshape(len(pieces), -1, 2, 3)[:, 1, 1]
    mean = pieces.mean(axis=1)
    away = np.linalg.norm(middle[:, :2], axis=1) - np.linalg.norm(mean[:, :2], axis=1)
    np.testing.assert_allclose(away, height, atol=1e-9)
    np.testing.assert_allclose(middle[:, 2], mean[:, 2], atol=1e-9)
    aside = middle[:, 0] * mean[:, 1] - middle[:, 1] * mean[:, 0]
    np.testing.assert_allclose(aside, 0, atol=1e-12)
    assert height.max() > 1e-3
    turn, place = Rotation.from_euler("xyz", (0.3, -1.0, 2.0)), np.array([1.0, -2.0, 0.5])
    moved = straight.copy()
    moved[:3], moved[3:7] = place, turn.as_quat(scalar_first=True)
    poses = link_poses(robot, moved)
    again = paths.bowed(paths.pieces(poses), poses, slack)
    expected = turn.apply(lines.reshape(-1, 3)) + place
    np.testing.assert_allclose(again.reshape(-1, 3), expected, atol=1e-9)
