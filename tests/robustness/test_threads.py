"""Calls from several threads end as they do one after the other, or in an error of ours."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import fields
from functools import partial

import numpy as np
import pytest

from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.simulation.contract import Simulation
from cdcsr.simulation.engines import backend_names, make_simulation
from cdcsr.simulation.state import State

NUM = 3
ROBOT = load_robot("planar-single")
CABLES = ROBOT.num_cables


def together(*calls: Callable[[], object]) -> list[BaseException]:
    """Call functions at once, each in a thread of its own; return what they raised."""
    raised: list[BaseException] = []
    begin = threading.Barrier(len(calls))

    def call(function: Callable[[], object]) -> None:
        begin.wait()
        try:
            function()
        except BaseException as error:
            raised.append(error)

    threads = [threading.Thread(target=call, args=(one,), daemon=True) for one in calls]
    for one in threads:
        one.start()
    for one in threads:
        one.join(300)  # the first call may compile
    assert not any(one.is_alive() for one in threads), "a thread hangs"
    return raised


class Threads:
    """Calls from several threads, each compared with the same calls one after the other."""

    def __init__(self, engine: str, rng: np.random.Generator) -> None:
        self.engine, self.rng = engine, rng
        self.command = rng.uniform(-0.3, 0.0, (NUM, CABLES))
        self.steps = int(rng.integers(2, 12))

    def made(self) -> Simulation:
        return make_simulation(ROBOT, self.engine, NUM)

    def path(self, simulation: Simulation, steps: int) -> list[State]:
        """Return the states at the start and after each step."""
        states = [simulation.state()]
        for _ in range(steps):
            simulation.step(self.command)
            states.append(simulation.state())
        return states

    def two_step_one(self) -> None:
        one, other = self.made(), self.made()
        advance = partial(self.path, one, self.steps)
        assert together(advance, advance) == []
        same(one.state(), self.path(other, 2 * self.steps)[-1])
        one.close()
        other.close()

    def two_step_two(self) -> None:
        one, other, alone = self.made(), self.made(), self.made()
        other.step(self.command, 3)
        calls = partial(self.path, one, self.steps), partial(self.path, other, self.steps)
        assert together(*calls) == []
        states = self.path(alone, self.steps + 3)
        same(one.state(), states[self.steps])
        same(other.state(), states[self.steps + 3])
        for each in (one, other, alone):
            each.close()

    def one_closes(self) -> None:
        one, other = self.made(), self.made()
        stepping = partial(self.path, one, 40)
        assert all(isinstance(error, CdcsrError) for error in together(stepping, one.close))
        with pytest.raises(CdcsrError, match="is closed"):
            one.state()
        before = other.get_snapshot().position.copy()
        other.step(self.command)
        assert not np.array_equal(before, other.get_snapshot().position)
        other.close()

    def one_reads(self) -> None:
        one, other, seen = self.made(), self.made(), list[State]()

        def reading() -> None:
            for _ in range(self.steps):
                seen.append(one.state())
                one.dynamics([1])

        assert together(partial(self.path, one, self.steps), reading) == []
        states = {round(state.time[0] / ROBOT.time_step): state for state in self.path(other, 12)}
        for state in seen:
            same(state, states[round(state.time[0] / ROBOT.time_step)])
        one.close()
        other.close()

    def one_resets(self) -> None:
        one, other, seen = self.made(), self.made(), list[State]()

        def resetting() -> None:
            for _ in range(self.steps):
                one.reset([0, 2])
                seen.append(one.state())

        assert together(partial(self.path, one, self.steps), resetting) == []
        states = self.path(other, self.steps)
        for state in [*seen, one.state()]:
            for copy in range(NUM):
                at = round(state.time[copy] / ROBOT.time_step)
                expected = states[at].tip_position[copy]
                np.testing.assert_array_equal(state.tip_position[copy], expected)
        one.close()
        other.close()

    def two_step_one_environment(self) -> None:
        envs = [TaskVectorEnv(NUM, ROBOT, self.engine, frame_skip=2) for _ in range(2)]
        for env in envs:
            env.reset(seed=1)

        def advance(env: TaskVectorEnv, steps: int) -> None:
            for _ in range(steps):
                env.step(self.command)

        half = partial(advance, envs[0], self.steps)
        assert together(half, half) == []
        advance(envs[1], 2 * self.steps)
        assert envs[0].actions_taken.tolist() == [2 * self.steps] * NUM
        same(envs[0].simulation.state(), envs[1].simulation.state())
        for env in envs:
            env.close()


def same(one: State, other: State) -> None:
    """Check that two states are the same to the bit."""
    for field in fields(State):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


SCENES = [name for name in vars(Threads) if name.startswith(("one_", "two_"))]


@pytest.mark.parametrize("engine", backend_names())
@pytest.mark.parametrize(
    "times", [len(SCENES), pytest.param(125, marks=pytest.mark.slow)], ids=["fast", "full"]
)
def test_threads_wait_for_each_other(engine: str, times: int) -> None:
    rng = np.random.default_rng(times)
    for trial in range(times):
        getattr(Threads(engine, rng), SCENES[trial % len(SCENES)])()
