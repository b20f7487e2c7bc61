"""Disturbances between policy and robot have the statistics that they declare."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from scipy import stats

from cdcsr.envs.disturbances import Channel, Disturbances
from cdcsr.errors import CdcsrError
from cdcsr.robot.description import load_robot
from cdcsr.simulation.contract import Array
from cdcsr.tasks.observation import BASE_POSITION, observation_size

NUM, STEPS, SIZE = 200, 100, observation_size(load_robot("paper"))


def channel(disturbances: Disturbances) -> Channel:
    return Channel(disturbances, np.random.default_rng(0))


def observations() -> Array:
    """Return observations, shape (STEPS, NUM, SIZE), in which no number occurs twice."""
    return np.arange(STEPS * NUM * SIZE, dtype=float).reshape(STEPS, NUM, SIZE)


def everyone(num: int = NUM) -> np.ndarray:
    return np.ones(num, dtype=bool)


def test_undisturbed_everything_arrives_as_it_was_sent() -> None:
    through, sent = channel(Disturbances()), observations()
    np.testing.assert_array_equal(through.start(sent[0], everyone()), sent[0])
    for row in sent[1:]:
        np.testing.assert_array_equal(through.observe(row), row)
        assert through.command(row) is row


@pytest.mark.parametrize("loss", [0.1, 0.4])
def test_lost_observations_are_replaced_by_the_last_that_arrived(loss: float) -> None:
    through, sent = channel(Disturbances(packet_loss=loss)), observations()
    last = through.start(sent[0], everyone())
    np.testing.assert_array_equal(last, sent[0])
    lost = 0
    for row in sent[1:]:
        received = through.observe(row)
        arrived = (received == row).all(axis=1)
        np.testing.assert_array_equal(received[~arrived], last[~arrived])
        lost += int((~arrived).sum())
        last = received
    assert stats.binomtest(lost, NUM * (STEPS - 1), loss).pvalue > 1e-4


def test_if_everything_is_lost_the_first_observation_is_repeated() -> None:
    through, sent = channel(Disturbances(packet_loss=1.0)), observations()
    through.start(sent[0], everyone())
    for row in sent[1:]:
        np.testing.assert_array_equal(through.observe(row), sent[0])


def test_changing_a_received_observation_does_not_change_later_ones() -> None:
    through, sent = channel(Disturbances(packet_loss=1.0)), observations()
    through.start(sent[0].copy(), everyone())[:] = np.nan
    through.observe(sent[1])[:] = np.nan
    np.testing.assert_array_equal(through.observe(sent[2]), sent[0])


def test_only_copies_that_begin_an_episode_receive_its_start() -> None:
    through, sent = channel(Disturbances(packet_loss=1.0)), observations()
    through.start(sent[0], everyone())
    fresh = np.arange(NUM) % 3 == 0
    received = through.start(sent[1], fresh)
    np.testing.assert_array_equal(received, np.where(fresh[:, None], sent[1], sent[0]))
    np.testing.assert_array_equal(through.observe(sent[2]), received)


def test_base_noise_has_its_deviation_and_changes_only_the_base_position() -> None:
    """In first observations and in later ones."""
    through, sent = channel(Disturbances(base_noise=0.02)), observations()
    errors = []
    for step, row in enumerate(sent):
        original = row.copy()
        received = through.start(row, everyone()) if step == 0 else through.observe(row)
        np.testing.assert_array_equal(row, original)
        errors.append((received - row)[:, BASE_POSITION])
        received[:, BASE_POSITION] = row[:, BASE_POSITION]
        np.testing.assert_array_equal(received, row)
    noise = np.array(errors)
    # Means of three columns over NUM x STEPS draws, and the noise of the start alone.
    assert np.abs(noise.mean(axis=(0, 1))).max() < 4 * 0.02 / np.sqrt(NUM * STEPS)
    assert stats.kstest(noise.ravel(), "norm", args=(0, 0.02)).pvalue > 1e-4
    assert np.abs(np.corrcoef(noise.reshape(-1, 3).T) - np.eye(3)).max() < 4 / np.sqrt(NUM * STEPS)
    assert noise[0].std() == pytest.approx(0.02, rel=0.1)


def test_action_noise_has_its_deviation_and_is_independent() -> None:
    command = np.full((2000, 8), -2.0)
    noise = channel(Disturbances(action_noise=0.3)).command(command) - command
    assert stats.kstest(noise.ravel(), "norm", args=(0, 0.3)).pvalue > 1e-4
    assert np.unique(noise).size == noise.size
    assert (command == -2.0).all()


@pytest.mark.parametrize(
    "make",
    [
        partial(Disturbances, action_noise=-0.1),
        partial(Disturbances, base_noise=-0.1),
        partial(Disturbances, packet_loss=-0.1),
        partial(Disturbances, packet_loss=1.1),
    ],
)
def test_impossible_strengths_are_errors(make: Callable[[], Disturbances]) -> None:
    with pytest.raises(CdcsrError, match="packet_loss must lie in"):
        make()


@pytest.mark.parametrize("bad", [-1, 101, 0.5])
def test_impossible_delays_are_errors(bad: float) -> None:
    with pytest.raises(CdcsrError, match="observation_delay counts whole steps, from 0 to 100"):
        Disturbances(observation_delay=bad)  # type: ignore[arg-type]


def test_late_observations_come_from_earlier_steps() -> None:
    through, sent = channel(Disturbances(observation_delay=3)), observations()
    np.testing.assert_array_equal(through.start(sent[0], everyone()), sent[0])
    for step in range(1, 20):
        np.testing.assert_array_equal(through.observe(sent[step]), sent[max(step - 3, 0)])


def test_a_new_episode_receives_no_late_observation_of_the_old_one() -> None:
    through, sent = channel(Disturbances(observation_delay=2)), observations()
    through.start(sent[0], everyone())
    for step in range(1, 10):
        through.observe(sent[step])
    fresh = np.arange(NUM) % 3 == 0
    # The last step of the old episode was observed above.
    received = [through.start(sent[50], fresh)]
    received += [through.observe(sent[step]) for step in range(10, 14)]
    expected = [(7, 50), (8, 50), (9, 50), (10, 10), (11, 11)]
    for row, (old, new) in zip(received, expected, strict=True):
        np.testing.assert_array_equal(row, np.where(fresh[:, None], sent[new], sent[old]))


def test_a_late_observation_may_also_be_lost() -> None:
    through, sent = channel(Disturbances(observation_delay=1, packet_loss=0.5)), observations()
    last = through.start(sent[0], everyone())
    for step in range(1, 30):
        received = through.observe(sent[step])
        arrived = (received == sent[step - 1]).all(axis=1)
        np.testing.assert_array_equal(received[~arrived], last[~arrived])
        last = received
