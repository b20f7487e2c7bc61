"""The compiled MuJoCo model holds the numbers of the description; its variants that are timed."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from backends.mujoco.model import build_spec
from backends.mujoco.model_choices import Choice, cheapest, model_choices
from cdcsr.robot.colors import BACKGROUND
from cdcsr.robot.description import Robot
from cdcsr.simulation.rotations import rotation_matrix
from tests.support.physics import described_bodies


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
        assert model.actuator(f"servo_{c}").gainprm[0] == servo.gain
        assert model.actuator(f"servo_{c}").biasprm[:3].tolist() == [0, -servo.gain, 0]
    assert model.opt.timestep == robot.time_step
    assert not model.opt.gravity.any()


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


def test_the_background_is_that_of_all_pictures(paper: Robot) -> None:
    model = build_spec(paper).compile()
    (texture,) = range(model.ntex)
    assert model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_SKYBOX
    colors = model.tex_data[: model.tex_height[0] * model.tex_width[0] * 3].reshape(-1, 3)
    assert np.abs(colors.astype(int) - BACKGROUND).max() <= 1  # rounded
