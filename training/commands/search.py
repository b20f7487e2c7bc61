"""`cdcsr search`: find out how much better than a controller one could do."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypedDict

from cdcsr.folders import WorkingFolder

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdcsr.envs.disturbances import Disturbances
    from cdcsr.envs.gym_env import TaskVectorEnv
    from cdcsr.robot.description import Robot
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


class _Summary(TypedDict):
    """Means over all targets, and what no plan reaches."""

    reached: float
    length: float
    best_reached: float
    best_length: float
    never: list[int]
    most_steps: int


def search(
    policy: str,
    /,
    *,
    out: Path,
    backend: str = "mujoco",
    space: str | None = None,
    start: str | None = None,
    threshold: float | None = None,
    seconds: float | None = None,
    radius: float | None = None,
    episodes: int = 100,
    rounds: int = 30,
    missed: bool = False,
    seed: int | None = None,
    robot: str | None = None,
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
        space: anchor, floating, spatter, workspace, a map (.npz) or debris (.stl, .obj, .ply,
            .glb); by default that of the training.
        start: how episodes begin: still, moving or anywhere (`cdcsr.tasks.starts`); by default as
            in the training.
        threshold: the tip is on the target within this distance, in m; by default as in the
            training, or the robot's own; so too the next two.
        seconds: how long an episode may take, in s.
        radius: of the balls of Floating or Spatter, in m.
        episodes: how many targets, the same as those of as many episodes of `cdcsr evaluate`.
        rounds: how many rounds at each target; about half a second each.
        missed: search only at targets that the controller reaches in less than half of 48 tries.
        seed: seed of the targets; by default the one that nothing is tuned on.
        robot: the robot; by default the policy's own, or else "paper". A policy is refused on
            another robot than its own.
        action_noise: standard deviation of noise on the commands, in [m] of set-point.
        base_noise: standard deviation of noise on the observed base position, in [m].
        packet_loss: probability that an observation is lost.
        force: start anew in a folder that holds another search.
        json: also write the summary to this file.
    """
    from cdcsr.envs.disturbances import Disturbances
    from cdcsr.files import write_json

    disturbances = Disturbances(action_noise, base_noise, packet_loss)
    asked = _prepare(
        policy,
        backend,
        space,
        start,
        (threshold, seconds, radius),
        episodes,
        rounds,
        missed,
        seed,
        robot,
        disturbances,
    )
    summary = asked.run(out, force)
    print(
        f"\n{asked.controller.name} in {asked.space}, {episodes} targets: reaches "
        f"{summary['reached']:.3f} in {summary['length']:.1f} steps (failures in full); the best "
        f"found reaches {summary['best_reached']:.3f} in {summary['best_length']:.1f}. "
        f"Never reached: {', '.join(map(str, summary['never'])) or 'none'}."
    )
    if json is not None:
        write_json(json, {**asked.identity(), **summary})


def _prepare(
    policy: str,
    backend: str,
    space: str | None,
    start: str | None,
    numbers: tuple[float | None, float | None, float | None],
    episodes: int,
    rounds: int,
    missed: bool,
    seed: int | None,
    robot: str | None,
    disturbances: Disturbances,
) -> _Search:
    """Find the controller, and check that it can be searched around."""
    from cdcsr.errors import CdcsrError
    from cdcsr.robot.description import load_robot
    from cdcsr.robot.ruler import ruler
    from cdcsr.simulation.arguments import MOST_COPIES, check_count
    from cdcsr.tasks.feasible import adjusted
    from training.commands.measured import check_spaces, find_controller, robot_of
    from training.config.seeds import TEST_SEED

    check_count("episodes", episodes, MOST_COPIES)
    check_count("rounds", rounds, 1_000_000)
    description = load_robot(robot or "paper")
    controller = find_controller(policy, description)
    description = robot_of(controller, description, robot is not None)
    if controller.task not in ("reach", "precise", "quiet"):
        raise CdcsrError(
            f"{controller.name} is for the task {controller.task}; a search is for controllers of "
            "reach, precise or quiet."
        )
    own = ruler(description).frame_skip
    if controller.frame_skip not in (None, own):
        raise CdcsrError(
            f"{controller.name} holds actions for {controller.frame_skip} steps; a search is for "
            f"controllers that hold them for the robot's own number, {own}."
        )
    space, start = space or controller.space or "anchor", start or controller.start
    description = adjusted(description, controller.task, [space], *numbers)
    check_spaces(controller, description, controller.task, [space], start)
    return _Search(
        controller,
        description,
        backend,
        space,
        start,
        TEST_SEED if seed is None else seed,
        episodes,
        rounds,
        missed,
        disturbances,
    )


