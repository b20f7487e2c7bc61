"""Read a training run from a command line. The options depend on the algorithm and the preset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from textwrap import fill
from typing import Annotated, Generic, TypeVar, get_args

import tyro

from training.algorithms.registry import ALGORITHMS, differences, own_numbers
from training.config.learner import Network
from training.config.run_description import PresetName
from training.run.train_options import Train

N = TypeVar("N", bound=Network)


@dataclass(frozen=True, kw_only=True)
class _Options(Train, Generic[N]):
    numbers: Annotated[N, tyro.conf.arg(name="learner")]
    """The numbers of the learner."""


def read_train(prog: str, argv: Sequence[str]) -> Train:
    """Return the run that a command line asks for.

    Args:
        prog: what the user typed before `argv`.
        argv: the arguments.

    Raises:
        CdcsrError: an unknown algorithm, or a number out of bounds.
        SystemExit: the user asked for help (0), or an argument is unknown (2).
    """
    algorithm = _option(argv, "--algorithm") or "batd3"
    preset: PresetName = "tuned"
    for known in get_args(PresetName):
        if _option(argv, "--preset") == known:
            preset = known
    own = own_numbers(algorithm, preset, _option(argv, "--task") or "reach")
    if "--help-all" not in argv and ("--help" in argv or "-h" in argv):
        print(_short_help(prog, algorithm, own))
        raise SystemExit(0)
    options = tyro.cli(
        _Options[type(own)],  # type: ignore[misc]
        prog=prog,
        description="Train a policy; see also --help.",
        args=["--help" if argument == "--help-all" else argument for argument in argv],
        default=_Options(out=tyro.MISSING, algorithm=algorithm, preset=preset, numbers=own),
    )
    values = {one.name: getattr(options, one.name) for one in fields(Train)}
    changes = dict(differences(options.numbers, own))
    values |= {"updates": changes.pop("updates", 0), "changes": tuple(changes.items())}
    return Train(**values)


def _short_help(prog: str, algorithm: str, own: Network) -> str:
    """Return help of one screen: the options of a run, and the names of the learner's numbers."""
    names = fill(", ".join(type(own).model_fields), 96, initial_indent="  ", subsequent_indent="  ")
    return f"""\
usage: {prog} --out FOLDER [OPTIONS]

Train a policy. To resume an interrupted run, give the same command again.

  --out FOLDER            the folder of the run
  --algorithm NAME        what learns; one of
{fill(", ".join(ALGORITHMS), 72, initial_indent=" " * 26, subsequent_indent=" " * 26)}
  --preset NAME           tuned (default), paper-reading or gpu: the learner's numbers
  --backend ENGINE        the engine to train in, or several joined by + (mujoco)
  --robot ROBOT           a shipped robot, or a path that ends in .toml (paper)
  --space SPACE           where targets lie: anchor (default), floating, spatter, workspace, a map
                          (.npz) or debris (.stl, .obj, .ply, .glb)
  --task TASK             reach (default), precise, quiet, capture, follow-line, ...
  --threshold M, --seconds S, --radius M
                          distance that counts as reached, length of an episode, and radius of
                          Floating or Spatter, in place of the robot's own
  --start START           how episodes begin: still (default), moving, anywhere
  --seed N                seed of everything random but the demonstrations (0)
  --demonstrations PATH   a dataset from `cdcsr demonstrate`; by default ten are recorded
  --randomize SCALE       domain randomization of the plant (0: off)
  --soften SCALE          randomization of how far cables stretch (0: off)
  --evaluate-every N      updates between evaluations and checkpoints (1000)
  --stop-after MINUTES    stop; the run can be resumed
  --device cuda, --seeds 0:10
                          learn on a GPU; seeds 0 to 9 side by side, in folders of OUT
  --force                 begin anew in a folder that holds another run
  --json FILE             also write the summary to this file

--learner.NAME sets a number that {algorithm} reads:
{names}

--help-all explains every option and shows its default."""


def _option(argv: Sequence[str], name: str) -> str | None:
    """Return the value of an option; of a repeated one the last counts."""
    for i in range(len(argv) - 1, -1, -1):
        if argv[i] == name and i + 1 < len(argv):
            return argv[i + 1]
        if argv[i].startswith(name + "="):
            return argv[i].split("=", 1)[1]
    return None
