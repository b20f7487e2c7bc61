"""`cdcsr new-robot`: descriptions of new arms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot, parse_robot, shipped_robots
from cdcsr.robot.ruler import answer_time, ruler
from cdcsr.robot.sizing import NewRobot
from cdcsr.robot.stability import stable_step
from training.commands import new_robot as making
from training.commands.new_robot import new_robot

MADE: dict[str, dict[str, Any]] = {
    "bench-arm": {"length": 0.12},
    "disc-arm": {"length": 0.4, "links": 10},
    "lab-arm": {"length": 0.5, "base_mass": 50.0},
    "single-segment": {"length": 0.6, "segments": 1, "links": 8},
    "four-segment": {"length": 1.0, "segments": 4, "links": 4},
    "hanging-arm": {"length": 0.5, "mount": "fixed", "gravity": True},
}
"""The options that made shipped robots, as docs/your-own-robot.md lists them."""


def test_the_size_of_the_paper_gives_nearly_its_robot() -> None:
    """Only the links' inertia differs: here they are uniform cylinders."""
    mine = parse_robot(NewRobot("mine", 2.4, 2, 4, 6).text()).model_dump()
    paper = load_robot("paper").model_dump()
    for robot in (mine, paper):
        del robot["name"], robot["base"]["inertia"]
        for segment in robot["segments"]:
            del segment["link"]["inertia"]
    assert mine == paper


def test_a_new_robot_is_similar() -> None:
    """Lengths are divided by 4 and times by 2, so that accelerations stay; masses by 64."""
    large, small = (parse_robot(NewRobot("a", length, 2, 4, 6).text()) for length in (2.4, 0.6))
    assert small.arm_length == pytest.approx(large.arm_length / 4)
    assert small.total_mass == pytest.approx(large.total_mass / 64, rel=1e-3)
    assert answer_time(small) == pytest.approx(answer_time(large) / 2, rel=0.01)
    assert ruler(small).threshold == pytest.approx(0.03 / 4)
    assert small.workspace.center[2] == pytest.approx(large.workspace.center[2] / 4, rel=1e-3)


@pytest.mark.parametrize("length", [0.05, 0.5, 30.0])
@pytest.mark.parametrize("links", [1, 30])
def test_new_robots_have_a_stable_step(length: float, links: int) -> None:
    robot = parse_robot(NewRobot("a", length, 3, 5, links, 2.0, "fixed", True).text())
    assert robot.time_step <= stable_step(robot)
    assert (robot.num_links, robot.num_cables) == (3 * links, 15)
    assert robot.base.mount == "fixed"
    assert robot.workspace.center[2] < 0 > robot.gravity[2]  # it hangs


def test_command_writes_a_robot_and_never_overwrites(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(making, "_reached_in_spatter", lambda _: 400)
    new_robot("short", length=0.3)
    written = Path("short.toml").read_text("utf-8")
    robot = load_robot("short.toml")
    assert (robot.name, robot.num_links, robot.arm_length) == ("short", 12, pytest.approx(0.3))
    assert "9 of 9 reached" in capsys.readouterr().out
    with pytest.raises(CdcsrError, match="is there already, and is not overwritten"):
        new_robot("short")
    assert Path("short.toml").read_text("utf-8") == written


@pytest.mark.parametrize(
    ("replies", "radius"),
    [([380], 0.0625), ([379, 380], 0.04688), ([0, 379, 400], 0.03125), ([0, 0, 0, 380], 0.01562)],
)
def test_the_radius_of_spatter_shrinks_until_95_percent_are_reached(
    replies: list[int], radius: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The paper's 0.15 m on an arm of 2.4 m are 0.0625 m on one of 1 m."""
    monkeypatch.setattr(making, "_reached_corners", lambda _: 9)
    waiting, tried = list(replies), list[float]()

    def reached(robot: Robot) -> int:
        tried.append(ruler(robot).spatter)
        return waiting.pop(0)

    monkeypatch.setattr(making, "_reached_in_spatter", reached)
    path = tmp_path / "mine.toml"
    new_robot("mine", length=1.0, out=path)
    robot = load_robot(str(path))
    assert ruler(robot).spatter == radius
    assert tried == [0.0625, 0.04688, 0.03125, 0.01562][: len(replies)]
    assert ("[scale]" in path.read_text("utf-8")) == (len(replies) > 1)
    others = ruler(robot).__dict__ | {"spatter": None}
    whole = parse_robot(NewRobot("mine", 1.0, 2, 4, 6).text(), "mine")
    assert others == ruler(whole).__dict__ | {"spatter": None}


def test_a_robot_whose_spatter_is_never_reached_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(making, "_reached_corners", lambda _: 9)
    monkeypatch.setattr(making, "_reached_in_spatter", lambda _: 379)
    with pytest.raises(CdcsrError, match=r"Spatter with a radius of 0\.0156. m, so .* not"):
        new_robot("mine", length=1.0, out=tmp_path / "mine.toml")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("name", MADE)
def test_the_command_makes_the_shipped_robots(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"{name}.toml"
    new_robot(name, out=path, **MADE[name])
    assert load_robot(str(path)) == load_robot(name)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"length": 1e-3}, "length must"),
        ({"cables": 2}, "cables must"),
        ({"links": 0}, "links must"),
        ({"out": Path("arm.txt")}, r"a \.toml file, not 'arm\.txt'"),
    ],
)
def test_impossible_robots_are_errors(
    options: dict[str, object], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CdcsrError, match=message):
        new_robot("mine", **options)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", shipped_robots())
def test_shipped_robots_have_a_stable_step(name: str) -> None:
    robot = load_robot(name)
    assert robot.time_step <= stable_step(robot)