@dataclass(frozen=True)
class _Search:
    """The options of a search."""

    controller: Controller
    robot: Robot
    backend: str
    space: str
    start: str
    seed: int
    episodes: int
    rounds: int
    missed: bool
    disturbances: Disturbances

    def identity(self) -> dict[str, object]:
        """Return what must be the same for a search to be resumed."""
        from cdcsr.tasks.spaces import own_file

        one = self.disturbances
        noise = {name: getattr(one, name) for name in ("action_noise", "base_noise", "packet_loss")}
        identity: dict[str, object] = {
            "controller": self.controller.name,
            "weights": getattr(self.controller, "digest", None),
            "robot": self.robot.fingerprint,
            "backend": self.backend,
            "space": self.space,
            "task": self.controller.task,
            "seed": self.seed,
            "episodes": self.episodes,
            "rounds": self.rounds,
            "missed": self.missed,
            **noise,
        }
        if self.start != "still":  # older searches have no such entry
            identity["start"] = self.start
        if scale := self.robot.scale.model_dump(mode="json"):
            identity["scale"] = scale  # the same
        identity |= own_file(self.space, self.robot)
        if any(noise.values()):
            # Older searches reported the tries that chose the plan; they cannot be resumed.
            identity["told"] = "by tries drawn anew"
        return identity

    def run(self, out: Path, force: bool) -> _Summary:
        """Search at all targets, in a folder that is new or holds this search.

        Raises:
            CdcsrError: the folder holds something else, or its table is damaged.
        """
        drawn = self._env(self.episodes)
        drawn.reset(seed=self.seed)
        targets = drawn.targets.copy()
        drawn.close()
        env = self._env(_COPIES, self.disturbances)
        with closing(env), SEARCH_FOLDER.claim(out, self.identity(), force=force):
            return _summarize(self._search(env, targets, out / "targets.csv"), env.max_actions)

    def _env(self, num: int, disturbances: Disturbances | None = None) -> TaskVectorEnv:
        from cdcsr.envs.gym_env import TaskVectorEnv

        return TaskVectorEnv(
            num,
            self.robot,
            self.backend,
            self.space,
            task=self.controller.task,
            centers=self.controller.centers,
            disturbances=disturbances,
            start=self.start,
            autoreset_mode="Disabled",
        )

    def _search(self, env: TaskVectorEnv, targets: NDArray[np.float64], table: Path) -> list[_Row]:
        """Search at each target that the table lacks, and write the table after each of them."""
        from cdcsr.files import write_text
        from cdcsr.tables import csv_text
        from controllers.search import improve

        rows = _read_rows(table, targets.round(4))
        for episode in range(len(rows), self.episodes):
            alone, best = improve(
                self.controller,
                env,
                targets[episode],
                self.rounds,
                self.seed + episode,
                lambda outcome: not self.missed or outcome.reached < 0.5,
            )
            numbers = [*targets[episode].round(4).tolist(), *_plain(alone), *_plain(best)]
            rows.append(_Row._make([episode, *numbers]))
            write_text(table, csv_text(_Row._fields, rows))
            told, found = (_text(each, env.task.threshold) for each in (alone, best))
            print(f"{episode + 1} of {self.episodes}: {told}; best {found}", flush=True)
        return rows


def _plain(outcome: Outcome) -> tuple[float, float, float]:
    return round(outcome.reached, 3), round(outcome.length, 2), round(outcome.nearest, 5)


def _text(outcome: Outcome, threshold: float) -> str:
    from cdcsr.robot.ruler import millimetres

    nearest = millimetres(outcome.nearest, threshold)
    return f"reached {outcome.reached:.2f}, {outcome.length:.0f} steps, nearest {nearest} mm"


def _summarize(rows: list[_Row], most: int) -> _Summary:
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
    from cdcsr.errors import CdcsrError
    from cdcsr.tables import read_csv_rows

    if not table.exists():
        return []
    try:
        head, lines = read_csv_rows(table)
        if tuple(head) != _Row._fields:
            raise ValueError(f"its columns are {', '.join(head)}")
        rows = [_Row(int(line[0]), *map(float, line[1:])) for line in lines]
    except ValueError as error:
        raise CdcsrError(
            f"{table} is damaged ({error}); delete it, and the search makes it again."
        ) from None
    for episode, row in enumerate(rows):
        here = (row.x, row.y, row.z)
        if episode == len(targets) or (row.episode, *here) != (episode, *targets[episode].tolist()):
            raise CdcsrError(
                f"{table} is of other targets: line {episode + 2} is of target {row.episode} at "
                f"{here}; give another folder, or --force to start anew."
            )
    return rows
