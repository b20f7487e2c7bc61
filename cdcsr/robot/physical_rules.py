"""Numbers of a robot description that no robot has, or that no engine can compute with."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic_core import InitErrorDetails, PydanticCustomError

Place = tuple[str | int, ...]

MOST_LINKS = 500
"""The largest number of links of a segment."""
_LEAST, _MOST = 1e-9, 1e9
"""The range of all numbers, in their units. Products of several such numbers stay far inside the
range of double precision."""
_NOT_TINY = {
    *("time_step", "recovery_time", "links", "length", "radius", "mass", "inertia", "size"),
    *("pitch_radius", "guide_offset", "gain", "eta", "offset", "youngs_modulus", "density"),
    *("axial_stiffness", "force_limit", "largest_tension"),
}
"""The keys whose numbers have a lower bound above zero."""
_RANGES: dict[str, tuple[float, float]] = {
    "time_step": (1e-6, 0.1),
    "links": (1, MOST_LINKS),
    "inertia": (1e-14, 1e9),
    "youngs_modulus": (1e-9, 1e13),
}
"""The ranges of keys for which that is too wide or too narrow."""
MOST_SEGMENTS, _MOST_CABLES = 64, 64
_TOO_LARGE = 1e300
"""An integer beyond this has no place in a float."""
_DEEPEST = 8
"""The description has no deeper sections; deeper ones hold unknown keys."""


def positive_number(data: Any, *place: str | int) -> float | None:
    """Return a number of data that may be broken in any way; None if it is not positive and
    finite."""
    value = data
    for key in place:
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):
            return None
    if not isinstance(value, int | float) or isinstance(value, bool) or not 0 < value < _TOO_LARGE:
        return None
    return float(value)


def broken_rule(data: Any, place: Place, message: str) -> InitErrorDetails:
    """Return the error of the number at `place`."""
    return _error(place, message, positive_number(data, *place))


def _error(place: Place, message: str, found: object) -> InitErrorDetails:
    kind = PydanticCustomError("value_error", "{message}", {"message": message})
    return InitErrorDetails(type=kind, loc=place, input=found)


def errors_of_magnitude(data: Any, place: Place = ()) -> Iterator[InitErrorDetails]:
    """Yield the numbers and the lists that are out of range, wherever they stand."""
    if isinstance(data, Mapping) and len(place) < _DEEPEST:
        for key, value in data.items():
            yield from errors_of_magnitude(value, (*place, key))
    elif isinstance(data, list | tuple) and len(place) < _DEEPEST:
        key = place[-1] if place else ""
        most = {"segments": MOST_SEGMENTS, "angles_deg": _MOST_CABLES}.get(str(key), 500)
        if len(data) > most:
            yield _error(place, f"at most {most} are allowed", len(data))
            return
        for i, value in enumerate(data):
            yield from errors_of_magnitude(value, (*place, i))
    elif isinstance(data, int | float) and not isinstance(data, bool) and data and data == data:
        name = next((key for key in reversed(place) if isinstance(key, str)), "")
        low, high = _RANGES.get(name, (_LEAST, _MOST))
        low = low if name in _NOT_TINY and place[0] != "workspace" else 0.0
        if not low <= abs(data) <= high and abs(data) != math.inf:
            found = data if abs(data) < _TOO_LARGE else None
            yield _error(place, f"must lie between {low:g} and {high:g}", found)


def errors_of_bodies(data: Any) -> Iterator[InitErrorDetails]:
    """Yield the numbers that contradict each other for any body or cable.

    All mass of a body lies within some distance r of its centre, so no moment of inertia exceeds
    mass times r^2. For the base r is its diagonal, which leaves room for panels beside it; for a
    link it is its length and twice its radius or that of its cables.
    """
    edges = [positive_number(data, "base", "size", i) for i in range(3)]
    if None not in edges:
        reach = math.hypot(*(edge for edge in edges if edge))
        yield from _too_large_inertia(data, ("base",), reach)
    count = _length(data, "segments")
    arm = 0.0
    for i in range(min(count, MOST_SEGMENTS)):
        place: Place = ("segments", i)
        links = link_places(data, i)
        number = 1.0 if len(links) > 1 else positive_number(data, *place, "links") or 1
        pitches = [
            positive_number(data, "segments", j, "cables", "pitch_radius") or 0.0
            for j in range(i, min(count, MOST_SEGMENTS))
        ]
        for link in links:
            length = positive_number(data, *link, "length")
            arm += (length or math.inf) * number
            if length:
                wide = max(positive_number(data, *link, "radius") or 0.0, *pitches)
                yield from _too_large_inertia(data, link, length + 2 * wide)
        yield from _impossible_cables(data, i, arm, edges)
        ball = positive_number(data, *place, "servo", "radius")
        mass = positive_number(data, *place, "servo", "mass")
        least = _RANGES["inertia"][0]
        if ball and mass and 0.4 * mass * ball**2 < least:
            yield broken_rule(
                data,
                (*place, "servo", "radius"),
                f"gives a ball of {mass:g} kg less inertia than the {least:g} kg m^2 that engines "
                "compute with",
            )


def _too_large_inertia(data: Any, place: Place, reach: float) -> Iterator[InitErrorDetails]:
    mass = positive_number(data, *place, "mass")
    moments = [positive_number(data, *place, "inertia", i) for i in range(3)]
    largest = max((moment or 0.0 for moment in moments), default=0.0)
    if mass and largest > mass * reach**2:
        yield broken_rule(
            data,
            (*place, "inertia", moments.index(largest)),
            f"is more than {mass * reach**2:.3g} kg m^2, which {mass:g} kg have at a distance of "
            f"{reach:.3g} m from their centre",
        )


def _impossible_cables(
    data: Any, i: int, arm: float, edges: Sequence[float | None]
) -> Iterator[InitErrorDetails]:
    """Yield the errors of the cables of segment `i`.

    Args:
        data: the description.
        i: the segment.
        arm: the length of the arm up to its end, in [m]; infinite if it is unknown.
        edges: the edges of the base, in [m].
    """
    place = ("segments", i, "cables")
    pitch = positive_number(data, *place, "pitch_radius")
    if pitch is None:
        return
    if pitch > 2 * arm:
        yield broken_rule(
            data,
            (*place, "pitch_radius"),
            f"must be at most twice the length of the arm below these cables' end ({2 * arm:g} m)",
        )
    angles = _angles(data, place)
    for angle in angles:
        across = abs(math.cos(angle)), abs(math.sin(angle))
        rooms = [edge / 2 / a for edge, a in zip(edges, across, strict=False) if edge and a > 1e-9]
        if rooms and pitch > min(rooms) * (1 + 1e-9):
            yield broken_rule(
                data,
                (*place, "pitch_radius"),
                f"puts a cable outside the base: must be at most {min(rooms):g} m",
            )
            break
    if len(angles) > 1 and all(math.cos(angle - angles[0]) > 1 - 1e-12 for angle in angles):
        yield _error((*place, "angles_deg"), "puts all cables at one place", None)


def link_places(data: Any, i: int) -> list[Place]:
    """Return where the rigid links of segment `i` stand: in its chain, or else its one link."""
    place: Place = ("segments", i, "chain")
    listed = _length(data, *place)
    return [(*place, n) for n in range(min(listed, MOST_LINKS))] or [("segments", i, "link")]


def _angles(data: Any, place: Place) -> list[float]:
    """Return the directions of a segment's cables in [rad]; none if one of them is no number."""
    try:
        angles = data["segments"][place[1]]["cables"]["angles_deg"]
        return [math.radians(float(angle)) for angle in angles[:_MOST_CABLES]]
    except (KeyError, IndexError, TypeError, ValueError, OverflowError):
        return []


def _length(data: Any, *place: str | int) -> int:
    try:
        for key in place:
            data = data[key]
        return len(data)
    except (KeyError, IndexError, TypeError):
        return 0
