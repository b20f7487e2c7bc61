"""The engine `mujoco-stock` steps the exported model, with the differences that its docstring
names."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import mujoco
import numpy as np
import pytest

from backends.contract_suite.states import commands_of, running, straight, stretch
from backends.mujoco.export import write_mjcf
from backends.mujoco.model import build_spec
from backends.mujoco.stock import MujocoStock, StockOptions
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.routing import routing
from cdcsr.simulation.engines import make_simulation
from tests.support.physics import changed, slack, with_parts

INTEGRATORS = {
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
}


@pytest.mark.parametrize("softness", ["mujoco", "description"])
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_step_is_mj_step_on_the_exported_file(
    integrator: str, softness: str, paper: Robot, tmp_path: Path
) -> None:
    """To the bit, over 200 steps in which every cable pulls."""
    write_mjcf(paper, tmp_path, {})
    spec = mujoco.MjSpec.from_file(str(tmp_path / "paper.xml"))
    spec.option.integrator = INTEGRATORS[integrator]
    if softness == "mujoco":
        hinges = [x for x in spec.joints if x.type == mujoco.mjtJoint.mjJNT_HINGE]
        for limited in [*hinges, *spec.tendons]:
            limited.solref_limit, limited.solimp_limit = (0.02, 1), (0.9, 0.95, 0.001, 0.5, 2)
    model = spec.compile()
    data, moved = mujoco.MjData(model), 0.0
    options = f"integrator={integrator},softness={softness}"
    simulation = make_simulation(paper, f"mujoco-stock:{options}", 2)
    for command in commands_of(paper, 200, 2):
        simulation.step(command)
        data.ctrl = command[1]
        mujoco.mj_step(model, data)
        np.testing.assert_array_equal(simulation.get_snapshot().position[1], data.qpos)
        moved = max(moved, float(np.abs(data.qpos).max()))
    simulation.close()
    assert moved > 0.05


def test_every_integrator_is_tested() -> None:
    assert get_args(StockOptions.model_fields["integrator"].annotation) == tuple(INTEGRATORS)


def test_the_exported_file_is_the_engine_with_the_descriptions_softness(
    paper: Robot, tmp_path: Path
) -> None:
    """Someone who loads the file and changes nothing steps this engine."""
    write_mjcf(paper, tmp_path, {})
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "paper.xml"))
    ours = MujocoStock(paper, options=StockOptions(softness="description")).model
    for name in ("jnt_solref", "jnt_solimp", "tendon_solref_lim", "tendon_solimp_lim"):
        np.testing.assert_array_equal(getattr(model, name), getattr(ours, name), err_msg=name)
    assert model.opt.integrator == ours.opt.integrator == int(INTEGRATORS["implicitfast"])


def test_linkages_are_as_soft_as_limits() -> None:
    robot = load_robot("paper-coupled")
    impedance, time = robot.mujoco.impedance, robot.constraint.recovery_time
    for softness, solref, most in (("mujoco", 0.02, 0.95), ("description", time, impedance)):
        options = StockOptions.model_validate({"softness": softness})
        model = MujocoStock(robot, options=options).model
        linked = model.eq_type == mujoco.mjtEq.mjEQ_JOINT
        assert linked.sum() == 20
        assert (model.eq_solref[linked] == [solref, 1.0]).all()
        assert (model.eq_solimp[linked, 1] == most).all()
        hinged = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        assert (model.jnt_solref[hinged] == [solref, 1.0]).all()


def test_a_slack_elastic_cable_has_no_tension(paper: Robot) -> None:
    """A taut one pulls by E A / L times its stretch at the beginning of the step, which is 0.1 mm,
    and by the nanometre by which cables of the model are shorter than described."""
    robot = with_parts(paper, cables={"axial_stiffness": 1e4})
    position = straight(robot)
    position.position[0, 7:15] = np.where(np.arange(8) % 2, 0.005, -1e-4)
    with running(robot, "mujoco-stock") as simulation:
        simulation.set_snapshot(position)
        simulation.step(np.zeros((1, 8)))
        tension = simulation.state().cable_tension[0]
    assert not tension[1::2].any()
    lengths = np.repeat([1.4, 2.6], 4)
    np.testing.assert_allclose(tension[::2], (1e4 / lengths * 1e-4)[::2], rtol=2e-5)


def test_a_pulled_cable_stretches_as_derived(paper: Robot) -> None:
    """All servos pull alike, so the arm stays straight, and its inverse inertia that of the
    start. The largest compliance of any cable bounds the others."""
    with running(paper, "mujoco-stock") as simulation:
        simulation.step(np.full((1, paper.num_cables), -1.0), 2000)
        tension, longer = simulation.state().cable_tension[0], -slack(paper, simulation)[0]
        allowed = stretch(simulation, tension.max())
    assert tension.min() > 45
    assert 0.8 * allowed < longer.max() < allowed
    with running(paper, "mujoco-stock:softness=description") as simulation:
        simulation.step(np.full((1, paper.num_cables), -1.0), 2000)
        assert -slack(paper, simulation).min() < 1e-2 * longer.max()


def test_the_time_step_that_elastic_cables_need_is_named_and_is_enough(paper: Robot) -> None:
    """Springs of MuJoCo's tendons are explicit. The named step has two digits; it is longer for
    heavier sliders and links."""
    elastic, named = with_parts(paper, cables={"axial_stiffness": 1e7}), []
    heavy = {"servo": {"mass": 20.0}, "link": {"mass": 118.0, "inertia": (1.6, 1.6, 0.037)}}
    for robot in (elastic, with_parts(elastic, **heavy)):
        with pytest.raises(CdcsrError, match="need a time_step of at most") as caught:
            make_simulation(robot, "mujoco-stock")
        named.append(float(str(caught.value).partition("at most ")[2].split()[0]))
    make_simulation(changed(elastic, time_step=0.95 * named[0]), "mujoco-stock").close()
    with pytest.raises(CdcsrError, match="explicit"):
        make_simulation(changed(elastic, time_step=1.05 * named[0]), "mujoco-stock")
    assert named[1] > 3 * named[0]
    # A spring k alone shakes in steps h of h^2 k / m = 4 and above; here cables share their links.
    stiffness = 1e7 / routing(elastic).rest_length
    alone = 2 / np.sqrt(stiffness * build_spec(elastic).compile().tendon_invweight0)
    assert 0.6 < named[0] / alone.min() < 0.8
