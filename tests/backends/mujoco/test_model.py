"""The compiled MuJoCo model holds the numbers of the description; its variants that are timed."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from backends.mujoco.active_cables import stepping_spec
from backends.mujoco.export import write_mjcf
from backends.mujoco.model import build_spec
from backends.mujoco.model_choices import Choice, cheapest, model_choices
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.robot.colors import BACKGROUND, segment_color
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.simulation.plant import Parameters
from cdcsr.simulation.rotations import rotation_matrix
from tests.support.physics import changed, described_bodies, with_parts


def test_bodies_have_the_described_mass_inertia_and_center(robot: Robot) -> None:
    model = build_spec(robot).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    expected = list(described_bodies(robot))
    assert model.nbody == 1 + len(expected)
    for name, mass, inertia, center in expected:
        body = model.body(name)
        assert body.mass == mass
        # The compiler may sort the moments and turn their frame.
        principal = rotation_matrix(body.iquat)
        np.testing.assert_allclose(
            principal @ np.diag(body.inertia) @ principal.T, np.diag(inertia), atol=1e-12
        )
        np.testing.assert_allclose(data.body(name).xipos, center, atol=1e-12)
    total = sum(mass for _, mass, _, _ in expected)
    np.testing.assert_allclose(
        data.subtree_com[0], sum(m * np.array(c) for _, m, _, c in expected) / total, atol=1e-12
    )


def test_center_of_mass_of_the_papers_robot(paper: Robot) -> None:
    """8 sliders of 0.2 kg are at z = 0.3 - 0.02 - 0.2; the middle of 12 links of 1.18 kg is at z =
    0.3 + 1.2."""
    model = build_spec(paper).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    total = 500 + 8 * 0.2 + 12 * 1.18
    assert model.body("base").subtreemass == pytest.approx(total)
    height = (8 * 0.2 * 0.08 + 12 * 1.18 * 1.5) / total
    np.testing.assert_allclose(data.subtree_com[0], [0, 0, height], atol=1e-12)


def test_joints_have_the_described_springs_dampers_and_limits(robot: Robot) -> None:
    model = build_spec(robot).compile()
    for j, (_, joint) in enumerate(robot.links):
        for axis in "xy":
            hinge = model.joint(f"hinge_{j}_{axis}")
            assert (hinge.stiffness[0], hinge.damping[0]) == (joint.stiffness, joint.damping)
            assert hinge.range.tolist() == [-joint.limit, joint.limit]
    for c, servo in enumerate(robot.servos):
        assert model.joint(f"slide_{c}").damping[0] == servo.damping
        assert model.actuator(f"servo_{c}").gainprm.tolist() == [servo.gain, *9 * [0]]
        assert model.actuator(f"servo_{c}").biasprm.tolist() == [0, -servo.gain, *8 * [0]]
    assert model.opt.timestep == robot.time_step
    assert not model.opt.gravity.any()


def test_limits_are_as_soft_as_described_and_equalities_are_rigid(paper: Robot) -> None:
    """A limit decays with the recovery time, critically damped, at the impedance that is given;
    MuJoCo's own shape of the impedance stays, and a slider has no limit on its way down."""
    options = paper.mujoco.model_copy(update={"impedance": 0.97})
    time = paper.constraint.recovery_time
    model = build_spec(paper.model_copy(update={"mujoco": options})).compile()
    hinged = model.jnt_type != mujoco.mjtJoint.mjJNT_FREE
    soft, shape = [time, 1.0], [0.97, 0.97, 0.001, 0.5, 2]
    assert (model.jnt_solref[hinged] == soft).all()
    assert (model.jnt_solimp[hinged] == shape).all()
    assert (model.tendon_solref_lim == soft).all()
    assert (model.tendon_solimp_lim == shape).all()
    assert model.jnt_limited[hinged].all()
    assert model.tendon_limited.all()
    assert not model.tendon_range[:, 0].any()
    sliders = model.jnt_range[model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE]
    assert sliders[:, 0].max() <= -1e6
    assert sliders[:, 1].tolist() == [servo.stop for servo in paper.servos]
    h = paper.time_step
    assert not model.eq_active0.any()
    assert (model.eq_solref == [-1 / h**2, -1 / h]).all()
    assert (model.eq_solimp == [0.9999, 0.9999, 0.001, 0.5, 2]).all()


