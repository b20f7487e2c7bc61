"""Change one place of the code at a time, and see whether a test notices: `make mutants`.

The changes are those of cosmic-ray. Of each package a random sample is taken, the same one for the
same seed. It runs in a copy of the project, so the sources stay as they are. The tests of a package
run once under coverage; then each change gets the tests that run the changed line, quickest first,
until one fails. No test may fail on sources without a change. Left out is what means nothing:
changes of annotations that are never evaluated, of decorators, and of what a type checker reads;
and what is told from the syntax to be no fault: see :func:`tests.support.reach.meaning`.
"""

from __future__ import annotations

import argparse
import compileall
import contextlib
import importlib
import json
import math
import os
import random
import re
import shlex
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import NamedTuple

import pytest
from cosmic_ray.ast import ast_nodes, get_ast  # type: ignore[import-not-found]
from cosmic_ray.mutating import mutate_code  # type: ignore[import-not-found]
from cosmic_ray.plugins import get_operator, operator_names  # type: ignore[import-not-found]

from tests.support.reach import Chosen, Reach, meaning

ROOT = Path(__file__).parents[2]
PHYSICS = "tests/backends/physics/test_"
ENGINES = f"tests/backends/contract {PHYSICS}analytic.py {PHYSICS}coupling.py {PHYSICS}servos.py "
ENGINES += f"{PHYSICS}elastic_cables.py {PHYSICS}rods.py {PHYSICS}guide_friction.py "
ENGINES += f"{PHYSICS}constraints.py::test_a_step_is_the_solution_of_its_conditions "
PACKAGES: dict[str, str] = {
    "cdcsr/robot": ENGINES + "tests/cdcsr/robot tests/backends/export tests/backends/mujoco "
    "tests/training/commands/test_new_robot.py",
    "cdcsr/tasks": "tests/cdcsr/tasks tests/cdcsr/envs tests/controllers/test_workspace.py "
    "tests/cdcsr/robot/test_ruler.py",
    "backends/mujoco": ENGINES + "tests/backends/mujoco tests/backends/export "
    "tests/backends/test_dm_env.py -k 'not pybullet'",
    "backends/pybullet": ENGINES + "tests/backends/pybullet tests/backends/export -k 'not mujoco'",
    "backends/export": "tests/backends/export",
    "backends/parity": "tests/backends/parity",
    "backends/cosserat": "tests/backends/physics/test_rods.py "
    "tests/training/commands/test_validate.py",
    "backends/viewers": "tests/backends/viewers tests/training/commands/test_film.py",
    "training/algorithms": "tests/training/algorithms tests/training/run tests/training/config",
    "training/device": "tests/training/device tests/training/algorithms/test_reference_update.py",
    "training/experience": "tests/training/experience tests/training/algorithms tests/training/run",
}
"""The packages that are changed, and the tests that should notice."""
if find_spec("mujoco_warp"):  # the extra gpu
    PACKAGES["backends/warp"] = "tests/backends/warp -m slow"
OPERATORS = [
    name
    for name in sorted(operator_names())
    if not re.search("Variable|Bit[OAX]|Shift|Decorator|_(Not)?(Eq|[LG]tE?)_Is", name)
]
"""The changes. Bit operators fail at once on floats, those of variables need their names, and `is`
of a number is a warning, which fails at once."""
LEFT_OUT = ("benchmarks.py", "model_choices.py")
"""Files that only measure speed, which fast tests do not."""
LOADED = "numpy scipy.optimize torch mujoco pybullet numba pydantic gymnasium minari"
"""Packages that are loaded once, before the processes of the tests part from this one."""
BUDGET, TIMEOUT = 60.0, 600.0
"""Seconds of tests, by their time without a change, that a change gets; and seconds after which one
that keeps the tests busy, compiling too, counts as noticed, which is said."""


class Mutant(NamedTuple):
    """One change of one file."""

    file: str
    operator: str
    code: str
    line: int
    """The first line that differs."""
    text: str
    """The text that stands there then."""


def mutants(package: str) -> Iterator[tuple[str, str, int]]:
    """Yield file, operator and occurrence of every change of a package."""
    for path in sorted((ROOT / package).glob("*.py")):
        if path.name in LEFT_OUT:
            continue
        code = path.read_text("utf-8")
        nodes = list(ast_nodes(get_ast(code)))
        for name in OPERATORS:
            operator = get_operator(name)()
            count = sum(1 for node in nodes for _ in operator.mutation_positions(node))
            yield from ((str(path.relative_to(ROOT)), name, n) for n in range(count))


