"""The list of algorithms: their numbers, titles, colours and order."""

from __future__ import annotations

import dataclasses

import pytest

from cdcsr.errors import CdcsrError
from cdcsr.files import JsonObject
from tests.support.paths import ROOT
from training.algorithms.registry import (
    ALGORITHMS,
    algorithm_color,
    algorithm_order,
    algorithm_title,
    differences,
    numbers_of,
    own_numbers,
)
from training.config.run_description import RunDescription
from training.study.lines import read_records


def test_what_rlpd_and_her_have_of_their_own() -> None:
    rlpd = own_numbers("rlpd", "paper-reading").model_dump()
    assert (rlpd["kept_share"], rlpd["layer_norm"], rlpd["updates_per_step"]) == (0.5, True, 20)
    tuned, td3 = (own_numbers(name, "tuned").model_dump() for name in ("rlpd", "td3"))
    assert (tuned["kept_share"], tuned["layer_norm"]) == (0.5, True)
    # With more updates a step it would have less experience than the others.
    assert tuned["updates_per_step"] == td3["updates_per_step"]
    for preset in ("paper-reading", "tuned"):  # Andrychowicz et al. 2017: four targets
        her = own_numbers("her", preset).model_dump()
        assert her == {**own_numbers("td3", preset).model_dump(), "hindsight": 4}
    pair = own_numbers("batd3-no-ensemble", "paper-reading").model_dump()
    assert pair["critics"] == 2


def test_a_preset_is_what_the_pages_say_of_it() -> None:
    """docs/getting-started.md and docs/learners.md: runs of 12,000 updates; on a GPU 1,024 copies,
    batches of 1,024 rows, two updates a step and a larger replay."""
    tuned, gpu = own_numbers("clasp", "tuned"), own_numbers("clasp", "gpu")
    numbers = tuned.model_dump()
    assert (numbers["updates"], numbers["critics"]) == (12_000, 2)
    assert dict(differences(gpu, tuned)) == {
        "num_envs": 1_024,
        "batch_size": 1_024,
        "updates_per_step": 2,
        "capacity": 2 * numbers["capacity"],
    }
    single = own_numbers("batd3-no-ensemble", "tuned").model_dump()
    assert (single["critics"], single["target_critics"]) == (1, 1)


def test_the_stored_runs_were_made_with_the_numbers_of_their_presets() -> None:
    """So the shipped tables say how a run of today learns. Left out are runs that changed numbers,
    and numbers that a run is older than."""
    runs: dict[str, JsonObject] = read_records(ROOT / "results")
    seen = set()
    for name, run in runs.items():
        spec, numbers = run["spec"], run.get("learner")
        if numbers and not spec.get("switches") and not spec.get("changes"):
            own = own_numbers(spec["algorithm"], spec["preset"], spec["task"])
            own = own.model_dump(mode="json", exclude={"updates"})
            expected = {key: value for key, value in own.items() if key in numbers}
            assert {key: numbers[key] for key in expected} == expected, name
            seen.add(spec["algorithm"])
    assert seen > {"bc", "batd3", "clasp", "td3", "rlpd"}


@pytest.mark.parametrize(
    ("algorithm", "allowed", "refused"),
    [
        ("her", {"hindsight": 0}, {"hindsight": -1}),
        ("her", {"hindsight": 1000}, {"hindsight": 1001}),
        ("rlpd", {"kept_share": 0.0}, {"kept_share": -0.01}),
        ("rlpd", {"kept_share": 0.99}, {"kept_share": 1.0}),
        ("td3", {"critics": 2, "target_critics": 2}, {"critics": 2, "target_critics": 3}),
    ],
)
def test_numbers_stay_within_their_bounds(
    algorithm: str, allowed: dict[str, float], refused: dict[str, float]
) -> None:
    own = own_numbers(algorithm, "tuned")
    assert own.changed(**allowed).model_dump().items() >= allowed.items()
    with pytest.raises(CdcsrError, match=next(reversed(refused))):
        own.changed(**refused)


def test_every_algorithm_has_a_title_a_colour_and_a_place_in_tables() -> None:
    """The study's come first, then controllers that do not learn, then unknown ones."""
    names = [*ALGORITHMS, "jacobian", "nearest", "someone's"]
    assert [algorithm_order(name) for name in names] == list(range(len(names)))
    assert (algorithm_title("clasp"), algorithm_title("jacobian")) == (
        "CLASP (ours)",
        "demonstrator",
    )
    assert algorithm_title("someone's") == "someone's"
    main = [name for name, one in ALGORITHMS.items() if not one.ablation]
    assert [name for name in ALGORITHMS if name.startswith("batd3-")] == [
        name for name in ALGORITHMS if name not in main
    ]
    colors = [algorithm_color(name) for name in (*main, "jacobian", "nearest")]
    assert len(set(colors)) == len(colors)  # none can be taken for another in one plot
    assert algorithm_color("someone's") == algorithm_color("nearest")


def test_a_run_has_its_own_length_unless_it_asks_for_another() -> None:
    run = RunDescription(algorithm="td3", changes=(("critics", 4),))
    assert numbers_of(run).model_dump() == own_numbers("td3", "tuned").model_dump() | {"critics": 4}
    longer = numbers_of(dataclasses.replace(run, updates=77)).model_dump()
    assert longer == numbers_of(run).model_dump() | {"updates": 77}
    clone = RunDescription(algorithm="bc", updates=77)  # whose length is in updates of the clone
    assert numbers_of(clone) == own_numbers("bc", "tuned")
    td3, other = own_numbers("td3", "tuned"), own_numbers("td3", "tuned").changed(critics=4)
    assert differences(other, td3) == (("critics", 4),)
    assert differences(td3, td3) == ()
