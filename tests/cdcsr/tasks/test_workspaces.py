"""Maps of workspaces: cells between points, targets in the cells, and files."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.tasks.spaces import demonstration_space, make_space
from cdcsr.tasks.workspace_map import Workspace, cells_between

PAPER = load_robot("paper")


def two_cells() -> Workspace:
    cells = np.array([[0, 0, 0], [5, 0, -1]], dtype=np.int16)
    return Workspace(PAPER.fingerprint, np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.1, 0.1]), cells)


def test_targets_are_uniform_in_the_cells() -> None:
    targets = two_cells().sample(np.random.default_rng(0), 20_000)
    first = targets[:, 0] < 1.25
    assert abs(first.mean() - 0.5) < 0.015
    for inside, corner in ((first, [1, 2, 3]), (~first, [1.5, 2, 2.9])):
        place = (targets[inside] - corner) / 0.1
        assert place.min() >= -1e-9
        assert place.max() <= 1 + 1e-9
        np.testing.assert_allclose(place.mean(axis=0), 0.5, atol=0.02)
        np.testing.assert_allclose(place.var(axis=0), 1 / 12, atol=0.005)


def test_a_cell_needs_all_its_corners() -> None:
    """3 x 2 x 2 points make two cells. Without a point in the middle there is none, without an
    outer point there is one."""
    grid = np.stack(np.meshgrid(range(3), range(2), range(2), indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    cells, wide = cells_between(grid)
    assert wide.all()
    assert sorted(cells.tolist()) == [[0, 0, 0], [1, 0, 0]]
    assert len(cells_between(grid[(grid != [1, 0, 1]).any(axis=1)])[0]) == 0
    assert cells_between(grid[(grid != [2, 1, 1]).any(axis=1)])[0].tolist() == [[0, 0, 0]]


def test_the_hull_is_what_cells_share_with_no_other_cell() -> None:
    """Three cells of 1 x 2 x 3 m make an L of 3 * 22 m^2, less two faces each of 6 m^2 (across x)
    and of 3 m^2 (across y)."""
    cells = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.int16)
    map_ = Workspace("", np.array([4.0, 5.0, 6.0]), np.array([1.0, 2.0, 3.0]), cells)
    sides = map_.hull[:, 1::2] - map_.hull[:, :1]
    normal = np.cross(sides[:, 0], sides[:, 1])
    assert np.abs(normal).sum() == pytest.approx(3 * 22 - 2 * 6 - 2 * 3)
    lower, upper = map_.hull.min(axis=(0, 1)), map_.hull.max(axis=(0, 1))
    np.testing.assert_allclose([lower, upper], [[4, 5, 6], [6, 9, 9]])
    # One side of each face lies in a cell, the other does not.
    middle, step = map_.hull.mean(axis=1), 1e-3 * normal
    assert (map_.holds(middle + step) != map_.holds(middle - step)).all()
    flat = Workspace("", np.zeros(3), np.array([1.0, 0.0, 3.0]), cells[:2])
    assert np.abs(np.ptp(flat.hull, axis=1)).prod(axis=1).max() == 0
    np.testing.assert_allclose(np.ptp(flat.hull[:, :, [0, 2]], axis=1), [[1, 3]] * 4)


def test_points_in_a_plane_make_flat_cells() -> None:
    grid = np.stack(np.meshgrid(range(2), [4], range(3), indexing="ij"), axis=-1).reshape(-1, 3)
    cells, wide = cells_between(grid)
    assert wide.tolist() == [True, False, True]
    assert sorted(cells.tolist()) == [[0, 4, 0], [0, 4, 1]]
    assert len(cells_between(grid[:1])[0]) == 0  # one point makes no cell


def test_a_saved_map_is_a_space_of_its_own_robot_only(tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    two_cells().save(path)
    space = make_space(str(path), PAPER)
    assert space.name == str(path)  # what else would find the map again
    ours, theirs = (s.sample(np.random.default_rng(1), 9) for s in (space, two_cells()))
    np.testing.assert_array_equal(ours, theirs)
    with pytest.raises(CdcsrError, match=r"is of another robot .*cdcsr workspace three-cable"):
        make_space(str(path), load_robot("three-cable"))


def test_a_map_that_is_missing_or_damaged_names_the_command(tmp_path: Path) -> None:
    with pytest.raises(
        CdcsrError,
        match=r"no map of the workspace of robot 'other'; make one with `cdcsr workspace",
    ):
        make_space("workspace", PAPER.model_copy(update={"name": "other"}))
    with pytest.raises(CdcsrError, match=r"Cannot read the map .*none\.npz"):
        make_space(str(tmp_path / "none.npz"), PAPER)
    path = tmp_path / "map.npz"
    two_cells().save(path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(CdcsrError, match="is not a map of a workspace"):
        make_space(str(path), PAPER)


def _written(path: Path, **changes: object) -> None:
    """Write a map with other arrays than it should have; None leaves one out."""
    made = two_cells()
    texts = {"robot": made.robot, "description": "", "digest": made.digest}
    numbers = {"origin": made.origin, "edges": made.edges, "cells": made.cells}
    arrays = {**{k: np.array(v) for k, v in texts.items()}, **numbers, **changes}
    kept = {name: array for name, array in arrays.items() if array is not None}
    np.savez_compressed(path, **kept)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"origin": np.zeros(2)}, "its arrays have wrong shapes"),
        ({"edges": np.ones((3, 1))}, "its arrays have wrong shapes"),
        ({"cells": np.zeros(3, np.int16)}, "its arrays have wrong shapes"),
        ({"cells": np.zeros((2, 2), np.int16)}, "its arrays have wrong shapes"),
        ({"cells": np.zeros((0, 3), np.int16)}, "it has no cells"),
        ({"cells": np.zeros((2, 3))}, "it has no cells"),
        ({"origin": np.array([0.0, np.nan, 0.0])}, "it is not finite"),
        ({"edges": np.array([0.1, -0.1, 0.1])}, "it is not finite"),
        ({"edges": np.array([0.1, np.inf, 0.1])}, "it is not finite"),
        ({"origin": np.zeros(3)}, "its digest is"),
        ({"digest": None}, "it holds ['cells.npy', 'description.npy'"),
        ({"more": np.zeros(3)}, "it holds ['cells.npy', 'description.npy'"),
    ],
)
def test_a_map_of_other_content_is_refused(
    tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    _written(tmp_path / "map.npz", **changes)
    with pytest.raises(CdcsrError, match=re.escape(message)):
        make_space(str(tmp_path / "map.npz"), PAPER)


def test_a_map_of_an_older_version_is_read_with_a_note(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "map.npz"
    _written(path, description=None, digest=None)
    old = make_space(str(path), PAPER)
    found, ours = (space.sample(np.random.default_rng(1), 9) for space in (old, two_cells()))
    np.testing.assert_array_equal(found, ours)
    assert "is of an older version, without a digest" in capsys.readouterr().err
    two_cells().save(path)
    make_space(str(path), PAPER)
    assert capsys.readouterr().err == ""


def test_a_flat_map_has_flat_cells() -> None:
    made = Workspace("", np.array([1.0, 2.0, 3.0]), np.array([0.2, 0.0, 0.1]), two_cells().cells)
    np.testing.assert_allclose(made.centers, [[1.1, 2.0, 3.05], [2.1, 2.0, 2.95]])
    assert (made.sample(np.random.default_rng(0), 50)[:, 1] == 2.0).all()


def test_demonstrations_for_a_workspace_are_taken_in_the_whole_workspace() -> None:
    assert [demonstration_space(n) for n in ("anchor", "floating", "spatter")] == ["anchor"] * 3
    assert [demonstration_space(n) for n in ("workspace", "my.npz")] == ["workspace", "my.npz"]


def test_the_command_that_makes_a_map_can_be_pasted(tmp_path: Path) -> None:
    file = tmp_path / "my arm.toml"
    text = load_robot("planar-single").to_toml()
    file.write_text(text.replace('"planar-single"', '"c-lab"'))
    for robot, word in ((load_robot(file), str(file)), (load_robot("three-cable"), "three-cable")):
        with pytest.raises(CdcsrError) as caught:
            make_space(str(tmp_path / "none.npz"), robot)
        found = re.search("`(.*)`", str(caught.value))
        assert found is not None
        assert shlex.split(found[1])[:3] == ["cdcsr", "workspace", word]
