"""An ensemble of ReLU networks in one tensor, with its backward pass written out.

The arithmetic is that of `nn.Linear` and autograd; what is saved is everything around the matrix products. One
tensor holds all members, so an optimizer or a soft update is one call. A member goes forward and back while its
activations are still in the cache, and they are written to the same room every time: none outlives a call, so
there is nothing that a later call could spoil. Between two products, compiled kernels do the rest in one pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from training.networks.ensemble_kernels import (
    Floats,
    back_head,
    back_normalize,
    back_rectify,
    head,
    normalize,
    rectify,
)

_LINE = 16  # numbers in a cache line; members begin at one
_BLOCK = 256  # rows that go through a member at a time where no row needs another


class Layer(NamedTuple):
    """One layer of one member: views, of its parameters or of their gradients.

    Attributes:
        weight: shape (n + 1, m); its last row is the bias.
        product, back: the weight without the bias, shape (n, m), and transposed, (m, n).
        gain, shift: of LayerNorm, shape (m,), or None.
        small: bias, and gain and shift if there are, for the kernels; of the output, its weights as well.
    """

    weight: Tensor
    product: Tensor
    back: Tensor
    gain: Tensor | None
    shift: Tensor | None
    small: list[Floats]


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
        self.rows = nn.Parameter(
            torch.zeros(num, sum(self._sizes))
        )  # all parameters, a row for each member
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
            norm = (
                (next(pieces), next(pieces))
                if self.layer_norm and i < len(self.widths) - 2
                else (None, None)
            )
            small = [part.detach().numpy() for part in (weight[-1], *norm) if part is not None]
            if i == len(self.widths) - 2:
                small.append(weight.detach().numpy()[:-1, 0])
            layers.append(Layer(weight, weight[:-1], weight[:-1].T, *norm, small))
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
        inputs = inputs.contiguous()
        room = self._room_for(inputs)
        if not room.gradients:
            room.gradient = torch.zeros_like(self.rows)
            room.gradients = [self.layers(row) for row in room.gradient]
        values = inputs.new_empty(len(self.rows), len(inputs))
        wanted, share = target.numpy(), 2 / len(target)
        for value, layers, gradients in zip(
            values.numpy(), room.layers, room.gradients, strict=True
        ):
            _forward(layers, room, inputs, value)
            delta = _backward(layers, room, (value - wanted) * share, gradients)
            torch.mm(inputs.T, delta, out=gradients[0].product)
        self.rows.grad = room.gradient
        return values

    def _room_for(self, inputs: Tensor) -> _Room:
        key = (
            self.rows.data_ptr(),
            len(inputs),
            inputs.dtype,
        )  # the room's views keep the address from being reused
        if self._room is None or self._room.key != key:
            self._room = _Room(self, inputs, key)
        return self._room

    def __getstate__(self) -> dict[str, Any]:
        return {
            **self.__dict__,
            "_room": None,
        }  # a copy of this module must not write to the room of this one


class _Values(torch.autograd.Function):
    """Outputs of some members. Each depends on its own row of inputs only, so its slope is known at once."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, ensemble: Ensemble, members: Sequence[int]) -> Tensor:
        inputs = inputs.contiguous()
        values = inputs.new_empty(len(members), len(inputs))
        slopes = inputs.new_empty(len(members), *inputs.shape) if ctx.needs_input_grad[0] else None
        for begin in range(0, len(inputs), _BLOCK):
            rows = slice(begin, begin + _BLOCK)
            part = inputs[rows]
            room, ones = ensemble._room_for(part), part.new_ones(len(part)).numpy()
            for i, member in enumerate(members):
                layers = room.layers[member]
                _forward(layers, room, part, values.numpy()[i, rows])
                if slopes is not None:
                    torch.mm(_backward(layers, room, ones), layers[0].back, out=slopes[i, rows])
        ctx.save_for_backward(slopes)
        return values

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, None, None]:  # type: ignore[override]
        (slopes,) = ctx.saved_tensors
        return (grad_outputs[0].unsqueeze(-1) * slopes).sum(0), None, None


