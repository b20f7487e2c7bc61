"""The training run: one loop for every algorithm."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module

import numpy as np
import torch
from tqdm import tqdm

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.files import write_bytes, write_json
from cdcsr.reading import MOST_RECORD, read_bytes
from cdcsr.simulation.randomization import Randomization
from cdcsr.tasks.spaces import wider_targets
from training.algorithms.bc import BehaviourCloning, Progress, imitate
from training.algorithms.registry import find_algorithm
from training.algorithms.td3 import TD3, BackboneNumbers
from training.config.learner import CloneStart, Cloning, Demonstrated
from training.experience.collector import Collector, exploration_noise
from training.experience.mixed_replay import MixedReplay
from training.networks.actor import Actor
from training.policy import Policy, load_policy
from training.run.checkpoint import Counters, Parts, load_state, save_state
from training.run.metrics import Meter, Metrics
from training.run.setup import Setup
from training.run.trackers import start_tracker
from training.run.train_options import RUN_FOLDER, STATE, SUMMARY, Train, read_older


def train(config: Train) -> Policy:
    """Carry out a run, or resume one that was interrupted.

    The folder then holds `config.json`, `metrics.csv`, `tensorboard/`, `clone/` (the policy of the
    behaviour clone), the policy itself, `state.safetensors` while the run is unfinished, and
    `summary.json` once it is finished.

    Raises:
        CdcsrError: the options do not fit together, or the folder holds another run.
        Busy: another process works at this run.
    """
    # Threads only slow small matrices down; seeds are run side by side instead.
    torch.set_num_threads(1)
    setup = Setup(config)
    if config.track:
        import_module(
            config.track
        )  # one that is missing should be told before the clone is trained
    identity = setup.identity()
    older = partial(read_older, run=config, now=identity, path=config.out / RUN_FOLDER.record)
    with RUN_FOLDER.claim(config.out, identity, older, config.force):
        return Run(setup).carry_out()


class Run:
    """One run in its folder, which this process holds.

    Args:
        setup: the parts of the run.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup, self.config, self.folder = setup, setup.config, setup.config.out
        self._started, self._minutes_before = time.monotonic(), 0.0

    def carry_out(self) -> Policy:
        """Do what is left of the run; return its policy."""
        if (self.folder / SUMMARY).exists():
            (self.folder / STATE).unlink(missing_ok=True)  # left if it was killed at its very end
            print(f"{self.folder} is a finished run; give --force to begin anew.")
            if self.config.json is not None:
                write_bytes(self.config.json, read_bytes(self.folder / SUMMARY, MOST_RECORD))
            return load_policy(self.folder)
        kind = find_algorithm(self.config.algorithm).learner
        clone = self._clone() if kind is None or kind.uses_clone else None
        if kind is None:
            assert clone is not None
            return self._finish(clone.actor, 0, 0)
        return self._learn(kind, clone)

    def _clone(self) -> BehaviourCloning:
        """Train the behaviour clone or, if that is done, read it back."""
        numbers, seed = self.setup.learner, self.config.seed
        assert isinstance(numbers, Cloning)
        torch.manual_seed(seed)
        clone = BehaviourCloning(self.setup.robot, numbers, torch.Generator().manual_seed(seed))
        if (self.folder / "clone" / "policy.json").is_file():
            clone.actor = load_policy(self.folder / "clone").actor
            return clone
        with _bar("clone", numbers.bc_updates) as progress:
            clone.fit(*self.setup.pairs(), progress)
        self.setup.policy(clone.actor, "bc").save(self.folder / "clone")
        return clone

    def _learn(self, kind: type[TD3[BackboneNumbers]], clone: BehaviourCloning | None) -> Policy:
        """Collect, store and update until the updates or the minutes are used up."""
        config, learner = self.config, self.setup.learner
        assert isinstance(learner, BackboneNumbers)
        parts, env = self._parts(kind, learner, clone)
        algorithm, replay, collector, generators, _ = parts
        # Begin, or resume from the checkpoint.
        state, done_before, recent = self.folder / STATE, 0, deque[bool](maxlen=200)
        if state.exists():
            counters = load_state(state, parts)
            done_before, self._minutes_before = counters["update"], counters["minutes"]
            recent.extend(bool(success) for success in counters["recent"])
        else:
            self._begin(parts, clone)
        metrics = self._metrics(done_before)
        meter, stopped, update = Meter(), False, done_before
        with tqdm(
            total=learner.updates,
            initial=done_before,
            desc=config.algorithm,
            unit="update",
            disable=None,  # off where no terminal shows it
        ) as bar:
            while update < learner.updates and not stopped:
                update += 1
                # Step the environments; store the episodes that end.
                if (update - 1) % learner.updates_per_step == 0:
                    for episode in collector.step(algorithm.actor):
                        recent.append(episode.success)
                        replay.add(episode, generators["hindsight"])
                # Learn from a batch.
                if replay.ready:
                    meter.add(algorithm.update(replay.sample(generators["sample"])))
                bar.update()
                if update % 50 == 0:
                    success = f"{np.mean(recent):.2f}" if recent else "-"
                    bar.set_postfix(success=success, refresh=False)
                # Measure on validation targets, and save.
                done = update == learner.updates
                stopped = not done and self._out_of_time()
                due = config.evaluate_every and update % config.evaluate_every == 0
                if done or stopped or due:
                    counters: Counters = {
                        "update": update,
                        "environment_steps": _environment_steps(learner, update),
                        "minutes": self._minutes(),
                        "recent": [int(success) for success in recent],
                        "diverged": collector.diverged,
                    }
                    metrics.add(self._measure(algorithm.policy, counters, meter))
                    if not done:
                        save_state(state, parts, counters)
        metrics.close()
        env.close()
        if stopped:
            print(f"Stopped after update {update}; the same options go on from here.")
            return load_policy(self.folder)
        steps = _environment_steps(learner, learner.updates)
        policy = self._finish(algorithm.policy, learner.updates, steps)
        state.unlink(missing_ok=True)
        return policy

    def _parts(
        self,
        kind: type[TD3[BackboneNumbers]],
        learner: BackboneNumbers,
        clone: BehaviourCloning | None,
    ) -> tuple[Parts, TaskVectorEnv]:
        """Make what learning changes, and the environments, which have begun."""
        config, robot = self.config, self.setup.robot
        torch.manual_seed(config.seed)
        torch_generator = torch.Generator().manual_seed(config.seed)
        algorithm = kind(robot, learner, torch_generator)
        if algorithm.uses_demonstrations:
            algorithm.show(*self.setup.pairs())
        noise, sample, hindsight, plants = np.random.default_rng(config.seed).spawn(4)
        randomization = None
        if config.randomized:
            randomization = Randomization(
                robot, learner.num_envs, config.randomize, plants, config.soften
            )
        env = self.setup.environment(learner.num_envs, config.space, randomization=randomization)
        if learner.practice > 0:
            env.space = wider_targets(env.space, learner.practice, robot)
        collector = Collector(env, exploration_noise(learner), learner.noise_hold, noise)
        share = learner.kept_share if isinstance(learner, Demonstrated) else 0.0
        actions = None if clone is None else clone.actions
        replay = MixedReplay(robot, env.task, learner, actions, share)
        collector.start(config.seed)
        generators = {"noise": noise, "sample": sample, "hindsight": hindsight}
        return Parts(algorithm, replay, collector, generators, torch_generator), env

    def _metrics(self, done_before: int) -> Metrics:
        """Go on with the table of the updates that are done, and begin a run in a tracker."""
        config = self.config
        tracker = config.track and start_tracker(config.track, self.folder, config.as_dict())
        return Metrics(self.folder, done_before, tracker)

    def _begin(self, parts: Parts, clone: BehaviourCloning | None) -> None:
        """Fill the replay and start the actor as the algorithm asks."""
        setup, learner, algorithm = self.setup, self.setup.learner, parts.algorithm
        cloned = None if clone is None else clone.actor
        parts.replay.prefill(setup.first_episodes(algorithm.actor, cloned))
        if isinstance(learner, CloneStart) and learner.clone_start:
            with _bar("actor", learner.bc_updates) as progress:
                imitate(algorithm.actor, learner, *setup.pairs(), parts.torch_generator, progress)
            algorithm.target_actor.load_state_dict(algorithm.actor.state_dict())

    def _measure(self, actor: Actor, counters: Counters, meter: Meter) -> dict[str, float]:
        """Save the policy as it is now, and return a row of metrics."""
        assert isinstance(self.setup.learner, BackboneNumbers)
        done = {"update": counters["update"], "of": self.setup.learner.updates}
        policy = self.setup.policy(actor, self.config.algorithm, unfinished=done)
        policy.save(self.folder)
        summary = self.setup.validate(policy).summary()
        names = ("success_rate", "success_low", "success_high", "length_mean")
        row = {name: summary[name] for name in names}
        row |= {name: counters[name] for name in ("update", "environment_steps", "minutes")}
        row["diverged"] = counters["diverged"]
        if counters["recent"]:
            row["train_success"] = float(np.mean(counters["recent"]))
        tqdm.write(
            f"update {counters['update']:>6}  {counters['minutes']:6.1f} min  "
            f"success {summary['success_rate']:.2f}  length {summary['length_mean']:5.1f}"
            + (f"  diverged {counters['diverged']}" if counters["diverged"] else "")
        )
        return row | meter.take()

    def _finish(self, actor: Actor, updates: int, steps: int) -> Policy:
        """Save the policy and the summary."""
        config = self.config
        policy = self.setup.policy(
            actor, config.algorithm, updates=updates, environment_steps=steps
        )
        policy.card["minutes"] = round(self._minutes(), 2)
        policy.save(self.folder)
        validation = self.setup.validate(policy).summary()
        summary = {"out": str(self.folder), **policy.card, "validation": validation}
        write_json(self.folder / SUMMARY, summary)
        if config.json is not None:
            write_json(config.json, summary)
        print(
            f"{policy.name}: success {validation['success_rate']:.2f}, length "
            f"{validation['length_mean']:.1f} on {validation['episodes']} validation targets "
            f"({config.backend}, {config.space}), {policy.card['minutes']:.1f} min -> {self.folder}"
        )
        return policy

    def _out_of_time(self) -> bool:
        limit = self.config.stop_after
        return limit is not None and self._minutes() - self._minutes_before > limit

    def _minutes(self) -> float:
        return self._minutes_before + (time.monotonic() - self._started) / 60


def _environment_steps(learner: BackboneNumbers, updates: int) -> int:
    """Return how many steps all environments have made after so many updates."""
    return -(-updates // learner.updates_per_step) * learner.num_envs


@contextmanager
def _bar(what: str, updates: int) -> Iterator[Progress]:
    """Show the progress of imitation."""
    with tqdm(total=updates, desc=what, unit="update", disable=None) as bar:

        def progress(update: int, loss: float) -> None:
            bar.update(update - bar.n)
            bar.set_postfix(loss=f"{loss:.2g}")

        yield progress
