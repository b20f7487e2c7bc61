"""Disturbances between policy and robot (BATD3 paper, section V-E and Table IV)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cdcsr.envs.rng_state import pack_generator, unpack_generator
from cdcsr.errors import CdcsrError
from cdcsr.simulation.delay_line import DelayLine, check_delay
from cdcsr.tasks.observation import BASE_POSITION

Array = NDArray[np.float64]

MOST = 1e3
"""The largest standard deviation of noise, in [m]."""


@dataclass(frozen=True)
class Disturbances:
    """The strength of each disturbance; zero is none."""

    action_noise: float = 0.0
    """Standard deviation of Gaussian noise on the commands, in [m] of set-point."""
    base_noise: float = 0.0
    """Standard deviation of Gaussian noise on the observed base position, in [m]."""
    packet_loss: float = 0.0
    """Probability that an observation is lost; the last one that arrived stands in for it."""
    observation_delay: int = 0
    """The age at which an observation arrives, in steps of the environment. At the start of an
    episode its first observation stands in for those before it. Late commands belong to the robot:
    see :class:`cdcsr.simulation.plant.Parameters`."""

    def __post_init__(self) -> None:
        noises = (self.action_noise, self.base_noise)
        if not all(0 <= noise <= MOST for noise in noises) or not 0 <= self.packet_loss <= 1:
            raise CdcsrError(
                f"Noise must lie in [0, {MOST:g}] m, and packet_loss must lie in [0, 1]; found "
                f"{self}."
            )
        check_delay("observation_delay", self.observation_delay)


class Channel:
    """The channel through which observations and commands of num copies pass, disturbed.

    Args:
        disturbances: their strengths.
        rng: a stream of its own is spawned from it, so that `rng` goes on drawing the same targets.
    """

    def __init__(self, disturbances: Disturbances, rng: np.random.Generator) -> None:
        self._strength = disturbances
        self._clear = disturbances == Disturbances()
        self._rng = rng.spawn(1)[0]
        self._received: Array | None = None
        self._line = DelayLine(0, 0)

    def start(self, observation: Array, fresh: NDArray[np.bool_]) -> Array:
        """Return what arrives when episodes begin: first observations are never lost or late.

        Args:
            observation: of all copies, shape (num, observation size).
            fresh: the copies that begin an episode, shape (num,).
        """
        observation = self._noisy(observation)
        if self._received is None:
            self._received = observation
            self._make_line()
        else:
            self._received = np.where(fresh[:, None], observation, self._received)
        self._line.fill(np.flatnonzero(fresh), observation[fresh])
        return self._received.copy()

    def observe(self, observation: Array) -> Array:
        """Return what arrives of the observations, shape (num, observation size)."""
        assert self._received is not None
        if self._clear:
            self._received = observation
            return observation.copy()
        lost = self._rng.random(len(observation)) < self._strength.packet_loss
        arriving = self._line.push(self._noisy(observation))
        self._received = np.where(lost[:, None], self._received, arriving)
        return self._received.copy()

    def command(self, command: Array) -> Array:
        """Return what arrives of the commands, shape (num, C), in [m]."""
        if self._strength.action_noise == 0:
            return command
        return command + self._rng.normal(scale=self._strength.action_noise, size=command.shape)

    def get_state(self) -> dict[str, NDArray[np.generic]]:
        """Return all that determines what the channel does from here on, once episodes have
        begun."""
        assert self._received is not None
        return {
            "received": self._received.copy(),
            "under_way": self._line.sent,
            "generator": pack_generator(self._rng),
        }

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go on from the state of a channel with the same disturbances."""
        self._received = state["received"].copy()
        self._make_line()
        self._line.sent = state["under_way"]
        unpack_generator(self._rng, state["generator"])

    def _make_line(self) -> None:
        """Make a new delay line for as many copies as have received something."""
        assert self._received is not None
        num = len(self._received)
        self._line = DelayLine(*self._received.shape)
        self._line.set_delay(np.arange(num), np.full(num, self._strength.observation_delay))

    def _noisy(self, observation: Array) -> Array:
        """Return the observations with noise on the base position."""
        if self._strength.base_noise == 0:
            return observation
        observation = observation.copy()
        observation[:, BASE_POSITION] += self._rng.normal(
            scale=self._strength.base_noise, size=(len(observation), 3)
        )
        return observation
