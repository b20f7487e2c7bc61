"""Other projects' code, run in processes of its own so that it can be timed beside ours.

A peer need not be installed in this environment: another environment's interpreter can be named.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from types import TracebackType
from typing import Self

from cdcsr.errors import CdcsrError

_LOOP = """
import os, sys, time
{setup}
print("ready", flush=True)
for line in sys.stdin:
    wall, own = time.perf_counter(), time.process_time()
    run(int(line))
    print(time.perf_counter() - wall, time.process_time() - own, flush=True)
"""
_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    "JAX_PLATFORMS": "cpu",
}


class MissingPeer(CdcsrError):
    """A package to compare with is not installed; the message is that of the failed import."""


class Peer:
    """A process that does an amount of work on request and returns the time it took.

    Args:
        setup: Python code that defines `run(count)`.
        python: the interpreter.

    Raises:
        MissingPeer: the interpreter lacks a package that `setup` imports.
        CdcsrError: there is no such interpreter, or `setup` fails.
    """

    def __init__(self, setup: str, python: str = sys.executable) -> None:
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 (open while the process lives)
        try:
            self._process = subprocess.Popen(
                [python, "-c", _LOOP.format(setup=setup)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
                env=os.environ | _ONE_THREAD,
            )
        except OSError as error:
            self._errors.close()
            raise CdcsrError(
                f"{python} cannot be started ({error.strerror}); name a Python interpreter."
            ) from None
        line = self._read()
        while line and line.strip() != "ready":  # packages may print a greeting
            line = self._read()
        if not line:
            self._fail()

    def start(self, count: int) -> None:
        """Ask for an amount of work."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{count}\n")
        self._process.stdin.flush()

    def wait(self) -> tuple[float, float]:
        """Wait for the work; return its wall time and the processor time of the process, in [s]."""
        line = self._read()
        if not line:
            self._fail()
        wall, own = line.split()
        return float(wall), float(own)

    def run(self, count: int) -> tuple[float, float]:
        """Do an amount of work; return wall time and processor time, in [s]."""
        self.start(count)
        return self.wait()

    def close(self) -> None:
        """End the process."""
        self._process.communicate()
        self._errors.close()

    def _read(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()

    def _fail(self) -> None:
        self._process.wait()
        self._errors.seek(0)
        last = (self._errors.read().strip().splitlines() or ["it ended without a message"])[-1]
        self.close()
        if last.startswith("ModuleNotFoundError: "):
            raise MissingPeer(last.removeprefix("ModuleNotFoundError: "))
        raise CdcsrError(f"A program to compare with failed: {last}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._process.returncode is None:
            self.close()
