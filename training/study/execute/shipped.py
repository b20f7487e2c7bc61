"""Measure the shipped policies and the scripted controllers in every engine."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import NamedTuple

from cdcsr.robot.description import load_robot
from cdcsr.simulation.engines import backend_names
from controllers.controller import Controller
from controllers.registry import scripted_controller
from training.config.seeds import TEST_SEED
from training.measure.evaluation import evaluate
from training.policy import Policy, load_policy, shipped_policies
from training.study.execute.jobs import commit
from training.study.lines import read_lines
from training.study.store import SHIPPED, write_files

SCRIPTED = ("jacobian", "nearest")
SOFTNESS = ("mujoco-stock:softness=description", "mujoco-stock:integrator=RK4")
"""Stock MuJoCo with one setting changed."""


OTHER_STARTS = ("moving", "anywhere")


class Place(NamedTuple):
    """Where a controller is measured."""

    space: str
    start: str
    backend: str


def places(start: str) -> list[Place]:
    """Return where a controller is measured, whose training began in the states `start`.

    From rest in every engine and space, and in Spatter also in the variants of stock MuJoCo. From
    other starts in MuJoCo, and in every engine if it was trained from other starts.
    """
    spaces = ("anchor", "floating", "spatter", "workspace")
    found = [Place(space, "still", engine) for space, engine in product(spaces, backend_names())]
    found += [Place("spatter", "still", engine) for engine in SOFTNESS]
    engines = ["mujoco"] if start == "still" else backend_names()
    return found + [
        Place("spatter", other, engine) for other, engine in product(OTHER_STARTS, engines)
    ]


def measure_shipped(store: Path, episodes: int = 100) -> int:
    """Measure what the store lacks, write each cell into it at once, and return their number.

    A cell that is there was measured on the same policy: its digest is compared.

    Args:
        store: the folder of the results.
        episodes: how many in each cell.
    """
    path = store / SHIPPED
    lines = {str(line["name"]): line for line in read_lines(path)} if path.is_file() else {}
    made = 0
    for controller, one, place in _wanted():
        name = f"{controller} in {place.backend}, {place.space}, {place.start}"
        digest = one.digest if isinstance(one, Policy) else "-"
        known = lines.get(name)
        if known and (known["policy"], known["episodes"]) == (digest, episodes):
            continue
        robot = one.robot if isinstance(one, Policy) else load_robot("paper")
        result = evaluate(
            one, robot, place.backend, place.space, episodes, TEST_SEED, start=place.start
        )
        lines[name] = {
            "name": name,
            "controller": controller,
            **place._asdict(),
            "commit": commit(),
            "policy": digest,
            "episodes": episodes,
            "success": "".join(map(str, result.success.astype(int))),
            "length": result.length.tolist(),
        }
        made += 1
        print(f"{name}: {result.rate:.2f}", flush=True)
        text = "".join(json.dumps(lines[key]) + "\n" for key in sorted(lines))
        write_files(store, {SHIPPED: text.encode()})
    return made


def _wanted() -> Iterator[tuple[str, Controller, Place]]:
    robot = load_robot("paper")
    found = {name: scripted_controller(name, robot) for name in SCRIPTED}
    found |= {name: load_policy(folder) for name, folder in shipped_policies().items()}
    for name, controller in found.items():
        if controller is not None:
            yield from ((name, controller, place) for place in places(controller.start))
