"""Rows that are collected on a device are the steps of the environment."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.plant import Parameters
from cdcsr.simulation.randomization import Randomization
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import observation_size, observe
from cdcsr.tasks.spaces import make_space
from cdcsr.tasks.starts import Starts
from tests.support.tiny import tiny_device_run
from training.config.learner import Practising
from training.device.beginnings import draw_states
from training.device.collector import POOL, DeviceCollector, Work
from training.device.doors import HostDoor
from training.device.networks import side_by_side, stacked_actor
from training.device.replay import DeviceReplay
from training.device.trial import DeviceTrial
from training.experience.replay import Replay
from training.measure.evaluation import evaluate
from training.networks.actor import Actor
from training.networks.mirror_symmetry import MirrorSymmetry
from training.policy import load_policy, shipped_policies
from training.run.device_parts import make_parts
from training.run.setup import Setup

PAPER, CPU = load_robot("paper"), torch.device("cpu")
RUNS, COPIES, ROWS = 2, 3, 400


class _Collected:
    """A collector with wild actors at a task, and an environment to compare it with."""

    def __init__(
        self, seeds: tuple[int, ...] = (0, 1), randomize: float = 0.0, **options: Any
    ) -> None:
        learner = Practising(num_envs=COPIES, exploration_noise=0.6, noise_hold=5)
        num, symmetry = len(seeds) * COPIES, bool(options.pop("symmetry", False))
        self.env = TaskVectorEnv(
            num, PAPER, space="workspace", frame_skip=10, autoreset_mode="Disabled", **options
        )
        self.door = HostDoor(make_simulation(PAPER, "mujoco", num), CPU)
        sizes = observation_size(PAPER), PAPER.num_cables
        shape = len(seeds), COPIES, ROWS
        empty = [Replay(1, *sizes, 0.99, 3) for _ in seeds]
        self.replay = DeviceReplay(shape, sizes, self.env.max_actions, 0.99, 3, empty, CPU)
        actors = []
        for seed in seeds:
            torch.manual_seed(seed)
            actors.append(Actor(PAPER, True, (8,), "relu", symmetry))
        self.layers = side_by_side([stacked_actor(x) for x in actors], CPU)
        work = Work(self.env.task, [self.env.space] * len(seeds), 10)
        self.states = draw_states(Starts(self.env.start, PAPER), seeds, POOL)
        plants = [Randomization(PAPER, 1, randomize, np.random.default_rng(s)) for s in seeds]
        self.plants = [each.draw(50) for each in plants if randomize]
        pools = self.replay, CPU, self.states, self.plants
        self.collector = DeviceCollector(self.door, work, learner, seeds, actors[0], *pools)

    def flat(self, name: str) -> NDArray[Any]:
        """Return one of the collector's tensors, a row for each copy of the engine."""
        return self.collector.tensors[name].flatten(0, 1).numpy().copy()

    def follow(self) -> None:
        """Give the environment the targets that the collector has drawn."""
        for name, rows in self.env._episodes.arrays().items():
            rows[:] = self.episodes(name)

    def episodes(self, name: str) -> NDArray[Any]:
        """Return numbers of the collector's episodes, a row for each copy of the engine."""
        runs = [self.collector.views(run)[f"episode.{name}"] for run in range(RUNS)]
        return torch.cat(runs).numpy()

    def begin(self, ids: NDArray[np.int64]) -> None:
        """Put copies of the environment to the beginnings that the collector has chosen."""
        run, simulation = ids // COPIES, self.env.simulation
        if self.plants:
            plant = self.collector.views(0)["plant"], self.collector.views(1)["plant"]
            row = torch.cat(plant).numpy()[ids]
            own = {
                name: np.stack([self.plants[r][name][i] for r, i in zip(run, row, strict=True)])
                for name in self.plants[0]
            }
            simulation.set_parameters(ids, Parameters(**own))
        if not self.states:
            simulation.reset(ids)
            return
        chosen = self.flat("chosen")[ids]
        states = [
            np.stack([self.states[r][part][i] for r, i in zip(run, chosen, strict=True)])
            for part in range(2)
        ]
        drift = [self.states[r].drift[i] for r, i in zip(run, chosen, strict=True)]
        np.testing.assert_allclose(self.episodes("drift")[ids], drift, atol=1e-7)
        states[0][:, 7:15] += simulation.plant.start_travel[ids]
        single = (part.astype(np.float32).astype(np.float64) for part in states)
        simulation.place(ids, *single)

    def close(self) -> None:
        self.env.close()
        self.door.close()


