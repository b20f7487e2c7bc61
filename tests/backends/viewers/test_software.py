"""The software renderer draws the robot's pose and the targets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from backends.contract_suite.states import straight
from backends.viewers.software import Renderer
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.poses import tip_at_start
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
