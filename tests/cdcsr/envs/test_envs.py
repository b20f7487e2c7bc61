"""The Gymnasium environments: episodes with known outcomes."""

from __future__ import annotations

from collections.abc import Iterator
from inspect import signature
from typing import get_type_hints

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers.vector import DictInfoToList

from cdcsr.envs.disturbances import Disturbances
from cdcsr.envs.gym_env import Info, TaskVectorEnv
from cdcsr.envs.options import EnvOptions
from cdcsr.envs.single_env import TaskEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.simulation.contract import Array
from cdcsr.simulation.engines import backend_names
from cdcsr.tasks.observation import BASE_POSITION, CABLE_TRAVEL, DISTANCE, TARGET, observation_size

both = pytest.mark.parametrize("backend", backend_names())
TIP = [0.0, 0.0, 2.7]
"""The tip of the paper's robot when it is straight, in [m]."""
IDLE = np.zeros(8)


@pytest.fixture
def vector() -> Iterator[VectorEnv]:
    env = gymnasium.make_vec("cdcsr/Reach-v0", num_envs=5, max_steps=6)
    yield env
    env.close()


def tolerance(backend: str) -> float:
    """Return how far two runs of the same commands may differ; MuJoCo repeats itself to the bit."""
    return 0.0 if backend == "mujoco" else 1e-9


def test_both_environments_have_the_same_keyword_arguments() -> None:
    """EnvOptions describes those of both."""
    own = {"self", "num_envs", "autoreset_mode"}
    assert (
        set(get_type_hints(EnvOptions)) == set(signature(TaskVectorEnv.__init__).parameters) - own
    )


def test_spaces_are_those_of_the_paper() -> None:
    env = gymnasium.make("cdcsr/Reach-v0")
    assert env.action_space == gymnasium.spaces.Box(-5.0, 0.0, (8,), np.float64)
    seen = (observation_size(load_robot("paper")),)
    assert env.observation_space == gymnasium.spaces.Box(-np.inf, np.inf, seen, np.float64)
    env.close()


@both
def test_the_same_seed_gives_the_same_episodes(backend: str) -> None:
    def run(seed: int) -> Array:
        env = gymnasium.make("cdcsr/Reach-v0", backend=backend, space="spatter", max_steps=40)
        rows = []
        for episode in range(2):
            observation, _ = env.reset(seed=seed if episode == 0 else None)
            env.action_space.seed(3)
            rows.append(observation)
            rows += [env.step(env.action_space.sample())[0] for _ in range(40)]
        env.close()
        return np.array(rows)

    first = run(5)
    np.testing.assert_allclose(run(5), first, rtol=0, atol=tolerance(backend))
    assert (first[0, TARGET] != first[41, TARGET]).all()  # the second episode has another target
    assert (first[0, TARGET] != run(6)[0, TARGET]).all()


@both
@pytest.mark.parametrize(
    ("reward", "success", "failure"), [("sparse", 1.0, 0.0), ("dense", 1 - 0.0299, -0.0301)]
)
def test_success_is_within_the_threshold_of_the_tip(
    backend: str, reward: str, success: float, failure: float
) -> None:
    """An idle tip stays in place: 0.0299 m from the target is a success, 0.0301 m is not."""
    env = gymnasium.make("cdcsr/Reach-v0", backend=backend, reward=reward)
    _, info = env.reset(options={"target": [0.0299, 0, 2.7]})
    assert info == {"is_success": True, "distance": pytest.approx(0.0299)}
    observation, given, terminated, truncated, info = env.step(IDLE)
    assert (terminated, truncated) == (True, False)
    assert given == pytest.approx(success)
    assert info == {"is_success": True, "distance": pytest.approx(0.0299)}
    np.testing.assert_allclose(observation[:10], [*TIP, 0, 0, 0, 0.0299, 0, 2.7, 0.0299], atol=1e-9)
    _, info = env.reset(options={"target": [0, 0.0301, 2.7]})
    _, given, terminated, truncated, info = env.step(IDLE)
    assert (terminated, truncated) == (False, False)
    assert given == pytest.approx(failure)
    assert info == {"is_success": False, "distance": pytest.approx(0.0301)}
    env.close()


