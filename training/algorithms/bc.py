"""Behaviour cloning: supervised learning of the demonstrations (BATD3 paper, section III-B)."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional

from cdcsr.robot import Robot
from training.config import Learner
from training.networks import Actor


class BehaviourCloning:
    """The mean network of a Gaussian policy of fixed width: eq. (4) is the mean squared error.

    Args:
        robot: the description.
        learner: the learner's numbers.
        generator: draws the batches.
    """

    def __init__(self, robot: Robot, learner: Learner, generator: torch.Generator) -> None:
        self.learner = learner
        self.actor = Actor(robot, learner.features == "state+error", learner.hidden, "tanh")
        self._generator = generator

    def fit(self, observations: Tensor, commands: Tensor, progress: Callable[[int, float], None]) -> None:
        """Train on all pairs, then freeze.

        Args:
            observations: shape (N, 23 + C).
            commands: the demonstrator's set-points, shape (N, C), in [m].
            progress: called with the number of the update and its loss.
        """
        encoded = self.actor.encoder(observations)
        wanted = self.actor.from_command(commands)
        updates = self.learner.bc_updates
        optimizer = torch.optim.Adam(self.actor.parameters(), lr=self.learner.bc_learning_rate, fused=True)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
        for update in range(1, updates + 1):
            chosen = torch.randint(len(encoded), (self.learner.batch_size,), generator=self._generator)
            loss = functional.mse_loss(self.actor(encoded[chosen]), wanted[chosen])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            if update % 100 == 0:
                progress(update, loss.item())
        self.actor.requires_grad_(False)
