"""The loop between a controller and a robot, at a fixed rate, whatever the robot is.

`simulate` with a clock: the robot is anything with four methods, and does not wait.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from eladapt.errors import ArgumentError, EladaptError, LoopError, require_number
from eladapt.hardware.timing import Pacer, Timing, undisturbed
from eladapt.motion.limits import MotionLimits
from eladapt.motion.motions import require_holdable, require_within
from eladapt.motion.shaped import Shaped
from eladapt.records.record import Record
from eladapt.records.recorder import Recorder
from eladapt.records.state_file import StateWriter, on_clock
from eladapt.robot.model import Robot
from eladapt.robot.protocols import BareController, Goal, GoalCourse
from eladapt.signals import Measurement, Reference

GAP = 1.0  # [s] between two runs whose clocks have nothing to do with each other: filters start afresh
WARM_UP = 20  # steps before the robot starts: they import, allocate and compile


class RobotInterface(Protocol):
    """A robot that takes torque. Each method returns within a fraction of a period, but `start`."""

    def start(self) -> None:
        """Release the brakes, or whatever it takes until torque is followed."""

    def read(self) -> Measurement:
        """The newest measurement; the last one again where there is no newer."""

    def write(self, tau: np.ndarray) -> None:
        """Command a torque (nv,) [N m], held until the next one."""

    def stop(self) -> None:
        """Bring the robot to rest by its own means; called once, however the loop ends."""


class LoopResult(NamedTuple):
    """What a loop leaves."""

    record: Record
    state: Any  # the controller's last
    timing: Timing
    ended: str  # "duration", "fault" or "interrupted"
    fault: Any = None  # the gate's, if there is one


def run_loop(
    controller: BareController,
    interface: RobotInterface,
    goal: GoalCourse,
    duration: float,
    dt: float = 1e-3,
    *,
    state: Any = None,
    after_fault: float = 1.0,
    checkpoint: str | Path | None = None,
    every: float = 1.0,
    priority: int | None = None,
    title: str = "",
    shaped: bool = True,
    limits: MotionLimits | None = None,
) -> LoopResult:
    """Regulate a robot for ``duration`` [s], reading and writing once every ``dt`` [s].

    goal: q_d (nq,), a `Reference`, or a callable of the time since the start [s], by the robot's clock, that
    returns either. state: of an earlier run, to go on with what it had learned, also if the robot's clock was
    set since; None begins afresh. When a gate latches a fault, its fallback goes on for ``after_fault`` [s].
    checkpoint: a file to which the state is saved every ``every`` [s] and at the end, for `load_state`; a
    write takes a millisecond or two. priority: see `undisturbed`. shaped: whether the goal becomes a
    reference within ``limits`` (None: `MotionLimits.for_robot`), so that a set-point that jumps makes the arm
    move smoothly, see `Shaped`; the state is that of the controller inside.

    The interface's `stop` is called however the loop ends. Raises LoopError, with record, state and timing so
    far, for whatever the robot, the goal or the controller raises, and ArgumentError, before anything moves,
    for a set-point beyond the joint limits or that the effort limits cannot hold; an interrupt from the
    keyboard ends the loop as the end of ``duration`` does.
    """
    dt = require_number("dt", dt, 0)
    steps = round(require_number("duration", duration, 0) / dt)
    if steps < 1:
        raise ArgumentError(f"duration: expected at least one step of {dt:g} s, got {duration:g} s")
    if (fault := getattr(state, "fault", None)) is not None:
        raise ArgumentError(f"state: holds the fault {fault}; clear it with state = controller.reset(state)")
    _require_reachable(controller.robot, goal)
    shaping = Shaped(controller, limits) if shaped and not isinstance(controller, Shaped) else None
    loop = _Loop(controller, shaping, interface, goal, dt, steps, title)
    writer = StateWriter(controller) if checkpoint else None
    _warm_up(shaping or controller, dt)
    ended, cause = "duration", None
    with undisturbed(priority):
        try:
            try:
                interface.start()
                loop.begin(state)
                left = steps
                saved = 0
                while loop.pacer.ticks + loop.pacer.missed < steps and left > 0:
                    fault = loop.tick()
                    if writer and checkpoint and loop.pacer.ticks - saved >= every / dt:
                        writer.write(checkpoint, loop.state)
                        saved = loop.pacer.ticks
                    loop.pacer.wait()
                    if fault is not None:
                        ended, left = "fault", min(left, round(after_fault / dt) + 1) - 1
            finally:
                interface.stop()
        except KeyboardInterrupt:
            ended = "interrupted"
        except Exception as reason:
            cause = reason
    if writer and checkpoint and loop.state is not None:
        writer.write(checkpoint, loop.state)
    timing = loop.pacer.timing()
    if cause is not None:
        done = f"{timing.ticks} of {steps} steps"
        message = f"the loop ended after {done}: {type(cause).__name__}: {cause}"
        raise LoopError(message, loop.record(), loop.state, timing) from cause
    if (record := loop.record()) is None:
        raise LoopError("the loop was interrupted before its first step", None, loop.state, timing)
    return LoopResult(record, loop.state, timing, ended, getattr(loop.state, "fault", None))


class _Loop:
    """What changes while a loop runs."""

    def __init__(
        self,
        controller: BareController,
        shaping: Shaped | None,
        interface: RobotInterface,
        goal: GoalCourse,
        dt: float,
        steps: int,
        title: str,
    ):
        self.robot = controller.robot
        self.controller, self.shaping, self.interface, self.dt = controller, shaping, interface, dt
        self.goal_at: Callable[[float], Goal] = goal if callable(goal) else (lambda _t: goal)
        self.pacer = Pacer(dt, steps + 1)
        self.recorder = Recorder(self.robot, controller, dt, steps + 1, title)
        self.state: Any = None  # the controller's
        self.reference: Any = None  # the shaping's state, where there is one
        self.began = 0.0  # [s] by the robot's clock

    def begin(self, state: Any) -> None:
        """The first measurement, and a state at it."""
        first = self.interface.read()
        self.began = first.t
        self.state = self.controller.init(first) if state is None else self._resumed(state, first)
        if self.shaping:
            self.reference = self.shaping.around(self.state, first)
        self.recorder.reserve(self.state)
        self.pacer.restart()

    def _resumed(self, state: Any, first: Measurement) -> Any:
        """A state of an earlier run, on the robot's clock if that was set in between."""
        last = getattr(state, "measurement", None)
        if last is not None and first.t < last.t:
            state = on_clock(state, first.t - GAP - last.t)
        return state

    def tick(self) -> Any:
        """Read, step, write, keep; returns the fault there is."""
        before = time.monotonic()
        measurement = self.interface.read()
        self.pacer.began(time.monotonic() - before)
        goal = self.goal_at(_number(getattr(measurement, "t", None)) - self.began)
        if self.shaping:
            self.reference, tau = self.shaping.step(self.reference, measurement, goal, self.dt)
            self.state = self.reference.inner
        else:
            self.state, tau = self.controller.step(self.state, measurement, goal, self.dt)
        self.interface.write(tau)
        nq, nv = self.robot.nq, self.robot.nv
        q, v = (_vector(getattr(measurement, n, None), size) for n, size in (("q", nq), ("v", nv)))
        t = _number(getattr(measurement, "t", None))
        self.recorder.add(t, q, v, tau, _reference(goal, self.robot), self.state)
        return getattr(self.state, "fault", None)

    def record(self) -> Record | None:
        """All that was kept so far."""
        return self.recorder.record() if self.recorder.count else None


