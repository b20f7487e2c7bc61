"""The session behind the live view: one robot in several engines under the same commands.

It knows no page. Whoever shows it calls :meth:`Session.advance` again and again from one thread.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backends.viewers.disturbing import Disturbing, ShownNumber
from backends.viewers.driving import Driver, Driving, Shown
from cdcsr.errors import CdcsrError, Diverged, unknown_choice
from cdcsr.robot.description import Robot
from cdcsr.robot.routing import cable_lengths, routing
from cdcsr.robot.ruler import rounded, ruler
from cdcsr.simulation.arguments import as_floats
from cdcsr.simulation.engines import make_simulation
from cdcsr.simulation.plant import Parameters
from cdcsr.simulation.state import State
from cdcsr.tasks.spaces import Space
from cdcsr.tasks.task import base_errors

Array = NDArray[np.float64]

SLOWEST, FASTEST = 0.01, 4.0
"""The range of the speed, in simulated seconds for each second."""
HISTORY = 400
"""The number of moments that plots and trails reach back."""
_SPEED, _FARTHEST = 0.2, 100.0
"""The speed at first, and the largest coordinate of a target in [m], with the paper's robot."""

PLANT: Mapping[str, ShownNumber] = {
    "base_mass": ShownNumber("base mass, factor", 0.1, 4.0, 0.05),
    "link_mass": ShownNumber("link masses, factor", 0.2, 4.0, 0.05),
    "joint_stiffness": ShownNumber("joint stiffness, factor", 0.0, 4.0, 0.05),
    "joint_damping": ShownNumber("joint damping, factor", 0.0, 4.0, 0.05),
    "slider_damping": ShownNumber("slider friction, factor", 0.0, 4.0, 0.05),
    "servo_gain": ShownNumber("servo gain, factor", 0.1, 4.0, 0.05),
    "rest_length_offset": ShownNumber("cable length, added [mm]", -10.0, 10.0, 0.5, 0.0, 1e-3),
    "command_delay": ShownNumber("command delay [steps]", 0.0, 40.0, 1.0, 0.0),
}
"""The fields of :class:`Parameters` that can be changed, the same for all parts of the robot; the
ranges are those of the paper's robot."""


class View(NamedTuple):
    """One engine at one moment, as it is drawn."""

    state: State
    position: Array
    """As in a Snapshot, shape (7 + C + H,)."""
    slack: Array
    """By how much each cable is longer than its path, shape (C,), in [m]."""


class Moment(NamedTuple):
    """The numbers of one moment that plots and trails show; E engines."""

    time: float
    tip: Array
    """Shape (E, 3), in [m]."""
    distance: Array
    """From tip to target, shape (E,), in [m]."""
    tension: Array
    """In the first engine, shape (C,), in [N]."""
    base: Array
    """How far the base is from its start in the first engine, shape (3,), in [m]."""
    tilt: float
    """The angle between the base and the axes of the world in the first engine, in [rad]."""


