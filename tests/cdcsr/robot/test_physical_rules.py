"""Numbers that no robot has: what is at a bound is allowed, what is beyond it is not."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from copy import deepcopy
from math import hypot, sqrt
from typing import Any

import pytest

from cdcsr.robot.description import load_robot
from cdcsr.robot.section_rules import errors_between_sections

Data = dict[str, Any]
PAPER: Data = tomllib.loads(load_robot("paper").to_toml())
Place = tuple[str | int, ...]


def changed(data: Data, *changes: tuple[Place, object]) -> Data:
    """Return a copy of data with other values at some places."""
    copy = deepcopy(data)
    for place, value in changes:
        below: Any = copy
        for key in place[:-1]:
            below = below[key]
        below[place[-1]] = value
    return copy


def broken(data: object) -> list[tuple[Place, str]]:
    """Return the place and the message of each broken rule."""
    found = errors_between_sections(data)
    return [(one["loc"], str(one["type"])) for one in found if "loc" in one]


def bounds() -> Iterator[tuple[Place, float]]:
    """Yield numbers of the paper's robot with the largest or least value that is allowed."""
    yield ("time_step",), 1e-6
    yield ("segments", 0, "links"), 500
    yield ("segments", 0, "servo", "gain"), 1e9
    yield ("segments", 0, "servo", "gain"), 1e-9
    yield ("segments", 0, "servo", "eta"), 1e-9
    yield ("segments", 0, "servo", "mass"), 1e-9
    yield ("segments", 0, "joint", "damping"), 1e9
    yield ("segments", 0, "link", "length"), 1e9
    yield ("base", "mass"), 1e9
    yield ("workspace", "center", 0), -1e9
    # A ball of a radius r and a mass m has 0.4 m r^2, of which 1e-14 kg m^2 is the least.
    yield ("segments", 0, "servo", "radius"), sqrt(1e-14 / 0.4 / 0.2) * (1 + 1e-12)
    # The base's diagonal; a link's length and twice the radius of its cables.
    yield ("base", "inertia", 2), 500 * 3 * 0.6**2 * (1 - 1e-12)
    yield ("segments", 1, "link", "inertia", 0), 1.18 * (0.2 + 2 * 0.02) ** 2 * (1 - 1e-12)
    yield ("segments", 1, "servo", "offset"), 0.6 - 0.02
    yield ("constraint", "recovery_time"), 2 * 0.0025


@pytest.mark.parametrize(("place", "bound"), [*bounds()], ids=str)
def test_a_bound_is_allowed_and_what_is_beyond_is_not(place: Place, bound: float) -> None:
    assert broken(changed(PAPER, (place, bound))) == []
    beyond = {one for by in (1.02, 1 / 1.02) for one in broken(changed(PAPER, (place, bound * by)))}
    assert [one for one, _ in beyond] == [place], beyond


def test_ranges_hold_for_either_sign_and_wherever_a_key_stands() -> None:
    """Only keys that must not be tiny have a lower bound, and targets have none."""
    mass: Place = ("base", "mass")
    message = "must lie between 1e-09 and 1e+09"
    for tiny in (1e-10, -1e-10):
        assert (mass, message) in broken(changed(PAPER, (mass, tiny)))
    for place in (("workspace", "size", 0), ("segments", 0, "joint", "damping")):
        assert broken(changed(PAPER, (place, 1e-200))) == []
    rod = changed(PAPER, (("segments", 0, "backbone"), {"youngs_modulus": 1e13}))
    assert broken(rod) == []
    modulus: Place = ("segments", 0, "backbone", "youngs_modulus")
    message = "must lie between 1e-09 and 1e+13"
    assert broken(changed(rod, (modulus, 1.1e13))) == [(modulus, message)]
    (huge,) = errors_between_sections(changed(PAPER, (mass, 10**400)))
    assert huge.get("input") is None  # it has no place in a float
    (large,) = errors_between_sections(changed(PAPER, (mass, 1e290)))
    assert large.get("input") == 1e290


