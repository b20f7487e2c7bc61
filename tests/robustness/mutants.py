"""Change one place of the code at a time, and see whether a test notices: `make mutants`.

The changes are those of cosmic-ray. Of each package a random sample is taken, the same one for the
same seed. It runs in a copy of the project, so the sources stay as they are. What no test can
notice is left out: changes of annotations of functions, which are never evaluated.
"""

from __future__ import annotations

import argparse
import ast
import math
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from cosmic_ray.ast import ast_nodes, get_ast  # type: ignore[import-not-found]
from cosmic_ray.mutating import mutate_code  # type: ignore[import-not-found]
from cosmic_ray.plugins import get_operator, operator_names  # type: ignore[import-not-found]

ROOT = Path(__file__).parents[2]
PACKAGES: dict[str, str] = {
    "cdcsr/robot": "tests/cdcsr/robot tests/backends/export",
    "cdcsr/tasks": "tests/cdcsr/tasks tests/cdcsr/envs",
    "backends/mujoco": "tests/backends/mujoco tests/backends/contract",
    "backends/pybullet": "tests/backends/pybullet tests/backends/contract",
    "training/algorithms": "tests/training/algorithms",
    "training/experience": "tests/training/experience tests/training/algorithms",
}
"""The packages that are changed, and the tests that should notice. The test file of the same name
as the changed one runs first."""
OPERATORS = [
    name for name in sorted(operator_names()) if not re.search("Variable|Bit[OAX]|Shift", name)
]
"""The changes. Bit operators fail at once on floats, and those of variables need their names."""
TIMEOUT = 600
"""Seconds after which a change that keeps the tests busy counts as noticed."""


class Mutant(NamedTuple):
    """One change of one file."""

    file: str
    operator: str
    occurrence: int
    code: str
    line: int
    """The first line that differs."""
    text: str
    """The text that stands there then."""


class Strip(ast.NodeTransformer):
    """Take annotations of functions and docstrings away."""

    def visit_arg(self, node: ast.arg) -> ast.arg:
        node.annotation = None
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.returns = None
        self.generic_visit(node)
        node.body = [self._bare(each) for each in node.body]
        return node

    @staticmethod
    def _bare(node: ast.stmt) -> ast.stmt:
        if isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
        return node


def meaning(code: str) -> str | None:
    """Return a text that is the same for code that does the same but for its annotations; None for
    what is no Python."""
    try:
        return ast.dump(Strip().visit(ast.parse(code)))
    except SyntaxError:
        return None


def mutants(package: str) -> Iterator[tuple[str, str, int]]:
    """Yield file, operator and occurrence of every change of a package."""
    for path in sorted((ROOT / package).glob("*.py")):
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
        text = changed.splitlines()[line - 1].strip()
        chosen.append(Mutant(file, name, occurrence, changed, line, text))
    return chosen, len(everything)


def is_noticed(mutant: Mutant, folder: Path, tests: list[str]) -> bool:
    """Return whether the tests fail with a change, in a copy of the project."""
    place = folder / mutant.file
    before = place.read_bytes()
    place.write_text(mutant.code, "utf-8")
    own = f"tests/{Path(mutant.file).parent}/test_{Path(mutant.file).name}"
    order = ([own] if (folder / own).is_file() else []) + tests
    command = [sys.executable, "-B", "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *order]
    env = os.environ | {"PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"}
    env["NUMBA_CACHE_DIR"] = str(folder / ".numba")
    try:
        return subprocess.run(
            command, cwd=folder, env=env, capture_output=True, timeout=TIMEOUT
        ).returncode in (1, 2, 3, 4)
    except subprocess.TimeoutExpired:
        return True
    finally:
        place.write_bytes(before)


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
    parser.add_argument("--num", type=int, default=40, help="changes of each package")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--minutes", type=float, default=math.inf, help="longest time for a package"
    )
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "copy"
        skip = shutil.ignore_patterns(".venv", ".git", "__pycache__", "results", ".*_cache")
        shutil.copytree(ROOT, folder, ignore=skip, symlinks=True)
        for package in asked.packages:
            chosen, total = sample(package, asked.num, asked.seed)
            noticed, tried, begin = 0, 0, time.monotonic()
            for mutant in chosen:
                if time.monotonic() - begin > 60 * asked.minutes:
                    break
                tried += 1
                if is_noticed(mutant, folder, PACKAGES[package].split()):
                    noticed += 1
                else:
                    place = f"{mutant.file}:{mutant.line}"
                    print(f"  {place} {mutant.operator}: {mutant.text}", flush=True)
            if tried:
                low, high = wilson(noticed, tried)
                print(
                    f"{package}: {noticed} of {tried} noticed ({noticed / tried:.2f} "
                    f"[{low:.2f}, {high:.2f}]), of {total} changes",
                    flush=True,
                )


if __name__ == "__main__":
    main()
