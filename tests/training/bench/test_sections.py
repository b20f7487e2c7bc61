"""`cdcsr bench`: rows and their values, growth with size, and peers."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cdcsr.cli import main
from cdcsr.errors import CdcsrError
from cdcsr.plots import COLORS
from cdcsr.robot.description import Robot
from cdcsr.simulation.benchmarks import Measurement
from tests.support.pixels import count_pixels
from training.bench import arms, growth, sections
from training.bench.growth import Growth, draw_growth, fitted_exponent, resized
from training.bench.peer_process import MissingPeer, Peer


def test_an_unknown_section_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "grwth"]) == 2
    error = capsys.readouterr().err
    assert "Unknown section 'grwth'. Did you mean 'growth'?" in error
    assert all(name in error for name in ("memory", "arms", "trainer", "mujoco", "pybullet"))


def test_rows_are_printed_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [
        Measurement("a", 1.234, "what a is", "the floor", ("a line",), {"more": [1]}),
        Measurement("b", None, "what b is"),
    ]
    monkeypatch.setattr(sections, "all_sections", lambda *_: {"some": lambda: rows})
    sections.run_sections((), tmp_path / "out.json", None, None)
    assert json.loads((tmp_path / "out.json").read_text()) == {"a": 1.234, "more": [1], "b": None}
    assert capsys.readouterr().out.splitlines() == [
        "some:",
        "  1.23  what a is [the floor]",
        "        a line",
        "     -  what b is",
    ]


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


def test_a_peer_does_as_much_as_it_is_asked() -> None:
    with Peer("print('hello')\nrun = lambda count: time.sleep(0.02 * count)") as peer:
        wall, own = peer.run(4)
        assert wall > 0.08
        assert own < wall / 2  # it sleeps


def test_a_peer_that_is_not_installed_is_reported() -> None:
    with pytest.raises(MissingPeer, match="no_such_package"):
        Peer("import no_such_package")


def test_a_peer_that_fails_is_reported() -> None:
    with (
        Peer("def run(count): raise ValueError(f'not {count}')") as peer,
        pytest.raises(CdcsrError, match="not 3"),
    ):
        peer.run(3)


def test_a_peer_without_an_interpreter_is_reported(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match="cannot be started"):
        Peer("", str(tmp_path / "python"))


def test_an_arm_that_is_not_installed_has_a_row_that_says_so(
    paper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(*_: object) -> None:
        raise MissingPeer("no gym_softrobot")

    monkeypatch.setattr(arms, "Peer", missing)
    monkeypatch.setattr(arms, "step_seconds", lambda *_, **__: 1e-4)
    (row,) = arms.arms(paper, "python")
    assert row.value == pytest.approx(paper.time_step / 1e-4)
    assert len(row.lines) == 1 + 2 + len(arms.SOFTROBOT_ARMS)
    assert "10,000" in row.lines[1]
    assert "not measured: pip install gym-softrobot" in row.lines[-1]