def sample(package: str, num: int, seed: int) -> tuple[list[Mutant], int]:
    """Return some changes that mean something, and how many there are in all."""
    everything = list(mutants(package))
    random.Random(seed).shuffle(everything)
    chosen: list[Mutant] = []
    for file, name, occurrence in everything:
        if len(chosen) == num:
            break
        code = (ROOT / file).read_text("utf-8")
        changed = mutate_code(code, get_operator(name)(), occurrence)
        if changed is None or meaning(changed) in (None, meaning(code)):
            continue
        pairs = zip(code.splitlines(), changed.splitlines(), strict=False)
        line = next((i for i, (a, b) in enumerate(pairs, 1) if a != b), 0)
        chosen.append(Mutant(file, name, changed, line, changed.splitlines()[line - 1].strip()))
    return chosen, len(everything)


class Copy:
    """A copy of the project, in which the tests of a package find a change or do not."""

    def __init__(self, folder: Path, package: str) -> None:
        self._folder, self._package = folder, package
        skip = shutil.ignore_patterns(".venv", ".git", "__pycache__", ".*_cache")
        shutil.copytree(ROOT, folder, ignore=skip, symlinks=True)
        compileall.compile_dir(folder, quiet=1, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
        tests = shlex.split(PACKAGES[package])

        def reach() -> int:
            plugin = Reach()
            # Or the first test that imports a file would be the only one that runs its first lines.
            for path in sorted((folder / package).glob("*.py")):
                importlib.import_module(".".join([*Path(package).parts, path.stem]))
            code = int(pytest.main(["-q", "-p", "no:cacheprovider", *tests], [plugin]))
            plugin.save(folder / "reach.json")
            return code

        if (code := self._forked(reach, math.inf, folder / ".numba")) != 0:
            raise SystemExit(f"The tests of {package} fail without a change: {code}.")
        found = json.loads((folder / "reach.json").read_text("utf-8"))
        self._seconds, self._lines = found["seconds"], found["lines"]

    def tests(self, mutant: Mutant) -> tuple[list[str], int]:
        """Return tests that run the changed line, or, if it runs at import, compiled or in another
        process, that run or name the file, and those of its room, or all; first from files that
        name it, then from its room, by time. The second value is how many there would be without a
        budget."""
        lines = self._lines.get(mutant.file, {})
        # In the first line, Numba runs what it makes of a kernel in the test that compiles it.
        bodies = (tests for line, tests in lines.items() if line != "1")
        every = [{test for test in tests if test} for tests in bodies]
        line = lines.get(str(mutant.line), [])
        exact = set() if "" in line else set(line)  # what runs at import, too, any test may need
        names = f"from {mutant.file[:-3].replace('/', '.')} ", Path(mutant.file).name
        files = {_file_of(test) for test in self._seconds}
        texts = {file: (self._folder / file).read_text("utf-8") for file in files}

        def named(test: str) -> bool:
            return any(name in texts[_file_of(test)] for name in names)

        def away(test: str) -> bool:
            return not test.startswith(f"tests/{self._package}/")

        # What is set at import, as a number of a class, is read without running any line.
        some = [test for test in self._seconds if named(test) or not away(test)]
        reached = exact or set(some).union(*every) or set(self._seconds)

        def place(test: str) -> tuple[bool, bool, float]:
            return not named(test), away(test), self._seconds.get(test, 0.0)

        total, chosen = 0.0, []
        for test in sorted(reached, key=place):
            total += self._seconds.get(test, 0.0)
            if chosen and total > BUDGET:
                break
            chosen.append(test)
        return chosen, len(reached)

    def _machine_code(self, file: str) -> Path:
        """Return a folder with the compiled functions but those of a file and its callers, which
        hold the machine code of what they call."""
        stale, before = {Path(file).stem}, 0
        while len(stale) > before:
            before = len(stale)
            calls = re.compile(rf"from [\w.]+\.({'|'.join(stale)}) import")
            for path in self._folder.glob("*/*/*.py"):
                if calls.search(code := path.read_text("utf-8")) and "@compiled" in code:
                    stale.add(path.stem)
        cache = Path(tempfile.mkdtemp(dir=self._folder))
        old = shutil.ignore_patterns(*(f"{stem}.*" for stem in stale))
        shutil.copytree(self._folder / ".numba", cache, ignore=old, dirs_exist_ok=True)
        return cache

    def notices(self, mutant: Mutant) -> bool:
        """Return whether a test fails with a change."""
        place = self._folder / mutant.file
        before, times = place.read_bytes(), place.stat()
        tests, _ = self.tests(mutant)
        files = sorted(set(map(_file_of, tests)))
        options = ["-q", "-x", "-p", "no:cacheprovider", "-m", "slow or not slow", *files]
        cache = self._folder / ".numba"
        if "@compiled" in mutant.code:
            cache = self._machine_code(mutant.file)
        place.write_text(mutant.code, "utf-8")
        try:
            code = self._forked(lambda: int(pytest.main(options, [Chosen(tests)])), TIMEOUT, cache)
            if code == 99:
                print(f"  tests were busy until the end: {mutant.file}:{mutant.line}", flush=True)
            return code != 0
        finally:
            place.write_bytes(before)
            os.utime(place, ns=(times.st_atime_ns, times.st_mtime_ns))

    def _forked(self, do: Callable[[], int], seconds: float, cache: Path) -> int:
        """Return what a function returns in a process of its own; 99 if it takes too long."""
        child = os.fork()
        if child == 0:
            os.setsid()
            os.chdir(self._folder)
            sys.path.insert(0, str(self._folder))
            for name in [name for name in sys.modules if name.split(".")[0] == "tests"]:
                del sys.modules[name]
            os.environ |= {"PYTHONPATH": str(self._folder), "NUMBA_CACHE_DIR": str(cache)}
            vars(importlib.import_module("numba.core.config"))["CACHE_DIR"] = str(cache)
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            code = 98
            try:
                code = do()
            finally:
                os._exit(code)
        end, done, status = time.monotonic() + seconds, 0, 0
        while not done and time.monotonic() < end:
            time.sleep(0.05)
            done, status = os.waitpid(child, os.WNOHANG)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # also workers that tests have left
        if not done:
            os.waitpid(child, 0)
            return 99
        return os.waitstatus_to_exitcode(status)


def _file_of(test: str) -> str:
    return test.partition("::")[0]


def wilson(hits: int, num: int) -> tuple[float, float]:
    """Return the 95 % interval of a share."""
    z = 1.96
    middle = (hits + z * z / 2) / (num + z * z)
    half = z / (num + z * z) * math.sqrt(hits * (num - hits) / num + z * z / 4)
    return middle - half, middle + half


def main() -> None:
    """Change a sample of each package and print what was not noticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("packages", nargs="*", default=list(PACKAGES))
    parser.add_argument("--num", type=int, default=60, help="changes of each package")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--minutes", type=float, default=math.inf, help="longest time for a package"
    )
    asked = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"
    sys.dont_write_bytecode = True
    for name in LOADED.split():
        importlib.import_module(name)
    for package in asked.packages:
        with tempfile.TemporaryDirectory() as name:
            chosen, total = sample(package, asked.num, asked.seed)
            copy = Copy(Path(name) / "copy", package)
            for mutant in chosen[:3]:  # or the figure would count what fails by itself
                code = (Path(name) / "copy" / mutant.file).read_text("utf-8")
                if copy.notices(mutant._replace(code=code)):
                    raise SystemExit(f"Tests of {mutant.file} fail without a change.")
            noticed, tried, begin = 0, 0, time.monotonic()
            for mutant in chosen:
                if time.monotonic() - begin > 60 * asked.minutes:
                    break
                tried += 1
                if copy.notices(mutant):
                    noticed += 1
                else:
                    tests, reached = copy.tests(mutant)
                    print(
                        f"  {mutant.file}:{mutant.line} {mutant.operator}: {mutant.text} "
                        f"({len(tests)} of {reached} tests)",
                        flush=True,
                    )
            if tried:
                low, high = wilson(noticed, tried)
                print(
                    f"{package}: {noticed} of {tried} noticed ({noticed / tried:.2f} "
                    f"[{low:.2f}, {high:.2f}]), of {total} changes",
                    flush=True,
                )


if __name__ == "__main__":
    main()
