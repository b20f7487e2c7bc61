"""The training run: one loop for every algorithm."""

from __future__ import annotations

import json
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from cdcsr.envs import ReachVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.files import write_json
from cdcsr.robot import Robot, load_robot
from cdcsr.simulation import load_backend
from cdcsr.spaces import demonstration_space, make_space
from cdcsr.tasks import observation_size
from controllers import demonstrations
from controllers.demonstrations import Episode
from controllers.jacobian import JacobianController
from training.algorithms import ALGORITHMS, BehaviourCloning
from training.algorithms.td3 import TD3
from training.checkpoints import load_state, save_state
from training.collector import Collector
from training.config import Train
from training.evaluation import VALIDATION_SEED, Result, evaluate
from training.metrics import Metrics
from training.networks import Actor
from training.policy import Policy, load_policy
from training.replay import Replay

Array = NDArray[np.float64]

DEMONSTRATIONS = 10
"""How many are recorded if none are given."""


def train(config: Train) -> Policy:
    """Carry out a run, or go on with one that was interrupted.

    The folder then holds: `config.json`, `metrics.csv`, `tensorboard/`, `clone/` (the behaviour clone's policy),
    the policy itself, `state.safetensors` while it is unfinished, and `summary.json` once it is done.

    Raises:
        CdcsrError: the options do not fit together, or the folder holds another run.
    """
    torch.set_num_threads(1)  # small matrices on several threads are slower; run seeds side by side instead
    run = Run(config)
    return run.carry_out()


