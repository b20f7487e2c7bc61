"""Gymnasium's own checks and wrappers, its autoreset modes, goals, and pictures."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from imageio_ffmpeg import count_frames_and_secs

import cdcsr  # noqa: F401 (registers the environments)
from cdcsr.envs.goal_env import GoalEnv, GoalVectorEnv
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.envs.single_env import TaskEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import shipped_robots
from cdcsr.simulation.cameras import HEIGHT, WIDTH
from cdcsr.simulation.contract import Array
from cdcsr.simulation.engines import backend_names
from cdcsr.tasks.catalogue import TASKS
from cdcsr.tasks.observation import CABLE_TRAVEL, TARGET, TIP_POSITION
from tests.support.engines import each_engine

ENVIRONMENTS = ("Reach", "Capture", "Follow", "ReachGoal")
engines = pytest.mark.parametrize("backend", each_engine())
FAR = [0.0, 1.0, 1.0]


def cases() -> list[Any]:
    """Return every environment, robot and engine; each robot has its fast turn in one engine for
    each environment."""
    found = []
    for (i, name), (j, robot), (k, backend) in itertools.product(
        enumerate(ENVIRONMENTS), enumerate(shipped_robots()), enumerate(backend_names())
    ):
        slow = [] if (i + j) % len(backend_names()) == k else [pytest.mark.slow]
        found.append(pytest.param(name, robot, backend, marks=slow))
    return found


@pytest.mark.parametrize(("name", "robot", "backend"), cases())
@pytest.mark.filterwarnings(
    "ignore:.*we recommend using a symmetric and normalized space:UserWarning"
)
@pytest.mark.filterwarnings("ignore:.*A Box observation space m.* value is -?infinity:UserWarning")
def test_gymnasium_finds_nothing_wrong(name: str, robot: str, backend: str) -> None:
    """Two recommendations are ignored: the paper's action space is [-eta, 0], and a free-floating
    robot has no bounds."""
    env = gymnasium.make(f"cdcsr/{name}-v0", robot=robot, backend=backend).unwrapped
    check_env(env, skip_render_check=True)


def test_every_kind_of_task_is_registered_with_its_first_task() -> None:
    first = {task.kind: name for name, task in reversed(TASKS.items())}
    registered = {
        spec.id: spec.kwargs["task"]
        for spec in gymnasium.registry.values()
        if spec.namespace == "cdcsr"
    }
    plain = {f"cdcsr/{kind.title()}-v0": name for kind, name in first.items()}
    assert registered == plain | {"cdcsr/ReachGoal-v0": "reach"}


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_every_environment_owns_its_spaces(name: str) -> None:
    """Seeding one space seeds no other."""
    many = gymnasium.make_vec(f"cdcsr/{name}-v0", num_envs=2)
    ones = [gymnasium.make(f"cdcsr/{name}-v0").unwrapped for _ in range(2)]
    spaces = [many.single_action_space, many.action_space]
    spaces += [many.single_observation_space, many.observation_space]
    for env in ones:
        spaces += [env.action_space, env.observation_space]
        assert isinstance(env, TaskEnv | GoalEnv)
        spaces += [env.batch.single_action_space, env.batch.single_observation_space]
    assert len({id(space) for space in spaces}) == len(spaces) == 12


class Planned:
    """A space that gives planned targets once, and then the same far one for ever."""

    name = "planned"

    def __init__(self, first: Array) -> None:
        self._first: Array | None = first

    def sample(self, rng: np.random.Generator, num: int) -> Array:
        targets, self._first = self._first, None
        return np.tile(FAR, (num, 1)) if targets is None else targets


def planned(env: gymnasium.Env | VectorEnv, first: Array) -> Any:
    """Give an environment its first targets, shape (num_envs, 3), and return it."""
    bare: Any = env.unwrapped
    (bare if isinstance(bare, TaskVectorEnv) else bare.batch).space = Planned(first)
    return env


def flat(observation: Any) -> Array:
    """Return observations as one array, whether they are dictionaries or not."""
    if isinstance(observation, dict):
        return np.concatenate([observation[name] for name in sorted(observation)], axis=-1)
    return observation


@engines
@pytest.mark.parametrize("name", ["Reach", "ReachGoal"])
@pytest.mark.parametrize("mode", AutoresetMode)
def test_episodes_follow_each_other_as_in_gymnasium(
    mode: AutoresetMode, name: str, backend: str
) -> None:
    """Gymnasium's own vector environment of single ones is the model, for 14 actions: copy 0
    succeeds at once, the others run out of time after four actions, and commands never rest."""
    first = np.array([[0, 0, 2.7], FAR, FAR])
    options: dict[str, Any] = {"backend": backend, "max_steps": 4}
    ours = planned(
        gymnasium.make_vec(f"cdcsr/{name}-v0", num_envs=3, autoreset_mode=mode, **options), first
    )
    makers = [
        lambda i=i: planned(gymnasium.make(f"cdcsr/{name}-v0", **options), first[i : i + 1])
        for i in range(3)
    ]
    theirs = SyncVectorEnv(makers, autoreset_mode=mode)
    assert ours.single_observation_space == theirs.single_observation_space
    mine, other = ours.reset(seed=0)[0], theirs.reset(seed=0)[0]
    ends = 0
    for action in np.random.default_rng(0).uniform(-5, 0, (14, 3, 8)):
        (mine, *outcome, info), (other, *expected, known) = ours.step(action), theirs.step(action)
        np.testing.assert_allclose(flat(mine), flat(other), rtol=0, atol=1e-9)
        np.testing.assert_array_equal(outcome, expected)
        done = outcome[1] | outcome[2]
        ends += done.sum()
        for key in ("is_success", "distance"):
            # In SAME_STEP these entries of ours are always of the step just made.
            model = known["final_info"][key] if "final_info" in known else known[key]
            model = np.where(done, model, known[key])
            np.testing.assert_allclose(info[key], model, rtol=0, atol=1e-9)
        assert ("final_obs" in info) == ("final_obs" in known)
        if "final_obs" in info:
            np.testing.assert_array_equal(info["_final_obs"], known["_final_obs"])
            last = np.array([flat(row) for row in known["final_obs"][done]])
            np.testing.assert_allclose(flat(info["final_obs"])[done], last, rtol=0, atol=1e-9)
        if mode is AutoresetMode.DISABLED and done.any():
            mine, _ = ours.reset(options={"reset_mask": done})
            other, _ = theirs.reset(options={"reset_mask": done})
            np.testing.assert_allclose(flat(mine), flat(other), rtol=0, atol=1e-9)
    assert ends == (9 if mode is AutoresetMode.NEXT_STEP else 10)
    ours.close()
    theirs.close()


def test_a_wasted_step_is_part_of_the_state() -> None:
    """An environment that goes on from a state begins the same new episodes."""
    first = TaskVectorEnv(2, max_steps=2, autoreset_mode="NextStep")
    second = TaskVectorEnv(2, max_steps=2, autoreset_mode="NextStep")
    action = np.full((2, 8), -5.0)
    first.reset(seed=0)
    assert first.step(action)[3].tolist() == [False, False]
    assert first.step(action)[3].tolist() == [True, True]
    second.set_state(first.get_state())
    for _ in range(3):
        np.testing.assert_array_equal(first.step(action)[0], second.step(action)[0])
    first.reset()  # a reset in between leaves nothing to begin
    assert (first.step(action)[0][:, CABLE_TRAVEL] < 0).any()
    first.close()
    second.close()


@engines
def test_a_goal_environment_is_reach_with_its_goals_apart(backend: str) -> None:
    plain = gymnasium.make_vec("cdcsr/Reach-v0", num_envs=3, backend=backend, reward="dense")
    goals = gymnasium.make_vec("cdcsr/ReachGoal-v0", num_envs=3, backend=backend, reward="dense")
    expected, _ = plain.reset(seed=4)
    found, _ = goals.reset(seed=4)
    assert isinstance(goals, GoalVectorEnv)
    for action in np.random.default_rng(0).uniform(-5, 0, (20, 3, 8)):
        assert found in goals.observation_space
        np.testing.assert_array_equal(found["achieved_goal"], expected[:, TIP_POSITION])
        np.testing.assert_array_equal(found["desired_goal"], expected[:, TARGET])
        rest = np.concatenate([expected[:, :6], expected[:, 10:]], axis=1)
        np.testing.assert_array_equal(found["observation"], rest)
        expected, reward, *_ = plain.step(action)
        found, same, *_ = goals.step(action)
        np.testing.assert_array_equal(reward, same)
        again = goals.compute_reward(found["achieved_goal"], found["desired_goal"], {})
        np.testing.assert_array_equal(again, reward)
    plain.close()
    goals.close()


@pytest.mark.parametrize(("reward", "away"), [("sparse", 0.0), ("dense", -0.04)])
def test_rewards_of_other_goals_come_in_any_number(reward: str, away: float) -> None:
    """The paper's robot succeeds within 30 mm; the shape is that of the goals without their last
    axis."""
    env = gymnasium.make("cdcsr/ReachGoal-v0", reward=reward).unwrapped
    assert isinstance(env, GoalEnv)
    achieved = np.tile([0.1, 0.2, 2.5], (2, 4, 1))
    desired = achieved + np.array([0.0, 0.0, 0.04])
    desired[1, 2] = achieved[1, 2]
    expected = np.full((2, 4), away)
    expected[1, 2] = 1.0
    found = env.compute_reward(achieved, desired, {})
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert env.compute_reward(achieved[1, 2], desired[1, 2], {}) == pytest.approx(1.0)
    with pytest.raises(CdcsrError, match=r"desired_goal must have the shape \(2, 4, 3\)"):
        env.compute_reward(achieved, desired[0], {})
    env.close()


@pytest.mark.parametrize("options", [{"task": "capture"}, {"quiet": True}, {"task": "follow-line"}])
def test_goals_are_only_for_what_the_tip_position_decides(options: dict[str, Any]) -> None:
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(CdcsrError, match="does not decide the task"):
            make("cdcsr/ReachGoal-v0", **options)


def test_both_render_modes_show_the_robot_and_the_target(monkeypatch: pytest.MonkeyPatch) -> None:
    """The window is read back; without a display SDL's dummy driver holds it."""
    pygame = pytest.importorskip("pygame", reason="windows need the extra `render`")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    options: dict[str, Any] = {"backend": "pybullet", "camera": "front"}
    window = gymnasium.make("cdcsr/ReachGoal-v0", render_mode="human", **options)
    drawn = gymnasium.make("cdcsr/Reach-v0", render_mode="rgb_array", **options)
    for env in (window, drawn):
        env.reset(seed=0)
        env.step(np.full(8, -1.0))
    assert window.render() is None
    picture = drawn.render()
    assert isinstance(picture, np.ndarray)
    assert picture.shape == (HEIGHT, WIDTH, 3)
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    np.testing.assert_array_equal(shown, picture)
    bare: Any = drawn.unwrapped
    target, simulation = bare.batch.targets[0], bare.batch.simulation
    np.testing.assert_array_equal(picture, simulation.render(0, "front", target))
    assert (picture != simulation.render(0, "front")).any()
    assert (picture != simulation.render(0, "side", target)).any()
    for env in (window, window, drawn):  # to close twice does nothing
        env.close()


def test_mistakes_of_rendering_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CdcsrError, match=r"Unknown camera 'sid'\. Did you mean 'side'"):
        TaskEnv(camera="sid")
    with pytest.raises(CdcsrError, match="Unknown render_mode 'rgb'"):
        TaskEnv("rgb")
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(CdcsrError, match=r"needs pygame, .* pip install 'cdcsr\[render\]'"):
        TaskEnv("human")


# moviepy warns of its own syntax when Python first compiles it.
@pytest.mark.filterwarnings("ignore:invalid escape sequence")
@pytest.mark.filterwarnings("ignore::SyntaxWarning")
def test_gymnasium_records_a_video(tmp_path: Path) -> None:
    pytest.importorskip("moviepy", reason="RecordVideo needs the extra `render`")
    env = gymnasium.make("cdcsr/Reach-v0", render_mode="rgb_array", backend="pybullet")
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "videos"))
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(8))
    env.close()
    (file,) = (tmp_path / "videos").glob("*.mp4")
    assert count_frames_and_secs(file)[0] == 4
