"""TD3 with a randomized ensemble of critics: the backbone of every method here.

TD3: Fujimoto et al. 2018 (clipped noise on the target action, delayed actor). The ensemble is that
of REDQ, Chen et al. 2021: each target is the minimum over Z critics drawn at random from E. With
E = Z = 2, as in the preset `tuned`, that is TD3's own pair.
"""

from __future__ import annotations

import copy
from typing import ClassVar, Generic, Self, TypeVar

import torch
from pydantic import model_validator
from torch import Tensor
from torch.nn import functional

from cdcsr.robot.description import Robot
from cdcsr.tasks.task import Reward
from training.config.learner import Count, Members, NotNegative, Practising, Rate, Share
from training.experience.replay import Batch
from training.networks.actor import Actor
from training.networks.bfloat16 import matrix_products
from training.networks.critics import Critics


class BackboneNumbers(Practising):
    """The numbers of the backbone. Where the paper is silent, defaults are those of TD3's paper."""

    layer_norm: bool = False
    """Use LayerNorm before each hidden activation of the critics."""
    learning_rate: Rate = 1e-4
    """Learning rate of actor and critics (Adam)."""
    soft_update: Share = 0.01
    """Rate beta at which target networks follow."""
    critics: Members = 5
    """Number E of critics in the ensemble."""
    target_critics: Members = 2
    """Number Z of critics, drawn at random, whose minimum is the target."""
    target_noise: NotNegative = 0.2
    """Standard deviation of the noise on the target policy's action in [-1, 1]."""
    noise_clip: NotNegative = 0.3
    """Bound c of that noise."""
    saturation_penalty: NotNegative = 0.0
    """Weight in the actor's loss of (|z| - 3)^2 where its output tanh(z) is saturated, |z| > 3. A
    saturated output gets no gradient, so a cable that is off early might stay off for ever."""
    policy_delay: Count = 2
    """Updates of the critics for each update of the actor."""
    averaged_policy: bool = False
    """Measure and keep the target actor, a running average of the actor."""
    bfloat16: bool = False
    """Multiply matrices in bfloat16 in an update, on processors that are faster at it (AMX)."""

    @model_validator(mode="after")
    def _subset_of_critics(self) -> Self:
        if self.target_critics > self.critics:
            raise ValueError(
                f"target_critics must be at most critics ({self.critics}); "
                f"found {self.target_critics}."
            )
        return self


class TD3Numbers(BackboneNumbers):
    """The numbers of TD3 on a sparse reward."""

    clip_targets: bool = False
    """Clip targets to [0, 1], where the values of a sparse reward lie."""


N_co = TypeVar("N_co", bound=BackboneNumbers, covariant=True)


class TD3(Generic[N_co]):
    """A deterministic actor and E critics with target copies.

    A variant overrides `next_value` (what a target bootstraps from) or `policy_loss`, and says by
    its class attributes what its replay buffer is filled with before learning begins.

    Args:
        robot: the description.
        learner: the numbers.
        generator: draws target noise and the subsets of critics.
    """

    uses_demonstrations: ClassVar[bool] = False
    """Demonstrations are put into the replay buffer."""
    uses_clone: ClassVar[bool] = False
    """A behaviour clone is trained first; its action is stored with every row of the replay."""
    uses_rollouts: ClassVar[bool] = False
    """The clone's successful episodes are put into the replay buffer."""
    reward: ClassVar[Reward] = "sparse"
    """The reward that is learned from."""

    def __init__(self, robot: Robot, learner: N_co, generator: torch.Generator) -> None:
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
        """Take the demonstrations, for variants that learn from them directly.

        Args:
            observations: shape (N, size of eq. (1)).
            commands: set-points, shape (N, C), in [m].
        """

    @property
    def policy(self) -> Actor:
        """The network that is measured and kept. The actor itself always explores."""
        return self.target_actor if self.learner.averaged_policy else self.actor

    def update(self, batch: Batch) -> dict[str, Tensor]:
        """Update the critics, and the actor when its turn comes.

        Returns:
            Losses and the mean value, scalars.
        """
        with matrix_products(bfloat16=self.learner.bfloat16):
            return self._update(batch)

    def _update(self, batch: Batch) -> dict[str, Tensor]:
        self.updates += 1
        encoded = self.actor.encoder(batch.observation)
        with torch.no_grad():
            value = self.next_value(self.actor.encoder(batch.next_observation), batch)
            target = batch.reward + batch.discount * value
            if isinstance(self.learner, TD3Numbers) and self.learner.clip_targets:
                target = target.clamp(0, 1)
        # Errors are summed over critics: the step of each must not depend on their number.
        values = self.critics.regress(encoded, batch.action, target)
        self.critic_optimizer.step()
        _follow(self.target_critics.parameters(), self._critic_parameters, self.learner.soft_update)
        metrics = {"critic_loss": (values - target).square().mean(), "value": values.mean()}
        if self.updates % self.learner.policy_delay == 0:
            metrics["actor_loss"] = self._update_actor(encoded, batch)
        return metrics

    def next_value(self, encoded: Tensor, batch: Batch) -> Tensor:
        """Return the value at the end of each transition, shape (B,).

        It is that of the target policy's action with clipped noise.
        """
        return self.target_value(encoded, self.smoothed_target_action(encoded))

    def smoothed_target_action(self, encoded: Tensor) -> Tensor:
        """Return the target policy's action with clipped noise, shape (B, C).

        Source: Fujimoto et al. 2018, eq. 15.
        """
        action = self.target_actor(encoded)
        noise = torch.randn(action.shape, generator=self._generator) * self.learner.target_noise
        return (action + noise.clamp(-self.learner.noise_clip, self.learner.noise_clip)).clamp(
            -1, 1
        )

    def target_value(self, encoded: Tensor, action: Tensor) -> Tensor:
        """Return the minimum over Z target critics drawn at random, shape (B,).

        Only the drawn critics are evaluated. Source: Chen et al. 2021, eq. 1.
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
        """Return the actor's loss: `policy_loss` and the price of saturation."""
        logits = self.actor.net(encoded)
        loss = self.policy_loss(encoded, torch.tanh(logits), batch)
        if self.learner.saturation_penalty > 0:
            excess = functional.relu(logits.abs() - 3).square().mean()
            loss = loss + self.learner.saturation_penalty * excess
        return loss

    def policy_loss(self, encoded: Tensor, action: Tensor, batch: Batch) -> Tensor:
        """Return minus the critics' mean value of the actor's action."""
        return -self.drawn_values(encoded, action).mean()

    def drawn_values(self, encoded: Tensor, action: Tensor) -> Tensor:
        """Return the values by Z critics drawn at random, shape (Z, B).

        The gradient of their mean is an unbiased estimate of that of the mean over all E, which
        REDQ takes, for Z / E of the work.
        """
        return self.critics(encoded, action, self._draw_critics())


def _follow(targets: object, sources: list[torch.nn.Parameter], rate: float) -> None:
    with torch.no_grad():
        torch._foreach_lerp_(list(targets), sources, rate)  # type: ignore[call-overload]
