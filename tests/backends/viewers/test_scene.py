"""The live view and films show poses, colours, spaces and numbers, from where the eye is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from trimesh import creation

from backends.contract_suite.states import moving
from backends.mujoco.simulation import MujocoSimulation
from backends.viewers.driving import Shown
from backends.viewers.session import Session
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.meshes import visual_meshes
from cdcsr.tasks.debris import load_surface
from cdcsr.tasks.spaces import Balls, anchor
from cdcsr.tasks.workspace_map import load_workspace

viser = pytest.importorskip("viser", reason="the extra `view` is not installed")


@pytest.fixture
def server() -> Iterator[Any]:
    from backends.viewers.web import LocalServer

    made = LocalServer("127.0.0.1", 0, verbose=False)
    yield made
    made.stop()


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
    from backends.viewers.scene import LOOSE, PULLED, TAUT, EngineScene

    scene = EngineScene(server, paper, "one", 0)
    tension = np.array([0, 62.5, 250, 1000, 0, 250, 0, 0.0])
    slack = np.array([0, 0, 0, 0, 1e-4, 1e-4, 4e-5, -1.0])
    half = (np.array(TAUT) + PULLED) / 2
    expected = [TAUT, half, PULLED, PULLED, LOOSE, LOOSE, TAUT, TAUT]
    np.testing.assert_allclose(scene.cable_colors(tension, slack), expected)


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
    vertices = mesh[1][1][mesh[1][2].astype(int)]
    corners = hull[1][1][hull[1][2].astype(int)]  # of triangles, two for each square of a cell
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    np.testing.assert_allclose(
        np.sort(sides, axis=1) / sides.min(), [[1, 1, np.sqrt(2)]] * len(corners), rtol=1e-3
    )
    np.testing.assert_allclose(np.ptp(vertices.reshape(-1, 3), axis=0), (0.4, 0.02, 0.4), atol=1e-6)


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


def test_numbers_and_plots_are_in_their_units(paper: Robot, server: Any) -> None:
    """Distances are in [mm] and angles in [mrad]; the outcome of an episode is said."""
    from backends.viewers.controls import Controls

    episodes = [Shown(np.array([0.1, 0.0, 2.5]), success) for success in (True, False)]
    session = Session(paper, ["mujoco", "pybullet"], anchor(paper), [], episodes)
    controls = Controls(server, session, lambda do: do())
    session.driving.pull(0, -4.0)
    for _ in range(20):
        session.step()
    session.driving.chosen, session.note = 1, "a note"
    controls._show_numbers()
    states = [simulation.state() for simulation in session.simulations]
    tips = np.array([state.tip_position[0] for state in states])
    far, apart = np.linalg.norm(tips - session.target, axis=1), np.linalg.norm(tips[0] - tips[1])
    lines = controls._text.content.split("  \n")
    assert lines[0].startswith("0.0500 s, ")
    assert [line.partition("**")[2] for line in lines[1:3]] == [
        f"{1e3 * each:.1f} mm** to the target" for each in far
    ]
    assert lines[3:] == [f"tips: {1e3 * apart:.2f} mm apart", "episode 2: was missed", "**a note**"]
    distance, tension, base = controls._plot_values()
    assert [len(each) for each in (distance, tension, base)] == [1 + 2, 1 + 8, 1 + 4]
    for time, *_ in (distance, tension, base):
        np.testing.assert_allclose(time, 0.0025 * np.arange(21))
    np.testing.assert_allclose([each[-1] for each in distance[1:]], 1e3 * far)
    np.testing.assert_allclose([each[-1] for each in tension[1:]], states[0].cable_tension[0])
    turn = 2e3 * np.arccos(states[0].base_quaternion[0, 0])
    shown = [*1e3 * states[0].base_position[0], turn]
    np.testing.assert_allclose([each[-1] for each in base[1:]], shown, rtol=1e-3)
    assert turn > 0.01
    session.close()
