"""The description of a run: its names, its plain data, what it may be."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from cdcsr.errors import CdcsrError
from cdcsr.reading import digest
from training.algorithms.registry import ALGORITHMS, own_numbers
from training.config.run_description import PresetName, RunDescription


def test_a_name_says_what_the_run_is() -> None:
    run = RunDescription(algorithm="td3", num_demonstrations=5, updates=77, seed=2)
    assert run.name == "td3-tuned_anchor_mujoco_d5_u77_s2"
    run = replace(run, task="quiet", randomize=0.5, changes=(("hidden", (8, 8)), ("critics", 3)))
    assert run.name.endswith("_s2_quiet_r0.5_critics=3_hidden=8x8")
    assert replace(run, start="moving").name.endswith("_s2_quiet_moving_r0.5_critics=3_hidden=8x8")


def test_plain_data_bring_it_back() -> None:
    run = RunDescription(space="spatter", seed=3, changes=(("hidden", (8, 8)), ("practice", 0.3)))
    assert RunDescription.from_dict(json.loads(json.dumps(run.as_dict()))) == run


def test_an_older_record_is_read() -> None:
    older = {"algorithm": "bc", "preset": "paper", "demonstrations": 5, "switches": {"critics": 3}}
    run = RunDescription.from_dict(older)
    assert (run.preset, run.num_demonstrations) == ("paper-reading", 5)
    assert run.changes == (("critics", 3),)
    assert run.start == "still"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"colour": "red"}, "colour"),
        ({"preset": "fast"}, "Unknown preset 'fast'"),
        ({"start": "anywere"}, "Unknown start 'anywere'. Did you mean 'anywhere'"),
        ({"seed": 2**64}, "seed must be a whole number from 0 to 9223372036854775807"),
        ({"seed": "0"}, "seed must be a whole number"),
        ({"frame_skip": 10**12}, "frame_skip must be a whole number"),
        ({"randomize": 6.0}, "scale of randomization"),
        (
            {"num_demonstrations": -1},
            "num_demonstrations must be a whole number from 0 to 100000, not -1",
        ),
        ({"preset": "/../../../x"}, "Unknown preset"),
        ({"algorithm": "../x"}, "The algorithm of a run must be a name"),
        ({"backend": "/etc/x"}, "The backend of a run must be a name"),
        ({"space": "..\\x.npz"}, "The space of a run must be a name"),
        ({"task": "a/../../b"}, "The task of a run must be a name"),
        ({"task": ["reach"]}, "The task of a run must be a name"),
    ],
)
def test_what_cannot_be_a_run_is_refused(data: dict[str, object], message: str) -> None:
    with pytest.raises(CdcsrError, match=message):
        RunDescription.from_dict(data)


_STORED: tuple[PresetName, ...] = ("paper-reading", "tuned")


def own_digest(algorithm: str) -> str:
    """Return a digest of all numbers that an algorithm has in the presets of stored runs."""
    found = [
        own_numbers(algorithm, preset, task).model_dump(mode="json")
        for preset in _STORED
        for task in ("reach", "capture", "follow-line")
    ]
    return digest(json.dumps(found, sort_keys=True).encode())[:8]


def test_stored_runs_mean_the_numbers_that_they_were_trained_with() -> None:
    """Names and records of runs, and the cards of policies, hold what differs from an algorithm's
    own numbers. Whoever changes one of these makes another run of each that is stored: give the
    algorithm another name, or measure its runs anew, and then write its digest here."""
    assert {name: own_digest(name) for name in ALGORITHMS} == {
        "bc": "27ba9a08",
        "batd3": "cdd7be66",
        "clasp": "c0dbb753",
        "td3wd": "dd3d8bd7",
        "rbl": "7eeea86e",
        "td3": "2492eb0e",
        "her": "60e7b9ef",
        "rlpd": "c04f9987",
        "drldr": "65040f0c",
        "batd3-no-bc": "5472658d",
        "batd3-no-prefill": "79939aa2",
        "batd3-no-ensemble": "e661413b",
    }
