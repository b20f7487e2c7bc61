"""The kernels' own rules; `test_compiled_ensemble` compares layers and gradients with PyTorch."""

from __future__ import annotations

import numpy as np
import pytest

from training.networks import ensemble_kernels as kernel

both_types = pytest.mark.parametrize("dtype", [np.float32, np.float64])


@both_types
def test_one_row_by_hand(dtype: type) -> None:
    x, bias = np.array([[1.0, -3.0, 2.0]], dtype), np.array([1.0, 1.0, -2.0], dtype)
    kernel.rectify(x, bias)
    assert x.tolist() == [[2, 0, 0]]
    delta, gradient = np.array([[5.0, 6.0, 7.0]], dtype), np.full(3, 9, dtype)
    kernel.back_rectify(delta, x, gradient)
    assert delta.tolist() == [[5, 0, 0]]
    assert gradient.tolist() == [5, 0, 0]


@both_types
def test_an_output_by_hand(dtype: type) -> None:
    below, weight = np.array([[1, 2], [0, 3]], dtype), np.array([5, 7], dtype)
    value = np.empty(2, dtype)
    kernel.head(below, weight, np.array([1], dtype), value)
    assert value.tolist() == [20, 22]
    delta, gradient, bias = np.empty((2, 2), dtype), np.full(2, 9, dtype), np.full(1, 9, dtype)
    kernel.back_head(np.array([2, -1], dtype), below, weight, delta, gradient, bias)
    assert delta.tolist() == [[10, 14], [-5, -7]]
    assert (gradient.tolist(), bias.tolist()) == ([2, 1], [1])


def test_nan_stays_nan() -> None:
    x = np.array([[np.nan, 1.0]])
    kernel.rectify(x, np.zeros(2))
    assert np.isnan(x[0, 0])
    x, after = np.array([[np.nan, 1.0]]), np.zeros((1, 2))
    kernel.normalize(x, np.zeros(2), np.ones(2), np.zeros(2), np.zeros(1), after)
    assert np.isnan(after).all()


def test_layer_norm_ignores_shift_and_scale_of_its_inputs() -> None:
    """So the gradient with respect to its inputs is orthogonal to both."""
    rng = np.random.default_rng(0)
    x, gain, inverse, after = (
        rng.normal(size=(4, 9)),
        rng.normal(size=9),
        np.empty(4),
        np.empty((4, 9)),
    )
    kernel.normalize(x, np.zeros(9), gain, np.ones(9), inverse, after)
    delta = rng.normal(size=(4, 9))
    kernel.back_normalize(delta, x, after, inverse, gain, *np.empty((3, 9)))
    np.testing.assert_allclose(delta.sum(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose((delta * x).sum(axis=1), 0, atol=1e-3)  # not 0, because of epsilon
