"""An actor as an ONNX model, which runs without torch. Needs the extra `onnx`.

The model computes in float64: in float32 the order of sums alone, which differs between torch and
onnxruntime and between one observation and many, moves commands by 1e-5 of their range.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from typing import Literal

import numpy as np
import onnxruntime  # pyright: ignore[reportMissingImports] - it is an extra, as the next ones
import onnxscript  # noqa: F401 # pyright: ignore[reportMissingImports] - torch needs it
import torch
from numpy.typing import NDArray
from onnx import ModelProto  # pyright: ignore[reportMissingImports]
from torch import Tensor, nn

from training.networks.actor import Actor

Type = Literal["float32", "float64"]


class _Commands(nn.Module):
    """Map observations of any type to set-points in [m] of the same type."""

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self.actor = deepcopy(actor).double()

    def forward(self, observation: Tensor) -> Tensor:
        return self.actor.command(observation.double()).to(observation.dtype)


def to_onnx(actor: Actor, dtype: Type, metadata: Mapping[str, str]) -> bytes:
    """Return an ONNX model that maps `observation`, (num, size), to `command`, (num, C), in [m].

    Args:
        actor: scaling, mirror symmetry and servo travel become part of the model.
        dtype: of observations and commands.
        metadata: added to the model.
    """
    example = torch.zeros(2, len(actor.encoder.offset), dtype=getattr(torch, dtype))
    with _quiet():
        program = torch.onnx.export(
            _Commands(actor),
            (example,),
            input_names=["observation"],
            output_names=["command"],
            dynamic_shapes={"observation": {0: torch.export.Dim("num")}},
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    _remove_traces(model)
    for key, value in metadata.items():
        model.metadata_props.add(key=key, value=value)
    return model.SerializeToString()


def largest_difference(
    actor: Actor, model: bytes, dtype: Type, observations: NDArray[np.float64]
) -> float:
    """Return how far a model's commands are from those of torch in float64, at most, in [m].

    Args:
        actor: the actor.
        model: what :func:`to_onnx` returned for it.
        dtype: as there.
        observations: shape (num, size).
    """
    given = observations.astype(dtype)
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    (found,) = session.run(None, {"observation": given})
    with torch.no_grad():
        expected = deepcopy(actor).double().command(torch.as_tensor(given).double())
    return float(np.abs(found - expected.numpy()).max())


def random_observations(actor: Actor, num: int) -> NDArray[np.float64]:
    """Return observations, (num, size), that spread by three times the actor's scales about its
    centres."""
    offset, scale = actor.encoder.offset.numpy(), actor.encoder.scale.numpy()
    return offset + 3 * scale * np.random.default_rng(0).normal(size=(num, len(offset)))


def _remove_traces(model: ModelProto) -> None:
    """Remove the lines of source code, with their paths, that torch notes at every node."""
    graph = model.graph
    for part in (model, graph, *graph.node, *graph.input, *graph.output, *graph.value_info):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep torch from telling of packages that are not needed here, and of its own deprecated
    calls."""
    log = logging.getLogger("torch.onnx")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(level)
