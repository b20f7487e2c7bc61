"""Compiled loops for everything in a layer but its matrix product: one pass over the activations.

The kernels work in place on contiguous arrays of one type: rows are samples of a batch, columns
are units of a layer. NaN stays NaN. Zeros are taken from an array so that they have its type: a
literal would turn the arithmetic of a loop into double precision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.compiled import compiled

# Sums may be reordered; NaN and infinity keep their meaning.
_FAST = {"reassoc", "contract", "arcp", "nsz"}
_EPS = 1e-5
"""Added to the variance, as in `nn.LayerNorm`."""

Floats = NDArray[np.floating]


@compiled(_FAST)
def rectify(x: Floats, bias: Floats) -> None:
    """Replace x by relu(x + bias)."""
    for i in range(x.shape[0]):
        row = x[i]
        for j in range(x.shape[1]):
            value = row[j] + bias[j]
            row[j] = value
            if value <= 0:
                row[j] = 0


@compiled(_FAST)
def back_rectify(delta: Floats, after: Floats, bias_gradient: Floats) -> None:
    """Take a gradient back through `rectify`.

    Args:
        delta: gradient with respect to the output; replaced by that with respect to the input.
        after: the output of `rectify`.
        bias_gradient: overwritten.
    """
    bias_gradient[:] = 0
    zero = np.zeros(1, delta.dtype)[0]
    for i in range(delta.shape[0]):
        row, out = delta[i], after[i]
        for j in range(delta.shape[1]):
            row[j] = zero if out[j] <= 0 else row[j]
        for j in range(delta.shape[1]):
            bias_gradient[j] += row[j]


@compiled(_FAST)
def normalize(
    x: Floats, bias: Floats, gain: Floats, shift: Floats, inverse: Floats, after: Floats
) -> None:
    """Write relu(LayerNorm(x + bias)) to `after`; x becomes its value before gain and shift.

    Args:
        x: shape (B, m).
        bias, gain, shift: shape (m,).
        inverse: overwritten by the inverse standard deviation of each row, shape (B,).
        after: overwritten, shape (B, m).
    """
    width, zero, share = x.shape[1], np.zeros(1, x.dtype)[0], np.full(1, 1 / x.shape[1], x.dtype)[0]
    for i in range(x.shape[0]):
        row, out = x[i], after[i]
        total = zero
        for j in range(width):
            row[j] += bias[j]
            total += row[j]
        mean, total = total * share, zero
        for j in range(width):
            row[j] -= mean
            total += row[j] * row[j]
        inverse[i] = 1 / np.sqrt(total * share + _EPS)
        scale = inverse[i]
        for j in range(width):
            row[j] *= scale
            value = row[j] * gain[j] + shift[j]
            out[j] = zero if value <= 0 else value


@compiled(_FAST)
def back_normalize(
    delta: Floats,
    normal: Floats,
    after: Floats,
    inverse: Floats,
    gain: Floats,
    bias_gradient: Floats,
    gain_gradient: Floats,
    shift_gradient: Floats,
) -> None:
    """Take a gradient back through `normalize`.

    Args:
        delta: gradient with respect to the output, shape (B, m); replaced by that with respect
            to the input.
        normal, after, inverse: what `normalize` left in `x`, `after` and `inverse`.
        gain: shape (m,).
        bias_gradient, gain_gradient, shift_gradient: overwritten.
    """
    bias_gradient[:], gain_gradient[:], shift_gradient[:] = 0, 0, 0
    width, zero = delta.shape[1], np.zeros(1, delta.dtype)[0]
    share = np.full(1, 1 / delta.shape[1], delta.dtype)[0]
    for i in range(delta.shape[0]):
        row, unit, out, scale = delta[i], normal[i], after[i], inverse[i]
        for j in range(width):
            row[j] = zero if out[j] <= 0 else row[j]
        for j in range(width):
            shift_gradient[j] += row[j]
        for j in range(width):
            gain_gradient[j] += row[j] * unit[j]
        total, along = zero, zero
        for j in range(width):
            row[j] *= gain[j]
            total += row[j]
            along += row[j] * unit[j]
        mean, slope = total * share, along * share
        for j in range(width):
            row[j] = (row[j] - mean - unit[j] * slope) * scale
        for j in range(width):
            bias_gradient[j] += row[j]


@compiled(_FAST)
def head(below: Floats, weight: Floats, bias: Floats, value: Floats) -> None:
    """Write below @ weight + bias, the one output of a network, to `value`.

    Args:
        below: shape (B, n).
        weight, bias: shapes (n,) and (1,).
        value: overwritten, shape (B,).
    """
    for i in range(below.shape[0]):
        row = below[i]
        total = bias[0]
        for j in range(below.shape[1]):
            total += row[j] * weight[j]
        value[i] = total


@compiled(_FAST)
def back_head(
    slope: Floats,
    below: Floats,
    weight: Floats,
    delta: Floats,
    weight_gradient: Floats,
    bias_gradient: Floats,
) -> None:
    """Take a gradient back through `head`.

    Args:
        slope: gradient with respect to the output, shape (B,).
        below, weight: the inputs of `head`.
        delta: overwritten by the gradient with respect to `below`, shape (B, n).
        weight_gradient, bias_gradient: overwritten.
    """
    weight_gradient[:], bias_gradient[:] = 0, 0
    for i in range(below.shape[0]):
        row, out, factor = below[i], delta[i], slope[i]
        bias_gradient[0] += factor
        for j in range(below.shape[1]):
            out[j] = factor * weight[j]
        for j in range(below.shape[1]):
            weight_gradient[j] += factor * row[j]
