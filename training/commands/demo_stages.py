"""The stages of `cdcsr demo`: from a robot's description to a transfer table, in one folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, write_json, write_text
from cdcsr.folders import WorkingFolder
from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import (
    engine_title,
    load_backend,
    principal_engines,
    working_engines,
)
from controllers.jacobian import JacobianController
from training.algorithms.registry import algorithm_title
from training.commands.build_model import build_model
from training.commands.demonstrate import demonstrate
from training.config.run_description import Changes
from training.config.seeds import TEST_SEED
from training.measure.evaluation import Result
from training.measure.transfer_matrix import disagreements, format_table, transfer
from training.plots import video
from training.plots.learning_curve import draw_learning_curve
from training.plots.targets import draw_targets
from training.policy import Policy, load_policy
from training.run.device_run import train_on_device
from training.run.metrics import read_metrics
from training.run.train_options import RUN_FOLDER, SUMMARY, Train
from training.run.trainer import train

ROBOT, SPACE = "paper", "spatter"
DEMO_FOLDER = WorkingFolder("the folder of a demo", "demo.json")
MODEL, DEMONSTRATIONS, RUN, CLONE = "model", "demonstrations", "runs/batd3", "runs/batd3/clone"
TABLE, CELLS = "transfer.md", "transfer.json"
CURVE, TARGETS = "learning_curve.png", "targets.png"
VIDEO, ANIMATION = "policy.mp4", "policy.gif"
CONTENTS = {
    TABLE: "the transfer table",
    CELLS: "the same numbers, with every episode",
    CURVE: "success during training",
    TARGETS: "reached and missed targets",
    VIDEO: "the policy in MuJoCo and PyBullet, in slow motion",
    ANIMATION: "the same, small",
    MODEL: "the robot as model files for every engine",
    DEMONSTRATIONS: "ten demonstrations, a Minari dataset",
    RUN: "the BATD3 run with its policy; the behaviour clone is in clone/",
}


@dataclass(frozen=True)
class Amounts:
    """How much the demo trains, measures and films."""

    minutes: float = 8.0
    """Longest training time. Training then stops, and the demo shows the policy of that moment."""
    episodes: int = 100
    """Episodes in each cell of the transfer table."""
    validation_episodes: int = 100
    """Episodes for each point of the learning curve."""
    filmed: int = 3
    """Episodes in the video: those of the first held-out targets."""
    updates: int = 9_000
    """Updates of BATD3."""
    changes: Changes = ()
    """Changed numbers of the learner."""

    @classmethod
    def within(cls, minutes: float) -> Amounts:
        """Return the amounts of a demo that trains for so long at most.

        Below the usual minutes, episodes become fewer in proportion, down to a tenth.
        """
        share = min(max(minutes / cls.minutes, 0.1), 1.0)
        episodes, filmed = round(share * cls.episodes), 1 + round(share * (cls.filmed - 1))
        return cls(minutes, episodes, episodes, filmed)

    def shown(self, training: Mapping[str, float]) -> str:
        """Say what a demo of these amounts shows, in one line.

        Args:
            training: the last row of its metrics.
        """
        update, minutes = int(training["update"]), training["minutes"]
        done = (
            f"BATD3 made {update:,} of {self.updates:,} updates in {minutes:.1f} minutes, the "
            "clone's training included"
        )
        if update == self.updates:
            return f"{done}."
        return (
            f"{done}: this shows that every part works here, not how well it learns. "
            "A larger --minutes goes on from here."
        )


@dataclass(frozen=True)
class Stage:
    """One step of the demo."""

    title: str
    inputs: Mapping[str, object]
    """Plain data that determine the outcome."""
    files: tuple[str, ...]
    """The files and folders it writes, in the demo's folder."""
    work: Callable[[], None]


