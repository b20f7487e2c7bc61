"""`cdcsr export`: write a policy as one file that other programs run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from training.policy import Policy

_STATES, _TOLERANCE = 10_000, 1e-6
"""On how many observations the file is compared with the policy, and how far its commands may be
from the policy's, in [m]; of more than 1 m, as a share of the largest pull."""


def export(
    policy: str,
    /,
    *,
    format: str = "onnx",
    dtype: str = "float32",
    out: Path | None = None,
    force: bool = False,
) -> None:
    """Write a policy as one ONNX file, which runs without this package.

    The file maps observations, shape (num, size), to set-points of the cables, shape (num, cables),
    in m. Scaling, mirror symmetry and servo travel are inside. Its metadata hold the layout and the
    units of the observation, the bounds of the commands, the control rate and the robot.
    examples/onnx_loop.py runs it. Needs the extra: pip install 'cdcsr[onnx]'.

    Args:
        policy: the folder of a policy or a run, or the name of a shipped policy.
        format: onnx; there is no other one yet.
        dtype: float32 or float64, the type of observations and commands; the network in between
            computes in float64.
        out: the file; by default the policy's name with the ending .onnx, in the current folder.
        force: replace a file that is there already.
    """
    from cdcsr.errors import CdcsrError, unknown_choice
    from cdcsr.files import refuse_taken, write_bytes
    from training.commands.measured import set_threads
    from training.policy import find_policy

    if format != "onnx":
        raise CdcsrError(unknown_choice("format", format, ["onnx"]))
    if dtype != "float32" and dtype != "float64":
        raise CdcsrError(unknown_choice("type", dtype, ["float32", "float64"]))
    found = find_policy(policy)
    path = Path(f"{Path(policy).resolve().name}.onnx") if out is None else out
    refuse_taken(path, force)
    try:
        from training.networks.onnx_file import (
            largest_difference,
            random_observations,
            to_onnx,
        )
    except ImportError as error:
        raise CdcsrError(f"The export needs {error.name}; run: pip install 'cdcsr[onnx]'") from None
    set_threads()
    data = to_onnx(found.actor, dtype, metadata(found))
    apart = largest_difference(found.actor, data, dtype, random_observations(found.actor, _STATES))
    if not apart <= _TOLERANCE * max(1.0, *(abs(servo.full) for servo in found.robot.servos)):
        raise CdcsrError(
            f"The file would not act as the policy {found.name!r}: its commands are up to "
            f"{apart:.1e} m apart; install the tested versions: "
            "pip install -c constraints.txt 'cdcsr[onnx]'."
        )
    refuse_taken(path, force)  # again, as the export took seconds
    write_bytes(path, data)
    print(
        f"{found.name} -> {path}, {len(data) / 1e3:.0f} kB; its commands on {_STATES:,} random "
        f"observations are within {apart:.1e} m of torch's"
    )


def metadata(policy: Policy) -> dict[str, str]:
    """Return what a user of the file must know: JSON texts by their names."""
    import json

    from cdcsr.tasks.observation import PARTS
    from training.policy import versions

    robot, layout, start = policy.robot, [], 0
    hold = int(policy.card["frame_skip"])
    for part in PARTS:
        width = part.width(robot.num_cables)
        layout.append({"name": part.name, "start": start, "width": width, "unit": part.unit})
        start += width
    known = {
        "policy": policy.name,
        "policy_digest": policy.digest,
        "robot": robot.name,
        "robot_fingerprint": robot.fingerprint,
        "observation": layout,
        "frame": "world; quaternions w-x-y-z",
        "command_low": robot.command_range[0].tolist(),
        "command_high": robot.command_range[1].tolist(),
        "command_unit": " ".join(dict.fromkeys(s.unit for s in robot.servos)),
        "control_rate_hz": 1 / (robot.time_step * hold),
        "versions": versions(),
    }
    return {name: json.dumps(value) for name, value in known.items()}
