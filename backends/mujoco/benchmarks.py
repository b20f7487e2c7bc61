"""The sections that MuJoCo brings to `cdcsr bench`: what the environment adds to a bare step, and
whether the model is built as cheaply as it can be."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict

import numpy as np

from backends.mujoco.active_cables import CURRENT
from backends.mujoco.model_choices import cheapest, model_choices
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.robot.description import Robot
from cdcsr.simulation.benchmarks import Measurement
from cdcsr.simulation.contract import Array


def environment(robot: Robot, _: Array) -> Iterator[Measurement]:
    """Compare the vector environment with bare `mujoco.batch`, for 32 and for 256 copies."""
    for copies in (32, 256):
        speed, bare = vector_env_speed(robot, copies)
        name = f"vector_env_{copies}"
        yield Measurement(
            name,
            speed / bare,
            f"MuJoCo vector environment, {copies} copies: steps/s over bare mujoco.batch",
            f"bare mujoco.batch: {bare:,.0f} steps/s",
            details={f"{name}_steps_per_second": speed, f"{name}_bare_steps_per_second": bare},
        )


def vector_env_speed(
    robot: Robot, copies: int = 32, steps: int = 150, rounds: int = 7
) -> tuple[float, float]:
    """Return the steps per second, all copies together, of the vector environment and of bare
    `mujoco.batch` on the same model under the same commands.

    The two take turns, so that a busy machine slows both alike; medians over the rounds.
    """
    env = TaskVectorEnv(copies, robot, "mujoco")
    env.reset(seed=0)
    bare = MujocoSimulation(robot, copies)
    commands = -np.random.default_rng(0).random((steps, copies, robot.num_cables))
    control = bare.batch.bind("ctrl")
    times: list[tuple[float, float]] = []
    for _ in range(rounds):
        start = time.perf_counter()
        for command in commands:
            env.step(command)
        middle = time.perf_counter()
        for command in commands:
            control[:] = command
            bare.batch.step(stage=CURRENT)
        times.append((middle - start, time.perf_counter() - middle))
        env.reset()
        bare.reset()
    env.close()
    of_env, of_bare = np.median(times, axis=0) / (steps * copies)
    return 1 / float(of_env), 1 / float(of_bare)


def model(robot: Robot, commands: Array) -> Iterator[Measurement]:
    """Compare the cost of a step with that of the cheapest variant of the model that is as good."""
    choices = model_choices(robot, commands)
    best = cheapest(choices)
    table = ["us/step   to ours   tip moves by"]
    for choice in choices:
        numbers = f"{choice.microseconds:7.1f}  {choice.ratio:8.2f}  {choice.distance:10.1e} mm"
        note = "" if choice.faithful else "not faithful"
        table.append(f"{numbers}  {choice.name:40s}{note}".rstrip())
    yield Measurement(
        "model",
        1 / best.ratio,
        f"MuJoCo model: cost of a step over that of the cheapest faithful variant ({best.name})",
        f"ours: {choices[0].microseconds:.1f} us",
        tuple(table),
        {"model_choices": [asdict(choice) for choice in choices]},
    )