@pytest.mark.parametrize(("frame_skip", "actions"), [(1, 250), (3, 83), (20, 12), (250, 1)])
def test_an_episode_lasts_250_simulation_steps(frame_skip: int, actions: int) -> None:
    """Steps that do not fill a whole action are left out: 3 x 83 = 249."""
    env = gymnasium.make("cdcsr/Reach-v0", frame_skip=frame_skip)
    env.reset(options={"target": [0, 1, 1]})
    ends = [env.step(IDLE)[2:4] for _ in range(actions)]
    assert ends == [(False, False)] * (actions - 1) + [(False, True)]
    assert isinstance(env.unwrapped, TaskEnv)
    time = env.unwrapped.batch.simulation.state().time[0]
    assert time == pytest.approx(actions * frame_skip * 0.0025)
    env.reset()
    assert env.step(IDLE)[3] == (actions == 1)  # the count starts again
    env.close()


def test_success_with_the_last_action_is_no_truncation() -> None:
    env = gymnasium.make("cdcsr/Reach-v0", max_steps=1)
    env.reset(options={"target": TIP})
    assert env.step(IDLE)[2:4] == (True, False)
    env.close()


def test_actions_beyond_the_bounds_are_clipped() -> None:
    rows = []
    for action in ([-9, 2, 0, 0, -9, 0, 0, 0], [-5, 0, 0, 0, -5, 0, 0, 0]):
        env = gymnasium.make("cdcsr/Reach-v0")
        env.reset(seed=0)
        rows.append([env.step(np.array(action, dtype=float))[0] for _ in range(20)])
        env.close()
    np.testing.assert_array_equal(rows[0], rows[1])
    assert rows[0][-1][CABLE_TRAVEL.start] < -1e-3  # and something was pulled


def test_centers_and_threshold_reach_space_and_task() -> None:
    env = TaskVectorEnv(20, space="floating", centers=np.array([TIP]), threshold=0.005)
    observation, info = env.reset(seed=0)
    distance = np.linalg.norm(observation[:, TARGET] - TIP, axis=1)
    assert distance.max() <= 0.01
    np.testing.assert_array_equal(info["is_success"], distance <= 0.005)
    assert 0 < info["is_success"].sum() < 20
    env.close()


def test_vector_spaces_are_batches(vector: VectorEnv) -> None:
    assert vector.num_envs == 5
    assert vector.action_space.shape == (5, 8)
    assert vector.observation_space.shape == (5, observation_size(load_robot("paper")))
    assert vector.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, info = vector.reset(seed=1)
    assert observation in vector.observation_space
    vector.action_space.seed(0)
    observation, reward, terminated, truncated, info = vector.step(vector.action_space.sample())
    assert observation in vector.observation_space
    assert [a.dtype for a in (reward, terminated, truncated)] == [np.float64, np.bool_, np.bool_]
    assert [a.shape for a in (reward, terminated, truncated, info["distance"])] == [(5,)] * 4


