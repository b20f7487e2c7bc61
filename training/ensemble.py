"""An ensemble of ReLU networks in one tensor, with its backward pass written out.

The arithmetic is that of `nn.Linear` and autograd; what is saved is everything around the matrix products. One
tensor holds all members, so an optimizer or a soft update is one call. A member goes forward and back while its
activations are still in the cache, and they are written to the same room every time: none outlives a call, so
there is nothing that a later call could spoil.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

_LINE = 16  # numbers in a cache line; rows and members begin at one
_EPS = 1e-5  # as in nn.LayerNorm


class Layer(NamedTuple):
    """One layer of one member: views, of its parameters or of their gradients.

    Attributes:
        weight: shape (n + 1, m); its last row is the bias, for an input that is always 1.
        back: shape (m, n), the weight without the bias, transposed.
        gain, shift: of LayerNorm, shape (m,), or None.
    """

    weight: Tensor
    back: Tensor
    gain: Tensor | None
    shift: Tensor | None


class Ensemble(nn.Module):
    """E networks of one shape with one output each: linear layers, LayerNorm if wanted, ReLU.

    `forward` is differentiable in its inputs only; `regress` is how parameters get a gradient. Not for use by
    several threads at once.

    Args:
        inputs: width of the input.
        hidden: widths of the hidden layers.
        num: E.
        layer_norm: normalise before each ReLU.
    """

    def __init__(self, inputs: int, hidden: Sequence[int], num: int, layer_norm: bool) -> None:
        super().__init__()
        self.widths, self.layer_norm = (inputs, *hidden, 1), layer_norm
        self._sizes: list[int] = []  # of weight, gain, shift, weight, gain, ... in a member's row
        for n, m in pairwise(self.widths):
            self._sizes += [(n + 1) * m, m, m] if layer_norm else [(n + 1) * m]
        if layer_norm:
            del self._sizes[-2:]  # none on the output
        self._sizes.append(-sum(self._sizes) % _LINE)
        self.rows = nn.Parameter(torch.zeros(num, sum(self._sizes)))  # all parameters, a row for each member
        self._room: _Room | None = None
        with torch.no_grad():
            for row in self.rows:
                for layer in self.layers(row):
                    linear = nn.Linear(len(layer.weight) - 1, layer.weight.shape[1])
                    layer.weight.copy_(torch.vstack([linear.weight.T, linear.bias]))
                    if layer.gain is not None:
                        layer.gain.fill_(1)

    def layers(self, row: Tensor) -> list[Layer]:
        """One of `rows`, or of their gradient, as layers."""
        pieces, layers = iter(row.split(self._sizes)), []
        for i, (n, m) in enumerate(pairwise(self.widths)):
            weight = next(pieces).view(n + 1, m)
            norm = (next(pieces), next(pieces)) if self.layer_norm and i < len(self.widths) - 2 else (None, None)
            layers.append(Layer(weight, weight[:-1].T, *norm))
        return layers

    def forward(self, inputs: Tensor, members: Sequence[int] | None = None) -> Tensor:
        """Outputs of all members, or of Z of them, at inputs of shape (B, n): shape (E, B), or (Z, B)."""
        return _Values.apply(inputs, self, range(len(self.rows)) if members is None else members)

    @torch.no_grad()
    def regress(self, inputs: Tensor, target: Tensor) -> Tensor:
        """Set the parameters' gradient to that of the members' mean squared errors, summed over members.

        What was in `.grad` is overwritten. Inputs have shape (B, n), the target, the same for all members, (B,);
        returns the outputs, shape (E, B).
        """
        room = self._room_for(inputs)
        if not room.gradients:
            room.gradient = torch.zeros_like(self.rows)
            room.gradients = [self.layers(row) for row in room.gradient]
        values = inputs.new_empty(len(self.rows), len(inputs), 1)
        for value, layers, gradients in zip(values, room.layers, room.gradients, strict=True):
            _forward(layers, room, value)
            _backward(layers, room, (value - target[:, None]).mul_(2 / len(target)), gradients)
        self.rows.grad = room.gradient
        return values.squeeze(-1)

    def _room_for(self, inputs: Tensor) -> _Room:
        """With `inputs` in it."""
        key = (self.rows.data_ptr(), inputs.shape, inputs.dtype)  # the room's views keep the address from being reused
        if self._room is None or self._room.key != key:
            self._room = _Room(self, inputs, key)
        self._room.inputs[:, :-1] = inputs
        return self._room

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_room": None}  # a copy of this module must not write to the room of this one


class _Values(torch.autograd.Function):
    """Outputs of some members. Each depends on its own row of inputs only, so its slope is known at once."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, ensemble: Ensemble, members: Sequence[int]) -> Tensor:
        room = ensemble._room_for(inputs)
        values = inputs.new_empty(len(members), len(inputs), 1)
        slopes = inputs.new_empty(len(members), *inputs.shape) if ctx.needs_input_grad[0] else None
        ones = inputs.new_ones(len(inputs), 1)
        for i, member in enumerate(members):
            layers = room.layers[member]
            _forward(layers, room, values[i])
            if slopes is not None:
                torch.mm(_backward(layers, room, ones), layers[0].back, out=slopes[i])
        ctx.save_for_backward(slopes)
        return values.squeeze(-1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, None, None]:  # type: ignore[override]
        (slopes,) = ctx.saved_tensors
        return (grad_outputs[0].unsqueeze(-1) * slopes).sum(0), None, None