def test_parts_look_as_large_as_described_and_weigh_and_touch_nothing(paper: Robot) -> None:
    model = build_spec(paper).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    assert (model.geom_group == 1).all()

    def drawn(name: str) -> int:
        """Return the geom of a body."""
        (geom,) = np.flatnonzero(model.geom_bodyid == model.body(name).id)
        return int(geom)

    assert model.geom_size[drawn("base")].tolist() == [size / 2 for size in paper.base.size]
    assert not data.geom_xpos[drawn("base")].any()
    height = paper.top
    for j, (link, _) in enumerate(paper.links):
        geom = drawn(f"link_{j}")
        assert model.geom_size[geom, :2].tolist() == [link.radius, link.length / 2]
        middle = [0, 0, height + link.length / 2]
        np.testing.assert_allclose(data.geom_xpos[geom], middle, atol=1e-12)
        color = np.divide(segment_color(j // 6), 255)
        np.testing.assert_allclose(model.geom_rgba[geom], color, atol=1e-7)
        height += link.length
    for c, servo in enumerate(paper.servos):
        ball, slider = drawn(f"slider_{c}"), data.body(f"slider_{c}")
        assert model.geom_size[ball, 0] == servo.radius
        np.testing.assert_array_equal(data.geom_xpos[ball], slider.xpos)
    np.testing.assert_allclose(data.site("tip").xpos, [0, 0, height], atol=1e-12)
    # Cables and guides are thin beside the links, which are 0.2 m long, and can be seen.
    assert 0 < model.tendon_width.min() <= model.tendon_width.max() < 0.01
    radius = model.site_size[:, 0]
    assert 0 < radius.min() <= radius.max() < 0.02
    # What a viewer looks at: the middle of base and arm, and as far as it reaches.
    np.testing.assert_allclose(model.stat.center, [0, 0, (paper.top + 2.4) / 2], atol=1e-12)
    oblong = changed(paper, base=paper.model_dump()["base"] | {"size": (0.9, 0.5, 0.6)})
    for robot, wide in ((paper, 0.6), (oblong, 0.9)):
        assert build_spec(robot).compile().stat.extent == pytest.approx(np.hypot(2.4, wide))


def test_tendons_are_as_long_as_the_cables_on_their_ways(paper: Robot) -> None:
    """A helix, a cable whose sheath keeps its length, and straight ones, on a bent arm."""
    data = paper.model_dump()
    helix = {"angle_deg": 10.0, "end_pitch_radius": 0.01, "twist_deg": 200.0}
    led = {"angle_deg": 130.0, "first_link": 2, "last_link": 9, "twist_deg": -50.0}
    data["segments"][0]["cables"] |= {"angles_deg": (10.0, 130.0), "paths": (helix, led)}
    robot, random = Robot.model_validate(data), np.random.default_rng(0)
    model = build_spec(robot).compile()
    bent = mujoco.MjData(model)
    travel, hinges = random.uniform(-0.1, 0.005, 6), random.uniform(-0.5, 0.5, 24)
    bent.qpos = np.concatenate([[0, 0, 0, 1, 0, 0, 0], travel, hinges])
    mujoco.mj_forward(model, bent)
    expected = cable_lengths(routing(robot), travel, hinges)
    np.testing.assert_allclose(bent.ten_length, expected, rtol=1e-12)


def test_guides_are_named_after_the_link_and_the_side_that_they_are_on(paper: Robot) -> None:
    model, named = build_spec(paper).compile(), 0
    for number, body in enumerate(model.site_bodyid):
        kind, *words = model.site(number).name.split("_")
        if kind == "guide":
            _, place, *side = words
            assert model.body(body).name == (f"link_{place}" if side else place)
            assert side in ([], ["high" if model.site_pos[number, 2] > 0.1 else "low"])
            named += 1
    assert named == 4 * (1 + 2 * 6) + 4 * (1 + 2 * 12)  # cables, guides on them


def test_coupled_hinges_follow_their_leaders_and_need_another_solver(paper: Robot) -> None:
    coupled = load_robot("paper-coupled")
    model = build_spec(coupled).compile()
    linked = model.eq_type == mujoco.mjtEq.mjEQ_JOINT
    pairs = np.stack([model.eq_obj1id, model.eq_obj2id], axis=1)[linked]
    first = 1 + coupled.num_cables  # the base's joint is the first
    followers = [n for n, leader in enumerate(coupled.leaders) if n != leader]
    assert (pairs - first).tolist() == [[n, coupled.leaders[n]] for n in followers]
    assert (model.eq_data[linked] == [0, 1, *(model.eq_data.shape[1] - 2) * [0]]).all()
    time, impedance = coupled.constraint.recovery_time, coupled.mujoco.impedance
    assert (model.eq_solref[linked] == [time, 1.0]).all()
    assert (model.eq_solimp[linked] == [impedance, impedance, 0.001, 0.5, 2]).all()
    assert model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
    assert build_spec(paper).compile().opt.solver == mujoco.mjtSolver.mjSOL_PGS
    stepped, h = stepping_spec(coupled).compile(), coupled.time_step
    assert stepped.eq_active0.all()
    assert (stepped.eq_solref == [-1 / h**2, -1 / h]).all()
    assert (stepped.eq_solimp[:, :2] == 0.9999).all()


def test_the_model_that_is_stepped_has_implicit_dampers_and_rigid_cables(paper: Robot) -> None:
    """Armatures are h C, and every cable is an equality that can be switched."""
    model, plain = stepping_spec(paper).compile(), build_spec(paper).compile()
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    assert model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    np.testing.assert_allclose(model.dof_armature, 0.0025 * plain.dof_damping, rtol=1e-12)
    assert not plain.dof_armature.any()
    assert not model.tendon_limited.any()
    assert model.eq_active0.all()
    assert len(model.eq_active0) == paper.num_cables
    assert plain.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    assert plain.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def test_faithful_variants_move_as_ours_does_and_others_do_not(paper: Robot) -> None:
    """With one guide a link, a cable cuts the corner at each joint. The pieces of a cable inside a
    link never change, so leaving them out changes nothing."""
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


def test_an_elastic_cable_is_a_spring_that_only_pulls(paper: Robot) -> None:
    """Its stiffness is E A over its length at rest."""
    model = build_spec(with_parts(paper, cables={"axial_stiffness": 3e3})).compile()
    rest = routing(paper).rest_length
    np.testing.assert_allclose(model.tendon_stiffness, 3e3 / rest, rtol=1e-12)
    np.testing.assert_allclose(model.tendon_lengthspring, [[0, r] for r in rest], rtol=1e-12)
    assert model.tendon_range[:, 1].min() >= 1e6


def test_a_file_holds_lengths_of_elastic_and_rigid_cables_to_the_last_digit(
    paper: Robot, tmp_path: Path
) -> None:
    """MuJoCo writes six digits, which would leave cables slack, or pulling, at the start."""
    odd = with_parts(paper, cables={"guide_offset": 0.0212345678})
    rest = routing(odd).rest_length
    for robot in (odd, with_parts(odd, cables={"axial_stiffness": 3e3})):
        write_mjcf(robot, tmp_path, {})
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "paper.xml"))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        elastic = robot is not odd
        found = model.tendon_lengthspring if elastic else model.tendon_range + 1e-9
        np.testing.assert_allclose(found[:, 1], rest, rtol=1e-12)
        np.testing.assert_allclose(data.ten_length, rest, rtol=1e-12)
        assert model.tendon_stiffness.any() == elastic


