"""How a step's cost grows: sizes, exponents and the figure."""

from __future__ import annotations

from pathlib import Path

import pytest

from cdcsr.plots import COLORS
from cdcsr.robot.description import Robot
from tests.support.pixels import count_pixels
from training.bench import growth
from training.bench.growth import Growth, draw_growth, fitted_exponent, resized


def test_the_exponent_of_a_power_law_is_found() -> None:
    sizes = (1, 2, 4, 8)
    assert fitted_exponent(sizes, [3 * size**1.5 for size in sizes]) == pytest.approx(1.5)


def test_resized_robots_have_the_links_asked_for(paper: Robot) -> None:
    robot = resized(paper, 4, 10)
    assert [segment.links for segment in robot.segments] == [3, 3, 2, 2]
    assert robot.num_cables == 16


@pytest.mark.usefixtures("third_engine")
def test_every_engine_has_an_exponent_in_links_and_in_segments(
    paper: Robot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def seconds(robot: Robot, engine: str) -> float:
        links = sum(segment.links for segment in robot.segments)
        return 1e-6 * links ** (2 if engine == "third" else 1) * len(robot.segments) ** 0.5

    monkeypatch.setattr(growth, "step_seconds", seconds)
    rows = {row.name: row for row in growth.growth(paper, tmp_path)}
    assert {name: row.value for name, row in rows.items()} == pytest.approx(
        {
            f"growth_{engine}_{what}": exponent
            for engine in ("mujoco", "pybullet", "third")
            for what, exponent in (("links", 1 + (engine == "third")), ("segments", 0.5))
        }
    )
    assert rows["growth_mujoco_links"].floor.startswith("6: 8 us, 12: 17 us")
    assert (tmp_path / "growth.png").is_file()


def test_growth_is_drawn_in_a_colour_for_each_engine(tmp_path: Path) -> None:
    sizes = {6: 10.0, 12: 20.0, 24: 40.0}
    path = tmp_path / "new" / "growth.png"
    draw_growth({name: Growth(sizes, sizes, 1.0, 1.0) for name in ("mujoco", "pybullet")}, path)
    assert all(count_pixels(path, color) > 100 for color in COLORS[:2])
