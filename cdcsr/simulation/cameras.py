"""The named views from which every engine draws a robot, and the size of its pictures."""

from __future__ import annotations

from cdcsr.errors import CdcsrError, unknown_choice

CAMERAS: dict[str, tuple[float, float]] = {
    "side": (55.0, -8.0),
    "front": (0.0, 0.0),
    "top": (55.0, -50.0),
}
"""Named views: azimuth around z from the y axis and elevation, in degrees. All look at the middle
of the robot."""

HEIGHT, WIDTH = 640, 480
"""The size of a picture in pixels, upright as the robot is."""


def camera_angles(name: str) -> tuple[float, float]:
    """Return the azimuth and the elevation of a named view, in degrees; see :data:`CAMERAS`.

    Raises:
        CdcsrError: there is no view of that name.
    """
    if name not in CAMERAS:
        raise CdcsrError(unknown_choice("camera", name, CAMERAS))
    return CAMERAS[name]
