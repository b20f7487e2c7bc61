"""The servo that pulls one cable, and what its commands mean."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from cdcsr.robot.parts import NonNegative, Part, Positive, there


class Servo(Part):
    """The slider that pulls one cable, and the servo that moves it.

    The force of the servo on its slider, upwards, is

        gain * (command - travel) - pretension    (set-point, displacement)
        -command - pretension                     (tension)

    and at most `force_limit`. Commands lie between zero and `full`.
    """

    later = ("kind", "gain", "eta", "largest_tension", "force_limit", "pretension")
    kind: Literal["set-point", "displacement", "tension"] = "set-point"
    """The meaning of a command: the set-point of a soft servo is a travel in [m], a stiff servo
    drives its slider, critically damped, to the displacement in [m], and the third pulls with the
    tension in [N]."""
    mass: Positive
    """Mass of the slider in [kg]."""
    damping: NonNegative
    """Viscous friction of the slider in [N s/m]."""
    own_gain: Positive | None = Field(None, alias="gain")
    """Servo force per set-point error in [N/m]; a tension servo has none."""
    own_eta: Positive | None = Field(None, alias="eta")
    """Largest pull: commands lie in [-eta, 0], in [m]; a tension servo has `largest_tension`."""
    largest_tension: Positive | None = None
    """Commands of a tension servo, which alone has it, lie in [0, largest_tension], in [N]."""
    radius: Positive
    """The slider is a solid ball of this radius, in [m]."""
    offset: Positive
    """Distance of the slider at rest below the cable's first guide, in [m]; above its radius."""
    force_limit: Positive | None = None
    """Largest force of the servo in [N]; without it there is none."""
    pretension: NonNegative = 0.0
    """Pull at the start and at the command zero, in [N]."""

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        given = [part is not None for part in (self.own_gain, self.own_eta, self.largest_tension)]
        if self.kind == "tension" and given != [False, False, True]:
            raise ValueError("a tension servo needs largest_tension, and has no gain and no eta")
        if self.kind != "tension" and given != [True, True, False]:
            raise ValueError(
                f"a {self.kind} servo needs gain and eta; only a tension servo has largest_tension"
            )
        if self.force_limit is not None and self.force_limit <= self.pretension:
            raise ValueError(f"force_limit must be above pretension ({self.pretension:g} N)")
        return self

    @property
    def gain(self) -> float:
        """Servo force per command error, in [N/m]; one for a tension servo."""
        return 1.0 if self.own_gain is None else self.own_gain

    @property
    def eta(self) -> float:
        """The largest pull of a servo that has no tension as its command, in [m]."""
        return there(self.own_eta, "eta: its commands are tensions")

    @property
    def sign(self) -> float:
        """Minus one for a tension servo, which pulls at positive commands; else one."""
        return -1.0 if self.kind == "tension" else 1.0

    @property
    def full(self) -> float:
        """The command of the largest pull: -eta in [m], or the largest tension in [N]."""
        if self.own_eta is not None:
            return -self.own_eta
        return there(self.largest_tension, "largest_tension")

    @property
    def stiffness(self) -> float:
        """How its force falls as the slider moves, in [N/m]; zero for a tension servo."""
        return 0.0 if self.kind == "tension" else self.gain

    @property
    def pull(self) -> float:
        """Its largest pull at the travel zero, in [N]."""
        most = self.gain * abs(self.full) + self.pretension
        return most if self.force_limit is None else min(most, self.force_limit)

    @property
    def unit(self) -> str:
        """The unit of its commands."""
        return "N" if self.kind == "tension" else "m"

    def servo_damping(self, time_step: float) -> float:
        """Return the damper with which a displacement servo comes to rest, in [N s/m]; zero for
        other servos.

        It is critical, 2 sqrt(gain mass), and a time step of the spring: as engines make such
        dampers implicit, the spring then sees the travel at the end of the step, which is stable at
        any gain.
        """
        if self.kind != "displacement":
            return 0.0
        return 2 * (self.gain * self.mass) ** 0.5 + time_step * self.gain

    @property
    def stop(self) -> float:
        """The travel at which the slider touches the cable's first guide and stops, in [m]."""
        return self.offset - self.radius
