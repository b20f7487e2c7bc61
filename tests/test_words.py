"""The rules of the house that a test can hold: sizes, and how sentences begin."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("cdcsr", "backends", "controllers", "training", "models", "tests", "docs", "examples")
KINDS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Expr, ast.Name)
MOST_ANY = 40
"""How often `Any` may stand in types outside of the tests."""


@cache  # not when tests are collected, which every process does
def texts() -> dict[Path, str]:
    paths = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    return {path: path.read_text("utf-8") for path in paths}


@cache
def nodes() -> list[tuple[Path, ast.AST]]:
    """Return every piece of syntax that the rules are about, with its file."""
    return [
        (path, node)
        for path, text in texts().items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, KINDS)
    ]


def lines_of(node: ast.stmt) -> int:
    assert node.end_lineno is not None
    return node.end_lineno - node.lineno + 1


def docstring_lines(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    return lines_of(node.body[0]) if ast.get_docstring(node) else 0


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_files_and_lines_are_short() -> None:
    """The linter holds lines of code to their length; here are those of every file."""
    long: list[str] = []
    for path, text in texts().items():
        lines = text.splitlines()
        long += [f"{name_of(path)}: {len(lines)} lines"] * (len(lines) > 350)
        long += [f"{name_of(path)}:{i}" for i, line in enumerate(lines, 1) if len(line) > 100]
    assert long == []


def test_functions_are_short() -> None:
    long = []
    for path, node in nodes():
        function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if function and lines_of(node) - docstring_lines(node) > 60:
            long.append(f"{name_of(path)}: {node.name}")
    assert long == []


def test_docstrings_are_sentences() -> None:
    """A sentence has a subject and a verb; one that begins like this has lost one of them."""
    wrong = []
    for path, node in nodes():
        if not isinstance(node, ast.Expr) or not isinstance(node.value, ast.Constant):
            continue
        text = node.value.value
        if isinstance(text, str) and re.match(r"\s*(Of|Those|Whose|What)\b", text):
            wrong.append(f"{name_of(path)}:{node.lineno}")
    assert wrong == []


def test_types_are_rarely_left_open() -> None:
    found = [
        path
        for path, node in nodes()
        if isinstance(node, ast.Name)
        and node.id == "Any"
        and path.relative_to(ROOT).parts[0] != "tests"
    ]
    assert len(found) <= MOST_ANY, sorted({name_of(path) for path in found})


def test_the_formatter_is_never_switched_off() -> None:
    switch = re.compile(r"#\s*fmt:\s*(skip|off)")
    assert [name_of(path) for path, text in texts().items() if switch.search(text)] == []
