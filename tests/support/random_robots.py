"""Random valid descriptions of robots, for property tests.

The fast tests draw the same few descriptions every time, so that they repeat (Hypothesis takes some
numbers from the code, so that other code may draw others), and end at once at one that fails; the
slow ones draw many new ones, and shrink one that fails.
"""

from __future__ import annotations

from typing import Any

from hypothesis import Phase, settings
from hypothesis import strategies as st

from cdcsr.robot.description import Robot

few = settings(
    max_examples=8,
    deadline=None,
    derandomize=True,
    database=None,
    phases=(Phase.explicit, Phase.generate),
)
many = settings(max_examples=200, deadline=None, database=None)


def between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


@st.composite
def inertias(draw: st.DrawFn, scale: float) -> tuple[float, float, float]:
    """Draw the inertia of a rigid body: each moment is the sum of two of three second moments."""
    x, y, z = (scale * draw(between(0.1, 1)) for _ in "xyz")
    return (y + z, x + z, x + y)


def _apart(angles: list[float]) -> bool:
    """Tell whether cables in these directions, in degrees, are not all at one place."""
    return len({round(angle, 3) % 360 for angle in angles}) > 1


@st.composite
def _segments(draw: st.DrawFn, offset: float) -> dict[str, Any]:
    """Draw a segment without cables, of links with room for guides at `offset` in [m]: joints of
    all kinds, given in numbers or by a material."""
    if draw(st.booleans()):
        links = draw(st.integers(1, 6))
        rod = {
            "length": links * offset * draw(between(4.4, 8)),
            "youngs_modulus": draw(between(1e6, 1e8)),
            "poissons_ratio": draw(between(-0.5, 0.5)),
            "density": draw(between(500, 5000)),
            "radius": draw(between(0.02, 0.05)),
            "inner_radius": draw(between(0, 0.015)),
            "damping_time": draw(between(0.01, 0.1)),
            "torsion": draw(st.booleans()),
            "curvature": (draw(between(-1, 1)), draw(between(-1, 1))),
        }
        if draw(st.booleans()):
            rod |= {"end_radius": draw(between(0.02, 0.05))}
        return {"links": links, "backbone": rod}
    length, mass = offset * draw(between(2.2, 5)), draw(between(0.1, 5))
    links, joint = _numbers(draw, length, mass)
    links["link"]["center"] = length * draw(between(0.01, 1))
    joint["order"] = draw(st.sampled_from(["xy", "yx", "x", "y"]))
    lower = -draw(between(0.5, 1))
    joint |= {"lower": lower, "rest": tuple(draw(between(lower, 0.5)) for _ in joint["order"])}
    if draw(st.booleans()):
        joint["torsion"] = {key: joint[key] for key in ("stiffness", "damping", "limit", "lower")}
    if draw(st.booleans()):
        links["taper"] = {"radius": draw(between(0.8, 1)), "mass": draw(between(0.5, 2))}
        moment = links["link"]["inertia"][0]
        links["link"]["inertia"] = (moment, moment, moment / 2)  # of a body, however thin
        return {**links, "joint": joint}
    other = {"length": 1.5 * length, "joint": joint | {"order": "y", "rest": ()}}
    return {"chain": [links["link"], links["link"] | other], "joint": joint}


def _length(segment: dict[str, Any]) -> float:
    """Return the length of a segment from :func:`_segments`, in [m]."""
    if "backbone" in segment:
        return segment["backbone"]["length"]
    links = segment.get("chain") or [segment["link"]] * segment["links"]
    return sum(link["length"] for link in links)


@st.composite
def _paths(draw: st.DrawFn, cables: dict[str, Any], last: int) -> dict[str, Any]:
    """Draw the same cables, or the first one or two of them, as cones and helices up to link
    `last`."""
    angles = cables["angles_deg"][: draw(st.sampled_from([1, 2, 6]))]
    if len(angles) > 1 and not _apart(angles):
        angles = angles[:1]
    paths = [
        {
            "angle_deg": angle,
            "end_pitch_radius": cables["pitch_radius"] * draw(between(0.5, 1)),
            "twist_deg": draw(between(-90, 90)),
            "first_link": draw(st.integers(0, last)),
            "last_link": last,
        }
        for angle in angles
    ]
    return {key: cables[key] for key in cables if key != "angles_deg"} | {"paths": paths}


