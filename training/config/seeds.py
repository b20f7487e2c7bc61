"""Which targets are held out, and which are not: those of all episodes are drawn by a seed."""

from __future__ import annotations

TEST_SEED = 10_000
"""Of the held-out targets every reported number is measured on. Nothing is ever tuned on them."""
VALIDATION_SEED = 20_000
"""Of the targets a run is watched on while it learns, and things are tuned on."""
