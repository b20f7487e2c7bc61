"""Products in bfloat16: each factor is rounded once, and nothing else is."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.autograd.function import BackwardCFunction
from torch.nn import functional

from cdcsr.errors import CdcsrError
from training.algorithms.batd3 import BATD3
from training.algorithms.clasp import CLASP
from training.algorithms.td3 import TD3, BackboneNumbers
from training.experience.replay import Batch
from training.networks.bfloat16 import has_fast_bfloat16, matrix_products
from training.networks.compiled_ensemble import Ensemble
from training.run import setup, trainer
from training.run.train_options import Train

Make = Callable[..., TD3[BackboneNumbers]]
needs_bfloat16 = pytest.mark.skipif(
    not has_fast_bfloat16(), reason="this processor multiplies no faster in bfloat16"
)


@needs_bfloat16
def test_factors_are_rounded_once_and_sums_are_not() -> None:
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.randn(256, 256, generator=generator) for _ in range(2))
    with matrix_products(bfloat16=True):
        found = torch.mm(a, b)
    expected = a.bfloat16().double() @ b.bfloat16().double()
    assert (found - expected).abs().max() < 1e-4  # rounded sums, of about 16, would be off by .06
    assert (torch.mm(a, b) - expected).abs().max() > 1e-2


@pytest.mark.skipif("ONEDNN_MAX_CPU_ISA" in os.environ, reason="the instruction set is limited")
def test_processors_with_amx_are_found() -> None:
    flags = Path("/proc/cpuinfo")
    if not flags.is_file() or "amx_bf16" not in flags.read_text():
        pytest.skip("this processor has no AMX")
    assert has_fast_bfloat16()


@pytest.mark.parametrize("bfloat16", [True, False])
def test_precision_is_what_it_was_after_an_update_that_fails(bfloat16: bool) -> None:
    def fail() -> None:
        with matrix_products(bfloat16=bfloat16):
            raise RuntimeError

    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high")
    try:
        with pytest.raises(RuntimeError):
            fail()
        assert torch.get_float32_matmul_precision() == "high"
    finally:
        torch.set_float32_matmul_precision(before)


def _round(x: Tensor) -> Tensor:
    return x.bfloat16().float()


class _Product(torch.autograd.Function):
    """Compute x w; the factors of all three products are rounded by hand."""

    @staticmethod
    def forward(ctx: BackwardCFunction, x: Tensor, w: Tensor) -> Tensor:
        ctx.save_for_backward(x, w)
        return _round(x) @ _round(w)

    @staticmethod
    def backward(  # type: ignore[override]
        ctx: BackwardCFunction, *grad_outputs: Tensor
    ) -> tuple[Tensor, Tensor]:
        x, w = (_round(tensor) for tensor in ctx.saved_tensors)
        delta = _round(grad_outputs[0])
        return delta @ w.T, x.T @ delta


@needs_bfloat16
def test_critics_learn_from_rounded_factors_and_all_else_in_float32() -> None:
    generator = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    ensemble = Ensemble(40, (64, 64), 2, layer_norm=True)
    inputs, target = torch.randn(64, 40, generator=generator), torch.rand(64, generator=generator)
    with matrix_products(bfloat16=True):
        ensemble.regress(inputs, target)
    assert ensemble.rows.grad is not None
    found = ensemble.rows.grad.clone()
    rows = ensemble.rows.detach().requires_grad_()
    for row in rows:
        x, layers = inputs, ensemble.layers(row)
        for layer in layers[:-1]:
            x = _Product.apply(x, layer.product) + layer.weight[-1]
            x = functional.relu(functional.layer_norm(x, x.shape[-1:], layer.gain, layer.shift))
        # The output layer is a kernel's work and never rounded.
        value = (x @ layers[-1].product + layers[-1].weight[-1])[:, 0]
        ((value - target) ** 2).mean().backward()
    assert rows.grad is not None
    assert (found - rows.grad).norm() / rows.grad.norm() < 1e-3
    ensemble.regress(inputs, target)
    assert (ensemble.rows.grad - rows.grad).norm() / rows.grad.norm() > 1e-3


@needs_bfloat16
@pytest.mark.parametrize("kind", [BATD3, CLASP])
def test_the_switch_is_for_updates_and_for_them_only(
    kind: type[TD3[BackboneNumbers]], make: Make, small_batch: Batch
) -> None:
    batch = Batch(*(part.repeat(16, *[1] * (part.ndim - 1)) for part in small_batch))
    fine, coarse = (
        make(kind, hidden=(64, 64), batch_size=64, bfloat16=bfloat16) for bfloat16 in (False, True)
    )

    def act(learner: TD3[BackboneNumbers]) -> Tensor:
        with torch.no_grad():
            return learner.actor(learner.actor.encoder(batch.observation))

    before = act(fine)
    value = fine.update(batch)["value"]
    difference = coarse.update(batch)["value"] - value
    assert 0 < difference.abs() < 0.01 * value.abs()
    coarse.actor.load_state_dict(make(kind, hidden=(64, 64), batch_size=64).actor.state_dict())
    assert torch.equal(act(coarse), before)


def test_where_it_is_no_faster_the_switch_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setup, "has_fast_bfloat16", lambda: False)
    config = Train(out=tmp_path / "run", changes=(("bfloat16", True),))
    with pytest.raises(
        CdcsrError, match="bfloat16 must be off: this processor multiplies no faster in it"
    ):
        trainer.train(config)
    assert not (tmp_path / "run").exists()
