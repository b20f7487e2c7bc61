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

from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import observation_size
from training.algorithms.registry import ALGORITHMS
from training.bench.peer_process import MissingPeer, Peer
from training.config.run_config import Learner, learner_for
from training.experience.collector import FinishedEpisode
from training.experience.mixed_replay import MixedReplay
from training.networks.bfloat16 import has_fast_bfloat16, matrix_products

_PRODUCTS = 50
"""Matrix products timed for every update: about as many operations."""
OWN = ("batd3", "td3", "clasp")
"""Algorithms whose updates are timed."""
_BFLOAT16 = "_bfloat16"
"""Ends the name of what is timed with products in bfloat16."""
_OURS = """
from training.bench.trainer_speed import own_updates
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
        `updates_per_second` of ours, by algorithm, and `stable_baselines3_updates_per_second` and
        `sbx_updates_per_second` (None where there is no SBX); by algorithm in `ratio` and `sbx_ratio` ours to theirs;
        `product_gflops`, the rate of a 256 x 256 matrix product, over and over in the cache; `share_of_product_rate`,
        at which part of that rate our whole update runs, of BATD3. The same in `bfloat16`, of ours and of
        stable-baselines3 with products in bfloat16 (None where that is no faster): `ratio`, `sbx_ratio` and
        `share_of_product_rate` there are still to the others and to the product in float32; `like_for_like` and
        `share_of_own_product_rate` are to those in bfloat16.
    """
    torch.set_num_threads(1)
    robot = load_robot("paper")
    others = _stable_baselines()
    turns: dict[str, Callable[[int], float]] = {
        **{name: _own_time(own_updates(name)) for name in OWN},
        "stable_baselines3": _own_time(others),
        "product": _own_time(_matrix_product()),
    }
    if has_fast_bfloat16():
        turns |= {name + _BFLOAT16: _own_time(own_updates(name, bfloat16=True)) for name in OWN}
        turns["stable_baselines3" + _BFLOAT16] = _own_time(_in_bfloat16(others))
        turns["product" + _BFLOAT16] = _own_time(_in_bfloat16(_matrix_product()))
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
    return speeds(
        {name: float(np.median(values)) for name, values in times.items()},
        update_flops(Learner(), robot),
    )


def speeds(times: dict[str, float], flops: float) -> dict[str, Any]:
    """What `update_speed` returns, from the seconds each one's turn takes and the operations of a BATD3 update."""
    found = _speeds(times, flops, "")
    if "product" + _BFLOAT16 in times:
        alike = _speeds(
            {name: times.get(name + _BFLOAT16, time) for name, time in times.items()}, flops, ""
        )
        found["bfloat16"] = _speeds(times, flops, _BFLOAT16) | {
            "like_for_like": alike["ratio"],
            "share_of_own_product_rate": alike["share_of_product_rate"],
            **{
                name: alike[name]
                for name in ("stable_baselines3_updates_per_second", "product_gflops")
            },
        }
    return {"bfloat16": None} | found


def _speeds(times: dict[str, float], flops: float, kind: str) -> dict[str, Any]:
    """Those of our updates of one kind, to what the others do in float32."""
    ours, others, sbx = (
        {name: times[name + kind] for name in OWN},
        times["stable_baselines3"],
        times.get("sbx"),
    )
    product_rate = _PRODUCTS * 2 * 256**3 / times["product"]
    return {
        "updates_per_second": {name: 1 / time for name, time in ours.items()},
        "stable_baselines3_updates_per_second": 1 / others,
        "sbx_updates_per_second": sbx and 1 / sbx,
        "ratio": {name: others / time for name, time in ours.items()},
        "sbx_ratio": {name: sbx and sbx / time for name, time in ours.items()},
        "product_gflops": product_rate / 1e9,
        "share_of_product_rate": flops / ours["batd3"] / product_rate,
    }


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
    observation, cables = (
        observation_size(robot) + 3 * (learner.features == "state+error"),
        robot.num_cables,
    )
    actor = _weights(observation, learner.hidden, cables)
    critic = _weights(observation + cables, learner.hidden, 1)
    into_actor, into_critic = (
        observation * learner.hidden[0],
        (observation + cables) * learner.hidden[0],
    )
    target = (
        actor + 2 * learner.target_critics * critic
    )  # the clone's action and the policy's are both valued
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

    replay = MixedReplay(robot, make_task("reach"), learner, clone)
    for _ in range(4):
        observations, actions = (
            rng.normal(size=(251, observation_size(robot))),
            rng.uniform(-1, 1, (250, cables)),
        )
        replay.add(FinishedEpisode(observations, actions, rng.random(250), True, True), rng)

    def run(updates: int) -> None:
        for _ in range(updates):
            algorithm.update(replay.sample(rng))

    return run


def _own_time(function: Callable[[int], None]) -> Callable[[int], float]:
    def run(count: int) -> float:
        start = time.thread_time()
        function(count)
        return time.thread_time() - start

    return run


def _in_bfloat16(function: Callable[[int], None]) -> Callable[[int], None]:
    def run(count: int) -> None:
        with matrix_products(bfloat16=True):
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
