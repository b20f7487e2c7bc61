"""What is wrong with a description, said so that its author finds the place: which line, which key, what is allowed."""

from __future__ import annotations

from typing import Any

from pydantic_core import InitErrorDetails, PydanticCustomError


def again(line: Any) -> InitErrorDetails:
    """A reported error as the input for a new report."""
    kind = PydanticCustomError("error", "{message}", {"message": message(line)})
    return InitErrorDetails(type=kind, loc=line["loc"], input=line["input"])


def message(line: Any) -> str:
    """The rule that was broken."""
    if line["type"] == "extra_forbidden":
        return "unknown key"
    return line["msg"].removeprefix("Value error, ").removeprefix("Input ")


def describe(text: str, line: Any) -> str:
    """One reported error with its line in the TOML text, its key, the rule, and what was found."""
    place = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in line["loc"]).lstrip(".")
    number = line_number(text, line["loc"])
    where = f"line {number}, {place}" if number else place
    found = line["input"]
    shown = f" (found {found!r})" if isinstance(found, int | float | str | list | tuple) else ""
    return f"{where}: {message(line)}{shown}"


def line_number(text: str, place: tuple[str | int, ...]) -> int | None:
    """The line that sets `place`, or else opens the innermost table around it."""
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
