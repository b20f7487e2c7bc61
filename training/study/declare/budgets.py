"""The sizes the study can be run in: seeds, training lengths and episodes."""

from __future__ import annotations

from dataclasses import dataclass

from training.config.run_description import PresetName


@dataclass(frozen=True)
class Budget:
    """How many seeds, updates and episodes the study uses. All methods get the same."""

    name: str
    seeds: int
    own_seeds: int
    """Seeds of a run that has demonstrations of its own."""
    updates: int
    """Updates of a run with the preset `tuned`."""
    paper_updates: int
    """Updates of a run with the paper's numbers."""
    episodes: int
    """Episodes in each cell of an evaluation."""
    evaluate_every: int
    """Updates between two points of a learning curve. Each point also saves a checkpoint."""
    validation_episodes: int
    """Episodes for each point of a learning curve."""

    def length(self, preset: PresetName) -> int:
        """Return the number of updates of a run with this preset."""
        return self.updates if preset == "tuned" else self.paper_updates


BUDGETS = {
    budget.name: budget
    for budget in (
        Budget("quick", 1, 1, 1_500, 1_500, 20, 500, 20),
        Budget("standard", 3, 5, 6_000, 20_000, 100, 750, 100),
        Budget("paper", 5, 5, 12_000, 100_000, 100, 1_000, 100),
    )
}
