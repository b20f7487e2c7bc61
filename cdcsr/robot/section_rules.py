"""Rules of a robot description that tie its sections together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from math import inf
from typing import Any

from pydantic_core import InitErrorDetails

from cdcsr.robot.physical_rules import (
    broken_rule,
    errors_of_bodies,
    errors_of_magnitude,
    link_places,
    positive_number,
)


def _errors_of_paths(data: Any, i: int) -> Iterator[InitErrorDetails]:
    """Yield the paths of segment `i` that run where there is no link or no base."""
    number = partial(positive_number, data)
    counts = [number("segments", j, "links") for j in range(len(data["segments"]))]
    cables = data["segments"][i]["cables"]
    paths = cables.get("paths", ()) if isinstance(cables, Mapping) else ()
    if not isinstance(paths, list | tuple) or not all(counts):
        return
    links = [count or 0.0 for count in counts]
    room = min((number("base", "size", axis) or inf) / 2 for axis in (0, 1))
    for n in range(min(len(paths), 64)):
        place = ("segments", i, "cables", "paths", n)
        own = paths[n].get("last_link") if isinstance(paths[n], Mapping) else None
        last = number(*place, "last_link") or (0 if own == 0 else sum(links[: i + 1]) - 1)
        if last >= sum(links):
            yield broken_rule(
                data, (*place, "last_link"), f"must be at most {sum(links) - 1:g}, the last link"
            )
        if (number(*place, "first_link") or 0) > last:
            yield broken_rule(
                data, (*place, "first_link"), f"must be at most {last:g}, the link it ends on"
            )
        if (number(*place, "pitch_radius") or 0) > room:
            yield broken_rule(
                data,
                (*place, "pitch_radius"),
                f"puts a cable outside the base: must be at most {room:g} m",
            )


def errors_between_sections(data: Any) -> Iterator[InitErrorDetails]:
    """Yield the errors between sections of data that may be broken in any way.

    A number that is missing or wrong in itself is passed over: other checks report it.
    """

    number, error = partial(positive_number, data), partial(broken_rule, data)
    yield from errors_of_magnitude(data)
    yield from errors_of_bodies(data)
    step, recovery = number("time_step"), number("constraint", "recovery_time")
    if step and recovery and recovery < 2 * step:
        yield error(
            ("constraint", "recovery_time"), f"must be at least two time steps ({2 * step:g} s)"
        )
    try:
        count = len(data["segments"])
    except (KeyError, TypeError):
        return
    height = number("base", "size", 2)
    for i in range(count):
        slider = ("segments", i, "servo", "offset")
        ball, below = number("segments", i, "servo", "radius"), number(*slider)
        if ball and below and below <= ball:
            yield error(
                slider, f"puts the slider into its guide: must be above its radius ({ball:g} m)"
            )
        place = ("segments", i, "cables", "guide_offset")
        offset = number(*place)
        if offset is None:
            continue
        yield from _errors_of_paths(data, i)
        for j in range(count if number(*place[:3], "paths", 0, "last_link") else i + 1):
            lengths = [(link, number(*link, "length")) for link in link_places(data, j)]
            rod, links = number("segments", j, "backbone", "length"), number("segments", j, "links")
            short = [link for link, length in lengths if length and offset >= length / 2]
            if short:
                name = "".join(
                    f"[{key}]" if isinstance(key, int) else f".{key}" for key in short[0]
                )
                yield error(
                    place,
                    "puts a guide outside its link: must be below half of "
                    f"{name[1:]}.length ({(number(*short[0], 'length') or 0) / 2:g} m)",
                )
                break
            if rod is not None and links is not None and offset >= rod / links / 4:
                yield error(  # the last link is half a cell
                    place,
                    "puts a guide outside its link: must be below a quarter of "
                    f"segments[{j}].backbone.length / links ({rod / links / 4:g} m)",
                )
                break
        if height and below is not None and offset + below > height:
            yield error(
                slider,
                f"puts the slider outside the base: must be at most {height - offset:g} m",
            )
