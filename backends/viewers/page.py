"""A film as one page, which can be opened anywhere and looked at from all sides. Needs the extra
`view`."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import redirect_stdout
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backends.viewers.scene import EngineScene, look_at
from backends.viewers.web import LocalServer
from cdcsr.robot.description import Robot
from cdcsr.robot.poses import link_poses
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.tasks.debris import Surface

Array = NDArray[np.float64]


class Moment(NamedTuple):
    """One engine at one moment, as it is drawn."""

    position: Array
    """As in a Snapshot, shape (7 + C + H,)."""
    tension: Array
    """Shape (C,), in [N]."""
    target: Array
    """Shape (3,), in [m]."""


def page(
    robot: Robot,
    titles: Sequence[str],
    moments: Sequence[Sequence[Moment]],
    period: float,
    debris: Surface | None = None,
) -> str:
    """Return a page, in HTML, that shows moments one after another, again and again.

    Args:
        robot: the description.
        titles: of the engines, whose robots stand side by side.
        moments: at each moment one for each engine.
        period: for how long each is shown, in [s].
        debris: a piece of debris that stands beside each robot.
    """
    route, num_cables = routing(robot), robot.num_cables
    with redirect_stdout(io.StringIO()):  # viser prints its address, which is of no use here
        server = LocalServer("127.0.0.1", 0, verbose=False)
    try:
        scenes = [EngineScene(server, robot, title, n, debris) for n, title in enumerate(titles)]
        look_at(server, robot, scenes[-1])
        trails: list[list[Array]] = []
        serializer, before = server.get_scene_serializer(), np.full(3, np.nan)
        for engines in moments:
            if not np.array_equal(before, engines[0].target):  # another episode
                trails, before = [[] for _ in scenes], engines[0].target
            for scene, trail, (position, tension, target) in zip(
                scenes, trails, engines, strict=True
            ):
                travel, hinges = np.split(position[7:], [num_cables])
                slack = route.rest_length - cable_lengths(route, travel, hinges)
                trail.append(link_poses(robot, position).joint[-1])
                scene.draw(position, tension, slack, np.array(trail), target)
            serializer.insert_sleep(period)
        return serializer.as_html()
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()
