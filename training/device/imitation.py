"""Behaviour cloning of runs side by side; see :mod:`training.algorithms.bc`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from training.algorithms.reference_update import Activation, Layer, descend, output
from training.config.learner import Cloning
from training.device.graphs import Repeated
from training.device.networks import adam
from training.device.streams import Streams, keys

Progress = Callable[[int, float], None]


def imitate(
    layers: list[Layer],
    activation: Activation,
    learner: Cloning,
    shown: tuple[Tensor, Tensor],
    seeds: Sequence[int],
    purpose: int,
    progress: Progress,
) -> None:
    """Train the actors of S runs to do as they were shown.

    Args:
        layers: their networks, shape (S, 1, ...).
        activation: of the hidden layers.
        learner: the numbers.
        shown: encoded observations (N, F), and the actions (N, C) they should give.
        seeds: of the runs.
        purpose: tells these draws from others of the same seeds.
        progress: called with the number of the update and its mean loss.
    """
    device = shown[0].device
    draws, updates = Streams(keys(seeds, purpose), device), learner.bc_updates
    rate = torch.tensor(learner.bc_learning_rate, device=device)
    optimizer, loss = adam(layers, rate), torch.zeros((), device=device)
    done = torch.zeros((), device=device)

    def update() -> None:
        # The cosine schedule of torch.optim.lr_scheduler.CosineAnnealingLR, on the device.
        rate.copy_(learner.bc_learning_rate * (1 + torch.cos(done * (math.pi / updates))) / 2)
        rows = draws.below(len(shown[0]), learner.batch_size)
        found = torch.tanh(output(layers, shown[0][rows], activation))
        losses = (found - shown[1][rows]).square().mean((-1, -2))
        descend(optimizer, losses.sum())
        loss.copy_(losses.detach().mean())
        done.add_(1)

    repeated = Repeated(update, device)
    for number in range(1, updates + 1):
        repeated()
        if number % 100 == 0:
            progress(number, loss.item())
