"""TD3 with a randomized ensemble of critics: the backbone of every method here.

TD3: Fujimoto et al. 2018 (clipped noise on the target action, delayed actor). The ensemble is that of REDQ,
Chen et al. 2021: each target is the minimum over Z critics drawn at random from E. With E = Z = 2, as in the preset
`tuned`, that is TD3's own pair.
"""

from __future__ import annotations

import copy
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from cdcsr.robot.description import Robot
from cdcsr.tasks.task import Reward
from training.config.run_config import Learner
from training.experience.replay import Batch
from training.networks.actor import Actor
from training.networks.bfloat16 import matrix_products
from training.networks.critics import Critics

IMITATING = frozenset({"clone_anchor", "anchor_updates", "anchor_floor", "self_imitation"})
"""The numbers of a learner whose actor is held to the clone, and to what went well."""


class TD3:
    """A deterministic actor and E critics with target copies.

    A variant overrides `next_value` (what a target bootstraps from), and says by its class attributes what
    its replay buffer is filled with before learning begins.

    Args:
        robot: the description.
        learner: the learner's numbers.
        generator: draws target noise and the subsets of critics.
    """

    uses_demonstrations: ClassVar[bool] = False
    """Demonstrations are put into the replay buffer."""
    uses_clone: ClassVar[bool] = False
    """A behaviour clone is trained first, and its actions go into the replay buffer with every row."""
    uses_rollouts: ClassVar[bool] = False
    """The clone's successful episodes are put into the replay buffer."""
    reward: ClassVar[Reward] = "sparse"
    """What is learned from."""
    heeds: ClassVar[frozenset[str]] = frozenset()
    """Those numbers of the learner that not every method looks at, and this one does."""

    def __init__(self, robot: Robot, learner: Learner, generator: torch.Generator) -> None:
        self.learner = learner
        self.actor = Actor(
            robot, learner.features == "state+error", learner.hidden, "relu", learner.symmetry
        )
        inputs = self.actor.encoder.size + robot.num_cables
        self.critics = Critics(inputs, learner.hidden, learner.critics, learner.layer_norm)
        self.target_actor = copy.deepcopy(self.actor).requires_grad_(False)
        self.target_critics = copy.deepcopy(self.critics).requires_grad_(False)
        self._actor_parameters = list(self.actor.parameters())
        self._critic_parameters = list(self.critics.parameters())
        self.actor_optimizer = torch.optim.Adam(
            self._actor_parameters, lr=learner.learning_rate, fused=True
        )
        self.critic_optimizer = torch.optim.Adam(
            self._critic_parameters, lr=learner.learning_rate, fused=True
        )
        self.updates = 0
        self._generator = generator

    def show(self, observations: Tensor, commands: Tensor) -> None:
        """Take what the demonstrator saw, shape (N, observation size), and did, set-points in [m], shape (N, C): for variants."""

    @property
    def policy(self) -> Actor:
        """The network that is measured and kept; exploration is always the actor's own."""
        return self.target_actor if self.learner.averaged_policy else self.actor

    def update(self, batch: Batch) -> dict[str, Tensor]:
        """One update of the critics, and of the actor when its turn comes.

        Returns:
            Scalars worth logging.
        """
        with matrix_products(bfloat16=self.learner.bfloat16):
            return self._update(batch)

    def _update(self, batch: Batch) -> dict[str, Tensor]:
        self.updates += 1
        self._set_learning_rate()
        encoded = self.actor.encoder(batch.observation)
        with torch.no_grad():
            value = self.next_value(self.actor.encoder(batch.next_observation), batch)
            target = batch.reward + batch.discount * value
            if self.learner.clip_targets and self.reward == "sparse":
                target = target.clamp(0, 1)
        # Errors are summed over critics, so that the step of each does not depend on how many there are.
        values = self.critics.regress(encoded, batch.action, target)
        self.critic_optimizer.step()
        _follow(self.target_critics.parameters(), self._critic_parameters, self.learner.soft_update)
        metrics = {"critic_loss": (values - target).square().mean(), "value": values.mean()}
        if self.updates % self.learner.policy_delay == 0:
            metrics["actor_loss"] = self._update_actor(encoded, batch)
        return metrics

    def _set_learning_rate(self) -> None:
        learner = self.learner
        gone = min(1.0, self.updates / learner.updates) * (1 - learner.final_learning_rate)
        for optimizer in (self.actor_optimizer, self.critic_optimizer):
            for group in optimizer.param_groups:
                group["lr"] = learner.learning_rate * (1 - gone)

    def next_value(self, encoded: Tensor, batch: Batch) -> Tensor:
        """Value to bootstrap from at the end of each transition, shape (B,): TD3's smoothed target policy."""
        return self.target_value(encoded, self.smoothed_target_action(encoded))

    def smoothed_target_action(self, encoded: Tensor) -> Tensor:
        """The target policy's action with clipped noise (Fujimoto et al. 2018, eq. 15), shape (B, C)."""
        action = self.target_actor(encoded)
        noise = torch.randn(action.shape, generator=self._generator) * self.learner.target_noise
        return (action + noise.clamp(-self.learner.noise_clip, self.learner.noise_clip)).clamp(
            -1, 1
        )

    def target_value(self, encoded: Tensor, action: Tensor) -> Tensor:
        """Minimum over Z target critics drawn at random (Chen et al. 2021, eq. 1), shape (B,).

        Only the critics drawn are evaluated.
        """
        return self.target_critics(encoded, action, self._draw_critics()).amin(0)

    def _draw_critics(self) -> list[int] | None:
        num, drawn = self.learner.critics, self.learner.target_critics
        return (
            None
            if drawn == num
            else torch.randperm(num, generator=self._generator)[:drawn].tolist()
        )

    def _update_actor(self, encoded: Tensor, batch: Batch) -> Tensor:
        loss = self.actor_loss(encoded, batch)
        self.actor_optimizer.zero_grad()
        loss.backward()
        self.actor_optimizer.step()
        _follow(self.target_actor.parameters(), self._actor_parameters, self.learner.soft_update)
        return loss.detach()

    def actor_loss(self, encoded: Tensor, batch: Batch) -> Tensor:
        """What the actor descends: `policy_loss`, and the price of saturation."""
        logits = self.actor.net(encoded)
        loss = self.policy_loss(encoded, torch.tanh(logits), batch)
        if self.learner.saturation_penalty > 0:
            loss = (
                loss
                + self.learner.saturation_penalty
                * functional.relu(logits.abs() - 3).square().mean()
            )
        return loss

    def policy_loss(self, encoded: Tensor, action: Tensor, batch: Batch) -> Tensor:
        """Minus the critics' mean at the actor's own action."""
        return -self.drawn_values(encoded, action).mean()

    def anchor_loss(self, action: Tensor, batch: Batch) -> Tensor:
        """w |pi(s) - a_BC(s)|^2 for variants with a clone, w falling linearly from `clone_anchor` to `anchor_floor`."""
        learner = self.learner
        left = max(0.0, 1 - self.updates / learner.anchor_updates)
        weight = learner.anchor_floor + left * (learner.clone_anchor - learner.anchor_floor)
        return weight * distance(action, batch.bc_action).mean() if weight > 0 else torch.zeros(())

    def self_imitation_loss(self, action: Tensor, batch: Batch, expected: Tensor) -> Tensor:
        """`self_imitation` (G - V)+ |pi(s) - a|^2 (Oh et al. 2018, eq. 2), G being the return that followed (s, a).

        Args:
            action: the actor's, shape (B, C).
            batch: has a and G.
            expected: V, what critics expect of the actor's action, shape (B,).
        """
        if self.learner.self_imitation == 0:
            return torch.zeros(())
        better = (batch.outcome - expected).clamp_min(0)
        return self.learner.self_imitation * (distance(action, batch.action) * better).mean()

    def drawn_values(self, encoded: Tensor, action: Tensor) -> Tensor:
        """Values by Z critics drawn at random, shape (Z, B).

        The gradient of their mean is an unbiased estimate of that of the mean over all E, which REDQ takes, for
        Z / E of the work.
        """
        return self.critics(encoded, action, self._draw_critics())


def distance(one: Tensor, other: Tensor) -> Tensor:
    """Mean over cables of the squared difference, shape (B,)."""
    return (one - other).square().mean(-1)


def _follow(targets: object, sources: list[torch.nn.Parameter], rate: float) -> None:
    with torch.no_grad():
        torch._foreach_lerp_(list(targets), sources, rate)  # type: ignore[call-overload]