def _require_reachable(robot: Robot, goal: GoalCourse) -> None:
    """Raises ArgumentError for a set-point beyond the joint limits, or that the effort limits cannot hold.

    What is no goal at all is left to the gate.
    """
    try:
        q = None if callable(goal) else robot.check_goal(goal).q
    except ArgumentError:
        return
    if q is not None:
        require_within(robot, q, "goal")
        require_holdable(robot, q, "goal")


def _warm_up(controller: BareController, dt: float) -> None:
    """A few steps at home that nobody sees."""
    robot = controller.robot
    q, zero = robot.configuration(robot.home), np.zeros(robot.nv)
    measurement = Measurement(0.0, q, zero, zero)
    try:
        state = controller.init(measurement)
        for k in range(WARM_UP):
            state, _ = controller.step(state, measurement._replace(t=k * dt), q, dt)
    except EladaptError:
        return  # it will be said where it matters, with the robot's own measurement


def _number(value: Any) -> float:
    """What a record shows of a time stamp that may be anything."""
    return float(value) if isinstance(value, int | float | np.number) else float("nan")


def _reference(goal: Any, robot: Robot) -> Reference:
    """What a record shows of a goal that may be anything."""
    if not isinstance(goal, Reference):
        return Reference(_vector(goal, robot.nq), robot.still, robot.still)
    return Reference(
        *(_vector(part, n) for part, n in zip(goal, (robot.nq, robot.nv, robot.nv), strict=True))
    )


def _vector(value: Any, size: int) -> np.ndarray:
    """What a record shows of a vector that may be anything."""
    try:
        vector = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return np.full(size, np.nan)
    return vector if vector.shape == (size,) else np.full(size, np.nan)
