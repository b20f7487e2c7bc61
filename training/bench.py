"""What an update costs, as a ratio against another implementation and against bare matrix products."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch

from cdcsr.robot import load_robot
from cdcsr.tasks import observation_size
from training.algorithms import BATD3
from training.config import Learner
from training.replay import Batch


def update_speed(updates: int = 40, rounds: int = 5) -> dict[str, float]:
    """Updates per second of BATD3 as in the paper (E = 5, Z = 2, 3 x 256, batch 256) and of stable-baselines3's TD3.

    Both on random data of the paper's sizes, with n_critics = 5 and the same networks there, in one thread of one
    process, taking turns; medians over the rounds. Stable-baselines3 is a development dependency.

    Args:
        updates: in each turn.
        rounds: turns of each.
    """
    torch.set_num_threads(1)
    ours, theirs, product = _ours(), _stable_baselines(), _matrix_product()
    times: dict[str, list[float]] = {"ours": [], "stable_baselines3": [], "product": []}
    for turn in range(rounds + 1):
        for name, function in (("ours", ours), ("stable_baselines3", theirs), ("product", product)):
            start = time.perf_counter()
            function(updates)
            if turn:  # the first turn only warms up
                times[name].append((time.perf_counter() - start) / updates)
    median = {name: float(np.median(values)) for name, values in times.items()}
    return {
        "updates_per_second": 1 / median["ours"],
        "stable_baselines3_updates_per_second": 1 / median["stable_baselines3"],
        "ratio": median["stable_baselines3"] / median["ours"],
        "product_gflops": 2 * 256**3 / median["product"] / 1e9,
    }


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
    )

    def run(updates: int) -> None:
        for _ in range(updates):
            algorithm.update(batch)

    return run


def _stable_baselines() -> Callable[[int], None]:
    import gymnasium
    from stable_baselines3 import TD3 as Other

    env = gymnasium.make("cdcsr/Reach-v0")
    policy = {"net_arch": [256, 256, 256], "n_critics": 5}
    other = Other("MlpPolicy", env, 1e-4, buffer_size=2000, batch_size=256, policy_kwargs=policy, device="cpu")
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
    a, b = torch.randn(256, 256), torch.randn(256, 256)

    def run(times: int) -> None:
        for _ in range(times):
            a @ b

    return run
