"""The session of the live view: time, driving, plants and episodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from backends.contract_suite.states import running
from backends.viewers.disturbing import DIRECTIONS
from backends.viewers.driving import HAND, RECORDING, Shown
from backends.viewers.session import Session
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.ruler import answer_time
from cdcsr.simulation.plant import Parameters
from cdcsr.simulation.state import State
from cdcsr.tasks.spaces import anchor
from controllers.controller import Target
from controllers.demonstrations import record
from controllers.feeds import StepByStep
from controllers.jacobian import JacobianController
from tests.support.controllers import Still

STEP = 0.0025


@pytest.fixture
def session(paper: Robot) -> Iterator[Session]:
    drivers = [StepByStep(JacobianController(paper), paper), StepByStep(Still(), paper)]
    made = Session(paper, ["mujoco", "pybullet"], anchor(paper), drivers)
    yield made
    made.close()


def test_all_engines_get_the_command_of_the_hand(paper: Robot, session: Session) -> None:
    session.driving.pull(1, -5.0)
    session.playing = True
    assert session.advance(0.5)  # at a speed of 0.2: 0.1 s, 40 steps
    command = np.zeros((1, paper.num_cables))
    command[0, 1] = -5.0
    for number, engine in enumerate(session.engines):
        with running(paper, engine) as alone:
            alone.step(command, 40)
            expected = alone.state().tip_position[0]
        np.testing.assert_array_equal(session.history[-1].tip[number], expected)
        assert np.linalg.norm(expected - session.history[0].tip[number]) > 1e-4
    tips = session.history[-1].tip
    assert session.apart == pytest.approx(np.linalg.norm(tips[0] - tips[1]))


def test_ranges_have_the_size_and_the_pace_of_the_robot() -> None:
    bench, paper = load_robot("bench-arm"), load_robot("paper")
    session = Session(bench, ["mujoco"], anchor(bench))
    pace = answer_time(bench) / answer_time(paper)
    assert session.speed == pytest.approx(0.2 * pace, rel=0.05)
    assert session.speed == float(f"{session.speed:.1e}")  # a round number
    assert session.numbers["rest_length_offset"][1:4] == (-0.5, 0.5, 0.025)
    assert session.disturbing.numbers["base_noise"][1:4] == (0, 10, 0.25)
    with pytest.raises(CdcsrError, match=r"from -0\.5 to 0\.5; found 10"):
        session.set_plant("rest_length_offset", 10.0)
    with pytest.raises(CdcsrError, match="from 0 to 10; found 200"):
        session.disturbing.set_noise("base_noise", 200.0)
    with pytest.raises(CdcsrError, match="within 5 m of zero"):
        session.move_target(np.array([0.0, 0.0, 5.1]))
    session.move_target(np.array([-5.0, 0.0, 5.0]))
    assert session.disturbing.hold == 0
    session.disturbing.set_noise("action_noise", 0.2)  # of a range of 0.25 m
    found = [session.disturbing.channel.command(np.zeros((1, 4))) for _ in range(200)]
    assert np.std(found) == pytest.approx(0.2 * 0.25, rel=0.15)
    assert session.disturbing.force == session.disturbing.strongest / 2
    session.disturbing.push("+x")
    assert session.disturbing.hold == pytest.approx(0.05 * pace / bench.time_step, abs=0.5)
    session.close()
    with pytest.raises(CdcsrError, match="closed"):
        session.simulations[0].state()


def test_time_passes_only_while_playing_and_as_fast_as_asked(session: Session) -> None:
    assert not session.advance(1.0)
    assert session.time == 0
    session.playing = True
    for _ in range(10):  # 0.5 steps each: none may be lost
        session.advance(0.5 * STEP / 0.2)
    assert session.steps == 5
    session.speed = 1.0
    session.advance(4 * STEP)
    assert session.time == pytest.approx(9 * STEP)
    session.step()
    assert session.steps == 10
    assert not session.advance(1.0)  # a single step pauses
    session.playing = True
    moments = len(session.history)
    assert not session.advance(1.0, budget=0.0)  # no time for the engines
    assert len(session.history) == moments
    for speed in (0.01, 4.0):
        session.speed = speed
        assert session.speed == speed
    for _ in range(500):
        session.step()
    assert len(session.history) == 400
    assert session.history[-1].time == session.time


def test_a_controller_follows_the_target_that_is_dragged(session: Session) -> None:
    session.drive("jacobian")
    session.playing, session.speed = True, 1.0
    session.advance(0.6)
    assert (session.history[-1].distance < 0.03).all()
    session.move_target(session.target + np.array([0.0, 0.08, 0.0]))
    session.advance(STEP)
    assert (session.history[-1].distance > 0.05).all()
    session.advance(0.6)
    assert (session.history[-1].distance < 0.03).all()
    session.driving.pull(0, -0.1)
    assert session.driving.name == HAND


def test_a_recording_is_repeated_and_failures_are_found(paper: Robot) -> None:
    env = TaskVectorEnv(2, paper, task="reach", frame_skip=2, autoreset_mode="Disabled")
    episodes, *_ = record(JacobianController(paper), env, 2, seed=3)
    env.close()
    shown = [Shown(e.target, n == 0, e.actions, 2) for n, e in enumerate(episodes)]
    session = Session(paper, ["mujoco"], anchor(paper), [], shown)
    assert session.driving.name == RECORDING
    session.show(session.driving.next_failure())
    assert session.driving.chosen == 1
    session.playing, session.speed = True, 1.0
    session.advance(2 * STEP * episodes[1].length)
    tip = episodes[1].observations[-1, :3]
    np.testing.assert_allclose(session.history[-1].tip[0], tip, atol=1e-12)
    np.testing.assert_array_equal(session.target, episodes[1].target)
    with pytest.raises(CdcsrError, match="no episode 3"):
        session.show(2)
    session.close()


def test_the_plant_changes_in_all_engines(paper: Robot, session: Session) -> None:
    session.set_plant("link_mass", 2.0)
    session.set_plant("command_delay", 3.0)
    for simulation in session.simulations:
        with running(paper, simulation.engine) as heavy:
            heavy.set_parameters(None, Parameters(link_mass=2.0, command_delay=3))
            expected = heavy.dynamics().mass_matrix
            np.testing.assert_allclose(simulation.dynamics().mass_matrix, expected, rtol=1e-9)
    session.driving.pull(0, -1.0)
    for _ in range(3):
        session.step()
    assert session.views()[0].state.cable_travel[0, 0] == 0
    session.step()
    assert session.views()[0].state.cable_travel[0, 0] < 0
    session.new_target(2**63 - 1)
    for name in session.plant:
        session.step()
        session.set_plant(name, session.numbers[name].high)
        assert (session.steps == 0) == (name == "rest_length_offset")
    session.set_plant("rest_length_offset", 4.0)
    assert session.steps == 0
    for view in session.views():
        np.testing.assert_allclose(view.slack, 0.004, atol=1e-9)


def test_a_push_is_a_force_on_the_last_link_for_a_moment(paper: Robot, session: Session) -> None:
    """A cable pulls with 5 m x 50 N/m at 0.02 m from the axis of an arm of 2.4 m. The push lasts
    0.05 s, 20 steps."""
    servo = paper.servos[0]
    largest = 2 * servo.gain * servo.eta * 0.02 / 2.4
    assert session.disturbing.strongest == pytest.approx(largest, rel=1e-3)
    session.disturbing.set_force(0.3 * largest)
    session.disturbing.push("-y")
    session.playing, session.speed = True, 1.0
    session.advance(30 * STEP)
    for number, engine in enumerate(session.engines):
        with running(paper, engine) as alone:
            still = alone.state().tip_position[0, 1]
            alone.set_loads(None, -1, force=(0.0, -0.3 * largest, 0.0))
            alone.step(np.zeros((1, 8)), 20)
            alone.set_loads(None, -1)
            alone.step(np.zeros((1, 8)), 10)
            expected = alone.state().tip_position[0]
        np.testing.assert_allclose(session.history[-1].tip[number], expected, atol=1e-12)
        assert expected[1] < still - 1e-4
    session.disturbing.push("+x")
    session.reset()
    session.advance(30 * STEP)
    start, tips = session.history[0].tip, session.history[-1].tip
    np.testing.assert_allclose(tips, start, atol=1e-9)  # a push ends with the episode


def test_noise_of_commands_is_drawn_for_each_action_and_repeats(session: Session) -> None:
    """2 % of 5 m are 0.1 m; of 400 draws the spread is known to 4 %."""
    session.disturbing.set_noise("action_noise", 0.02)
    for cable in range(8):
        session.driving.pull(cable, -2.0)
    found = []
    for _ in range(50):
        session.step()
        found.append(session.driving.arriving + 2.0)
    assert np.std(found) == pytest.approx(0.1, rel=0.15)
    assert (session.driving.command == -2.0).all()
    session.disturbing.set_noise("action_noise", 0.02)  # begins anew
    session.step()
    np.testing.assert_array_equal(session.driving.arriving + 2.0, found[0])
    session.disturbing.set_noise("action_noise", 0.0)
    session.step()
    np.testing.assert_array_equal(session.driving.arriving, -2.0)


def test_a_policy_sees_what_the_channel_lets_through(paper: Robot) -> None:
    """Late observations are those of some actions ago, lost ones are those before."""
    watching = Watching()
    session = Session(paper, ["mujoco"], anchor(paper), [StepByStep(watching, paper)])
    session.disturbing.set_noise("observation_delay", 2.0)
    session.driving.pull(0, -3.0)  # so that something moves
    session.step()
    session.drive(watching.name)
    tips = [session.history[-1].tip[0]]
    for _ in range(5):
        session.step()
        tips.append(session.history[-1].tip[0])
    np.testing.assert_allclose(watching.seen, [tips[max(0, k - 2)] for k in range(5)], atol=1e-12)
    np.testing.assert_allclose(watching.times, STEP * np.arange(5), atol=1e-12)  # since it began
    watching.seen.clear()
    session.disturbing.set_noise("observation_delay", 0.0)
    session.disturbing.set_noise("packet_loss", 1.0)
    for _ in range(3):
        session.step()
    np.testing.assert_allclose(watching.seen, [tips[5]] * 3, atol=1e-12)  # only the first arrives
    session.close()


class Watching(Still):
    """It keeps the tips that it sees, and leaves all cables at half of their range."""

    def __init__(self) -> None:
        self.seen: list[np.ndarray] = []
        self.times: list[float] = []

    def act(self, state: State, target: Target, time: np.ndarray) -> np.ndarray:
        self.times.append(time.item())
        self.seen.append(state.tip_position[0].copy())
        return np.full((1, 8), -2.5)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.driving.pull(8, 0.0), "no cable 9; there are 8"),
        (lambda s: s.driving.pull(0, -5.1), "cable 1 lies from -5 m to 0"),
        (lambda s: s.driving.pull(0, np.nan), "from -5 m to 0"),
        (lambda s: s.drive("jacobi"), "Did you mean 'jacobian'"),
        (lambda s: s.new_target(-1), "from 0 on"),
        (lambda s: s.new_target(2**63), "from 0 on; found 9223372036854775808"),
        (lambda s: s.move_target(np.array([0, np.nan, 0])), "finite"),
        (lambda s: s.move_target(np.array([0, 0, 1e9])), "within 100 m"),
        (lambda s: setattr(s, "speed", np.inf), "from 0.01 to 4"),
        (lambda s: s.set_plant("base_mass", np.nan), "from 0.1 to 4"),
        (lambda s: s.set_plant("gravity", 1.0), "Unknown number of the plant"),
        (lambda s: s.disturbing.set_noise("packet_loss", 1.1), "from 0 to 1; found 1.1"),
        (lambda s: s.disturbing.set_noise("wind", 1.0), "Unknown disturbance"),
        (lambda s: s.disturbing.set_force(np.inf), "from 0 to"),
        (lambda s: s.disturbing.push("up"), "Unknown direction"),
        (lambda s: s.show(0), "no episode 1; there are 0"),
        (lambda s: s.driving.next_failure(), "None of the 0 episodes"),
    ],
)
def test_nonsense_is_refused_and_changes_nothing(
    session: Session, call: Callable[[Session], None], message: str
) -> None:
    before = session.plant, session.target.tolist(), session.driving.name, session.speed
    with pytest.raises(CdcsrError, match=message):
        call(session)
    after = session.plant, session.target.tolist(), session.driving.name, session.speed
    assert after == before


def test_divergence_stops_the_session_at_its_start(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    session.playing = True
    session.advance(0.1)

    def diverge(*_: object) -> None:
        raise Diverged("mujoco", 0, 0.1, "too fast")

    monkeypatch.setattr(session.simulations[1], "step", diverge)
    assert session.advance(0.1)  # so that it is shown
    assert not session.playing
    assert "diverged" in session.note
    assert session.steps == 0


def test_a_push_goes_where_its_name_says() -> None:
    for name, direction in DIRECTIONS.items():
        expected = np.zeros(3)
        expected["xyz".index(name[1])] = 1 if name[0] == "+" else -1
        assert direction == tuple(expected)
