"""The engine `warp` meets the contract in single precision and moves as `mujoco` does, on a CPU.

Kernels are compiled once for each robot, which takes about a minute; so most tests are slow ones.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from backends.contract_suite import EngineContract
from backends.contract_suite.states import (
    STRETCH,
    Make,
    assert_same,
    commands_of,
    random_parameters,
    straight,
)
from cdcsr.errors import CdcsrError, Diverged
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.routing import routing
from cdcsr.simulation.contract import Array, Simulation, State
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.plant import Parameters
from cdcsr.simulation.randomization import Randomization
from cdcsr.tasks.starts import Starts
from training.measure.trajectories import demonstrator_commands

pytest.importorskip("mujoco_warp", reason="the extra gpu is not installed")
from backends.mujoco.simulation import MujocoSimulation
from backends.warp.simulation import WarpSimulation

pytestmark = pytest.mark.slow
WARP = "warp:device=cpu"
NUM = 4


class TestWarp(EngineContract):
    backend = WARP
    copies = NUM

    @pytest.fixture(params=["paper", "planar-single"])
    def robot(self, request: pytest.FixtureRequest) -> Robot:
        """Return a robot with a free base and one with a fixed base."""
        return load_robot(request.param)


def far(one: Simulation, other: Simulation, commands: Array) -> float:
    """Return the largest distance between the tips of two simulations under the same commands, in
    [m]."""
    largest = 0.0
    for command in commands:
        one.step(command)
        other.step(command)
        apart = one.state().tip_position - other.state().tip_position
        largest = max(largest, float(np.linalg.norm(apart, axis=1).max()))
    return largest


def warp(robot: Robot) -> WarpSimulation:
    simulation = make_simulation(robot, WARP, NUM)
    assert isinstance(simulation, WarpSimulation)
    return simulation


@pytest.mark.parametrize("hold", [1, 5, 20, 50])
def test_it_moves_as_mujoco_does_under_random_commands(make: Make, paper: Robot, hold: int) -> None:
    """Within 0.1 mm over an episode, with cables that are no longer than those of `mujoco`."""
    one, other = make(WARP, paper, NUM), make("mujoco", paper, NUM)
    assert far(one, other, commands_of(paper, 250, NUM, seed=hold, hold=hold)) < 1e-4
    assert one.state().cable_tension.max() > 100
    assert (one.dynamics().cable_length - routing(paper).rest_length).max() < STRETCH


def test_it_moves_as_mujoco_does_along_demonstrations(make: Make, paper: Robot) -> None:
    commands = demonstrator_commands(paper, "mujoco", NUM, seed=0).values.swapaxes(0, 1)
    one, other = make(WARP, paper, NUM), make("mujoco", paper, NUM)
    assert far(one, other, commands) < 5e-5


@pytest.mark.parametrize("what", ["parameters", "elastic cables", "loads"])
def test_it_moves_as_mujoco_does_where_copies_differ(make: Make, paper: Robot, what: str) -> None:
    """And what makes them differ moves the tip much further."""
    one, other, plain = make(WARP, paper, NUM), make("mujoco", paper, NUM), make(WARP, paper, NUM)
    for simulation in (one, other):
        if what == "parameters":
            simulation.set_parameters([0, 2], random_parameters(paper, 2))
            simulation.reset()
        elif what == "elastic cables":
            simulation.set_parameters([0, 2], Parameters(cable_strain=1e-4))
        else:
            simulation.set_loads([0, 2], 5, force=(5, 0, 2), point=(0.03, 0, 0.1))
            simulation.set_loads([0, 2], -1, torque=(0, 1, 0.3), slot=1)
    commands = commands_of(paper, 100, NUM, hold=10)
    assert far(one, other, commands) < 1e-4
    for command in commands:
        plain.step(command)
    moved = np.linalg.norm(one.state().tip_position - plain.state().tip_position, axis=1)
    assert moved[[0, 2]].min() > 1e-3
    assert moved[[1, 3]].max() < 1e-4


def test_tensors_on_the_device_are_the_numbers_of_the_contract(paper: Robot) -> None:
    one, other = warp(paper), warp(paper)
    seen = one.device_state()
    for command in commands_of(paper, 20, NUM, hold=5):
        one.step_device(torch.tensor(command, dtype=torch.float32))
        other.step(command)
    expected = other.state()
    for field in dataclasses.fields(State):
        tensor = getattr(seen, field.name)  # taken before the steps: it is the engine's own memory
        np.testing.assert_allclose(
            tensor.numpy(), getattr(expected, field.name), rtol=0, atol=1e-6, err_msg=field.name
        )
    assert seen.cable_tension.max() > 1
    mask = torch.tensor([True, False, False, True])
    one.reset_device(mask)
    other.reset([0, 3])
    assert_same(one.state(), other.state())
    assert seen.time.tolist() == [0.0, *other.state().time[1:3], 0.0]


def test_a_fixed_base_stands_still_on_the_device() -> None:
    planar = load_robot("planar-single")
    one = warp(planar)
    seen = one.device_state()
    assert seen.base_position.shape == (NUM, 3)
    np.testing.assert_allclose(seen.base_position, one.state().base_position, atol=1e-7)
    assert not seen.base_velocity.any()
    assert seen.joint_angles.shape == (NUM, planar.num_hinges)


def test_a_copy_that_diverges_is_told_and_does_no_harm(paper: Robot) -> None:
    one, other = warp(paper), warp(paper)
    commands = commands_of(paper, 12, NUM, hold=5)
    for simulation in (one, other):
        for command in commands[:5]:
            simulation.step(command)
        start = simulation.get_snapshot()
        simulation.set_snapshot(dataclasses.replace(start, engine="by hand"))
    broken = one.get_snapshot()
    broken.velocity[2, -1] = 1e6
    one.set_snapshot(dataclasses.replace(broken, engine="by hand"))
    seen = one.device_state()
    for command in commands[5:10]:
        one.step_device(torch.tensor(command, dtype=torch.float32))
        other.step(command)
    assert seen.diverged.tolist() == [False, False, True, False]
    assert all(torch.isfinite(tensor).all() for tensor in seen)
    assert_same(one.state(), other.state(), copies=[0, 1, 3])
    for _ in range(2):  # until it is reset
        with pytest.raises(Diverged, match=r"copy 2 diverged at t = .*coordinate 37 moves at 1"):
            one.step(commands[10])
        other.step(commands[10])
    one.reset([2])
    one.step(commands[11])
    other.step(commands[11])
    assert_same(one.state(), other.state(), copies=[0, 1, 3])


def test_a_snapshot_continues_to_the_bit(paper: Robot) -> None:
    one, other = warp(paper), warp(paper)
    commands = commands_of(paper, 40, NUM, hold=5)
    for command in commands[:20]:
        one.step(command)
    other.step(commands[7])
    other.set_snapshot(one.get_snapshot())
    for command in commands[20:]:
        one.step(command)
        other.step(command)
    assert_same(one.state(), other.state())
    np.testing.assert_array_equal(one.get_snapshot().private, other.get_snapshot().private)


def test_what_the_device_cannot_do_is_refused(paper: Robot) -> None:
    one, command = warp(paper), torch.zeros(NUM, paper.num_cables)
    with pytest.raises(CdcsrError, match=r"shape \(4, 8\), be float32 and be on cpu; found"):
        one.step_device(command[:2])
    with pytest.raises(CdcsrError, match=r"shape \(4,\), be bool and be on cpu; found"):
        one.reset_device(torch.zeros(NUM, 1, dtype=torch.bool))
    one.set_parameters([1], Parameters(command_delay=2))
    with pytest.raises(CdcsrError, match="step_device delays no commands"):
        one.step_device(command)
    with pytest.raises(CdcsrError, match=r"option device: .*found 'gpu'"):
        make_simulation(paper, "warp:device=gpu")
    if not torch.cuda.is_available():
        with pytest.raises(CdcsrError, match="Warp finds no device cuda:7 here; there is cpu"):
            make_simulation(paper, "warp:device=cuda:7")
    with pytest.raises(CdcsrError, match="warp has no friction in guides"):
        one.set_parameters(None, Parameters(guide_friction=0.1))


def test_an_excess_is_taken_back_with_the_recovery_time(paper: Robot) -> None:
    """A cable that begins 2 mm too long gives back the share h / recovery time in a step."""
    one, start = warp(paper), straight(paper, NUM)
    start.position[:, 7] = -2e-3
    one.set_snapshot(start)
    one.step(np.zeros((NUM, paper.num_cables)))
    left = (one.dynamics().cable_length - routing(paper).rest_length)[:, 0]
    keep = 1 - paper.time_step / paper.constraint.recovery_time
    np.testing.assert_allclose(left, keep * 2e-3, rtol=1e-2)


def test_a_step_can_end_with_a_restart(paper: Robot) -> None:
    one, other = warp(paper), warp(paper)
    mask = torch.tensor([True, False, False, True])
    for number, command in enumerate(commands_of(paper, 12, NUM, hold=5)):
        tensor = torch.tensor(command, dtype=torch.float32)
        if number == 6:
            one.step_device(tensor, 2, mask)
            other.step_device(tensor, 2)
            other.reset_device(mask)
        else:
            one.step_device(tensor, 2)
            other.step_device(tensor, 2)
        for ours, theirs in zip(one.device_state(), other.device_state(), strict=True):
            assert torch.equal(ours, theirs)
    assert one.device_state().time.tolist() == pytest.approx([0.025, 0.06, 0.06, 0.025])


def test_copies_begin_on_the_device_as_they_do_on_the_host(paper: Robot) -> None:
    """In drawn states and with drawn plants, which move the tip to other places."""
    one, other, plain = warp(paper), warp(paper), warp(paper)
    states = Starts("anywhere", paper).draw(np.random.default_rng(1), NUM)
    plants = Randomization(paper, 1, 1.0, np.random.default_rng(2)).draw(6)
    del plants["command_delay"]
    fresh, row = torch.tensor([True, False, True, False]), torch.tensor([5, 0, 3, 0])
    ids, commands = np.flatnonzero(fresh), commands_of(paper, 30, NUM, hold=5)
    single = [part.astype(np.float32) for part in states[:2]]
    short = np.maximum(-plants["rest_length_offset"][row[ids]], 0)
    single[0][ids, 7:15] += short.astype(np.float32)
    one.set_plants(plants)
    one.set_start_device(*map(torch.from_numpy, single))
    for number, command in enumerate(commands):
        tensor = torch.tensor(command, dtype=torch.float32)
        if number == 7:
            one.change_plants(fresh, row)
        one.step_device(tensor, 1, fresh if number == 7 else None)
        other.step(command)
        plain.step(command)
        if number == 7:
            own = {name: rows[row[ids]] for name, rows in plants.items()}
            other.set_parameters(ids, Parameters(**own))
            for simulation in (other, plain):
                simulation.place(ids, *(part[ids].astype(np.float64) for part in single))
    assert_same(one.state(), other.state())
    moved = np.linalg.norm(other.state().tip_position - plain.state().tip_position, axis=1)
    assert moved[ids].min() > 1e-3


def test_a_start_of_another_shape_is_refused(paper: Robot) -> None:
    one, size = warp(paper), paper.num_coordinates
    position, velocity = torch.zeros(NUM, size + 1), torch.zeros(NUM, size)
    with pytest.raises(CdcsrError, match=r"start's velocity must have the shape \(4, 38\)"):
        one.set_start_device(position, position)
    with pytest.raises(CdcsrError, match=r"start's position must have the shape \(4, 39\)"):
        one.set_start_device(position[:3], velocity)
    with pytest.raises(
        CdcsrError, match=r"position must have the shape .*be float32 and be on cpu"
    ):
        one.set_start_device(position.double(), velocity)
    rough = {"guide_friction": np.full((2, paper.num_cables), 0.1)}
    with pytest.raises(CdcsrError, match="warp has no friction in guides"):
        one.set_plants(rough)


def test_a_copy_that_gets_lighter_gets_new_constants() -> None:
    """Each body carries the masses of its own copy that come after it."""
    one = warp(load_robot("planar-single"))
    one.set_parameters([1, 2], Parameters(link_mass=0.5))
    one.set_parameters([2], Parameters(link_mass=0.25))
    with one._copies.active():
        arrays = one._copies.plant_arrays()
        mass, after = (arrays[name].numpy() for name in ("body_mass", "body_subtreemass"))
    links = one._copies.host.body("link_0").id
    np.testing.assert_allclose(after[:, links], mass[:, links:].sum(axis=1), rtol=1e-5)
    assert after[2, links] < 0.3 * after[0, links]


@pytest.mark.parametrize("name", ["planar-single", "paper-coupled"])
def test_there_is_room_for_all_limits_at_once(make: Make, name: str) -> None:
    """All sliders and hinges are past their limits; coupled or not, they move as in `mujoco`."""
    robot = load_robot(name)
    start, cables = straight(robot, NUM), robot.num_cables
    start.position[:, 7 : 7 + cables] = robot.servos[0].stop + 1e-3
    start.position[:, 7 + cables :] = [hinge.upper + 1e-3 for hinge in robot.hinges]
    found = []
    for engine in (WARP, "mujoco"):
        simulation = make(engine, robot, NUM)
        simulation.set_snapshot(start)
        simulation.step(np.zeros((NUM, cables)))
        found.append(simulation.get_snapshot().velocity[:, 6:])
    np.testing.assert_allclose(found[0], found[1], atol=1e-3)
    assert found[0][:, cables:].max() < -0.05  # all hinges come back


def test_mujoco_draws_a_copy_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    planar, drawn, place = load_robot("planar-single"), [], np.array([0.1, 0.0, 1.4])
    one = warp(planar)
    for command in commands_of(planar, 20, NUM, hold=5):
        one.step(command)

    def render(self: MujocoSimulation, index: int, camera: str, target: Array | None) -> Array:
        drawn.append((self.state().tip_position[index], camera, target))
        return np.zeros(())

    monkeypatch.setattr(MujocoSimulation, "render", render)
    one.render(2, "top", place)
    one.render(1)
    tips, ((two, top, marked), (first, side, unmarked)) = one.state().tip_position, drawn
    assert np.linalg.norm(tips[1] - tips[2]) > 1e-4
    np.testing.assert_allclose([two, first], tips[[2, 1]], atol=1e-6)
    assert (top, marked.tolist(), side, unmarked) == ("top", place.tolist(), "side", None)
    assert WarpSimulation(planar).num == 1
