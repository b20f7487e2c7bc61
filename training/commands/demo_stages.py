"""The main job: from a description of a robot to a transfer table, in one folder, resumable at any point."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cdcsr.files import WorkingFolder, read_json, write_json, write_text
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.engines import backend_names, engine_title
from controllers.controller import Controller
from controllers.jacobian import JacobianController
from training.commands.build_model import build_model
from training.commands.demonstrate import demonstrate
from training.config.run_config import PRESETS, Learner, Train
from training.config.seeds import TEST_SEED
from training.measure.evaluation import Result
from training.measure.transfer_matrix import disagreements, format_table, transfer
from training.plots.learning_curve import draw_learning_curve
from training.plots.style import algorithm_title
from training.plots.targets import draw_targets
from training.plots.video import policy_video
from training.policy import Policy, load_policy
from training.run.metrics import read_metrics
from training.run.trainer import train

ROBOT, SPACE = "paper", "spatter"
TRAINED_IN = "mujoco"

RECORD = "demo.json"
DEMO_FOLDER = WorkingFolder("the folder of a demo", RECORD)
MODEL, DEMONSTRATIONS, RUN = "model", "demonstrations", "runs/batd3"
TABLE, CELLS = "transfer.md", "transfer.json"
CURVE, TARGETS = "learning_curve.png", "targets.png"
VIDEO, ANIMATION = "policy.mp4", "policy.gif"
_CONTENTS = {
    TABLE: "the transfer table",
    CELLS: "the same, with every episode",
    CURVE: "success while learning",
    TARGETS: "reached and missed targets",
    VIDEO: "the policy in both engines, in slow motion",
    ANIMATION: "the same, small",
    MODEL: "the robot for MuJoCo (MJCF) and for PyBullet (URDF)",
    DEMONSTRATIONS: "ten demonstrations, a Minari dataset",
    RUN: "the BATD3 run with its policy; the behaviour clone is in clone/",
}


@dataclass(frozen=True)
class Amounts:
    """How much of everything."""

    minutes: float = 8.0
    """Of training, at most; the policy is then what it has become."""
    episodes: int = 100
    """In each cell of the transfer table."""
    filmed: int = 3
    """Episodes in the video: those of the first held-out targets."""
    learner: Learner = field(default_factory=lambda: replace(PRESETS["tuned"], updates=9_000))


class Stages:
    """Does each stage once: one that is recorded as done with the same inputs, and whose files are there, is skipped.

    Args:
        folder: claimed as :data:`DEMO_FOLDER`; its record holds the inputs of each finished stage.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self._record = folder, folder / RECORD
        self._done = read_json(self._record)

    def run(
        self, name: str, inputs: dict[str, Any], files: Sequence[str], work: Callable[[], None]
    ) -> None:
        """Do one stage, unless that was done before.

        Args:
            name: what is done, in words.
            inputs: plain data that decides what comes out.
            files: what comes out, by names in the folder.
            work: does it.
        """
        if self._done.get(name) == inputs and all((self.folder / file).exists() for file in files):
            print(f"==> {name}: done before", flush=True)
            return
        print(f"==> {name}", flush=True)
        started = time.monotonic()
        work()
        self._done[name] = inputs
        write_json(self._record, self._done)
        print(f"    {time.monotonic() - started:.0f} s", flush=True)


def run_demo(out: Path, amounts: Amounts = Amounts()) -> dict[str, Any]:
    """Build the models, record demonstrations, train, measure in both engines, and draw.

    Stopped at any point, the same call goes on from there; training loses at most what came after its last
    evaluation. With more minutes, training that ran out of them goes on, and what follows from it is done again.

    Args:
        out: the folder of everything.
        amounts: how much of everything.

    Returns:
        A summary, ready for JSON.

    Raises:
        CdcsrError: the folder holds something else, or a demo with other options.
    """
    torch.set_num_threads(1)
    with DEMO_FOLDER.claim(out):
        return _run(Stages(out), amounts)


