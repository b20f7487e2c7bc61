"""The copies of a robot spread over worker processes, each with a World of its own.

A worker is a plain subprocess and not one of `multiprocessing`, so that it never imports the
caller's main module, which may import a learning framework or start simulations itself. Requests go
in by its standard input, and answers come back by what was its standard output. Either side notices
at once when the other is gone.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import pickle
import signal
import subprocess
import sys
import weakref
from collections.abc import Iterable, Sequence
from typing import IO, Literal

import numpy as np
from numpy.typing import NDArray

from backends.pybullet.options import PybulletOptions
from backends.pybullet.world import Divergence, World
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.capstan import Capstan
from cdcsr.simulation.loads import Loads
from cdcsr.simulation.plant import Plant

Array = NDArray[np.float64]
Method = Literal["set_plant", "set_loads", "reset", "place", "step"]

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from backends.pybullet.workers import serve; serve()"
)
_PATIENCE = 5.0
"""A worker that has not ended after this time, in [s], is killed."""


class Pool:
    """The stand-in for a World of `num` copies, with the same attributes and methods.

    Attributes:
        processes: the workers.
    """

    def __init__(self, robot: Robot, num: int, options: PybulletOptions, workers: int) -> None:
        edges = np.linspace(0, num, workers + 1).round().astype(int)
        self._shares = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
        command = [sys.executable, "-c", _START, json.dumps(sys.path)]
        self.processes = [
            subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            for _ in self._shares
        ]
        self._end = weakref.finalize(self, _end, self.processes)
        self.time = np.zeros(num)
        self.position = np.zeros((num, 7 + robot.num_cables + robot.num_hinges))
        self.velocity = np.zeros((num, robot.num_coordinates))
        self.pulls = np.zeros((num, robot.num_cables + len(Capstan(robot).cable)))
        self.tip = np.zeros((num, 6))
        self._ask([(robot, share.stop - share.start, options) for share in self._shares])

    def set_plant(self, ids: NDArray[np.int64], plant: Plant) -> None:
        """Give copies `ids` the numbers in the rows of `plant`."""
        self._call(
            "set_plant",
            [
                (ids[mine] - share.start, Plant(*(rows[mine] for rows in plant)))
                for share, mine in zip(self._shares, self._inside(ids), strict=True)
            ],
        )

    def set_loads(self, loads: Loads) -> None:
        """Let loads act on all copies from the next step on."""
        self._call("set_loads", [(loads.of_copies(share),) for share in self._shares])

    def reset(self, ids: Iterable[int]) -> None:
        """Put copies back to the start."""
        chosen = np.fromiter(ids, int)
        parts = zip(self._shares, self._inside(chosen), strict=True)
        self._call("reset", [((chosen[mine] - s.start).tolist(),) for s, mine in parts])

    def place(
        self,
        ids: NDArray[np.int64],
        time: Array,
        position: Array,
        velocity: Array,
        pulls: Array,
    ) -> None:
        """Put copies `ids` into a state; see :meth:`World.place`."""
        rows, inside = (time, position, velocity, pulls), self._inside(ids)
        self._call(
            "place",
            [
                (ids[mine] - share.start, *(row[mine] for row in rows))
                for share, mine in zip(self._shares, inside, strict=True)
            ],
        )

    def step(self, command: Array, substeps: int) -> list[Divergence]:
        """Advance all copies; see :meth:`World.step`."""
        results = self._call("step", [(command[s], substeps) for s in self._shares])
        return [
            Divergence(share.start + lost.copy, lost.time, lost.what)
            for share, losses in zip(self._shares, results, strict=True)
            for lost in losses
        ]

    def close(self) -> None:
        """End the workers; to close twice does nothing."""
        self._end()

    def _inside(self, ids: NDArray[np.int64]) -> list[NDArray[np.bool_]]:
        """Return for every worker which of `ids` are its copies."""
        return [(ids >= share.start) & (ids < share.stop) for share in self._shares]

    def _call(
        self, method: Method, arguments: Sequence[tuple[object, ...]]
    ) -> list[list[Divergence]]:
        return self._ask([(method, *args) for args in arguments])

    def _ask(self, requests: Sequence[tuple[object, ...]]) -> list[list[Divergence]]:
        """Send every worker its request, read the state of its copies, and return the results."""
        if not self._end.alive:
            raise CdcsrError(
                "This simulation is closed, or it lost one of its worker processes; make a new one."
            )
        results: list[list[Divergence]] = []
        index = 0
        try:
            for index, request in enumerate(requests):
                _send(_pipe(self.processes[index].stdin), request)
            for index, share in enumerate(self._shares):
                result, state = pickle.load(_pipe(self.processes[index].stdout))
                self.time[share], self.position[share] = state[:2]
                self.velocity[share], self.pulls[share], self.tip[share] = state[2:]
                results.append(result)
        except (EOFError, OSError, pickle.UnpicklingError):
            worker, share = self.processes[index], self._shares[index]
            self.close()
            raise CdcsrError(
                f"The PyBullet worker process of copies {share.start} to {share.stop - 1} ended "
                f"unexpectedly (exit code {worker.returncode}); make a new simulation, with fewer "
                "workers if memory is short."
            ) from None
        except BaseException:  # an interrupt: the next answer would belong to this request
            self.close()
            raise
        return results


def serve() -> None:
    """Run a worker: make a World, then answer requests until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the caller handles it, and closes our input
    requests = sys.stdin.buffer
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # PyBullet writes messages to the standard output
    world = World(*pickle.load(requests))
    result: list[Divergence] = []
    try:
        while True:
            state = (world.time, world.position, world.velocity, world.pulls, world.tip)
            _send(answers, (result, state))
            method, *arguments = pickle.load(requests)
            result = getattr(world, method)(*arguments) or []
    except (EOFError, BrokenPipeError):
        world.close()


def _send(pipe: IO[bytes], message: object) -> None:
    pickle.dump(message, pipe, protocol=pickle.HIGHEST_PROTOCOL)
    pipe.flush()


def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
    """Return a pipe of a Popen that was opened with it."""
    assert pipe is not None
    return pipe


def _end(workers: list[subprocess.Popen[bytes]]) -> None:
    for worker in workers:
        with contextlib.suppress(BrokenPipeError):  # it is gone already
            _pipe(worker.stdin).close()
    for worker in workers:
        try:
            worker.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            worker.kill()
            worker.wait()
        _pipe(worker.stdout).close()