class Run:
    """The state of one training run."""

    def __init__(self, config: Train) -> None:
        self.config, self.folder = config, config.out
        self.robot: Robot = load_robot(config.robot)
        # What is misspelt or does not fit must not leave a folder behind.
        load_backend(config.backend)
        make_space(config.space, self.robot)
        self.episodes = self._demonstrations()
        self._claim_folder()
        self.centers = np.array([episode.target for episode in self.episodes])
        self.started = time.monotonic()
        self.minutes_before = 0.0
        self.torch_generator = torch.Generator()

    def carry_out(self) -> Policy:
        """All of it; returns the trained policy."""
        if (self.folder / "summary.json").exists():
            print(f"{self.folder} is a finished run; give --force to start anew.")
            return load_policy(self.folder)
        clone = None
        if self.config.algorithm == "bc" or ALGORITHMS[self.config.algorithm].uses_clone:
            clone = self._clone()
        if self.config.algorithm == "bc":
            assert clone is not None
            return self._finish(clone.actor, 0, 0)
        return self._learn(clone)

    # -- before learning ------------------------------------------------------------------------------------

    def _claim_folder(self) -> None:
        """Make the folder, or make sure that the run in it is this one."""
        path, identity = self.folder / "config.json", {**self.config.identity(), "fingerprint": self.robot.fingerprint}
        if self.folder.exists() and not self.config.force:
            if not path.is_file():
                if any(self.folder.iterdir()):
                    raise CdcsrError(f"{self.folder} exists and is not a training run; give another folder.")
            else:
                _refuse_other_run(path, identity)
        if self.config.force:
            for name in ("summary.json", "state.safetensors", "metrics.csv"):
                (self.folder / name).unlink(missing_ok=True)
            for old in (self.folder / "tensorboard").glob("events.*"):
                old.unlink()
            (self.folder / "clone" / "policy.json").unlink(missing_ok=True)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CdcsrError(f"Cannot make the folder {self.folder}: {error.strerror}.") from None
        write_json(path, identity)

    def _demonstrations(self) -> list[Episode]:
        config = self.config
        if config.demonstrations is not None:
            return demonstrations.load(config.demonstrations, self.robot.fingerprint, config.frame_skip)
        print(f"Recording {DEMONSTRATIONS} demonstrations in {config.backend} (seed 0)", flush=True)
        env = self._env(DEMONSTRATIONS, demonstration_space(config.space), autoreset="Disabled")
        episodes, _ = demonstrations.record(JacobianController(self.robot), env, DEMONSTRATIONS, seed=0)
        env.close()
        return episodes

    def _env(self, num: int, space: str, autoreset: str = "SameStep") -> ReachVectorEnv:
        config = self.config
        centers = self.centers if hasattr(self, "centers") else None
        return ReachVectorEnv(
            num, self.robot, config.backend, space, config.reward, config.frame_skip,
            centers=centers, autoreset_mode=autoreset,
        )  # fmt: skip

    def _clone(self) -> BehaviourCloning:
        """The behaviour clone, trained or, if that was done before, read back."""
        torch.manual_seed(self.config.seed)
        clone = BehaviourCloning(self.robot, self.config.learner, torch.Generator().manual_seed(self.config.seed))
        if (self.folder / "clone" / "policy.json").is_file():
            clone.actor = load_policy(self.folder / "clone").actor
            return clone
        observations = np.concatenate([e.observations[:-1] for e in self.episodes])
        commands = np.concatenate([e.actions for e in self.episodes])
        with tqdm(total=self.config.learner.bc_updates, desc="clone", unit="update") as bar:

            def progress(update: int, loss: float) -> None:
                bar.update(update - bar.n)
                bar.set_postfix(loss=f"{loss:.2g}")

            clone.fit(_tensor(observations), _tensor(commands), progress)
        self._policy(clone.actor, "bc").save(self.folder / "clone")
        return clone

    def _fill(self, replay: Replay, algorithm: TD3, clone: BehaviourCloning | None) -> None:
        """Put demonstrations and the clone's successful episodes into the replay buffer."""
        episodes = list(self.episodes) if algorithm.uses_demonstrations else []
        rollouts = self.config.learner.bc_rollouts
        if clone is not None and rollouts > 0:
            env = self._env(rollouts, self.config.space, autoreset="Disabled")
            observation, _ = env.reset(seed=self.config.seed)
            episodes += demonstrations.rollout(self._policy(clone.actor, "bc"), env, observation).successes()
            env.close()
        for episode in episodes:
            actions = algorithm.actor.from_command(_tensor(episode.actions)).numpy()
            replay.add_episode(
                episode.observations, actions, self._rewards(episode), True, _actions(clone, episode.observations)
            )

    def _rewards(self, episode: Episode) -> Array:
        """A successful episode's rewards under this run's reward."""
        success = np.arange(1, episode.length + 1) == episode.length
        distance = episode.observations[1:, 9]
        return success.astype(np.float64) if self.config.reward == "sparse" else success - distance

    # -- learning -------------------------------------------------------------------------------------------

    def _learn(self, clone: BehaviourCloning | None) -> Policy:
        config, learner = self.config, self.config.learner
        torch.manual_seed(config.seed)
        self.torch_generator.manual_seed(config.seed)
        algorithm = ALGORITHMS[config.algorithm](self.robot, learner, self.torch_generator)
        env = self._env(learner.num_envs, config.space)
        streams = np.random.default_rng(config.seed).spawn(2)
        collector = Collector(env, learner.exploration_noise, learner.noise_hold, streams[0])
        replay = Replay(
            learner.capacity, observation_size(self.robot), self.robot.num_cables,
            learner.discount, learner.return_steps,
        )  # fmt: skip
        state_path = self.folder / "state.safetensors"
        counters: dict[str, Any] = {"update": 0, "environment_steps": 0, "minutes": 0.0, "recent": []}
        collector.start(config.seed)
        generators = {"noise": streams[0], "sample": streams[1], "env": env.np_random}
        everything = (algorithm, replay, collector, generators, self.torch_generator)
        if state_path.exists():
            counters = load_state(state_path, *everything)
        else:
            self._fill(replay, algorithm, clone)
        self.minutes_before = counters["minutes"]
        recent = deque((bool(x) for x in counters["recent"]), maxlen=200)
        metrics = Metrics(self.folder, counters["update"])
        first, meter, stopped = counters["update"] + 1, _Meter(), False
        with tqdm(total=learner.updates, initial=first - 1, desc=config.algorithm, unit="update") as bar:
            for update in range(first, learner.updates + 1):
                for episode in collector.step(algorithm.actor):
                    recent.append(episode.success)
                    replay.add_episode(
                        episode.observations, episode.actions, episode.rewards, episode.terminated,
                        _actions(clone, episode.observations),
                    )  # fmt: skip
                if replay.size >= learner.batch_size:
                    meter.add(algorithm.update(replay.sample(learner.batch_size, streams[1])))
                bar.update(update - bar.n)
                if update % 50 == 0:
                    bar.set_postfix(success=f"{np.mean(recent):.2f}" if recent else "-", refresh=False)
                done = update == learner.updates
                stopped = not done and self._out_of_time()
                if done or stopped or (config.evaluate_every and update % config.evaluate_every == 0):
                    counters = {
                        "update": update,
                        "environment_steps": update * learner.num_envs,
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
        state_path.unlink(missing_ok=True)
        return self._finish(algorithm.policy, learner.updates, learner.updates * learner.num_envs)

    def _measure(self, actor: Actor, counters: dict[str, Any], recent: deque[bool], meter: _Meter) -> dict[str, float]:
        """Save the policy as it is now; one row of metrics, with its success rate on validation targets."""
        policy = self._policy(actor, self.config.algorithm)
        policy.save(self.folder)
        summary = self._evaluate(policy).summary()
        row = {name: summary[name] for name in ("success_rate", "success_low", "success_high", "length_mean")}
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
        policy = self._policy(actor, self.config.algorithm, updates=updates, environment_steps=steps)
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
            "name": f"{algorithm}-{config.preset}-{config.space}-{config.backend}-s{config.seed}",
            "algorithm": algorithm,
            "preset": config.preset,
            "backend": config.backend,
            "space": config.space,
            "seed": config.seed,
            "frame_skip": config.frame_skip,
            "demonstrations": len(self.episodes),
            **more,
        }
        return Policy(actor, self.robot, self.centers, card)

    def _evaluate(self, policy: Policy) -> Result:
        config = self.config
        return evaluate(
            policy, self.robot, config.backend, config.space, config.evaluate_episodes,
            seed=VALIDATION_SEED, centers=self.centers, frame_skip=config.frame_skip,
        )  # fmt: skip

    def _out_of_time(self) -> bool:
        limit = self.config.stop_after
        return limit is not None and self._minutes() - self.minutes_before > limit

    def _minutes(self) -> float:
        return self.minutes_before + (time.monotonic() - self.started) / 60


