"""The compiled ensemble against plain PyTorch, and its kernels by hand."""

from __future__ import annotations

import copy
from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from training.algorithms.reference_update import Layer, outputs, parameters
from training.device.networks import stacked_ensemble
from training.networks import ensemble_kernels as kernel
from training.networks.compiled_ensemble import Ensemble

HIDDEN = (8, 12, 6)
INPUTS, MEMBERS, ROWS = 7, 4, 5


@pytest.fixture(params=[False, True], ids=["plain", "layer_norm"])
def ensemble(request: pytest.FixtureRequest) -> Ensemble:
    torch.manual_seed(0)
    ensemble = Ensemble(INPUTS, HIDDEN, MEMBERS, request.param).double()
    with torch.no_grad():  # so that gains differ from 1 and shifts from 0
        ensemble.rows.add_(0.1 * torch.randn_like(ensemble.rows))
    return ensemble


def reference(ensemble: Ensemble) -> list[Layer]:
    """Copy the ensemble as plain PyTorch."""
    return stacked_ensemble(ensemble, ensemble.rows)


def rows(count: int = ROWS) -> Tensor:
    return torch.randn(count, INPUTS, dtype=torch.float64)


@pytest.mark.parametrize("members", [None, [2], [3, 0]])
def test_outputs_and_gradients_of_inputs(ensemble: Ensemble, members: list[int] | None) -> None:
    inputs = rows().requires_grad_()
    values = ensemble(inputs, members)
    expected = outputs(reference(ensemble), inputs)[members or slice(None), :, 0]
    torch.testing.assert_close(values, expected)
    weight = torch.randn_like(values)
    (gradient,) = torch.autograd.grad((values * weight).sum(), inputs)
    (wanted,) = torch.autograd.grad((expected * weight).sum(), inputs)
    torch.testing.assert_close(gradient, wanted)


def test_gradients_of_inputs_by_finite_differences(ensemble: Ensemble) -> None:
    assert torch.autograd.gradcheck(lambda x: ensemble(x, [1, 2]), rows().requires_grad_())


def test_gradients_of_parameters(ensemble: Ensemble) -> None:
    for _ in range(2):  # the second time, over the results of the first
        inputs, target = rows(), torch.randn(ROWS, dtype=torch.float64)
        found = ensemble.regress(inputs, target)
        layers = reference(ensemble)
        expected = outputs(layers, inputs)[..., 0]
        (expected - target).square().mean(1).sum().backward()
        torch.testing.assert_close(found, expected.detach())
        assert ensemble.rows.grad is not None
        gradients = stacked_ensemble(ensemble, ensemble.rows.grad)
        for gradient, wanted in zip(parameters(gradients), parameters(layers), strict=True):
            torch.testing.assert_close(gradient.detach(), wanted.grad)


def test_a_hidden_layer_of_one_unit() -> None:
    ensemble, inputs = Ensemble(INPUTS, (4, 1), 1, layer_norm=False).double(), rows()
    found = ensemble.regress(inputs, torch.zeros(ROWS).double())
    torch.testing.assert_close(found, outputs(reference(ensemble), inputs)[..., 0].detach())


def test_padding_stays_zero() -> None:
    ensemble = Ensemble(INPUTS, HIDDEN, MEMBERS, layer_norm=True)
    used = sum((n + 1) * m for n, m in pairwise(ensemble.widths)) + 2 * sum(HIDDEN)
    optimizer = torch.optim.Adam(ensemble.parameters(), fused=True)
    ensemble.regress(rows().float(), torch.ones(ROWS))
    optimizer.step()
    assert used < ensemble.rows.shape[1]
    assert not ensemble.rows[:, used:].any()
    assert ensemble.rows[:, used - 1].all()


def test_graphs_alive_at_once_do_not_disturb_each_other(ensemble: Ensemble) -> None:
    first, second = rows().requires_grad_(), rows().requires_grad_()
    (alone,) = torch.autograd.grad(ensemble(first).square().sum(), first)
    a, b = ensemble(first), ensemble(second)
    ensemble.regress(rows(), torch.zeros(ROWS, dtype=torch.float64))
    together, _ = torch.autograd.grad(a.square().sum() + b.sum(), [first, second])
    assert torch.equal(together, alone)


def test_parameters_have_no_gradient_through_outputs(ensemble: Ensemble) -> None:
    assert not ensemble(rows()).requires_grad


def test_batches_of_different_size_and_type(ensemble: Ensemble) -> None:
    inputs = rows(9)
    whole = ensemble(inputs)
    torch.testing.assert_close(ensemble(inputs[:4]), whole[:, :4])
    with pytest.raises(RuntimeError, match="shapes"):
        ensemble(inputs[:, :1])
    single = ensemble.float()(inputs.float())
    torch.testing.assert_close(single, whole.float(), rtol=1e-4, atol=1e-5)


def test_copies_and_loaded_weights_are_used(ensemble: Ensemble) -> None:
    inputs, target = rows(), torch.zeros(ROWS, dtype=torch.float64)
    before = ensemble.regress(inputs, target)
    twin = copy.deepcopy(ensemble).requires_grad_(False)
    with torch.no_grad():
        ensemble.rows.mul_(2)
    changed = ensemble(inputs)
    assert torch.equal(twin(inputs), before)
    assert not torch.equal(changed, before)
    twin.load_state_dict(ensemble.state_dict())
    assert torch.equal(twin(inputs), changed)
    twin.rows.data = twin.rows.data * 0  # moved elsewhere
    assert not twin(inputs).any()


def test_initialized_as_linear_layers() -> None:
    torch.manual_seed(3)
    ensemble = Ensemble(INPUTS, HIDDEN, 2, layer_norm=False)
    torch.manual_seed(3)
    for member in ensemble.rows:
        for layer in ensemble.layers(member):
            linear = nn.Linear(len(layer.weight) - 1, layer.weight.shape[1])
            assert torch.equal(layer.weight[:-1], linear.weight.T)
            assert torch.equal(layer.weight[-1], linear.bias)


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