def run_demo(
    out: Path, amounts: Amounts = Amounts(), device: Literal["auto", "cpu", "cuda"] = "auto"
) -> dict[str, object]:
    """Build models, record demonstrations, train, measure in every engine, and draw.

    A demo that was stopped is resumed; training loses at most what came after its last checkpoint:
    one with each evaluation, on a GPU at most one a minute.
    With more minutes, training goes on, and the stages after it are done again.

    Args:
        out: the folder for everything.
        amounts: how much of everything.
        device: where BATD3 learns; see :func:`training.commands.demo.demo`.

    Returns:
        A summary, ready for JSON.

    Raises:
        CdcsrError: the folder holds something else, or a demo with other options; or there is no
            GPU where one is asked for.
        Busy: another process runs a demo there.
    """
    torch.set_num_threads(1)
    demo = Demo(out, amounts, engine_on_gpu(out, device))
    with DEMO_FOLDER.claim(out):
        carry_out(out, demo.stages())
    training = read_metrics(out / RUN / "metrics.csv")[-1]
    print("\n" + (out / TABLE).read_text("utf-8"))
    print(amounts.shown(training) + "\n")
    width = max(len(str(out / name)) for name in CONTENTS)
    for name, what in CONTENTS.items():
        print(f"{out / name!s:<{width}}  {what}")
    return {"out": str(out), "files": [*CONTENTS], "training": training, **read_json(out / CELLS)}


def engine_on_gpu(out: Path, device: Literal["auto", "cpu", "cuda"]) -> str | None:
    """Return the engine that steps on a GPU and say so, or None to learn on the processor.

    Raises:
        CdcsrError: a GPU is asked for, and there is none, or no engine for it; or the folder was
            begun with another device.
    """
    begun = out / RUN / RUN_FOLDER.record
    if begun.is_file():
        record = read_json(begun)
        own = "cuda" if record.get("device") == "cuda" else "cpu"
        if device not in ("auto", own):
            raise CdcsrError(
                f"{out} was begun with device {own}; go on with that, or give another folder."
            )
        if own == "cuda" and (out / RUN / SUMMARY).is_file():  # nothing is left to train
            return str(record["backend"])
        device = own
    if device == "cpu":
        return None
    engines = [name for name in principal_engines() if hasattr(load_backend(name), "device_state")]
    if engines and torch.cuda.is_available():
        where = torch.cuda.get_device_name()
        print(f"BATD3 learns on {where}, in {engine_title(engines[0])}.", flush=True)
        return engines[0]
    if device == "cuda":
        lacks = "GPU" if engines else "engine that steps on one (pip install 'cdcsr[gpu]')"
        raise CdcsrError(f"There is no {lacks} for device cuda here; choose auto or cpu.")
    return None


def carry_out(folder: Path, stages: Iterable[Stage]) -> None:
    """Do the stages that the record in the folder does not name with the same inputs, or whose
    files are missing."""
    record = folder / DEMO_FOLDER.record
    done = read_json(record)
    for stage in stages:
        there = all((folder / file).exists() for file in stage.files)
        if there and done.get(stage.title) == stage.inputs:
            print(f"==> {stage.title}: done before", flush=True)
            continue
        print(f"==> {stage.title}", flush=True)
        started = time.monotonic()
        stage.work()
        done[stage.title] = stage.inputs
        write_json(record, done)
        print(f"    {time.monotonic() - started:.0f} s", flush=True)


