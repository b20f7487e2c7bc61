"""An ensemble of ReLU networks in one tensor, with its backward pass written out.

The arithmetic is that of `nn.Linear` and autograd; what is saved is everything around the matrix products. One
tensor holds all members, so an optimizer or a soft update is one call. A member goes forward and back while its
activations are still in the cache, and they are written to the same room every time: none outlives a call, so
there is nothing that a later call could spoil.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

_LINE = 16
"""Numbers in a cache line; rows and members begin at one."""
_EPS = 1e-5
"""As in `nn.LayerNorm`."""


class Layer(NamedTuple):
    """One layer of one member: views, of its parameters or of their gradients."""

    weight: Tensor
    """(n + 1, m): its last row is the bias, for an input that is always 1."""
    gain: Tensor | None
    """(m,) of LayerNorm, or None."""
    shift: Tensor | None
    """(m,) of LayerNorm, or None."""


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
        self.widths = (inputs, *hidden, 1)
        self.layer_norm = layer_norm
        self._pieces: list[int] = []  # sizes of weight, gain, shift, weight, ... in a member's row
        for n, m in zip(self.widths[:-1], self.widths[1:], strict=True):
            self._pieces += [(n + 1) * m, m, m] if layer_norm else [(n + 1) * m]
        if layer_norm:
            del self._pieces[-2:]  # no LayerNorm on the output
        self._pieces.append(-sum(self._pieces) % _LINE)
        self.parameters_by_member = nn.Parameter(torch.zeros(num, sum(self._pieces)))
        self._room: _Room | None = None
        with torch.no_grad():
            for row in self.parameters_by_member:
                self._initialize(row)

    def _initialize(self, row: Tensor) -> None:
        for layer in self.layers(row):
            n, m = len(layer.weight) - 1, layer.weight.shape[1]
            linear = nn.Linear(n, m)
            layer.weight[:-1] = linear.weight.T
            layer.weight[-1] = linear.bias
            if layer.gain is not None:
                layer.gain.fill_(1)

    def layers(self, row: Tensor) -> list[Layer]:
        """A member's row of `parameters_by_member`, or of its gradient, as layers: views, not copies."""
        pieces, step, last = row.split(self._pieces), 3 if self.layer_norm else 1, len(self.widths) - 2
        layers = []
        for i, n in enumerate(self.widths[:-1]):
            at, norm = i * step, self.layer_norm and i < last
            weight = pieces[at].view(n + 1, self.widths[i + 1])
            layers.append(Layer(weight, pieces[at + 1] if norm else None, pieces[at + 2] if norm else None))
        return layers

    def forward(self, inputs: Tensor, members: Sequence[int] | None = None) -> Tensor:
        """Outputs, differentiable in `inputs` (and not in the parameters).

        Args:
            inputs: shape (B, n).
            members: which, Z of them; None for all.

        Returns:
            Shape (E, B), or (Z, B).
        """
        chosen = range(len(self.parameters_by_member)) if members is None else members
        return _Values.apply(inputs, self, chosen)  # type: ignore[no-any-return]

    @torch.no_grad()
    def regress(self, inputs: Tensor, target: Tensor) -> Tensor:
        """Set the parameters' gradient to that of the members' mean squared errors, summed over members.

        What was in `.grad` is overwritten.

        Args:
            inputs: shape (B, n).
            target: shape (B,), for every member.

        Returns:
            Outputs, shape (E, B).
        """
        parameters, room = self.parameters_by_member, self._take_room(inputs)
        if parameters.grad is None:
            parameters.grad = torch.zeros_like(parameters)
        values = inputs.new_empty(len(parameters), len(inputs))
        for value, row, gradient in zip(values, parameters, parameters.grad, strict=True):
            layers = self.layers(row)
            _forward(layers, room, value)
            _backward(layers, room, (value - target) * (2 / len(target)), self.layers(gradient))
        return values

    def _take_room(self, inputs: Tensor) -> _Room:
        room = self._room
        if room is None or len(room.inputs) != len(inputs) or room.inputs.dtype != inputs.dtype:
            room = self._room = _Room(self.widths, self.layer_norm, inputs)
        room.inputs[:, :-1] = inputs
        return room

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_room": None}  # a copy of the module gets room of its own


