"""The sections of a description beside its segments."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, Strict

from cdcsr.robot.mesh_files import MeshName
from cdcsr.robot.parts import Inertia, NonNegative, Part, Positive, Vector


def _unit(quaternion: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """Check that a quaternion has the length 1."""
    if abs(np.linalg.norm(quaternion) - 1) > 1e-6:
        raise ValueError("must have the length 1")
    return quaternion


class Base(Part):
    """The base: a box. At the start its centre is the world origin, unless it says otherwise."""

    later = ("mount", "position", "quaternion", "mesh")
    size: Annotated[tuple[Positive, Positive, Positive], Strict(False)]
    """Edge lengths along x, y, z in [m]."""
    mass: Positive
    """Mass in [kg], sliders not included."""
    inertia: Inertia
    """Principal moments about the centre in [kg m^2]."""
    mount: Literal["free", "fixed"] = "free"
    """A free base floats; a fixed one never moves, and its mass and inertia have no effect."""
    position: Vector = (0.0, 0.0, 0.0)
    """Its centre at the start, in the world frame, in [m]."""
    quaternion: Annotated[
        tuple[float, float, float, float], Strict(False), AfterValidator(_unit)
    ] = (1.0, 0.0, 0.0, 0.0)
    """How it is turned at the start, w-x-y-z."""
    mesh: MeshName | None = None
    """Its look: a mesh file in [m], origin at its centre."""


class Constraint(Part):
    """Unilateral constraints: cables, never longer than at rest, and hinge limits."""

    recovery_time: Positive
    """The time constant with which an excess of length or angle decays, in [s]; at least two time
    steps."""


class Workspace(Part):
    """The cuboid of the Anchor Space, where the robot works."""

    center: Vector
    """In the world frame, in [m]."""
    size: Annotated[tuple[NonNegative, NonNegative, NonNegative], Strict(False)]
    """Edge lengths in [m]; zero for a plane or a line."""


class Payload(Part):
    """A body that the tip carries, on the arm's axis."""

    later = ("inertia", "offset")
    mass: Positive
    """In [kg]."""
    inertia: Annotated[tuple[NonNegative, NonNegative, NonNegative], Strict(False)] = (0, 0, 0)
    """Principal moments about its own centre of mass in [kg m^2]; zero for a point."""
    offset: NonNegative = 0.0
    """How far its centre of mass lies beyond the tip, in [m]."""


class MujocoOptions(Part):
    """Numbers that only MuJoCo reads."""

    integrator: Literal["implicitfast", "implicit", "Euler"] = "implicitfast"
    """The integrator in the model files, for stock MuJoCo. The simulation does not read it: there
    dampers are implicit, and nothing else is."""
    impedance: Annotated[float, Field(gt=0, lt=1)] = 0.999
    """Impedance (solimp dmin = dmax) of hinge limits and, in the model files, of cables; 1 is
    rigid. Too close to 1, a taut cable of the model files that shortens by nanometres is slack for
    a step, in which nothing holds its slider."""
