"""An ensemble of ReLU networks in one tensor, with its backward pass written out.

The arithmetic is that of `nn.Linear` and autograd, as in
:mod:`training.algorithms.reference_update`; what is saved is everything around the matrix
products. One tensor holds all members, so that an optimizer step or a soft update is one call.
A member goes forward and back while its activations are still in the cache. Activations are
always written to the same buffers and never outlive a call. Between two matrix products a
compiled kernel does the rest in one pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.autograd.function import BackwardCFunction, once_differentiable

from training.networks.ensemble_kernels import (
    Floats,
    back_head,
    back_normalize,
    back_rectify,
    head,
    normalize,
    rectify,
)

_CACHE_LINE = 16
"""Numbers in a cache line; each member begins at one."""
_BLOCK = 256
"""Rows that go through a member at a time where rows do not depend on each other."""


class Layer(NamedTuple):
    """One layer of one member: views of its parameters, or of their gradients.

    Attributes:
        weight: shape (n + 1, m); the last row is the bias.
        product, back: the weight without the bias, shape (n, m), and transposed, (m, n).
        gain, shift: of LayerNorm, shape (m,), or None.
        small: for the kernels the bias, then gain and shift if there are any; for the output
            layer the bias and its weights.
    """

    weight: Tensor
    product: Tensor
    back: Tensor
    gain: Tensor | None
    shift: Tensor | None
    small: list[Floats]


class Ensemble(nn.Module):
    """E networks of one shape with one output each: linear layers, optional LayerNorm, ReLU.

    `forward` is differentiable in its inputs only; `regress` computes the gradient of the
    parameters. An ensemble must not be used by several threads at once.

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
            del self._sizes[-2:]  # the output is not normalised
        self._sizes.append(-sum(self._sizes) % _CACHE_LINE)
        self.rows = nn.Parameter(torch.zeros(num, sum(self._sizes)))
        """All parameters, one row for each member."""
        self._buffers_in_use: _Buffers | None = None
        with torch.no_grad():
            for row in self.rows:
                for layer in self.layers(row):
                    linear = nn.Linear(len(layer.weight) - 1, layer.weight.shape[1])
                    layer.weight.copy_(torch.vstack([linear.weight.T, linear.bias]))
                    if layer.gain is not None:
                        layer.gain.fill_(1)

    def layers(self, row: Tensor) -> list[Layer]:
        """Return the layers of one member as views of its row of `rows`, or of their gradient."""
        pieces, layers = iter(row.split(self._sizes)), []
        last = len(self.widths) - 2
        for i, (n, m) in enumerate(pairwise(self.widths)):
            weight = next(pieces).view(n + 1, m)
            normalised = self.layer_norm and i < last
            norm = (next(pieces), next(pieces)) if normalised else (None, None)
            small = [part.detach().numpy() for part in (weight[-1], *norm) if part is not None]
            if i == last:
                small.append(weight.detach().numpy()[:-1, 0])
            layers.append(Layer(weight, weight[:-1], weight[:-1].T, *norm, small))
        return layers

    def forward(self, inputs: Tensor, members: Sequence[int] | None = None) -> Tensor:
        """Return the outputs of all members, or of Z of them: (B, n) -> (E, B), or (Z, B)."""
        return _Values.apply(inputs, self, range(len(self.rows)) if members is None else members)

    @torch.no_grad()
    def regress(self, inputs: Tensor, target: Tensor) -> Tensor:
        """Set the gradient of the parameters to that of the squared errors.

        The loss is each member's mean squared error, summed over members. `rows.grad` is
        overwritten.

        Args:
            inputs: shape (B, n).
            target: shape (B,), the same for every member.

        Returns:
            Outputs, shape (E, B).
        """
        inputs = inputs.contiguous()
        buffers = self._buffers_for(inputs)
        if not buffers.gradients:
            buffers.gradient = torch.zeros_like(self.rows)
            buffers.gradients = [self.layers(row) for row in buffers.gradient]
        values = inputs.new_empty(len(self.rows), len(inputs))
        wanted, share = target.numpy(), 2 / len(target)
        members = zip(values.numpy(), buffers.layers, buffers.gradients, strict=True)
        for value, layers, gradients in members:
            _forward(layers, buffers, inputs, value)
            delta = _backward(layers, buffers, (value - wanted) * share, gradients)
            torch.mm(inputs.T, delta, out=gradients[0].product)
        self.rows.grad = buffers.gradient
        return values

    def _buffers_for(self, inputs: Tensor) -> _Buffers:
        # The views inside the buffers keep the address of `rows` from being used again.
        key = (self.rows.data_ptr(), len(inputs), inputs.dtype)
        if self._buffers_in_use is None or self._buffers_in_use.key != key:
            self._buffers_in_use = _Buffers(self, inputs, key)
        return self._buffers_in_use

    def __getstate__(self) -> dict[str, object]:
        # A copy of this module must not write to this module's buffers.
        return {**self.__dict__, "_buffers_in_use": None}


