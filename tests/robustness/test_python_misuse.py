"""Wrong arguments and a wrong order of calls end in an error of ours, and change nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.envs.single_env import TaskEnv
from cdcsr.errors import CdcsrError
from cdcsr.files import read_json, refuse_unwritable, write_text
from cdcsr.folders import new_folder
from cdcsr.robot.description import load_robot
from cdcsr.simulation.contract import Simulation
from cdcsr.simulation.engines import backend_names, make_simulation
from cdcsr.simulation.plant import Parameters
from cdcsr.tasks.spaces import make_space
from cdcsr.tasks.workspace_map import load_workspace
from controllers.demonstrations import load
from controllers.stable_baselines import StableBaselines
from training.policy import find_policy, load_policy
from training.study.store import read_results

NUM = 3
ROBOT = load_robot("planar-single")
CABLES = ROBOT.num_cables
Misuse = tuple[str, Callable[[Any], object]]

BAD_IDS: list[object] = [
    *(0.0, [0.5], [1.0, 2.0], ["0"], [None], "all", {0}),
    *([True, False], [[True, False, True]], [[0, 1]], np.eye(3, dtype=bool)),
    *([-1], [0, 3], [2, 1], [1, 1], [0, 10**30], [0, 1, 2, 3], 1, np.int64(0), True),
]
WRONG_NUMBERS: list[Any] = [
    *(np.nan, np.inf, -1.0, "heavy", None, 1j, np.ones(2), np.ones((NUM, 99))),
]


def bad_arrays(shape: tuple[int, ...]) -> Iterator[object]:
    """Yield what is no finite array of numbers of that shape."""
    good = np.full(shape, -0.01)
    yield from (None, "x", -0.01, [], [[]], {}, object(), [[0.0], [0.0, 1.0]])
    for other in (shape[1:], (1, *shape), (*shape, 1), shape[:-1], (shape[0] + 1, *shape[1:])):
        if other != shape:
            yield np.zeros(other)
    if len(shape) > 1:
        yield from (np.zeros((1, shape[1])), np.zeros((shape[0], 1)))
    for dtype in (complex, str, object, bool):
        yield good.astype(dtype)
    for bad in (np.nan, np.inf, -np.inf):
        spoilt = good.copy()
        spoilt.flat[-1] = bad
        yield from (spoilt, spoilt.astype(np.float32), spoilt.tolist())


def simulation_misuses() -> Iterator[Misuse]:
    """Yield wrong calls of a simulation of three copies."""
    for ids in BAD_IDS:
        yield f"reset({ids!r})", lambda sim, ids=ids: sim.reset(ids)
        yield f"dynamics({ids!r})", lambda sim, ids=ids: sim.dynamics(ids)
        yield (
            f"set_parameters({ids!r})",
            lambda sim, ids=ids: sim.set_parameters(ids, Parameters(base_mass=2.0)),
        )
    huge = [np.full((NUM, CABLES), size) for size in (1e10, -1e11, 1e300)]
    for array in [*bad_arrays((NUM, CABLES)), *huge]:
        yield f"step({array!r})", lambda sim, array=array: sim.step(array)
    command = np.zeros((NUM, CABLES))
    for substeps in (0, -1, 1.0, 1.5, True, None, "2", 10**12, np.float64(1)):
        yield f"substeps={substeps!r}", lambda sim, s=substeps: sim.step(command, s)
    for name in ("position", "velocity", "private"):
        yield (
            f"snapshot.{name}",
            lambda sim, name=name: sim.set_snapshot(
                replace(sim.get_snapshot(), **{name: getattr(sim.get_snapshot(), name)[:, :-1]})
            ),
        )
    yield (
        "snapshot.private, longer",
        lambda sim: sim.set_snapshot(
            replace(
                sim.get_snapshot(),
                private=np.concatenate([sim.get_snapshot().private, np.zeros((NUM, 1))], axis=1),
            )
        ),
    )
    yield (
        "snapshot of two",
        lambda sim: sim.set_snapshot(make_simulation(ROBOT, sim.engine, 2).get_snapshot()),
    )
    yield (
        "snapshot of another",
        lambda sim: sim.set_snapshot(
            make_simulation(load_robot("three-cable"), sim.engine, NUM).get_snapshot()
        ),
    )
    for index in (-1, NUM, 0.0, "0", True, None):
        yield f"render({index!r})", lambda sim, index=index: sim.render(index)
    for camera in ("inside", "", None, 3):
        yield f"render(0, {camera!r})", lambda sim, camera=camera: sim.render(0, camera)
    for name in Parameters.__dataclass_fields__:
        for value in WRONG_NUMBERS:
            yield (
                f"{name}={value!r}",
                lambda sim, name=name, value=value: sim.set_parameters(
                    None, Parameters(**{name: value})
                ),
            )


def env_misuses() -> Iterator[Misuse]:
    """Yield wrong calls of a vector environment of three copies."""
    for array in bad_arrays((NUM, CABLES)):
        yield f"step({array!r})", lambda env, array=array: env.step(array)
    for array in bad_arrays((NUM, 3)):
        yield (
            f"targets={array!r}",
            lambda env, array=array: env.reset(options={"targets": array}),
        )
    for mask in (*BAD_IDS, [0, 1, 2], [0.5, 1, 0], [np.nan, 0, 1], None):
        yield f"mask={mask!r}", lambda env, m=mask: env.reset(options={"reset_mask": m})
    for seed in (-1, 1.5, "1", True, 2**64, np.nan, [1]):
        yield f"seed={seed!r}", lambda env, seed=seed: env.reset(seed=seed)
    yield "options", lambda env: env.reset(options={"mask": 1})


def constructor_misuses() -> Iterator[Misuse]:
    """Yield wrong arguments of an environment's constructor."""
    wrong: dict[str, list[Any]] = {
        "num_envs": [0, -1, 1.5, "2", True, 10**12, None],
        "robot": ["nobody", "", "x" * 400, "../paper", "no/such.toml", "a\0b.toml"],
        "backend": ["bullet", "", "mujoco:", "mujoco:x=1", "m" * 5000],
        "space": ["moon", "", "no.npz", "x" * 400 + ".npz"],
        "frame_skip": [0, -1, 1.5, 251, True, "1"],
        "max_steps": [0, -3, 1.5, 10**12, "9"],
        "threshold": [0.0, -1.0, np.nan, np.inf],
        "centers": [np.zeros(3), np.zeros((2, 2)), np.full((2, 3), np.nan), "here", []],
        "task": ["fly", ""],
        "motion": ["jump"],
        "reward": ["rich"],
        "autoreset_mode": ["AnyStep"],
    }
    for name, values in wrong.items():
        for value in values:
            options: dict[str, Any] = {"robot": ROBOT, name: value}
            if name == "centers":
                options["space"] = "spatter"
            yield f"{name}={value!r}", lambda _, options=options: TaskVectorEnv(**options)


