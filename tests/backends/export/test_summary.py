"""The summary of a robot: its text, its random state, and a mass matrix that is another."""

from __future__ import annotations

import numpy as np
import pytest

from backends.export import summary
from backends.export.summary import Summary, show, summarize
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Snapshot
from tests.support.physics import changed, with_parts


def test_the_text_has_the_numbers_in_their_units() -> None:
    lengths = [(0, 0.5), (0, 0.4), (2, 1.25)]
    about: Summary = {
        "robot": "mine",
        "fingerprint": "abc",
        "bodies": 11,
        "degrees_of_freedom": 22,
        "total_mass": 12.5,
        "center_of_mass": [0.25, -0.5, 0.125],
        "tip": [1.0, 2.0, 3.5],
        "reach": 2.75,
        "cables": [
            {"name": f"cable_{c}", "segment": s, "rest_length": length}
            for c, (s, length) in enumerate(lengths)
        ],
        "backends": ["a", "b"],
        "time_step": 0.0025,
        "stable_step": 0.0123,
        "accuracy": 0.003,
        "accurate_step": {"a": 0.00125, "b": None},
        "mass_matrix_difference": {"b": {"straight": 1.5e-12, "bent": 2.5e-11}},
    }
    lines = [" ".join(line.split()) for line in show(about).splitlines()]
    assert lines == [
        "robot mine (abc)",
        "bodies 11",
        "degrees of freedom 22",
        "total mass 12.5 kg",
        "centre of mass (0.25, -0.5, 0.125) m, straight",
        "tip (1, 2, 3.5) m; straight, 2.75 m from the first joint",
        "cables 3, rest lengths in m:",
        "segment 0 0.5, 0.4",
        "segment 2 1.25",
        "time step 0.0025 s; no spring shakes below 0.012 s",
        "a has a mean error of 3 mm at 0.0013 s",
        "b has a mean error of 3 mm at the robot's own step, at which it diverges",
        "mass matrix b differs from a by 1.5e-12 straight, 2.5e-11 bent "
        "(largest relative difference)",
    ]


@pytest.fixture
def placed(monkeypatch: pytest.MonkeyPatch) -> dict[str, Snapshot]:
    """Make an engine `heavy` whose base weighs a thousandth more, and keep the states of all
    engines; no accurate step is looked for."""
    states: dict[str, Snapshot] = {}

    class Watched(MujocoSimulation):
        def set_snapshot(self, snapshot: Snapshot) -> None:
            states[self.name] = snapshot
            super().set_snapshot(snapshot)

        name = ""

    def make(robot: Robot, name: str, num: int) -> Watched:
        base = robot.model_dump()["base"]
        heavy = changed(robot, base=base | {"mass": 1.001 * base["mass"]})
        simulation = Watched(heavy if name == "heavy" else robot, num)
        simulation.robot, simulation.name = robot, name
        return simulation

    monkeypatch.setattr(summary, "make_simulation", make)
    monkeypatch.setattr(summary, "accurate_step", lambda *_: None)
    monkeypatch.setattr(summary, "engine_factory", lambda _: None)
    return states


def test_a_base_of_another_mass_shows_in_the_mass_matrix(
    paper: Robot, placed: dict[str, Snapshot]
) -> None:
    """Entries of the base's linear motion are the total mass, of which the base has 500 kg."""
    about = summarize(paper, ["light", "same", "heavy"])
    assert list(about["mass_matrix_difference"]) == ["same", "heavy"]
    assert about["mass_matrix_difference"]["same"] == {"straight": 0, "bent": 0}
    expected = 0.5 / (500 + 8 * 0.2 + 12 * 1.18)
    found = about["mass_matrix_difference"]["heavy"]
    assert found == {"straight": pytest.approx(expected), "bent": pytest.approx(expected)}
    assert summarize(paper, ["light"])["mass_matrix_difference"] == {}
    assert set(placed) == {"light", "same", "heavy"}


@pytest.mark.parametrize("limit", [1.5, 0.1])
def test_one_state_is_straight_and_one_is_turned_and_bent_within_its_limits(
    paper: Robot, placed: dict[str, Snapshot], limit: float
) -> None:
    summarize(with_parts(paper, joint={"limit": limit}), ["light", "same"])
    first, second = placed["light"].position, placed["same"].position
    np.testing.assert_array_equal(first, second)
    still = np.zeros(first.shape[1])
    still[3] = 1
    np.testing.assert_array_equal(first[0], still)
    turned, pulled, bent = np.split(first[1, 3:], [4, 12])
    assert np.linalg.norm(turned) == pytest.approx(1)
    assert np.abs(turned[1:]).min() > 0.01
    assert -0.05 < pulled.min() <= pulled.max() < 0
    assert 0.9 * min(limit, 0.3) < np.abs(bent).max() <= min(limit, 0.3)
    assert bent.min() < 0 < bent.max()


def test_a_robot_on_a_mount_has_no_freedom_of_the_base(
    paper: Robot, placed: dict[str, Snapshot]
) -> None:
    mounted = changed(paper, base=paper.model_dump()["base"] | {"mount": "fixed"})
    freedoms = [summarize(robot, ["light"])["degrees_of_freedom"] for robot in (paper, mounted)]
    assert freedoms == [6 + 8 + 24, 8 + 24]
    assert placed == {}
