"""A replay of steps, for many copies of many runs at once; returns are computed when drawn.

:class:`training.experience.replay.Replay` stores episodes when they end. Here all copies store a
row at every step, so that nothing waits for an episode's end and no shape changes. What of an
episode is known only later (whether it is complete, and what followed an action until its end) is
written back to the rows of that episode as it goes on.

Shapes: S runs, N copies of each, T rows of each copy, B transitions; O numbers of an observation,
C cables.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from training.device.streams import Streams
from training.experience.replay import Batch, Replay

_TRIES = 8
"""How often a row is drawn until it begins a transition. Such rows are at least half of all."""


class Step(NamedTuple):
    """One step of all copies."""

    observation: Tensor
    """Before the action, (S, N, O)."""
    action: Tensor
    """(S, N, C), in [-1, 1]."""
    bc_action: Tensor
    """The behaviour clone's, (S, N, C), in [-1, 1]."""
    last: Tensor
    """(S, N): the observation is an episode's last, and no action counts."""
    terminated: Tensor
    """(S, N): the observation is an episode's last, and success ended it."""
    dropped: Tensor
    """(S, N): the observation is the last of an episode that diverged and must not be learned
    from."""


class DeviceReplay:
    """The last T steps of N copies of S runs, and rows that were there from the start.

    Args:
        shape: S, N and T.
        sizes: O and C.
        longest: the largest number of actions of an episode.
        discount: gamma.
        return_steps: n.
        prefilled: for each run the rows that were there from the start: they are kept for ever.
        device: where everything is.
    """

    def __init__(
        self,
        shape: tuple[int, int, int],
        sizes: tuple[int, int],
        longest: int,
        discount: float,
        return_steps: int,
        prefilled: list[Replay],
        device: torch.device,
    ) -> None:
        (runs, copies, steps), (observation, action) = shape, sizes
        self.shape, self.longest = shape, longest
        self.return_steps = return_steps
        rows = (steps, runs, copies)

        def zeros(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros(shape, dtype=dtype, device=device)

        self.tensors = {
            "observation": zeros(*rows, observation),
            "action": zeros(*rows, action),
            "bc_action": zeros(*rows, action),
            "reward": zeros(*rows),
            "outcome": zeros(*rows),
            "last": zeros(*rows, dtype=torch.bool),
            "terminated": zeros(*rows, dtype=torch.bool),
            "number": zeros(*rows, dtype=torch.int64),  # of the row in its episode, from zero
            "begins": zeros(*rows, dtype=torch.bool),  # a transition of a complete episode
            "time": zeros(dtype=torch.int64),
            "age": zeros(runs, copies, dtype=torch.int64),
            "count": zeros(runs, dtype=torch.int64),  # of rows that begin a transition
        }
        """All that changes, by name; `time` counts steps, `age` those of the current episode."""
        self.run = torch.arange(runs, device=device)[:, None]
        self._back = torch.arange(longest, device=device)
        self._ahead = torch.arange(return_steps, device=device)
        self.weights = discount ** torch.arange(max(longest, return_steps + 1), device=device)
        self._kept = _table(prefilled, device)
        self._num_kept = torch.tensor([_num(one) for one in prefilled], device=device)[:, None]

    @staticmethod
    def memory(shape: tuple[int, int, int], sizes: tuple[int, int]) -> float:
        """Return how many bytes the rows take that such a replay stores."""
        numbers = sizes[0] + 2 * sizes[1] + 2
        return math.prod(shape) * (4.0 * numbers + 8 + 3)

    def views(self, run: int, steps: int) -> dict[str, Tensor]:
        """Return what changes of one run, as views, by name; `time` is that of all runs.

        Args:
            run: its number.
            steps: how many were stored, as a number that waits for no device; later rows are empty.
        """
        one = {"time": (), "age": (run,), "count": (run,)}
        rows = slice(min(steps, self.shape[2])), run
        return {name: x[one.get(name, rows)] for name, x in self.tensors.items()}

    def write(self, step: Step) -> None:
        """Store what is known of a step before it is made."""
        rows = self.tensors
        row = (rows["time"] % self.shape[2])[None]
        rows["count"] -= rows["begins"].index_select(0, row)[0].sum(-1)
        for name in ("observation", "action", "bc_action", "last", "terminated"):
            rows[name].index_copy_(0, row, getattr(step, name)[None])
        rows["number"].index_copy_(0, row, rows["age"][None])
        for name in ("reward", "outcome", "begins"):
            rows[name].index_fill_(0, row, 0)
        # An episode is complete now: its rows before this one begin transitions.
        complete = (self._back[:, None, None] < rows["age"]) & step.last & ~step.dropped
        before = (rows["time"] - 1 - self._back) % self.shape[2]
        rows["begins"].index_copy_(0, before, rows["begins"].index_select(0, before) | complete)
        rows["count"] += complete.sum((0, 2))

    def finish(self, reward: Tensor) -> None:
        """Store the rewards of the step that was written, (S, N), and go on to the next.

        The reward of a row that is an episode's last is ignored.
        """
        rows = self.tensors
        time, age = rows["time"], rows["age"]
        row = (time % self.shape[2])[None]
        last = rows["last"].index_select(0, row)[0]
        rows["reward"].index_copy_(0, row, torch.where(last, 0.0, reward)[None])
        # The rows of the episode so far, this one first.
        own = (self._back[:, None, None] <= age) & ~last
        gain = torch.where(own, self.weights[: self.longest, None, None] * reward, 0.0)
        rows["outcome"].index_add_(0, (time - self._back) % self.shape[2], gain)
        age.copy_(torch.where(last, 0, age + 1))
        time += 1

    def sample(self, size: int, draws: Streams, kept_share: float | None = None) -> Batch:
        """Draw transitions uniformly, with replacement.

        Args:
            size: B.
            draws: draws the rows.
            kept_share: the share of B that comes from the rows that were there from the start; all
                of it while there are fewer others than B. None to draw from all rows alike.

        Returns:
            Tensors of shape (S, B, ...).
        """
        row, copy, found = self._drawn(size, draws)
        collected = self._transitions(row, copy, draws)
        if self._kept is None:
            return collected
        rows = draws.below(self._num_kept, size)
        kept = Batch(*(table[self.run, rows] for table in self._kept))
        ready = self.tensors["count"][:, None]
        if kept_share is None:
            own = draws.below(self._num_kept + ready, size) >= self._num_kept
        else:
            share = torch.arange(size, device=ready.device) < round(kept_share * size)
            own = (ready >= size) & ~share
        own = own & found
        return Batch(*(choose(own, a, b) for a, b in zip(collected, kept, strict=True)))

    def _drawn(self, size: int, draws: Streams) -> tuple[Tensor, Tensor, Tensor]:
        """Draw rows and their copies, and say which of them begin a transition, (S, B) each.

        Where all tries failed, another row of the batch stands in, if there is one.
        """
        (runs, copies, steps), rows = self.shape, self.tensors
        filled = rows["time"].clamp(1, steps)
        flat = rows["begins"].view(-1)
        tried = draws.below(copies * filled, _TRIES * size).view(runs, _TRIES, size)
        row, copy = tried // copies, tried % copies
        place = (row * runs + self.run[..., None]) * copies + copy
        begins = flat[place].to(torch.int8)
        first, found = begins.argmax(1, keepdim=True), begins.amax(1)
        row, copy = (x.gather(1, first).squeeze(1) for x in (row, copy))
        stand_in = found.argmax(1, keepdim=True).expand_as(row)
        row, copy = (torch.where(found > 0, x, x.gather(1, stand_in)) for x in (row, copy))
        return row, copy, found > 0

    def _transitions(self, row: Tensor, copy: Tensor, draws: Streams) -> Batch:
        """Return the transitions that begin at some rows of some copies."""
        steps, rows = self.shape[2], self.tensors
        # Up to n rewards ahead, until the episode's last row.
        ahead = (row[..., None] + self._ahead) % steps
        at = self.run[..., None], copy[..., None]
        going = (~rows["last"][ahead, *at]).to(torch.int64).cumprod(-1)
        weight = self.weights[: self.return_steps]
        reward = (rows["reward"][ahead, *at] * weight * going).sum(-1)
        num = going.sum(-1)
        end, own = (row + num) % steps, (self.run, copy)
        return Batch(
            observation=rows["observation"][row, *own],
            action=rows["action"][row, *own],
            reward=reward,
            discount=torch.where(rows["terminated"][end, *own], 0.0, self.weights[num]),
            next_observation=rows["observation"][end, *own],
            bc_action=rows["bc_action"][row, *own],
            next_bc_action=rows["bc_action"][end, *own],
            outcome=rows["outcome"][row, *own],
        )


def _table(prefilled: list[Replay], device: torch.device) -> Batch | None:
    """Return the transitions in some replays, (S, largest number, ...); None if there are none."""
    if not all(_num(one) for one in prefilled):
        return None
    most, tables = max(map(_num, prefilled)), []
    for one in prefilled:
        rows, begins = one.rows, one.rows["successor"][: one.size] >= 0
        after = rows["successor"][: one.size][begins]
        names = ("observation", "action", "reward", "discount")
        parts = {name: rows[name][: one.size][begins] for name in (*names, "bc_action", "outcome")}
        parts["next_observation"] = rows["observation"][after]
        parts["next_bc_action"] = rows["bc_action"][after]
        columns = []
        for name in Batch._fields:
            part = torch.from_numpy(parts[name])
            columns.append(part.new_zeros(most, *part.shape[1:]))
            columns[-1][: len(part)] = part
        tables.append(columns)
    return Batch(*(torch.stack(column).to(device) for column in zip(*tables, strict=True)))


def _num(replay: Replay) -> int:
    """Return how many rows of a replay begin a transition."""
    return int((replay.rows["successor"][: replay.size] >= 0).sum())


def choose(condition: Tensor, one: Tensor, other: Tensor) -> Tensor:
    """Choose rows of (S, B, ...) by a condition of shape (S, B)."""
    return torch.where(condition.view(*condition.shape, *[1] * (one.dim() - 2)), one, other)
