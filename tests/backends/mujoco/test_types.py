"""The types that this project declares for MuJoCo name only what MuJoCo has."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import mujoco
import pytest
from mujoco import batch

STUBS = Path(__file__).parents[3] / "typings" / "mujoco"


def public(body: list[ast.stmt]) -> Iterator[tuple[str, list[ast.stmt]]]:
    """Yield the names that a stub declares, each with the body of its class."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, node.body if isinstance(node, ast.ClassDef) else []
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id, []


def set_when_made(kind: type, name: str) -> bool:
    """Return whether a class of Python code sets an attribute in its constructor."""
    return kind is batch.Batch and name in {"model", "state"}


@pytest.mark.parametrize(("file", "module"), [("__init__.pyi", mujoco), ("batch.pyi", batch)])
def test_every_declared_name_exists(file: str, module: object) -> None:
    found = list(public(ast.parse((STUBS / file).read_text("utf-8")).body))
    assert found
    for name, body in found:
        assert hasattr(module, name), name
        kind = getattr(module, name)
        missing = [
            attribute
            for attribute, _ in public(body)
            if not hasattr(kind, attribute) and not set_when_made(kind, attribute)
        ]
        assert not missing, f"{name}: {missing}"
