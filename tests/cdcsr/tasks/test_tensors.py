"""Tasks judge, observe and move PyTorch's tensors as they do NumPy's arrays."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import torch

from cdcsr.robot.description import load_robot
from cdcsr.simulation.state import State
from cdcsr.tasks.catalogue import TASKS, make_task
from cdcsr.tasks.observation import observe, tip_distance
from cdcsr.tasks.target_motion import MOTIONS, make_motion

COPIES = 40


def _tensor(array: Any) -> Any:
    return torch.from_numpy(np.array(array))


def _states(rng: np.random.Generator, targets: Any) -> State:
    """Return robots of which many are on target, slow and with a quiet base."""
    robot = load_robot("paper")
    quaternion = np.array([1.0, 0, 0, 0]) + 0.02 * rng.normal(size=(COPIES, 4))
    numbers = {
        "time": (COPIES,),
        "base_angular_velocity": (COPIES, 3),
        "joint_angles": (COPIES, robot.num_hinges),
        "joint_rates": (COPIES, robot.num_hinges),
        **dict.fromkeys(("cable_travel", "cable_tension"), (COPIES, robot.num_cables)),
    }
    return State(
        tip_position=targets + 0.015 * rng.normal(size=(COPIES, 3)),
        tip_velocity=0.04 * rng.normal(size=(COPIES, 3)),
        base_position=0.001 * rng.normal(size=(COPIES, 3)),
        base_velocity=rng.normal(size=(COPIES, 3)),
        base_quaternion=quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        **{name: rng.normal(size=shape) for name, shape in numbers.items()},
    )


@pytest.mark.parametrize("reward", ["sparse", "dense"])
@pytest.mark.parametrize("name", TASKS)
def test_verdicts_and_rewards(name: str, reward: str) -> None:
    rng = np.random.default_rng(0)
    quick: dict[str, Any] = {"settling": 0.01} if name.startswith("follow") else {}
    quick |= {"dwell": 0.01} if name.startswith("capture") else {}
    task = make_task(name, reward_kind=reward, **quick)
    counts = task.new_counts(COPIES)
    tensors: Any = {key: _tensor(count) for key, count in counts.items()}
    seen = []
    targets, state = rng.normal(size=(COPIES, 3)), None
    for action in range(12):
        if state is None or action % 6 == 0:  # so that some stay on target
            state = _states(rng, targets)
        theirs: Any = State(**{f.name: _tensor(getattr(state, f.name)) for f in fields(State)})
        still, distance = np.zeros((COPIES, 3)), tip_distance(state, targets)
        ours = task.judge(state, still, distance, counts)
        apart: Any = tip_distance(theirs, _tensor(targets))
        verdict: Any = task.judge(theirs, _tensor(still), apart, tensors)
        for one, other in zip(ours, verdict, strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_allclose(
            task.reward(distance, ours.rewarded), task.reward(apart, verdict.rewarded), atol=1e-12
        )
        np.testing.assert_allclose(
            observe(state, targets), np.asarray(observe(theirs, _tensor(targets))), atol=1e-12
        )
        seen.append(ours.success)
    assert 0 < np.mean(seen) < 1


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1e-12), (np.float32, 1e-5)])
def test_targets_move_alike(name: str, kind: type[np.floating[Any]], tolerance: float) -> None:
    rng, motion = np.random.default_rng(1), make_motion(name)
    position = 0.3 * rng.normal(size=(COPIES, 3))
    velocity, memory = motion.begin(rng, position)
    memory[:1, 3:6] = 0  # one tumbles at no rate
    tensors: list[Any] = [_tensor(rows.astype(kind)) for rows in (position, velocity, memory)]
    start = position.copy()
    for _ in range(200):
        motion.advance(position, velocity, memory, 0.0025)
        motion.advance(tensors[0], tensors[1], tensors[2], 0.0025)
    for ours, theirs in zip((position, velocity, memory), tensors, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=tolerance)
    assert name == "rest" or np.abs(position - start).max() > 0.01
