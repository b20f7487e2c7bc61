"""Errors in a robot description, as its author can use them: line, key, rule and what was found."""

from __future__ import annotations

from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError


def report_again(error: ErrorDetails) -> InitErrorDetails:
    """Turn a reported error into the input of a new report."""
    kind = PydanticCustomError("error", "{message}", {"message": message(error)})
    return InitErrorDetails(type=kind, loc=error["loc"], input=error["input"])


def message(error: ErrorDetails) -> str:
    """Return the rule that was broken."""
    if error["type"] == "extra_forbidden":
        return "unknown key"
    return error["msg"].removeprefix("Value error, ").removeprefix("Input ")


def describe(text: str, error: ErrorDetails) -> str:
    """Return an error as text: its line in the TOML text, its key, the rule, and what was found."""
    keys = (f"[{key}]" if isinstance(key, int) else f".{key}" for key in error["loc"])
    place = "".join(keys).lstrip(".")
    number = line_number(text, error["loc"])
    where = f"line {number}, {place}" if number else place
    found = error["input"]
    shown = f" (found {found!r})" if isinstance(found, int | float | str | list | tuple) else ""
    return f"{where}: {message(error)}{shown}"


def line_number(text: str, place: tuple[str | int, ...]) -> int | None:
    """Return the line number that sets `place`, or else opens the innermost table around it."""
    counts: dict[str, int] = {}
    table: list[str | int] = []
    best, best_depth = None, 0
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split("#")[0].strip()
        if line.startswith("["):
            keys = line.strip("[] \t").replace(" ", "").split(".")
            if line.startswith("[["):
                counts[keys[0]] = counts.get(keys[0], -1) + 1
            table = [keys[0], counts[keys[0]], *keys[1:]] if keys[0] in counts else list(keys)
            here = tuple(table)
        elif "=" in line:
            here = (*table, *line.split("=")[0].strip().replace(" ", "").split("."))
        else:
            continue
        if here == place[: len(here)] and len(here) > best_depth:
            best, best_depth = number, len(here)
    return best
