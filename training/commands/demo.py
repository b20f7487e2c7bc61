"""`cdcsr demo`."""

from __future__ import annotations

from pathlib import Path


def demo(out: Path, minutes: float = 8.0, json: Path | None = None) -> None:
    """Build, demonstrate, train, and measure the transfer between engines: the whole path, in one folder.

    Builds the paper's robot for both engines, records ten demonstrations, trains BC and BATD3 in MuJoCo, measures
    both and the demonstrator on the same held-out targets in both engines, and draws a learning curve, the targets
    and a video. Stopped at any point, the same command goes on from there.

    Args:
        out: the folder of everything.
        minutes: of training, at most. With more, a demo whose training ran out of them goes on.
        json: also write the results, each episode included, to this file.
    """
    from cdcsr.errors import CdcsrError
    from cdcsr.files import write_json
    from training.commands.demo_stages import Amounts, run_demo

    if not minutes > 0:
        raise CdcsrError(f"minutes must be positive, not {minutes:g}.")
    summary = run_demo(out, Amounts(minutes))
    if json is not None:
        write_json(json, summary)
