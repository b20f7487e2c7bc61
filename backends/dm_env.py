"""Every task as a `dm_env` environment over any engine, for users of dm_control.

With MuJoCo the environment also has the model and the data that `dm_control.viewer` and the pixel
wrappers ask for.
"""

# dm_control is not annotated: a method of its base classes without a body seems to return None.
# pyright: reportIncompatibleMethodOverride=false

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Unpack

import numpy as np
from dm_control.mujoco import engine, wrapper
from dm_control.rl import control
from dm_env import specs
from numpy.typing import NDArray

from backends.mujoco.model import build_spec
from backends.mujoco.simulation import MujocoSimulation
from cdcsr.envs.episodes import Episodes
from cdcsr.envs.options import TaskOptions
from cdcsr.errors import Diverged
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import Array, Simulation
from cdcsr.simulation.engines import make_simulation
from cdcsr.tasks.catalogue import actions_per_episode, make_task
from cdcsr.tasks.observation import parts_of, tip_distance
from cdcsr.tasks.spaces import Space, make_space
from cdcsr.tasks.task import Task

_TARGET_COLOR = (0.2, 0.7, 0.3, 0.4)
"""The colour of the ball around the target whose radius is the task's threshold."""


class SimulationPhysics(control.Physics):
    """One robot in any engine, as dm_control sees it.

    Attributes:
        simulation: the engine, with one copy.
        measured: the copy's state now; arrays of shape (1, ...).
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.measured = simulation.state()
        self._command = np.zeros((1, simulation.robot.num_cables))

    def set_control(self, control: Array) -> None:
        """Set the servo set-points, shape (C,), in [m], for the steps that follow."""
        self._command[0] = control

    def step(self, n_sub_steps: int = 1) -> None:
        """Advance the robot by some time steps.

        Raises:
            PhysicsError: the simulation diverged.
        """
        try:
            self.simulation.step(self._command, n_sub_steps)
        except Diverged as error:
            raise control.PhysicsError(str(error)) from error
        self.measured = self.simulation.state()

    def reset(self) -> None:
        """Put the robot back to the start; dm_control calls this before an episode is set up."""
        self.simulation.reset()
        self._command[:] = 0

    def after_reset(self) -> None:
        """Measure the state; dm_control calls this once an episode is set up."""
        self.measured = self.simulation.state()

    def time(self) -> float:
        """Return the simulated time since the start of the episode, in [s]."""
        return float(self.measured.time[0])

    def timestep(self) -> float:
        """Return the time step of the simulation, in [s]."""
        return self.simulation.robot.time_step

    def show_target(self, target: Array, radius: float) -> None:
        """Mark the target, shape (3,), in [m], if there is a picture to mark it in."""

    def close(self) -> None:
        """Release what the engine holds."""
        self.simulation.close()


class MujocoPhysics(SimulationPhysics):
    """A robot in MuJoCo, with what viewers and wrappers use of `dm_control.mujoco.Physics`.

    `data` is current after every step. What is written to it acts on the robot: a pose while
    resetting, or a force of the viewer's mouse.
    """

    def __init__(self, simulation: MujocoSimulation) -> None:
        spec = build_spec(simulation.robot)
        spec.worldbody.add_site(name="target", rgba=_TARGET_COLOR)
        self._view = engine.Physics.from_model(wrapper.MjModel(spec.compile()))
        self._target = self.model.name2id("target", "site")
        # The compiler marks a site at its body's origin as one that never moves; this one does.
        self.model.site_sameframe[self._target] = 0
        self._engine = simulation
        super().__init__(simulation)

    @property
    def model(self) -> wrapper.MjModel:
        """The model of the robot and the target."""
        return self._view.model

    @property
    def data(self) -> wrapper.MjData:
        """The data that belong to `model`."""
        return self._view.data

    @property
    def named(self) -> engine.NamedIndexStructs:
        """`model` and `data`, indexed by name."""
        return self._view.named

    @property
    def render(self) -> Callable[..., NDArray[np.generic]]:
        """The method `dm_control.mujoco.Physics.render` of this robot."""
        return self._view.render

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
        self.model.site_pos[self._target] = self.data.site_xpos[self._target] = target
        self.model.site_size[self._target] = radius

    def close(self) -> None:
        self._view.free()
        super().close()

    def _refresh(self) -> None:
        """Update `data`, and all quantities in it that follow from the state."""
        self._engine.write_to(self.data.ptr)
        self._view.forward()


class TargetTask(control.Task):
    """A task of :mod:`cdcsr.tasks`, judged by its own rules.

    Args:
        task: what is rewarded, how targets move, and when an episode ends.
        space: where targets are drawn.
        robot: gives the limits of the commands.
        frame_skip: how many simulation steps each action is held for.
        seed: seeds the targets and their motions; `cdcsr/Reach-v0` draws the same with that seed.

    Raises:
        CdcsrError: an impossible frame_skip.
    """

    def __init__(self, task: Task, space: Space, robot: Robot, frame_skip: int, seed: int) -> None:
        self._task, self._frame_skip = task, frame_skip
        self._max_actions = actions_per_episode(task.max_steps, frame_skip)
        self._episode = Episodes(1, task, space)
        self._range = robot.command_range
        self._rng = np.random.default_rng(seed)
        self._reward, self._terminated = 0.0, False

    @property
    def target(self) -> Array:
        """Where the target is now, shape (3,), in [m]."""
        return self._episode.targets[0]

    def initialize_episode(self, physics: SimulationPhysics) -> None:
        self._episode.begin(np.arange(1), self._rng)
        physics.show_target(self.target, self._task.threshold)

    def before_step(self, action: Array, physics: SimulationPhysics) -> None:
        physics.set_control(np.clip(action, *self._range))

    def after_step(self, physics: SimulationPhysics) -> None:
        self._episode.advance(self._frame_skip, physics.timestep())
        physics.show_target(self.target, self._task.threshold)
        distance, verdict = self._episode.judge(physics.measured)
        self._reward = float(self._task.reward(distance, verdict.rewarded)[0])
        self._terminated = bool(verdict.terminated[0])

    def action_spec(self, physics: SimulationPhysics) -> specs.BoundedArray:
        return specs.BoundedArray(self._range[0].shape, np.float64, *self._range, "command")

    def get_observation(self, physics: SimulationPhysics) -> OrderedDict[str, Array]:
        """Return eq. (1) by parts; joined in this order they are Gymnasium's observation."""
        targets = self._episode.targets
        parts = parts_of(physics.measured, targets, tip_distance(physics.measured, targets))
        return OrderedDict((name, part[0].copy()) for name, part in parts.items())

    def get_reward(self, physics: SimulationPhysics) -> float:
        return self._reward

    def get_termination(self, physics: SimulationPhysics) -> float | None:
        """Return the discount that ends an episode: 0 after success, 1 when time is up."""
        if self._terminated:
            return 0.0
        return 1.0 if self._episode.actions_taken[0] >= self._max_actions else None


