"""The numbers of a robot's tasks, from its description: its ruler and its clock."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np
from numpy.typing import NDArray

from cdcsr.robot.description import Robot
from cdcsr.robot.scale import Scale

Array = NDArray[np.float64]

ACTIONS = 250
"""How many actions an episode of reaching has, if the time step allows."""
_ARM_LENGTH, _ANSWER_TIME, _PITCH_RADIUS, _PULL = 2.4, 0.180673, 0.02, 250.0
"""Arm length, answer time, pitch radius and largest pull of the paper's robot, in [m], [s], [m]
and [N]."""
_FAR, _MOST, _GROWTH = 1 / 12, 1e4, 1.1


@dataclass(frozen=True)
class Ruler:
    """The numbers of one robot's tasks; see :class:`cdcsr.robot.scale.Scale` for most of them."""

    size: float
    """Its length as a multiple of that of the paper's robot."""
    pace: float
    """Its time as a multiple of that of the paper's robot."""
    travel: float
    """Its pitch radius as a multiple of that of the paper's robot; cable travel grows with it."""
    pull: float
    """Its largest servo force as a multiple of that of the paper's robot."""
    threshold: float
    floating: float
    spatter: float
    seconds: float
    frame_skip: int
    capture_speed: float
    base_shift: float
    base_tilt: float
    tip_speed: float
    spacing: float

    @property
    def scale(self) -> Scale:
        """A section of a description that gives these numbers to any robot."""
        own = {name: getattr(self, name) for name in Scale.model_fields if hasattr(self, name)}
        return Scale(length=self.size * _ARM_LENGTH, time=self.pace * _ANSWER_TIME, **own)

    @property
    def speed(self) -> float:
        """Length by time, as a multiple of that of the paper's robot."""
        return self.size / self.pace


def ruler(robot: Robot) -> Ruler:
    """Return the numbers of a robot's tasks.

    They are rounded to three digits, so that all machines find the same ones.
    """
    return _ruler(cast(Hashable, robot))


@lru_cache(maxsize=64)
def _ruler(key: Hashable) -> Ruler:
    robot = cast(Robot, key)
    given = robot.scale
    size = rounded((given.length or robot.arm_length) / _ARM_LENGTH)
    pace = rounded((given.time or answer_time(robot)) / _ANSWER_TIME)
    speed = size / pace
    radius = max((s.cables.pitch_radius for s in robot.segments if s.cable_angles), default=0.02)
    pull = max((servo.pull for servo in robot.servos), default=_PULL)
    seconds = given.seconds or rounded(0.625 * pace)
    return Ruler(
        size=size,
        pace=pace,
        travel=rounded(radius / _PITCH_RADIUS),
        pull=rounded(pull / _PULL),
        threshold=given.threshold or rounded(0.03 * size),
        floating=given.floating or rounded(0.01 * size),
        spatter=given.spatter or rounded(0.15 * size),
        seconds=seconds,
        frame_skip=given.frame_skip or max(1, round(seconds / ACTIONS / robot.time_step)),
        capture_speed=given.capture_speed or rounded(0.1 * speed),
        base_shift=given.base_shift or rounded(0.003 * size),
        base_tilt=given.base_tilt or 0.05,
        tip_speed=given.tip_speed or rounded(2.0 * speed),
        spacing=given.spacing or rounded(0.05 * size),
    )


def rounded(number: float, digits: int = 3) -> float:
    """Return a number with so many significant digits."""
    return float(f"{number:.{digits}g}")


def millimetres(length: float, threshold: float) -> str:
    """Return a length in [mm] as text, in whole ones for thresholds of 10 mm and more, and for
    smaller ones with as many more digits as these have."""
    return f"{1e3 * length:.{max(0, 1 - math.floor(math.log10(1e3 * threshold)))}f}"


