"""Operation spaces: targets lie inside and are uniform."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.tasks.spaces import (
    SPACES,
    WiderTargets,
    demonstration_targets,
    make_space,
    own_file,
    wider_targets,
)
from cdcsr.tasks.workspace_map import Workspace
from tests.support.distributions import LEAST_P, is_isotropic, is_uniform

PAPER = load_robot("paper")
CENTERS = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 20.0, 0.0]])
NUM = 30_000


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("name", SPACES)
def test_every_space_has_its_name_and_repeats_with_the_seed(name: str) -> None:
    space = make_space(name, PAPER)
    assert space.name == name
    assert space.sample(rng(), 5).shape == (5, 3)
    np.testing.assert_array_equal(space.sample(rng(), 5), space.sample(rng(), 5))
    assert (space.sample(rng(), 5) != space.sample(rng(1), 5)).any()


def test_anchor_fills_the_cuboid_evenly() -> None:
    """Its edges are 0.2 m around (0.20, 0.10, 2.45) m; the coordinates are independent."""
    targets = make_space("anchor", PAPER).sample(rng(), NUM)
    for axis, center in enumerate((0.2, 0.1, 2.45)):
        place = (targets[:, axis] - (center - 0.1)) / 0.2
        assert place.min() >= 0
        assert place.max() <= 1
        assert is_uniform(place)
    # Correlations of independent columns are within four standard errors, 4 / sqrt(NUM).
    assert np.abs(np.corrcoef(targets.T) - np.eye(3)).max() < 4 / np.sqrt(NUM)


def test_anchor_has_the_edges_of_the_workspace() -> None:
    robot = PAPER.model_copy(
        update={"workspace": PAPER.workspace.model_copy(update={"size": (0.4, 0.0, 0.1)})}
    )
    spread = np.ptp(make_space("anchor", robot).sample(rng(), NUM), axis=0)
    np.testing.assert_allclose(spread, [0.4, 0.0, 0.1], rtol=1e-3)


@pytest.mark.parametrize(("name", "radius"), [("floating", 0.01), ("spatter", 0.15)])
def test_floating_and_spatter_fill_balls_evenly(name: str, radius: float) -> None:
    targets = make_space(name, PAPER, CENTERS).sample(rng(), NUM)
    apart = targets[:, None] - CENTERS
    nearest = np.linalg.norm(apart, axis=2).argmin(axis=1)
    offset = apart[np.arange(NUM), nearest]
    distance = np.linalg.norm(offset, axis=1)
    assert distance.max() <= radius * (1 + 1e-9)
    # Volume: an eighth lies within half the radius, and (r / radius)^3 is uniform.
    inner = int((distance <= radius / 2).sum())
    assert stats.binomtest(inner, NUM, 1 / 8).pvalue > LEAST_P
    assert is_uniform((distance / radius) ** 3)
    assert is_isotropic(offset)
    assert stats.chisquare(np.bincount(nearest)).pvalue > LEAST_P


@pytest.mark.parametrize(
    ("axes", "dimensions"), [((True, True, True), 3), ((True, False, True), 2)]
)
def test_wider_targets_move_half_of_the_targets_evenly(
    axes: tuple[bool, bool, bool], dimensions: int
) -> None:
    inner = Points(np.array([[0.1, 0.2, 0.3]]))
    offset = WiderTargets(inner, 0.4, axes).sample(rng(), NUM) - inner.points
    distance = np.linalg.norm(offset, axis=1)
    moved = distance > 1e-12
    assert stats.binomtest(int(moved.sum()), NUM, 0.5).pvalue > LEAST_P
    # Within a ball (r / radius)^3 is uniform, within a disc its square.
    assert is_uniform((distance[moved] / 0.4) ** dimensions)
    assert np.array_equal(np.ptp(offset, axis=0) > 0, axes)
    if dimensions == 3:
        assert is_isotropic(offset[moved])
    else:
        assert is_uniform(np.arctan2(offset[moved, 2], offset[moved, 0]), -np.pi, np.pi)


def test_wider_targets_stay_in_the_plane_of_a_flat_workspace() -> None:
    inner, flat = Points(np.zeros((1, 3))), load_robot("planar-single")
    assert flat.workspace.size[1] == 0
    assert np.array_equal(
        np.ptp(wider_targets(inner, 0.2, flat).sample(rng(), 100), axis=0) > 0, [True, False, True]
    )
    nowhere = flat.workspace.model_copy(update={"size": (0.0, 0.0, 0.0)})
    point = flat.model_copy(update={"workspace": nowhere})
    for robot in (PAPER, point):
        assert (np.ptp(wider_targets(inner, 0.2, robot).sample(rng(), 100), axis=0) > 0.2).all()


@dataclass(frozen=True)
class Points:
    """A space of a few targets."""

    points: np.ndarray
    name: str = "points"

    def sample(self, rng: np.random.Generator, num: int) -> np.ndarray:
        return self.points[rng.integers(len(self.points), size=num)]


@pytest.mark.parametrize("name", ["floating", "spatter"])
def test_centers_are_by_default_the_demonstrations_of_seed_0(name: str) -> None:
    centers = demonstration_targets(PAPER, num=10, seed=0)
    assert centers.shape == (10, 3)
    np.testing.assert_array_equal(centers, make_space("anchor", PAPER).sample(rng(0), 10))
    ours, default = make_space(name, PAPER, centers), make_space(name, PAPER)
    np.testing.assert_array_equal(default.sample(rng(3), 50), ours.sample(rng(3), 50))
    assert (demonstration_targets(PAPER, seed=1) != centers).all()


def test_a_widened_space_keeps_its_name_and_a_given_map_is_told_by_its_digest(
    tmp_path: Path,
) -> None:
    assert wider_targets(make_space("spatter", PAPER), 0.1, PAPER).name == "spatter"
    assert own_file("anchor", PAPER) == own_file("workspace", PAPER) == {}
    cells = np.zeros((1, 3), np.int16)
    made = Workspace(PAPER.fingerprint, np.zeros(3), np.ones(3), cells, PAPER.to_toml())
    made.save(tmp_path / "mine.npz")
    assert own_file(str(tmp_path / "mine.npz"), PAPER) == {"map": made.digest}


def test_an_unknown_space_is_an_error() -> None:
    with pytest.raises(
        CdcsrError,
        match=r"'spater'\. Did you mean 'spatter'\? "
        r"Available: anchor, floating, spatter, workspace\.",
    ):
        make_space("spater", PAPER)
