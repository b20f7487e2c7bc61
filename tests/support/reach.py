"""Find which tests run which lines, run chosen tests only, and tell what changes of a source mean:
what mutation testing needs (tests/robustness/mutants.py)."""

from __future__ import annotations

import ast
import json
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest
from coverage import Coverage
from numba.core.event import install_timer


class Reach:
    """Finds which tests run which lines, and how long each takes but for compiling kernels, which
    falls to the first that needs them. What a fixture runs that tests share, all of them run; what
    a function with a cache runs, every test that calls it."""

    def __init__(self) -> None:
        self.coverage = Coverage(data_file=None, source=[str(Path.cwd())], branch=False)
        self.seconds: dict[str, float] = defaultdict(float)
        self._sharing: dict[str, list[str]] = {}
        self._test = ""
        self.coverage.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
    ) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        name = f"{fixturedef.baseid} {fixturedef.argname}"
        self._sharing[name] = [
            item.nodeid
            for item in request.session.items
            if item.nodeid.startswith(fixturedef.baseid)
            and fixturedef.argname in getattr(item, "fixturenames", ())
        ]
        self.coverage.switch_context(name)
        try:
            return (yield)
        finally:
            self.coverage.switch_context(self._test)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        def compiling(seconds: float) -> None:
            self.seconds[item.nodeid] -= seconds

        for module in [*sys.modules.values()]:
            if str(getattr(module, "__file__", "")).startswith(f"{Path.cwd()}/"):
                for value in vars(module).values():
                    if hasattr(value, "cache_clear"):
                        value.cache_clear()
        self._test = item.nodeid
        self.coverage.switch_context(self._test)
        with install_timer("numba:compile", compiling):
            result = yield
        self.coverage.switch_context("")
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds[report.nodeid] += report.duration

    def save(self, file: Path) -> None:
        """Write the seconds of each test, and the tests of each line of each file."""
        self.coverage.stop()
        data = self.coverage.get_data()
        lines = {
            str(Path(name).relative_to(Path.cwd())): {
                line: [test for each in contexts for test in self._sharing.get(each, [each])]
                for line, contexts in data.contexts_by_lineno(name).items()
            }
            for name in data.measured_files()
        }
        file.write_text(json.dumps({"seconds": self.seconds, "lines": lines}), "utf-8")


class Chosen:
    """Runs the chosen tests only, in their order."""

    def __init__(self, tests: list[str]) -> None:
        self._place = {test: place for place, test in enumerate(tests)}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted(
            (each for each in items if each.nodeid in self._place),
            key=lambda each: self._place[each.nodeid],
        )


INK = {"alpha", "capsize", "fontsize", "labelsize", "linewidth", "lw", "markersize", "ms", "pad"}
"""Arguments of Matplotlib that say how large, thick or dense the ink of a figure is."""
_IDENTITY = {ast.Eq: ast.Is(), ast.NotEq: ast.IsNot()}


class Strip(ast.NodeTransformer):
    """Take away what does nothing when the code runs, and what makes no fault."""

    def visit_arg(self, node: ast.arg) -> ast.arg:
        node.annotation = None
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.returns, node.decorator_list = None, []
        self.generic_visit(node)
        node.body = [self._bare(each) for each in node.body]
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.ClassDef:
        self.generic_visit(node)
        kind = " ".join(map(ast.unparse, [*node.decorator_list, *node.bases]))
        if re.search("dataclass|NamedTuple|Protocol", kind):  # pydantic evaluates annotations
            node.body = [self._bare(each) for each in node.body]
        node.decorator_list = []
        return node

    def visit_Module(self, node: ast.Module) -> ast.Module:
        self.generic_visit(node)
        node.body = [self._bare(each) for each in node.body]
        return node

    def visit_If(self, node: ast.If) -> ast.AST | None:
        self.generic_visit(node)
        return None if "TYPE_CHECKING" in ast.unparse(node.test) else node

    def visit_Call(self, node: ast.Call) -> ast.Call:
        self.generic_visit(node)
        if ast.unparse(node.func) == "zip":
            node.keywords = [each for each in node.keywords if each.arg != "strict"]
        node.keywords = [each for each in node.keywords if each.arg not in INK]
        return node

    def visit_Compare(self, node: ast.Compare) -> ast.Compare:
        self.generic_visit(node)
        if ast.unparse(node.comparators[-1]) == "None":
            node.ops = [_IDENTITY.get(type(each), each) for each in node.ops]
        return node

    @staticmethod
    def _bare(node: ast.stmt) -> ast.stmt:
        if isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
        return node


def meaning(code: str) -> str | None:
    """Return a text that is the same for code that does the same; None for what is no Python.

    It is also the same where only these differ:

    - whether `zip` checks that lengths are equal: an assertion, which no right call breaks,
    - `is None` and `== None`: the second is what `make check` (E711) refuses,
    - arguments in :data:`INK`: the look of a figure.
    """
    try:
        return ast.dump(Strip().visit(ast.parse(code)))
    except SyntaxError:
        return None
