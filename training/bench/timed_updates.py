"""The updates that `cdcsr bench trainer` times: ours, and those of other projects' TD3."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.catalogue import make_task
from cdcsr.tasks.observation import observation_size
from training.algorithms.batd3 import BATD3Numbers
from training.algorithms.registry import find_algorithm
from training.algorithms.td3 import BackboneNumbers
from training.experience.collector import FinishedEpisode
from training.experience.mixed_replay import MixedReplay

Updates = Callable[[int], object]
"""Makes a number of updates."""

PRODUCT_SIZE, PRODUCTS = 256, 50
"""Rows and columns of the matrices whose product is timed, and how many products are timed for each
update: together they take about as many operations."""
SBX = """
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
    model.replay_buffer.add(
        observation, following, action, numpy.zeros(1), numpy.zeros(1), [dict()]
    )
def run(updates):
    model.train(updates, 256)
"""
"""Code of a peer process that makes the updates of SBX, stable-baselines3's sibling in JAX."""


def own_updates(name: str = "batd3", bfloat16: bool = False) -> Updates:
    """Return what updates an algorithm with the paper's numbers, each time with a batch of random
    data from the replay buffer.

    Args:
        name: the algorithm.
        bfloat16: multiply matrices in bfloat16.
    """
    torch.set_num_threads(1)
    robot, entry = load_robot("paper"), find_algorithm(name)
    learner = entry.numbers().changed(bfloat16=bfloat16)
    assert entry.learner is not None
    assert isinstance(learner, BackboneNumbers)
    algorithm = entry.learner(robot, learner, torch.Generator().manual_seed(0))
    rng, cables = np.random.default_rng(0), robot.num_cables

    def clone(observations: NDArray[np.float64]) -> NDArray[np.float32]:
        return rng.uniform(-1, 1, (len(observations), cables)).astype(np.float32)

    replay = MixedReplay(robot, make_task("reach"), learner, clone)
    for _ in range(4):
        observations = rng.normal(size=(251, observation_size(robot)))
        actions = rng.uniform(-1, 1, (250, cables))
        replay.add(FinishedEpisode(observations, actions, rng.random(250), True, True), rng)

    def run(updates: int) -> None:
        for _ in range(updates):
            algorithm.update(replay.sample(rng))

    return run


def stable_baselines_updates() -> Updates:
    """Return what updates stable-baselines3's TD3 with five critics and the paper's networks.

    Raises:
        CdcsrError: stable-baselines3 is not installed.
    """
    try:
        import stable_baselines3
    except ModuleNotFoundError as error:
        raise CdcsrError(
            f"{error.name} is needed to compare with; install the development dependencies."
        ) from None
    import gymnasium

    env = gymnasium.make("cdcsr/Reach-v0")
    policy = {"net_arch": [256, 256, 256], "n_critics": 5}
    other = stable_baselines3.TD3(
        "MlpPolicy", env, 1e-4, buffer_size=2000, batch_size=256, policy_kwargs=policy, device="cpu"
    )
    other._setup_learn(1_000_000)
    assert other.replay_buffer is not None
    rng = np.random.default_rng(0)
    shape = env.observation_space.shape
    assert shape is not None
    for _ in range(1000):
        action = rng.random((1, 8)) * 2 - 1
        observation, following = rng.normal(size=(1, *shape)), rng.normal(size=(1, *shape))
        other.replay_buffer.add(observation, following, action, np.zeros(1), np.zeros(1), [{}])
    return lambda updates: other.train(gradient_steps=updates, batch_size=256)


def matrix_products() -> Updates:
    """Return what multiplies two matrices that stay in the cache, :data:`PRODUCTS` times an
    update."""
    shape = PRODUCT_SIZE, PRODUCT_SIZE
    a, b, c = torch.randn(shape), torch.randn(shape), torch.empty(shape)

    def run(updates: int) -> None:
        for _ in range(PRODUCTS * updates):
            torch.mm(a, b, out=c)

    return run


def update_flops(learner: BATD3Numbers, robot: Robot) -> float:
    """Return the floating-point operations in the matrix products of one BATD3 update.

    A multiplication and an addition count as two. A row through a network takes two operations for
    every weight. The way back takes two more for the gradient of each weight, and two for that of
    the activations: for every weight but the first layer's, or for all if the gradient of the
    inputs is wanted.
    """
    error = 3 * (learner.features == "state+error")
    observation, cables = observation_size(robot) + error, robot.num_cables
    actor = _count_weights(observation, learner.hidden, cables)
    critic = _count_weights(observation + cables, learner.hidden, 1)
    first_of_actor = observation * learner.hidden[0]
    first_of_critic = (observation + cables) * learner.hidden[0]
    # The target values two actions: the clone's and the policy's.
    target = actor + 2 * learner.target_critics * critic
    critics = learner.critics * (3 * critic - first_of_critic)
    improve = 3 * actor - first_of_actor + learner.target_critics * 2 * critic
    return 2.0 * learner.batch_size * (target + critics + improve / learner.policy_delay)


def _count_weights(inputs: int, hidden: tuple[int, ...], outputs: int) -> int:
    return sum(n * m for n, m in pairwise((inputs, *hidden, outputs)))
