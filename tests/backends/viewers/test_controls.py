"""The controls of the live view: ranges, numbers, plots, what pages change, and who drives."""

from __future__ import annotations

import asyncio
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from backends.contract_suite.states import running
from backends.viewers.disturbing import Disturbing
from backends.viewers.driving import HAND, Driving, Shown
from backends.viewers.session import Session
from cdcsr.envs.disturbances import Channel, Disturbances
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.ruler import ruler
from cdcsr.tasks.spaces import anchor
from controllers.feeds import StepByStep
from controllers.jacobian import JacobianController
from tests.backends.physics.test_servos import TENSION
from tests.support.controllers import Still
from tests.support.physics import with_parts

viser = pytest.importorskip("viser", reason="the extra `view` is not installed")


def controls_of(session: Session, server: Any) -> Any:
    from backends.viewers.controls import Controls

    return Controls(server, session, lambda do: do())


def from_page(element: Any, value: object) -> None:
    """Do what follows when a page sets a value."""
    event = SimpleNamespace(client=1, target=SimpleNamespace(value=value))
    asyncio.run(element._impl.update_cb[0](event))


def test_numbers_and_plots_are_in_their_units(paper: Robot, server: Any) -> None:
    """Distances are in [mm] and angles in [mrad]; the outcome of an episode is said."""
    episodes = [Shown(np.array([0.1, 0.0, 2.5]), success) for success in (True, False)]
    session = Session(paper, ["mujoco", "pybullet"], anchor(paper), [], episodes)
    controls = controls_of(session, server)
    session.driving.pull(0, -4.0)
    for _ in range(20):
        session.step()
    session.driving.chosen, session.note = 1, "a note"
    controls._show_numbers()
    states = [simulation.state() for simulation in session.simulations]
    tips = np.array([state.tip_position[0] for state in states])
    far, apart = np.linalg.norm(tips - session.target, axis=1), np.linalg.norm(tips[0] - tips[1])
    lines = controls._text.content.split("  \n")
    assert lines[0] == "0.0500 s, 0 updates/s"
    assert [line.partition("**")[2] for line in lines[1:3]] == [
        f"{1e3 * each:.1f} mm** to the target" for each in far
    ]
    assert lines[3:] == [f"tips: {1e3 * apart:.2f} mm apart", "episode 2: was missed", "**a note**"]
    distance, tension, base = controls._plot_values()
    assert [len(each) for each in (distance, tension, base)] == [1 + 2, 1 + 8, 1 + 4]
    for time, *_ in (distance, tension, base):
        np.testing.assert_allclose(time, 0.0025 * np.arange(21))
    np.testing.assert_allclose([each[-1] for each in distance[1:]], 1e3 * far)
    np.testing.assert_allclose([each[-1] for each in tension[1:]], states[0].cable_tension[0])
    turn = 2e3 * np.arccos(states[0].base_quaternion[0, 0])
    shown = [*1e3 * states[0].base_position[0], turn]
    np.testing.assert_allclose([each[-1] for each in base[1:]], shown, rtol=1e-5)
    assert turn > 0.01
    session.close()


def test_controls_have_the_ranges_of_the_session(paper: Robot, server: Any) -> None:
    """Cables from 0 to their full command; what is set by hand is not set back while it drives."""
    from backends.viewers.controls import _COLORS

    session = Session(paper, ["mujoco"], anchor(paper), [], [Shown(np.zeros(3), True)] * 3)
    sliders: dict[str, tuple[float, ...]] = {}
    slider = server.gui.add_slider
    server.gui.add_slider = lambda *given: sliders.update({given[0]: given[1:]}) or slider(*given)
    controls = controls_of(session, server)
    assert sliders["speed"] == (0.01, 4, 0.01, 0.2)
    most = session.disturbing.strongest
    assert sliders["force of a push [N]"] == pytest.approx((0, most, most / 100, most / 2))
    for pull in controls._pulls:
        assert (pull.min, pull.max, pull.value) == (0, 5, 0)
        assert pull.step == pytest.approx(5 / 200)
    assert (controls._episode.min, controls._episode.max, controls._episode.value) == (1, 3, 1)
    assert controls._handle.disable_rotations
    assert 0.05 * 2.4 < controls._handle.scale < 0.15 * 2.4
    assert (controls._seed.min, controls._seed.step, controls._seed.value) == (0, 1, 0)
    for name, slider in {**controls._plant, **controls._noise}.items():
        number = {**session.numbers, **session.disturbing.numbers}[name]
        found = slider.min, slider.max, slider.step, slider.value
        assert found == (number.low, number.high, number.step, number.start)
    plots: list[Any] = controls._plots
    series = [plot.series[1:] for plot in plots]
    assert [len(each) for each in series] == [len(plot.data) - 1 for plot in plots] == [1, 8, 4]
    assert [line["stroke"] for line in series[1]] == list(_COLORS)
    assert [line["label"] for line in series[1]] == [f"cable {n}" for n in range(1, 9)]
    assert [bool(plot.legend["show"]) for plot in plots] == [True, False, True]
    assert {len(values) for plot in plots for values in plot.data} == {1}
    assert {plot.scales["x"]["time"] for plot in plots} == {False}
    from_page(controls._episode, 3.0)
    assert (session.driving.chosen, controls._episode.value) == (2, 3)
    controls._next_target()
    assert (session.seed, controls._seed.value) == (1, 1)
    session.driving.command = np.full(8, -2.0)
    controls._show_numbers()  # after an episode began
    assert [pull.value for pull in controls._pulls] == [2.0] * 8
    session.driving.command = np.full(8, -1.0)
    controls._show_numbers()
    assert [pull.value for pull in controls._pulls] == [2.0] * 8
    session.close()


