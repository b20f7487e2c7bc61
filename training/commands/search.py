"""`cdcsr search`: how much better than a controller could one do."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cdcsr.files import WorkingFolder

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from controllers.search import Outcome

_COPIES = 48
"""Plans tried side by side."""
SEARCH_FOLDER = WorkingFolder(
    "a search", "search.json", frozenset({"controller", "rounds"}), results=("targets.csv",)
)


class _Row(NamedTuple):
    """One target, as a line of `targets.csv`."""

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
    """Search, target by target, for commands that do better than a controller: what could be done at all.

    Offsets to the controller's own commands are searched for by the cross-entropy method, 48 plans a round. Goes on
    where it was stopped. What it finds is a lower bound: a target may be reachable, or sooner, and not found to be;
    under disturbances, an estimate of one.

    Args:
        policy: folder of a policy or a run, name of a shipped policy, or "jacobian" for the demonstrator.
        out: folder of the results: `targets.csv`, a line for each target, and `search.json`, what was asked for.
        backend: the engine.
        space: anchor, floating, spatter or workspace; by default the one the policy was trained in.
        episodes: how many targets, the same as those of as many episodes of `cdcsr evaluate`.
        rounds: of the search at each target; about half a second each.
        missed: search only at targets that the controller reaches in less than half of 48 tries.
        seed: of the targets; by default the one that nothing is tuned on.
        robot: the robot of the scripted demonstrator; a policy brings its own.
        action_noise: standard deviation of noise on the commands, in [m] of set-point.
        base_noise: standard deviation of noise on the observed base position, in [m].
        packet_loss: probability that an observation is lost.
        force: start anew in a folder that holds another search.
        json: also write the summary to this file.
    """
    import torch

    from cdcsr.envs.disturbances import Disturbances
    from cdcsr.envs.gym_env import TaskVectorEnv
    from cdcsr.errors import CdcsrError
    from cdcsr.files import write_json, write_text
    from controllers.search import improve
    from training.commands.measured import find_controller, trained_space
    from training.config.seeds import TEST_SEED
    from training.policy import Policy

    torch.set_num_threads(1)
    for name, value in {"episodes": episodes, "rounds": rounds}.items():
        if value < 1:
            raise CdcsrError(f"{name} must be at least 1, not {value}.")
    controller, description = find_controller(policy, robot)
    learned = controller if isinstance(controller, Policy) else None
    seed, space = TEST_SEED if seed is None else seed, space or trained_space(controller)
    disturbances = Disturbances(action_noise, base_noise, packet_loss)
    task = "reach" if learned is None else learned.task
    if task not in ("reach", "precise", "quiet"):
        raise CdcsrError(
            f"{controller.name} is for {task}; a search is for reaching: reach, precise, quiet."
        )
    if learned is not None and learned.frame_skip != 1:
        raise CdcsrError(
            f"{controller.name} holds actions for {learned.frame_skip} steps; a search is for one a step."
        )
    common: dict[str, Any] = {
        "robot": description,
        "backend": backend,
        "space": space,
        "task": task,
        "autoreset_mode": "Disabled",
        "centers": None if learned is None else learned.centers,
    }
    drawn = TaskVectorEnv(episodes, **common)
    drawn.reset(seed=seed)
    targets = drawn.targets.copy()
    drawn.close()
    identity = {
        "controller": controller.name,
        "weights": None if learned is None else learned.digest,
        "robot": description.fingerprint,
        "backend": backend,
        "space": space,
        "task": task,
        "seed": seed,
        "episodes": episodes,
        "rounds": rounds,
        "missed": missed,
        "action_noise": action_noise,
        "base_noise": base_noise,
        "packet_loss": packet_loss,
    }
    if action_noise or base_noise or packet_loss:
        identity["told"] = (
            "by tries drawn anew"  # once it was by those that chose, so such a search cannot go on
        )
    environment = TaskVectorEnv(_COPIES, disturbances=disturbances, **common)
    with closing(environment) as env, SEARCH_FOLDER.claim(out, identity, force=force):
        rows = _read_rows(out / "targets.csv", targets.round(4))
        for episode in range(len(rows), episodes):
            alone, best = improve(
                controller,
                env,
                targets[episode],
                rounds,
                seed + episode,
                lambda outcome: not missed or outcome.reached < 0.5,
            )
            rows.append(
                _Row._make(
                    [episode, *targets[episode].round(4).tolist(), *_plain(alone), *_plain(best)]
                )
            )
            write_text(
                out / "targets.csv",
                "".join(",".join(map(str, row)) + "\n" for row in [_Row._fields, *rows]),
            )
            print(f"{episode + 1} of {episodes}: {_told(alone)}; best {_told(best)}", flush=True)
    summary = identity | _summary(rows, env.max_actions)
    print(
        f"\n{summary['controller']} in {space}, {episodes} targets: reaches {summary['reached']:.3f} in "
        f"{summary['length']:.1f} steps (failures in full); with what was found {summary['best_reached']:.3f} in "
        f"{summary['best_length']:.1f}. Never reached: {', '.join(map(str, summary['never'])) or 'none'}."
    )
    if json is not None:
        write_json(json, summary)


def _plain(outcome: Outcome) -> tuple[float, float, float]:
    return round(outcome.reached, 3), round(outcome.length, 2), round(outcome.nearest, 5)


def _told(outcome: Outcome) -> str:
    return f"reached {outcome.reached:.2f}, {outcome.length:.0f} steps, nearest {1e3 * outcome.nearest:.0f} mm"


def _summary(rows: list[_Row], most: int) -> dict[str, Any]:
    """Means over targets, and the targets nothing reaches."""
    return {
        "reached": sum(row.reached for row in rows) / len(rows),
        "length": sum(row.length for row in rows) / len(rows),
        "best_reached": sum(row.best_reached for row in rows) / len(rows),
        "best_length": sum(row.best_length for row in rows) / len(rows),
        "never": [row.episode for row in rows if row.best_reached == 0],
        "most_steps": most,
    }


def _read_rows(table: Path, targets: NDArray[np.float64]) -> list[_Row]:
    """Return the rows that a search has found already, none if there is no table.

    Args:
        table: `targets.csv`.
        targets: those of this search, shape (episodes, 3), rounded as in the table.

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
            f"{table} is damaged ({error}); delete it to have it made again."
        ) from None
    for episode, row in enumerate(rows):
        here = (row.x, row.y, row.z)
        if episode == len(targets) or (row.episode, *here) != (
            episode,
            *targets[episode].tolist(),
        ):
            raise CdcsrError(
                f"{table} is of other targets: line {episode + 2} is of target {row.episode} at "
                f"{here}; give another folder, or --force to begin anew."
            )
    return rows
