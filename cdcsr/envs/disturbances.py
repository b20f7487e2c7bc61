"""What goes wrong between policy and robot (BATD3 paper, section V-E and Table IV)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.rng_state import pack_generator, unpack_generator
from cdcsr.errors import CdcsrError
from cdcsr.simulation.delay_line import DelayLine, check_delay
from cdcsr.tasks.observation import BASE_POSITION

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Disturbances:
    """How strongly each one acts; all zero is undisturbed."""

    action_noise: float = 0.0
    """Standard deviation of Gaussian noise on the commands, in [m] of set-point."""
    base_noise: float = 0.0
    """Standard deviation of Gaussian noise on the observed base position, in [m]."""
    packet_loss: float = 0.0
    """Probability that an observation does not arrive; the last one that did stands in for it."""
    observation_delay: int = 0
    """How many steps of the environment old an observation is when it arrives. An episode's first stands in for
    those before it. Commands that arrive late are the robot's own: see :class:`cdcsr.simulation.plant.Parameters`."""

    def __post_init__(self) -> None:
        noises = (self.action_noise, self.base_noise)
        if not all(0 <= noise < math.inf for noise in noises) or not 0 <= self.packet_loss <= 1:
            raise CdcsrError(
                f"Noise must be finite and not negative, and packet_loss must lie in [0, 1]; found {self}."
            )
        check_delay("observation_delay", self.observation_delay)


class Channel:
    """Carries observations and commands of `num` copies, disturbed."""

    def __init__(self, disturbances: Disturbances, rng: np.random.Generator) -> None:
        self._is = disturbances
        self._clear = disturbances == Disturbances()
        # A stream of its own: how often it is asked must not change the targets that `rng` draws.
        self._rng = rng.spawn(1)[0]
        self._received: Array | None = None
        self._line = DelayLine(0, 0)

    def start(self, observation: Array, fresh: NDArray[np.bool_]) -> Array:
        """The first observation of an episode always arrives. `fresh` marks the copies that begin one."""
        observation = self._noisy(observation)
        if self._received is None:
            self._received = observation
            self._open()
        else:
            self._received = np.where(fresh[:, None], observation, self._received)
        self._line.fill(np.flatnonzero(fresh), observation[fresh])
        return self._received.copy()

    def observe(self, observation: Array) -> Array:
        """What arrives of an observation, shape (num, n)."""
        assert self._received is not None
        if self._clear:
            self._received = observation
            return observation.copy()
        lost = self._rng.random(len(observation)) < self._is.packet_loss
        arriving = self._line.push(self._noisy(observation))
        self._received = np.where(lost[:, None], self._received, arriving)
        return self._received.copy()

    def command(self, command: Array) -> Array:
        """What arrives of a command, shape (num, C)."""
        if self._is.action_noise == 0:
            return command
        return command + self._rng.normal(scale=self._is.action_noise, size=command.shape)

    def get_state(self) -> dict[str, NDArray[Any]]:
        """All that determines what it does from here on; there is none before the first episode."""
        assert self._received is not None
        return {
            "received": self._received.copy(),
            "under_way": self._line.sent,
            "generator": pack_generator(self._rng),
        }

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Go on from a state of a channel with the same disturbances."""
        self._received = state["received"].copy()
        self._open()
        self._line.sent = state["under_way"]
        unpack_generator(self._rng, state["generator"])

    def _open(self) -> None:
        """A new line for as many copies as have received something."""
        assert self._received is not None
        num = len(self._received)
        self._line = DelayLine(*self._received.shape)
        self._line.set_delay(np.arange(num), np.full(num, self._is.observation_delay))

    def _noisy(self, observation: Array) -> Array:
        if self._is.base_noise == 0:
            return observation
        observation = observation.copy()
        observation[:, BASE_POSITION] += self._rng.normal(
            scale=self._is.base_noise, size=(len(observation), 3)
        )
        return observation
