"""Collect episodes on a device: N copies of each of S runs act, and every step is stored.

Shapes: O numbers of an observation, C cables. Copies of a run are neighbours in an engine's
arrays. A copy whose episode has ended stores one more row, the episode's last observation; its
action is ignored, and it begins a new episode with that step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cdcsr.envs.episodes import Episodes
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Simulation
from cdcsr.simulation.randomization import Drawn
from cdcsr.simulation.state import State
from cdcsr.tasks.catalogue import actions_per_episode
from cdcsr.tasks.observation import observation_size, observe, tip_distance
from cdcsr.tasks.spaces import Space
from cdcsr.tasks.starts import Start
from cdcsr.tasks.target_motion import make_motion
from cdcsr.tasks.task import Task
from training.algorithms.reference_update import Layer, output
from training.config.learner import Practising
from training.device.beginnings import Beginnings
from training.device.doors import Door, Foreign, restore
from training.device.graphs import Repeated
from training.device.replay import DeviceReplay, Step
from training.device.streams import Streams, keys
from training.experience.collector import exploration_noise
from training.networks.actor import Actor

POOL = 16_384
"""How many targets are drawn for a run, with the generator of its seed. Every episode takes one of
them at random, so that nothing is drawn while steps are made."""
_PURPOSE = 1


@dataclass(frozen=True)
class Work:
    """The work that all copies do.

    Attributes:
        task: with the time between actions.
        spaces: where the targets of each run are drawn.
        frame_skip: simulation steps for each action.
    """

    task: Task
    spaces: Sequence[Space]
    frame_skip: int


class DeviceCollector:
    """Let copies act with exploration noise, and store what they do.

    Args:
        door: the engine's copies, S times N.
        work: the task.
        learner: the numbers of exploration.
        seeds: of the runs.
        module: an actor whose encoder, symmetry and servo range are those of all runs.
        replay: gets every step.
        device: where everything is.
        states: pools of POOL starts for every run; none if episodes begin at rest.
        plants: pools of plants for every run; none if all are as described.

    Attributes:
        tensors: all that changes besides the engine, the replay and the random numbers.
    """

    def __init__(
        self,
        door: Door,
        work: Work,
        learner: Practising,
        seeds: Sequence[int],
        module: Actor,
        replay: DeviceReplay,
        device: torch.device,
        states: Sequence[Start] = (),
        plants: Sequence[Drawn] = (),
    ) -> None:
        self.door, self._work, self._module, self._replay = door, work, module, replay
        self._state = door.device_state()
        robot, runs, copies = door.robot, len(seeds), learner.num_envs
        self._shape = runs, copies
        self._actions = actions_per_episode(work.task.max_steps, work.frame_skip)
        self._step = robot.time_step
        self._episodes = Episodes(runs * copies, work.task, work.spaces[0], bool(states))
        self._beginnings = Beginnings(door, runs, states, plants, device)
        self._episodes.convert(lambda array: as_tensor(array, device))
        self.draws = Streams(keys(seeds, _PURPOSE), device)
        self._pool = _pool(work, seeds, device)
        self._run = torch.arange(runs, device=device)[:, None]
        self._scale = as_tensor(exploration_noise(learner), device)[None, :, None]
        self._hold, self._copy = learner.noise_hold, torch.arange(copies, device=device)
        self._endless = not work.task.ends and work.task.reward_kind == "sparse"
        self._arrived = torch.zeros(runs * copies, robot.num_cables, device=device)
        self._pay = 1 - learner.discount if self._endless else 1.0
        self.tensors = self._zeros(robot, device)
        self.clone: list[Layer] | None = None
        self._actor: list[Layer] = []
        self._steps = 0

    def _zeros(self, robot: Robot, device: torch.device) -> dict[str, Tensor]:
        rows, size = self._shape, observation_size(robot)
        floats = {
            "observation": (*rows, size),
            "noise": (*rows, robot.num_cables),
            "command": (*rows, robot.num_cables),
        }
        flags, totals = ("last", "terminated", "dropped"), ("episodes", "successes", "diverged")
        return {
            **{name: torch.zeros(shape, device=device) for name, shape in floats.items()},
            **{name: torch.zeros(rows, dtype=torch.bool, device=device) for name in flags},
            **{name: torch.zeros(rows[0], dtype=torch.int64, device=device) for name in totals},
            "chosen": torch.zeros(rows, dtype=torch.int64, device=device),
            "count": torch.zeros((), dtype=torch.int64, device=device),
        }

    @property
    def longest(self) -> int:
        """The largest number of actions of an episode."""
        return self._actions

    @property
    def steps(self) -> int:
        """How many steps every copy has made, which waits for no device."""
        return self._steps

    def views(self, run: int) -> dict[str, Tensor]:
        """Return what changes of one run, as views, by name; two counts are those of all runs."""
        own = self.tensors | self._beginnings.tensors
        found = {name: x[run] if x.dim() else x for name, x in own.items()}
        for name, rows in cast(dict[str, Tensor], self._episodes.arrays()).items():
            found[f"episode.{name}"] = rows.view(*self._shape, *rows.shape[1:])[run]
        return found | {"drawn": self.draws.drawn}

    def start(self, actor: list[Layer], clone: list[Layer] | None) -> None:
        """Let all copies begin an episode.

        Args:
            actor: of every run, shape (S, 1, ...); it may change with every step.
            clone: of every run, a network of tanh, if the method has one.
        """
        self._actor, self.clone = actor, clone
        device = self.tensors["observation"].device
        self._before, self._after, self._send = (
            Repeated(x, device) for x in (self._act, self._judge, self._delay)
        )
        everyone = torch.ones(self.door.num, dtype=torch.bool, device=device)
        self._choose(everyone)
        self._beginnings.set_plants()
        self.door.reset_device(everyone)
        self._restart(everyone)
        self._look()

    def resume(self, steps: int) -> None:
        """Go on after so many steps; :meth:`start` was called, and then the state put back."""
        self._steps = steps

    def restore(self, simulation: Simulation, arrays: Mapping[str, NDArray[np.float64]]) -> None:
        """Put the engine back, after the tensors, to what :func:`snapshot_arrays` returned."""
        self._beginnings.set_plants()
        restore(simulation, self.door, arrays)

    def step(self) -> None:
        """Take one action in every copy."""
        self._steps += 1
        self._before()
        fresh, skip = self._flat("last"), self._work.frame_skip
        self._beginnings.set_plants(fresh)
        if self._beginnings.delays:
            for left in reversed(range(skip)):
                self._send()
                self.door.step_device(self._arrived, 1, None if left else fresh)
        else:
            self.door.step_device(self.tensors["command"].flatten(0, 1), skip, fresh)
        self._after()

    def _delay(self) -> None:
        """Find the commands that arrive in a time step."""
        self._arrived.copy_(self._beginnings.arriving(self.tensors["command"].flatten(0, 1)))

    @torch.no_grad()
    def _act(self) -> None:
        """Choose an action for every copy, and store what is known before it is taken."""
        with self.draws.together("act"):
            self._explore()

    def _explore(self) -> None:
        now, module = self.tensors, self._module
        seen, cables = now["observation"], None
        if module.mirror_symmetry is not None:
            seen, cables = module.mirror_symmetry(seen)
        encoded = module.encoder(seen)
        action = torch.tanh(output(self._actor, encoded))
        clone = torch.zeros_like(action)
        if self.clone is not None:
            clone = torch.tanh(output(self.clone, encoded, torch.tanh))
        if cables is not None:  # noise is on the robot's own cables
            action = action.gather(-1, cables)
        fresh = ((self._copy + now["count"]) % self._hold == 0)[None, :, None]
        drawn = self.draws.normal(now["noise"]) * self._scale
        now["noise"].copy_(torch.where(fresh, drawn, now["noise"]))
        now["count"] += 1
        action = (action + now["noise"]).clamp(-1, 1)
        now["command"].copy_(module.to_command(action))
        stored = action if cables is None else action.gather(-1, cables)
        flags = now["last"], now["terminated"], now["dropped"]
        self._replay.write(Step(seen, stored, clone, *flags))
        self._choose(self._flat("last"))

    @torch.no_grad()
    def _judge(self) -> None:
        """See what the actions led to, and begin the episodes of copies that ended before."""
        now, episodes, task = self.tensors, self._episodes, self._work.task
        state = cast(State, self._state)
        # Copies that ended before stand at the start now, and so do those that just diverged,
        # which end with this action.
        ended, lost = self._flat("last").clone(), self._state.diverged.clone()
        episodes.advance(self._work.frame_skip, self._step)
        distance, verdict = (cast(Foreign, x) for x in episodes.judge(state))
        verdict = verdict.without(ended | lost)
        reward = torch.where(
            ended | lost, 0.0, cast(Foreign, task.reward(distance, verdict.rewarded))
        )
        self._replay.finish(self._pay * reward.view(self._shape))
        late = cast(Foreign, episodes.actions_taken) >= self._actions
        done = ~ended & (verdict.terminated | late | lost)
        for name, flags in ("last", done), ("terminated", verdict.terminated), ("dropped", lost):
            self._flat(name).copy_(flags)
        finished = (done & ~lost).view(self._shape)
        now["episodes"] += finished.sum(-1)
        now["successes"] += (finished & verdict.success.view(self._shape)).sum(-1)
        now["diverged"] += lost.view(self._shape).sum(-1)
        self._restart(ended)
        self._look()

    def _choose(self, fresh: Tensor) -> None:
        """Choose targets, states and plants for copies that the next step puts to the start."""
        self.tensors["chosen"].copy_(self.draws.below(POOL, self._shape[1]))
        self._beginnings.choose(fresh, self.tensors["chosen"], self.draws)

    def _restart(self, fresh: Tensor) -> None:
        """Give copies at the start their targets."""
        chosen, drift = self.tensors["chosen"], self._beginnings.drift
        tables = [*self._pool, *([] if drift is None else [drift])]
        begun = [table[self._run, chosen].flatten(0, 1) for table in tables]
        self._episodes.restart(cast(Foreign, fresh), *cast(Foreign, begun))
        self._beginnings.clear(fresh)

    def _look(self) -> None:
        """Observe the state as it is."""
        state, targets = cast(State, self._state), self._episodes.targets
        seen = cast(Foreign, observe(state, targets, tip_distance(state, targets)))
        self.tensors["observation"].copy_(seen.view(*self._shape, -1))

    def _flat(self, name: str) -> Tensor:
        """Return one of the flags in the engine's order, shape (S N,)."""
        return self.tensors[name].view(-1)


def _pool(work: Work, seeds: Sequence[int], device: torch.device) -> tuple[Tensor, ...]:
    """Draw targets and their motions for every run: shapes (S, POOL, ...)."""
    motion, drawn = make_motion(work.task.motion, work.task.size, work.task.pace), []
    for seed, space in zip(seeds, work.spaces, strict=True):
        rng = np.random.default_rng(seed)
        place = space.sample(rng, POOL)
        drawn.append((place, *motion.begin(rng, place)))
    return tuple(as_tensor(np.stack(parts), device) for parts in zip(*drawn, strict=True))


def as_tensor(array: NDArray[np.generic], device: torch.device) -> Tensor:
    """Return an array as a tensor; numbers that are not whole in single precision."""
    kind = torch.float32 if array.dtype.kind == "f" else None
    return torch.tensor(array, dtype=kind, device=device)
