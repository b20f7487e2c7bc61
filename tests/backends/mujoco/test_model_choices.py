"""The variants of the MuJoCo model that are timed: which of them move as the chosen one does."""

from __future__ import annotations

import numpy as np
import pytest

from backends.mujoco.model_choices import Choice, cheapest, model_choices
from cdcsr.robot.description import Robot


def test_faithful_variants_move_as_ours_does_and_others_do_not(paper: Robot) -> None:
    """With one guide a link, a cable cuts the corner at each joint. The pieces of a cable inside a
    link never change, so leaving them out changes nothing."""
    commands = np.repeat(
        -paper.servos[0].eta * np.random.default_rng(0).random((2, 4, paper.num_cables)), 10, axis=1
    )
    soft = "MuJoCo's own soft limits"
    bends, guides = (
        f"soft limits, {what}"
        for what in ("cables measured only where they bend", "one guide a link")
    )
    names = ("solver Newton", soft, bends, guides)
    found = {choice.name: choice for choice in model_choices(paper, commands, rounds=1, only=names)}
    assert list(found) == ["ours", *names]
    assert found["ours"].distance == 0
    assert found["solver Newton"].distance < 1e-3
    assert found["solver Newton"].faithful
    assert not found[soft].faithful
    assert found[bends].distance == pytest.approx(found[soft].distance, abs=1e-6)
    assert found[guides].distance > found[soft].distance + 1


def test_cheapest_is_among_the_faithful() -> None:
    choices = [
        Choice("ours", 50, 1, 0, True),
        Choice("wrong", 10, 0.2, 5, True),
        Choice("soft", 9, 0.1, 0, False),
    ]
    choices.append(Choice("lost", 9, 0.1, np.nan, True))
    assert cheapest(choices).name == "ours"
    assert cheapest([*choices, Choice("better", 40, 0.8, 0.01, True)]).name == "better"
