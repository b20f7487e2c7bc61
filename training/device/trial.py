"""Measure the policies of runs side by side on a device: one episode for each target."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
import torch
from gymnasium.utils.seeding import np_random
from torch import Tensor

from cdcsr.envs.episodes import Episodes
from cdcsr.simulation.state import State
from cdcsr.tasks.catalogue import actions_per_episode
from cdcsr.tasks.observation import observe, tip_distance
from cdcsr.tasks.starts import Starts
from training.algorithms.reference_update import Layer, output
from training.device.collector import Work, as_tensor
from training.device.doors import Door, Foreign
from training.device.graphs import Repeated
from training.networks.actor import Actor

_ASK_EVERY = 25
"""How many actions are taken until the device is asked whether any episode goes on."""


class Outcome(NamedTuple):
    """The outcomes of V episodes of each of S runs, shapes (S, V)."""

    success: Tensor
    length: Tensor
    """In actions."""
    distance: Tensor
    """From tip to target at the end, in [m]."""
    diverged: Tensor


class DeviceTrial:
    """Let policies reach for the targets that an environment would draw from a seed.

    Args:
        door: the engine's copies, S times V.
        work: the task, and where the targets of each run lie.
        seed: of the targets.
        module: an actor whose encoder, symmetry and servo range are those of all runs.
        device: where everything is.
        starts: how episodes begin; by default at rest.

    Attributes:
        targets: where targets begin, shape (S, V, 3), in [m].
    """

    def __init__(
        self,
        door: Door,
        work: Work,
        seed: int,
        module: Actor,
        device: torch.device,
        starts: Starts | None = None,
    ) -> None:
        self._door, self._work, self._module = door, work, module
        self._state = door.device_state()
        runs = len(work.spaces)
        self._shape = runs, door.num // runs
        varies, drift = starts is not None and starts.varies, None
        if starts is not None and varies:
            # An environment's starts have the second child of its generator.
            own = np_random(seed)[0].spawn(2)[1]
            position, velocity, drift = starts.draw(own, self._shape[1])
            rows = (as_tensor(np.tile(x, (runs, 1)), device) for x in (position, velocity))
            door.set_start_device(*rows)
        drawn = [Episodes(self._shape[1], work.task, space, varies) for space in work.spaces]
        for each in drawn:
            each.begin(np.arange(self._shape[1]), np_random(seed)[0], drift=drift)
        self.targets = np.stack([each.targets for each in drawn])
        self._episodes = Episodes(door.num, work.task, work.spaces[0], varies)
        self._first = {
            name: as_tensor(np.concatenate([each.arrays()[name] for each in drawn]), device)
            for name in drawn[0].arrays()
        }
        self._episodes.convert(lambda array: as_tensor(array, device))
        self._most = actions_per_episode(work.task.max_steps, work.frame_skip)
        flags = torch.zeros(3, door.num, dtype=torch.bool, device=device)
        self._active, self._success, self._diverged = flags
        self._length = torch.zeros(door.num, dtype=torch.int64, device=device)
        self._distance = torch.zeros(door.num, device=device)
        self._command = torch.zeros(door.num, door.robot.num_cables, device=device)
        self._actor: list[Layer] = []
        self._before, self._after = (Repeated(x, device) for x in (self._act, self._judge))

    def run(self, actor: list[Layer]) -> Outcome:
        """Measure policies, always the same tensors, shape (S, 1, ...)."""
        self._actor = actor
        for name, rows in cast(dict[str, Tensor], self._episodes.arrays()).items():
            rows.copy_(self._first[name])
        for flags, value in (self._active, True), (self._success, False), (self._diverged, False):
            flags.fill_(value)
        self._length.zero_()
        self._door.reset_device(torch.ones_like(self._active))
        for action in range(self._most):
            if action % _ASK_EVERY == 0 and not self._active.any():
                break
            self._before()
            self._door.step_device(self._command, self._work.frame_skip)
            self._after()
        found = self._success, self._length, self._distance, self._diverged
        return Outcome(*(part.view(self._shape).clone() for part in found))

    def close(self) -> None:
        """Release the engine."""
        self._door.close()

    @torch.no_grad()
    def _act(self) -> None:
        state, targets = cast(State, self._state), self._episodes.targets
        seen = cast(Foreign, observe(state, targets)).view(*self._shape, -1)
        module, cables = self._module, None
        if module.mirror_symmetry is not None:
            seen, cables = module.mirror_symmetry(seen)
        action = torch.tanh(output(self._actor, module.encoder(seen)))
        if cables is not None:
            action = action.gather(-1, cables)
        self._command.copy_(module.to_command(action).flatten(0, 1))

    @torch.no_grad()
    def _judge(self) -> None:
        state, episodes = self._state, self._episodes
        episodes.advance(self._work.frame_skip, self._door.robot.time_step)
        distance = cast(Foreign, tip_distance(cast(State, state), episodes.targets))
        _, verdict = cast(Foreign, episodes.judge(cast(State, state)))
        verdict = verdict.without(state.diverged)
        active = self._active
        self._length += active
        self._distance.copy_(torch.where(active, distance, self._distance))
        self._success.copy_(torch.where(active, verdict.success, self._success))
        self._diverged |= active & state.diverged
        active &= ~(verdict.terminated | state.diverged)