class TaskEnvironment(control.Environment):
    """The environment that :func:`make_dm_environment` makes."""

    def close(self) -> None:
        """Release what the engine holds."""
        self.physics.close()


def make_dm_environment(
    task: str | Task = "reach",
    robot: Robot | str = "paper",
    backend: str = "mujoco",
    space: str = "anchor",
    seed: int = 0,
    frame_skip: int | None = None,
    centers: Array | None = None,
    flat_observation: bool = False,
    **options: Unpack[TaskOptions],
) -> TaskEnvironment:
    """Make a task into a `dm_env` environment; with MuJoCo, `dm_control.viewer.launch` opens it.

    An episode ends with discount 0 on success, if the task ends then, and with discount 1 when time
    is up. Actions are clipped to their bounds.

    Args:
        task: a task, or a name in :data:`cdcsr.tasks.catalogue.TASKS`.
        robot: a robot, the path of a description, or the name of a shipped one.
        backend: the engine.
        space: the operation space in which targets are drawn.
        seed: seeds the targets and their motions.
        frame_skip: how many simulation steps each action is held for; by default the robot's own
            number.
        centers: the targets of the demonstrations, shape (n, 3), in [m]; Floating and Spatter
            surround them. By default those of the paper's ten.
        flat_observation: observe one array, "observations", instead of the parts of eq. (1).
        options: changes of the task, see :class:`cdcsr.envs.options.TaskOptions`.

    Raises:
        CdcsrError: an unknown name, or an impossible number.
    """
    robot = robot if isinstance(robot, Robot) else load_robot(robot)
    frame_skip = ruler(robot).frame_skip if frame_skip is None else frame_skip
    reward, period = options.pop("reward", None), robot.time_step * frame_skip
    task = make_task(task, robot, period=period, reward_kind=reward, **options)
    judged = TargetTask(task, make_space(space, robot, centers), robot, frame_skip, seed)
    simulation = make_simulation(robot, backend)
    is_mujoco = isinstance(simulation, MujocoSimulation)
    physics = MujocoPhysics(simulation) if is_mujoco else SimulationPhysics(simulation)
    return TaskEnvironment(
        physics, judged, n_sub_steps=frame_skip, flat_observation=flat_observation
    )
