"""`cdcsr demo`: the whole path, from a robot's description to a transfer table."""

from __future__ import annotations

from pathlib import Path
from typing import Literal


def demo(
    out: Path,
    minutes: float = 8.0,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    json: Path | None = None,
) -> None:
    """Build, demonstrate, train, and measure the transfer between engines, all in one folder.

    The demo builds the paper's robot for every engine, records ten demonstrations, trains BC and
    BATD3, measures both and the demonstrator on the same held-out targets in every engine, and
    draws a learning curve, the targets and a video. If it is stopped, the same command resumes it.

    Args:
        out: the folder for everything.
        minutes: longest training time, the clone included. The other stages come on top: half a
            minute at the least, and as much again the first time, when PyBullet's kernels are
            compiled. With less than 8 the tables and the video have fewer episodes. A larger
            number trains a demo further that ran out of it.
        device: where BATD3 learns: cpu; cuda for a GPU, in the engine that steps on it; auto takes
            a GPU if there is one and the extra gpu is installed, and a folder that was begun keeps
            its device.
        json: also write the results, each episode included, to this file.
    """
    from cdcsr.files import write_json
    from cdcsr.simulation.arguments import check_number
    from training.commands.demo_stages import Amounts, run_demo

    check_number("minutes", minutes, 1e-3, 1e6)
    summary = run_demo(out, Amounts.within(minutes), device)
    if json is not None:
        write_json(json, summary)
