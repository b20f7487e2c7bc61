"""What measures speed: that it measures what it says, not how fast this machine is."""

from __future__ import annotations

from pathlib import Path

import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from training.bench.growth_plot import growth_picture
from training.bench.peer_process import MissingPeer, Peer
from training.bench.scaling import Growth, exponent, resized


def test_exponent_of_a_power_law() -> None:
    assert exponent((1, 2, 4, 8), [3 * size**1.5 for size in (1, 2, 4, 8)]) == pytest.approx(1.5)


def test_resized_robots_have_the_links_asked_for(paper: Robot) -> None:
    robot = resized(paper, 4, 10)
    assert [segment.links for segment in robot.segments] == [3, 3, 2, 2]
    assert robot.num_cables == 16


def test_peer_does_as_much_as_it_is_asked() -> None:
    with Peer("print('hello')\nrun = lambda count: time.sleep(0.02 * count)") as peer:
        wall, own = peer.run(4)
        assert wall > 0.08
        assert own < wall / 2  # asleep


def test_peer_that_is_not_installed() -> None:
    with pytest.raises(MissingPeer, match="no_such_package"):
        Peer("import no_such_package")


def test_peer_that_fails() -> None:
    with (
        Peer("def run(count): raise ValueError(f'not {count}')") as peer,
        pytest.raises(CdcsrError, match="not 3"),
    ):
        peer.run(3)


def test_peer_without_an_interpreter(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match="cannot be started"):
        Peer("", str(tmp_path / "python"))


def test_growth_is_drawn(tmp_path: Path) -> None:
    sizes = {6: 10.0, 12: 20.0, 24: 40.0}
    growth_picture({"mujoco": Growth(sizes, sizes, 1.0, 1.0)}, tmp_path / "new" / "growth.png")
    assert (tmp_path / "new" / "growth.png").read_bytes().startswith(b"\x89PNG")
