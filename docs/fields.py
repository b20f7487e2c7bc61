"""The page of all fields of a description, made from the models that read it."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.pycode import ModuleAnalyzer

from cdcsr.robot.description import Robot

_HEAD = """# Every field of a description

All lengths in m, masses in kg, angles in rad unless a name says degrees. A field without a default
must be given. [Your own robot](/your-own-robot.md) says how to begin.

![A robot with the names of its lengths](geometry.png)

`python docs/geometry.py geometry.png` draws this from a description.
"""
_BOUNDS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}


def fields_page() -> str:
    """Return the page: a table for each section."""
    parts = [_HEAD]
    for path, model in _sections(Robot, ""):
        title = f"`[{path}]`" if path else "Top level"
        text = _plain(model.__doc__ or "")
        rows = "\n".join(filter(None, (_row(model, *each) for each in model.model_fields.items())))
        parts.append(f"## {title}\n\n{text}\n")
        if rows:
            parts.append(f"| key | kind | default | meaning |\n| --- | --- | --- | --- |\n{rows}\n")
    return "\n".join(parts)


def _sections(model: type[BaseModel], path: str) -> Iterator[tuple[str, type[BaseModel]]]:
    """Yield every section with its dotted path, in the order of the fields."""
    yield path, model
    for name, field in model.model_fields.items():
        inner = _model_in(field.annotation)
        if inner is not None:
            yield from _sections(inner, f"{path}.{field.alias or name}".lstrip("."))


def _model_in(kind: Any) -> type[BaseModel] | None:
    """Return the model that an annotation holds, if it holds one."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return kind
    return next((found for arg in get_args(kind) if (found := _model_in(arg))), None)


def _row(model: type[BaseModel], name: str, field: FieldInfo) -> str:
    """Return the row of a field; a field that is a section has none."""
    if _model_in(field.annotation) is not None:
        return ""
    default = "" if field.is_required() else _shown(field.default)
    kind = _kind(
        Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
    )
    cells = [f"`{field.alias or name}`", kind, default, _meaning(model, name)]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _kind(kind: Any) -> str:
    """Return a type and its bounds in words."""
    if get_origin(kind) is Annotated:
        inner, *metadata = get_args(kind)
        bounds = [
            f"{word} {getattr(each, key):.6g}"
            for each in _flat(metadata)
            for key, word in _BOUNDS.items()
            if getattr(each, key, None) is not None
        ]
        return " ".join([_kind(inner), ", ".join(bounds)]).strip()
    if get_origin(kind) is Literal:
        return " or ".join(f"`{choice}`" for choice in get_args(kind))
    arguments = [arg for arg in get_args(kind) if arg is not type(None)]
    if get_origin(kind) is tuple:
        inner = _kind(arguments[0]).replace("number", "numbers", 1)
        return inner if arguments[-1] is Ellipsis else f"{len(arguments)} {inner}"
    if arguments:
        return " or ".join(map(_kind, arguments))
    names = {float: "number", int: "whole number", str: "text", bool: "`true` or `false`"}
    return names.get(kind, str(kind))


def _flat(metadata: list[Any]) -> Iterator[Any]:
    """Yield constraints, also those inside a pydantic field."""
    for each in metadata:
        yield each
        if isinstance(each, FieldInfo):
            yield from each.metadata


def _shown(default: object) -> str:
    """Return a default as TOML would say it."""
    if default is None or default == ():
        return "none"
    if isinstance(default, tuple):
        return f"`[{', '.join(map(str, default))}]`"
    return f"`{str(default).lower() if isinstance(default, bool) else default}`"


def _meaning(model: type[BaseModel], name: str) -> str:
    """Return the docstring below a field, of the class that declares it."""
    for owner in model.__mro__:
        if name in inspect.get_annotations(owner):
            docs = ModuleAnalyzer.for_module(owner.__module__).find_attr_docs()
            return _plain(" ".join(docs.get((owner.__name__, name), [])))
    return ""


def _plain(text: str) -> str:
    """Return a docstring as Markdown."""
    lines = [line.strip() for line in text.strip().splitlines()]
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", "\n".join(lines)).strip()