class Demo:
    """The stages of a demo in one folder.

    Args:
        out: the folder.
        amounts: how much of everything.
        engine: steps on a GPU, where BATD3 learns then; None to learn on the processor.
    """

    def __init__(self, out: Path, amounts: Amounts, engine: str | None) -> None:
        self._out, self._amounts = out, amounts
        self._robot = load_robot(ROBOT)
        self._training = Train(
            backend=engine or "mujoco",
            device="cuda" if engine else "cpu",
            preset="gpu" if engine else "tuned",
            out=out / RUN,
            space=SPACE,
            robot=ROBOT,
            demonstrations=out / DEMONSTRATIONS,
            evaluate_episodes=amounts.validation_episodes,
            updates=amounts.updates,
            changes=amounts.changes,
        )

    def stages(self) -> Iterator[Stage]:
        """Yield the stages in order; later ones take as inputs what earlier ones wrote."""
        robot = {"robot": self._robot.fingerprint}
        engine = engine_title(self._training.backend)
        yield Stage("models of the robot", robot, (MODEL,), self._build)
        yield Stage(f"ten demonstrations in {engine}", robot, (DEMONSTRATIONS,), self._demonstrate)
        yield Stage(
            f"BC and BATD3 in {engine}",
            {**self._training.identity(self._robot), "minutes": self._amounts.minutes},
            (f"{RUN}/policy.json", f"{CLONE}/policy.json"),
            self._train,
        )
        measured = {
            "weights": [policy.digest for policy in self._policies()],
            "engines": working_engines(),
            "episodes": self._amounts.episodes,
        }
        targets = "the same held-out targets in every engine"
        yield Stage(targets, measured, (TABLE, CELLS), self._measure)
        yield Stage("figures", measured, (CURVE, TARGETS), self._draw)
        filmed = {**measured, "episodes": min(self._amounts.filmed, self._amounts.episodes)}
        yield Stage("video", filmed, (VIDEO, ANIMATION), self._film)

    def _build(self) -> None:
        build_model(ROBOT, out=self._out / MODEL, force=True)

    def _demonstrate(self) -> None:
        backend = self._training.backend
        demonstrate(out=self._out / DEMONSTRATIONS, backend=backend, robot=ROBOT, force=True)

    def _train(self) -> None:
        """Train the clone and BATD3 until the updates or the minutes are used up."""
        history = read_metrics(self._out / RUN / "metrics.csv")
        left = self._amounts.minutes - (history[-1]["minutes"] if history else 0.0)
        summary = self._out / RUN / "summary.json"
        if left > 0 and not summary.exists():
            config = replace(self._training, stop_after=left)
            if config.device == "cpu":
                train(config)
            else:
                train_on_device(config, torch.device(config.device))

    def _policies(self) -> tuple[Policy, Policy]:
        """Return the clone and the policy."""
        return load_policy(self._out / CLONE), load_policy(self._out / RUN)

    def _measure(self) -> None:
        episodes = self._amounts.episodes
        cells = transfer(
            [JacobianController(self._robot), *self._policies()],
            self._robot,
            working_engines(),
            [SPACE],
            episodes,
            progress=lambda cell: print(
                f"    {cell.controller} in {cell.backend}: {cell.result.rate:.2f}", flush=True
            ),
        )
        data = {
            "seed": TEST_SEED,
            "cells": [
                {**cell.as_dict(), "distance": cell.result.distance, "targets": cell.result.targets}
                for cell in cells
            ],
            "disagreements": [pair.as_dict() for pair in disagreements(cells)],
        }
        write_json(self._out / CELLS, data)
        head = f"{episodes} held-out targets, the same in each cell."
        write_text(self._out / TABLE, f"{head}\n\n{format_table(cells)}\n")

    def _draw(self) -> None:
        """Draw the learning curve, and the targets that clone and policy reach in each engine."""
        clone, policy = self._policies()
        titles = {one.name: algorithm_title(one.card["algorithm"]) for one in (clone, policy)}
        cells = read_json(self._out / CELLS)["cells"]
        references = {
            f"{titles.get(cell['controller'], 'demonstrator')}, held-out targets": float(
                cell["success_rate"]
            )
            for cell in cells
            if cell["backend"] == self._training.backend and cell["controller"] != policy.name
        }
        draw_learning_curve([self._out / RUN], self._out / CURVE, references)
        results = {
            f"{titles[cell['controller']]} in {engine_title(cell['backend'])}": Result(
                *(np.array(cell[name]) for name in ("success", "length", "distance", "targets")),
                diverged=cell["diverged"],
            )
            for cell in cells
            if cell["controller"] in titles
        }
        draw_targets(results, self._robot, self._out / TARGETS)

    def _film(self) -> None:
        _, policy = self._policies()
        targets = np.array(read_json(self._out / CELLS)["cells"][-1]["targets"])
        targets, engines = targets[: self._amounts.filmed], principal_engines()
        skip = policy.frame_skip
        recordings = [video.record(policy, self._robot, name, targets, skip) for name in engines]
        period = self._robot.time_step * int(policy.card["frame_skip"])
        frames = list(video.draw_frames(recordings, self._robot, targets, period))
        video.write_video(frames, self._out / VIDEO)
        video.write_video(video.halved(frames), self._out / ANIMATION, video.FRAMES_PER_SECOND // 2)
