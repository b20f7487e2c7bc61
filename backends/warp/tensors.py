"""The state of all copies as torch tensors that are the engine's own memory."""

from __future__ import annotations

from typing import NamedTuple

import torch
import warp as wp

from backends.mujoco.active_cables import base_size
from backends.warp.device import Copies
from cdcsr.robot.description import Robot


class DeviceState(NamedTuple):
    """The state of all copies as tensors on the device, in single precision.

    The numbers are those of :class:`cdcsr.simulation.contract.State`, in the same units and frames.
    The tensors are the engine's own memory: read them only. They change with every step and reset;
    clone what is to last.
    """

    time: torch.Tensor
    """Shape (num,), in [s], in double precision."""
    tip_position: torch.Tensor
    """Shape (num, 3), in [m]."""
    tip_velocity: torch.Tensor
    """Shape (num, 3), in [m/s]."""
    base_position: torch.Tensor
    """Shape (num, 3), in [m]."""
    base_quaternion: torch.Tensor
    """w-x-y-z, unit length to rounding, shape (num, 4)."""
    base_velocity: torch.Tensor
    """Shape (num, 3), in [m/s]."""
    base_angular_velocity: torch.Tensor
    """In the world frame, shape (num, 3), in [rad/s]."""
    cable_travel: torch.Tensor
    """Shape (num, C), in [m]; negative is pulled."""
    cable_tension: torch.Tensor
    """The tension in the last step, shape (num, C), in [N]."""
    joint_angles: torch.Tensor
    """Shape (num, H), in [rad]."""
    joint_rates: torch.Tensor
    """Shape (num, H), in [rad/s]."""
    diverged: torch.Tensor
    """Whether a copy has diverged since its last reset, shape (num,), bool. Such a copy stands at
    the start; its numbers mean nothing until it is reset."""


def tensors_of(copies: Copies, robot: Robot) -> DeviceState:
    """Return the state of all copies; nothing is copied but the pose of a fixed base."""
    (q, v), cables = base_size(robot), robot.num_cables
    qpos, qvel = wp.to_torch(copies.data.qpos), wp.to_torch(copies.data.qvel)
    position, quaternion, velocity = qpos[:, :3], qpos[:, 3:7], qvel[:, :3]
    if not v:
        position, quaternion, velocity = (
            torch.tensor(part, dtype=qpos.dtype, device=qpos.device).expand(copies.num, -1)
            for part in (robot.base.position, robot.base.quaternion, (0.0, 0.0, 0.0))
        )
    return DeviceState(
        time=wp.to_torch(copies.time),
        tip_position=wp.to_torch(copies.tip),
        tip_velocity=wp.to_torch(copies.tip_velocity),
        base_position=position,
        base_quaternion=quaternion,
        base_velocity=velocity,
        base_angular_velocity=wp.to_torch(copies.base_turning),
        cable_travel=qpos[:, q : q + cables],
        cable_tension=wp.to_torch(copies.tension),
        joint_angles=qpos[:, q + cables :],
        joint_rates=qvel[:, v + cables :],
        diverged=wp.to_torch(copies.diverged),
    )
