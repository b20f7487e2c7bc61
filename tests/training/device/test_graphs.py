"""Work that a GPU repeats as a CUDA graph is fit for it, which a processor can tell."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from cdcsr.simulation.contract import Simulation
from cdcsr.simulation.randomization import Drawn
from tests.support.tiny import tiny_device_run
from training.device.doors import DeviceState, HostDoor
from training.run.device_parts import make_parts
from training.run.setup import Setup

CPU = torch.device("cpu")


class _StillRobots:
    """A door whose copies do not move, without a word to the processor."""

    def __init__(self, simulation: Simulation, device: torch.device) -> None:
        self.robot, self.num = simulation.robot, simulation.num
        self._state = HostDoor(simulation, device).device_state()

    def device_state(self) -> DeviceState:
        return self._state

    def step_device(self, *_: Any) -> None:
        pass

    def reset_device(self, mask: torch.Tensor) -> None:
        pass

    def set_start_device(self, *_: torch.Tensor) -> None:
        pass

    def set_plants(self, plants: Drawn) -> None:
        pass

    def change_plants(self, *_: torch.Tensor) -> None:
        pass

    def close(self) -> None:
        pass


class _Waiting(TorchDispatchMode):
    """Refuse what a CUDA graph cannot hold: a wait for a number, a shape that depends on numbers,
    and a tensor that comes from Python."""

    REFUSED = ("_local_scalar_dense", "nonzero", "masked_select", "lift_fresh", "unique", "equal")

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Any = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        name = func.overloadpacket.__name__
        assert name not in self.REFUSED, name
        for part in args[1] if name in ("index", "index_put", "index_put_") else ():
            assert part is None or part.dtype != torch.bool, name
        return func(*args, **kwargs or {})


def _tensors(part: object, name: str = "", seen: set[int] | None = None) -> Iterator[Any]:
    """Yield where the numbers of all tensors are that an object of the project reaches."""
    seen = set() if seen is None else seen
    if isinstance(part, torch.Tensor):
        yield name, part.data_ptr()
        return
    own = type(part).__module__.startswith(("training", "cdcsr", "tests"))
    if id(part) in seen or not (own or isinstance(part, dict | list | tuple)):
        return
    seen.add(id(part))
    found = (
        part.items()
        if isinstance(part, dict)
        else enumerate(part)
        if isinstance(part, list | tuple)
        else vars(part).items()
    )
    for key, value in found:
        yield from _tensors(value, f"{name}.{key}", seen)


@pytest.mark.parametrize(
    ("algorithm", "task", "numbers", "options"),
    [
        ("clasp", "reach", {"symmetry": True}, {"start": "moving", "randomize": 2.0}),
        ("her", "reach", {}, {}),
        ("rlpd", "follow-random", {"symmetry": True}, {}),
    ],
)
def test_a_graph_can_hold_all_work(
    algorithm: str,
    task: str,
    numbers: dict[str, Any],
    options: dict[str, Any],
    tmp_path: Path,
    demonstrations: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("training.run.device_parts.open_door", _StillRobots)
    given = demonstrations if task == "reach" else None
    config = tiny_device_run(
        tmp_path / "run", demonstrations, algorithm, task=task, numbers=numbers, **options
    )
    parts = make_parts([Setup(replace(config, demonstrations=given))], CPU)
    learner = parts.learner
    for update in range(1, 6):  # in the first ones optimizers make their state
        learner.collector.step()
        learner.update(update)
    where = dict(_tensors(parts))
    assert len(where) > 50
    with _Waiting():
        for update in range(6, 40):
            learner.collector.step()
            learner.update(update)
    assert where == dict(_tensors(parts))
    assert int(learner.networks.updates) == 39
    with pytest.raises(AssertionError, match="_local_scalar_dense"), _Waiting():
        learner.networks.updates.item()
    parts.close()
