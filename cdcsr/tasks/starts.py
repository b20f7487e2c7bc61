"""The states in which episodes begin.

| start | the base | the arm |
| --- | --- | --- |
| still | at rest | straight |
| moving | drifts and turns | straight |
| anywhere | drifts and turns | bent and swinging, cables pulled |

The base always begins at the origin of the world, unturned. So targets, which are drawn in the
world, have the same places relative to the base at every start.

**Drift and turn.** A drift moves robot and target alike: the target moves with the velocity that
the base was given, in addition to its own motion. By Galilean invariance the drifting robot then
has the problem of the still one; a policy has to find that out, as it observes the drift. (Drift of
the target relative to the base is the task's: motion `drift`.) A turn belongs to the robot alone:
the target does not turn with the base, so the arm sweeps past it.

**Bent arms.** Joint angles drawn at random would stretch cables, and say nothing of tensions or
rates. So these states are simulated: from the straight arm at rest a command is drawn, uniform over
the servos' range, and held for a random time; then a second one. The states at the end of both are
kept, hence arms that swing out and arms that swing back. Cables are never too long in them, and
those that are slack have no tension. The bank holds :data:`BANK` such states, and takes a second or
two, once for each process, robot and seed. Parameters of a copy may shorten a cable; its slider
then begins higher by as much, as after a reset.

The bank is always simulated in :data:`ENGINE`, and is common to all engines: the same seed gives
the same starts in each of them, so a comparison of engines is paired by episode. Every engine then
goes on from position and velocity by its own rules.
"""

from __future__ import annotations

from contextlib import closing
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import Simulation
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.rotations import rotation_matrix
from cdcsr.tasks.target_motion import directions
from cdcsr.tasks.task import Task

Array = NDArray[np.float64]
StartName = Literal["still", "moving", "anywhere"]

SPEED, RATE = 0.02, 0.02
"""The largest speed of the base, in [m/s], and its largest rate of turning, in [rad/s], of the
paper's robot. Both are uniform from zero; so are their directions over the sphere."""
ENGINE = "mujoco"
"""The engine that simulates the bank."""
BANK = 256
"""The number of states in the bank."""
HOLD = 0.2
"""The longest time for which a command of the bank is held, in [s], with the paper's robot; uniform
from one time step."""


class Start(NamedTuple):
    """The states in which n episodes begin."""

    position: Array
    """As in a Snapshot, shape (n, 7 + C + 2 J); the base is at the origin."""
    velocity: Array
    """In the order of coordinates, shape (n, nv)."""
    drift: Array
    """The velocity that the target shares with the robot, shape (n, 3), in [m/s]."""