class _Values(torch.autograd.Function):
    """Outputs of some members. Each depends on its own row of inputs only, so its slope is known at once."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, ensemble: Ensemble, members: Sequence[int]) -> Tensor:
        room = ensemble._take_room(inputs)
        values = inputs.new_empty(len(members), len(inputs))
        slopes = inputs.new_empty(len(members), *inputs.shape) if ctx.needs_input_grad[0] else None
        for i, member in enumerate(members):
            layers = ensemble.layers(ensemble.parameters_by_member[member])
            _forward(layers, room, values[i])
            if slopes is not None:
                delta = _backward(layers, room, torch.ones_like(values[i]))
                torch.mm(delta, layers[0].weight[:-1].T, out=slopes[i])
        ctx.save_for_backward(slopes)
        return values

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        (slopes,) = ctx.saved_tensors
        return torch.einsum("zb,zbn->bn", gradient, slopes), None, None


class _Room:
    """Where activations and their gradients are written, for one size of batch; members take turns.

    Attributes:
        inputs: shape (B, n + 1), the last column 1, as is that of
        hidden: the activations of each hidden layer, shape (B, m + 1).
        before: with LayerNorm, what goes into it, shape (B, m); else views of `hidden` without the ones.
        after: `hidden` without the ones, shape (B, m).
        delta: gradients with respect to `before`, shape (B, m); every other one shares its memory.
        moments: with LayerNorm, mean and inverse deviation.
    """

    def __init__(self, widths: Sequence[int], layer_norm: bool, like: Tensor) -> None:
        rows, hidden = len(like), widths[1:-1]
        self.inputs = like.new_ones(rows, widths[0] + 1)
        self.hidden = [like.new_ones(rows, m + _LINE)[:, : m + 1] for m in hidden]
        self.after = [h[:, :-1] for h in self.hidden]
        self.before = [like.new_empty(rows, m) for m in hidden] if layer_norm else self.after
        pair = [like.new_empty(rows * max(hidden)) for _ in range(2)]
        self.delta = [pair[i % 2][: rows * m].view(rows, m) for i, m in enumerate(hidden)]
        self.moments: list[tuple[Tensor, Tensor]] = [(like, like)] * len(hidden)


def _forward(layers: list[Layer], room: _Room, value: Tensor) -> None:
    """From `room.inputs` to `value`, shape (B,)."""
    below = room.inputs
    for i, (weight, gain, shift) in enumerate(layers[:-1]):
        torch.mm(below, weight, out=room.before[i])
        if gain is None:
            room.after[i].relu_()
        else:
            normal, *moments = torch.native_layer_norm(room.before[i], gain.shape, gain, shift, _EPS)
            room.moments[i] = (moments[0], moments[1])
            torch.clamp_min(normal, 0, out=room.after[i])
        below = room.hidden[i]
    torch.mv(below, layers[-1].weight[:, 0], out=value)


def _backward(layers: list[Layer], room: _Room, slope: Tensor, gradients: list[Layer] | None = None) -> Tensor:
    """From the gradient with respect to `value`, shape (B,), right after `_forward`, to that of the first product.

    Gradients of parameters are written to `gradients`, if given.
    """
    top = len(room.hidden) - 1
    delta = torch.mul(slope[:, None], layers[-1].weight[:-1, 0], out=room.delta[top])
    if gradients is not None:
        torch.mv(room.hidden[top].T, slope, out=gradients[-1].weight[:, 0])
    for i in range(top, -1, -1):
        weight, gain, shift = layers[i]
        torch.ops.aten.threshold_backward.grad_input(delta, room.after[i], 0, grad_input=delta)
        if gain is not None:
            mask = [True, gradients is not None, gradients is not None]
            delta, *others = torch.ops.aten.native_layer_norm_backward(
                delta, room.before[i], gain.shape, *room.moments[i], gain, shift, mask
            )
            if gradients is not None:
                gradients[i].gain.copy_(others[0])  # type: ignore[union-attr]
                gradients[i].shift.copy_(others[1])  # type: ignore[union-attr]
        if gradients is not None:
            torch.mm((room.hidden[i - 1] if i else room.inputs).T, delta, out=gradients[i].weight)
        if i:
            delta = torch.mm(delta, weight[:-1].T, out=room.delta[i - 1])
    return delta
