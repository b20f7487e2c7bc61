"""The seeds of the targets that measure, and that nothing may learn from."""

from __future__ import annotations

TEST_SEED = 10_000
"""Seed of the held-out targets. Every reported number is measured on them; nothing is tuned on
them."""
VALIDATION_SEED = 20_000
"""Seed of the targets on which a run is watched while it learns, and on which things are tuned."""
EVALUATION_SEEDS = {TEST_SEED: "held-out targets", VALIDATION_SEED: "validation targets"}