class Starts:
    """Draw the states in which episodes begin.

    Args:
        name: still, moving or anywhere; see the table above.
        robot: the description.
        seed: seeds the bank. An evaluation takes another one than training, so that a policy is
            measured from states in which it never began.

    Raises:
        CdcsrError: there is no such start.
    """

    def __init__(self, name: str, robot: Robot, seed: int = 0) -> None:
        self.name: StartName = start_name(name)
        self._robot, self._seed = robot, seed

    @property
    def varies(self) -> bool:
        """Whether the starts differ from each other."""
        return self.name != "still"

    def check(self, task: Task) -> None:
        """Check that a task can begin so.

        Raises:
            CdcsrError: it is quiet, and the base drifts; or the base does not start at the origin,
                or cannot move, as it would have to.
        """
        base = self._robot.base
        if (self.varies or task.quiet) and (
            base.position != (0.0, 0.0, 0.0) or base.quaternion != (1.0, 0.0, 0.0, 0.0)
        ):
            what = f"start {self.name!r}" if self.varies else f"task {task.name!r}"
            raise CdcsrError(
                f"The {what} is for a base that begins at the world's origin, unturned; that of "
                f"{self._robot.name!r} does not. Choose another one."
            )
        if self.varies and base.mount == "fixed":
            raise CdcsrError(
                f"With start {self.name!r} the base drifts, and that of {self._robot.name!r} is "
                "fixed; choose start 'still'."
            )
        if task.quiet and self.varies:
            raise CdcsrError(
                f"With start {self.name!r} the base drifts by itself, so that the task "
                f"{task.name!r} would fail; choose start 'still'."
            )

    def begin(
        self, simulation: Simulation, ids: NDArray[np.int64], rng: np.random.Generator
    ) -> Array | None:
        """Put copies `ids`, whose parameters are set, into states in which episodes begin.

        Returns:
            The velocity that each target shares with its robot, shape (len(ids), 3), in [m/s]; None
            if the robots are still.
        """
        if not self.varies:
            simulation.reset(ids)
            return None
        position, velocity, drift = self.draw(rng, len(ids))
        position[:, 7 : 7 + self._robot.num_cables] += simulation.plant.start_travel[ids]
        simulation.place(ids, position, velocity)
        return drift

    def draw(self, rng: np.random.Generator, num: int) -> Start:
        """Draw `num` states for a start that is not still."""
        if self.name == "anywhere":
            positions, velocities = bank(self._robot, self._seed)
            chosen = rng.integers(len(positions), size=num)
            position, velocity = positions[chosen], velocities[chosen]
        else:
            size = self._robot.num_coordinates
            position, velocity = np.zeros((num, size + 1)), np.zeros((num, size))
            position[:, 3] = 1.0
        own = ruler(self._robot)
        drift = directions(rng, num) * rng.uniform(0, SPEED * own.speed, (num, 1))
        # Sliders and hinges are relative to the base: the robot gets this motion as a whole.
        velocity[:, :3] += drift
        velocity[:, 3:6] += directions(rng, num) * rng.uniform(0, RATE / own.pace, (num, 1))
        return Start(position, velocity, drift)


def start_name(name: str) -> StartName:
    """Return the name of a start.

    Raises:
        CdcsrError: there is no such start.
    """
    for known in get_args(StartName):
        if name == known:
            return known
    raise CdcsrError(unknown_choice("start", name, get_args(StartName)))


_BANKS: dict[tuple[str, float, int], tuple[Array, Array]] = {}


def bank(robot: Robot, seed: int) -> tuple[Array, Array]:
    """Return positions and velocities of bent and swinging robots, seen from their base.

    They are simulated at the first call and kept.
    """
    key = robot.fingerprint, ruler(robot).pace, seed
    if key not in _BANKS:
        _BANKS[key] = _simulate(robot, np.random.default_rng(seed))
    return _BANKS[key]


def _simulate(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array]:
    num, most = BANK // 2, max(1, round(HOLD * ruler(robot).pace / robot.time_step))
    commands = rng.random((2, num, robot.num_cables)) * robot.full_commands
    ends = rng.integers(1, most, size=(2, num), endpoint=True).cumsum(axis=0)
    positions = np.zeros((2, num, robot.num_coordinates + 1))
    velocities = np.zeros((2, num, robot.num_coordinates))
    with closing(make_simulation(robot, ENGINE, num)) as simulation:
        for step in range(int(ends.max())):
            simulation.step(np.where((step < ends[0])[:, None], *commands))
            reached = ends == step + 1
            if reached.any():
                now = simulation.get_snapshot()
                for which, copies in enumerate(reached):
                    positions[which, copies] = now.position[copies]
                    velocities[which, copies] = now.velocity[copies]
    position, velocity = positions.reshape(BANK, -1), velocities.reshape(BANK, -1)
    to_base = rotation_matrix(position[:, 3:7]).swapaxes(1, 2)
    velocity[:, :3] = np.einsum("nij,nj->ni", to_base, velocity[:, :3])
    velocity[:, 3:6] = np.einsum("nij,nj->ni", to_base, velocity[:, 3:6])
    position[:, :7] = [0, 0, 0, 1, 0, 0, 0]
    return position, velocity
