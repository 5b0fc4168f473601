"""Any goal as a reference within an arm's limits, planned anew in every step."""

from __future__ import annotations

import contextlib
import functools
import math
import warnings
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
import pinocchio as pin
from ruckig import InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from eladapt.compiling import SCALAR, VECTOR, VIEW, kernel, prepare
from eladapt.control.stepping import CLOCK_ROUNDING, LONGEST_STEP
from eladapt.errors import ArgumentError, GoalWarning, require_number
from eladapt.motion.limits import MotionLimits
from eladapt.robot.postures import beyond
from eladapt.robot.protocols import (
    Around,
    BareController,
    Goal,
    handed_on,
    of_the_inner,
    require_controller,
)
from eladapt.scratch import Scratch
from eladapt.signals import Measurement, Reference

INSIDE = 0.01  # [rad or m] of a joint limit: what a gate that looks ahead leaves to stop in
EXACT = 1 + 1e-6  # of the limits by a goal that is planned to the limits and rounded
NEAR = 1e-3  # [rad or m] from where the arm is seen, a first goal is where it begins
USABLE = 0.99  # of the limits by a goal that is to be caught


class _Planning(NamedTuple):
    """The planner and what it writes to; nothing is remembered from call to call."""

    problem: InputParameter
    trajectory: Trajectory
    planner: Ruckig


class _Frame(NamedTuple):
    """What a step of planning needs."""

    still: np.ndarray  # (nv,) zeros
    neutral: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    limits: tuple[np.ndarray, np.ndarray, np.ndarray]
    planning: Scratch[_Planning]


@kernel(VECTOR, VIEW, VIEW, VIEW, VIEW, VECTOR, VECTOR, VECTOR, SCALAR)
def reached(
    way: np.ndarray, v: np.ndarray, a: np.ndarray, goal_v: np.ndarray, goal_a: np.ndarray,
    velocity: np.ndarray, acceleration: np.ndarray, jerk: np.ndarray, dt: float,
) -> bool:  # fmt: skip
    """Whether a goal within the limits, ``way`` (nv,) off, is where a step of dt leads that keeps to the jerk
    limit."""
    for i in range(len(way)):
        if abs(goal_v[i]) > EXACT * velocity[i] or abs(goal_a[i]) > EXACT * acceleration[i]:
            return False
        allowed = EXACT * jerk[i] * dt
        if abs(goal_a[i] - a[i]) > allowed or abs(goal_v[i] - v[i] - dt * a[i]) > allowed * dt:
            return False
        if abs(way[i] - dt * (v[i] + dt / 2 * a[i])) > allowed * dt * dt:
            return False
    return True


