"""The environments in stable-baselines3: its own checker, its own vector environment as the model,
and short runs of its learners."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import cdcsr  # noqa: F401 (registers the environments)
from cdcsr import cli
from cdcsr.errors import CdcsrError
from tests.cdcsr.envs.test_gymnasium import FAR, flat, planned

sb3 = pytest.importorskip("stable_baselines3", reason="needs stable-baselines3")
from stable_baselines3.common.env_checker import check_env  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv  # noqa: E402

from backends.sb3_env import BatchedVecEnv  # noqa: E402

SMALL: dict[str, Any] = {"robot": "planar-single", "max_steps": 20}


def batched(name: str, num: int = 3, **options: Any) -> BatchedVecEnv:
    return BatchedVecEnv(gymnasium.make_vec(f"cdcsr/{name}-v0", num_envs=num, **options))


@pytest.mark.filterwarnings("ignore:Your action space has dtype float64")
@pytest.mark.filterwarnings("ignore:We recommend you to use a symmetric and normalized Box action")
@pytest.mark.parametrize("name", ["Reach", "Capture", "Follow", "ReachGoal"])
def test_its_checker_finds_nothing_wrong(name: str) -> None:
    """Two recommendations are ignored: actions are of float64, in the paper's space [-eta, 0]."""
    env = gymnasium.make(f"cdcsr/{name}-v0", **SMALL).unwrapped
    check_env(env)
    env.close()


@pytest.mark.parametrize("name", ["Reach", "ReachGoal"])
def test_it_steps_as_its_own_vector_environment_does(name: str) -> None:
    """Copy 0 succeeds at once, the others run out of time after four actions."""
    first = np.array([[0, 0, 2.7], FAR, FAR])
    ours = batched(name, max_steps=4)
    planned(ours.env, first)
    theirs = DummyVecEnv(
        [
            lambda i=i: planned(gymnasium.make(f"cdcsr/{name}-v0", max_steps=4), first[i : i + 1])
            for i in range(3)
        ]
    )
    assert ours.observation_space == theirs.observation_space
    np.testing.assert_array_equal(flat(ours.reset()), flat(theirs.reset()))
    ended = 0
    for action in np.random.default_rng(0).uniform(-5, 0, (10, 3, 8)):
        (mine, *outcome, infos), (other, *expected, known) = ours.step(action), theirs.step(action)
        np.testing.assert_allclose(flat(mine), flat(other), rtol=0, atol=1e-9)
        for found, model in zip(outcome, expected, strict=True):
            assert found.dtype == model.dtype
            np.testing.assert_array_equal(found, model)
        for found, model in zip(infos, known, strict=True):
            assert found.keys() == model.keys()
            assert found["TimeLimit.truncated"] is model["TimeLimit.truncated"]
            assert found["is_success"] is model["is_success"]
            if "terminal_observation" in model:
                ended += 1
                last = flat(found["terminal_observation"]), flat(model["terminal_observation"])
                np.testing.assert_allclose(*last, rtol=0, atol=1e-9)
    assert ended == 3 + 2 * 2
    ours.close()
    theirs.close()


def test_seeds_options_and_pictures() -> None:
    env = batched("Reach", 2, **SMALL, backend="pybullet")
    env.seed(3)
    first = env.reset()
    env.seed(3)
    np.testing.assert_array_equal(flat(env.reset()), flat(first))
    assert (flat(env.reset()) != flat(first)).any()
    env.set_options({"target": (0.1, 0.0, 1.2)})
    env.reset()
    assert env.get_attr("targets")[0].tolist() == [[0.1, 0.0, 1.2]] * 2
    images = env.get_images()
    np.testing.assert_array_equal(images[0], images[1])
    env.close()


def test_other_environments_are_refused() -> None:
    with pytest.raises(CdcsrError, match="not SyncVectorEnv; make one with"):
        BatchedVecEnv(gymnasium.make_vec("cdcsr/Reach-v0", vectorization_mode="sync"))
    with pytest.raises(CdcsrError, match="needs autoreset_mode SAME_STEP"):
        batched("Reach", autoreset_mode="NextStep")


def test_td3_with_hindsight_learns_and_is_a_controller(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    env = batched("ReachGoal", **SMALL)
    model = sb3.TD3(
        "MultiInputPolicy",
        env,
        replay_buffer_class=sb3.HerReplayBuffer,
        learning_starts=70,
        batch_size=8,
        buffer_size=300,
        policy_kwargs={"net_arch": [8]},
        seed=0,
    )
    before = [weights.detach().clone() for weights in model.actor.parameters()]
    model.learn(90)
    moved = zip(before, model.actor.parameters(), strict=True)
    assert any((old != new).any() for old, new in moved)
    env.close()
    file = tmp_path / "hindsight.zip"
    model.save(file)
    few = ["--episodes", "1", "--space", "anchor", "--backend", "mujoco"]
    assert cli.main(["transfer", str(file), *few, "--robot", "planar-single"]) == 0
    assert "| hindsight " in capsys.readouterr().out
    assert cli.main(["evaluate", str(file), *few, "--robot", "three-segment"]) == 2
    assert "has observations and actions of shapes {'achieved_goal'" in capsys.readouterr().err


def test_sac_learns() -> None:
    env = batched("Reach", **SMALL, reward="dense")
    model = sb3.SAC("MlpPolicy", env, learning_starts=30, batch_size=8, buffer_size=300, seed=0)
    before = [weights.detach().clone() for weights in model.actor.parameters()]
    model.learn(45)
    moved = zip(before, model.actor.parameters(), strict=True)
    assert any((old != new).any() for old, new in moved)
    env.close()
