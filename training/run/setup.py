"""The parts of a training run before it learns: checks, environments, demonstrations."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.memory import check_memory
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.engines import load_backend
from cdcsr.tasks.catalogue import actions_per_episode, make_task
from cdcsr.tasks.feasible import adjusted, check_targets
from cdcsr.tasks.observation import observation_size
from cdcsr.tasks.spaces import demonstration_space, make_space, own_file
from cdcsr.tasks.starts import Starts
from cdcsr.tasks.symmetry import images
from cdcsr.tasks.task import Reward, Task
from controllers import demonstrations
from controllers.jacobian import JacobianController
from controllers.rollout import Episode, rollout
from training.algorithms.registry import find_algorithm
from training.algorithms.td3 import BackboneNumbers
from training.config.learner import CloneRollouts, Demonstrated, Practising
from training.config.seeds import VALIDATION_SEED
from training.experience.collector import FinishedEpisode
from training.measure.evaluation import Result, evaluate
from training.networks.actor import Actor
from training.networks.bfloat16 import has_fast_bfloat16
from training.policy import Policy
from training.run.train_options import Train

Array = NDArray[np.float64]


class Setup:
    """The parts of a training run. Making one checks the options; nothing is simulated.

    Args:
        config: the run.

    Raises:
        CdcsrError: the options do not fit together, or do not fit the robot or the task.
    """

    def __init__(self, config: Train) -> None:
        self.config, self.learner = config, config.learner
        numbers = config.threshold, config.seconds, config.radius
        self.robot: Robot = adjusted(
            load_robot(config.robot), config.task, [config.space], *numbers
        )
        own = ruler(self.robot).frame_skip
        self.frame_skip = own if config.frame_skip is None else config.frame_skip
        load_backend(config.backend)
        space = make_space(config.space, self.robot)
        kind = find_algorithm(config.algorithm).learner
        self.reward: Reward = "sparse" if kind is None else kind.reward
        task = make_task(config.task, self.robot)
        self._threshold = task.threshold
        self._check(task)
        check_targets(self.robot, task, space, bent=config.start == "anywhere")

    def _check(self, task: Task) -> None:
        config, learner = self.config, self.learner
        Starts(config.start, self.robot).check(task)
        actions = actions_per_episode(task.max_steps, self.frame_skip)
        if learner.symmetry and len(images(self.robot)) == 1:
            raise CdcsrError(
                f"symmetry must be off: the cables of {self.robot.name!r} have no mirror image."
            )
        if not isinstance(learner, Practising):
            for name in ("randomize", "soften"):
                if value := getattr(config, name):
                    raise CdcsrError(
                        f"{name} must be 0 for {config.algorithm}, which collects no episodes, not "
                        f"{value:g}."
                    )
            return
        if learner.discount == 1 and not task.ends:
            raise CdcsrError(
                f"discount must be below 1 for {config.task!r}, which pays for every action on "
                "target."
            )
        self._check_memory(learner)
        if learner.capacity < (least := max(learner.batch_size, actions + 1)):
            raise CdcsrError(
                f"capacity must be at least {least}, a batch and an episode, not "
                f"{learner.capacity}."
            )
        if isinstance(learner, BackboneNumbers) and learner.bfloat16 and not has_fast_bfloat16():
            raise CdcsrError("bfloat16 must be off: this processor multiplies no faster in it.")

    def _check_memory(self, learner: Practising) -> None:
        """Check that the replay and the networks fit into memory.

        A network takes its weights five times (with the target's, the gradient and Adam's two
        moments), and the output of each layer three times for every row of a batch.
        """
        inputs, cables = observation_size(self.robot), self.robot.num_cables
        kept = isinstance(learner, Demonstrated) and learner.kept_share > 0
        rows = learner.capacity * (1 + kept)
        check_memory(
            f"A replay with a capacity of {learner.capacity:,} rows",
            rows * (4.0 * (inputs + 2 * cables + 3) + 8),
            "lower --learner.capacity",
        )
        widths = (inputs + 3, *learner.hidden, cables)
        weights = sum(before * after for before, after in pairwise(widths))
        critics = learner.critics if isinstance(learner, BackboneNumbers) else 0
        check_memory(
            f"{1 + critics} networks of hidden layers {learner.hidden} and batches of "
            f"{learner.batch_size:,}",
            4.0 * (1 + critics) * (5 * weights + 3 * learner.batch_size * sum(widths)),
            "lower --learner.hidden, --learner.batch-size or --learner.critics",
        )

    def identity(self) -> dict[str, object]:
        """Return all that must be the same for the run to be resumed."""
        given = self.config.demonstrations is not None
        digest = demonstrations.digest(self.episodes) if given else None
        own = own_file(self.config.space, self.robot)
        return {**self.config.identity(self.robot, digest), **own}

    @cached_property
    def episodes(self) -> list[Episode]:
        """The demonstrations: those of the dataset, or recorded now."""
        config = self.config
        if config.demonstrations is not None:
            return demonstrations.load(
                config.demonstrations,
                self.robot.fingerprint,
                self.frame_skip,
                config.task,
                threshold=self._threshold,
            )
        num, seed = config.num_demonstrations, config.demonstration_seed
        print(f"Recording {num} demonstrations in {config.backend} (seed {seed})", flush=True)
        space = demonstration_space(config.space)
        env = self.environment(num, space, centers=None, autoreset_mode="Disabled")
        try:
            return demonstrations.record(JacobianController(self.robot), env, num, seed)[0]
        finally:
            env.close()

    @cached_property
    def centers(self) -> Array:
        """The targets of the demonstrations, shape (n, 3), in [m]."""
        return np.array([episode.target for episode in self.episodes])

    def pairs(self) -> tuple[Tensor, Tensor]:
        """Return what the demonstrator observed and its set-points in [m]."""
        observations = np.concatenate([episode.observations[:-1] for episode in self.episodes])
        commands = np.concatenate([episode.actions for episode in self.episodes])
        return as_tensor(observations), as_tensor(commands)

    def environment(self, num: int, space: str, **options: Any) -> TaskVectorEnv:
        """Return `num` environments of the run's task in a space."""
        config = self.config
        options = {"centers": self.centers, **options} if "centers" not in options else options
        return TaskVectorEnv(
            num,
            self.robot,
            config.backend,
            space,
            self.reward,
            self.frame_skip,
            task=config.task,
            start=config.start,
            **options,
        )

    def first_episodes(self, actor: Actor, clone: Actor | None) -> list[FinishedEpisode]:
        """Return what the algorithm's replay begins with: demonstrations, and what a clone reached.

        Args:
            actor: maps commands to actions.
            clone: the behaviour clone, if the algorithm has one.
        """
        kind, learner = find_algorithm(self.config.algorithm).learner, self.learner
        episodes = list(self.episodes) if kind is not None and kind.uses_demonstrations else []
        if clone is not None and isinstance(learner, CloneRollouts):
            env = self.environment(
                learner.bc_rollouts, self.config.space, autoreset_mode="Disabled"
            )
            observation, _ = env.reset(seed=self.config.seed)
            episodes += rollout(self.policy(clone, "bc"), env, observation).successes()
            env.close()
        return [
            FinishedEpisode(
                episode.observations,
                actor.from_command(as_tensor(episode.actions)).numpy(),
                episode.rewards,
                True,
                episode.terminated,
            )
            for episode in episodes
        ]

    def policy(self, actor: Actor, algorithm: str, **more: object) -> Policy:
        """Return an actor as a policy with its card.

        Args:
            actor: the network.
            algorithm: the run's, or "bc" for its clone.
            more: further entries of the card.
        """
        config, changes = self.config, self.config.changes_of(algorithm)
        card = {
            "name": config.policy_name(algorithm, changes),
            "algorithm": algorithm,
            "preset": config.preset,
            "backend": config.backend,
            "task": config.task,
            "space": config.space,
            "start": config.start,
            "seed": config.seed,
            "frame_skip": self.frame_skip,
            "randomize": config.randomize,
            **({"soften": config.soften} if config.soften else {}),
            "demonstrations": len(self.episodes),
            "changes": dict(changes),
            **more,
        }
        return Policy(actor, self.robot, self.centers, card)

    def validate(self, policy: Policy) -> Result:
        """Measure a policy on the validation targets, in the engine and space of training."""
        config = self.config
        return evaluate(
            policy,
            self.robot,
            config.backend,
            config.space,
            config.evaluate_episodes,
            seed=VALIDATION_SEED,
            centers=self.centers,
            frame_skip=self.frame_skip,
            task=config.task,
            start=config.start,
        )


def as_tensor(array: Array) -> Tensor:
    """Return an array as a tensor of float32."""
    return torch.as_tensor(array, dtype=torch.float32)
