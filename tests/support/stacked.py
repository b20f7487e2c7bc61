"""The weights of this project's networks as the stacked layers of the reference update."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from training.algorithms.reference_update import Layer
from training.networks.actor import Actor
from training.networks.compiled_ensemble import Ensemble


def stacked_actor(actor: Actor) -> list[Layer]:
    """Copy an actor."""
    linears = [module for module in actor.net if isinstance(module, nn.Linear)]
    return [Layer(_leaf(x.weight.T[None]), _leaf(x.bias[None, None])) for x in linears]


def stacked_ensemble(ensemble: Ensemble, rows: Tensor) -> list[Layer]:
    """Copy an ensemble's parameters, or with its `rows.grad` their gradients."""
    layers = []
    for members in zip(*(ensemble.layers(row) for row in rows.detach()), strict=True):
        columns = zip(*((x.product, x.weight[-1], x.gain, x.shift) for x in members), strict=True)
        stacks = [torch.stack(column) for column in columns if column[0] is not None]
        layers.append(Layer(_leaf(stacks[0]), *(_leaf(x.unsqueeze(1)) for x in stacks[1:])))
    return layers


def _leaf(tensor: Tensor) -> Tensor:
    return tensor.detach().clone().requires_grad_()
