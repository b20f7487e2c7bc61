"""`cdcsr film`: show a controller or a dataset in a video, or in a page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numpy import float64
    from numpy.typing import NDArray

    from cdcsr.robot.description import Robot
    from cdcsr.tasks.debris import Surface
    from controllers.controller import Controller

_ENDINGS = ".mp4", ".gif", ".html"
_SPEED = 0.12
"""Simulated seconds in a second of the film, of the paper's robot."""
_MOST_EPISODES, _MOST_WIDTH, _MOST_RATE, _MOST_SECONDS = 100, 2_000, 100, 1_000.0


def film(
    what: str,
    /,
    *,
    out: Path,
    backend: tuple[str, ...] = ("mujoco", "pybullet"),
    robot: str | None = None,
    space: str = "spatter",
    targets: int = 3,
    seed: int | None = None,
    seconds: float | None = None,
    speed: float | None = None,
    fps: int = 12,
    camera: str = "side",
    width: int = 400,
    force: bool = False,
) -> None:
    """Film a controller or a dataset in several engines side by side: MP4, GIF or a page.

    A controller acts in each engine by itself; the commands of a dataset are repeated in each. A
    page (.html) shows the robots from all sides in any browser, with nothing else; it needs the
    extra: pip install 'cdcsr[view]'. No display and no graphics card are needed.

    Args:
        what: a controller, named as for `cdcsr evaluate`, or the folder of a dataset made by
            `cdcsr demonstrate`.
        out: the file; its ending gives the format: .mp4, .gif or .html.
        backend: one engine, or several side by side.
        robot: a shipped robot's name, or a path ending in .toml; by default the robot of the policy
            or of the dataset, else paper.
        space: where targets lie: anchor, floating, spatter, workspace, a map (.npz) or debris
            (.stl, .obj, .ply, .glb), which is then shown too. A dataset has its own.
        targets: how many episodes, one after another.
        seed: seed of the targets; by default the one that nothing is tuned on.
        seconds: how much of each episode is shown, in simulated s; by default all of it.
        speed: how many simulated seconds pass in a second; by default 0.12 for the paper's robot,
            and so many that episodes of another take as long.
        fps: frames in a second.
        camera: side, front or top; a page can be turned.
        width: the width of each engine's picture in pixels; its height is 1.8 times that.
        force: replace a file that is there already.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.files import refuse_taken
    from cdcsr.robot.ruler import ruler
    from cdcsr.simulation.arguments import check_count, check_number
    from cdcsr.simulation.cameras import camera_angles
    from cdcsr.simulation.engines import engine_factory
    from training.plots.video import Style, policy_video

    if out.suffix not in _ENDINGS:
        raise CdcsrError(f"A film ends in {', '.join(_ENDINGS)}, not as {str(out)[:80]!r} does.")
    refuse_taken(out, force)
    check_count("targets", targets, _MOST_EPISODES)
    check_count("fps", fps, _MOST_RATE)
    check_count("width", width, _MOST_WIDTH, least=32)
    if speed is not None:
        check_number("speed", speed, 1e-3, 100.0)
    if seconds is not None:
        check_number("seconds", seconds, 0.0, _MOST_SECONDS)
    camera_angles(camera)
    for name in backend:
        engine_factory(name)
    if out.suffix == ".html":
        _check_page()
    shown, found, places, debris = _find(what, robot, space, targets, seed)
    limit = float("inf") if seconds is None else seconds
    speed = _SPEED * ruler(found).pace if speed is None else speed
    style = Style(speed / fps, fps, width, camera, limit, debris)
    policy_video(shown, found, backend, places, out, shown.frame_skip, style)
    size = out.stat().st_size / 1e6
    print(f"{shown.name}, {found.name} in {', '.join(backend)} -> {out}, {size:.2f} MB")


def _check_page() -> None:
    """Check that what makes a page is installed.

    Raises:
        CdcsrError: it is not.
    """
    from cdcsr.errors import CdcsrError

    try:
        import backends.viewers.page  # noqa: F401
    except ImportError:
        raise CdcsrError("A page needs viser; run: pip install 'cdcsr[view]'") from None


def _find(
    what: str, robot: str | None, space: str, targets: int, seed: int | None
) -> tuple[Controller, Robot, NDArray[float64], Surface | None]:
    """Return what acts, on which robot, the targets, shape (N, 3), in [m], and on which debris they
    lie, if they do.

    Raises:
        CdcsrError: there is no such controller or dataset, or it is of another robot.
    """
    import numpy as np

    from cdcsr.robot.description import load_robot
    from cdcsr.robot.ruler import ruler
    from cdcsr.simulation.arguments import MOST_SEED, check_count
    from cdcsr.tasks.debris import Surface
    from cdcsr.tasks.spaces import make_space
    from controllers.dataset_files import stored_robot
    from controllers.demonstrations import load
    from controllers.nearest import Nearest
    from training.commands.measured import find_controller, robot_of
    from training.config.seeds import TEST_SEED

    seed = TEST_SEED if seed is None else seed
    check_count("seed", seed, MOST_SEED, least=0)
    asked = load_robot(robot or "paper")
    if (Path(what) / "data").is_dir():
        own = stored_robot(Path(what))
        described = asked if robot is not None or own is None else own
        episodes = load(Path(what), described.fingerprint, ruler(described).frame_skip)[:targets]
        controller = Nearest(described, episodes)  # each is nearest to its own target
        controller.name = Path(what).resolve().name
        return controller, described, np.array([episode.target for episode in episodes]), None
    controller = find_controller(what, asked)
    described = robot_of(controller, asked, robot is not None)
    place = make_space(space, described, controller.centers)
    drawn = place.sample(np.random.default_rng(seed), targets)
    return controller, described, drawn, place if isinstance(place, Surface) else None