def refused(misuses: Iterator[Misuse], subject: object) -> int:
    """Check that each call raises an error of ours; return how many there were."""
    calls = list(misuses)
    for what, call in calls:
        try:
            call(subject)
        except CdcsrError as error:
            message = str(error)
        except Exception as error:
            pytest.fail(f"{what[:200]} ends in {type(error).__name__}: {str(error)[:200]}")
        else:
            pytest.fail(f"{what[:200]} is accepted")
        assert len(message) < 2000, what[:200]
    print(f"{type(subject).__name__}: {len(calls)} wrong calls refused")
    return len(calls)


@pytest.fixture(params=backend_names())
def simulation(request: pytest.FixtureRequest) -> Iterator[Simulation]:
    made = make_simulation(ROBOT, request.param, NUM)
    yield made
    made.close()


def test_a_simulation_refuses_wrong_calls(simulation: Simulation) -> None:
    simulation.step(np.full((NUM, CABLES), -0.02), 3)
    before = simulation.get_snapshot()
    assert refused(simulation_misuses(), simulation) >= 180
    after = simulation.get_snapshot()
    np.testing.assert_array_equal(before.position, after.position)
    np.testing.assert_array_equal(before.velocity, after.velocity)


@pytest.mark.parametrize("engine", backend_names())
def test_an_environment_refuses_wrong_calls(engine: str) -> None:
    env = TaskVectorEnv(NUM, ROBOT, engine)
    with pytest.raises(CdcsrError, match=r"Call reset\(\) before the first step\(\)\."):
        env.step(np.zeros((NUM, CABLES)))
    with pytest.raises(CdcsrError, match="The first reset begins all episodes"):
        env.reset(options={"reset_mask": [True, False, True]})
    env.reset(seed=1)
    assert refused(env_misuses(), env) >= 70
    env.close()


def test_a_constructor_refuses_wrong_arguments() -> None:
    assert refused(constructor_misuses(), None) >= 40


@pytest.mark.parametrize(
    "path", ["x" * 256, "a\0b", "loop", "nothing", "/y" * 3000, "x" * 300 + ".npz", "/dev/zero"]
)
def test_what_can_be_no_path_is_one_line(
    path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    fitting, place = ROBOT.fingerprint, Path(path)
    reading: list[Callable[[], object]] = [
        *(lambda: find_policy(path), lambda: load_policy(place), lambda: load_robot(path)),
        *(lambda: StableBaselines(path), lambda: load(place, fitting, 1)),
        *(lambda: read_results(place), lambda: load_workspace(ROBOT, place)),
        *(lambda: read_json(place), lambda: make_space(path, ROBOT)),
    ]
    writing = [
        *(lambda: write_text(place / "a", ""), lambda: refuse_unwritable(place / "a")),
        *(lambda: ExitStack().enter_context(new_folder(place / "a", "a thing", False)),),
    ]
    for call in reading + (writing if path != "nothing" else []):
        with pytest.raises(CdcsrError):
            call()
    assert [each.name for each in tmp_path.iterdir()] == ["loop"]


def test_one_robots_actions_have_the_shape_of_its_cables() -> None:
    env = TaskEnv(robot=ROBOT)
    env.reset(seed=1)
    for action in (np.zeros(1), np.zeros((1, CABLES)), 0.0, np.full(CABLES, np.nan)):
        with pytest.raises(CdcsrError, match="action must"):
            env.step(np.asarray(action))
    env.close()


def test_a_mask_means_the_copies_that_it_marks(simulation: Simulation) -> None:
    simulation.step(np.full((NUM, CABLES), -0.02), 3)
    simulation.reset(np.array([False, False, True]))
    assert simulation.state().time.tolist() == [3 * ROBOT.time_step, 3 * ROBOT.time_step, 0.0]


def test_other_types_of_the_same_numbers_are_right(simulation: Simulation) -> None:
    command = np.full((NUM, CABLES), -0.25)
    start = simulation.get_snapshot()
    simulation.step(command, 5)
    expected = simulation.state().tip_position
    others: list[Any] = [command.tolist(), command.astype(np.float32), np.asfortranarray(command)]
    for same in others:
        simulation.set_snapshot(start)
        simulation.step(same, 5)
        np.testing.assert_allclose(simulation.state().tip_position, expected, atol=1e-9)
