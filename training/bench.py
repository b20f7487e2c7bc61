"""What an update costs, as a ratio against another implementation and against bare matrix products."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from backends.peers import MissingPeer, Peer
from cdcsr.observation import observation_size
from cdcsr.robot import Robot, load_robot
from cdcsr.tasks import make_task
from training.algorithms import ALGORITHMS
from training.collector import FinishedEpisode
from training.config import Learner, learner_for
from training.memory import Memory
from training.precision import bfloat16_products, products

_PRODUCTS = 50
"""Matrix products timed for every update: about as many operations."""
OWN = ("batd3", "td3", "clasp")
"""Algorithms whose updates are timed."""
_OURS = """
from training.bench import own_updates
run = own_updates()
"""
_SBX = """
import gymnasium, numpy, sbx
class Blank(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1, 1, ({observation},), numpy.float32)
    action_space = gymnasium.spaces.Box(-1, 1, ({action},), numpy.float32)
    def reset(self, **_):
        return numpy.zeros({observation}, numpy.float32), dict()
model = sbx.TD3("MlpPolicy", Blank(), learning_rate=1e-4, buffer_size=2000, batch_size=256,
                policy_kwargs=dict(net_arch=[256, 256, 256], n_critics=5))
model._setup_learn(1_000_000)
draw = numpy.random.default_rng(0)
for _ in range(1000):
    observation, following = draw.normal(size=(2, 1, {observation}))
    action = draw.uniform(-1, 1, (1, {action}))
    model.replay_buffer.add(observation, following, action, numpy.zeros(1), numpy.zeros(1), [dict()])
def run(updates):
    model.train(updates, 256)
"""


def update_speed(python: str, updates: int = 4, rounds: int = 40) -> dict[str, Any]:
    """Updates per second of BATD3, TD3 and CLASP with the paper's numbers (E = 5, Z = 2, 3 x 256, batch 256), and of
    other TD3s.

    Stable-baselines3 (a development dependency) and SBX (its sibling in JAX, optional) with n_critics = 5 and the same
    networks, all on random data of the paper's sizes, each in one thread, taking turns; medians over the rounds. An
    update includes drawing its batch. Where the processor multiplies faster in bfloat16, our updates and those of
    stable-baselines3 are timed that way as well. Times are the processor's, so that what other jobs do counts as little
    as it can.

    Args:
        python: an interpreter that has sbx-rl, if any; it runs in a process of its own.
        updates: in each turn; even, so that each turn has as many updates of the actor.
        rounds: turns of each.

    Returns:
        Updates per second; by algorithm in `ratio` and `sbx_ratio` ours to theirs, the latter None where there is no
        SBX; `product_gflops`, the rate of a 256 x 256 matrix product, over and over in the cache;
        `share_of_product_rate`, at which part of that rate our whole update runs, of BATD3; `bfloat16`, the same with
        products in bfloat16 (against what the others do by themselves, and `product_gflops` in float32; in
        `like_for_like` by algorithm ours to those of stable-baselines3 in bfloat16), or None.
    """
    torch.set_num_threads(1)
    robot = load_robot("paper")
    others = _stable_baselines()
    turns: dict[str, Callable[[int], float]] = {
        **{name: _own_time(own_updates(name)) for name in OWN},
        "stable_baselines3": _own_time(others),
        "product": _own_time(_matrix_product()),
    }
    if faster := bfloat16_products():
        turns |= {f"{name}_bfloat16": _own_time(own_updates(name, bfloat16=True)) for name in OWN}
        turns["stable_baselines3_bfloat16"] = _own_time(_in_bfloat16(others))
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(MissingPeer):
            setup = _SBX.format(observation=observation_size(robot), action=robot.num_cables)
            sbx = stack.enter_context(Peer(setup, python))
            turns["sbx"] = lambda count: sbx.run(count)[1]
        times: dict[str, list[float]] = {name: [] for name in turns}
        for turn in range(rounds + 1):
            for name, function in turns.items():
                taken = function(updates)
                if turn:  # the first turn only warms up
                    times[name].append(taken / updates)
    median = {name: float(np.median(values)) for name, values in times.items()}
    return {
        "stable_baselines3_updates_per_second": 1 / median["stable_baselines3"],
        "sbx_updates_per_second": 1 / median["sbx"] if "sbx" in median else None,
        "product_gflops": _product_rate(median) / 1e9,
        **_speeds(median, robot),
        "bfloat16": _speeds(median, robot, "_bfloat16") if faster else None,
    }


def _speeds(median: dict[str, float], robot: Robot, kind: str = "") -> dict[str, Any]:
    """What `update_speed` returns of our updates of one kind, from the seconds that everybody's take."""
    ours, others, sbx = {name: median[name + kind] for name in OWN}, median["stable_baselines3"], median.get("sbx")
    speeds: dict[str, Any] = {
        "updates_per_second": {name: 1 / time for name, time in ours.items()},
        "ratio": {name: others / time for name, time in ours.items()},
        "sbx_ratio": {name: sbx and sbx / time for name, time in ours.items()},
        "share_of_product_rate": update_flops(Learner(), robot) / ours["batd3"] / _product_rate(median),
    }
    if kind:
        speeds["like_for_like"] = {name: median["stable_baselines3" + kind] / time for name, time in ours.items()}
    return speeds


