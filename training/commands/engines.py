"""`cdcsr engines`: list the engines, what in them is theirs, and what a step costs here."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cdcsr.robot.description import Robot

_STEPS, _ROUNDS = 20, 5


def engines(*, robot: str = "paper", json: Path | None = None) -> None:
    """List the engines: their options, what is their own and what is ours, and the time of a step.

    An engine that cannot be loaded is listed with its error.

    Args:
        robot: a shipped robot, or a path ending in .toml, whose step is timed.
        json: also write everything to this file.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.files import write_json
    from cdcsr.robot.description import load_robot
    from cdcsr.simulation.engines import backend_names, load_backend

    description, found = load_robot(robot), {}
    for name in backend_names():
        try:
            kind = load_backend(name)
            found[name] = {
                "title": kind.title,
                "version": kind.version,
                "capabilities": sorted(kind.capabilities),
                "physics": asdict(kind.physics),
                "options": {
                    key: {"default": field.default, "what": field.description}
                    for key, field in kind.options_type.model_fields.items()
                },
                "step_us": {num: _step_us(description, name, num) for num in (1, 32)},
            }
        except CdcsrError as error:
            found[name] = {"error": str(error)}
        except ImportError as error:
            found[name] = {"error": f"{type(error).__name__}: {error}"}
    for name, row in found.items():
        print("\n".join(_shown(name, row)), end="\n\n")
    print("A time is the median of a copy's step, in turns of this process.")
    if json is not None:
        write_json(json, found)


def _step_us(robot: Robot, name: str, num: int) -> float:
    """Return the time of a step of one of `num` copies, in [us]."""
    import numpy as np

    from cdcsr.simulation.engines import make_simulation

    simulation = make_simulation(robot, name, num)
    command = robot.full_commands * np.random.default_rng(0).random((num, robot.num_cables))
    simulation.step(command)  # the first step may compile
    times = []
    for _ in range(_ROUNDS):
        simulation.reset()
        start = perf_counter()
        for _ in range(_STEPS):
            simulation.step(command)
        times.append((perf_counter() - start) / _STEPS / num)
    simulation.close()
    return 1e6 * float(np.median(times))


def _shown(name: str, row: dict[str, object]) -> list[str]:
    """Return an engine's lines."""
    if "error" in row:
        return [f"{name}: cannot be loaded: {row['error']}"]
    abilities = row["capabilities"]
    assert isinstance(abilities, list)
    lines = [f"{name}: {row['title']} {row['version']} ({', '.join(abilities)})"]
    for part in ("physics", "options", "step_us"):
        values = row[part]
        assert isinstance(values, dict)
        for key, value in values.items():
            if part == "options":
                value = f"{value['what']} Default: {value['default']}."
                key = f"option {key}"
            elif part == "step_us":
                key, value = f"step, {key} copies", f"{value:.0f} us a copy"
            lines.append(f"  {key.replace('_', ' '):<24}{' '.join(str(value).split())}")
    return lines