@pytest.mark.parametrize(
    ("place", "one", "most"),
    [
        (("segments",), PAPER["segments"][0], 64),
        (("segments", 0, "cables", "angles_deg"), 0.0, 64),
        (("base", "size"), 0.6, 500),
    ],
)
def test_lists_are_no_longer_than_they_may_be(place: Place, one: object, most: int) -> None:
    message = f"at most {most} are allowed"
    assert (place, message) not in broken(changed(PAPER, (place, [one] * most)))
    assert (place, message) in broken(changed(PAPER, (place, [one] * (most + 1))))


def test_cables_lie_within_the_base_and_the_arm() -> None:
    """At 0, 90, ... degrees a cable leaves the base of 0.6 m at 0.3 m, at 45 degrees at 0.42 m; and
    none lies further out than twice the arm below its end."""
    first, second = (("segments", s, "cables", "pitch_radius") for s in (0, 1))
    wide = (("base", "size"), [0.6, 0.4, 0.6])
    assert broken(changed(PAPER, (first, 0.3))) == []
    message = "puts a cable outside the base: must be at most 0.3 m"
    assert broken(changed(PAPER, (first, 0.3001))) == [(first, message)]
    assert broken(changed(PAPER, wide, (first, 0.2001)))[0][1].endswith("at most 0.2 m")
    diagonal = hypot(0.3, 0.3)
    assert broken(changed(PAPER, (second, diagonal))) == []
    assert broken(changed(PAPER, (second, 1.001 * diagonal)))[0][0] == second
    short = [(("segments", s, "link", "length"), 0.05) for s in (0, 1)]
    large = (("base", "size"), [9.0, 9.0, 9.0]), (("base", "inertia"), [9.0, 9.0, 9.0])
    assert broken(changed(PAPER, *short, *large, (first, 0.6), (second, 1.2))) == []
    found = broken(changed(PAPER, *short, *large, (first, 0.61), (second, 1.21)))
    ends = "must be at most twice the length of the arm below these cables' end"
    assert found == [(first, f"{ends} (0.6 m)"), (second, f"{ends} (1.2 m)")]


def test_cables_of_one_place_are_none() -> None:
    place: Place = ("segments", 0, "cables", "angles_deg")
    for angles in ([0.0, 360.0], [10.0, 370.0, -350.0]):
        message = "puts all cables at one place"
        assert broken(changed(PAPER, (place, angles))) == [(place, message)]
    for angles in ([0.0], [0.0, 1.0], [0.0, 360.0, 90.0]):
        assert broken(changed(PAPER, (place, angles))) == []


def test_a_slider_lies_below_its_guide_by_more_than_its_radius() -> None:
    place: Place = ("segments", 0, "servo", "offset")
    assert broken(changed(PAPER, (place, 0.0101))) == []
    for inside in (0.01, 0.004):
        (one,) = broken(changed(PAPER, (place, inside)))
        assert one[0] == place
        assert one[1].endswith("must be above its radius (0.01 m)")


def test_a_guide_lies_within_each_link_that_its_cable_passes() -> None:
    """The last link of a rod in six cells of 0.2 m is half a cell, which has two guides."""
    second: Place = ("segments", 1, "cables", "guide_offset")
    assert broken(changed(PAPER, (second, 0.0999))) == []
    (one,) = broken(changed(PAPER, (second, 0.1)))
    assert one[0] == second
    assert one[1].endswith("must be below half of segments[0].link.length (0.1 m)")
    rod = {"length": 1.2, "radius": 0.02}
    data = changed(PAPER, *[(("segments", 0, key), None) for key in ("link", "joint")])
    data = changed(data, (("segments", 0, "backbone"), rod))
    assert broken(changed(data, (second, 0.0499))) == []
    (one,) = broken(changed(data, (second, 0.05)))
    assert one[1].endswith("a quarter of segments[0].backbone.length / links (0.05 m)")


@pytest.mark.parametrize(
    "data",
    [
        *(None, 3, [], {}, {"segments": None}, {"segments": 4}, {"segments": [None, 3, {}]}),
        *(changed(PAPER, ((key,), bad)) for key in PAPER for bad in (None, True, "x", [], {})),
    ],
)
def test_what_is_broken_in_itself_is_passed_over(data: object) -> None:
    assert all("must" in message or "allowed" in message for _, message in broken(data))
