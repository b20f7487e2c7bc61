"""Random numbers for runs side by side."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import stats

from training.device.streams import Streams, keys

CPU = torch.device("cpu")


def test_bits_are_those_of_splitmix64() -> None:
    # Published values for the state 1234567.
    expected = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    streams = Streams([1234567], CPU)
    found = torch.cat([streams.bits(2), streams.bits(3)], 1)[0]
    assert [int(number) & (2**64 - 1) for number in found] == expected


def test_distributions() -> None:
    streams, like = Streams(keys([0, 1], 0), CPU), torch.zeros(2, 100_000)
    for run in streams.uniform(like).numpy():
        assert stats.kstest(run, "uniform").pvalue > 1e-3
        assert run.min() > 0
        assert run.max() < 1
    first, second = streams.normal(like).numpy()
    assert stats.kstest(first, "norm").pvalue > 1e-3
    assert abs(np.corrcoef(first, second)[0, 1]) < 5 / np.sqrt(100_000)
    assert abs(np.corrcoef(first[1:], first[:-1])[0, 1]) < 5 / np.sqrt(100_000)
    counts = torch.bincount(streams.below(7, 70_000)[0], minlength=7).numpy()
    assert stats.chisquare(counts).pvalue > 1e-3
    pairs = np.array([np.sort(streams.subset(4, 2)[0].numpy()) for _ in range(6_000)])
    counts = np.bincount(pairs[:, 0] * 4 + pairs[:, 1], minlength=16)
    assert stats.chisquare(counts[[1, 2, 3, 6, 7, 11]]).pvalue > 1e-3
    assert counts.sum() == counts[[1, 2, 3, 6, 7, 11]].sum()  # two different ones


def test_extremes_stay_finite() -> None:
    streams = Streams([0], CPU)
    lowest, highest = torch.zeros(1, 1, dtype=torch.int64), torch.full((1, 1), -1)
    for bits in (lowest, highest):
        streams.bits = lambda num, bits=bits: bits  # type: ignore[method-assign]  # noqa: ARG005
        assert torch.isfinite(streams.normal(torch.zeros(1, 1))).all()


def test_a_run_draws_alone_what_it_draws_beside_others() -> None:
    together, alone = Streams(keys([3, 4, 5], 1), CPU), Streams(keys([5], 1), CPU)
    for _ in range(3):
        ours, theirs = (s.normal(torch.zeros(n, 2, 5)) for s, n in ((together, 3), (alone, 1)))
        assert torch.equal(ours[2:], theirs)
    assert int(together.drawn) == int(alone.drawn) == 30


def test_numbers_that_are_found_together_are_the_same() -> None:
    one, other = Streams([3, 4], CPU), Streams([3, 4], CPU)
    for _ in range(3):
        with one.together("work"):
            found = one.below(9, 5), one.normal(torch.zeros(2, 3, 2)), one.subset(4, 2)
        expected = other.below(9, 5), other.normal(torch.zeros(2, 3, 2)), other.subset(4, 2)
        for ours, theirs in zip(found, expected, strict=True):
            assert torch.equal(ours, theirs)
        assert torch.equal(one.bits(2), other.bits(2))
    with pytest.raises(AssertionError), one.together("work"):
        one.bits(1)


@pytest.mark.parametrize("purpose", [0, 1])
def test_keys_differ(purpose: int) -> None:
    found = keys(range(1000), purpose)
    assert len({*found, *keys(range(1000), 1 - purpose)}) == 2000


def splitmix64(key: int, num: int) -> list[int]:
    """Return numbers as Steele, Lea and Flood 2014 print it (fig. 16), in whole numbers."""
    whole, found = 2**64, []
    for n in range(1, num + 1):
        z = (key + n * 0x9E3779B97F4A7C15) % whole
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 % whole
        z = (z ^ (z >> 27)) * 0x94D049BB133111EB % whole
        found.append(z ^ (z >> 31))
    return found


def test_numbers_follow_from_the_bits_for_keys_of_any_size() -> None:
    """The highest 23 digits make a number from 0 to 1, in the middle of its step; all but the
    lowest one make a whole number."""
    several = [0, 1, 2**63 - 1, 2**63, 2**64 - 1]
    bits = np.array([splitmix64(key, 12) for key in several], dtype=np.uint64)
    streams, like = Streams(several, CPU), torch.zeros(5, 2, 2)
    expected = ((bits >> np.uint64(41)) + 0.5) / 2**23
    np.testing.assert_allclose(streams.uniform(like).flatten(1), expected[:, :4], rtol=1e-6)
    normal = stats.norm.ppf(expected[:, 4:8])
    np.testing.assert_allclose(streams.normal(like).flatten(1), normal, rtol=1e-3, atol=1e-5)
    assert streams.below(1000, 1).tolist() == ((bits[:, 8:9] >> np.uint64(1)) % 1000).tolist()
    limits = torch.tensor([[1], [2], [3], [50], [2**40]])
    drawn = (bits[:, 9:10] >> np.uint64(1)) % limits.numpy().astype(np.uint64)
    assert streams.below(limits, 1).tolist() == drawn.tolist()
    assert int(streams.drawn) == 10
    order = bits[:, 10:].astype(np.int64).argsort(axis=1)
    assert streams.subset(2, 2).tolist() == order.tolist()
    for purpose in (0, 3):
        numbers = [splitmix64(seed % 2**64, purpose + 1)[-1] for seed in (-1, 5)]
        assert keys([-1, 5], purpose) == numbers
