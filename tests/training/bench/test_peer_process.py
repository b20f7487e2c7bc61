"""A peer does as much as it is asked, and its errors are reported in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from training.bench import arms
from training.bench.peer_process import MissingPeer, Peer


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
