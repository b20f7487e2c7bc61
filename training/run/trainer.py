"""The training run: one loop for every algorithm."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.files import write_bytes, write_json
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.engines import load_backend
from cdcsr.simulation.randomization import Randomization
from cdcsr.tasks.catalogue import actions_per_episode, make_task
from cdcsr.tasks.spaces import demonstration_space, make_space, wider_targets
from cdcsr.tasks.symmetry import images
from cdcsr.tasks.task import Reward
from controllers import demonstrations
from controllers.jacobian import JacobianController
from controllers.rollout import Episode, rollout
from training.algorithms.bc import BehaviourCloning, Progress, imitate
from training.algorithms.registry import ALGORITHMS
from training.algorithms.td3 import TD3
from training.config.run_config import Train
from training.config.seeds import VALIDATION_SEED
from training.experience.collector import Collector, FinishedEpisode, exploration_noise
from training.experience.mixed_replay import MixedReplay
from training.measure.evaluation import Result, evaluate
from training.networks.actor import Actor
from training.networks.bfloat16 import has_fast_bfloat16
from training.policy import Policy, load_policy
from training.run.checkpoint import load_state, save_state
from training.run.heeded import refuse_unheeded
from training.run.metrics import Meter, Metrics
from training.run.run_folder import RUN_FOLDER, older_defaults

Array = NDArray[np.float64]
_STATE = "state.safetensors"


def train(config: Train) -> Policy:
    """Carry out a run, or go on with one that was interrupted.

    The folder then holds: `config.json`, `metrics.csv`, `tensorboard/`, `clone/` (the behaviour clone's policy),
    the policy itself, `state.safetensors` while it is unfinished, and `summary.json` once it is done.

    Raises:
        CdcsrError: the options do not fit together, or the folder holds another run.
        Busy: another process is at this run.
    """
    torch.set_num_threads(
        1
    )  # small matrices on several threads are slower; run seeds side by side instead
    run = Run(config)
    with RUN_FOLDER.claim(run.folder, run.identity, older_defaults(), config.force):
        return run.carry_out()


class Run:
    """The state of one training run."""

    def __init__(self, config: Train) -> None:
        self.config, self.folder = config, config.out
        self.robot: Robot = load_robot(config.robot)
        # What is misspelt or does not fit must not leave a folder behind.
        load_backend(config.backend)
        make_space(config.space, self.robot)
        task = make_task(config.task)
        if config.learner.discount == 1 and not task.ends:
            raise CdcsrError(
                f"discount must be below 1 for {config.task!r}, which pays for every action on target."
            )
        if config.learner.symmetry and len(images(self.robot)) == 1:
            raise CdcsrError(
                f"symmetry must be off: the cables of {self.robot.name!r} have no mirror image."
            )
        self._check_memory(actions_per_episode(task.max_steps, config.frame_skip))
        refuse_unheeded(config)
        if config.learner.bfloat16 and not has_fast_bfloat16():
            raise CdcsrError("bfloat16 must be off: this processor multiplies no faster in it.")
        self.reward: Reward = (
            "sparse" if config.algorithm == "bc" else ALGORITHMS[config.algorithm].reward
        )
        self.episodes = self._demonstrations()
        identity = {**config.identity(), "fingerprint": self.robot.fingerprint}
        if config.demonstrations is not None:
            identity["dataset"] = demonstrations.digest(
                self.episodes
            )  # another one may have come under the same name
        self.identity = identity
        self.centers = np.array([episode.target for episode in self.episodes])
        self.started = time.monotonic()
        self.minutes_before = 0.0
        self.torch_generator = torch.Generator()

    def carry_out(self) -> Policy:
        """All of it; returns the trained policy."""
        if (self.folder / "summary.json").exists():
            (self.folder / _STATE).unlink(missing_ok=True)  # if it was killed in between
            print(f"{self.folder} is a finished run; give --force to start anew.")
            if self.config.json is not None:
                write_bytes(self.config.json, (self.folder / "summary.json").read_bytes())
            return load_policy(self.folder)
        clone = None
        if self.config.algorithm == "bc" or ALGORITHMS[self.config.algorithm].uses_clone:
            clone = self._clone()
        if self.config.algorithm == "bc":
            assert clone is not None
            return self._finish(clone.actor, 0, 0)
        return self._learn(clone)

    def _check_memory(self, actions: int) -> None:
        """Refuse a replay buffer too small to learn from, and a share of it that nothing would fill.

        Args:
            actions: of an episode, at most.
        """
        config, learner = self.config, self.config.learner
        if learner.capacity < (least := max(learner.batch_size, actions + 1)):
            raise CdcsrError(
                f"capacity must be at least {least}, a batch and an episode, not {learner.capacity}."
            )
        kept = config.algorithm != "bc" and ALGORITHMS[config.algorithm].uses_demonstrations
        if learner.kept_share > 0 and not kept:
            raise CdcsrError(
                f"kept_share must be 0 for {config.algorithm}, which keeps no episodes."
            )

    # -- before learning ------------------------------------------------------------------------------------

    def _demonstrations(self) -> list[Episode]:
        config = self.config
        if config.demonstrations is not None:
            return demonstrations.load(
                config.demonstrations, self.robot.fingerprint, config.frame_skip, config.task
            )
        num = config.num_demonstrations
        print(f"Recording {num} demonstrations in {config.backend} (seed 0)", flush=True)
        env = self._env(num, demonstration_space(config.space), autoreset_mode="Disabled")
        episodes, _ = demonstrations.record(JacobianController(self.robot), env, num, seed=0)
        env.close()
        return episodes

    def _env(self, num: int, space: str, **more: Any) -> TaskVectorEnv:
        config = self.config
        centers = self.centers if hasattr(self, "centers") else None
        return TaskVectorEnv(
            num,
            self.robot,
            config.backend,
            space,
            self.reward,
            config.frame_skip,
            centers=centers,
            task=config.task,
            **more,
        )

    def _clone(self) -> BehaviourCloning:
        """The behaviour clone, trained or, if that was done before, read back."""
        torch.manual_seed(self.config.seed)
        clone = BehaviourCloning(
            self.robot, self.config.learner, torch.Generator().manual_seed(self.config.seed)
        )
        if (self.folder / "clone" / "policy.json").is_file():
            clone.actor = load_policy(self.folder / "clone").actor
            return clone
        with self._bar("clone") as progress:
            clone.fit(*self._pairs(), progress)
        self._policy(clone.actor, "bc").save(self.folder / "clone")
        return clone

    def _pairs(self) -> tuple[Tensor, Tensor]:
        """What the demonstrator saw and what it did."""
        observations = np.concatenate([episode.observations[:-1] for episode in self.episodes])
        return _tensor(observations), _tensor(
            np.concatenate([episode.actions for episode in self.episodes])
        )

    @contextmanager
    def _bar(self, what: str) -> Iterator[Progress]:
        """Shows how far imitation has come."""
        with tqdm(total=self.config.learner.bc_updates, desc=what, unit="update") as bar:

            def progress(update: int, loss: float) -> None:
                bar.update(update - bar.n)
                bar.set_postfix(loss=f"{loss:.2g}")

            yield progress

    def _begin(self, replay: MixedReplay, algorithm: TD3, clone: BehaviourCloning | None) -> None:
        """Let the learner begin with what the algorithm is given: demonstrations, the clone's successes, its skill."""
        episodes = list(self.episodes) if algorithm.uses_demonstrations else []
        rollouts = self.config.learner.bc_rollouts
        if clone is not None and algorithm.uses_rollouts and rollouts > 0:
            env = self._env(rollouts, self.config.space, autoreset_mode="Disabled")
            observation, _ = env.reset(seed=self.config.seed)
            policy = self._policy(clone.actor, "bc")
            episodes += rollout(policy, env, observation).successes()
            env.close()
        actor = algorithm.actor
        replay.prefill(
            FinishedEpisode(
                episode.observations,
                actor.from_command(_tensor(episode.actions)).numpy(),
                episode.rewards,
                True,
                episode.terminated,
            )
            for episode in episodes
        )
        if self.config.learner.clone_start:
            with self._bar("actor") as progress:
                imitate(actor, self.config.learner, *self._pairs(), self.torch_generator, progress)
            algorithm.target_actor.load_state_dict(actor.state_dict())

    # -- learning -------------------------------------------------------------------------------------------

    def _learn(self, clone: BehaviourCloning | None) -> Policy:
        config, learner = self.config, self.config.learner
        torch.manual_seed(config.seed)
        self.torch_generator.manual_seed(config.seed)
        algorithm = ALGORITHMS[config.algorithm](self.robot, learner, self.torch_generator)
        if algorithm.uses_demonstrations:
            algorithm.show(*self._pairs())
        streams = np.random.default_rng(config.seed).spawn(4)
        plants = None
        if config.randomize:
            plants = Randomization(self.robot, learner.num_envs, config.randomize, streams[3])
        env = self._env(learner.num_envs, config.space, randomization=plants)
        if learner.practice > 0:
            env.space = wider_targets(env.space, learner.practice, self.robot)
        collector = Collector(env, exploration_noise(learner), learner.noise_hold, streams[0])
        try:
            replay = MixedReplay(
                self.robot, env.task, learner, None if clone is None else clone.actions
            )
        except MemoryError:
            raise CdcsrError(
                f"capacity {learner.capacity} does not fit into this machine's memory."
            ) from None
        state_path = self.folder / _STATE
        counters: dict[str, Any] = {
            "update": 0,
            "environment_steps": 0,
            "minutes": 0.0,
            "recent": [],
        }
        collector.start(config.seed)
        generators = {"noise": streams[0], "sample": streams[1], "hindsight": streams[2]}
        everything = (algorithm, replay, collector, generators, self.torch_generator)
        if state_path.exists():
            counters = load_state(state_path, *everything)
        else:
            self._begin(replay, algorithm, clone)
        self.minutes_before = counters["minutes"]
        recent = deque((bool(x) for x in counters["recent"]), maxlen=200)
        metrics = Metrics(self.folder, counters["update"])
        first, meter, stopped = counters["update"] + 1, Meter(), False
        with tqdm(
            total=learner.updates, initial=first - 1, desc=config.algorithm, unit="update"
        ) as bar:
            for update in range(first, learner.updates + 1):
                if (update - 1) % learner.updates_per_step == 0:
                    for episode in collector.step(algorithm.actor):
                        recent.append(episode.success)
                        replay.add(episode, streams[2])
                if replay.ready:
                    meter.add(algorithm.update(replay.sample(streams[1])))
                bar.update(update - bar.n)
                if update % 50 == 0:
                    bar.set_postfix(
                        success=f"{np.mean(recent):.2f}" if recent else "-", refresh=False
                    )
                done = update == learner.updates
                stopped = not done and self._out_of_time()
                if (
                    done
                    or stopped
                    or (config.evaluate_every and update % config.evaluate_every == 0)
                ):
                    counters = {
                        "update": update,
                        "environment_steps": self._environment_steps(update),
                        "minutes": self._minutes(),
                        "recent": [int(x) for x in recent],
                    }
                    metrics.add(self._measure(algorithm.policy, counters, recent, meter))
                    if not done:
                        save_state(state_path, *everything, counters)
                if stopped:
                    break
        metrics.close()
        env.close()
        if stopped:
            print(f"Stopped after update {counters['update']}; the same options go on from here.")
            return load_policy(self.folder)
        policy = self._finish(
            algorithm.policy, learner.updates, self._environment_steps(learner.updates)
        )
        state_path.unlink(missing_ok=True)
        return policy

    def _measure(
        self, actor: Actor, counters: dict[str, Any], recent: deque[bool], meter: Meter
    ) -> dict[str, float]:
        """Save the policy as it is now; one row of metrics, with its success rate on validation targets."""
        policy = self._policy(actor, self.config.algorithm)
        policy.save(self.folder)
        summary = self._evaluate(policy).summary()
        row = {
            name: summary[name]
            for name in ("success_rate", "success_low", "success_high", "length_mean")
        }
        row |= {name: counters[name] for name in ("update", "environment_steps", "minutes")}
        if recent:
            row["train_success"] = float(np.mean(recent))
        tqdm.write(
            f"update {counters['update']:>6}  {counters['minutes']:6.1f} min  "
            f"success {summary['success_rate']:.2f}  length {summary['length_mean']:5.1f}"
        )
        return row | meter.take()

    # -- after learning -------------------------------------------------------------------------------------

    def _finish(self, actor: Actor, updates: int, steps: int) -> Policy:
        policy = self._policy(
            actor, self.config.algorithm, updates=updates, environment_steps=steps
        )
        policy.card["minutes"] = round(self._minutes(), 2)
        policy.save(self.folder)
        validation = self._evaluate(policy).summary()
        summary = {"out": str(self.folder), **policy.card, "validation": validation}
        write_json(self.folder / "summary.json", summary)
        if self.config.json is not None:
            write_json(self.config.json, summary)
        print(
            f"{policy.name}: success {validation['success_rate']:.2f}, length {validation['length_mean']:.1f} on "
            f"{validation['episodes']} validation targets ({self.config.backend}, {self.config.space}), "
            f"{policy.card['minutes']:.1f} min -> {self.folder}"
        )
        return policy

    def _policy(self, actor: Actor, algorithm: str, **more: Any) -> Policy:
        config = self.config
        card = {
            "name": config.policy_name(algorithm),
            "algorithm": algorithm,
            "preset": config.preset,
            "backend": config.backend,
            "task": config.task,
            "space": config.space,
            "seed": config.seed,
            "frame_skip": config.frame_skip,
            "randomize": config.randomize,
            "demonstrations": len(self.episodes),
            "changes": config.changes(algorithm),
            **more,
        }
        return Policy(actor, self.robot, self.centers, card)

    def _evaluate(self, policy: Policy) -> Result:
        config = self.config
        return evaluate(
            policy,
            self.robot,
            config.backend,
            config.space,
            config.evaluate_episodes,
            seed=VALIDATION_SEED,
            centers=self.centers,
            frame_skip=config.frame_skip,
            task=config.task,
        )

    def _environment_steps(self, updates: int) -> int:
        """How many the environments have made after so many updates."""
        learner = self.config.learner
        return -(-updates // learner.updates_per_step) * learner.num_envs

    def _out_of_time(self) -> bool:
        limit = self.config.stop_after
        return limit is not None and self._minutes() - self.minutes_before > limit

    def _minutes(self) -> float:
        return self.minutes_before + (time.monotonic() - self.started) / 60


def _tensor(array: Array) -> Tensor:
    return torch.as_tensor(array, dtype=torch.float32)