class _Values(torch.autograd.Function):
    """Compute the outputs of some members.

    An output depends on its own row of inputs only, so the forward pass can find its derivative.
    """

    @staticmethod
    def forward(
        ctx: BackwardCFunction, inputs: Tensor, ensemble: Ensemble, members: Sequence[int]
    ) -> Tensor:
        inputs = inputs.contiguous()
        values = inputs.new_empty(len(members), len(inputs))
        slopes = inputs.new_empty(len(members), *inputs.shape) if ctx.needs_input_grad[0] else None
        for begin in range(0, len(inputs), _BLOCK):
            rows = slice(begin, begin + _BLOCK)
            part = inputs[rows]
            buffers, ones = ensemble._buffers_for(part), part.new_ones(len(part)).numpy()
            for i, member in enumerate(members):
                layers = buffers.layers[member]
                _forward(layers, buffers, part, values.numpy()[i, rows])
                if slopes is not None:
                    delta = _backward(layers, buffers, ones)
                    torch.mm(delta, layers[0].back, out=slopes[i, rows])
        if slopes is not None:
            ctx.save_for_backward(slopes)
        return values

    @staticmethod
    @once_differentiable
    def backward(  # type: ignore[override]
        ctx: BackwardCFunction, *grad_outputs: Tensor
    ) -> tuple[Tensor, None, None]:
        (slopes,) = ctx.saved_tensors
        return (grad_outputs[0].unsqueeze(-1) * slopes).sum(0), None, None


class _Buffers:
    """The arrays that members, in turn, write their activations and gradients to.

    Attributes:
        key: the address of the parameters, and the number and type of the input rows, for which
            these buffers were made.
        layers: the parameters of each member.
        gradient, gradients: the gradient of the parameters, and its layers by member; made when
            first needed.
        before: the product of each hidden layer, shape (B, m); with LayerNorm it becomes the
            normalised value before gain and shift.
        after: the activations; without LayerNorm the same arrays as `before`.
        delta: gradients with respect to either, shape (B, m).
        inverse: with LayerNorm, the inverse standard deviations.
        unused, unused_head: where gradients go that are not needed.
    """

    def __init__(
        self, ensemble: Ensemble, inputs: Tensor, key: tuple[int, int, torch.dtype]
    ) -> None:
        self.key, rows, hidden = key, len(inputs), ensemble.widths[1:-1]
        self.layers = [ensemble.layers(row) for row in ensemble.rows.detach()]
        self.gradient: Tensor | None = None
        self.gradients: list[list[Layer]] = []
        self.before = [inputs.new_empty(rows, m) for m in hidden]
        self.after = self.before
        if ensemble.layer_norm:
            self.after = [inputs.new_empty(rows, m) for m in hidden]
        # The backward pass needs only the last delta: two arrays are used in turn.
        pair = [inputs.new_empty(rows * max(hidden)) for _ in range(2)]
        self.delta = [pair[i % 2][: rows * m].view(rows, m) for i, m in enumerate(hidden)]
        self.inverse = [inputs.new_empty(rows).numpy() for _ in hidden]
        self.unused = [[inputs.new_empty(m).numpy() for _ in range(3)] for m in hidden]
        self.unused_head = [inputs.new_empty(m).numpy() for m in (1, hidden[-1])]
        # The same arrays in the type that the kernels take.
        self.before_floats, self.after_floats, self.delta_floats = (
            [tensor.numpy() for tensor in tensors]
            for tensors in (self.before, self.after, self.delta)
        )


def _forward(layers: list[Layer], buffers: _Buffers, inputs: Tensor, value: Floats) -> None:
    """Write a member's outputs at `inputs`, shape (B, n), to `value`, shape (B,)."""
    below = inputs
    for i, layer in enumerate(layers[:-1]):
        torch.mm(below, layer.product, out=buffers.before[i])
        before, after = buffers.before_floats[i], buffers.after_floats[i]
        if layer.gain is None:
            rectify(before, layer.small[0])
        else:
            bias, gain, shift = layer.small
            normalize(before, bias, gain, shift, buffers.inverse[i], after)
        below = buffers.after[i]
    bias, weight = layers[-1].small
    head(buffers.after_floats[-1], weight, bias, value)


def _backward(
    layers: list[Layer], buffers: _Buffers, slope: Floats, gradients: list[Layer] | None = None
) -> Tensor:
    """Return the gradient of the first matrix product, given `slope`, that of the output.

    `_forward` must have been called just before. Fills `gradients`, except for the weights of
    the first product, where they are wanted.
    """
    last = buffers.unused_head if gradients is None else gradients[-1].small
    after, delta_floats = buffers.after_floats, buffers.delta_floats
    back_head(slope, after[-1], layers[-1].small[1], delta_floats[-1], last[1], last[0])
    delta = buffers.delta[-1]
    for i in range(len(layers) - 2, -1, -1):
        if i < len(layers) - 2:
            if gradients is not None:
                torch.mm(buffers.after[i].T, delta, out=gradients[i + 1].product)
            delta = torch.mm(delta, layers[i + 1].back, out=buffers.delta[i])
        small = buffers.unused[i] if gradients is None else gradients[i].small
        if layers[i].gain is None:
            back_rectify(delta_floats[i], after[i], small[0])
        else:
            normal, inverse = buffers.before_floats[i], buffers.inverse[i]
            gain = layers[i].small[1]
            back_normalize(delta_floats[i], normal, after[i], inverse, gain, *small)
    return delta
