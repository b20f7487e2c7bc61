"""The replay of steps draws the transitions that the replay of episodes stores."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.stats import chisquare

from training.device.replay import DeviceReplay, Step
from training.device.streams import Streams
from training.experience.replay import Batch, Replay

RUNS, COPIES, LONGEST, RETURN_STEPS = 2, 3, 12, 4
CPU, DISCOUNT = torch.device("cpu"), 0.9


def _host() -> Replay:
    return Replay(10_000, 1, 1, DISCOUNT, RETURN_STEPS)


def _fill(replay: DeviceReplay, steps: int, seed: int = 0) -> list[Replay]:
    """Send episodes of random lengths and rewards to a replay, and to one of episodes each run.

    Every observation is another number, by which a transition is known; -1 in an episode's rows
    marks those that diverged, which only the replay of steps sees.
    """
    rng, hosts = np.random.default_rng(seed), [_host() for _ in range(RUNS)]
    length = rng.integers(1, LONGEST, size=(RUNS, COPIES), endpoint=True)
    begun = np.zeros((RUNS, COPIES), dtype=np.int64)
    seen: list[NDArray[np.floating[Any]]] = []
    for step in range(steps):
        number = 1.0 + np.arange(RUNS * COPIES).reshape(RUNS, COPIES) + step * RUNS * COPIES
        action, clone = rng.uniform(-1, 1, (2, RUNS, COPIES))
        reward = rng.uniform(0, 1, (RUNS, COPIES))
        last = step - begun == length
        terminated = last & (length % 2 == 0)
        dropped = last & (length == 5)
        seen.append(np.stack([number, action, clone, reward]))
        parts = [torch.tensor(x, dtype=torch.float32)[..., None] for x in (number, action, clone)]
        flags = [torch.from_numpy(x) for x in (last, terminated & ~dropped, dropped)]
        replay.write(Step(parts[0], parts[1], parts[2], flags[0], flags[1], flags[2]))
        replay.finish(torch.tensor(reward, dtype=torch.float32))
        for run, copy in np.argwhere(last):
            rows = np.array(seen)[begun[run, copy] : step + 1, :, run, copy]
            if not dropped[run, copy]:
                hosts[run].add_episode(
                    rows[:, :1], rows[:-1, 1:2], rows[:-1, 3], terminated[run, copy], rows[:, 2:3]
                )
            begun[run, copy] = step + 1
            length[run, copy] = rng.integers(1, LONGEST, endpoint=True)
    return hosts


def _device(steps: int, prefilled: list[Replay] | None = None) -> DeviceReplay:
    shape = RUNS, COPIES, steps
    kept = [_host() for _ in range(RUNS)] if prefilled is None else prefilled
    return DeviceReplay(shape, (1, 1), LONGEST, DISCOUNT, RETURN_STEPS, kept, CPU)


def _known(host: Replay) -> dict[float, Batch]:
    """Return the transitions of a replay of episodes by their first observation."""
    found = {}
    for row in np.flatnonzero(host.rows["successor"][: host.size] >= 0):
        after = host.rows["successor"][row]
        names = {name: host.rows[name][row] for name in host.rows if name != "successor"}
        later = {f"next_{name}": host.rows[name][after] for name in ("observation", "bc_action")}
        found[float(names["observation"][0])] = Batch(**{**names, **later})
    return found


@pytest.mark.parametrize("steps", [90, 1000])
def test_transitions_are_those_of_whole_episodes(steps: int) -> None:
    # 300 steps are made: one ring is overwritten three times, the other never.
    replay = _device(steps)
    hosts = _fill(replay, 300)
    batch = replay.sample(20_000, Streams([1, 2], CPU))
    for run, host in enumerate(hosts):
        known, drawn = _known(host), set(batch.observation[run, :, 0].tolist())
        for i in range(1000):
            row = Batch(*(part[run, i] for part in batch))
            number = float(row.observation[0])
            for found, expected in zip(row, known[number], strict=True):
                np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
        kept = {n for n in known if n > RUNS * COPIES * max(0, 300 - steps)}
        assert drawn == kept  # all of them, and none that is overwritten, incomplete or dropped
        assert int(replay.tensors["count"][run]) == len(kept)


def test_all_transitions_are_drawn_alike_while_the_ring_fills() -> None:
    replay = _device(500)
    hosts = _fill(replay, 300)
    drawn = replay.sample(40_000, Streams([1, 2], CPU)).observation[..., 0]
    for run, host in enumerate(hosts):
        known = torch.tensor(sorted(_known(host)))
        times = torch.bincount(torch.searchsorted(known, drawn[run]), minlength=len(known))
        assert chisquare(times.numpy()).pvalue > 1e-4


def test_what_was_there_from_the_start_is_drawn_by_its_share() -> None:
    rng, prefilled = np.random.default_rng(3), [_host() for _ in range(RUNS)]
    for run, host in enumerate(prefilled):
        for _ in range(3 + run):
            rows = -rng.uniform(1, 2, (31, 1))
            host.add_episode(rows, rows[1:], np.ones(30), True, rows)
    replay = _device(500, prefilled)
    draws = Streams([1, 2], CPU)
    everything = replay.sample(2048, draws)
    assert (everything.observation < 0).all()  # nothing is collected yet
    for run, host in enumerate(prefilled):
        known = set(host.rows["observation"][: host.size, 0].tolist())
        assert set(everything.observation[run, :, 0].tolist()) <= known
        assert len(set(everything.observation[run, :, 0].tolist())) == 30 * (3 + run)
    _fill(replay, 400)
    size = 20_000
    share = (replay.sample(size, draws).observation < 0).float().mean(1).squeeze()
    counts = replay.tensors["count"].numpy()
    for run in range(RUNS):
        expected = 30 * (3 + run) / (30 * (3 + run) + counts[run])
        # Five standard deviations of a share.
        assert abs(float(share[run]) - expected) < 5 * np.sqrt(expected / size)
    half, more = ((replay.sample(n, draws, 0.5).observation < 0).float() for n in (600, 2000))
    assert half.mean(1).flatten().tolist() == pytest.approx([0.5, 0.5], abs=0.01)
    assert more.all()  # there are fewer than that yet


def test_a_run_alone_draws_the_same() -> None:
    both, alone = (
        _device(90),
        DeviceReplay((1, COPIES, 90), (1, 1), LONGEST, DISCOUNT, RETURN_STEPS, [_host()], CPU),
    )
    _fill(both, 200)
    for name, rows in both.tensors.items():
        if name == "time":
            alone.tensors[name].copy_(rows)
        else:
            part = rows[1:2] if name in ("age", "count") else rows[:, 1:2]
            alone.tensors[name].copy_(part)
    first, second = both.sample(64, Streams([1, 2], CPU)), alone.sample(64, Streams([2], CPU))
    for ours, theirs in zip(first, second, strict=True):
        assert torch.equal(ours[1:], theirs)


def test_the_memory_that_is_told_is_that_of_the_rows() -> None:
    shape, sizes = (2, 3, 50), (5, 4)
    empty = [Replay(1, *sizes, DISCOUNT, 2) for _ in range(2)]
    replay = DeviceReplay(shape, sizes, LONGEST, DISCOUNT, 2, empty, CPU)
    rows = [x for x in replay.tensors.values() if x.shape[:1] == (50,)]
    assert sum(x.nbytes for x in rows) == DeviceReplay.memory(shape, sizes)


def test_rare_transitions_fill_a_batch() -> None:
    """Where all tries of a place of the batch miss, another one's transition stands in. Of 600 rows
    two begin one, so that 8 tries miss nearly always."""
    replay = _device(200)
    for step in range(150):
        last = torch.full((RUNS, COPIES), step == 2)
        seen = torch.full((RUNS, COPIES, 1), float(step))
        dropped = last & (torch.arange(COPIES) > 0)
        age = replay.tensors["age"]
        replay.write(Step(seen, seen, seen, last, ~last & last, dropped))
        replay.finish(torch.ones(RUNS, COPIES))
        age.clamp_(max=LONGEST - 1)
    assert replay.tensors["count"].tolist() == [2, 2]
    batch = replay.sample(400, Streams([1, 2], CPU))
    for run in range(RUNS):
        assert set(batch.observation[run, :, 0].tolist()) == {0.0, 1.0}
