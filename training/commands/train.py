"""`cdcsr train`, also installed as `training`, and the same as `python -m training`."""

from __future__ import annotations

from collections.abc import Sequence


class TrainCommand:
    """Train a policy with BATD3, with a method it is compared with, or with CLASP."""

    def __init__(self, prog: str, argv: Sequence[str]) -> None:
        from training.run.command_line import read_train

        self.config = read_train(prog, argv)
        self.json = self.config.json

    def run(self) -> None:
        """Carry out the run."""
        if self.config.device == "cuda":
            import torch

            from training.run.device_run import train_on_device

            train_on_device(self.config, torch.device("cuda"))
            return
        from training.run.trainer import train

        train(self.config)
