"""The compiled MuJoCo model holds the numbers of the description."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from backends.mujoco.model import build_spec
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
