"""Eq. (1) of the BATD3 paper (Tian et al., section III-A): what a policy observes.

:data:`PARTS` is the only place that knows the layout of the observation. Everything is in the world
frame and in SI units. If the target moves, the observation holds its position, not its velocity.
States may hold arrays of NumPy or, see :mod:`cdcsr.tasks.task`, of another library.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import accumulate
from typing import Literal

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import State

Array = NDArray[np.float64]

Kind = Literal["position", "velocity", "scalar", "quaternion", "axial vector", "per cable"]
"""The kind decides what a mirror does to a part; an axial vector is, for example, an angular
velocity."""
_WIDTHS = {
    "position": 3,
    "velocity": 3,
    "scalar": 1,
    "quaternion": 4,
    "axial vector": 3,
    "per cable": 0,
}
_UNITS: dict[Kind, str] = {
    "position": "m",
    "velocity": "m/s",
    "scalar": "m",
    "quaternion": "1",
    "axial vector": "rad/s",
    "per cable": "m",
}


@dataclass(frozen=True)
class Part:
    """One quantity of eq. (1)."""

    name: str
    """The field of :class:`State` that holds it, or `target` or `distance`."""
    kind: Kind
    scale: float
    """The range in which a network should tell values apart, in the quantity's own unit, for the
    paper's robot; see :meth:`scale_of`."""
    centre: Literal["zero", "workspace", "base position", "base quaternion"] = "zero"
    """The value that a network sees as zero: zero, the middle of the robot's workspace in [m], or
    where its base starts."""

    @property
    def unit(self) -> str:
        """The unit of its numbers; those of a quaternion, in the order w-x-y-z, have none: "1"."""
        return _UNITS[self.kind]

    def width(self, num_cables: int) -> int:
        """Return how many numbers of the observation this part takes."""
        return num_cables if self.kind == "per cable" else _WIDTHS[self.kind]

    def scale_of(self, robot: Robot) -> float:
        """Return its scale for a robot of any size and pace."""
        own = ruler(robot)
        factors = {
            "position": own.size,
            "velocity": own.speed,
            "scalar": own.size,
            "quaternion": 1.0,
            "axial vector": 1 / own.pace,
            "per cable": own.travel,
        }
        return self.scale * factors[self.kind]


# The scales are wide on purpose: a base position scaled to the millimetres that it moves would make
# a policy that fails when its measurement is noisy by centimetres.
PARTS = (
    Part("tip_position", "position", 0.3, "workspace"),
    Part("tip_velocity", "velocity", 1.0),
    Part("target", "position", 0.3, "workspace"),
    Part("distance", "scalar", 0.3),
    Part("base_position", "position", 0.1, "base position"),
    Part("base_quaternion", "quaternion", 0.1, "base quaternion"),
    Part("base_velocity", "velocity", 0.1),
    Part("base_angular_velocity", "axial vector", 0.1),
    Part("cable_travel", "per cable", 0.03),
)
"""The parts of eq. (1) in order. Only the last one has a width that depends on the robot."""

_ENDS = list(accumulate(part.width(0) for part in PARTS))
SLICES = {
    part.name: slice(end - part.width(0), None if part.kind == "per cable" else end)
    for part, end in zip(PARTS, _ENDS, strict=True)
}
"""Where each part is in an observation, by name."""
TIP_POSITION, TIP_VELOCITY = SLICES["tip_position"], SLICES["tip_velocity"]
TARGET, DISTANCE = SLICES["target"], SLICES["distance"].start
"""The distance is one column; the others are slices."""
BASE_POSITION, BASE_QUATERNION = SLICES["base_position"], SLICES["base_quaternion"]
CABLE_TRAVEL = SLICES["cable_travel"]
_GOAL = ("target", "distance")
"""The parts that tell of the target."""


def observation_size(robot: Robot) -> int:
    """Return how many numbers eq. (1) has for a robot."""
    return sum(part.width(robot.num_cables) for part in PARTS)


