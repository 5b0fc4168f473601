"""Through several postures without stopping."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from ruckig import InputParameter
from scipy.interpolate import CubicSpline

from eladapt.errors import ArgumentError
from eladapt.motion.limits import MotionLimits
from eladapt.motion.motions import Course, Motion, solved
from eladapt.robot.model import Robot
from eladapt.robot.postures import require_holdable, require_within

POINTS = 1000  # at which the path's derivatives are taken
OVERSHOOT = 200  # points at which the path is compared with the joint limits
CLOSEST = 1e-9  # [rad or m] between two waypoints


def waypoints(robot: Robot, points: Sequence[np.ndarray], limits: MotionLimits | None = None) -> Motion:
    """From rest at the first of points (nq,) to rest at the last, through all others without stopping.

    The path is a cubic spline through the points, smooth up to its curvature; along it one jerk-limited
    move, by ruckig, whose own limits keep every joint's velocity, acceleration and jerk within ``limits``
    (None: `MotionLimits.for_robot`) wherever the path is bent most. Parametrisations that are faster bound no
    jerk. Raises ArgumentError for fewer than two points, for neighbours that coincide, for points beyond the
    joint limits or that cannot be held, and where the path between them leaves the joint limits.
    """
    limits = limits or MotionLimits.for_robot(robot)
    places = [robot.check_q(q, f"points[{k}]") for k, q in enumerate(points)]
    if len(places) < 2:
        raise ArgumentError(f"points: expected at least 2, got {len(places)}")
    for k, q in enumerate(places):
        require_within(robot, q, f"points[{k}]")
        require_holdable(robot, q, f"points[{k}]")
    legs = np.array([robot.difference(one, two) for one, two in itertools.pairwise(places)])
    for k, leg in enumerate(legs):
        if np.abs(leg).max() < CLOSEST:
            raise ArgumentError(
                f"points: expected neighbours that differ, points[{k}] and points[{k + 1}] coincide"
            )
    lengths = np.max(np.abs(legs) / limits.velocity, axis=1)  # [s] each leg takes at full speed
    knots = np.concatenate([[0.0], np.cumsum(lengths)])
    x = np.concatenate([np.zeros((1, robot.nv)), np.cumsum(legs, axis=0)])
    path = CubicSpline(knots, x, bc_type="natural" if len(places) > 2 else "not-a-knot")
    for s in np.linspace(0, knots[-1], OVERSHOOT):
        require_within(robot, robot.integrate(places[0], path(s)), f"points: the path at {s / knots[-1]:.0%}")
    problem = InputParameter(1)
    problem.target_position = [knots[-1]]
    problem.max_velocity, problem.max_acceleration, problem.max_jerk = _along(path, knots[-1], limits)
    profile = solved(problem)

    def course(t: float) -> Course:
        (s,), (rate,), (change,) = profile.at_time(t)
        first, second = path(s, 1), path(s, 2)
        return Course(path(s), first * rate, second * rate**2 + first * change)

    return Motion(robot, places[0].copy(), profile.duration, course, "waypoints")


def _along(
    path: CubicSpline, end: float, limits: MotionLimits
) -> tuple[list[float], list[float], list[float]]:
    """Largest s', s'' and s''' with which x(s) keeps the limits of x' s', x'' s'^2 + x' s'' and
    x''' s'^3 + 3 x'' s' s'' + x' s'''."""
    s = np.linspace(0, end, POINTS)
    first, second, third = (np.maximum(np.abs(path(s, k)).max(axis=0), 1e-12) for k in (1, 2, 3))
    rate = min(
        np.min(limits.velocity / first),
        np.min(np.sqrt(limits.acceleration / (2 * second))),
        np.min(np.cbrt(limits.jerk / (3 * third))),
    )
    change = min(np.min(limits.acceleration / (2 * first)), np.min(limits.jerk / (9 * second * rate)))
    return [float(rate)], [float(change)], [float(np.min(limits.jerk / (3 * first)))]
