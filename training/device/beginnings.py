"""The states and plants in which the copies of a device begin their episodes.

An environment draws both when an episode begins. Here each run draws pools of them before, with a
generator of its seed, and an episode takes one of either at random, so that nothing is drawn, and
nothing comes from the host, while steps are made.

Shapes: S runs, N copies of each; copies of a run are neighbours among all S N of an engine. P
states and Q plants of a run; C cables.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from cdcsr.simulation.randomization import Drawn
from cdcsr.tasks.starts import Start, Starts
from training.device.doors import Door
from training.device.streams import Streams

PLANTS = 1_024
"""How many plants are drawn for a run."""


class Beginnings:
    """Give copies that begin an episode a state, if starts vary, and a plant, if it is random.

    Args:
        door: the engine's copies.
        runs: S.
        states: pools of starts for every run, or none if all begin at rest.
        plants: pools of plants for every run, or none if all are as described.
        device: where everything is.

    Attributes:
        tensors: all that changes, by name; S is the first axis of all but a count.
    """

    def __init__(
        self,
        door: Door,
        runs: int,
        states: Sequence[Start],
        plants: Sequence[Drawn],
        device: torch.device,
    ) -> None:
        self._door, self._shape = door, (runs, door.num // runs)
        self._run = torch.arange(runs, device=device)[:, None]
        self._every = torch.arange(door.num, device=device)
        self._states: list[Tensor] = []
        self._at: list[Tensor] = []
        self._travel: Tensor | None = None
        self.tensors: dict[str, Tensor] = {}
        if states:
            self._states = [_stack(parts, device) for parts in zip(*states, strict=True)]
            self._at = [
                torch.zeros(door.num, pool.shape[-1], device=device) for pool in self._states[:2]
            ]
            door.set_start_device(*self._at)
        self._delay: Tensor | None = None
        if plants:
            self._take_plants(plants, device)

    def _take_plants(self, plants: Sequence[Drawn], device: torch.device) -> None:
        """Hand the plants to the engine, but for late commands, which are kept here."""
        whole = {name: np.concatenate([each[name] for each in plants]) for name in plants[0]}
        delay = torch.from_numpy(whole.pop("command_delay")).to(device)
        drawn: Drawn = {name: rows.astype(np.float64) for name, rows in whole.items()}
        self._door.set_plants(drawn)
        short = np.maximum(-drawn["rest_length_offset"], 0.0)
        self._travel = torch.tensor(short, dtype=torch.float32, device=device)
        self._num = len(plants[0]["command_delay"])
        self.tensors["plant"] = torch.zeros(self._shape, dtype=torch.int64, device=device)
        if int(longest := delay.max()):
            self._delay = delay
            cables = self._door.robot.num_cables
            self.tensors["sent"] = torch.zeros(
                *self._shape, int(longest) + 1, cables, device=device
            )
            self.tensors["sent_count"] = torch.zeros((), dtype=torch.int64, device=device)

    @property
    def delays(self) -> bool:
        """Whether commands arrive late."""
        return self._delay is not None

    @property
    def drift(self) -> Tensor | None:
        """The velocities that targets share with their robots, (S, P, 3), in [m/s]."""
        return self._states[2] if self._states else None

    def choose(self, fresh: Tensor, chosen: Tensor, draws: Streams) -> None:
        """Choose how copies will begin that are put to the start next.

        Args:
            fresh: which copies, shape (S N,).
            chosen: the number of a state in the pool of its run, shape (S, N).
            draws: draws the plants.
        """
        if "plant" in self.tensors:
            drawn = draws.below(self._num, self._shape[1])
            plant = self.tensors["plant"]
            plant.copy_(torch.where(fresh.view(self._shape), drawn, plant))
        for rows, pool in zip(self._at, self._states[:2], strict=bool(self._at)):
            new = pool[self._run, chosen].flatten(0, 1)
            rows.copy_(torch.where(fresh[:, None], new, rows))
        if self._at and self._travel is not None:
            cables = slice(7, 7 + self._travel.shape[1])
            position, short = self._at[0], self._travel[self._rows()]
            position[:, cables] += torch.where(fresh[:, None], short, 0.0)

    def _rows(self) -> Tensor:
        """Return which of all S Q plants every copy has, shape (S N,)."""
        return (self.tensors["plant"] + self._num * self._run).flatten()

    def arriving(self, command: Tensor) -> Tensor:
        """Send commands, shape (S N, C), and return those that arrive in this time step."""
        assert self._delay is not None
        sent, count = self.tensors["sent"].flatten(0, 1), self.tensors["sent_count"]
        ring = sent.shape[1]
        sent.index_copy_(1, (count % ring)[None], command[:, None])
        arrived = sent[self._every, (count - self._delay[self._rows()]) % ring]
        count += 1
        return arrived

    def clear(self, fresh: Tensor) -> None:
        """Forget the commands under way to copies that have begun, shape (S N,)."""
        if self._delay is not None:
            self.tensors["sent"] *= ~fresh.view(self._shape)[..., None, None]

    def set_plants(self, fresh: Tensor | None = None) -> None:
        """Hand the plants of copies, shape (S N,), by default of all, to the engine."""
        if "plant" in self.tensors:
            every = torch.ones_like(self._every, dtype=torch.bool)
            self._door.change_plants(every if fresh is None else fresh, self._rows())


def draw_states(starts: Starts, seeds: Sequence[int], num: int) -> list[Start]:
    """Draw a pool of states for every run; none if all begin at rest."""
    if not starts.varies:
        return []
    # The generator itself draws the targets, and its first four children belong to other work.
    return [starts.draw(np.random.default_rng(seed).spawn(5)[4], num) for seed in seeds]


def _stack(parts: Sequence[np.ndarray], device: torch.device) -> Tensor:
    return torch.tensor(np.stack(parts), dtype=torch.float32, device=device)