class _Meter:
    """Means of the losses since they were last taken."""

    def __init__(self) -> None:
        self._values: dict[str, list[Tensor]] = {}
        self._since = time.monotonic()

    def add(self, metrics: dict[str, Tensor]) -> None:
        for name, value in metrics.items():
            self._values.setdefault(name, []).append(value)

    def take(self) -> dict[str, float]:
        means = {name: float(torch.stack(values).mean()) for name, values in self._values.items()}
        now = time.monotonic()
        means["updates_per_second"] = max(map(len, self._values.values()), default=0) / (now - self._since)
        self._values, self._since = {}, now
        return means


def _tensor(array: Array) -> Tensor:
    return torch.as_tensor(array, dtype=torch.float32)


def _actions(clone: BehaviourCloning | None, observations: Array) -> Array | None:
    """The clone's actions in [-1, 1], once for each observation, so that no update computes them again."""
    if clone is None:
        return None
    with torch.no_grad():
        return clone.actor(clone.actor.encoder(_tensor(observations))).numpy()


def _refuse_other_run(path: Path, identity: dict[str, Any]) -> None:
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise CdcsrError(f"{path} cannot be read ({error}); give another folder, or --force.") from None
    if found != identity:
        flat_found, flat_asked = _flat(found), _flat(identity)
        differing = sorted(k for k in flat_found.keys() | flat_asked.keys() if flat_found.get(k) != flat_asked.get(k))
        raise CdcsrError(
            f"{path.parent} holds a run with other options ({', '.join(differing)}); give the same ones to resume it, "
            "another folder, or --force to start anew."
        )


def _flat(data: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in data.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return flat
