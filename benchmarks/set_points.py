"""A course of set-points, how a loop went through it, and how near the arm came to them."""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import eladapt as ea
from eladapt.errors import EladaptError, LoopError
from eladapt.robot.protocols import BareController

AFTER, REST = 0.5, 1.0  # [s] after a motion, and before the next one, in which errors are judged


class Errors(NamedTuple):
    """The largest of all joints and set-points [rad]."""

    after: float  # from 0.5 s after a motion's end to the next motion
    rest: float  # in the last second before it


@dataclass(frozen=True, eq=False)
class Course:
    """Set-points for ``each`` [s], beginning at the posture ``start`` (nv,); a goal for `run_loop`."""

    robot: ea.Robot
    start: np.ndarray
    set_points: np.ndarray  # (number, nv)
    each: float
    limits: ea.MotionLimits

    @classmethod
    def around(
        cls, robot: ea.Robot, start: np.ndarray, far: float, number: int, each: float,
        limits: ea.MotionLimits, seed: int,
    ) -> Course:  # fmt: skip
        """Random set-points at most ``far`` [rad] from the start in each joint."""
        rng = np.random.default_rng(seed)
        points = start + rng.uniform(-far, far, (number, robot.nv))
        return cls(robot, start, points, each, limits)

    @property
    def duration(self) -> float:
        """[s]"""
        return len(self.set_points) * self.each

    def __call__(self, t: float) -> np.ndarray:
        """q_d (nq,) at t [s] after the start."""
        k = min(int(max(t, 0.0) / self.each), len(self.set_points) - 1)
        return self.robot.configuration(self.set_points[k])

    @functools.cached_property
    def ends(self) -> list[float]:
        """[s] when the motion to each set-point ends."""
        robot, stops = self.robot, [self.robot.configuration(x) for x in (self.start, *self.set_points)]
        return [
            k * self.each + ea.move(robot, q0, q1, self.limits).duration
            for k, (q0, q1) in enumerate(itertools.pairwise(stops))
        ]

    def errors(self, t: np.ndarray, q: np.ndarray) -> Errors:
        """Of an arm that was at q (N, nq) at t (N,) [s] after the start; inf where a set-point was not
        judged, since the run had ended."""
        away = [np.abs(self.robot.difference(self(at), here)).max() for at, here in zip(t, q, strict=True)]
        error = np.array(away)
        after: list[float] = []
        rest: list[float] = []
        for k, end in enumerate(self.ends):
            until = (k + 1) * self.each
            for found, since in ((after, end + AFTER), (rest, until - REST)):
                seen = error[(t > since) & (t < until)]
                found.append(float(seen.max()) if len(seen) else np.inf)
        return Errors(max(after), max(rest))


class Driven(NamedTuple):
    """What came of a course."""

    ended: str  # `LoopResult.ended`, or the fault, or what the loop failed with
    errors: Errors
    result: ea.LoopResult | LoopError  # record, state and timing


def drive(controller: BareController, interface: ea.RobotInterface, course: Course, dt: float) -> Driven:
    """Through a course in a loop, whatever ends it."""
    result: ea.LoopResult | LoopError
    try:
        result = ea.run_loop(controller, interface, course, course.duration, dt, limits=course.limits)
        ended = result.ended if result.fault is None else f"fault {result.fault}"
    except LoopError as reason:
        result, ended = reason, str(reason)
    record = result.record
    errors = Errors(np.inf, np.inf) if record is None else course.errors(record.t - record.t[0], record.q)
    return Driven(ended, errors, result)


def weighed(controller: BareController, driven: Driven, frame: str | None = None) -> str:
    """The load that came on the way, by the controller behind the gate; or why it is not known."""
    try:
        load = ea.payload(controller, driven.result.state.inner, frame)
    except EladaptError as reason:
        return str(reason)
    return f"{load.mass:.4f} +- {load.mass_std:.4f}"
