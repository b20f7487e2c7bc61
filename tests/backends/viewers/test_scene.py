"""The live view and films show poses, colours, spaces and numbers, from where the eye is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from trimesh import creation

from backends.contract_suite.states import moving, straight
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.robot.colors import CABLE_RADIUS
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.meshes import visual_meshes
from cdcsr.robot.ruler import ruler
from cdcsr.tasks.debris import load_surface
from cdcsr.tasks.spaces import Balls, anchor
from cdcsr.tasks.workspace_map import Workspace, load_workspace

viser = pytest.importorskip("viser", reason="the extra `view` is not installed")


class Recorder:
    """A scene that keeps what it is asked for: what, and with which arguments."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *args, **options: self.asked.append((name, args, options))


def test_a_robot_is_drawn_where_mujoco_has_it(paper: Robot, server: Any) -> None:
    """Base, links, the trail of the tip and the target; two robots stand side by side."""
    from backends.viewers.scene import EngineScene

    first, scene = (EngineScene(server, paper, "one", number) for number in (0, 1))
    assert first.origin.tolist() == [0, 0, 0]
    assert scene.origin[[0, 2]].tolist() == [0, 0]
    wide = visual_meshes(paper)["base"].extents[1]  # with its panels
    assert wide < scene.origin[1] < 1.5 * wide
    simulation, start = MujocoSimulation(paper), moving(paper, 1)
    simulation.set_snapshot(start)
    data = mujoco.MjData(simulation.model)
    simulation.write_to(data)
    mujoco.mj_forward(simulation.model, data)
    trail, target = np.arange(12.0).reshape(4, 3), np.array([0.1, 0.2, 2.0])
    scene.draw(start.position[0], np.zeros(8), np.zeros(8), trail, target)
    np.testing.assert_allclose(scene._base.position, start.position[0, :3])
    np.testing.assert_allclose(scene._base.wxyz, start.position[0, 3:7])
    seen = []
    for chosen, batch in scene._links:
        for link, place, turn in zip(
            chosen, batch.batched_positions, batch.batched_wxyzs, strict=True
        ):
            np.testing.assert_allclose(place, data.body(f"link_{link}").xpos, atol=1e-6)
            rotated = Rotation.from_quat(turn, scalar_first=True).as_matrix()
            expected = data.xmat[simulation.model.body(f"link_{link}").id]
            np.testing.assert_allclose(rotated.ravel(), expected, atol=1e-6)
            seen.append(int(link))
    assert sorted(seen) == list(range(12))
    np.testing.assert_allclose(scene._trail.points, np.stack([trail[:-1], trail[1:]], axis=1))
    np.testing.assert_allclose(scene._target.position, target)
    # Four lines for each piece of a cable, then the lines from the sliders.
    pieces = 4 * (1 + 2 * (6 - 1)) + 4 * (1 + 2 * (12 - 1)) + 8
    assert len(scene._cables.points) == len(scene._cables.colors) > pieces
    scene.draw(start.position[0], np.zeros(8), 0.01 * (np.arange(8) == 1), trail, target)
    colors = scene._cables.colors
    assert (colors[-8:, 0] == colors[-8:, 1]).all()
    blue = (colors[:, 0] == (90, 160, 255)).all(axis=1)
    assert blue[-8:].tolist() == [False, True, *[False] * 6]
    assert 4 * 10 < blue[:-8].sum() < 4 * 14


def test_a_cable_is_blue_when_slack_and_red_by_the_root_of_its_tension(
    paper: Robot, server: Any
) -> None:
    """The largest tension is 250 N; a quarter of it is half way from grey to red."""
    from backends.viewers.scene import EngineScene

    loose, taut, pulled = (90, 160, 255), (70, 70, 78), (230, 60, 20)
    scene = EngineScene(server, paper, "one", 0)
    tension = np.array([0, 62.5, 250, 1000, 0, 250, 0, 0.0])
    slack = np.array([0, 0, 0, 0, 1e-4, 1e-4, 4e-5, -1.0])
    half = (np.array(taut) + pulled) / 2
    expected = [taut, half, pulled, pulled, loose, loose, taut, taut]
    np.testing.assert_allclose(scene.cable_colors(tension, slack), expected)
    bench = load_robot("bench-arm")  # whose cables travel a twentieth as far
    found = EngineScene(server, bench, "two", 1).cable_colors(np.zeros(8), slack / 20)
    np.testing.assert_allclose(found[4:], [loose, loose, taut, taut])