def _run(stages: Stages, amounts: Amounts) -> dict[str, Any]:
    out, robot = stages.folder, load_robot(ROBOT)
    of_robot = {"robot": robot.fingerprint}
    stages.run(
        "models of the robot",
        of_robot,
        [MODEL],
        lambda: build_model(ROBOT, out=out / MODEL, force=True),
    )
    stages.run(
        "ten demonstrations in MuJoCo",
        of_robot,
        [DEMONSTRATIONS],
        lambda: demonstrate(out=out / DEMONSTRATIONS, backend=TRAINED_IN, robot=ROBOT, force=True),
    )
    _train(stages, amounts)
    clone, policy = load_policy(out / RUN / "clone"), load_policy(out / RUN)
    learned = {
        "weights": [_digest(out / RUN / "clone"), _digest(out / RUN)],
        "episodes": amounts.episodes,
    }
    stages.run(
        "the same held-out targets in both engines",
        learned,
        [TABLE, CELLS],
        lambda: _measure(out, robot, [JacobianController(robot), clone, policy], amounts.episodes),
    )
    measured = json.loads((out / CELLS).read_text("utf-8"))
    stages.run(
        "figures",
        learned,
        [CURVE, TARGETS],
        lambda: _draw(out, robot, measured["cells"], [clone, policy]),
    )
    targets = np.array(measured["cells"][-1]["targets"])[: amounts.filmed]
    stages.run(
        "video",
        {**learned, "episodes": len(targets)},
        [VIDEO, ANIMATION],
        lambda: policy_video(
            policy,
            robot,
            backend_names(),
            targets,
            [out / VIDEO, out / ANIMATION],
            policy.frame_skip,
        ),
    )
    print("\n" + (out / TABLE).read_text("utf-8"))
    width = max(len(str(out / name)) for name in _CONTENTS)
    for name, what in _CONTENTS.items():
        print(f"{out / name!s:<{width}}  {what}")
    history = read_metrics(out / RUN / "metrics.csv")
    return {"out": str(out), "files": list(_CONTENTS), "training": history[-1], **measured}


def _train(stages: Stages, amounts: Amounts) -> None:
    """Train BATD3, and the behaviour clone it begins with, until its updates or its minutes are used up."""
    folder = stages.folder / RUN
    config = Train(
        folder,
        space=SPACE,
        backend=TRAINED_IN,
        robot=ROBOT,
        demonstrations=stages.folder / DEMONSTRATIONS,
        learner=amounts.learner,
    )

    def work() -> None:
        history = read_metrics(folder / "metrics.csv")
        left = amounts.minutes - (history[-1]["minutes"] if history else 0.0)
        if left > 0 and not (folder / "summary.json").exists():
            train(replace(config, stop_after=left))
        if not (folder / "summary.json").exists():
            print(
                "    The time for training is used up; a larger --minutes trains this policy further."
            )

    inputs = {**config.identity(), "minutes": amounts.minutes}
    stages.run(
        "BC and BATD3 in MuJoCo", inputs, [f"{RUN}/policy.json", f"{RUN}/clone/policy.json"], work
    )


def _measure(out: Path, robot: Robot, controllers: Sequence[Controller], episodes: int) -> None:
    """Write the transfer table, and what it is made of."""
    cells = transfer(
        controllers,
        robot,
        backend_names(),
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
    write_json(out / CELLS, data)
    write_text(
        out / TABLE,
        f"{episodes} held-out targets, the same in each cell.\n\n{format_table(cells)}\n",
    )


def _draw(
    out: Path, robot: Robot, cells: Sequence[dict[str, Any]], policies: Sequence[Policy]
) -> None:
    """The learning curve and the picture of the targets."""
    titles = {policy.name: algorithm_title(policy.card["algorithm"]) for policy in policies}
    references = {
        f"{titles.get(cell['controller'], 'demonstrator')}, held-out targets": cell["success_rate"]
        for cell in cells
        if cell["backend"] == TRAINED_IN and cell["controller"] != policies[-1].name
    }
    draw_learning_curve([out / RUN], out / CURVE, references)
    results = {
        f"{titles[cell['controller']]} in {engine_title(cell['backend'])}": Result(
            *(np.array(cell[name]) for name in ("success", "length", "distance", "targets"))
        )
        for cell in cells
        if cell["controller"] in titles
    }
    draw_targets(results, robot, out / TARGETS)


def _digest(folder: Path) -> str:
    """Names the weights of a policy."""
    return hashlib.sha256((folder / "policy.safetensors").read_bytes()).hexdigest()[:16]
