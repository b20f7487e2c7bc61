"""`cdcsr new-robot`: describe an arm of any size."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from cdcsr.robot.description import Robot

_SHARES = (1.0, 0.75, 0.5, 0.25)
"""The sizes of the Anchor Space that are tried, as parts of the one in proportion."""


def new_robot(
    name: str,
    /,
    *,
    length: float = 0.5,
    segments: int = 2,
    cables: int = 4,
    links: int = 6,
    base_mass: float | None = None,
    mount: Literal["free", "fixed"] = "free",
    gravity: bool = False,
    out: Path | None = None,
) -> None:
    """Write the commented description of a new arm, whose targets the demonstrator reaches.

    The arm is similar to that of the paper. The scripted demonstrator tries the corners and the
    middle of the cuboid of targets in MuJoCo; the cuboid shrinks until it reaches them all.

    Args:
        name: the robot's name: lower-case letters, digits and hyphens.
        length: of the arm, in m.
        segments: how many segments.
        cables: how many cables each segment has.
        links: how many links each segment has.
        base_mass: of the base, in kg; by default in proportion.
        mount: free for a base that floats, or fixed.
        gravity: let the arm hang in gravity.
        out: the file to write; by default NAME.toml. A file that is there is never overwritten.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.files import refuse_unwritable, write_text
    from cdcsr.robot.description import parse_robot
    from cdcsr.robot.ruler import ruler
    from cdcsr.robot.sizing import NewRobot

    path = Path(f"{name}.toml") if out is None else out
    if path.suffix != ".toml":
        raise CdcsrError(f"A robot is a .toml file, not {path.name!r}.")
    if path.exists():
        raise CdcsrError(f"{path} is there already, and is not overwritten; give another --out.")
    edge = 0.0
    for share in _SHARES:
        text = NewRobot(
            name, length, segments, cables, links, base_mass, mount, gravity, cuboid=share
        ).text()
        robot = parse_robot(text, name)
        refuse_unwritable(path)
        reached = _reached_corners(robot)
        edge = robot.workspace.size[0]
        print(f"targets in a cuboid of {edge:g} m: {reached} of 9 reached", flush=True)
        if reached == 9:
            break
    else:
        raise CdcsrError(
            f"The demonstrator does not reach a cuboid of {edge:g} m, so {path} is not written; "
            "choose more segments or cables, or a heavier base."
        )
    write_text(path, text)
    own = ruler(robot)
    print(
        f"{robot.name}: {robot.num_links} links, {robot.num_cables} cables, arm "
        f"{robot.arm_length:g} m, {robot.total_mass:.4g} kg, time step {robot.time_step:g} s, "
        f"an action every {own.frame_skip} steps, episodes of {own.seconds:g} s, threshold "
        f"{own.threshold:g} m -> {path}"
    )


def _reached_corners(robot: Robot) -> int:
    """Return how many of nine targets the demonstrator reaches: corners and middle of Anchor."""
    import itertools
    from contextlib import closing

    import numpy as np

    from cdcsr.envs.gym_env import TaskVectorEnv
    from controllers.jacobian import JacobianController
    from controllers.rollout import rollout

    half = np.array(robot.workspace.size) / 2
    corners = np.array([*itertools.product((-1, 1), repeat=3), (0, 0, 0)])
    with closing(TaskVectorEnv(len(corners), robot, autoreset_mode="Disabled")) as env:
        targets = np.array(robot.workspace.center) + half * corners
        observation, _ = env.reset(options={"targets": targets})
        return int(rollout(JacobianController(robot), env, observation).success.sum())
