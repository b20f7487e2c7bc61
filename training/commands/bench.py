"""`cdcsr bench`: measure speed and memory."""

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
    """Measure speed and memory, mostly as ratios to something that ran in turns with it.

    The machine's own speed is printed beside each ratio. The section "trainer" needs the
    development dependencies; "memory" needs a system with the `resource` module; "gpu" needs the
    extra `gpu`; learning takes three and a half minutes of it.

    Args:
        sections: memory, growth, arms, trainer, gpu, or one that an engine brings; by default all.
        json: also write the numbers to this file.
        plot: also draw how the cost of a step grows with the robot, into this folder.
        peers: an interpreter that has gym-softrobot and sbx-rl; by default this one.
    """
    from training.bench.sections import run_sections

    run_sections(sections, json, plot, peers)
