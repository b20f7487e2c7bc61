"""RLPD: reinforcement learning with prior data (Ball et al. 2023), on TD3."""

from __future__ import annotations

from training.algorithms.td3wd import TD3wD


class RLPD(TD3wD):
    """Half of every batch from the demonstrations, LayerNorm in the critics, more updates for each step.

    What it does differently is in its numbers: `kept_share`, `layer_norm`, `updates_per_step`. Demonstrations are
    kept apart from what is collected, so half of the samples are theirs however much that becomes. In the preset
    `tuned` it has as many critics, and updates for each step, as all; the experiment `rivals` gives it more of them.
    """
