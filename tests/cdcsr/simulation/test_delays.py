"""The delay line against numbers counted by hand."""

from __future__ import annotations

import numpy as np

from cdcsr.simulation.delay_line import DelayLine


def numbers(line: DelayLine, first: int, count: int) -> np.ndarray:
    """Send first, first + 1, ... to each copy and return what arrives, shape (count, num)."""
    return np.stack(
        [line.push(np.full((3, 1), float(k)))[:, 0] for k in range(first, first + count)]
    )


def test_each_copy_is_late_by_its_own_delay() -> None:
    line = DelayLine(3, 1)
    assert line.idle
    line.set_delay(np.arange(3), np.array([0, 1, 3]))
    assert not line.idle
    np.testing.assert_array_equal(
        numbers(line, 1, 5), [[1, 0, 0], [2, 1, 0], [3, 2, 0], [4, 3, 1], [5, 4, 2]]
    )
    np.testing.assert_array_equal(line.sent[0, :, 0], [3, 4, 5])


def test_a_longer_delay_waits_with_zeros_and_a_shorter_one_skips() -> None:
    line = DelayLine(3, 1)
    line.set_delay(np.arange(3), np.array([1, 1, 1]))
    numbers(line, 1, 4)
    line.set_delay(np.array([1, 2]), np.array([3, 0]))
    np.testing.assert_array_equal(numbers(line, 5, 4), [[4, 0, 5], [5, 0, 6], [6, 4, 7], [7, 5, 8]])
    line.set_delay(np.array([1]), np.array([0]))
    np.testing.assert_array_equal(numbers(line, 9, 1), [[8, 9, 9]])


def test_filled_copies_receive_what_they_are_filled_with() -> None:
    line = DelayLine(3, 1)
    line.set_delay(np.arange(3), np.array([2, 2, 2]))
    numbers(line, 1, 3)
    line.fill(np.array([1]), np.array([[-1.0]]))
    np.testing.assert_array_equal(numbers(line, 4, 3), [[2, -1, 2], [3, -1, 3], [4, 4, 4]])


def test_a_line_continues_from_what_another_had_sent() -> None:
    one, other = DelayLine(3, 1), DelayLine(3, 1)
    one.set_delay(np.arange(3), np.array([0, 2, 4]))
    other.set_delay(np.arange(3), np.array([0, 2, 2]))
    numbers(one, 1, 6)
    other.sent = one.sent
    np.testing.assert_array_equal(numbers(other, 7, 2), [[7, 5, 5], [8, 6, 6]])
    one.sent = other.sent  # the older rows are not known
    np.testing.assert_array_equal(numbers(one, 9, 2), [[9, 7, 0], [10, 8, 0]])