@pytest.mark.parametrize(
    "options",
    [
        {"max_steps": 400, "threshold": 0.45},
        {"max_steps": 400, "threshold": 0.45, "symmetry": True},
        {"task": make_task("capture-tumble", PAPER, threshold=0.8, speed=0.8, max_steps=400)},
        {"task": "follow-circle", "max_steps": 300, "threshold": 0.6},
        {"task": "follow-random", "max_steps": 200, "threshold": 0.6},
        {"reward": "dense", "max_steps": 300, "threshold": 0.4, "quiet": True},
        {"start": "anywhere", "max_steps": 300, "threshold": 0.45},
        {"start": "moving", "max_steps": 200, "threshold": 0.5, "randomize": 2.0},
        {"max_steps": 200, "threshold": 0.5, "randomize": 2.0},
    ],
)
def test_a_step_is_that_of_the_environment(options: dict[str, Any]) -> None:
    both = _Collected(**options)
    collector, env, counts = both.collector, both.env, np.zeros(2)
    collector.start(both.layers, None)
    env.reset(seed=0)
    both.begin(np.arange(env.num_envs))
    for step in range(2 * env.max_actions + 2):
        both.follow()
        ended = both.flat("last")
        seen = observe(env.simulation.state(), env.targets)
        np.testing.assert_allclose(both.flat("observation"), seen, rtol=1e-5, atol=1e-6)
        collector.step()
        _, reward, terminated, truncated, _ = env.step(both.flat("command"))
        pay = 1 if env.task.ends else 1 - Practising().discount
        stored = both.replay.tensors["reward"][step].flatten()[~ended]
        np.testing.assert_allclose(stored, (pay * reward)[~ended], atol=1e-6)
        for name, flags in (("last", terminated | truncated), ("terminated", terminated)):
            np.testing.assert_array_equal(both.flat(name), flags & ~ended)
        counts += [(terminated & ~ended).sum(), (truncated & ~ended).sum()]
        if ended.any():
            both.begin(np.flatnonzero(ended))
    assert counts[0] > 0 or not env.task.ends  # both kinds of end were seen
    assert counts[1] > 0
    totals = collector.tensors["episodes"].sum(), collector.tensors["diverged"].sum()
    assert totals == (counts.sum(), 0)
    both.close()


def test_stored_actions_are_those_of_the_mirror_image() -> None:
    both = _Collected(symmetry=True)
    both.collector.start(both.layers, None)
    for _ in range(5):
        both.collector.step()
    rows = both.replay.tensors
    image = MirrorSymmetry(PAPER)
    seen = rows["observation"][:5]
    torch.testing.assert_close(image(seen).observation, seen)  # an image is its own
    cables = image(both.collector.tensors["observation"]).cables
    assert len(set(cables[..., 0].flatten().tolist())) > 1  # some were mirrored
    both.close()


def test_episodes_that_diverge_are_dropped() -> None:
    both = _Collected(max_steps=400)
    collector, simulation = both.collector, both.door._simulation
    collector.start(both.layers, None)
    for step in range(60):
        if step == 20:
            snapshot = simulation.get_snapshot()
            snapshot.velocity[1, 0] = 1e9
            simulation.place([1], snapshot.position[1:2], snapshot.velocity[1:2])
        collector.step()
    assert collector.tensors["diverged"].tolist() == [1, 0]
    rows = both.replay.tensors
    begins = rows["begins"].flatten(1)[:60]
    assert not begins[:22, 1].any()
    assert begins[:20, [0, 2, 3, 4, 5]].all()
    assert rows["count"].tolist() == [int(x) for x in rows["begins"][:60].sum((0, 2))]
    assert torch.isfinite(rows["observation"]).all()
    both.close()


