"""The door of the engine `warp` for torch: states and commands are tensors that stay."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
import warp as wp

from backends.warp.device import Copies
from backends.warp.tensors import DeviceState
from cdcsr.errors import CdcsrError
from cdcsr.simulation.contract import Simulation
from cdcsr.simulation.declarations import check_abilities
from cdcsr.simulation.plant import Parameters
from cdcsr.simulation.randomization import Drawn
from cdcsr.simulation.turns import taking_turns


@taking_turns
class DeviceSteps(Simulation):
    """Steps and resets for those who stay on the device: nothing is copied to the host, and nobody
    waits for the device."""

    _copies: Copies
    _tensors: DeviceState
    _command: torch.Tensor
    _chosen_copies: torch.Tensor
    _plants: list[tuple[torch.Tensor, torch.Tensor]]
    """The engine's arrays that plants change, and those numbers of all known plants."""

    def device_state(self) -> DeviceState:
        """Return the state of all copies on the device; nothing is copied, and it is always the
        same tensors."""
        self._check_open()
        return self._tensors

    def step_device(
        self, command: torch.Tensor, substeps: int = 1, restart: torch.Tensor | None = None
    ) -> None:
        """Advance all copies under commands on the device; read `diverged` to see which are lost.

        Args:
            command: as in `step`, shape (num, C), on this device, in [m]. Its numbers are not
                checked.
            substeps: how many time steps.
            restart: the copies that stand at the start after that, shape (num,), bool, on this
                device; a reset apart would look a second time at what follows from positions.

        Raises:
            CdcsrError: the command or the mask has another shape or is on another device; or
                commands are delayed, which only `step` can do.
        """
        self._check_open()
        if not self._line.idle:
            raise CdcsrError("step_device delays no commands; use step, or set no command_delay.")
        self._check_tensor("The command", command, self._command)
        self._command.copy_(command)
        if restart is not None:
            self._choose(restart)
        with self._in_torch_order():
            for done in range(1, substeps + 1):
                self._copies.step(restart is not None and done == substeps)

    def reset_device(self, mask: torch.Tensor) -> None:
        """Put copies to the start, as `reset` does.

        Args:
            mask: which copies, shape (num,), bool, on this device.

        Raises:
            CdcsrError: the mask has another shape or is on another device.
        """
        self._check_open()
        self._choose(mask)
        with self._in_torch_order():
            self._copies.restart()

    def set_start_device(self, position: torch.Tensor, velocity: torch.Tensor) -> None:
        """Let copies start from now on in the states that stand in two tensors at that time.

        `reset` does so too. Tensions are zero, and whatever was applied is gone.

        Args:
            position: as in a snapshot, shape (num, 7 + C + H), float32; a free base is unturned.
            velocity: in the order of coordinates, shape (num, nv), float32.

        Raises:
            CdcsrError: a tensor has another shape, or is on another device.
        """
        self._check_open()
        found = (
            ("position", position, self.robot.num_coordinates + 1),
            ("velocity", velocity, self.robot.num_coordinates),
        )
        for name, tensor, size in found:
            like = self._command.new_empty(self.num, size)
            self._check_tensor(f"The start's {name}", tensor, like)
        host = self._copies.host
        with self._copies.active():
            parts = position[:, -host.nq :], velocity[:, -host.nv :]
            self._copies.start_at(*(wp.from_torch(part) for part in parts))

    def set_plants(self, plants: Drawn) -> None:
        """Take note of P plants, from which :meth:`change_plants` gives some to copies.

        Args:
            plants: by the names of :class:`cdcsr.simulation.plant.Parameters`, P rows each, without
                late commands.
        """
        self._check_open()
        num = len(next(iter(plants.values())))
        plant = Parameters(**plants).plant(self.robot, num)
        check_abilities(self.engine, self.capabilities, self.robot, plant)
        # Masses decide other numbers of the model, which the engine finds for copies at once.
        with self._copies.active():
            pool = Copies(self.robot, num, self._copies.device)
            pool.set_plant(np.arange(num), plant)
            own, theirs = self._copies.plant_arrays(), pool.plant_arrays()
            self._plants = [(wp.to_torch(own[k]), wp.to_torch(theirs[k])) for k in own]

    def change_plants(self, mask: torch.Tensor, row: torch.Tensor) -> None:
        """Give copies plants of :meth:`set_plants`; the attribute `plant` does not change.

        Args:
            mask: which copies, shape (num,), bool, on this device; put them to the start next.
            row: the number of the plant, shape (num,), int64.
        """
        for own, theirs in self._plants:
            chosen = mask.view(-1, *[1] * (own.dim() - 1))
            own.copy_(torch.where(chosen, theirs[row], own))

    def _choose(self, mask: torch.Tensor) -> None:
        """Take note of the copies that are to be put to the start."""
        self._check_tensor("The mask", mask, self._chosen_copies)
        self._chosen_copies.copy_(mask)

    def _check_tensor(self, name: str, found: torch.Tensor, like: torch.Tensor) -> None:
        parts = (
            (tuple(x.shape), str(x.dtype).removeprefix("torch."), x.device) for x in (like, found)
        )
        (shape, kind, device), other = parts
        if other != (shape, kind, device):
            raise CdcsrError(
                f"{name} must have the shape {shape}, be {kind} and be on {device}; found "
                f"{other[0]}, {other[1]}, on {other[2]}."
            )

    @contextmanager
    def _in_torch_order(self) -> Iterator[None]:
        """Let Warp work after what torch was given before, and torch go on after that.

        On a GPU both only hand their work over, each to a stream of its own.
        """
        with self._copies.active():
            if not self._copies.device.is_cuda:
                yield
                return
            ours = wp.get_stream()
            theirs = wp.stream_from_torch(torch.cuda.current_stream(self._copies.device.ordinal))
            ours.wait_stream(theirs)
            yield
            theirs.wait_stream(ours)