def test_spaces_are_drawn_where_their_targets_are(paper: Robot, tmp_path: Any) -> None:
    from backends.viewers.scene import _add_space

    cuboid, balls = anchor(paper), Balls("balls", np.array([[0.0, 0, 2], [1, 0, 2]]), 0.05)
    creation.box((0.4, 0.02, 0.4)).apply_translation((0.2, 0.1, 2.45)).export(tmp_path / "slab.ply")
    surface = load_surface(str(tmp_path / "slab.ply"), paper)
    mapped, scene = load_workspace(paper), Recorder()
    for space in (cuboid, balls, surface, mapped):
        _add_space(scene, "space", space, 1.0)  # type: ignore[arg-type]
    box, *spheres, mesh, hull = scene.asked
    assert box[0] == "add_box"
    np.testing.assert_array_equal(box[1][2], cuboid.size)
    np.testing.assert_array_equal(box[2]["position"], cuboid.center)
    assert [(s[0], s[1][0], s[1][1]) for s in spheres] == [
        ("add_icosphere", f"space{n}", 0.05) for n in (0, 1)
    ]
    np.testing.assert_array_equal([s[2]["position"] for s in spheres], balls.centers)
    assert all(0 < options["opacity"] < 0.6 for _, _, options in scene.asked)
    violet = (120, 90, 200)
    assert box[1][1] == spheres[0][1][2] == spheres[1][1][2] == hull[2]["color"] == violet
    assert len(mesh[2]["color"]) == 3  # its opacity is told apart
    vertices = mesh[1][1][mesh[1][2].astype(int)]
    corners = hull[1][1][hull[1][2].astype(int)]  # of triangles, two for each square of a cell
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    np.testing.assert_allclose(
        np.sort(sides, axis=1) / sides.min(), [[1, 1, np.sqrt(2)]] * len(corners), rtol=1e-3
    )
    np.testing.assert_allclose(np.ptp(vertices.reshape(-1, 3), axis=0), (0.4, 0.02, 0.4), atol=1e-6)
    longest = sides.argmax(axis=1)  # the two triangles of a square have their diagonal in common
    ends = [{tuple(c[k]), tuple(c[k - 1])} for c, k in zip(corners, longest, strict=True)]
    assert ends[::2] == ends[1::2]


def test_flat_and_other_spaces_are_drawn_thin_and_as_points(paper: Robot) -> None:
    from backends.viewers.scene import _add_space

    flat, scene = replace(anchor(paper), size=np.array([0.4, 0.0, 0.2])), Recorder()
    whole = load_workspace(paper)
    other = Sampled(whole)
    for space in (flat, whole, other):
        _add_space(scene, "space", space, 2.0)  # type: ignore[arg-type]
    box, hull, cloud = scene.asked
    np.testing.assert_allclose(box[1][2], [0.4, 2e-3, 0.2])
    for _, _, options in (box, hull):  # the arm is in no shadow of what is no body
        assert (options["cast_shadow"], options["receive_shadow"]) == (False, False)
    assert cloud[0] == "add_point_cloud"
    np.testing.assert_array_equal(cloud[1][1], other.drawn.astype(np.float32))
    assert 1000 <= len(other.drawn) <= 10_000
    assert 0.002 < cloud[2]["point_size"] < 0.05  # seen, and hardly on each other


class Sampled:  # of no known kind
    def __init__(self, inner: Workspace) -> None:
        self._inner = inner

    def sample(self, rng: np.random.Generator, num: int) -> np.ndarray:
        self.drawn = self._inner.sample(rng, num)
        return self.drawn


@pytest.mark.parametrize("name", ["paper", "bench-arm"])
def test_a_scene_has_a_title_below_and_lines_of_the_cables_size(name: str) -> None:
    """Lines are as thick as the cylinders of pictures; the title stands below the base."""
    from backends.viewers.scene import EngineScene

    scene, robot = Recorder(), load_robot(name)
    server: Any = SimpleNamespace(scene=scene)
    EngineScene(server, robot, "one", 2, anchor(robot))
    asked = {
        args[0].rpartition("/")[2]: (what, args, options) for what, args, options in scene.asked
    }
    assert all(args[0].startswith("/engine2") for _, args, _ in scene.asked)
    assert asked["engine2"][2]["show_axes"] is False
    title = asked["title"]
    assert title[1][1] == "one"
    x, y, below = title[2]["position"]
    assert (x, y) == (0, 0)
    assert -0.3 < (below + robot.top) / robot.arm_length < -0.1
    size = robot.arm_length / 2.4
    assert ruler(robot).size == pytest.approx(size)
    assert asked["cables"][2]["thickness"] == pytest.approx(2 * size * CABLE_RADIUS)
    assert asked["trail"][2]["thickness"] == pytest.approx(3 * size * CABLE_RADIUS)
    assert asked["target"][1][1] == pytest.approx(0.018 * size)
    assert (len(asked["trail"][1][2]), len(asked["target"][1][2])) == (3, 3)  # no opacity