class Session:
    """Simulate one robot in several engines side by side, all under the same commands.

    Controllers see the first engine.

    Args:
        robot: the description.
        engines: their names.
        space: where new targets are drawn.
        drivers: controllers that may choose the commands.
        episodes: recorded or measured episodes that can be shown again.
        seed: of the target.

    Attributes:
        driving: who chooses the commands.
        disturbing: what disturbs the robot.
        playing: whether `advance` lets time pass.
        note: what stopped it last, for the user.
        steps: how many simulation steps were made since the last reset.
        target: shape (3,), world frame, in [m].
        numbers: :data:`PLANT` for this robot.
        plant: their values as they are shown.
        history: the last moments, the latest at its end.

    Raises:
        CdcsrError: an engine is unknown, or cannot simulate the robot.
    """

    def __init__(
        self,
        robot: Robot,
        engines: Sequence[str],
        space: Space,
        drivers: Sequence[Driver] = (),
        episodes: Sequence[Shown] = (),
        seed: int = 0,
    ) -> None:
        self.robot, self.engines, self.space = robot, list(engines), space
        self.driving = Driving(robot, drivers, episodes)
        self.playing, self.note, self.steps = False, "", 0
        own, longer = ruler(robot), PLANT["rest_length_offset"]
        self._speed = float(np.clip(rounded(_SPEED * own.pace, 2), SLOWEST, FASTEST))
        self._farthest, self._debt, self._route = _FARTHEST * own.size, 0.0, routing(robot)
        self.numbers = {**PLANT, "rest_length_offset": longer.grown(own.travel)}
        self.plant = {name: number.start for name, number in self.numbers.items()}
        self.history: deque[Moment] = deque(maxlen=HISTORY)
        self.simulations = [make_simulation(robot, engine) for engine in engines]
        self.disturbing = Disturbing(robot, self.simulations)
        for simulation in self.simulations:  # the first step may compile, and no page should wait
            simulation.step(np.zeros((1, robot.num_cables)))
        self.new_target(seed)
        if episodes:
            self.show(0)
        else:
            self.reset()

    @property
    def speed(self) -> float:
        """The simulated seconds that pass in a second.

        Raises:
            CdcsrError: it is set outside its range.
        """
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        if not SLOWEST <= speed <= FASTEST:
            raise CdcsrError(f"The speed lies from {SLOWEST:g} to {FASTEST:g}; found {speed:g}.")
        self._speed = speed

    @property
    def time(self) -> float:
        """The simulated time since the last reset, in [s]."""
        return self.steps * self.robot.time_step

    @property
    def apart(self) -> float:
        """The largest distance between the tips of two engines, in [m]."""
        tips = self.history[-1].tip
        return float(np.linalg.norm(tips[:, None] - tips, axis=2).max())

    def views(self) -> list[View]:
        """Return every engine as it is now."""
        found = []
        for simulation in self.simulations:
            state = simulation.state()
            travel, hinges = state.cable_travel[0], state.joint_angles[0]
            length = cable_lengths(self._route, travel, hinges)
            slack = self._route.rest_length + simulation.plant.rest_length_offset[0] - length
            base = state.base_position[0], state.base_quaternion[0]
            found.append(View(state, np.concatenate([*base, travel, hinges]), slack))
        return found

    def reset(self) -> None:
        """Put the robot back to its start in all engines, with no cable pulled."""
        self.disturbing.stop()
        for simulation in self.simulations:
            simulation.reset()
        self.steps, self._debt = 0, 0.0
        self.driving.command = np.zeros(self.robot.num_cables)
        self.history.clear()
        self.driving.begin(self.simulations[0], 0)
        self._remember()

    def advance(self, seconds: float, budget: float = np.inf) -> bool:
        """Let time pass, if the session plays; what fails stops it and leaves a note.

        Args:
            seconds: of real time; the speed says how much simulated time that is.
            budget: how long the engines may take, in [s]; the rest of the time is left out.

        Returns:
            Whether time passed.
        """
        if not self.playing:
            return False
        self._debt += seconds * self.speed / self.robot.time_step
        steps, self._debt = int(self._debt), self._debt % 1.0
        return self._step(steps, budget)

    def step(self) -> None:
        """Stop, and make one simulation step."""
        self.playing = False
        self._step(1, np.inf)

    def drive(self, name: str) -> None:
        """Let somebody else choose the commands from now on: a name in `driving.names`.

        Raises:
            CdcsrError: nobody of that name can drive this robot.
        """
        before = self.driving.name
        self.driving.choose(name)
        try:
            self.driving.begin(self.simulations[0], self.steps)
        except CdcsrError:
            self.driving.name = before
            raise

    def move_target(self, place: Array) -> None:
        """Put the target somewhere else, shape (3,), in [m]; drivers follow it.

        Raises:
            CdcsrError: it is no place, or too far away.
        """
        place = as_floats("The target", place, (3,))
        if (np.abs(place) > self._farthest).any():
            raise CdcsrError(
                f"The coordinates of a target lie within {self._farthest:g} m of zero."
            )
        self.target = place

    def new_target(self, seed: int) -> None:
        """Draw the target of a seed.

        Raises:
            CdcsrError: the seed is negative or too large.
        """
        if not 0 <= seed < 2**63:
            raise CdcsrError(f"A seed is a whole number from 0 on; found {seed}.")
        self.seed = seed
        self.move_target(self.space.sample(np.random.default_rng(seed), 1)[0])

    def show(self, number: int) -> None:
        """Begin an episode that was recorded or measured, counted from 0.

        Raises:
            CdcsrError: there is no such episode.
        """
        self.move_target(self.driving.show(number))
        self.reset()

    def set_plant(self, name: str, value: float) -> None:
        """Change one of :attr:`numbers`, as it is shown, in all engines.

        Another length of the cables puts the robot back to its start, as it changes where the
        sliders begin.

        Raises:
            CdcsrError: there is no such number, or it is out of range.
        """
        if name not in self.numbers:
            raise CdcsrError(unknown_choice("number of the plant", name, self.numbers))
        self.numbers[name].check(value)
        changed = self.plant | {name: value}
        values = {key: shown * self.numbers[key].scale for key, shown in changed.items()}
        delay = round(values.pop("command_delay"))
        parameters = Parameters(command_delay=delay, **values)
        for simulation in self.simulations:
            simulation.set_parameters(None, parameters)
        self.plant = changed
        if name == "rest_length_offset":
            self.reset()

    def close(self) -> None:
        """Close the engines."""
        for simulation in self.simulations:
            simulation.close()

    def _step(self, steps: int, budget: float) -> bool:
        """Make steps while the budget lasts, and return whether there were any."""
        end, left = time.perf_counter() + budget, steps
        try:
            while left > 0 and time.perf_counter() < end:
                channel = self.disturbing.channel
                hold = self.driving.next_command(self.steps, self.target, channel)
                hold = min(each for each in (hold, self.disturbing.hold, left) if each)
                for simulation in self.simulations:
                    simulation.step(self.driving.arriving[None], hold)
                self.disturbing.passed(hold)
                self.steps, left = self.steps + hold, left - hold
        except CdcsrError as error:
            self.playing, self.note = False, str(error)
            if isinstance(error, Diverged):
                self.reset()
            return True
        if left < steps:
            self._remember()
        return left < steps

    def _remember(self) -> None:
        """Add this moment to the history."""
        states = [simulation.state() for simulation in self.simulations]
        tip, first = np.array([state.tip_position[0] for state in states]), states[0]
        _, tilt = base_errors(first.base_position, first.base_quaternion)
        self.history.append(
            Moment(
                self.time,
                tip,
                np.linalg.norm(tip - self.target, axis=1),
                first.cable_tension[0],
                first.base_position[0] - self.robot.base.position,
                float(tilt[0]),
            )
        )