def answer_time(robot: Robot) -> float:
    """Return how long the straight arm takes to answer one cable that is pulled in full, in [s].

    It has answered when the tip is a twelfth of the arm's length aside, or, if the cable cannot
    pull it so far, at 63 % of the way. The cable is one of the outermost that end on a segment. The
    arm is linear, in a plane and without gravity: with mass matrix M, dampers C and springs K of
    base and hinges, and a taut cable at the distance r from the axis,

        (M + m r^2 1 1') a = F r 1 - (C + c r^2 1 1') v - (K + k r^2 1 1') q,

    where 1 marks the hinges that the cable passes, F is the servo's largest force, and m, c and k
    are mass, friction and gain of its slider. The arm's inertia, dampers, springs and servos all
    slow this down; the slowest of them sets the time. The plane is that in which most joints bend;
    joints that do not bend in it are rigid. An arm without cables has the time of the
    paper's.
    """
    segments = [segment for segment in robot.segments if segment.cable_angles]
    if not segments:
        return _ANSWER_TIME
    last = max(n for n, segment in enumerate(robot.segments) if segment.cable_angles)
    cables, servo = robot.segments[last].cables, robot.segments[last].servo
    passed = sum(segment.links for segment in robot.segments[: last + 1])
    mass, tip = _planar_mass(robot)
    hinges = len(mass) - robot.num_links
    arm = np.zeros(len(mass))
    arm[hinges : hinges + passed] = cables.pitch_radius
    springs, dampers = np.zeros((2, len(mass)))
    springs[hinges:] = [joint.stiffness for _, joint in robot.links]
    dampers[hinges:] = [joint.damping for _, joint in robot.links]
    along = np.outer(arm, arm)
    mass = mass + servo.mass * along
    damping = np.diag(dampers) + (servo.damping + servo.servo_damping(0.0)) * along
    stiffness = np.diag(springs) + servo.stiffness * along
    free = _free_motions(robot, hinges)
    if free is not None:
        mass, damping, stiffness = (free.T @ part @ free for part in (mass, damping, stiffness))
        arm, tip = arm @ free, tip @ free
    times, moved = _pulled(mass, damping, stiffness, servo.pull * arm, tip)
    goal = min(_FAR * robot.arm_length, 0.63 * moved.max())
    after = int(np.argmax(moved >= goal))
    return float(np.interp(goal, moved[after - 1 : after + 1], times[after - 1 : after + 1]))


def _free_motions(robot: Robot, base: int) -> Array | None:
    """Return how the coordinates, `base` of the base and one a joint, move with the free ones in
    the plane in which most joints bend; None if all are free.

    Joints that do not bend in that plane are rigid, and those of a coupled segment bend alike.
    """
    across = max("yx", key=lambda axis: sum(axis in joint.order for _, joint in robot.links))
    columns = list(np.eye(base + robot.num_links)[:base])
    first = base
    for segment in robot.segments:
        own: list[Array] = []
        for _, joint in segment.pairs:
            if across in joint.order:
                own.append(np.eye(base + robot.num_links)[first])
            first += 1
        columns += [np.sum(own, axis=0)] if segment.coupling and own else own
    free = np.array(columns).T
    return None if free.shape[0] == free.shape[1] else free


def _planar_mass(robot: Robot) -> tuple[Array, Array]:
    """Return the mass matrix of the straight arm in a plane and how the tip moves with each
    coordinate: shift and tilt of the base, unless it is fixed, then the hinges."""
    joint, rows = robot.first_joint, []
    joints: list[float] = []
    for link, _ in robot.links:
        joints.append(joint)
        rows.append((link.mass, link.inertia[1], joint + link.center_of_mass))
        joint += link.length
    count, height = len(joints), np.array(joints)
    mass = np.zeros((count + 2, count + 2))
    mass[0, 0], mass[1, 1] = robot.base.mass, robot.base.inertia[1]

    def lever(place: float, below: int) -> Array:
        arms = np.where(np.arange(count) < below, place - height, 0.0)
        return np.concatenate([[1.0, place], arms])

    for n, (weight, inertia, place) in enumerate(rows):
        shift = lever(place, n + 1)
        turn = np.concatenate([[0.0, 1.0], np.arange(count) <= n])
        mass += weight * np.outer(shift, shift) + inertia * np.outer(turn, turn)
    tip = lever(joint, count)
    first = 0 if robot.base.mount == "free" else 2
    return mass[first:, first:], tip[first:]


def _pulled(
    mass: Array, damping: Array, stiffness: Array, force: Array, tip: Array
) -> tuple[Array, Array]:
    """Return times and how far aside the tip is then, under a constant force from rest.

    Implicit Euler steps, each a tenth longer than the one before.
    """
    step = 1e-7
    times, moved = [0.0], [0.0]
    angle, rate = np.zeros((2, len(mass)))
    while times[-1] < _MOST:
        implicit = mass + step * damping + step**2 * stiffness
        rate = np.linalg.solve(implicit, mass @ rate + step * (force - stiffness @ angle))
        angle = angle + step * rate
        times.append(times[-1] + step)
        moved.append(abs(float(tip @ angle)))
        step *= _GROWTH
    return np.array(times), np.array(moved)