def _product_rate(median: dict[str, float]) -> float:
    """Floating-point operations per second of the matrix product."""
    return _PRODUCTS * 2 * 256**3 / median["product"]


def side_by_side(updates: int = 20, rounds: int = 12) -> float:
    """Speed of a run's updates beside those of another run, to its speed alone: two processes of one thread each.

    Wall times, one alone and both together taking turns; medians over the rounds.
    """
    alone, together = [], []
    with Peer(_OURS) as one, Peer(_OURS) as other:
        for turn in range(rounds + 1):
            single = one.run(updates)[0]
            for run in (one, other):
                run.start(updates)
            both = [run.taken()[0] for run in (one, other)]
            if turn:
                alone.append(single)
                together.append(np.mean(both))
    return float(np.median(alone) / np.median(together))


def update_flops(learner: Learner, robot: Robot) -> float:
    """Floating-point operations in the matrix products of one BATD3 update, a multiplication and an addition each.

    A row through a network takes two for every weight; to go back, as many for the gradient of the weights, and for
    that of the activations two for every weight but the first layer's (or all, if the inputs' gradient is wanted).
    """
    observation, cables = observation_size(robot) + 3 * (learner.features == "state+error"), robot.num_cables
    actor = _weights(observation, learner.hidden, cables)
    critic = _weights(observation + cables, learner.hidden, 1)
    into_actor, into_critic = observation * learner.hidden[0], (observation + cables) * learner.hidden[0]
    target = actor + 2 * learner.target_critics * critic  # the clone's action and the policy's are both valued
    critics = learner.critics * (3 * critic - into_critic)
    improve = 3 * actor - into_actor + learner.target_critics * 2 * critic
    return 2.0 * learner.batch_size * (target + critics + improve / learner.policy_delay)


def _weights(inputs: int, hidden: tuple[int, ...], outputs: int) -> int:
    widths = (inputs, *hidden, outputs)
    return sum(n * m for n, m in pairwise(widths))


def own_updates(name: str = "batd3", bfloat16: bool = False) -> Callable[[int], None]:
    """Does so many updates of an algorithm with the paper's numbers, on random data, each with a batch from the replay.

    Args:
        name: one of :data:`training.algorithms.ALGORITHMS`.
        bfloat16: with products in bfloat16.
    """
    torch.set_num_threads(1)
    robot, learner = load_robot("paper"), replace(learner_for(name, "paper"), bfloat16=bfloat16)
    algorithm = ALGORITHMS[name](robot, learner, torch.Generator().manual_seed(0))
    rng, cables = np.random.default_rng(0), robot.num_cables

    def clone(observations: NDArray[np.float64]) -> NDArray[np.float32]:
        return rng.uniform(-1, 1, (len(observations), cables)).astype(np.float32)

    memory = Memory(robot, learner, clone, make_task("reach"))
    for _ in range(4):
        observations, actions = rng.normal(size=(251, observation_size(robot))), rng.uniform(-1, 1, (250, cables))
        memory.add(FinishedEpisode(observations, actions, rng.random(250), True, True), rng)

    def run(updates: int) -> None:
        for _ in range(updates):
            algorithm.update(memory.sample(rng))

    return run


def _own_time(function: Callable[[int], None]) -> Callable[[int], float]:
    def run(count: int) -> float:
        start = time.thread_time()
        function(count)
        return time.thread_time() - start

    return run


def _in_bfloat16(function: Callable[[int], None]) -> Callable[[int], None]:
    def run(count: int) -> None:
        with products(Learner(bfloat16=True)):
            function(count)

    return run


def _stable_baselines() -> Callable[[int], None]:
    import gymnasium
    import stable_baselines3

    env = gymnasium.make("cdcsr/Reach-v0")
    policy = {"net_arch": [256, 256, 256], "n_critics": 5}
    other = stable_baselines3.TD3(
        "MlpPolicy", env, 1e-4, buffer_size=2000, batch_size=256, policy_kwargs=policy, device="cpu"
    )
    other._setup_learn(1_000_000)
    rng = np.random.default_rng(0)
    shape = env.observation_space.shape
    assert shape is not None
    for _ in range(1000):
        action = rng.random((1, 8)) * 2 - 1
        observation, following = rng.normal(size=(1, *shape)), rng.normal(size=(1, *shape))
        other.replay_buffer.add(observation, following, action, np.zeros(1), np.zeros(1), [{}])  # type: ignore[union-attr]

    def run(updates: int) -> None:
        other.train(gradient_steps=updates, batch_size=256)

    return run


def _matrix_product() -> Callable[[int], None]:
    a, b, c = torch.randn(256, 256), torch.randn(256, 256), torch.empty(256, 256)

    def run(updates: int) -> None:
        for _ in range(_PRODUCTS * updates):
            torch.mm(a, b, out=c)

    return run