@st.composite
def arms(draw: st.DrawFn) -> Robot:
    """Draw any arm: as :func:`robots`, and with a fixed or turned base, gravity, torsion, rods,
    passive segments, rough guides and links of which the centre of mass lies anywhere."""
    usual = draw(robots()).model_dump()
    base = usual["base"] | {
        "mount": draw(st.sampled_from(["free", "fixed"])),
        "position": tuple(draw(between(-1, 1)) for _ in "xyz"),
        "quaternion": draw(st.sampled_from([(1.0, 0.0, 0.0, 0.0), (0.5, -0.5, 0.1, 0.7)])),
    }
    segments = usual["segments"][:2]
    offset = max(segment["cables"]["guide_offset"] for segment in segments)
    ours = [draw(_segments(offset)) for _ in segments]
    for segment in segments:
        cables = segment["cables"]
        cables["pitch_radius"] = min(cables["pitch_radius"], 1.9 * _length(ours[0]))
        if draw(st.booleans()):
            pull = segment["servo"]["gain"] * segment["servo"]["eta"]
            segment["cables"]["axial_stiffness"] = pull * draw(between(1, 1000))
        if draw(st.booleans()):
            segment["cables"]["guide_friction"] = draw(between(0.01, 0.5))
        servo, kind = (
            segment["servo"],
            draw(st.sampled_from(["set-point", "displacement", "tension"])),
        )
        servo |= {"kind": kind, "pretension": draw(between(0, 5)), "force_limit": 50.0}
        if kind == "tension":
            servo["largest_tension"] = servo.pop("gain") * servo.pop("eta")
    for segment, own in zip(segments, ours, strict=True):
        if draw(st.integers(0, 2)):
            own |= {key: segment[key] for key in ("cables", "servo")}
    tail = [draw(_segments(offset))] if draw(st.booleans()) else []
    total = sum(len(own.get("chain", ())) or own["links"] for own in ours + tail)
    for own in ours:
        if "cables" in own and draw(st.booleans()):
            own |= {"cables": draw(_paths(own["cables"], min(1, total - 1)))}
    keys = {"gravity": tuple(draw(between(-10, 10)) for _ in "xyz"), "base": base}
    if draw(st.booleans()):
        keys["payload"] = {"mass": draw(between(0.01, 2)), "offset": 0.05}
    return Robot.model_validate(usual | keys | {"segments": ours + tail})


def _numbers(draw: st.DrawFn, length: float, mass: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Draw links of a length and mass, and joints between them."""
    joint = {
        "stiffness": draw(between(0, 5)),
        "damping": draw(between(0.05, 3)),
        "limit": draw(between(0.5, 3)),
    }
    link = {
        "length": length,
        "radius": draw(between(0.005, 0.1)),
        "mass": mass,
        "inertia": draw(inertias(mass * length**2 / 5)),
    }
    return {"links": draw(st.integers(1, 6)), "link": link}, joint


@st.composite
def robots(draw: st.DrawFn) -> Robot:
    """1 to 4 segments of 1 to 10 links and 3 to 6 cables each, from centimetres to metres and grams
    to tonnes.

    Mass goes with size, as it does in matter: a step of half a millisecond then is short for every
    spring.
    """
    height, heavy = draw(between(0.2, 2)), draw(between(20, 2000))
    segments: list[dict[str, Any]] = []
    shortest = height
    for _ in range(draw(st.integers(1, 4))):
        length, mass = draw(between(0.03, 0.5)), draw(between(0.1, 5))
        shortest = min(shortest, length)
        offset = draw(between(0.05, 0.45)) * shortest
        joint = {
            "stiffness": draw(between(0, 5)),
            "damping": draw(between(0.05, 3)),
            "limit": draw(between(0.5, 3)),
        }
        angles = draw(st.lists(between(-360, 360), min_size=3, max_size=6).filter(_apart))
        segments.append(
            {
                "links": draw(st.integers(1, 10)),
                "link": {
                    "length": length,
                    "radius": draw(between(0.005, 0.1)),
                    "mass": mass,
                    "inertia": draw(inertias(mass * length**2 / 5)),
                },
                "joint": joint,
                "cables": {
                    "angles_deg": angles,
                    "pitch_radius": draw(between(0.01, min(0.1, 2 * shortest))),
                    "guide_offset": offset,
                },
                "servo": {
                    "mass": draw(between(0.05, 1)),
                    "damping": draw(between(0, 50)),
                    "gain": draw(between(5, 100)),
                    "eta": draw(between(0.1, 5)),
                    "radius": draw(between(0.002, 0.009)),
                    "offset": max(draw(between(0.3, 0.99)) * (height - offset), 0.06),
                },
            }
        )
    base = {
        "size": (draw(between(0.2, 1)), 0.5, height),
        "mass": heavy,
        "inertia": draw(inertias(heavy / 10)),
    }
    return Robot.model_validate(
        {
            "name": draw(st.from_regex(r"\A[a-z][a-z0-9-]{0,10}\Z")),
            "time_step": 0.0005,
            "base": base,
            "constraint": {"recovery_time": 0.0005 * draw(between(2, 10))},
            "workspace": {"center": (0.0, 0.0, 1.0), "size": (0.1, 0.0, 0.2)},
            "segments": segments,
        }
    )
