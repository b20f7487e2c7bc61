"""The options of the PyBullet engines: which of Bullet's defaults act, and how often it steps."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from backends.pybullet.client import MAX_JOINT_SPEED
from cdcsr.simulation.contract import EngineOptions


class PybulletOptions(EngineOptions):
    """How PyBullet steps."""

    substeps: Annotated[int, Field(ge=1, le=100)] = 1
    """Steps of Bullet in a time step of the robot; the tensions are solved for in each."""
    damping: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Bullet's damping d of every body, in [1/s]: forces d (1 + |v|) m v and torques likewise."""
    max_joint_speed: Annotated[float, Field(gt=0.0, le=MAX_JOINT_SPEED)] = MAX_JOINT_SPEED
    """The speed at which Bullet clamps joints, in [m/s] and [rad/s]."""
    contact: bool = False
    """Whether links that are not neighbours, and the base, push each other away where they touch,
    with Bullet's contacts and friction. Cables know nothing of contacts, and a snapshot does not
    keep them: it goes on as after a first touch."""
    servo: Literal["force", "motor"] = "force"
    """How a servo acts: as a force on its slider, or as Bullet's position motor with default gains,
    no stronger than that force."""

    @property
    def steps(self) -> int:
        return self.substeps


class PybulletStockOptions(PybulletOptions):
    """How PyBullet steps by default."""

    damping: Annotated[float, Field(ge=0.0, le=1.0)] = 0.04
    """Bullet's damping d of every body, in [1/s]: forces d (1 + |v|) m v and torques likewise."""
    max_joint_speed: Annotated[float, Field(gt=0.0, le=MAX_JOINT_SPEED)] = 100.0
    """The speed at which Bullet clamps joints, in [m/s] and [rad/s]."""
    servo: Literal["force", "motor"] = "motor"
    """How a servo acts: as a force on its slider, or as Bullet's position motor with default gains,
    no stronger than that force."""
