"""Products in bfloat16: what is rounded, how often, and that nothing else is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from training.algorithms import BATD3, TD3
from training.config import Learner
from training.ensemble import Ensemble
from training.precision import bfloat16_products, products
from training.replay import Batch

_WIDE = {"hidden": (64, 64), "batch_size": 64}
needs_bfloat16 = pytest.mark.skipif(not bfloat16_products(), reason="this processor has no use for bfloat16")


@needs_bfloat16
def test_factors_are_rounded_once_and_sums_are_not() -> None:
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.randn(256, 256, generator=generator) for _ in range(2))
    with products(Learner(bfloat16=True)):
        found = torch.mm(a, b)
    expected = a.bfloat16().double() @ b.bfloat16().double()
    assert (found - expected).abs().max() < 1e-4  # rounded sums, of about 16, would be off by .06
    assert (torch.mm(a, b) - expected).abs().max() > 1e-2


@pytest.mark.parametrize("bfloat16", [True, False])
def test_precision_is_what_it_was_after_an_update_that_fails(bfloat16: bool) -> None:
    def fail() -> None:
        with products(Learner(bfloat16=bfloat16)):
            raise RuntimeError

    before = torch.get_float32_matmul_precision()
    with pytest.raises(RuntimeError):
        fail()
    assert torch.get_float32_matmul_precision() == before


def _round(x: Tensor) -> Tensor:
    return x.bfloat16().float()


class _Product(torch.autograd.Function):
    """x w with all three products' factors rounded by hand."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, w: Tensor) -> Tensor:
        ctx.save_for_backward(x, w)
        return _round(x) @ _round(w)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, Tensor]:
        x, w = ctx.saved_tensors
        return _round(grad_outputs[0]) @ _round(w).T, _round(x).T @ _round(grad_outputs[0])


@needs_bfloat16
def test_critics_learn_from_rounded_factors_and_all_else_in_float32() -> None:
    generator = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    ensemble = Ensemble(40, (64, 64), 2, layer_norm=True)
    inputs, target = torch.randn(64, 40, generator=generator), torch.rand(64, generator=generator)
    with products(Learner(bfloat16=True)):
        ensemble.regress(inputs, target)
    assert ensemble.rows.grad is not None
    found = ensemble.rows.grad.clone()
    rows = ensemble.rows.detach().requires_grad_()
    for row in rows:
        x, layers = inputs, ensemble.layers(row)
        for layer in layers[:-1]:
            x = _Product.apply(x, layer.product) + layer.weight[-1]
            x = functional.relu(functional.layer_norm(x, x.shape[-1:], layer.gain, layer.shift))
        value = (x @ layers[-1].product + layers[-1].weight[-1])[:, 0]  # of so few numbers, never rounded
        ((value - target) ** 2).mean().backward()
    assert rows.grad is not None
    assert (found - rows.grad).norm() / rows.grad.norm() < 1e-3
    ensemble.regress(inputs, target)
    assert (ensemble.rows.grad - rows.grad).norm() / rows.grad.norm() > 1e-3


@needs_bfloat16
def test_only_updates_are_in_bfloat16(make: Callable[..., TD3], small_batch: Batch) -> None:
    learners = [make(BATD3, **_WIDE, bfloat16=bfloat16) for bfloat16 in (False, True)]
    seen = small_batch.observation.repeat(16, 1)
    for learner in learners:
        learner.actor.load_state_dict(learners[0].actor.state_dict())
        learner.update(small_batch)
        learner.actor.load_state_dict(learners[0].actor.state_dict())
    with torch.no_grad():
        a, b = (learner.actor(learner.actor.encoder(seen)) for learner in learners)
    assert torch.equal(a, b)
    assert dataclasses.asdict(Learner())["bfloat16"] is False
