"""`cdcsr plot`: draw what other commands wrote."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cdcsr.files import JsonObject
    from training.measure.evaluation import Result

_KINDS = {
    "workspace": "a map made by `cdcsr workspace`, or the JSON file of `cdcsr evaluate`",
    "parity": "the JSON file of `cdcsr parity`",
    "targets": "the JSON file of `cdcsr evaluate` or `cdcsr transfer`",
    "matrix": "the JSON file of `cdcsr transfer` or `cdcsr evaluate`",
    "sweep": "the JSON file of `cdcsr sweep`",
    "learning": "the folder of a training run",
    "episode": "a dataset made by `cdcsr demonstrate`",
}
"""The kinds of plots, and what each is drawn from."""


def plot(
    kind: str,
    file: Path,
    /,
    *,
    out: Path,
    robot: str = "paper",
    backend: tuple[str, ...] = ("mujoco", "pybullet"),
    episode: int = 1,
    force: bool = False,
) -> None:
    """Draw what other commands wrote: success, sweeps, learning, episodes, parity; PNG or PDF.

    `targets` shows in 3D which targets were reached, `workspace` the same inside the map of the
    workspace, `matrix` the success of each controller in each engine, `sweep` success against
    numbers of the plant, `learning` success during training, `episode` the distance, travel,
    tension and motion of the base over time, and `parity` how far engines are apart. Success is
    drawn with its 95 % interval.

    Args:
        kind: targets, workspace, matrix, sweep, learning, episode or parity.
        file: the JSON file of `cdcsr evaluate`, `transfer`, `sweep` or `parity`; for workspace also
            a map; for learning the folder of a run; for episode a dataset.
        out: the picture, .png or .pdf.
        robot: of targets and workspace: the robot to draw with them.
        backend: of episode: the engines in which its commands are repeated.
        episode: of episode: which one of the dataset, counted from 1.
        force: replace a file that is there already.
    """
    from cdcsr.errors import CdcsrError, unknown_choice
    from cdcsr.files import refuse_taken

    if kind not in _KINDS:
        raise CdcsrError(unknown_choice("kind of plot", kind, _KINDS))
    if out.suffix not in (".png", ".pdf"):
        raise CdcsrError(f"A plot ends in .png or .pdf, not as {str(out)[:80]!r} does.")
    refuse_taken(out, force)
    try:
        _draw(kind, file, out, robot, backend, episode)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        kinds = "; ".join(f"{name}: {source}" for name, source in _KINDS.items())
        raise CdcsrError(
            f"{file} cannot be drawn as {kind} ({type(error).__name__}: {error}). What is drawn "
            f"from what: {kinds}."
        ) from None
    print(f"drawn to {out}")


def _draw(
    kind: str, file: Path, out: Path, robot: str, backend: tuple[str, ...], episode: int
) -> None:
    """Draw one file.

    Raises:
        KeyError, TypeError, ValueError, IndexError: it is of another kind.
    """
    from cdcsr.robot.description import load_robot
    from cdcsr.tasks.workspace_map import load_workspace
    from training.plots.learning_curve import draw_learning_curve
    from training.plots.measured import draw_matrix, draw_parity, draw_sweep
    from training.plots.targets import draw_targets, draw_workspace

    if kind == "learning":
        if not (file / "metrics.csv").is_file():
            raise ValueError("it holds no metrics.csv")
        draw_learning_curve([file], out)
    elif kind == "episode":
        _draw_episode(file, out, backend, episode)
    elif kind == "sweep":
        draw_sweep(_rows(file, "points"), out)
    elif kind == "matrix":
        draw_matrix(_rows(file, "cells"), out)
    elif kind == "parity":
        draw_parity(_read(file), out)
    elif kind == "workspace" and file.suffix == ".npz":
        described = load_robot(robot)
        draw_workspace({}, load_workspace(described, file), described, out)
    elif kind == "workspace":
        described, results = load_robot(robot), _results(file)
        own = next((cell["space"] for cell in _rows(file, "cells")), "")
        path = Path(own) if str(own).endswith(".npz") else None
        draw_workspace(results, load_workspace(described, path), described, out)
    else:
        draw_targets(_results(file), load_robot(robot), out)


def _results(file: Path) -> dict[str, Result]:
    """Return the cells in a JSON file as results by their titles.

    Raises:
        KeyError, TypeError, ValueError: there are none, or they lack something.
    """
    import numpy as np

    from training.measure.evaluation import Result

    results = {}
    for cell in _rows(file, "cells"):
        success, length, places = (
            np.array(cell[name]) for name in ("success", "length", "targets")
        )
        unknown = np.full(len(success), np.nan)
        title = f"{cell['controller']} in {cell['backend']}, {cell['space']}"
        results[title] = Result(success.astype(bool), length, unknown, places)
    return results


def _read(file: Path) -> JsonObject:
    """Return the object in a JSON file.

    Raises:
        ValueError: it is a folder.
    """
    from cdcsr.files import read_json

    if file.is_dir():
        raise ValueError("it is a folder")
    return read_json(file)


def _rows(file: Path, key: str) -> list[JsonObject]:
    """Return the rows in a JSON file under a key.

    Raises:
        ValueError: there are none.
    """
    rows = _read(file).get(key)
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise ValueError(f"it has no {key}")
    return rows


def _draw_episode(file: Path, out: Path, backend: tuple[str, ...], episode: int) -> None:
    """Repeat one episode of a dataset in each engine, and draw it."""
    from cdcsr.errors import CdcsrError
    from cdcsr.robot.description import load_robot
    from cdcsr.robot.ruler import ruler
    from controllers.dataset_files import stored_robot
    from controllers.demonstrations import load
    from controllers.nearest import Nearest
    from training.plots.measured import draw_episode
    from training.plots.video import record

    if not (file / "data").is_dir():
        raise ValueError("it is no dataset")
    robot = stored_robot(file) or load_robot("paper")
    hold = ruler(robot).frame_skip
    found = load(file, robot.fingerprint, hold)
    if not 1 <= episode <= len(found):
        raise CdcsrError(f"There is no episode {episode} in {file}; there are {len(found)}.")
    chosen = found[episode - 1]
    controller, targets = Nearest(robot, [chosen]), chosen.target[None]
    recordings = [record(controller, robot, name, targets, hold) for name in backend]
    draw_episode(recordings, robot, robot.time_step * hold, out)
