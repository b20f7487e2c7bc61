"""The ruler and the clock by which a robot's tasks are measured, as a description gives them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cdcsr.robot.parts import Part, Positive


class Scale(Part):
    """Numbers of the tasks that depend on the robot's size and pace; all of them are optional.

    What is not given follows from `length` and `time`, such that the robot of the BATD3 paper gets
    the numbers of the paper (:mod:`cdcsr.robot.ruler`). None of them affects the motion.
    """

    later = (
        *("length", "time", "threshold", "floating", "spatter", "seconds", "frame_skip"),
        *("capture_speed", "base_shift", "base_tilt", "tip_speed", "spacing"),
    )
    length: Positive | None = None
    """All lengths below are parts of it, in [m]; by default the length of the arm."""
    time: Positive | None = None
    """All times below are multiples of it, in [s]; by default the arm's answer time."""
    threshold: Positive | None = None
    """The tip is on a target within this distance, in [m]."""
    floating: Positive | None = None
    """The radius xi_F of the balls of the Floating Space, in [m]."""
    spatter: Positive | None = None
    """The radius xi_S of the balls of the Spatter Space, in [m]."""
    seconds: Positive | None = None
    """How long an episode of reaching may take, in [s]; capturing has twice, following four times
    as long."""
    frame_skip: Annotated[int, Field(ge=1)] | None = None
    """How many time steps an action is held for; by default a 250th of `seconds`."""
    capture_speed: Positive | None = None
    """A captured target is held slower than this, in [m/s]."""
    base_shift: Positive | None = None
    """The largest distance of a quiet base from its start, in [m]."""
    base_tilt: Positive | None = None
    """The largest angle of a quiet base from its start, in [rad]."""
    tip_speed: Positive | None = None
    """The largest tip speed that the demonstrator wishes for, in [m/s]."""
    spacing: Positive | None = None
    """The distance between the targets that a map of the workspace tries, in [m]."""
