"""The Reach task for dm_control's users: a `dm_env` environment over any engine.

On MuJoCo the environment also has the model and the data that `dm_control.viewer` and the pixel wrappers ask for.
"""

# dm_control is not annotated, and a method of its base classes without a body reads as one that returns None.
# pyright: reportIncompatibleMethodOverride=false

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np
from dm_control.mujoco import engine, wrapper
from dm_control.rl import control
from dm_env import specs
from numpy.typing import NDArray

from backends.mujoco.model import build_spec
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.errors import Diverged
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.contract import Array, Simulation
from cdcsr.simulation.engines import make_simulation
from cdcsr.tasks.catalogue import Reach, actions_per_episode
from cdcsr.tasks.observation import parts_of, tip_distance
from cdcsr.tasks.spaces import Space, make_space
from cdcsr.tasks.task import Reward

_TARGET = (0.2, 0.7, 0.3, 0.4)
"""Colour of the ball in which a reach succeeds."""


class SimulationPhysics(control.Physics):
    """One robot in any engine, as dm_control sees it.

    Attributes:
        simulation: the engine, with one copy.
        measured: its state now; arrays of shape (1, ...).
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.measured = simulation.state()
        self._command = np.zeros((1, simulation.robot.num_cables))

    def set_control(self, control: Array) -> None:
        """Set the servo set-points, shape (C,), in [m], for the steps that follow."""
        self._command[0] = control

    def step(self, n_sub_steps: int = 1) -> None:
        try:
            self.simulation.step(self._command, n_sub_steps)
        except Diverged as error:
            raise control.PhysicsError(str(error)) from error
        self.measured = self.simulation.state()

    def reset(self) -> None:
        self.simulation.reset()
        self._command[:] = 0

    def after_reset(self) -> None:
        self.measured = self.simulation.state()

    def time(self) -> float:
        return float(self.measured.time[0])

    def timestep(self) -> float:
        return self.simulation.robot.time_step

    def show_target(self, target: Array, radius: float) -> None:
        """Mark a target, shape (3,), in [m], where there is a picture to mark it in."""

    def close(self) -> None:
        """Release what the engine holds."""
        self.simulation.close()


class MujocoPhysics(SimulationPhysics):
    """A robot in MuJoCo, with the parts of `dm_control.mujoco.Physics` that viewers and wrappers use.

    `data` is current after every step, and what is written to it (a pose while resetting, a force of the
    viewer's mouse) acts on the robot.
    """

    def __init__(self, simulation: MujocoSimulation) -> None:
        spec = build_spec(simulation.robot)
        spec.worldbody.add_site(name="target", rgba=_TARGET)
        self._view = engine.Physics.from_model(wrapper.MjModel(spec.compile()))
        self._target = self.model.name2id("target", "site")
        # The compiler marks a site at its body's origin as not worth transforming; this one will move.
        self.model.site_sameframe[self._target] = 0
        self._engine = simulation
        super().__init__(simulation)

    @property
    def model(self) -> wrapper.MjModel:
        """The robot and the target."""
        return self._view.model

    @property
    def data(self) -> wrapper.MjData:
        return self._view.data

    @property
    def named(self) -> engine.NamedIndexStructs:
        """`model` and `data`, indexed by name."""
        return self._view.named

    def render(self, *args: Any, **kwargs: Any) -> NDArray[Any]:
        """See `dm_control.mujoco.Physics.render`."""
        return self._view.render(*args, **kwargs)

    def step(self, n_sub_steps: int = 1) -> None:
        self._engine.read_from(self.data.ptr)
        super().step(n_sub_steps)
        self._refresh()

    def reset(self) -> None:
        super().reset()
        self._refresh()

    def after_reset(self) -> None:
        self._engine.read_from(self.data.ptr)
        super().after_reset()
        self._refresh()

    def show_target(self, target: Array, radius: float) -> None:
        self.model.site_pos[self._target] = target
        self.model.site_size[self._target] = radius

    def close(self) -> None:
        self._view.free()
        super().close()

    def _refresh(self) -> None:
        """Make `data`, and all that follows from the state in it, current."""
        self._engine.write_to(self.data.ptr)
        self._view.forward()


class ReachTask(control.Task):
    """:class:`cdcsr.tasks.catalogue.Reach` on targets from a space.

    Args:
        task: what is observed and rewarded.
        space: where targets are drawn from.
        robot: gives the limits of the commands.
        max_actions: after which an episode is over.
        seed: of the targets; they are the ones `cdcsr/Reach-v0` draws first with that seed.

    Attributes:
        target: of this episode, shape (3,), in [m].
    """

    def __init__(
        self, task: Reach, space: Space, robot: Robot, max_actions: int, seed: int
    ) -> None:
        self.target = np.zeros(3)
        self._task, self._space, self._max_actions = task, space, max_actions
        self._eta = np.array([servo.eta for servo in robot.servos])
        self._rng = np.random.default_rng(seed)
        self._actions_taken = 0

    def initialize_episode(self, physics: SimulationPhysics) -> None:
        self.target = self._space.sample(self._rng, 1)[0]
        self._actions_taken = 0
        physics.show_target(self.target, self._task.threshold)

    def before_step(self, action: Array, physics: SimulationPhysics) -> None:
        physics.set_control(np.clip(action, -self._eta, 0))
        self._actions_taken += 1

    def action_spec(self, physics: SimulationPhysics) -> specs.BoundedArray:
        return specs.BoundedArray(
            self._eta.shape, np.float64, -self._eta, np.zeros_like(self._eta), "command"
        )

    def get_observation(self, physics: SimulationPhysics) -> OrderedDict[str, Array]:
        """Eq. (1) by parts; joined in this order they are the observation of `cdcsr/Reach-v0`."""
        parts = parts_of(physics.measured, self.target[None], self._distance(physics))
        return OrderedDict((name, part[0].copy()) for name, part in parts.items())

    def get_reward(self, physics: SimulationPhysics) -> float:
        distance = self._distance(physics)
        return float(self._task.reward(distance, distance <= self._task.threshold)[0])

    def get_termination(self, physics: SimulationPhysics) -> float | None:
        """The discount that ends an episode: 0 after success, 1 when time is up."""
        if self._distance(physics)[0] <= self._task.threshold:
            return 0.0
        return 1.0 if self._actions_taken >= self._max_actions else None

    def _distance(self, physics: SimulationPhysics) -> Array:
        return tip_distance(physics.measured, self.target[None])


class ReachEnvironment(control.Environment):
    """What :func:`make_dm_environment` makes."""

    def close(self) -> None:
        self.physics.close()


def make_dm_environment(
    robot: Robot | str = "paper",
    backend: str = "mujoco",
    space: str = "anchor",
    seed: int = 0,
    reward: Reward = "sparse",
    frame_skip: int = 1,
    max_steps: int = Reach.max_steps,
    threshold: float = 0.03,
    centers: Array | None = None,
    flat_observation: bool = False,
) -> control.Environment:
    """The Reach task as a `dm_env` environment; with MuJoCo, `dm_control.viewer.launch` opens it.

    An episode ends with discount 0 on success and with discount 1 when time is up. Actions beyond the bounds
    are clipped.

    Args:
        robot: a Robot, a path, or the name of a shipped one.
        backend: the engine.
        space: the operation space targets are drawn from.
        seed: of the targets.
        reward: "sparse" (eq. 2) or "dense".
        frame_skip: simulation steps each action is held for.
        max_steps: simulation steps after which time is up.
        threshold: success within this distance, in [m].
        centers: the demonstrations' targets that Floating and Spatter surround, shape (n, 3), in [m].
        flat_observation: one array under the key "observations" instead of one for each part of eq. (1).

    Raises:
        CdcsrError: an unknown robot, engine, space or reward, or an impossible frame_skip.
    """
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    max_actions = actions_per_episode(max_steps, frame_skip)
    task = ReachTask(
        Reach(threshold, reward), make_space(space, robot, centers), robot, max_actions, seed
    )
    simulation = make_simulation(robot, backend)
    is_mujoco = isinstance(simulation, MujocoSimulation)
    physics = MujocoPhysics(simulation) if is_mujoco else SimulationPhysics(simulation)
    return ReachEnvironment(
        physics, task, n_sub_steps=frame_skip, flat_observation=flat_observation
    )