class _Room:
    """Where members, in turn, write their activations and gradients; with the views of them made once.

    Attributes:
        key: where the parameters are, and the shape and type of the inputs, that it is for.
        layers: the parameters of each member.
        gradient, gradients: the parameters' gradient, and its layers by member; made when first needed.
        inputs: shape (B, n + 1), the last column 1, as is that of
        hidden: the activations of each hidden layer, shape (B, m + 1).
        after: `hidden` without the ones, shape (B, m).
        before: with LayerNorm, what goes into it, shape (B, m); else the same as `after`.
        moments: with LayerNorm, its means and inverse deviations.
        delta: gradients with respect to `before`, shape (B, m).
        below: what goes into each layer, transposed.
    """

    def __init__(self, ensemble: Ensemble, inputs: Tensor, key: tuple[int, torch.Size, torch.dtype]) -> None:
        self.key, rows, hidden = key, len(inputs), ensemble.widths[1:-1]
        self.layers = [ensemble.layers(row) for row in ensemble.rows.detach()]
        self.gradient: Tensor | None = None
        self.gradients: list[list[Layer]] = []
        self.inputs = inputs.new_ones(rows, inputs.shape[1] + 1)
        self.hidden = [inputs.new_ones(rows, m + _LINE)[:, : m + 1] for m in hidden]
        self.after = [h[:, :-1] for h in self.hidden]
        self.before = [inputs.new_empty(rows, m) for m in hidden] if ensemble.layer_norm else self.after
        self.moments: list[tuple[Tensor, Tensor]] = [(inputs, inputs)] * len(hidden)
        pair = [inputs.new_empty(rows * max(hidden)) for _ in range(2)]  # going back, only the last is needed
        self.delta = [pair[i % 2][: rows * m].view(rows, m) for i, m in enumerate(hidden)]
        self.below = [self.inputs.T, *[h.T for h in self.hidden]]


def _forward(layers: list[Layer], room: _Room, value: Tensor) -> None:
    """From `room.inputs` to `value`, shape (B, 1)."""
    below = room.inputs
    for i, (weight, _, gain, shift) in enumerate(layers[:-1]):
        torch.mm(below, weight, out=room.before[i])
        if gain is None:
            room.after[i].relu_()
        else:
            normal, mean, deviation = torch.native_layer_norm(room.before[i], gain.shape, gain, shift, _EPS)
            room.moments[i] = mean, deviation
            torch.clamp_min(normal, 0, out=room.after[i])
        below = room.hidden[i]
    torch.mm(below, layers[-1].weight, out=value)


def _backward(layers: list[Layer], room: _Room, slope: Tensor, gradients: list[Layer] | None = None) -> Tensor:
    """From the gradient of `value`, right after `_forward`, to that of the first product; fills `gradients`."""
    delta, learn = slope, gradients is not None
    for i in range(len(layers) - 1, -1, -1):
        if i < len(layers) - 1:
            torch.ops.aten.threshold_backward.grad_input(delta, room.after[i], 0, grad_input=delta)
            if (gain := layers[i].gain) is not None:
                delta, dgain, dshift = torch.ops.aten.native_layer_norm_backward(
                    delta, room.before[i], gain.shape, *room.moments[i], gain, layers[i].shift, [True, learn, learn]
                )
                if gradients is not None:
                    gradients[i].gain.copy_(dgain)  # type: ignore[union-attr]
                    gradients[i].shift.copy_(dshift)  # type: ignore[union-attr]
        if gradients is not None:
            torch.mm(room.below[i], delta, out=gradients[i].weight)
        if i:
            delta = torch.mm(delta, layers[i].back, out=room.delta[i - 1])
    return delta