def test_numbers_and_plots_are_shown_now_and_then(
    paper: Robot, server: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numbers at most ten times a second, plots about three times; updates are those in which
    something changed, of which every other one is here."""
    from backends.viewers import controls as room

    now, session = 1.0, Session(paper, ["mujoco"], anchor(paper))
    monkeypatch.setattr(room, "time", SimpleNamespace(perf_counter=lambda: now))
    controls = controls_of(session, server)
    numbers, plots, rates = [], [], []
    inner, values = controls._show_numbers, controls._plot_values
    monkeypatch.setattr(controls, "_show_numbers", lambda: numbers.append(now) or inner())
    monkeypatch.setattr(controls, "_plot_values", lambda: plots.append(now) or values())
    for n in range(1, 321):
        now = 1 + n / 64
        controls.show(changed=n > 64 and n % 2 == 0)
        rates.append(controls._rate)
        if n == 64:
            assert len(plots) == 1  # the first time, though nothing has changed
    assert rates[::64] == [0, 0, 32, 32, 32]
    assert rates[63::64] == [0, 32, 32, 32, 32]
    assert min(np.diff([1.0, *numbers])) >= 0.1
    assert len(numbers) > 40
    assert min(np.diff([1.0, *plots])) >= 0.3
    assert 11 < len(plots) < 15
    shown = controls._text.content
    assert f"{controls._rate:.0f} updates/s" in shown
    assert "apart" not in shown
    drawn = len(plots)
    for n in range(321, 385):  # nothing changes: no plot is drawn again
        now = 1 + n / 64
        controls.show(changed=False)
    assert len(plots) <= drawn + 1
    for times in (numbers, plots):
        now = 2 * times[-1]  # after a long sleep
        controls.show(changed=True)
        assert times[-1] == now
    session.close()


def test_what_a_page_changes_is_shown_and_what_is_refused_goes_back(
    paper: Robot, server: Any
) -> None:
    driver = StepByStep(Still(), paper)
    session = Session(paper, ["mujoco"], anchor(paper), [driver])
    controls = controls_of(session, server)
    from_page(controls._seed, 5.0)
    with pytest.raises(CdcsrError, match="whole number"):
        from_page(controls._seed, 0.5)
    assert (session.seed, controls._seed.value) == (5, 5)
    controls._show_numbers()
    np.testing.assert_allclose(controls._handle.position, session.target)
    with pytest.raises(CdcsrError, match="within 100 m"):
        controls._drag(np.array([0.0, 0.0, 1e3]))
    np.testing.assert_allclose(controls._handle.position, session.target)
    assert controls._play.label == "Play"
    controls._turn()
    controls._show_numbers()
    assert (session.playing, controls._play.label) == (True, "Pause")
    from_page(controls._pulls[2], 1.5)
    assert session.driving.command.tolist() == [0, 0, -1.5, 0, 0, 0, 0, 0]
    session.driving.choose("still")
    session.driving.command = np.full(8, -2.0)
    controls._show_numbers()  # what a controller does
    assert controls._driver.value == "still"
    assert [pull.value for pull in controls._pulls] == [2.0] * 8
    session.driving.choose(HAND)
    controls._reset()
    controls._show_numbers()
    assert [pull.value for pull in controls._pulls] == [0.0] * 8
    sliders = {**controls._plant, **controls._noise}
    for name, slider in sliders.items():
        from_page(slider, slider.max)
        slider.value = slider.max
        assert {**session.plant, **session.disturbing.noise}[name] == slider.max
    controls._restore_plant()
    controls._clear_noise()
    shown = {**session.plant, **session.disturbing.noise}
    for name, number in {**session.numbers, **session.disturbing.numbers}.items():
        assert sliders[name].value == shown[name] == number.start
    session.close()


def test_a_servo_that_is_told_a_tension_pulls_by_a_positive_number(server: Any) -> None:
    robot = with_parts(load_robot("planar-single"), servo=TENSION)
    session = Session(robot, ["mujoco"], anchor(robot))
    controls = controls_of(session, server)
    assert [pull.max for pull in controls._pulls] == [250.0] * 4
    from_page(controls._pulls[1], 40.0)
    assert session.driving.command.tolist() == [0, 40, 0, 0]
    session.close()


def test_failures_are_walked_through_in_a_circle(paper: Robot) -> None:
    """Without recordings the first controller drives an episode that is shown."""
    place = np.array([0.1, 0.0, 2.4])
    episodes = [
        Shown(place + 0.01 * n, success) for n, success in enumerate((False, True, False, True))
    ]
    drivers = [StepByStep(Still(), paper), StepByStep(JacobianController(paper), paper)]
    driving = Driving(paper, drivers, episodes)
    assert driving.names == [HAND, "still", "jacobian"]
    seen = []
    for _ in range(3):
        number = driving.next_failure()
        np.testing.assert_array_equal(driving.show(number), episodes[number].target)
        seen.append(number)
    assert seen == [2, 0, 2]
    assert driving.name == "still"
    driving.choose("jacobian")
    driving.show(1)
    assert driving.next_failure() == 2
    assert driving.name == "jacobian"  # who drives goes on
    driving.pull(7, -5.0)
    driving.pull(0, 0.0)
    assert driving.command.tolist() == [0, *[0] * 6, -5]
    for number in (-1, 4):
        with pytest.raises(CdcsrError, match="there are 4"):
            driving.show(number)
    with pytest.raises(CdcsrError, match="no cable 0"):
        driving.pull(-1, 0.0)
    with pytest.raises(CdcsrError, match=r"to 0; found 0\.01"):
        driving.pull(0, 0.01)


def test_a_command_is_held_for_the_rest_of_its_action(paper: Robot) -> None:
    """The number of steps for which nothing changes: of a recording and a controller those that
    its action has left; of the hand no limit, but an action where there is noise."""
    quiet, random = (
        Channel(Disturbances(action_noise=noise), np.random.default_rng(0)) for noise in (0.0, 0.1)
    )
    recorded = -np.arange(24.0).reshape(3, 8) / 10
    driver, target = StepByStep(Still(), paper), np.array([0.1, 0.0, 2.4])
    driving = Driving(paper, [driver], [Shown(target, True, recorded, 4)])
    driving.show(0)
    with running(paper, "mujoco") as simulation:
        driving.begin(simulation, 5)
        for step, row, left in ((5, 0, 4), (8, 0, 1), (9, 1, 4), (15, 2, 2), (40, 2, 1)):
            assert driving.next_command(step, target, quiet) == left
            np.testing.assert_array_equal(driving.arriving, recorded[row])
        noise = []
        for step in (9, 12, 13):  # drawn once for each action
            driving.next_command(step, target, random)
            noise.append(driving.arriving - recorded[(step - 5) // 4])
        np.testing.assert_allclose(noise[1], noise[0])
        assert np.abs(noise[2] - noise[1]).max() > 0.01
        driving.choose("still")
        driving.begin(simulation, 3)
        skip = driver.frame_skip
        assert [driving.next_command(3 + n, target, quiet) for n in range(3)] == [
            skip - n % skip for n in range(3)
        ]
    driving = Driving(paper, [], [Shown(target, True, recorded)])  # one step for each
    driving.show(0)
    for step, row in ((0, 0), (1, 1), (2, 2), (3, 2)):
        assert driving.next_command(step, target, quiet) == 1
        np.testing.assert_array_equal(driving.arriving, recorded[row])
    driving.choose(HAND)
    assert driving.next_command(0, target, quiet) == 0
    assert driving.next_command(0, target, random) == ruler(paper).frame_skip


def test_pushes_fit_the_robot() -> None:
    """A cable of the bench arm pulls with 0.25 m x 0.125 N/m at 1 mm from its axis."""
    bench = load_robot("bench-arm")
    strongest = 2 * 0.25 * 0.125 * 0.001 / 0.12
    assert Disturbing(bench, []).strongest == pytest.approx(strongest, rel=2e-3)
    disturbing = Disturbing(bench.model_copy(update={"time_step": 1.0}), [])
    disturbing.push("+x")
    assert disturbing.hold == 1
    disturbing.set_force(0.0)
    disturbing.set_force(disturbing.strongest)
    with pytest.raises(CdcsrError, match="from 0 to"):
        disturbing.set_force(-1e-6)
    assert disturbing.force == disturbing.strongest


def test_numbers_from_a_page_must_be_whole_ones() -> None:
    from backends.viewers.controls import _whole

    for number in (-3.0, 0.0, 1.0, 2.0, 2.0**53 - 1):
        assert _whole(number) == number
    for number in (0.5, -1.5, math.nan, math.inf, 2.0**53, -(2.0**53)):
        with pytest.raises(CdcsrError, match="whole number is needed"):
            _whole(number)
