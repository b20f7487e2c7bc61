"""The networks of runs side by side, as the stacked layers of the reference update."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from training.algorithms.reference_update import Layer, parameters
from training.networks.actor import Actor
from training.networks.compiled_ensemble import Ensemble


def stacked_actor(actor: Actor) -> list[Layer]:
    """Copy an actor: a stack of one."""
    return [Layer(_leaf(x.weight.T[None]), _leaf(x.bias[None, None])) for x in _linears(actor)]


def stacked_ensemble(ensemble: Ensemble, rows: Tensor) -> list[Layer]:
    """Copy an ensemble's parameters, or with its `rows.grad` their gradients."""
    layers = []
    for members in zip(*(ensemble.layers(row) for row in rows.detach()), strict=True):
        columns = zip(*((x.product, x.weight[-1], x.gain, x.shift) for x in members), strict=True)
        stacks = [torch.stack(column) for column in columns if column[0] is not None]
        layers.append(Layer(_leaf(stacks[0]), *(_leaf(x.unsqueeze(1)) for x in stacks[1:])))
    return layers


def side_by_side(stacks: Sequence[list[Layer]], device: torch.device) -> list[Layer]:
    """Join the stacks of S runs: their tensors get a first axis of S."""
    joined = []
    for layers in zip(*stacks, strict=True):
        columns = [column for column in zip(*layers, strict=True) if column[0] is not None]
        joined.append(Layer(*(_leaf(torch.stack(column).to(device)) for column in columns)))
    return joined


@torch.no_grad()
def copied(layers: list[Layer]) -> list[Layer]:
    """Return other tensors with the same numbers, which nothing learns."""
    return [Layer(*(x.detach().clone() for x in layer if x is not None)) for layer in layers]


@torch.no_grad()
def write_actor(layers: list[Layer], run: int, actor: Actor) -> None:
    """Give an actor the weights of one of the runs."""
    for layer, linear in zip(layers, _linears(actor), strict=True):
        linear.weight.copy_(layer.weight[run, 0].T)
        linear.bias.copy_(layer.bias[run, 0, 0])


def adam(layers: list[Layer], rate: float | Tensor) -> torch.optim.Adam:
    """Return the optimizer of a stack, with its state made, which checkpoints read and write; on a
    GPU a CUDA graph can repeat its steps."""
    weights = parameters(layers)
    optimizer = torch.optim.Adam(weights, lr=rate, fused=True, capturable=weights[0].is_cuda)
    for weight in weights:
        optimizer.state[weight] = {
            "step": torch.zeros((), device=weight.device),
            "exp_avg": torch.zeros_like(weight),
            "exp_avg_sq": torch.zeros_like(weight),
        }
    return optimizer


def _linears(actor: Actor) -> list[nn.Linear]:
    return [module for module in actor.net if isinstance(module, nn.Linear)]


def _leaf(tensor: Tensor) -> Tensor:
    return tensor.detach().clone().requires_grad_()