def tip_distance(state: State, target: Array) -> Array:
    """Return the distances from tip to target, shape (num,), in [m]; `target` is (num, 3)."""
    apart = target - state.tip_position
    xp = array_namespace(apart)
    return xp.sqrt(xp.einsum("ni,ni->n", apart, apart))


def parts_of(state: State, target: Array, distance: Array) -> dict[str, Array]:
    """Return the parts of eq. (1) by name and in order.

    Args:
        state: the measured state of num copies.
        target: target positions, shape (num, 3), in [m].
        distance: what :func:`tip_distance` returns for them, shape (num,), in [m].

    Returns:
        Arrays of shape (num, width of the part).
    """
    given = {"target": target, "distance": distance[:, None]}
    return {
        part.name: given[part.name] if part.name in given else getattr(state, part.name)
        for part in PARTS
    }


def observe(state: State, target: Array, distance: Array | None = None) -> Array:
    """Build eq. (1) from a state.

    Args:
        state: the measured state of num copies.
        target: target positions, shape (num, 3), in [m].
        distance: what :func:`tip_distance` returns for them, if it is known already.

    Returns:
        Shape (num, observation size).
    """
    if distance is None:
        distance = tip_distance(state, target)
    parts = list(parts_of(state, target, distance).values())
    return array_namespace(target).concat(parts, axis=1)


def to_state(observation: Array, time: Array, robot: Robot) -> State:
    """Return the state that an observation tells of: the inverse of :func:`observe`.

    Args:
        observation: shape (num, observation size).
        time: of each copy, shape (num,), in [s].
        robot: the robot that was observed.

    Returns:
        A state whose cable tension, joint angles and joint rates are NaN, as eq. (1) does not
        hold them.
    """
    num = len(observation)
    hinges = np.full((num, robot.num_hinges), np.nan)
    unknown = {
        "cable_tension": np.full((num, robot.num_cables), np.nan),
        "joint_angles": hinges,
        "joint_rates": hinges.copy(),
    }
    known = {
        field.name: observation[:, SLICES[field.name]]
        for field in fields(State)
        if field.name in SLICES
    }
    return State(time=time, **known, **unknown)


def with_target(observations: Array, target: Array) -> Array:
    """Return the same observations with another target, and the distance to it.

    Args:
        observations: shape (..., observation size).
        target: shape (3,), or one for each observation; in [m].
    """
    xp = array_namespace(observations)
    moved = xp.asarray(observations, copy=True)
    moved[..., TARGET] = target
    moved[..., DISTANCE] = xp.linalg.vector_norm(target - moved[..., TIP_POSITION], axis=-1)
    return moved


def as_goals(observation: Array) -> dict[str, Array]:
    """Return an observation with its goals apart, as Gymnasium's goal environments do.

    Args:
        observation: shape (..., observation size).

    Returns:
        `observation`, which is eq. (1) without target and distance, shape (..., size - 4);
        `achieved_goal`, the tip's position, and `desired_goal`, the target, each of shape (..., 3),
        in [m]. The arrays are copies.
    """
    rest = [observation[..., where] for name, where in SLICES.items() if name not in _GOAL]
    return {
        "observation": np.concatenate(rest, axis=-1),
        "achieved_goal": observation[..., TIP_POSITION].copy(),
        "desired_goal": observation[..., TARGET].copy(),
    }


def input_offset(robot: Robot) -> Array:
    """Return the value of each number of eq. (1) that a network sees as zero, shape (size,)."""
    centres = {
        "workspace": robot.workspace.center,
        "base position": robot.base.position,
        "base quaternion": robot.base.quaternion,
    }
    return np.concatenate(
        [centres.get(part.centre, np.zeros(part.width(robot.num_cables))) for part in PARTS]
    )


def input_scale(robot: Robot) -> Array:
    """Return the amount by which each number of eq. (1) is divided for a network, shape (size,)."""
    widths = [part.width(robot.num_cables) for part in PARTS]
    return np.repeat([part.scale_of(robot) for part in PARTS], widths)


def error_scale(robot: Robot) -> float:
    """Return the amount by which the vector from tip to target is divided for a network."""
    return 0.1 * ruler(robot).size
