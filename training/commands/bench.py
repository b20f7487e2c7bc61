"""`cdcsr bench`."""

from __future__ import annotations

from pathlib import Path


def bench(
    sections: tuple[str, ...] = (),
    /,
    *,
    json: Path | None = None,
    plot: Path | None = None,
    peers: str | None = None,
) -> None:
    """Measure speed and memory, times as ratios within one process, the machine's own floor beside them.

    Needs the development dependencies (stable-baselines3), and a system with the `resource` module for memory.

    Args:
        sections: memory, growth, arms, trainer, or one that an engine brings; by default all.
        json: also write the numbers to this file.
        plot: also draw how the cost of a step grows with the robot, into this folder.
        peers: an interpreter that has gym-softrobot and sbx-rl; by default this one, if it has.
    """
    from training.bench.sections import Benchmarks

    Benchmarks(peers, plot).run(sections, json)