def test_a_page_draws_each_moment_with_its_trail_and_its_slack(
    paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A trail begins anew with another target. The straight robot's cables are slack by the travel
    of their sliders."""
    from backends.viewers import page as room

    drawn: list[tuple[int, list[np.ndarray]]] = []

    class Scene:
        def __init__(self, _: Any, robot: Robot, title: str, number: int, debris: Any) -> None:
            assert (robot, title, debris) == (paper, "ab"[number], None)
            self.number, self.origin = number, np.zeros(3)

        def draw(self, *values: np.ndarray) -> None:
            drawn.append((self.number, [np.array(each) for each in values]))

    looks: list[int] = []
    monkeypatch.setattr(room, "EngineScene", Scene)
    monkeypatch.setattr(room, "look_at", lambda _, __, last: looks.append(last.number))
    moments, targets = [], [np.array([0.1, 0.0, 2.0]), np.array([0.2, 0.0, 2.0])]
    for n, target in enumerate([targets[0], targets[0], targets[1]]):
        engines = []
        for number in range(2):
            position = straight(paper, 1, travel=0.001 * n).position[0]
            position[0] = number + 0.1 * n
            engines.append(room.Moment(position, np.full(8, 1.0 * n), target))
        moments.append(engines)
    text = room.page(paper, ["a", "b"], moments, 0.5)
    assert text.lstrip().lower().startswith("<!doctype html>")
    assert [number for number, _ in drawn] == [0, 1] * 3
    assert looks == [1]  # from the first to the last
    tip = 0.3 + 2.4
    for (number, values), n in zip(drawn, [0, 0, 1, 1, 2, 2], strict=True):
        position, tension, slack, trail, target = values
        np.testing.assert_array_equal(position, moments[n][number].position)
        assert (tension == n).all()
        np.testing.assert_allclose(slack, 0.001 * n, atol=1e-12)
        since = [0, 0, 2][n]
        xs = [number + 0.1 * k for k in range(since, n + 1)]
        np.testing.assert_allclose(trail, [[x, 0, tip] for x in xs], atol=1e-12)
        np.testing.assert_array_equal(target, moments[n][number].target)


@pytest.mark.parametrize("name", ["paper", "hanging-arm", "bench-arm"])
def test_the_eye_sees_the_ends_of_all_robots(name: str, server: Any) -> None:
    """A page's field of view is about a radian; both ends are within it, and not far within."""
    from backends.viewers.scene import EngineScene, look_at
    from cdcsr.simulation.rotations import at_start

    robot = load_robot(name)
    scenes = [EngineScene(server, robot, "one", number) for number in range(3)]
    for last in (scenes[0], scenes[2]):
        look_at(server, robot, last)
        eye = np.array(server.initial_camera.position)
        gaze = np.array(server.initial_camera.look_at) - eye
        ends = [at_start(robot, [0, 0, z]) for z in (-robot.top, robot.top + robot.arm_length)]
        angles = []
        for scene in (scenes[0], last):
            for end in ends:
                toward = end + scene.origin - eye
                across = np.linalg.norm(np.cross(gaze, toward))
                angles.append(np.arctan2(across, gaze @ toward))
        assert max(angles) < 0.75
        assert max(angles) > 0.3
        # It stands before the row, a little above the middle and beside it.
        assert gaze[0] == -eye[0] < 0
        aside, down = np.arctan2(gaze[1], -gaze[0]), np.arctan2(-gaze[2], np.hypot(*gaze[:2]))
        assert 0.2 < aside < 0.5
        assert 0.15 < down < 0.35
        assert (eye + gaze)[2] == pytest.approx(ends[1][2] / 2)  # the middle of the arm