def test_an_elastic_cable_is_a_constraint_of_half_impedance(paper: Robot) -> None:
    """R = w (1 - d) / d, which is w for d = 1/2: it is c / h^2, where c = L / (E A), but never
    less than that of a cable that does not stretch."""
    simulation = MujocoSimulation(paper, 3)
    strain = np.array([1e-4, 0.0, 1e-13])
    simulation.set_parameters(None, Parameters(cable_strain=strain))
    model, cables = simulation.model, paper.num_cables
    names = ("tendon_invweight0", "eq_solimp", "eq_solref")
    weight, impedance, reference = (simulation.batch.expand(name)[:, :cables] for name in names)
    h, rest = paper.time_step, routing(paper).rest_length
    rigid, described = model.eq_solimp[0], model.tendon_invweight0
    np.testing.assert_allclose(weight[0], 1e-4 * rest / h**2, rtol=1e-9)
    np.testing.assert_allclose(weight[1], described, rtol=1e-12)
    np.testing.assert_allclose(weight[2], described * (1 - rigid[0]) / rigid[0], rtol=1e-3)
    assert (impedance[[0, 2]] == [0.5, 0.5, *rigid[2:]]).all()
    assert (impedance[1] == rigid).all()
    # MuJoCo multiplies stiffness by d; then a = -v / h - excess / h^2, as of rigid ones.
    np.testing.assert_allclose(reference[[0, 2]], np.full((2, cables, 2), [-0.5 / h**2, -0.5 / h]))
    assert (reference[1] == model.eq_solref[:cables]).all()


def test_the_light_is_white_and_falls_on_the_arm(paper: Robot) -> None:
    model = build_spec(paper).compile()
    ambient = model.vis.headlight.ambient
    assert 0.2 < ambient[0] == ambient[1] == ambient[2] < 0.6
    assert model.light_dir[0, 2] < -0.5
    aside = np.cross(model.light_pos[0] - [0, 0, paper.top + 1.2], model.light_dir[0])
    assert np.linalg.norm(aside) < 0.6


def test_the_background_is_that_of_all_pictures(paper: Robot) -> None:
    model = build_spec(paper).compile()
    (texture,) = range(model.ntex)
    assert model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_SKYBOX
    colors = model.tex_data[: model.tex_height[0] * model.tex_width[0] * 3].reshape(-1, 3)
    assert np.abs(colors.astype(int) - BACKGROUND).max() <= 1  # rounded
