"""`cdcsr new-robot`: describe an arm of any size."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdcsr.robot.description import Robot
    from cdcsr.robot.sizing import NewRobot

_SHARES = (1.0, 0.75, 0.5, 0.25)
"""The sizes of the Anchor Space and of Spatter that are tried, as parts of those in proportion."""
_SPATTER_TARGETS, _SPATTER_LEAST, _SPATTER_SEED = 400, 380, 30_000
"""How many targets of Spatter are tried, how many of them must be reached, and the seed that draws
them; nothing is measured on it."""


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
    middle of the cuboid of targets in MuJoCo; the cuboid shrinks until it reaches them all. Then it
    tries 400 targets of Spatter; the radius shrinks until it reaches 95 % of them.

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
    asked = NewRobot(name, length, segments, cables, links, base_mass, mount, gravity)
    asked.text()  # refuses numbers that contradict each other
    refuse_unwritable(path)
    asked = _with_spatter(_with_cuboid(asked, path), path)
    text = asked.text()
    robot = parse_robot(text, name)
    write_text(path, text)
    own = ruler(robot)
    print(
        f"{robot.name}: {robot.num_links} links, {robot.num_cables} cables, arm "
        f"{robot.arm_length:g} m, {robot.total_mass:.4g} kg, time step {robot.time_step:g} s, "
        f"an action every {own.frame_skip} steps, episodes of {own.seconds:g} s, threshold "
        f"{own.threshold:g} m -> {path}"
    )


def _with_cuboid(asked: NewRobot, path: Path) -> NewRobot:
    """Return the arm with the largest cuboid all of whose corners the demonstrator reaches.

    Raises:
        CdcsrError: it does not reach those of the smallest.
    """
    from dataclasses import replace

    from cdcsr.errors import CdcsrError
    from cdcsr.robot.description import parse_robot

    edge = 0.0
    for share in _SHARES:
        tried = replace(asked, cuboid=share)
        robot = parse_robot(tried.text(), asked.name)
        edge, reached = robot.workspace.size[0], _reached_corners(robot)
        print(f"targets in a cuboid of {edge:g} m: {reached} of 9 reached", flush=True)
        if reached == 9:
            return tried
    raise CdcsrError(
        f"The demonstrator does not reach a cuboid of {edge:g} m, so {path} is not written; "
        "choose more segments or cables, or a heavier base."
    )


def _with_spatter(asked: NewRobot, path: Path) -> NewRobot:
    """Return the arm with the largest radius of Spatter at which the demonstrator reaches 95 % of
    the targets.

    Raises:
        CdcsrError: it reaches fewer at the smallest.
    """
    from dataclasses import replace

    from cdcsr.errors import CdcsrError
    from cdcsr.robot.description import parse_robot
    from cdcsr.robot.ruler import ruler

    radius = 0.0
    for share in _SHARES:
        tried = replace(asked, spatter=share)
        robot = parse_robot(tried.text(), asked.name)
        radius, reached = ruler(robot).spatter, _reached_in_spatter(robot)
        print(
            f"targets of Spatter, with a radius of {radius:g} m: {reached} of {_SPATTER_TARGETS} "
            "reached",
            flush=True,
        )
        if reached >= _SPATTER_LEAST:
            return tried
    raise CdcsrError(
        f"The demonstrator does not reach the targets of Spatter with a radius of {radius:g} m, so "
        f"{path} is not written; choose more segments or cables, or a heavier base."
    )


def _reached_corners(robot: Robot) -> int:
    """Return how many of nine targets the demonstrator reaches: corners and middle of Anchor."""
    import itertools

    import numpy as np

    half = np.array(robot.workspace.size) / 2
    corners = np.array([*itertools.product((-1, 1), repeat=3), (0, 0, 0)])
    return _reached(robot, np.array(robot.workspace.center) + half * corners)


def _reached_in_spatter(robot: Robot) -> int:
    """Return how many targets of Spatter the demonstrator reaches."""
    import numpy as np

    from cdcsr.tasks.spaces import make_space

    rng = np.random.default_rng(_SPATTER_SEED)
    return _reached(robot, make_space("spatter", robot).sample(rng, _SPATTER_TARGETS))


def _reached(robot: Robot, targets: NDArray[np.float64]) -> int:
    """Return how many of the targets, shape (n, 3) in [m], the demonstrator reaches."""
    from contextlib import closing

    from cdcsr.envs.gym_env import TaskVectorEnv
    from controllers.jacobian import JacobianController
    from controllers.rollout import rollout

    with closing(TaskVectorEnv(len(targets), robot, autoreset_mode="Disabled")) as env:
        observation, _ = env.reset(options={"targets": targets})
        return int(rollout(JacobianController(robot), env, observation).success.sum())
