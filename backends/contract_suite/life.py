"""Closed simulations refuse everything, and copies are simulations of their own."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import gymnasium
import numpy as np
import pytest

import cdcsr  # noqa: F401 (registers the environments)
from backends.contract_suite.states import Make, assert_same, commands_of
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import Robot
from cdcsr.simulation.contract import Simulation
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.plant import Parameters

USES: dict[str, Callable[[Simulation], object]] = {
    "step": lambda s: s.step(np.zeros((s.num, s.robot.num_cables)), 40),
    "reset": lambda s: s.reset(),
    "state": lambda s: s.state(),
    "dynamics": lambda s: s.dynamics(),
    "get_snapshot": lambda s: s.get_snapshot(),
    "set_parameters": lambda s: s.set_parameters(None, Parameters()),
    "render": lambda s: s.render(),
    "copy": copy.copy,
    "pickle": pickle.dumps,
}


class LifeContract:
    """Tests of closing, copying and pickling."""

    def test_a_closed_simulation_refuses_everything_and_moves_no_other(
        self, engine: str, make: Make, paper: Robot
    ) -> None:
        """PyBullet gives the number of a closed client to the next one."""
        closed, snapshot = make_simulation(paper, engine), make(engine, paper).get_snapshot()
        closed.close()
        closed.close()
        other = make(engine, paper)
        before = other.state()
        position, velocity = snapshot.position, snapshot.velocity
        uses = USES | {
            "set_snapshot": lambda s: s.set_snapshot(snapshot),
            "place": lambda s: s.place(None, position, velocity),
        }
        for use in uses.values():
            with pytest.raises(CdcsrError, match="is closed; make a new one"):
                use(closed)
        assert_same(other.state(), before)

    @pytest.mark.parametrize("how", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
    def test_a_copy_goes_on_alone_and_as_the_original_does(
        self, engine: str, make: Make, paper: Robot, how: Callable[[Simulation], Simulation]
    ) -> None:
        """With delays, and parameters of each copy."""
        commands = commands_of(paper, 40, 2)
        original = make(engine, paper, 2)
        original.set_parameters([1], Parameters(link_mass=1.3, command_delay=3))
        for command in commands[:20]:
            original.step(command)
        twin = how(original)
        for command in commands[20:]:
            original.step(command)
        assert abs(twin.state().time - original.state().time).min() > 0.04  # it did not go along
        for command in commands[20:]:
            twin.step(command)
        exact = "bit_exact" in original.capabilities
        assert_same(twin.state(), original.state(), atol=0.0 if exact else 1e-9)
        twin.close()

    @pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
    def test_a_copied_environment_goes_on_as_its_original(
        self, engine: str, how: Callable[[gymnasium.Env], gymnasium.Env]
    ) -> None:
        env = gymnasium.make("cdcsr/Reach-v0", backend=engine)
        env.reset(seed=3)
        actions = [env.action_space.sample() for _ in range(20)]
        for action in actions:
            env.step(action)
        twin = how(env)
        ends = [[each.step(action)[0] for action in actions][-1] for each in (env, twin)]
        np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-9)
        env.close()
        twin.close()
