"""Hindsight on a device: transitions with a target that the tip did reach, made when drawn.

See :mod:`training.experience.hindsight`, which stores whole episodes with such targets.
"""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from cdcsr.tasks.observation import (
    BASE_POSITION,
    BASE_QUATERNION,
    TIP_POSITION,
    TIP_VELOCITY,
    with_target,
)
from cdcsr.tasks.task import Task
from training.device.doors import Foreign
from training.device.replay import DeviceReplay, choose
from training.device.streams import Streams
from training.experience.replay import Batch


class HindsightReplay(DeviceReplay):
    """A replay in which k of k + 1 transitions get a target that their episode reached.

    The episode is that of a row drawn as ever. Its new target is where the tip was after a random
    action, and a random offset in a ball of the threshold's radius; the transition begins before
    the first success there. Where there is none, or the episode begins on target, the row's own
    transition is drawn.

    Args:
        task: defines success, which ends an episode.
        hindsight: k.
        more: the arguments of :class:`DeviceReplay`.
    """

    def __init__(self, task: Task, hindsight: int, *more: Foreign) -> None:
        super().__init__(*more)
        self._task, self._share = task, hindsight / (hindsight + 1)
        self._time = torch.arange(self.longest + 1, device=self.run.device)

    def _transitions(self, row: Tensor, copy: Tensor, draws: Streams) -> Batch:
        own = super()._transitions(row, copy, draws)
        moved, possible = self._relabelled(row, copy, draws)
        wanted = draws.uniform(row) < self._share
        return Batch(*(choose(wanted & possible, a, b) for a, b in zip(moved, own, strict=True)))

    def _relabelled(self, row: Tensor, copy: Tensor, draws: Streams) -> tuple[Batch, Tensor]:
        """Return transitions of the rows' episodes with new targets, and which exist, (S, B)."""
        steps, rows, time = self.shape[2], self.tensors, self._time
        number, at = rows["number"][row, self.run, copy], (self.run[..., None], copy[..., None])
        # The whole episode, if its beginning is not overwritten yet.
        since = (rows["time"] - 1 - row) % steps
        whole = since + number < torch.clamp(rows["time"], max=steps)
        first = row - number
        every = (first[..., None] + time) % steps
        length = rows["last"][every, *at].to(torch.int8).argmax(-1)
        seen = rows["observation"][every, *at]
        tip = seen[..., TIP_POSITION]
        goal = 1 + (draws.uniform(row) * length).to(torch.int64)
        goal = torch.minimum(goal, length)
        reached = tip.gather(2, goal[..., None, None].expand(*goal.shape, 1, 3))
        offset = draws.normal(reached)
        radius = self._task.threshold * draws.uniform(reached[..., :1]) ** (1 / 3)
        target = reached + offset * (
            radius / torch.linalg.vector_norm(offset, dim=-1, keepdim=True)
        )
        # The first success there.
        distance = torch.linalg.vector_norm(tip - target, dim=-1)
        success = self._first_success(seen, distance, length)
        possible = whole & (success > 0) & (distance[..., 0] > self._task.threshold)
        # A transition that begins before it.
        begins = (draws.uniform(row) * success).to(torch.int64)
        begins = torch.minimum(begins, (success - 1).clamp_min(0))
        left = success - begins
        num = torch.clamp(left, max=self.return_steps)
        ends = left <= self.return_steps
        here, there = (first + begins) % steps, (first + begins + num) % steps
        place = self.run, copy

        def observed(where: Tensor) -> Tensor:
            seen: Foreign = rows["observation"][where, *place]
            return cast(Tensor, with_target(seen, cast(Foreign, target.squeeze(2))))

        following = self.weights[(left - 1).clamp_min(0)]
        batch = Batch(
            observation=observed(here),
            action=rows["action"][here, *place],
            reward=torch.where(ends, following, 0.0),
            discount=torch.where(ends, 0.0, self.weights[num]),
            next_observation=observed(there),
            bc_action=rows["bc_action"][here, *place],
            next_bc_action=rows["bc_action"][there, *place],
            outcome=following,
        )
        return batch, possible

    def _first_success(self, seen: Tensor, distance: Tensor, length: Tensor) -> Tensor:
        """Return after how many actions episodes succeed, (S, B); 0 where they do not.

        Args:
            seen: their observations, shape (S, B, L + 1, O).
            distance: from tip to target, shape (S, B, L + 1), in [m].
            length: their actions, shape (S, B).
        """

        def flat(where: slice) -> Foreign:
            return seen[..., where].reshape(-1, where.stop - where.start)

        velocity, base = flat(TIP_VELOCITY), (flat(BASE_POSITION), flat(BASE_QUATERNION))
        holds: Foreign = self._task.on_target(cast(Foreign, distance.reshape(-1)), velocity, *base)
        rows = holds.view(-1, distance.shape[-1])[:, 1:]
        first = cast(Tensor, cast(Foreign, self._task.first_successes(rows))).view_as(length)
        return torch.where(first <= length, first, 0)
