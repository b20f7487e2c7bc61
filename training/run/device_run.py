"""Training runs that learn side by side on one device; see :mod:`training.device`.

Each run has a folder of its own with the same files as any other run, and ends as it would alone.
All of them have the same options but the seed. A run that was interrupted goes on where its last
checkpoint was; on a processor to the bit, on a GPU up to the order in which it adds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, write_json
from cdcsr.tasks.catalogue import make_task
from training.algorithms.td3 import BackboneNumbers
from training.device.doors import snapshot_arrays
from training.device.networks import write_actor
from training.device.trial import Outcome
from training.measure.evaluation import Result
from training.networks.actor import Actor
from training.policy import Policy, load_policy
from training.run.checkpoint import read_meta, reading_state, write_state
from training.run.device_first import share_demonstrations
from training.run.device_parts import DeviceParts, check_device, make_clones, make_parts
from training.run.metrics import Metrics
from training.run.setup import Setup
from training.run.trackers import start_tracker
from training.run.train_options import FIRST, RUN_FOLDER, SHOWN, STATE, SUMMARY, Train, read_older

NEXT = "state.next.safetensors"
"""A checkpoint that is complete and waits until those of the runs beside it are, too."""
SAVE_EVERY = 60.0
"""Time between checkpoints, in [s]: their replays may have gigabytes, and a GPU is fast."""


def train_on_device(config: Train, device: torch.device) -> list[Policy]:
    """Carry out a run, or one for each of its seeds, or resume those that were interrupted.

    Raises:
        CdcsrError: there is no such device, the options do not fit together, or a folder holds
            another run.
        Busy: another process works at one of the runs.
    """
    policies = train_side_by_side(config.each_seed(), device)
    paths = [one.out / SUMMARY for one in config.each_seed()]
    if config.json is not None and all(path.exists() for path in paths):
        summaries = [read_json(path) for path in paths]
        write_json(config.json, summaries[0] if config.seeds is None else {"runs": summaries})
    return policies


def train_side_by_side(configs: Sequence[Train], device: torch.device) -> list[Policy]:
    """Carry out runs that differ only in their folders, seeds and spaces, and learn from the same
    demonstrations; raises as :func:`train_on_device`."""
    if device.type == "cuda" and not torch.cuda.is_available():
        raise CdcsrError("PyTorch finds no GPU for device cuda here; choose device cpu.")
    torch.set_num_threads(1)
    setups = [Setup(one) for one in configs]
    check_device(setups[0], len(setups), device)
    if configs[0].track:
        import_module(configs[0].track)  # one that is missing should be told before the work
    begin: list[Callable[[], None]] = []
    with ExitStack() as held:
        for setup in setups:
            one, identity = setup.config, setup.identity()
            older = partial(read_older, run=one, now=identity, path=one.out / RUN_FOLDER.record)
            begin.append(held.enter_context(RUN_FOLDER.hold(one.out, identity, older, one.force)))
        for each in begin:  # nothing is deleted before all folders are held
            each()
        return DeviceRuns(setups, device).carry_out()


class DeviceRuns:
    """Runs in folders that this process holds.

    Args:
        setups: the parts of each run.
        device: where they learn.

    Raises:
        CdcsrError: they ask for something that only a processor can do.
    """

    def __init__(self, setups: Sequence[Setup], device: torch.device) -> None:
        self.setups, self.device = setups, device
        self._folders = [setup.config.out for setup in setups]
        self._started, self._minutes_before = time.monotonic(), 0.0
        self._saved = self._started
        self._counted = 0, self._started

    def carry_out(self) -> list[Policy]:
        """Do what is left of the runs; return their policies."""
        finished = [(folder / SUMMARY).exists() for folder in self._folders]
        if all(finished):
            for folder in self._folders:
                _tidy(folder)  # in case it was killed at its very end
                print(f"{folder} is a finished run; give --force to begin anew.")
            return [load_policy(folder) for folder in self._folders]
        if any(finished):  # the process was killed at the end; only the others are left
            for folder, done in zip(self._folders, finished, strict=True):
                if done:
                    _tidy(folder)
            left = [one for one, done in zip(self.setups, finished, strict=True) if not done]
            DeviceRuns(left, self.device).carry_out()
            return [load_policy(folder) for folder in self._folders]
        share_demonstrations(self.setups)  # the same for all seeds and these spaces
        learner = self.setups[0].learner
        if not isinstance(learner, BackboneNumbers):  # supervised
            return self._finish(make_clones(self.setups, self.device), 0, 0)
        self._learner = learner
        self._settle()
        if len(groups := self._groups()) > 1:
            print("The runs stand at different updates; those at the same one go on together.")
            for group in groups:
                DeviceRuns(group, self.device).carry_out()
            return [load_policy(folder) for folder in self._folders]
        parts = make_parts(self.setups, self.device)
        try:
            return self._learn(parts)
        finally:
            parts.close()

    def _learn(self, parts: DeviceParts) -> list[Policy]:
        """Collect, store and update until the updates or the minutes are used up."""
        learner, numbers, config = parts.learner, self._learner, self.setups[0].config
        done_before, stopped = self._resume(parts), False
        tables = [self._table(setup, done_before) for setup in self.setups]
        seen, self._counted = _totals(parts), (done_before, time.monotonic())
        with tqdm(
            total=numbers.updates,
            initial=done_before,
            desc=config.algorithm,
            unit="update",
            disable=None,
        ) as bar:
            update = done_before
            while update < numbers.updates and not stopped:
                update += 1
                if (update - 1) % numbers.updates_per_step == 0:
                    learner.collector.step()
                if learner.ready:
                    learner.update(update)
                bar.update()
                done = update == numbers.updates
                stopped = not done and self._out_of_time()
                due = config.evaluate_every and update % config.evaluate_every == 0
                if done or stopped or due:
                    rows = self._rows(parts, update, seen)
                    seen = _totals(parts)
                    for table, row in zip(tables, rows, strict=True):
                        table.add(row)
                    if stopped or (not done and time.monotonic() - self._saved > SAVE_EVERY):
                        self._save(parts, update)
        for table in tables:
            table.close()
        if stopped:
            print(f"Stopped after update {update}; the same options go on from here.")
            return [load_policy(folder) for folder in self._folders]
        steps = learner.collector.steps * numbers.num_envs
        return self._finish(parts.actors, numbers.updates, steps)

    def _table(self, setup: Setup, done_before: int) -> Metrics:
        """Go on with the metrics of a run."""
        track, folder = setup.config.track, setup.config.out
        tracker = track and start_tracker(track, folder, setup.config.as_dict())
        return Metrics(folder, done_before, tracker)

    def _rows(
        self, parts: DeviceParts, update: int, seen: dict[str, list[int]]
    ) -> list[dict[str, float]]:
        """Measure and save every run's policy as it is now; return their rows of metrics."""
        rows, now, losses = [], _totals(parts), parts.learner.take_metrics()
        (before, since), measured = self._counted, time.monotonic()
        outcome = Outcome(*(part.cpu() for part in parts.trial.run(parts.learner.policy)))
        steps = parts.learner.collector.steps * self._learner.num_envs
        unfinished = {"update": update, "of": self._learner.updates}
        for run, setup in enumerate(self.setups):
            write_actor(parts.learner.policy, run, parts.actors[run])
            policy = setup.policy(parts.actors[run], setup.config.algorithm, unfinished=unfinished)
            policy.save(setup.config.out)
            summary = self._result(parts, outcome, run).summary()
            names = ("success_rate", "success_low", "success_high", "length_mean")
            row = {name: summary[name] for name in names}
            row |= {"update": update, "environment_steps": steps, "minutes": self._minutes()}
            row["diverged"] = now["diverged"][run]
            if episodes := now["episodes"][run] - seen["episodes"][run]:
                successes = now["successes"][run] - seen["successes"][run]
                row["train_success"] = successes / episodes
            row["updates_per_second"] = (update - before) / max(1e-9, measured - since)
            rows.append(row | losses[run])
        self._counted = update, time.monotonic()
        rates = [row["success_rate"] for row in rows]
        lowest = f" (lowest {min(rates):.2f})" if len(rates) > 1 else ""
        tqdm.write(
            f"update {update:>6}  {self._minutes():6.2f} min  success {np.mean(rates):.2f}{lowest}"
        )
        return rows

    def _result(self, parts: DeviceParts, outcome: Outcome, run: int) -> Result:
        """Return what :meth:`Setup.validate` measures, of one run."""
        setup, success = self.setups[run], outcome.success[run].numpy()
        most = make_task(setup.config.task, setup.robot).max_steps
        length = np.where(success, outcome.length[run].numpy() * setup.frame_skip, most)
        distance = outcome.distance[run].numpy().astype(np.float64)
        lost = int(outcome.diverged[run].sum())
        return Result(success, length, distance, parts.trial.targets[run], lost)

    def _save(self, parts: DeviceParts, update: int) -> None:
        """Write a checkpoint of every run: all of them are replaced, or none."""
        arrays, copies = snapshot_arrays(parts.simulation), self._learner.num_envs
        for run, setup in enumerate(self.setups):
            tensors = {name: x.cpu() for name, x in parts.learner.views(run).items()}
            own = slice(run * copies, (run + 1) * copies)
            tensors |= {f"engine.{k}": torch.from_numpy(x[own]) for k, x in arrays.items()}
            counters = {"update": update, "minutes": self._minutes()}
            counters["steps"] = parts.learner.collector.steps
            write_state(setup.config.out / NEXT, tensors, {"counters": counters}, setup.robot)
        for folder in self._folders:
            (folder / NEXT).replace(folder / STATE)
        self._saved = time.monotonic()

    def _settle(self) -> None:
        """Finish or undo checkpoints during which the process was killed.

        Once all are written they are put in place, one after the other. So where one is in place,
        all are complete; else some may be missing.
        """
        waiting = [folder for folder in self._folders if (folder / NEXT).exists()]
        updates = {_update_of(folder / NEXT) for folder in waiting}
        others = [folder / STATE for folder in self._folders if folder not in waiting]
        complete = all(path.exists() and _update_of(path) in updates for path in others)
        for folder in waiting:
            if complete:
                (folder / NEXT).replace(folder / STATE)
            else:
                (folder / NEXT).unlink()

    def _groups(self) -> list[list[Setup]]:
        """Return the runs by the update at which they stand: those of one list go on together."""
        groups: dict[int, list[Setup]] = {}
        for setup, folder in zip(self.setups, self._folders, strict=True):
            path = folder / STATE
            groups.setdefault(_update_of(path) if path.exists() else 0, []).append(setup)
        return list(groups.values())

    def _resume(self, parts: DeviceParts) -> int:
        """Put the runs, which stand at the same update, back to their checkpoints.

        Returns:
            The number of updates that are done, 0 without checkpoints.

        Raises:
            CdcsrError: a checkpoint is damaged.
        """
        paths, learner, update = [folder / STATE for folder in self._folders], parts.learner, 0
        arrays: list[dict[str, torch.Tensor]] = []
        for run, path in enumerate(paths):
            if not path.exists():
                return 0
            with reading_state(path, self.setups[run].robot) as (tensors, meta):
                counters = meta["counters"]
                learner.collector.resume(counters["steps"])
                views = learner.views(run)
                for name, view in views.items():
                    if (found := tensors[name].shape) != view.shape:
                        raise ValueError(f"{name} has the shape {tuple(found)}")
            for name, view in views.items():
                view.copy_(tensors[name])
            arrays.append(
                {k.removeprefix("engine."): x for k, x in tensors.items() if "engine." in k}
            )
            update, self._minutes_before = counters["update"], counters["minutes"]
        engine = {k: torch.cat([one[k] for one in arrays]).numpy() for k in arrays[0]}
        learner.collector.restore(parts.simulation, engine)
        return update

    def _finish(self, actors: Sequence[Actor], updates: int, steps: int) -> list[Policy]:
        """Save the policies and the summaries."""
        policies = []
        for run, setup in enumerate(self.setups):
            config = setup.config
            policy = setup.policy(
                actors[run],
                config.algorithm,
                updates=updates,
                environment_steps=steps,
                device=self.device.type,
            )
            policy.card["minutes"] = round(self._minutes(), 2)
            policy.save(config.out)
            validation = setup.validate(policy).summary()
            summary = {"out": str(config.out), **policy.card, "validation": validation}
            write_json(config.out / SUMMARY, summary)
            _tidy(config.out)
            print(
                f"{policy.name}: success {validation['success_rate']:.2f}, length "
                f"{validation['length_mean']:.1f} on {validation['episodes']} validation targets "
                f"({config.backend}, {config.space}), {policy.card['minutes']:.1f} min -> "
                f"{config.out}"
            )
            policies.append(policy)
        return policies

    def _out_of_time(self) -> bool:
        limit = self.setups[0].config.stop_after
        return limit is not None and self._minutes() - self._minutes_before > limit

    def _minutes(self) -> float:
        return self._minutes_before + (time.monotonic() - self._started) / 60


def _tidy(folder: Path) -> None:
    """Delete what a finished run no longer needs."""
    for name in (STATE, FIRST, SHOWN):
        (folder / name).unlink(missing_ok=True)


def _update_of(path: Path) -> int:
    """Return after how many updates a checkpoint was written."""
    return int(read_meta(path)["counters"]["update"])


def _totals(parts: DeviceParts) -> dict[str, list[int]]:
    """Return how many episodes every run has had, and how many of them succeeded or diverged."""
    tensors = parts.learner.collector.tensors
    return {name: tensors[name].tolist() for name in ("episodes", "successes", "diverged")}
