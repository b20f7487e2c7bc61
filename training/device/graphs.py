"""Work that a graphics card repeats without Python, as a CUDA graph."""

from __future__ import annotations

from collections.abc import Callable

import torch

_EAGER = 3
"""How often work is done as it is before it is captured: PyTorch chooses kernels and optimizers
make their state in the first calls."""


class Repeated:
    """Do the same work again and again: on a GPU as a CUDA graph, on a processor as it is.

    Args:
        work: reads and writes tensors that stay where they are, and waits for nothing.
        device: where they are.
    """

    def __init__(self, work: Callable[[], None], device: torch.device) -> None:
        self._work, self._cuda = work, device.type == "cuda"
        self._calls, self._graph = 0, None

    def __call__(self) -> None:
        if not self._cuda:
            self._work()
            return
        self._calls += 1
        if self._calls <= _EAGER:
            side = torch.cuda.Stream()
            side.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(side):
                self._work()
            torch.cuda.current_stream().wait_stream(side)
            return
        if self._graph is None:
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph):
                self._work()
        self._graph.replay()
