"""`cdcsr view`: see a robot move, and steer it, in a web page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from backends.viewers.driving import Shown
    from cdcsr.robot.description import Robot
    from controllers.controller import Controller


def view(
    robot: str | None = None,
    /,
    *,
    backend: tuple[str, ...] = ("mujoco",),
    drive: tuple[str, ...] = ("jacobian",),
    show: Path | None = None,
    space: str = "anchor",
    frame_skip: int | None = None,
    seed: int = 0,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> None:
    """See a robot move, and steer it, in a web page.

    Needs the extra: pip install 'cdcsr[view]'.

    Args:
        robot: a shipped robot's name, or a path ending in .toml; by default the robot of a policy
            or of a dataset, else paper.
        backend: one engine, or several that get the same commands side by side.
        drive: controllers to choose from in the page, named as for `cdcsr evaluate`; the first one
            begins.
        show: episodes to show again: a dataset made by `cdcsr demonstrate`, or the JSON file of
            `cdcsr evaluate`.
        space: the operation space of the targets: anchor, floating, spatter, workspace, a map
            (.npz) or debris (.stl, .obj, .ply, .glb).
        frame_skip: how many simulation steps each command of the dataset was held for; by default
            the robot's own number.
        seed: seed of the first target.
        host: the address to listen at; 0.0.0.0 lets other machines in, who then can steer too.
        port: the port to listen at; if it is taken, the next free one.
    """
    from backends.viewers.session import Session
    from cdcsr.errors import CdcsrError
    from cdcsr.robot.description import load_robot
    from cdcsr.tasks.spaces import make_space
    from controllers.dataset_files import stored_robot
    from controllers.feeds import StepByStep
    from training.commands.measured import find_controller

    try:
        from backends.viewers.web import WebView
    except ImportError:
        raise CdcsrError("The view needs viser; run: pip install 'cdcsr[view]'") from None
    stored = stored_robot(show) if show is not None and show.is_dir() and robot is None else None
    described = stored or load_robot(robot or "paper")
    asked = robot is not None or stored is not None
    controllers = [find_controller(name, described) for name in drive]
    shown = _common_robot(controllers, described, asked)
    episodes = _episodes(show, shown, frame_skip, backend[0]) if show else []
    session = Session(
        shown,
        backend,
        make_space(space, shown),
        [StepByStep(controller, shown) for controller in controllers],
        episodes,
        seed,
    )
    if controllers and not episodes:
        session.drive(controllers[0].name)
    session.playing = True
    page = WebView(session, host, port)
    print(f"{shown.name} in {', '.join(backend)}: open {page.url} (Ctrl-C ends)", flush=True)
    try:
        page.run()
    finally:
        page.close()


def _common_robot(controllers: list[Controller], described: Robot, asked: bool) -> Robot:
    """Return the one robot that all controllers are for."""
    from cdcsr.errors import CdcsrError
    from training.commands.measured import robot_of

    found = {c.name: robot_of(c, described, asked) for c in controllers}
    robots = {robot.fingerprint: robot for robot in found.values()}
    if len(robots) > 1:
        names = ", ".join(f"{name} ({robot.name})" for name, robot in found.items())
        raise CdcsrError(f"All controllers must be for one robot; found {names}.")
    return next(iter(robots.values()), described)


def _episodes(path: Path, robot: Robot, frame_skip: int | None, backend: str) -> list[Shown]:
    """Read the episodes of a dataset, or those of an evaluation: in the first engine if it has
    them."""
    import numpy as np

    from backends.viewers.driving import Shown
    from cdcsr.errors import CdcsrError
    from cdcsr.files import read_json
    from cdcsr.robot.ruler import ruler
    from controllers.demonstrations import load

    if path.is_dir():
        hold = frame_skip or ruler(robot).frame_skip
        recorded = load(path, robot.fingerprint, hold)
        return [Shown(e.target, True, e.actions, hold) for e in recorded]
    try:
        cells = read_json(path)["cells"]
        cell = next((cell for cell in cells if cell["backend"] == backend), cells[0])
        targets = np.array(cell["targets"], dtype=float).reshape(-1, 3)
        success = [bool(reached) for reached in cell["success"]]
        return [Shown(*episode) for episode in zip(targets, success, strict=True)]
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise CdcsrError(
            f"{path} holds no episodes ({type(error).__name__}: {error}); make it with "
            "`cdcsr evaluate POLICY --json FILE`."
        ) from None
