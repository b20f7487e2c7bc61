"""Behaviour cloning: supervised learning of the demonstrations (BATD3 paper, section III-B)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from cdcsr.robot.description import Robot
from training.config.learner import Cloning
from training.networks.actor import Actor

Progress = Callable[[int, float], None]


class BehaviourCloning:
    """The mean network of a Gaussian policy of fixed width: eq. (4) is the mean squared error.

    Args:
        robot: the description.
        learner: the learner's numbers.
        generator: draws the batches.
    """

    def __init__(self, robot: Robot, learner: Cloning, generator: torch.Generator) -> None:
        self.learner = learner
        self.actor = Actor(
            robot, learner.features == "state+error", learner.hidden, "tanh", learner.symmetry
        )
        self._generator = generator

    def actions(self, observations: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the clone's actions in [-1, 1]: (n, observation size) -> (n, C)."""
        with torch.no_grad():
            return self.actor.act(torch.as_tensor(observations, dtype=torch.float32)).numpy()

    def fit(self, observations: Tensor, commands: Tensor, progress: Progress) -> None:
        """Train on all pairs, then freeze; see :func:`imitate`."""
        imitate(self.actor, self.learner, observations, commands, self._generator, progress)
        self.actor.requires_grad_(False)


def pairs(actor: Actor, observations: Tensor, commands: Tensor) -> tuple[Tensor, Tensor]:
    """Return the inputs of an actor, (N, F), and the actions in [-1, 1] it should give, (N, C).

    Args:
        actor: the network.
        observations: shape (N, observation size).
        commands: the demonstrator's set-points, shape (N, C), in [m].
    """
    wanted = actor.from_command(commands)
    if actor.mirror_symmetry is not None:
        observations, cables = actor.mirror_symmetry(observations)
        wanted = wanted.gather(-1, cables)
    return actor.encoder(observations), wanted


def imitate(
    actor: Actor,
    learner: Cloning,
    observations: Tensor,
    commands: Tensor,
    generator: torch.Generator,
    progress: Progress,
) -> None:
    """Train an actor to do as it was shown.

    Args:
        actor: the network.
        learner: the learner's numbers.
        observations: shape (N, observation size).
        commands: the demonstrator's set-points, shape (N, C), in [m].
        generator: draws the batches.
        progress: called with the number of the update and its loss.
    """
    encoded, wanted = pairs(actor, observations, commands)
    updates = learner.bc_updates
    optimizer = torch.optim.Adam(actor.parameters(), lr=learner.bc_learning_rate, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    for update in range(1, updates + 1):
        chosen = torch.randint(len(encoded), (learner.batch_size,), generator=generator)
        loss = functional.mse_loss(actor(encoded[chosen]), wanted[chosen])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if update % 100 == 0:
            progress(update, loss.item())
