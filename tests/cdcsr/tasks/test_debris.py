"""Debris: targets are uniform by area on the part of the surface that the arm reaches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import stats

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.spaces import demonstration_space, make_space, own_file
from cdcsr.tasks.workspace_map import Workspace, load_workspace
from tests.support.distributions import LEAST_P, is_isotropic

LAB = load_robot("lab-arm")
"""A robot without a map: 0.5 m long."""
NUM = 20_000


def saved(mesh: trimesh.Trimesh, path: Path, center: tuple[float, ...] = (0.0, 0.0, 0.0)) -> str:
    mesh.copy().apply_translation(center).export(path)
    return str(path)


def draw(name: str, robot: Robot, seed: int = 0, num: int = NUM) -> np.ndarray:
    return make_space(name, robot).sample(np.random.default_rng(seed), num)


def test_targets_are_uniform_on_a_sphere(tmp_path: Path) -> None:
    center = LAB.workspace.center
    name = saved(trimesh.creation.icosphere(4, 0.05), tmp_path / "ball.stl", center)
    offset = draw(name, LAB) - center
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), 0.05, rtol=3e-3)
    assert is_isotropic(offset)
    np.testing.assert_array_equal(draw(name, LAB, 1, 9), draw(name, LAB, 1, 9))
    assert (draw(name, LAB, 1, 9) != draw(name, LAB, 2, 9)).any()


def test_every_side_of_a_box_gets_its_share_by_area(tmp_path: Path) -> None:
    """Sides of 6, 3 and 2 areas, twice; each has two triangles, in which targets are uniform."""
    center, size = LAB.workspace.center, np.array([0.02, 0.04, 0.06])
    name = saved(trimesh.creation.box(size), tmp_path / "box.ply", center)
    place = (draw(name, LAB) - center) / (size / 2)
    sides = np.abs(place).argmax(axis=1)
    expected = NUM * np.array([6, 3, 2]) / 11
    assert stats.chisquare(np.bincount(sides), expected).pvalue > LEAST_P
    np.testing.assert_allclose(np.abs(place).max(axis=1), 1.0, rtol=1e-6)
    for axis in range(3):
        inside = np.delete(place[sides == axis], axis, axis=1).ravel()
        assert stats.kstest((inside + 1) / 2, "uniform").pvalue > LEAST_P


def test_targets_lie_within_the_arms_length_and_outside_of_the_base(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A ball of radius r around the first joint of an arm of length L, shifted by d along z, is in
    reach up to the height (L^2 - r^2 - d^2) / (2 d) above its own centre; a ball's area grows with
    the height (Archimedes)."""
    length, radius, shift = LAB.arm_length, 0.4, 0.3
    height = (length**2 - radius**2 - shift**2) / (2 * shift)
    center = (0.0, 0.0, LAB.first_joint + shift)
    name = saved(trimesh.creation.icosphere(5, radius), tmp_path / "ball.stl", center)
    targets = draw(name, LAB)
    z = targets[:, 2] - center[2]
    half = np.array(LAB.base.size) / 2
    assert (np.abs(targets) > half).any(axis=1).all()
    assert z.max() == pytest.approx(height, abs=2e-3)
    share = make_space(name, LAB).share  # pyright: ignore[reportAttributeAccessIssue]
    below = (height + radius) / (2 * radius)
    assert 0.9 * below < share <= below + 0.02  # some of it is inside the base
    assert "within the arm's length of the first joint of 'lab-arm'" in capsys.readouterr().err


def test_a_shipped_map_says_what_is_in_reach(tmp_path: Path) -> None:
    """A long bar through the workspace: all targets lie in cells, and all cells' parts get some."""
    paper = load_robot("paper")
    name = saved(trimesh.creation.box((4.0, 0.01, 0.01)), tmp_path / "bar.stl", (0.0, 0.1, 2.4))
    whole, targets = load_workspace(paper), draw(name, paper, num=3000)
    cell = np.floor((targets - whole.origin) / whole.edges).astype(int)
    cells = {tuple(each) for each in whole.cells.tolist()}
    assert all(tuple(each) in cells for each in cell.tolist())
    row = np.floor((np.array([0.0, 0.1, 2.4]) - whole.origin) / whole.edges).astype(int)
    through = {x for x, y, z in cells if (y, z) == (row[1], row[2])}
    assert through <= set(cell[:, 0].tolist())
    assert not whole.holds(np.array([[0.0, 0.0, 0.0], [1e9, 0.0, 0.0]])).any()


def test_a_map_of_ones_own_says_what_is_in_reach(tmp_path: Path) -> None:
    """A map with one cell, whose corner is the centre of a ball, holds an eighth of the ball."""
    center = np.array(LAB.workspace.center)
    name = saved(trimesh.creation.icosphere(4, 0.05), tmp_path / "ball.stl", tuple(center))
    cells, edges = np.zeros((1, 3), np.int16), np.ones(3)
    made = Workspace(LAB.fingerprint, center, edges, cells, LAB.to_toml())
    made.save(tmp_path / "mine.npz")
    both = f"{tmp_path / 'mine.npz'}+{name}"
    assert (draw(both, LAB, num=500) >= center).all()
    assert not (draw(name, LAB, num=500) >= center).all()
    assert own_file(both, LAB) == own_file(name, LAB) | {"map": made.digest}
    assert demonstration_space(both) == both
    Workspace(LAB.fingerprint, center, edges * (1, 0, 1), cells, LAB.to_toml()).save(
        tmp_path / "mine.npz"
    )
    with pytest.raises(CdcsrError, match="is flat, and no debris is"):
        make_space(both, LAB)


@pytest.mark.parametrize("name", ["paper", "lab-arm"])
def test_debris_in_other_units_or_out_of_reach_says_what_to_do(tmp_path: Path, name: str) -> None:
    robot = load_robot(name)
    ball = trimesh.creation.icosphere(3, 0.1 * robot.arm_length)
    ball.apply_translation(robot.workspace.center)
    for scale, words in (
        (1e3, r"Less than 0\.1% .* extends from .* look like millimetres: export it in metres"),
        (1e-3, r"less than the threshold of .* export it in metres"),
    ):
        saved(ball.copy().apply_scale(scale), tmp_path / "other.stl")
        with pytest.raises(CdcsrError, match=words):
            make_space(str(tmp_path / "other.stl"), robot)
    saved(ball, tmp_path / "far.stl", (9.0, 0.0, 0.0))
    with pytest.raises(CdcsrError, match=r"move it near \(.*\) m, the middle of the robot's work"):
        make_space(str(tmp_path / "far.stl"), robot)


def test_a_record_holds_the_digest_of_the_debris(tmp_path: Path) -> None:
    """Two files of one body have one digest, another body has another one."""
    ball = trimesh.creation.icosphere(2, 0.05)
    first, again = (
        saved(ball, tmp_path / name, LAB.workspace.center) for name in ("a.ply", "b.ply")
    )
    other = saved(ball.copy().apply_scale(1.01), tmp_path / "c.ply", LAB.workspace.center)
    assert own_file(first, LAB) == own_file(again, LAB) != own_file(other, LAB)
    assert set(own_file(first, LAB)) == {"debris"}
    assert own_file("anchor", LAB) == {}
    assert demonstration_space(first) == first