def test_a_learner_that_diverges_does_not_stop_those_beside_it() -> None:
    both = _Collected(max_steps=100)
    both.layers[0].weight.detach()[0] = torch.nan
    both.collector.start(both.layers, None)
    for _ in range(3):
        both.collector.step()
    # Its copies are lost, begin anew, and are lost again.
    assert both.collector.tensors["diverged"].tolist() == [2 * COPIES, 0]
    assert not both.replay.tensors["begins"][:3, 0].any()
    assert torch.isfinite(both.replay.tensors["observation"][:3]).all()
    both.close()


def test_a_run_collects_alone_what_it_collects_beside_others() -> None:
    both, alone = _Collected((0, 1), max_steps=100), _Collected((1,), max_steps=100)
    for each in (both, alone):
        each.collector.start(each.layers, None)
        for _ in range(30):
            each.collector.step()
        each.close()
    for name, rows in alone.replay.views(0, 30).items():
        torch.testing.assert_close(both.replay.views(1, 30)[name], rows)
    assert not torch.equal(
        both.replay.views(0, 30)["observation"], alone.replay.views(0, 30)["observation"]
    )
    for one in (both, alone):
        one.close()


@pytest.mark.parametrize(
    ("task", "start"),
    [
        ("reach", "still"),
        ("reach", "anywhere"),
        ("capture-drift", "moving"),
        ("follow-circle", "still"),
    ],
)
def test_a_trial_measures_what_an_evaluation_does(task: str, start: str) -> None:
    shipped = load_policy(shipped_policies()["batd3-spatter-mujoco"])
    own = evaluate(shipped, PAPER, "mujoco", "spatter", 20, 7, task=task, start=start)
    env = TaskVectorEnv(1, PAPER, space="spatter", task=task, centers=shipped.centers)
    door = HostDoor(make_simulation(PAPER, "mujoco", 40), CPU)
    other = make_space("anchor", PAPER)
    work, starts = Work(env.task, [env.space, other], 1), Starts(start, PAPER, 7)
    trial = DeviceTrial(door, work, 7, shipped.actor, CPU, starts)
    np.testing.assert_array_equal(trial.targets[0], own.targets)
    np.testing.assert_array_equal(trial.targets[1], other.sample(np_random(7)[0], 20))
    idle = deepcopy(shipped.actor)
    torch.nn.init.zeros_(idle.net[-1].weight)  # type: ignore[arg-type]
    layers = side_by_side([stacked_actor(shipped.actor), stacked_actor(idle)], CPU)
    for _ in range(2):  # a second trial begins anew
        outcome = trial.run(layers)
        np.testing.assert_array_equal(outcome.success[0], own.success)
        length = np.where(own.success, outcome.length[0], env.task.max_steps)
        np.testing.assert_array_equal(length, own.length)
        np.testing.assert_allclose(outcome.distance[0], own.distance, atol=1e-3)
        assert outcome.success[0].sum() > outcome.success[1].sum() or task != "reach"
    env.close()
    trial.close()


def test_a_batch_can_be_drawn_after_the_longest_episode(
    tmp_path: Path, demonstrations: Path
) -> None:
    """And after the step that ends it; at once where there are demonstrations enough."""
    for number, algorithm in enumerate(("td3", "td3wd")):
        config = tiny_device_run(tmp_path / algorithm, demonstrations, algorithm)
        parts = make_parts([Setup(config)], CPU)
        longest, ready = parts.learner.collector.longest, []
        for steps in (0, longest + 1, longest + 2):
            parts.learner.collector.resume(steps)
            ready.append(parts.learner.ready)
        assert ready == [bool(number), bool(number), True]
        parts.close()
