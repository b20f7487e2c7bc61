"""`python -m training`, also installed as the command `training`: the same as `cdcsr train`."""

from __future__ import annotations

import sys

from cdcsr.cli import run


def main() -> int:
    """Train a policy from the command line."""
    from training.commands.train import TrainCommand

    return run(TrainCommand, "training", sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
