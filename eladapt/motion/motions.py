"""Motions from rest to rest: what a goal becomes that an arm can follow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from ruckig import InputParameter, Ruckig, RuckigError, Trajectory

from eladapt.errors import ArgumentError, UnknownNameError, require_number
from eladapt.motion.limits import MotionLimits
from eladapt.robot.model import Robot
from eladapt.robot.postures import require_holdable, require_within
from eladapt.signals import Reference


class Course(NamedTuple):
    """Where a motion is: from its start in the tangent space, each (nv,)."""

    x: np.ndarray  # [rad or m]
    v: np.ndarray
    a: np.ndarray


@dataclass(frozen=True, eq=False)
class Motion:
    """A reference over time, from rest to rest: ``motion(t)`` is a `Reference`, wherever a goal is taken.

    q0 (nq,): where it starts; course: t [s] in [0, duration] -> `Course`. Before 0 it rests at its start,
    after ``duration`` [s] at its end.
    """

    robot: Robot
    q0: np.ndarray
    duration: float
    course: Callable[[float], Course]
    name: str = "motion"

    def __call__(self, t: float) -> Reference:
        """The reference at t [s]."""
        x, v, a = self.course(min(max(t, 0.0), self.duration))
        q = self.robot.integrate(self.q0, x)
        if 0.0 < t < self.duration:
            return Reference(q, v, a)
        return Reference(q, np.zeros_like(v), np.zeros_like(a))

    def __repr__(self) -> str:
        return f"Motion({self.name} of {self.robot.name}, {self.duration:.4g} s)"

    @property
    def end(self) -> np.ndarray:
        """(nq,) where it ends."""
        return self(self.duration).q

    def sampled(self, dt: float) -> tuple[np.ndarray, Reference]:
        """t (N,) every dt [s] from 0 to the end, and q (N, nq), v and a (N, nv) there."""
        t = np.arange(0.0, self.duration + dt, dt)
        points = [self(float(time)) for time in t]
        return t, Reference(*(np.array(part) for part in zip(*points, strict=True)))


def move(
    robot: Robot,
    q0: np.ndarray,
    q1: np.ndarray,
    limits: MotionLimits | None = None,
    *,
    duration: float | None = None,
    turns: Mapping[str, int] | None = None,
) -> Motion:
    """The fastest motion from q0 to q1 (nq,) within the limits, all joints arriving together, by ruckig.

    limits: None for `MotionLimits.for_robot`. duration [s]: a slower one. turns: whole turns beside the short
    way, by the name of a continuous joint. Raises ArgumentError for an end that the joint limits exclude
    or the effort limits cannot hold, for a duration that is too short; UnknownNameError for a joint that is
    none.
    """
    limits = limits or MotionLimits.for_robot(robot)
    q0, q1 = robot.check_q(q0, "q0"), robot.check_q(q1, "q1")
    require_within(robot, q0, "q0")
    require_within(robot, q1, "q1")
    require_holdable(robot, q1, "q1")
    way = robot.difference(q0, q1) + _turned(robot, turns or {})
    problem = InputParameter(robot.nv)
    problem.max_velocity, problem.max_acceleration = limits.velocity, limits.acceleration
    problem.max_jerk, problem.target_position = limits.jerk, way
    fastest = solved(problem)
    if duration is not None:
        duration = require_number("duration", duration, 0)
        if duration < fastest.duration:
            joint = robot.joint_names[int(np.argmax(fastest.independent_min_durations))]
            raise ArgumentError(
                f"duration: expected at least {fastest.duration:.4g} s, which {joint} takes within its "
                f"limits, got {duration:g} s"
            )
        problem.minimum_duration = duration
        fastest = solved(problem)
    return Motion(robot, q0.copy(), fastest.duration, _followed(fastest), "move")


def solved(problem: InputParameter) -> Trajectory:
    """ruckig's trajectory. Raises ArgumentError where it finds none."""
    trajectory = Trajectory(problem.degrees_of_freedom)
    try:
        Ruckig(problem.degrees_of_freedom).calculate(problem, trajectory)
    except RuckigError as reason:
        raise ArgumentError(f"motion: ruckig finds none within these limits ({reason})") from reason
    return trajectory


def _turned(robot: Robot, turns: Mapping[str, int]) -> np.ndarray:
    """(nv,) [rad] of whole turns by joint."""
    way = np.zeros(robot.nv)
    model = robot.model
    legal = [n for n in robot.joint_names if model.nqs[model.getJointId(n)] == 2]
    if unknown := [name for name in turns if name not in legal]:
        raise UnknownNameError("continuous joint", unknown, legal)
    for name, count in turns.items():
        way[robot.joint_names.index(name)] = 2 * np.pi * count
    return way


def _followed(trajectory: Trajectory) -> Callable[[float], Course]:
    return lambda t: Course(*(np.array(part) for part in trajectory.at_time(t)))
