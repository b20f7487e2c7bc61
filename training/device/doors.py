"""The door of an engine for a learner on a device: states and commands are tensors that stay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cdcsr.errors import Diverged
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Simulation, Snapshot
from cdcsr.simulation.plant import Parameters
from cdcsr.simulation.randomization import Drawn
from cdcsr.simulation.state import State

Foreign = Any
"""A tensor where the types of tasks and episodes say NumPy, or the other way round."""
_SNAPSHOT = "time", "position", "velocity", "private"


class DeviceState(Protocol):
    """The state of all copies as tensors; those of :class:`cdcsr.simulation.state.State`."""

    tip_position: Tensor
    tip_velocity: Tensor
    base_position: Tensor
    base_quaternion: Tensor
    diverged: Tensor
    """Whether a copy has diverged since its last reset, shape (num,)."""


class Door(Protocol):
    """Copies of a robot whose states and commands are tensors on one device."""

    robot: Robot
    num: int

    def device_state(self) -> DeviceState:
        """Return the state: always the same tensors, whose numbers change with steps and resets."""
        ...

    def step_device(
        self, command: Tensor, substeps: int = 1, restart: Tensor | None = None
    ) -> None:
        """Advance all copies; commands have the shape (num, C), in [m] or [N].

        Copies of the mask `restart`, shape (num,), stand at the start after that.
        """
        ...

    def reset_device(self, mask: Tensor) -> None:
        """Put copies back to the start; the mask has the shape (num,)."""
        ...

    def set_start_device(self, position: Tensor, velocity: Tensor) -> None:
        """Let copies start from now on in the states that stand in two tensors at that time.

        Args:
            position: as in a snapshot, shape (num, 7 + C + H); the base is unturned.
            velocity: in the order of coordinates, shape (num, nv).
        """
        ...

    def set_plants(self, plants: Drawn) -> None:
        """Take note of P plants, by the names of `Parameters`, without late commands."""
        ...

    def change_plants(self, mask: Tensor, row: Tensor) -> None:
        """Give copies of a mask, shape (num,), plants by their rows, shape (num,).

        A copy whose cables get shorter must be put to the start next.
        """
        ...

    def close(self) -> None:
        """Release the engine."""
        ...


class HostDoor:
    """A door for any engine: tensors go through NumPy's arrays and come back.

    Args:
        simulation: of the engine.
        device: where the tensors are.
    """

    def __init__(self, simulation: Simulation, device: torch.device) -> None:
        self._simulation, self._device = simulation, device
        self.robot, self.num = simulation.robot, simulation.num
        self._lost = np.zeros(self.num, dtype=np.bool_)
        self._start: tuple[Tensor, Tensor] | None = None
        self._plants: Drawn = {}
        parts = {name: self._tensor(rows) for name, rows in self._arrays().items()}
        self._state = _HostState(**parts)

    def device_state(self) -> DeviceState:
        return cast(DeviceState, self._state)

    def refresh(self) -> None:
        """Copy the state to the device; steps and resets do so themselves."""
        for name, rows in self._arrays().items():
            getattr(self._state, name).copy_(self._tensor(rows))

    def _arrays(self) -> Mapping[str, NDArray[np.generic]]:
        state = self._simulation.state()
        return {**{f.name: getattr(state, f.name) for f in fields(State)}, "diverged": self._lost}

    def step_device(
        self, command: Tensor, substeps: int = 1, restart: Tensor | None = None
    ) -> None:
        given = command.cpu().numpy().astype(np.float64)
        wrong = np.logical_not(np.isfinite(given).all(axis=1))  # of a learner that has diverged
        self._lost |= wrong
        try:
            self._simulation.step(np.where(wrong[:, None], 0.0, given), substeps)
        except Diverged as error:
            self._lost[list(error.copies)] = True
            self._simulation.reset(error.copies)
        if restart is not None:
            self._reset(restart)
        self.refresh()

    def reset_device(self, mask: Tensor) -> None:
        self._reset(mask)
        self.refresh()

    def _reset(self, mask: Tensor) -> None:
        chosen = mask.cpu().numpy()
        self._lost[chosen] = False
        if not chosen.any():
            return
        if self._start is None:
            self._simulation.reset(np.flatnonzero(chosen))
        else:
            state = (part[mask].cpu().numpy() for part in self._start)
            self._simulation.place(np.flatnonzero(chosen), *state)

    def set_start_device(self, position: Tensor, velocity: Tensor) -> None:
        self._start = position, velocity

    def set_plants(self, plants: Drawn) -> None:
        self._plants = plants

    def change_plants(self, mask: Tensor, row: Tensor) -> None:
        ids, chosen = np.flatnonzero(mask.cpu().numpy()), row[mask].cpu().numpy()
        if len(ids):
            own = {name: values[chosen] for name, values in self._plants.items()}
            self._simulation.set_parameters(ids, Parameters(**own))

    def close(self) -> None:
        self._simulation.close()

    def _tensor(self, array: NDArray[np.generic]) -> Tensor:
        kind = torch.bool if array.dtype == np.bool_ else torch.float32
        return torch.tensor(array, dtype=kind, device=self._device)


class _HostState(NamedTuple):
    time: Tensor
    tip_position: Tensor
    tip_velocity: Tensor
    base_position: Tensor
    base_quaternion: Tensor
    base_velocity: Tensor
    base_angular_velocity: Tensor
    cable_travel: Tensor
    cable_tension: Tensor
    joint_angles: Tensor
    joint_rates: Tensor
    diverged: Tensor


def open_door(simulation: Simulation, device: torch.device) -> Door:
    """Return the engine's own door, if it has one on this device, or one through NumPy's arrays."""
    if hasattr(simulation, "device_state"):
        door = cast(Door, simulation)
        there = door.device_state().tip_position.device
        if there.type == device.type and (there.index or 0) == (device.index or 0):
            return door
    return HostDoor(simulation, device)


def snapshot_arrays(simulation: Simulation) -> dict[str, NDArray[np.float64]]:
    """Return all that determines the future of a simulation without delayed commands."""
    snapshot = simulation.get_snapshot()
    return {name: getattr(snapshot, name) for name in _SNAPSHOT}


def restore(simulation: Simulation, door: Door, arrays: Mapping[str, NDArray[np.float64]]) -> None:
    """Go on from what :func:`snapshot_arrays` returned, in a simulation and behind its door."""
    parts = {name: arrays[name] for name in _SNAPSHOT}
    simulation.set_snapshot(Snapshot(simulation.engine, simulation.robot.fingerprint, **parts))
    if isinstance(door, HostDoor):
        door.refresh()
