"""Measure what each choice in the MuJoCo model costs a step, and how far it moves the tip."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from backends.mujoco.active_cables import CURRENT, Cables, Limits, stepping_spec
from backends.mujoco.model import build_spec
from cdcsr.robot.description import Robot

Array = NDArray[np.float64]
Change = Callable[[mujoco.MjSpec], None]

OURS = "ours"
FAITHFUL = 0.1
"""A choice is faithful if it moves the tip by at most this over an episode, in [mm]; a target is
60 mm wide."""
_JACOBIAN, _INTEGRATOR, _SOLVER = mujoco.mjtJacobian, mujoco.mjtIntegrator, mujoco.mjtSolver


@dataclass(frozen=True)
class Choice:
    """A variant of the model, and what was measured of it."""

    name: str
    microseconds: float
    """The time of a step of one copy, in [us]."""
    ratio: float
    """This time over that of our model."""
    distance: float
    """The largest distance of the tip from our model's, over all steps and episodes, in [mm]; NaN
    if the variant diverged."""
    holds: bool
    """Whether the cables hold: MuJoCo's soft limits let them stretch by millimetres."""

    @property
    def faithful(self) -> bool:
        """Whether the variant could take the place of our model."""
        return self.holds and self.distance <= FAITHFUL


def model_choices(
    robot: Robot, commands: Array, rounds: int = 21, only: tuple[str, ...] = ()
) -> list[Choice]:
    """Measure variants of the model under the same commands; the first is our model.

    They take turns in one thread of one process. Times are medians over the rounds, ratios are
    taken within a round.

    Args:
        robot: the description.
        commands: servo set-points of N episodes side by side, shape (N, T, C), in [m].
        rounds: how many turns each variant has.
        only: the names of the variants besides our model; by default all.
    """
    variants = _variants(robot)
    chosen = {name: v for name, v in variants.items() if not only or name in (OURS, *only)}
    steppers, tips = {}, {}
    for name, variant in chosen.items():
        spec = variant.spec(robot)
        variant.change(spec)
        steppers[name] = _Stepper(robot, spec.compile(), len(commands), variant.cables)
        tips[name] = steppers[name].run(commands)
    seconds: dict[str, list[float]] = {name: [] for name in steppers}
    for _ in range(rounds):
        for name, stepper in steppers.items():
            start = time.thread_time()
            stepper.run(commands)
            seconds[name].append(time.thread_time() - start)
    ours = np.array(seconds[OURS])
    per_step = 1e6 / (commands.shape[0] * commands.shape[1])
    return [
        Choice(
            name,
            float(np.median(taken)) * per_step,
            float(np.median(np.array(taken) / ours)),
            1e3 * float(np.linalg.norm(tips[name] - tips[OURS], axis=-1).max()),
            chosen[name].cables is Cables,
        )
        for name, taken in seconds.items()
    ]


def cheapest(choices: list[Choice]) -> Choice:
    """Return the cheapest faithful variant, which may be our model."""
    return min((choice for choice in choices if choice.faithful), key=lambda choice: choice.ratio)


class _Variant(NamedTuple):
    """A way to build and to step the model."""

    change: Change
    spec: Callable[[Robot], mujoco.MjSpec] = stepping_spec
    cables: type[Cables | Limits] = Cables


class _Stepper:
    """Steps a batch under given commands."""

    def __init__(
        self, robot: Robot, model: mujoco.MjModel, num: int, cables: type[Cables | Limits]
    ) -> None:
        self._batch = batch.Batch(model, num, 1, True)
        self._cables, self._tip = cables(robot, self._batch), model.site("tip").id
        self._control, self._places = self._batch.bind("ctrl"), self._batch.bind("site_xpos")

    def run(self, commands: Array) -> Array:
        """Run episodes from the start, and return the tip positions, shape (T, N, 3), in [m]."""
        self._batch.reset(stage=CURRENT)
        tips = []
        for step in range(commands.shape[1]):
            self._control[:] = commands[:, step]
            self._cables.step()
            tips.append(self._places.reshape(len(commands), -1, 3)[:, self._tip].copy())
        return np.array(tips)


