"""Learn on a device: what :mod:`training.run.trainer` does, for S runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from training.algorithms.reference_update import Layer, Networks, parameters, update
from training.algorithms.td3 import TD3, BackboneNumbers
from training.config.learner import Demonstrated
from training.device.collector import DeviceCollector
from training.device.graphs import Repeated
from training.device.networks import adam, copied, side_by_side, stacked_actor, stacked_ensemble
from training.device.replay import DeviceReplay
from training.device.streams import Streams, keys
from training.networks.encoder import Encoder

_PURPOSE = 2
METRICS = "critic_loss", "value", "actor_loss"


def make_networks(
    algorithms: Sequence[TD3[BackboneNumbers]], learner: BackboneNumbers, device: torch.device
) -> Networks:
    """Return the networks of runs side by side, with the weights of their algorithms."""
    actor = side_by_side([stacked_actor(one.actor) for one in algorithms], device)
    critics = side_by_side(
        [stacked_ensemble(one.critics.ensemble, one.critics.ensemble.rows) for one in algorithms],
        device,
    )
    return Networks(
        actor,
        critics,
        copied(actor),
        copied(critics),
        adam(actor, learner.learning_rate),
        adam(critics, learner.learning_rate),
        torch.zeros((), dtype=torch.int64, device=device),
    )


class DeviceLearner:
    """Draw, update and average, without a word to the processor.

    Args:
        learner: the numbers.
        networks: of the runs.
        collector: has begun.
        replay: what it fills.
        encoder: of the runs' actors.
        shown: the demonstrations, encoded, and their actions, if the replay begins with them.
        seeds: of the runs.
        device: where everything is.

    Attributes:
        totals: sums of losses and values since they were last taken, each of shape (S,).
    """

    def __init__(
        self,
        learner: BackboneNumbers,
        networks: Networks,
        collector: DeviceCollector,
        replay: DeviceReplay,
        encoder: Encoder,
        shown: tuple[Tensor, Tensor] | None,
        seeds: Sequence[int],
        device: torch.device,
    ) -> None:
        self.learner, self.networks, self.collector = learner, networks, collector
        self._replay, self._encoder, self._shown = replay, encoder, shown
        self.draws = Streams(keys(seeds, _PURPOSE), device)
        self.totals = {name: torch.zeros(len(seeds), device=device) for name in METRICS}
        self._share = (learner.kept_share or None) if isinstance(learner, Demonstrated) else None
        self._critics_turn, self._actors_turn = (
            Repeated(partial(self._update, actors_turn=turn), device) for turn in (False, True)
        )
        self.taken, self._longest = {"updates": 0, "actor_updates": 0}, collector.longest

    @property
    def ready(self) -> bool:
        """Whether a batch can be drawn: from demonstrations, or from complete episodes.

        Every copy has completed an episode after the longest one and the step that ends it. What
        clones reached does not count, as it differs from run to run.
        """
        shown = 0 if self._shown is None else len(self._shown[0])
        return shown >= self.learner.batch_size or self.collector.steps > self._longest + 1

    @property
    def policy(self) -> list[Layer]:
        """The networks that are measured and kept; the actors themselves always explore."""
        networks = self.networks
        return networks.target_actor if self.learner.averaged_policy else networks.actor

    def update(self, number: int) -> None:
        """Make the update of a number, which counts from 1."""
        turn = number % self.learner.policy_delay == 0
        (self._actors_turn if turn else self._critics_turn)()
        self.taken["updates"] += 1
        self.taken["actor_updates"] += turn

    def _update(self, *, actors_turn: bool) -> None:
        with self.draws.together("actor" if actors_turn else "critics"):
            self._draw_and_update(actors_turn=actors_turn)

    def _draw_and_update(self, *, actors_turn: bool) -> None:
        with torch.no_grad():
            batch = self._replay.sample(self.learner.batch_size, self.draws, self._share)
            batch = batch._replace(
                observation=self._encoder(batch.observation),
                next_observation=self._encoder(batch.next_observation),
            )
        metrics = update(
            self.networks, batch, self.learner, self.draws, self._shown, actors_turn=actors_turn
        )
        for name, value in metrics.items():
            self.totals[name] += value

    def take_metrics(self) -> list[dict[str, float]]:
        """Return the mean losses and values of every run since this was last called."""
        counts = {name: self.taken["updates"] for name in METRICS}
        counts["actor_loss"] = self.taken["actor_updates"]
        means = {
            name: (total / max(1, counts[name])).tolist() for name, total in self.totals.items()
        }
        for total in self.totals.values():
            total.zero_()
        self.taken = dict.fromkeys(self.taken, 0)
        runs = len(next(iter(means.values())))
        return [{name: means[name][run] for name in METRICS if counts[name]} for run in range(runs)]

    def views(self, run: int) -> dict[str, Tensor]:
        """Return all that determines how a run goes on, but for its engine, by name.

        The tensors are views: to write into them is to put the run back.
        """
        networks, found = self.networks, {"updates": self.networks.updates}
        stacks = {
            "actor": networks.actor,
            "critics": networks.critics,
            "target_actor": networks.target_actor,
            "target_critics": networks.target_critics,
        }
        for name, layers in stacks.items():
            found |= {f"{name}.{i}": x.detach()[run] for i, x in enumerate(parameters(layers))}
        for name, optimizer in (
            ("actor_optimizer", networks.actor_optimizer),
            ("critic_optimizer", networks.critic_optimizer),
        ):
            for i, state in enumerate(optimizer.state.values()):
                found |= {
                    f"{name}.{i}.{key}": value[run] if value.dim() else value
                    for key, value in state.items()
                }
        stored = self._replay.views(run, self.collector.steps)
        found |= {f"replay.{name}": x for name, x in stored.items()}
        found |= {f"collector.{name}": x for name, x in self.collector.views(run).items()}
        return found | {"drawn": self.draws.drawn}