@both
@pytest.mark.parametrize("frame_skip", [1, 3])
def test_each_copy_is_a_single_env(backend: str, frame_skip: int) -> None:
    rng = np.random.default_rng(0)
    targets = rng.uniform([0.0, 0.0, 2.3], [0.3, 0.3, 2.6], (5, 3))
    actions = rng.uniform(-5, 0, (30, 5, 8))
    kwargs: EnvOptions = {"backend": backend, "frame_skip": frame_skip, "reward": "dense"}
    many = gymnasium.make_vec("cdcsr/Reach-v0", num_envs=5, **kwargs)
    observation, info = many.reset(options={"targets": targets})
    together = [(observation, info), *((r[0], r[1], r[4]) for r in map(many.step, actions))]
    many.close()
    one = gymnasium.make("cdcsr/Reach-v0", **kwargs)
    for i in range(5):
        observation, info = one.reset(options={"target": targets[i]})
        alone = [(observation, info), *((r[0], r[1], r[4]) for r in map(one.step, actions[:, i]))]
        for theirs, ours in zip(together, alone, strict=True):
            np.testing.assert_allclose(ours[0], theirs[0][i], rtol=0, atol=tolerance(backend))
            assert ours[-1]["distance"] == pytest.approx(theirs[-1]["distance"][i], abs=1e-9)
            assert len(ours) == 2 or ours[1] == pytest.approx(theirs[1][i], abs=1e-9)
    one.close()


def test_the_next_episode_begins_in_the_step_that_ends_one(vector: VectorEnv) -> None:
    """Copy 3 succeeds at once. The others run out of time in their sixth step, copy 3 one later."""
    far = [0.0, 1.0, 1.0]
    targets = np.array([far, far, far, TIP, far])
    vector.reset(seed=0, options={"targets": targets})
    idle = np.zeros((5, 8))
    third = np.array([False, False, False, True, False])

    observation, reward, terminated, truncated, info = vector.step(idle)
    np.testing.assert_array_equal(terminated, third)
    assert not truncated.any()
    np.testing.assert_array_equal(reward, third)
    np.testing.assert_array_equal(info["is_success"], third)
    np.testing.assert_array_equal(info["_final_obs"], third)
    np.testing.assert_array_equal(info["_final_info"], third)
    np.testing.assert_array_equal(info["final_obs"][3, TARGET], TIP)
    assert info["final_info"]["is_success"][3]
    assert info["final_info"]["distance"][3] == pytest.approx(0, abs=1e-9)
    np.testing.assert_array_equal(observation[~third, TARGET], targets[~third])
    assert observation[3, DISTANCE] > 0.1  # a new target, in the Anchor Space

    for _ in range(4):
        observation, _, terminated, truncated, info = vector.step(idle)
        assert not (terminated | truncated).any()
        assert "final_obs" not in info
    pull = np.tile([-5.0, 0, 0, 0, 0, 0, 0, 0], (5, 1))
    observation, reward, terminated, truncated, info = vector.step(pull)
    np.testing.assert_array_equal(truncated, ~third)
    assert not terminated.any()
    np.testing.assert_array_equal(info["_final_obs"], ~third)
    np.testing.assert_array_equal(info["_final_info"], ~third)
    assert (info["final_obs"][:, CABLE_TRAVEL.start] < 0).all()  # where the pulled slider was
    np.testing.assert_array_equal(observation[:, CABLE_TRAVEL.start] < 0, third)
    _, _, _, truncated, info = vector.step(idle)
    np.testing.assert_array_equal(truncated, third)
    assert (
        info["final_obs"][3, CABLE_TRAVEL.start] < 0
    )  # the end of the other episodes did not move this copy


def test_gymnasium_can_split_the_info_by_robot(vector: VectorEnv) -> None:
    lists = DictInfoToList(vector)
    _, infos = lists.reset(options={"targets": np.array([TIP] + [[0, 1, 1]] * 4)})
    assert [info["is_success"] for info in infos] == [True] + [False] * 4
    infos = lists.step(np.zeros((5, 8)))[4]
    assert set(infos[0]) == {"is_success", "distance", "final_obs", "final_info"}
    assert infos[0]["final_info"]["is_success"]
    assert all(set(info) == {"is_success", "distance"} for info in infos[1:])


