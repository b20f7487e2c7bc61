"""What measures speed: that it measures what it says, not how fast this machine is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from backends.mujoco.model_choices import Choice, cheapest, model_choices
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


def test_faithful_variants_move_as_ours_does_and_others_do_not(paper: Robot) -> None:
    """One guide a link lets a cable cut the corner at each joint; leaving out what cannot change does not."""
    commands = np.repeat(
        -paper.servos[0].eta * np.random.default_rng(0).random((2, 4, paper.num_cables)), 10, axis=1
    )
    soft = "MuJoCo's own soft limits"
    bends, guides = (
        f"soft limits, {what}"
        for what in ("cables measured only where they bend", "one guide a link")
    )
    names = ("solver Newton", soft, bends, guides)
    found = {choice.name: choice for choice in model_choices(paper, commands, rounds=1, only=names)}
    assert list(found) == ["ours", *names]
    assert found["ours"].distance == 0
    assert found["solver Newton"].distance < 1e-3
    assert found["solver Newton"].faithful
    assert not found[soft].faithful
    assert found[bends].distance == pytest.approx(found[soft].distance, abs=1e-6)
    assert found[guides].distance > found[soft].distance + 1


def test_cheapest_is_among_the_faithful() -> None:
    choices = [
        Choice("ours", 50, 1, 0, True),
        Choice("wrong", 10, 0.2, 5, True),
        Choice("soft", 9, 0.1, 0, False),
    ]
    choices.append(Choice("lost", 9, 0.1, np.nan, True))
    assert cheapest(choices).name == "ours"
    assert cheapest([*choices, Choice("better", 40, 0.8, 0.01, True)]).name == "better"


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