def _variants(robot: Robot) -> dict[str, _Variant]:
    return {
        OURS: _Variant(_nothing),
        "solver Newton": _Variant(_option(solver=_SOLVER.mjSOL_NEWTON)),
        "solver CG": _Variant(_option(solver=_SOLVER.mjSOL_CG)),
        "at most 10 iterations": _Variant(_option(iterations=10)),
        "tolerance 1e-6, not 1e-8": _Variant(_option(tolerance=1e-6)),
        "Jacobian dense": _Variant(_option(jacobian=_JACOBIAN.mjJAC_DENSE)),
        "Jacobian sparse": _Variant(_option(jacobian=_JACOBIAN.mjJAC_SPARSE)),
        "gravity and control clamps skipped": _Variant(_skip_unused),
        "no visual geoms": _Variant(_without_geoms),
        "no sensors but those of stops": _Variant(_without_sensors),
        "MuJoCo's own soft limits": _Variant(_nothing, build_spec, Limits),
        "soft limits, integrator implicit": _Variant(
            _option(integrator=_INTEGRATOR.mjINT_IMPLICIT), build_spec, Limits
        ),
        "soft limits, integrator Euler": _Variant(
            _option(integrator=_INTEGRATOR.mjINT_EULER), build_spec, Limits
        ),
        "soft limits, cables measured only where they bend": _Variant(
            lambda spec: _reroute(spec, robot, _bends_only), build_spec, Limits
        ),
        "soft limits, one guide a link": _Variant(
            lambda spec: _reroute(spec, robot, _every_other), build_spec, Limits
        ),
    }


def _nothing(_: mujoco.MjSpec) -> None:
    pass


def _option(**values: object) -> Change:
    def change(spec: mujoco.MjSpec) -> None:
        for name, value in values.items():
            setattr(spec.option, name, value)

    return change


def _skip_unused(spec: mujoco.MjSpec) -> None:
    bit = mujoco.mjtDisableBit
    spec.option.disableflags |= int(bit.mjDSBL_GRAVITY) | int(bit.mjDSBL_CLAMPCTRL)


def _without_geoms(spec: mujoco.MjSpec) -> None:
    for geom in list(spec.geoms):
        spec.delete(geom)


def _without_sensors(spec: mujoco.MjSpec) -> None:
    for sensor in list(spec.sensors):
        if not sensor.name.startswith("stop_"):
            spec.delete(sensor)


# -- other routes of the cables --------------------------------------------------------------------

Route = list[list[str]]
"""The sites along a cable, in stretches; the length between two stretches is not measured."""


def _bends_only(sites: list[str]) -> Route:
    """Return the stretches across the joints; those between the two guides of a link never
    change."""
    return [sites[:2]] + [sites[i : i + 2] for i in range(1, len(sites) - 1, 2)]


def _every_other(sites: list[str]) -> Route:
    """Return the slider, the base's guide, and the upper guide of each link."""
    return [sites[:1] + sites[1::2] + (sites[-1:] if len(sites) % 2 else [])]


def _reroute(spec: mujoco.MjSpec, robot: Robot, route: Callable[[list[str]], Route]) -> None:
    """Lead every cable along other sites; its rest length is their distance in the straight arm."""
    straight = spec.compile()
    data = mujoco.MjData(straight)
    mujoco.mj_kinematics(straight, data)
    _without_sensors(spec)
    for c in range(robot.num_cables):
        old = spec.tendon(f"cable_{c}")
        sites = [f"pull_{c}"] + [
            site.name
            for site in sorted(spec.sites, key=lambda site: data.site(site.name).xpos[2])
            if site.name.startswith(f"guide_{c}_")
        ]
        solref, solimp = np.array(old.solref_limit), np.array(old.solimp_limit)
        slack = straight.tendon_length0[c] - old.range[1]
        spec.delete(old)
        new = spec.add_tendon(
            name=f"cable_{c}",
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            solref_limit=solref,
            solimp_limit=solimp,
        )
        length = 0.0
        for i, stretch in enumerate(route(sites)):
            if i:
                new.wrap_pulley(1.0)
            for site in stretch:
                new.wrap_site(site)
            places = np.array([data.site(site).xpos for site in stretch])
            length += float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
        new.range = [0.0, length - slack]
