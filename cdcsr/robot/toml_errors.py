"""Errors in a robot description, as its author can use them: line, key, rule and what was found."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterator, Sequence
from typing import get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

_SHOWN = 12
"""The number of errors that a report shows in full."""


class _Brief(reprlib.Repr):
    """Shorten what was found."""

    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to write an integer of more than 4,300 digits.
        return f"an integer of {bits} bits" if (bits := x.bit_length()) > 999 else repr(x)


_brief = _Brief()
_brief.maxstring = _brief.maxother = _brief.maxlong = 60


def without_echoes(errors: Sequence[ErrorDetails]) -> Iterator[ErrorDetails]:
    """Yield the errors but those that only repeat others: a list all of whose items have errors is
    reported as an empty list too."""
    inside = {error["loc"][:n] for error in errors for n in range(len(error["loc"]))}
    return (e for e in errors if e["type"] != "too_short" or e["loc"] not in inside)


def report_again(error: ErrorDetails) -> InitErrorDetails:
    """Turn a reported error into the input of a new report."""
    kind = PydanticCustomError("error", "{message}", {"message": message(error)})
    return InitErrorDetails(type=kind, loc=error["loc"], input=error["input"])


def message(error: ErrorDetails) -> str:
    """Return the rule that was broken."""
    if error["type"] == "extra_forbidden":
        return "unknown key"
    return error["msg"].removeprefix("Value error, ").removeprefix("Input ")


def describe_all(text: str, error: ValidationError, model: type[BaseModel]) -> str:
    """Return the errors in a description as one line; of many, the first few are shown.

    Args:
        text: the TOML text.
        error: what is wrong in it.
        model: the class of the description, which knows the keys.
    """
    errors = error.errors(include_url=False, include_context=False)
    shown = [describe(text, one, model) for one in errors[:_SHOWN]]
    if len(errors) > _SHOWN:
        shown.append(f"and {len(errors) - _SHOWN} more")
    count = f"{len(errors)} error" + "s" * (len(errors) != 1)
    return f"{count} in the robot description: " + "; ".join(shown)


def describe(text: str, error: ErrorDetails, model: type[BaseModel]) -> str:
    """Return an error as text: its line in the TOML text, its key, the rule, and what was found."""
    keys = (f"[{key}]" if isinstance(key, int) else f".{key[:60]}" for key in error["loc"])
    place = "".join(keys).lstrip(".")
    number = line_number(text, error["loc"])
    where = f"line {number}, {place}" if number else place
    found = error["input"]
    shown = (
        f" (found {_brief.repr(found)})"
        if isinstance(found, int | float | str | list | tuple)
        else ""
    )
    return f"{where}: {message(error)}{_hint(error, model)}{shown}"


def _hint(error: ErrorDetails, model: type[BaseModel]) -> str:
    """Return the known key that is most like an unknown one, as a question."""
    *sections, key = error["loc"] or ("",)
    if message(error) != "unknown key" or not isinstance(key, str):
        return ""
    for section in sections:
        if isinstance(section, str) and section in (fields := _fields(model)):
            model = _section(fields[section].annotation) or model
    close = difflib.get_close_matches(key[:60], _fields(model), n=1)
    return f", did you mean {close[0]!r}?" if close else ""


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a section by the keys with which they are written."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _section(annotation: object) -> type[BaseModel] | None:
    """Return the class of a section in the annotation of a field."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for one in get_args(annotation) if (found := _section(one))), None)


def line_number(text: str, place: tuple[str | int, ...]) -> int | None:
    """Return the line number that sets `place`, or else opens the innermost table around it."""
    counts: dict[tuple[str | int, ...], int] = {}  # of the tables in each array of tables
    table: list[str | int] = []
    best, best_depth = None, 0
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split("#")[0].strip()
        if line.startswith("["):
            keys = line.strip("[] \t").replace(" ", "").split(".")
            table = []
            for depth, key in enumerate(keys, start=1):
                table.append(key)
                if line.startswith("[[") and depth == len(keys):
                    counts[tuple(table)] = counts.get(tuple(table), -1) + 1
                if tuple(table) in counts:
                    table.append(counts[tuple(table)])
            here = tuple(table)
        elif "=" in line:
            here = (*table, *line.split("=")[0].strip().replace(" ", "").split("."))
        else:
            continue
        if here == place[: len(here)] and len(here) > best_depth:
            best, best_depth = number, len(here)
    return best
