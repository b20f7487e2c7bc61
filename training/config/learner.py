"""The numbers that several learners share. What one method reads alone stands beside that method.

The defaults are those of the preset `paper-reading`.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.simulation.arguments import MOST_COPIES

Count = Annotated[int, Field(ge=1, le=1_000_000_000)]
Copies = Annotated[int, Field(ge=1, le=MOST_COPIES)]
Members = Annotated[int, Field(ge=1, le=100)]
Width = Annotated[int, Field(ge=1, le=16_384)]
Rate = Annotated[float, Field(gt=0, le=10)]
NotNegative = Annotated[float, Field(ge=0, le=1e6)]
Share = Annotated[float, Field(gt=0, le=1)]


class Numbers(BaseModel):
    """Frozen numbers with bounds; unknown names, wrong types and values out of bounds are errors.

    Raises:
        CdcsrError: names the first wrong number, what was found and what is allowed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, **numbers: object) -> None:
        try:
            super().__init__(**numbers)
        except ValidationError as error:
            raise CdcsrError(self._sentence(error)) from None

    def changed(self, **numbers: object) -> Self:
        """Return these numbers with some of them changed; bounds are checked again."""
        return type(self)(**{**self.model_dump(), **numbers})

    @classmethod
    def _sentence(cls, error: ValidationError) -> str:
        first = error.errors()[0]
        if not first["loc"]:
            return first["msg"].removeprefix("Value error, ")
        name = str(first["loc"][0])
        if first["type"] == "extra_forbidden":
            return unknown_choice("option of this algorithm", name, cls.model_fields)
        rule = first["msg"].removeprefix("Input ").removeprefix("Value error, ")
        return f"{name}: {rule[0].lower()}{rule[1:]}; found {first['input']!r}."


class Network(Numbers):
    """The networks and their inputs, which every learner has."""

    features: Literal["state", "state+error"] = "state"
    """Inputs of the networks: eq. (1), scaled; or also the scaled vector from tip to target."""
    symmetry: bool = False
    """Mirror symmetry: replace every situation by its mirror image whose target lies in one part of
    the space, one quarter for arms like the paper's. What is learned there holds everywhere."""
    hidden: Annotated[tuple[Width, ...], Field(min_length=1, max_length=16)] = (256, 256, 256)
    """Widths of the hidden layers of every network."""
    batch_size: Annotated[int, Field(ge=1, le=1_000_000)] = 256
    """Rows in a batch."""


class Cloning(Network):
    """Behaviour cloning."""

    bc_updates: Count = 10_000
    """Updates of the behaviour clone."""
    bc_learning_rate: Rate = 1e-4
    """Learning rate of the behaviour clone (Adam)."""


class Practising(Network):
    """Collecting episodes and replaying them."""

    practice: NotNegative = 0.0
    """Wider targets: half of the training targets lie up to this far, in [m], outside the space.
    Demonstrations and measurements stay in the space."""
    discount: Share = 0.99
    """Discount gamma of each action."""
    return_steps: Count = 1
    """Steps n of the n-step return; it bootstraps through time limits."""
    num_envs: Copies = 1
    """Environments that are stepped side by side."""
    updates_per_step: Count = 1
    """Updates after each step of the environments."""
    exploration_noise: NotNegative = 0.1
    """Standard deviation of the exploration noise on actions in [-1, 1]."""
    noise_ladder: bool = False
    """Give each environment its own deviation, evenly from zero to twice `exploration_noise`."""
    noise_hold: Count = 1
    """Actions for which one draw of exploration noise is held."""
    hindsight: Annotated[int, Field(ge=0, le=1_000)] = 0
    """Copies of each collected episode that are stored with a target that the tip did reach
    (Andrychowicz et al. 2017)."""
    updates: Count = 100_000
    """Length of the run, in updates."""
    capacity: Count = 1_000_000
    """Rows of the replay buffer."""

    @model_validator(mode="after")
    def _ladder_needs_environments(self) -> Self:
        if self.noise_ladder and self.num_envs == 1:
            raise ValueError(
                "noise_ladder needs num_envs of at least 2: the only environment would have no "
                "noise; found 1."
            )
        return self


class Demonstrated(Network):
    """A replay that begins with the demonstrations."""

    kept_share: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of each batch that comes from the demonstration buffer; with 0 there is none, and
    demonstrations lie in the replay buffer."""


class CloneRollouts(Network):
    """A replay that begins with episodes of the clone."""

    bc_rollouts: Copies = 100
    """Episodes of the behaviour clone whose successes pre-fill the replay buffer."""


class CloneStart(Cloning):
    """An actor that can start as the clone."""

    clone_start: bool = False
    """Start the actor from behaviour cloning instead of from random weights."""
