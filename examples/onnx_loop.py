"""Run an exported policy in your own control loop; needs numpy and onnxruntime, nothing else.

    cdcsr export clasp-anchor-mujoco && python examples/onnx_loop.py clasp-anchor-mujoco.onnx

Replace `measure` and `pull` by your robot. The file's metadata list the parts of the observation:
world frame, SI units, quaternions w-x-y-z.
"""

import json
import sys
import time

import numpy as np
import onnxruntime

options = onnxruntime.SessionOptions()
options.intra_op_num_threads = 1  # threads that wait for each other cost more than they save
session = onnxruntime.InferenceSession(sys.argv[1], options)
about = {k: json.loads(v) for k, v in session.get_modelmeta().custom_metadata_map.items()}
low, high, period = about["command_low"], about["command_high"], 1 / about["control_rate_hz"]
target = np.array([0.3, 0.2, 2.2])


def measure() -> dict[str, np.ndarray]:
    """Return each part of the observation; here of a robot that is straight and still."""
    tip = np.array([0.0, 0.0, 2.6])
    still = {part["name"]: np.zeros(part["width"]) for part in about["observation"]}
    known = {"tip_position": tip, "base_quaternion": np.array([1.0, 0.0, 0.0, 0.0])}
    distance = np.array([np.linalg.norm(target - tip)])
    return {**still, **known, "target": target, "distance": distance}


def pull(set_points: np.ndarray) -> None:
    """Send the set-points of the cables, in [m], to the servos; 0 does not pull."""


num, took, begun = round(2 / period), [], time.perf_counter()
for step in range(num):
    time.sleep(max(0.0, begun + step * period - time.perf_counter()))
    now, parts = time.perf_counter(), measure()
    row = np.concatenate([parts[part["name"]] for part in about["observation"]])
    (command,) = session.run(None, {"observation": row[None].astype(np.float32)})
    pull(np.clip(command[0], low, high))
    took.append(1e3 * (time.perf_counter() - now))
rate = num / (time.perf_counter() - begun)
print(f"{rate:.0f} commands/s; each took {np.median(took):.3f} ms, {max(took):.3f} ms at most")
