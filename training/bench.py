"""What an update costs, as a ratio against another implementation and against bare matrix products."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import torch

from cdcsr.robot import Robot, load_robot
from cdcsr.tasks import observation_size
from training.algorithms import BATD3
from training.config import Learner
from training.replay import Batch

_PRODUCTS = 50
"""Matrix products timed for every update: about as many operations."""


def update_speed(updates: int = 4, rounds: int = 40) -> dict[str, float]:
    """Updates per second of BATD3 as in the paper (E = 5, Z = 2, 3 x 256, batch 256) and of stable-baselines3's TD3.

    Both on random data of the paper's sizes, with n_critics = 5 and the same networks there, in one thread of one
    process, taking turns; medians over the rounds. Times are the thread's own, so that what other jobs do with
    the machine counts as little as it can. Stable-baselines3 is a development dependency.

    Args:
        updates: in each turn; even, so that each turn has as many updates of the actor.
        rounds: turns of each.

    Returns:
        Updates per second; `ratio`, ours to theirs; `product_gflops`, the rate of a 256 x 256 matrix product, over
        and over in the cache; and `share_of_product_rate`, at which part of that rate our whole update runs.
    """
    torch.set_num_threads(1)
    ours, theirs, product = _ours(), _stable_baselines(), _matrix_product()
    times: dict[str, list[float]] = {"ours": [], "stable_baselines3": [], "product": []}
    for turn in range(rounds + 1):
        for name, function in (("ours", ours), ("stable_baselines3", theirs), ("product", product)):
            start = time.thread_time()
            function(updates)
            if turn:  # the first turn only warms up
                times[name].append((time.thread_time() - start) / updates)
    median = {name: float(np.median(values)) for name, values in times.items()}
    product_rate = _PRODUCTS * 2 * 256**3 / median["product"]
    return {
        "updates_per_second": 1 / median["ours"],
        "stable_baselines3_updates_per_second": 1 / median["stable_baselines3"],
        "ratio": median["stable_baselines3"] / median["ours"],
        "product_gflops": product_rate / 1e9,
        "share_of_product_rate": update_flops(Learner(), load_robot("paper")) / median["ours"] / product_rate,
    }


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


def _ours() -> Callable[[int], None]:
    robot = load_robot("paper")
    generator = torch.Generator().manual_seed(0)
    algorithm = BATD3(robot, Learner(), generator)
    size, cables = observation_size(robot), robot.num_cables
    batch = Batch(
        torch.randn(256, size),
        torch.rand(256, cables) * 2 - 1,
        torch.rand(256),
        torch.full((256,), 0.99),
        torch.randn(256, size),
        torch.rand(256, cables) * 2 - 1,
        torch.rand(256, cables) * 2 - 1,
    )

    def run(updates: int) -> None:
        for _ in range(updates):
            algorithm.update(batch)

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
