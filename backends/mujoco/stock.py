"""The engine `mujoco-stock`: what someone gets who loads the exported MJCF into MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import mujoco

from backends.mujoco.active_cables import Limits
from backends.mujoco.model import INTEGRATORS, build_spec
from backends.mujoco.simulation import BatchSimulation
from cdcsr.simulation.contract import EngineOptions, Physics


class StockOptions(EngineOptions):
    """The options of `mujoco-stock`."""

    integrator: Literal["implicitfast", "implicit", "Euler", "RK4", "discrete"] = "implicitfast"
    """MuJoCo's integrator. discrete solves constraints and dampers together, in M + hC + h²K; the
    others solve constraints with the mass matrix M alone, and then move with dampers implicit (RK4:
    explicit)."""
    softness: Literal["mujoco", "description"] = "mujoco"
    """The softness of the limits of cables and hinges: MuJoCo's default, or the description's,
    which the exported file names."""


class MujocoStock(BatchSimulation):
    """`num` copies of the exported MJCF in MuJoCo, with nothing added.

    Cables are MuJoCo's limits of tendons. A step is `mj_step` on the file that `cdcsr build-model`
    writes, with two differences. The integrator is that of the options. With softness=mujoco the
    limits of tendons and hinges have the solref and solimp of an empty MJCF, (0.02, 1) and
    (0.9, 0.95, 0.001, 0.5, 2), and not those of the description: most MJCF in use names none.

    The tension of a cable is the force of its limit at the last evaluation in a step; RK4 makes
    four.
    """

    engine = "mujoco-stock"
    title = "MuJoCo, stock"
    variant_of = "mujoco"
    capabilities = frozenset(
        {"render", "bit_exact", "soft_cables", "elastic_cables", "servo_kinds"}
    )
    options_type = StockOptions
    physics = Physics(
        joint_dynamics="MuJoCo's",
        integration="MuJoCo's, by the option integrator",
        cables="MuJoCo's limits of tendons, by the option softness",
        limits="MuJoCo's, by the option softness",
        servos="MuJoCo's position actuators",
        damping="MuJoCo's joint damping",
    )
    switches: ClassVar[Mapping[str, str]] = {"softness": "description"}
    cables_type = Limits

    @property
    def ideal(self) -> bool:
        return False  # soft limits stretch by as much at any time step

    def _spec(self) -> mujoco.MjSpec:
        options = self.options
        assert isinstance(options, StockOptions)
        spec = build_spec(self.robot)
        spec.option.integrator = INTEGRATORS[options.integrator]
        if options.softness == "mujoco":
            _set_default_softness(spec)
        return spec


def _set_default_softness(spec: mujoco.MjSpec) -> None:
    """Give limits of hinges and tendons, and coupled hinges, the softness of an empty MjSpec."""
    empty = mujoco.MjSpec()
    joint, tendon = empty.worldbody.add_body().add_joint(), empty.add_tendon()
    hinges = [x for x in spec.joints if x.type == mujoco.mjtJoint.mjJNT_HINGE]
    for limited, default in [(x, joint) for x in hinges] + [(x, tendon) for x in spec.tendons]:
        limited.solref_limit, limited.solimp_limit = default.solref_limit, default.solimp_limit
    soft = empty.add_equality()
    for equality in spec.equalities:
        if equality.type == mujoco.mjtEq.mjEQ_JOINT:
            equality.solref, equality.solimp = soft.solref, soft.solimp
