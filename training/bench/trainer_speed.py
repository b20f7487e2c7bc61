"""How fast the learners update, against other projects and against bare matrix products."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping

import numpy as np
import torch

from cdcsr.robot.description import Robot
from cdcsr.simulation.benchmarks import Measurement
from cdcsr.tasks.observation import observation_size
from training.algorithms.batd3 import BATD3Numbers
from training.algorithms.registry import algorithm_title
from training.bench.peer_process import MissingPeer, Peer
from training.bench.timed_updates import (
    PRODUCT_SIZE,
    PRODUCTS,
    SBX,
    Updates,
    matrix_products,
    own_updates,
    stable_baselines_updates,
    update_flops,
)
from training.networks import bfloat16

TIMED = ("batd3", "td3", "clasp")
"""Algorithms whose updates are timed."""
OTHERS, OTHERS_JAX, PRODUCT = "stable_baselines3", "sbx", "product"
BFLOAT16 = "_bfloat16"
"""Ends the name of what is timed with products in bfloat16."""
_OURS = "from training.bench.timed_updates import own_updates\nrun = own_updates()"


def trainer(robot: Robot, python: str) -> Iterator[Measurement]:
    """Measure the updates of our learners.

    Args:
        robot: the description.
        python: an interpreter that may have sbx-rl.
    """
    yield from compare_speeds(update_seconds(robot, python), update_flops(BATD3Numbers(), robot))
    what = "speed of a run's updates with another run beside it over alone"
    yield Measurement("side_by_side", side_by_side(), what)


def update_seconds(
    robot: Robot, python: str, updates: int = 4, rounds: int = 40
) -> dict[str, float]:
    """Return the processor time in [s] of an update of each learner, medians over the rounds.

    Ours have the paper's numbers (E = 5, Z = 2, 3 x 256, batch 256). The others are the TD3 of
    stable-baselines3 (a development dependency) and of SBX (optional), with five critics and the
    same networks. All learn from random data, in one thread, and take turns. An update includes the
    drawing of its batch. Where the processor multiplies faster in bfloat16, ours and those of
    stable-baselines3 are also timed that way.

    Args:
        robot: the description.
        python: an interpreter that may have sbx-rl; it runs in a process of its own.
        updates: updates in each turn; an even number, so that each turn updates the actor as often.
        rounds: turns of each.

    Returns:
        Times by name: algorithms, "stable_baselines3", "sbx" if it is there, and "product", the
        matrix products timed for an update. Names of what is timed in bfloat16 end in "_bfloat16".
    """
    torch.set_num_threads(1)
    others, product = stable_baselines_updates(), matrix_products()
    turns: dict[str, Callable[[int], float]] = {
        **{name: _timed(own_updates(name)) for name in TIMED},
        OTHERS: _timed(others),
        PRODUCT: _timed(product),
    }
    if bfloat16.has_fast_bfloat16():
        turns |= {name + BFLOAT16: _timed(own_updates(name, bfloat16=True)) for name in TIMED}
        turns[OTHERS + BFLOAT16] = _timed(in_bfloat16(others))
        turns[PRODUCT + BFLOAT16] = _timed(in_bfloat16(product))
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(MissingPeer):
            setup = SBX.format(observation=observation_size(robot), action=robot.num_cables)
            sbx = stack.enter_context(Peer(setup, python))
            turns[OTHERS_JAX] = lambda count: sbx.run(count)[1]
        times: dict[str, list[float]] = {name: [] for name in turns}
        for turn in range(rounds + 1):
            for name, function in turns.items():
                taken = function(updates)
                if turn:  # the first turn only warms up
                    times[name].append(taken / updates)
    return {name: float(np.median(values)) for name, values in times.items()}


def compare_speeds(seconds: Mapping[str, float], flops: float) -> Iterator[Measurement]:
    """Compare the updates' speeds with those of the others, and with that of bare products.

    Args:
        seconds: what :func:`update_seconds` returns.
        flops: floating-point operations in the matrix products of a BATD3 update.
    """
    size = "E = 5, 3 x 256, batch 256"
    details = {"update_seconds": dict(seconds), "update_flops": flops}
    yield from _compare("", f"({size})", "", seconds, flops, details)
    if TIMED[0] + BFLOAT16 not in seconds:
        what = "updates with products in bfloat16, which are no faster on this processor"
        yield Measurement("update_share_bfloat16", None, what)
        return
    ours = {name: seconds[name + BFLOAT16] for name in TIMED}
    yield from _compare(BFLOAT16, f"({size}, bfloat16)", " in float32", {**seconds, **ours}, flops)
    # SBX has no bfloat16.
    alike = {**ours, **{name: seconds[name + BFLOAT16] for name in (OTHERS, PRODUCT)}}
    yield from _compare(
        f"{BFLOAT16}_alike", "(the same, bfloat16)", " in bfloat16", alike, flops, jax=False
    )


def _compare(
    suffix: str,
    ours: str,
    theirs: str,
    seconds: Mapping[str, float],
    flops: float,
    details: Mapping[str, object] | None = None,
    jax: bool = True,
) -> Iterator[Measurement]:
    """Compare speeds; `suffix` ends the names of the values, `ours` and `theirs` say in words how
    our updates and the others' were made."""
    rate = PRODUCTS * 2 * PRODUCT_SIZE**3 / seconds[PRODUCT]
    yield Measurement(
        f"update_share{suffix}",
        flops / seconds["batd3"] / rate,
        f"BATD3 updates/s {ours} over those at the rate of a product{theirs}",
        f"{PRODUCT_SIZE} x {PRODUCT_SIZE} product: {rate / 1e9:.0f} GFLOP/s",
        details=details or {},
    )
    for name in TIMED:
        over = f"{algorithm_title(name)} updates/s {ours} over"
        yield Measurement(
            f"update_sb3_{name}{suffix}",
            seconds[OTHERS] / seconds[name],
            f"{over} stable-baselines3's TD3{theirs}, five critics",
            f"{1 / seconds[OTHERS]:.0f} updates/s",
        )
        if jax:
            sbx = seconds.get(OTHERS_JAX)
            yield Measurement(
                f"update_sbx_{name}{suffix}",
                None if sbx is None else sbx / seconds[name],
                f"{over} SBX's TD3 (JAX){theirs}, five critics",
                "pip install sbx-rl, here or for --peers"
                if sbx is None
                else f"{1 / sbx:.1f} updates/s",
            )


def side_by_side(updates: int = 20, rounds: int = 12) -> float:
    """Return the speed of a run's updates beside those of another run, over its speed alone.

    Each run is a process of one thread. Wall times, one alone and both together taking turns;
    medians over the rounds.
    """
    alone, together = [], []
    with Peer(_OURS) as one, Peer(_OURS) as other:
        for turn in range(rounds + 1):
            single = one.run(updates)[0]
            for run in (one, other):
                run.start(updates)
            both = [run.wait()[0] for run in (one, other)]
            if turn:  # the first turn only warms up
                alone.append(single)
                together.append(np.mean(both))
    return float(np.median(alone) / np.median(together))


def in_bfloat16(function: Updates) -> Updates:
    """Return the same work with matrix products in bfloat16."""

    def run(count: int) -> None:
        with bfloat16.matrix_products(bfloat16=True):
            function(count)

    return run


def _timed(function: Updates) -> Callable[[int], float]:
    """Return the same work, timed: its processor time in [s]."""

    def run(count: int) -> float:
        start = time.thread_time()
        function(count)
        return time.thread_time() - start

    return run