class _Room:
    """Where members, in turn, write their activations and gradients; with the views of them made once.

    Attributes:
        key: where the parameters are, and the number of rows and type of the inputs, that it is for.
        layers: the parameters of each member.
        gradient, gradients: the parameters' gradient, and its layers by member; made when first needed.
        before: what each hidden layer's product is written to, shape (B, m); then, with LayerNorm, what it has
            before gain and shift.
        after: the activations; without LayerNorm the same as `before`.
        delta: gradients with respect to either, shape (B, m).
        inverse: with LayerNorm, the inverse standard deviations.
        unused, unused_head: for gradients that nobody wants.
    """

    def __init__(
        self, ensemble: Ensemble, inputs: Tensor, key: tuple[int, int, torch.dtype]
    ) -> None:
        self.key, rows, hidden = key, len(inputs), ensemble.widths[1:-1]
        self.layers = [ensemble.layers(row) for row in ensemble.rows.detach()]
        self.gradient: Tensor | None = None
        self.gradients: list[list[Layer]] = []
        self.before = [inputs.new_empty(rows, m) for m in hidden]
        self.after = (
            [inputs.new_empty(rows, m) for m in hidden] if ensemble.layer_norm else self.before
        )
        pair = [
            inputs.new_empty(rows * max(hidden)) for _ in range(2)
        ]  # going back, only the last is needed
        self.delta = [pair[i % 2][: rows * m].view(rows, m) for i, m in enumerate(hidden)]
        self.inverse = [inputs.new_empty(rows).numpy() for _ in hidden]
        self.unused = [[inputs.new_empty(m).numpy() for _ in range(3)] for m in hidden]
        self.unused_head = [inputs.new_empty(m).numpy() for m in (1, hidden[-1])]
        # The same memory, as the kernels take it.
        self.before_floats, self.after_floats, self.delta_floats = (
            [tensor.numpy() for tensor in tensors]
            for tensors in (self.before, self.after, self.delta)
        )


def _forward(layers: list[Layer], room: _Room, inputs: Tensor, value: Floats) -> None:
    """From inputs to `value`, shape (B,)."""
    below = inputs
    for i, layer in enumerate(layers[:-1]):
        torch.mm(below, layer.product, out=room.before[i])
        if layer.gain is None:
            rectify(room.before_floats[i], layer.small[0])
        else:
            bias, gain, shift = layer.small
            normalize(
                room.before_floats[i], bias, gain, shift, room.inverse[i], room.after_floats[i]
            )
        below = room.after[i]
    bias, weight = layers[-1].small
    head(room.after_floats[-1], weight, bias, value)


def _backward(
    layers: list[Layer], room: _Room, slope: Floats, gradients: list[Layer] | None = None
) -> Tensor:
    """From the gradient of `value`, right after `_forward`, to that of the first product.

    Fills `gradients`, but for the first product's.
    """
    last = room.unused_head if gradients is None else gradients[-1].small
    back_head(
        slope, room.after_floats[-1], layers[-1].small[1], room.delta_floats[-1], last[1], last[0]
    )
    delta = room.delta[-1]
    for i in range(len(layers) - 2, -1, -1):
        if i < len(layers) - 2:
            if gradients is not None:
                torch.mm(room.after[i].T, delta, out=gradients[i + 1].product)
            delta = torch.mm(delta, layers[i + 1].back, out=room.delta[i])
        small = room.unused[i] if gradients is None else gradients[i].small
        if layers[i].gain is None:
            back_rectify(room.delta_floats[i], room.after_floats[i], small[0])
        else:
            back_normalize(
                room.delta_floats[i],
                room.before_floats[i],
                room.after_floats[i],
                room.inverse[i],
                layers[i].small[1],
                small[0],
                small[1],
                small[2],
            )
    return delta