@kernel(VECTOR, VECTOR, VECTOR, VECTOR)
def come_inside(way: np.ndarray, x: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
    """Shorten the way (nv,) to joint coordinates x that are beyond the joint limits, in place; whether any
    are."""
    shortened = False
    for i in range(len(x)):
        if x[i] > upper[i]:
            way[i] += upper[i] - INSIDE - x[i]
            shortened = True
        elif x[i] < lower[i]:
            way[i] += lower[i] + INSIDE - x[i]
            shortened = True
    return shortened


@kernel(VIEW, VIEW, VECTOR, VECTOR)
def slower(v: np.ndarray, a: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> bool:
    """Whether a goal's own motion leaves enough of the limits to come nearer."""
    for i in range(len(v)):
        if abs(v[i]) > USABLE * velocity[i] or abs(a[i]) > USABLE * acceleration[i]:
            return False
    return True


@kernel(VECTOR, VIEW, VIEW, VIEW, VIEW, VECTOR, VECTOR, SCALAR)
def beside(
    way: np.ndarray, v: np.ndarray, a: np.ndarray, goal_v: np.ndarray, goal_a: np.ndarray,
    velocity: np.ndarray, acceleration: np.ndarray, dt: float,
) -> np.ndarray:  # fmt: skip
    """(7, nv): the reference's position, velocity and acceleration beside a goal that moves, and the least
    and largest of velocity and acceleration that are left there."""
    found = np.empty((7, len(way)))
    for i in range(len(way)):
        found[0, i] = dt * (goal_v[i] - dt / 2 * goal_a[i]) - way[i]
        found[1, i] = v[i] - goal_v[i] + dt * goal_a[i]
        found[2, i] = a[i] - goal_a[i]
        found[3, i], found[4, i] = -velocity[i] - goal_v[i], velocity[i] - goal_v[i]
        found[5, i], found[6, i] = -acceleration[i] - goal_a[i], acceleration[i] - goal_a[i]
    return found


class ShapedState(NamedTuple):
    """What a `Shaped` controller remembers."""

    inner: Any  # the controller's state
    reference: Reference  # where the arm should be now
    t: float  # [s] of the measurement that the reference belongs to
    begun: bool = False  # whether a goal was seen yet
    beyond: bool = False  # whether the last one was beyond the joint limits, which was said then

    def __repr__(self) -> str:
        return f"ShapedState(t = {self.t:.6g} s, {self.inner!r})"

    @property
    def fault(self) -> Any:
        """The gate's inside, None where there is none."""
        return getattr(self.inner, "fault", None)

    @property
    def brake(self) -> bool:
        """Whether a gate inside wants the brakes."""
        return bool(getattr(self.inner, "brake", False))

    @property
    def measurement(self) -> Any:
        """The last one that the controller saw, None where its state does not say."""
        return getattr(self.inner, "measurement", None)

    def __getattr__(self, name: str) -> Any:
        """What the controller's state says beside: parameters, external, touching and so on."""
        return of_the_inner(self, name)


@dataclass(frozen=True, eq=False)
class Shaped(Around):
    """A controller whose goal may jump, reverse or run away: it is given a reference within the limits.

    In every step the fastest way from where the reference is to the goal, all joints arriving together, is
    planned anew by ruckig, and the reference goes the first dt of it; so neither position nor velocity nor
    acceleration jumps, whatever the goal does. A goal that moves within the limits is followed to the letter
    once it is reached. A goal beyond the joint limits is taken just inside, by `INSIDE`. While a gate inside
    holds a fault, the reference stands where the arm is.

    limits: None for `MotionLimits.for_robot` of the controller's robot. Raises ArgumentError for what is no
    controller, one that is shaped already, and limits of other joints. Put it around a gate, so that the
    gate judges what the controller is asked for: ``Shaped(GatedController.for_robot(controller))``.
    """

    controller: BareController
    limits: MotionLimits | None = None

    def __post_init__(self) -> None:
        prepare()
        require_controller(self.controller)
        if shapes(self.controller):
            raise ArgumentError(
                f"controller: expected one without Shaped in it, got {self.controller!r}; shape a goal once"
            )
        if not isinstance(self.limits, MotionLimits | None):
            raise ArgumentError(
                f"limits: expected MotionLimits, or None for MotionLimits.for_robot, got {self.limits!r}"
            )
        limits = self.limits or MotionLimits.for_robot(self.controller.robot)
        if limits.robot.joint_names != self.controller.robot.joint_names:
            raise ArgumentError(
                f"limits: expected those of the joints {self.controller.robot.joint_names}, "
                f"got {limits.robot.joint_names}"
            )
        object.__setattr__(self, "limits", limits)

    def __repr__(self) -> str:
        return f"Shaped({self.controller!r})"

    def init(self, measurement: Measurement, theta0: Any = None) -> ShapedState:
        """The reference where the arm is, as fast as it is within the limits; theta0 as the controller takes
        it."""
        given, here = () if theta0 is None else (theta0,), self._here(measurement)
        return ShapedState(self.controller.init(measurement, *given), here, measurement.t)

    def around(self, inner: Any, measurement: Measurement) -> ShapedState:
        """The state that begins here with a state of the controller."""
        return ShapedState(inner, self._here(measurement), measurement.t)

    def step(
        self, state: ShapedState, measurement: Measurement, goal: Goal, dt: float
    ) -> tuple[ShapedState, np.ndarray]:
        """The state at ``measurement`` and the torque (nv,) to hold for dt [s].

        Raises ArgumentError for a dt that is not positive, and what the controller raises; a measurement or a
        goal that is none is handed on to it, which says so. A sample that was seen before moves nothing; one
        that is late or early moves the reference by the time that its stamp says.
        """
        dt = require_number("dt", dt, 0)
        try:
            wanted = self.robot.check_goal(goal)
        except ArgumentError:
            inner, tau = self.controller.step(state.inner, measurement, goal, dt)
            return state._replace(inner=inner), tau
        t, reference, outside = getattr(measurement, "t", None), state.reference, state.beyond
        if state.fault is not None:
            reference = self._seen(measurement) or reference
        elif not state.begun:
            reference = self._begun(reference, wanted)
        elif t != state.t:
            way, outside = self._way(reference, wanted)
            if outside and not state.beyond:
                self._say_beyond(wanted)
            reference = self._followed(reference, way, wanted, _passed(state.t, t, dt))
        inner, tau = self.controller.step(state.inner, measurement, handed_on(reference), dt)
        seen = float(t) if isinstance(t, int | float) else state.t
        return ShapedState(inner, reference, seen, True, outside), tau

    def follow(self, reference: Reference, goal: Reference, dt: float) -> Reference:
        """The reference dt [s] later, on its way to the goal.

        The way is planned beside the goal, as if that went on as it accelerates now: what is left of the
        limits beside the goal's own motion is what it takes to come nearer. A goal that leaves nothing is
        run after where it is; to one that no motion leads to, 1e300 rad off, the reference brakes.
        """
        return self._followed(reference, self._way(reference, goal)[0], goal, dt)

    def _way(self, reference: Reference, goal: Reference) -> tuple[np.ndarray, bool]:
        """(nv,) from the reference to the goal, or to just inside the joint limits, and whether the goal is
        beyond them."""
        model, frame = self.robot.model, self._frame
        way = pin.difference(model, reference.q, goal.q)
        x = pin.difference(model, frame.neutral, goal.q)
        return way, come_inside(way, x, frame.lower, frame.upper)

    def _say_beyond(self, goal: Reference) -> None:
        frame = self._frame
        said = beyond(self.robot, self.robot.coordinates(goal.q), frame.lower, frame.upper)
        with contextlib.suppress(GoalWarning):  # where warnings are errors, too: the arm moves
            warnings.warn(f"goal: {said}; taken just inside", GoalWarning, stacklevel=4)

    def _followed(self, reference: Reference, way: np.ndarray, goal: Reference, dt: float) -> Reference:
        """The reference dt [s] later, on a way (nv,) to the goal."""
        model, frame = self.robot.model, self._frame
        limits = frame.limits
        if reached(way, *reference[1:], *goal[1:], *limits, dt):
            return Reference(pin.integrate(model, reference.q, way), goal.v, goal.a)
        there = Reference(goal.q, frame.still, frame.still)
        step = self._planned(reference, way, goal, dt) if slower(*goal[1:], *limits[:2]) else None
        step = step or self._planned(reference, way, there, dt)
        return step or self._planned(reference, frame.still, there, dt) or reference

    def _planned(self, reference: Reference, way: np.ndarray, goal: Reference, dt: float) -> Reference | None:
        """The first step of the fastest way to a goal that is ``way`` (nv,) off and goes on as it moves; None
        where the planner finds no way."""
        frame = self._frame
        problem, trajectory, planner = frame.planning.own
        there = beside(way, *reference[1:], *goal[1:], *frame.limits[:2], dt)
        (
            problem.current_position, problem.current_velocity, problem.current_acceleration,
            problem.min_velocity, problem.max_velocity, problem.min_acceleration, problem.max_acceleration,
        ) = there.tolist()  # fmt: skip  # ruckig takes lists in a fifth of the time
        for together in (Synchronization.Time, Synchronization.No):
            problem.synchronization = together
            try:  # some states in the midst of reversals cannot arrive together
                planner.calculate(problem, trajectory)
            except (RuckigError, ValueError):
                continue
            left, v, a = np.array(trajectory.at_time(dt))
            q = pin.integrate(self.robot.model, reference.q, way + left)
            return Reference(q, goal.v + v, goal.a + a)
        return None

    def _begun(self, reference: Reference, goal: Reference) -> Reference:
        """Where the reference begins, given the first goal: noise of the first sample is no distance."""
        near = np.abs(pin.difference(self.robot.model, reference.q, goal.q)) <= NEAR
        return goal if near.all() and not goal.v.any() and not goal.a.any() else reference

    @functools.cached_property
    def _frame(self) -> _Frame:
        """What stays the same from step to step."""
        robot, limits = self.robot, cast(MotionLimits, self.limits)
        return _Frame(
            np.zeros(robot.nv), pin.neutral(robot.model), robot.lower, robot.upper,
            (limits.velocity, limits.acceleration, limits.jerk),
            Scratch(functools.partial(_planning, limits.jerk)),
        )  # fmt: skip

    def _here(self, measurement: Measurement) -> Reference:
        """Where the arm is, at the speed that it has as far as that is within the limits.

        Raises ArgumentError for what is no measurement.
        """
        _, q, v, _ = self.robot.check_measurement(measurement)
        top, still = self._frame.limits[0], self._frame.still
        return Reference(q, np.minimum(np.maximum(v, -top), top), still.copy())

    def _seen(self, measurement: Any) -> Reference | None:
        """The same, None for what is no measurement."""
        try:
            return self._here(measurement)
        except (ArgumentError, TypeError, ValueError, OverflowError):
            return None


def shapes(controller: Any) -> bool:
    """Whether a controller, or the one inside of whatever it is, is `Shaped`."""
    while not isinstance(controller, Shaped):
        if not isinstance(controller, Around):
            return False
        controller = controller.controller
    return True


def _passed(before: float, now: Any, dt: float) -> float:
    """The time [s] by which the goal has moved on between two samples; dt where their stamps agree with it or
    do not say, and after a longer pause, from which the reference goes on where it was."""
    if not isinstance(now, int | float):
        return dt
    passed = now - before
    nominal = abs(passed - dt) <= CLOCK_ROUNDING * dt + 4 * math.ulp(now)
    return dt if nominal or not 0 < passed <= LONGEST_STEP * dt else passed


def _planning(jerk: np.ndarray) -> _Planning:
    """For joints with these jerk limits (nv,)."""
    problem = InputParameter(len(jerk))
    problem.max_jerk = jerk
    return _Planning(problem, Trajectory(len(jerk)), Ruckig(len(jerk)))
