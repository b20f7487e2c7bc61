"""Each model error changes the plant as its name says; policies act on it only on request."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.segments import Segment
from cdcsr.simulation.contract import State
from cdcsr.simulation.engines import backend_names, make_simulation
from controllers.controller import Conditions, Controller, Target
from training.config.seeds import VALIDATION_SEED
from training.measure.evaluation import evaluate
from training.measure.plant_axes import AXES, Axis, find_axes
from training.policy import Policy, find_policy

both = pytest.mark.parametrize("backend", backend_names())


@pytest.fixture(scope="module")
def policy() -> Policy:
    return find_policy("batd3-spatter-mujoco")


@both
@pytest.mark.parametrize(
    ("name", "level"), [("servo_gain", 0.1), ("slider_damping", 10.0), ("servo_gain", 1.0)]
)
def test_one_step_of_a_free_slider(backend: str, name: str, level: float, paper: Robot) -> None:
    """A cable that is let out is slack; its slider moves by itself: m v / h = k u - c v.

    The base is 2500 times as heavy. Bullet's damper sees the speed before the step, which is zero,
    unless the damper is stiff.
    """
    plant, servo, step, out = AXES[name].plant(paper, level), paper.servos[0], paper.time_step, 0.1
    gain, damping = servo.gain, servo.damping
    if name == "servo_gain":
        gain *= level
    else:
        damping *= level
    simulation = make_simulation(plant.robot, backend)
    if plant.parameters is not None:
        simulation.set_parameters(None, plant.parameters)
    simulation.reset()
    simulation.step(np.array([[out] + [0.0] * 7]))
    velocity = simulation.get_snapshot().velocity[0, 6]
    simulation.close()
    if backend.startswith("pybullet") and step * damping < 0.5 * servo.mass:
        damping = 0.0
    assert velocity == pytest.approx(step * gain * out / (servo.mass + step * damping), rel=1e-3)


class Clock(Controller):
    """Pulls nothing and notes the time."""

    name = "clock"
    privileged = True

    def __init__(self) -> None:
        self.times: list[float] = []
        self.time_step = 0.0

    def begin(self, conditions: Conditions) -> None:
        self.time_step = conditions.robot.time_step

    def act(self, state: State, target: Target, time: NDArray[np.float64]) -> NDArray[np.float64]:
        self.times.append(float(state.time[0]))
        return np.zeros_like(state.cable_travel)


def test_the_time_step_axis_keeps_the_control_period(paper: Robot) -> None:
    clock = Clock()
    result = evaluate(
        clock,
        paper,
        "mujoco",
        "anchor",
        1,
        VALIDATION_SEED,
        plant=AXES["time_step"].plant(paper, 0.25),
    )
    assert clock.time_step == paper.time_step / 4
    np.testing.assert_allclose(clock.times, np.arange(250) * paper.time_step, atol=1e-9)
    assert result.length.tolist() == [250]


@pytest.mark.parametrize("name", ["servo_gain", "command_delay", "observation_delay"])
def test_a_policy_fails_on_a_plant_that_is_far_off(name: str, policy: Policy, paper: Robot) -> None:
    level = {"servo_gain": 0.1, "command_delay": 100.0, "observation_delay": 100.0}[name]
    rates = [
        evaluate(
            policy, paper, "mujoco", "spatter", 4, VALIDATION_SEED, policy.centers, plant=plant
        ).rate
        for plant in (None, AXES[name].plant(paper, level))
    ]
    assert rates[0] == 1
    assert rates[1] < 0.5


def test_levels_have_the_size_of_the_robot() -> None:
    """The bench arm's cables run at a twentieth of the paper's distance from the axis, with servos
    weaker by 20^3; its sliders have 9.5 mm of room."""
    paper, bench = load_robot("paper"), load_robot("bench-arm")
    assert [axis.on(paper) for axis in AXES.values()] == list(AXES.values())
    own = {name: axis.on(bench) for name, axis in AXES.items()}
    assert own["rest_length_offset"].down == (-0.00025, -0.0005, -0.001, -0.0025, -0.005, -0.0095)
    assert own["cable_strain"].up[-1] == pytest.approx(8.0, rel=1e-2)
    assert own["link_mass"] == AXES["link_mass"]
    tight = bench.model_copy(update={"segments": (_with_slider_at(bench, 0.0035),)})
    assert AXES["rest_length_offset"].on(tight).down[-1] == -0.0025
    for level in own["rest_length_offset"].levels[1:]:
        plant = own["rest_length_offset"].plant(bench, level)
        assert plant.parameters is not None
        plant.parameters.plant(bench, 1)  # refuses none of them


def _with_slider_at(robot: Robot, offset: float) -> Segment:
    """Return the first segment with its sliders so far from the guides, in [m]."""
    segment = robot.segments[0]
    return segment.model_copy(
        update={"own_servo": segment.servo.model_copy(update={"offset": offset})}
    )


@pytest.mark.parametrize("axis", AXES.values(), ids=list(AXES))
def test_every_level_makes_a_plant(axis: Axis, paper: Robot) -> None:
    assert axis.levels[0] == axis.nominal
    assert list(axis.up) == sorted(axis.up)
    assert list(axis.down) == sorted(axis.down, reverse=True)
    for level in axis.levels:
        plant = axis.plant(paper, level)
        if plant.parameters is not None:
            plant.parameters.plant(paper, 1)
            plant.parameters.delay(1)
        assert (plant.robot is paper) == (level == axis.nominal or axis.name != "time_step")


@pytest.mark.parametrize(
    ("name", "level", "message"),
    [
        ("time_step", 2.0, "must be 1 over a whole number"),
        ("time_step", 0.3, "must be 1 over a whole number"),
        ("command_delay", 1.5, "must be a whole number of steps, not 1.5"),
    ],
)
def test_levels_that_are_none_are_refused(
    name: str, level: float, message: str, paper: Robot
) -> None:
    with pytest.raises(CdcsrError, match=message):
        AXES[name].plant(paper, level)


def test_an_unknown_axis_is_told() -> None:
    with pytest.raises(CdcsrError, match=r"Unknown axis 'link_mas'. Did you mean 'link_mass'\?"):
        find_axes(("link_mas",))
    with pytest.raises(CdcsrError, match="No axis is given"):
        find_axes(())
    assert [axis.name for axis in find_axes(("servo_gain", "link_mass"))] == [
        "link_mass",
        "servo_gain",
    ]
    assert find_axes(("all",)) == list(AXES.values())


def test_a_policy_acts_on_a_changed_robot_only_if_told_to(policy: Policy, paper: Robot) -> None:
    finer, finest = (AXES["time_step"].plant(paper, level) for level in (0.5, 0.25))
    arguments = ("mujoco", "spatter", 1, VALIDATION_SEED)
    with pytest.raises(CdcsrError, match="is for robot 'paper'"):
        evaluate(policy, finer.robot, *arguments)
    evaluate(policy, paper, *arguments, plant=finer)
    with pytest.raises(CdcsrError, match="is for robot 'paper'"):
        evaluate(policy, finer.robot, *arguments)  # it does not stay allowed
    with pytest.raises(CdcsrError, match="is for robot 'paper'"):
        evaluate(policy.on(finer.robot), finest.robot, *arguments)
    with pytest.raises(CdcsrError, match="it is for other links or cables"):
        policy.on(load_robot("planar-single"))
