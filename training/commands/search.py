"""`cdcsr search`: find out how much better than a controller one could do."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cdcsr.files import WorkingFolder

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdcsr.envs.gym_env import TaskVectorEnv
    from controllers.controller import Controller
    from controllers.search import Outcome

_COPIES = 48
"""The number of plans that are tried side by side."""
SEARCH_FOLDER = WorkingFolder(
    "a search", "search.json", frozenset({"controller", "rounds"}), results=("targets.csv",)
)


class _Row(NamedTuple):
    """One line of `targets.csv`: a target, and the outcomes of the controller and of the best."""

    episode: int
    x: float
    y: float
    z: float
    reached: float
    length: float
    nearest: float
    best_reached: float
    best_length: float
    best_nearest: float


def search(
    policy: str,
    /,
    *,
    out: Path,
    backend: str = "mujoco",
    space: str | None = None,
    episodes: int = 100,
    rounds: int = 30,
    missed: bool = False,
    seed: int | None = None,
    robot: str = "paper",
    action_noise: float = 0.0,
    base_noise: float = 0.0,
    packet_loss: float = 0.0,
    force: bool = False,
    json: Path | None = None,
) -> None:
    """Search, target by target, for commands that do better than a controller.

    The search tries offsets to the controller's own commands by the cross-entropy method, 48 plans
    a round. It resumes where it was stopped. What it finds is a lower bound: a target may be
    reachable, or reachable sooner, without being found to be. Under disturbances it is an estimate.

    Args:
        policy: folder of a policy or a run, name of a shipped policy, "jacobian" (the scripted
            demonstrator), "nearest" (replays the nearest demonstration), package.module:Object (a
            controller of your own), or a .zip of stable-baselines3.
        out: folder of the results: `targets.csv`, a line for each target, and `search.json`, the
            options.
        backend: the engine.
        space: anchor, floating, spatter or workspace; by default that of the training.
        episodes: how many targets, the same as those of as many episodes of `cdcsr evaluate`.
        rounds: how many rounds at each target; about half a second each.
        missed: search only at targets that the controller reaches in less than half of 48 tries.
        seed: seed of the targets; by default the one that nothing is tuned on.
        robot: the robot, unless the policy brings its own.
        action_noise: standard deviation of noise on the commands, in [m] of set-point.
        base_noise: standard deviation of noise on the observed base position, in [m].
        packet_loss: probability that an observation is lost.
        force: start anew in a folder that holds another search.
        json: also write the summary to this file.
    """
    from cdcsr.envs.disturbances import Disturbances
    from cdcsr.envs.gym_env import TaskVectorEnv
    from cdcsr.errors import CdcsrError
    from cdcsr.files import write_json
    from cdcsr.robot.description import load_robot
    from training.commands.measured import find_controller, robot_of, set_threads
    from training.config.seeds import TEST_SEED

    set_threads()
    for name, value in {"episodes": episodes, "rounds": rounds}.items():
        if value < 1:
            raise CdcsrError(f"{name} must be at least 1, not {value}.")
    description = load_robot(robot)
    controller = find_controller(policy, description)
    _check_searchable(controller)
    env_options = {
        "robot": robot_of(controller, description),
        "backend": backend,
        "space": space or controller.space or "anchor",
        "task": controller.task,
        "autoreset_mode": "Disabled",
        "centers": controller.centers,
    }
    seed = TEST_SEED if seed is None else seed
    drawn = TaskVectorEnv(episodes, **env_options)
    drawn.reset(seed=seed)
    targets = drawn.targets.copy()
    drawn.close()
    identity = {
        "controller": controller.name,
        "weights": getattr(controller, "digest", None),
        "robot": drawn.robot.fingerprint,
        "backend": backend,
        "space": env_options["space"],
        "task": controller.task,
        "seed": seed,
        "episodes": episodes,
        "rounds": rounds,
        "missed": missed,
        "action_noise": action_noise,
        "base_noise": base_noise,
        "packet_loss": packet_loss,
    }
    if action_noise or base_noise or packet_loss:
        # Older searches reported the tries that chose the plan; they cannot be resumed.
        identity["told"] = "by tries drawn anew"
    disturbances = Disturbances(action_noise, base_noise, packet_loss)
    environment = TaskVectorEnv(_COPIES, disturbances=disturbances, **env_options)
    with closing(environment) as env, SEARCH_FOLDER.claim(out, identity, force=force):
        rows = _search_all(controller, env, targets, rounds, seed, missed, out / "targets.csv")
    summary = identity | _summary(rows, env.max_actions)
    print(
        f"\n{controller.name} in {summary['space']}, {episodes} targets: reaches "
        f"{summary['reached']:.3f} in {summary['length']:.1f} steps (failures in full); the best "
        f"found reaches {summary['best_reached']:.3f} in {summary['best_length']:.1f}. "
        f"Never reached: {', '.join(map(str, summary['never'])) or 'none'}."
    )
    if json is not None:
        write_json(json, summary)


def _check_searchable(controller: Controller) -> None:
    """Refuse a controller of a task that does not end with success, or of longer actions."""
    from cdcsr.errors import CdcsrError

    if controller.task not in ("reach", "precise", "quiet"):
        raise CdcsrError(
            f"{controller.name} is for the task {controller.task}; a search is for controllers of "
            "reach, precise or quiet."
        )
    if controller.frame_skip != 1:
        raise CdcsrError(
            f"{controller.name} holds actions for {controller.frame_skip} steps; a search is for "
            "controllers with one action a step."
        )


def _search_all(
    controller: Controller,
    env: TaskVectorEnv,
    targets: NDArray[np.float64],
    rounds: int,
    seed: int,
    missed: bool,
    table: Path,
) -> list[_Row]:
    """Search at each target that the table lacks, and write the table after each of them."""
    from cdcsr.files import write_text
    from controllers.search import improve

    rows = _read_rows(table, targets.round(4))
    for episode in range(len(rows), len(targets)):
        target = targets[episode]
        alone, best = improve(
            controller,
            env,
            target,
            rounds,
            seed + episode,
            lambda outcome: not missed or outcome.reached < 0.5,
        )
        numbers = [*target.round(4).tolist(), *_plain(alone), *_plain(best)]
        rows.append(_Row._make([episode, *numbers]))
        lines = [",".join(map(str, row)) + "\n" for row in [_Row._fields, *rows]]
        write_text(table, "".join(lines))
        print(
            f"{episode + 1} of {len(targets)}: {_text(alone)}; best {_text(best)}",
            flush=True,
        )
    return rows


def _plain(outcome: Outcome) -> tuple[float, float, float]:
    return round(outcome.reached, 3), round(outcome.length, 2), round(outcome.nearest, 5)


def _text(outcome: Outcome) -> str:
    nearest = 1e3 * outcome.nearest
    return f"reached {outcome.reached:.2f}, {outcome.length:.0f} steps, nearest {nearest:.0f} mm"


def _summary(rows: list[_Row], most: int) -> dict[str, Any]:
    """Return means over targets, and the targets that no plan reaches."""
    return {
        "reached": sum(row.reached for row in rows) / len(rows),
        "length": sum(row.length for row in rows) / len(rows),
        "best_reached": sum(row.best_reached for row in rows) / len(rows),
        "best_length": sum(row.best_length for row in rows) / len(rows),
        "never": [row.episode for row in rows if row.best_reached == 0],
        "most_steps": most,
    }


def _read_rows(table: Path, targets: NDArray[np.float64]) -> list[_Row]:
    """Return the rows that a search has found already; none if there is no table.

    Args:
        table: `targets.csv`.
        targets: the targets of this search, shape (episodes, 3), rounded as in the table.

    Raises:
        CdcsrError: the table is damaged, or has other targets.
    """
    import csv

    from cdcsr.errors import CdcsrError

    if not table.is_file():
        return []
    try:
        with table.open(newline="", encoding="utf-8") as file:
            lines = [[*map(float, line.values())] for line in csv.DictReader(file)]
        rows = [_Row(int(line[0]), *line[1:]) for line in lines]
    except (OSError, ValueError, TypeError) as error:
        raise CdcsrError(
            f"{table} is damaged ({error}); delete it, and the search makes it again."
        ) from None
    for episode, row in enumerate(rows):
        here = (row.x, row.y, row.z)
        if episode == len(targets) or (row.episode, *here) != (
            episode,
            *targets[episode].tolist(),
        ):
            raise CdcsrError(
                f"{table} is of other targets: line {episode + 2} is of target {row.episode} at "
                f"{here}; give another folder, or --force to start anew."
            )
    return rows