def test_without_autoreset_episodes_go_on_until_they_are_reset() -> None:
    env = gymnasium.make_vec("cdcsr/Reach-v0", num_envs=3, autoreset_mode="Disabled", max_steps=2)
    assert env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    env.reset(options={"targets": np.array([[0, 1, 1]] * 3)})
    pull = np.zeros((3, 8))
    pull[:, 0] = -5
    env.step(pull)
    before, _, _, truncated, info = env.step(pull)
    assert truncated.all()
    assert "final_obs" not in info
    mask = np.array([False, True, False])
    after, info = env.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(after[~mask], before[~mask])
    assert (after[1, CABLE_TRAVEL] == 0).all()
    assert after[1, TARGET].tolist() != [0, 1, 1]
    np.testing.assert_allclose(info["distance"], after[:, DISTANCE])
    after, _, _, truncated, _ = env.step(pull)
    np.testing.assert_array_equal(truncated, ~mask)
    assert (
        after[~mask, CABLE_TRAVEL.start] < after[mask, CABLE_TRAVEL.start]
    ).all()  # the others were pulled for three steps
    env.close()


def test_disturbances_act_between_policy_and_robot() -> None:
    """If no observation arrives, the first one stays; noise moves the robots differently."""
    env = TaskVectorEnv(2, disturbances=Disturbances(action_noise=0.5, packet_loss=1.0))
    first, _ = env.reset(seed=0)
    last = first
    for _ in range(5):
        last = env.step(np.full((2, 8), -2.5))[0]
    np.testing.assert_array_equal(last, first)
    travel = env.simulation.state().cable_travel
    assert (travel != 0).all()
    assert (travel[0] != travel[1]).all()
    env.close()


def test_the_seed_determines_the_disturbances_too() -> None:
    env = TaskVectorEnv(
        3, disturbances=Disturbances(action_noise=0.5, base_noise=0.1, packet_loss=0.3)
    )
    runs = []
    for seed in (4, 4, 5):
        first, _ = env.reset(seed=seed)
        runs.append([first, *(env.step(np.full((3, 8), -1.0))[0] for _ in range(10))])
    env.close()
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0][0][:, BASE_POSITION] != runs[2][0][:, BASE_POSITION]).all()


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"backend": "mujco"}, "Unknown backend 'mujco'. Did you mean 'mujoco'?"),
        ({"space": "anker"}, "Unknown space 'anker'."),
        ({"robot": "papre"}, "Unknown robot 'papre'. Did you mean 'paper'?"),
        ({"reward": "shaped"}, "reward must be 'sparse' or 'dense', not 'shaped'."),
        ({"frame_skip": 0}, r"frame_skip must be a whole number from 1 to 10000000, not 0"),
        (
            {"frame_skip": 9, "max_steps": 8},
            r"frame_skip must be a whole number from 1 to 8, not 9.",
        ),
        ({"autoreset_mode": "NextStp"}, "autoreset_mode 'NextStp'. Did you mean 'NextStep'?"),
        ({"num_envs": 0}, "num_envs must be a whole number from 1 to 100000, not 0"),
    ],
)
def test_wrong_arguments_are_errors(kwargs: Info, message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        gymnasium.make_vec("cdcsr/Reach-v0", **kwargs)


def test_wrong_reset_options_are_errors(vector: VectorEnv) -> None:
    with pytest.raises(CdcsrError, match=r"Unknown reset option 'target'\. Did you mean 'targets'"):
        vector.reset(options={"target": np.array(TIP)})
    with pytest.raises(CdcsrError, match=r"'targets' must have the shape \(5, 3\), not \(3,\)"):
        vector.reset(options={"targets": TIP})
    with pytest.raises(CdcsrError, match=r"'reset_mask' must have the shape \(5,\), not \(2,\)"):
        vector.reset(options={"reset_mask": [True, False]})
    one = gymnasium.make("cdcsr/Reach-v0")
    with pytest.raises(CdcsrError, match=r"Unknown reset option 'targets'\. Did you mean 'target'"):
        one.reset(options={"targets": [TIP]})
    one.close()
