"""The loop between a controller and a robot, at a fixed rate, whatever the robot is.

`simulate` with a clock: the robot is anything with four methods, and does not wait.
"""

from __future__ import annotations

import contextlib
import time
import warnings
from collections.abc import Callable, Collection
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple, Protocol

import numpy as np

from eladapt.errors import (
    ArgumentError,
    BrakesWarning,
    EladaptError,
    LoopError,
    LoopTerminated,
    require_number,
)
from eladapt.hardware.bookkeeping import Bookkeeping
from eladapt.hardware.interruption import Interruption
from eladapt.hardware.shown import shown_number, shown_reference, shown_vector
from eladapt.hardware.timing import Pacer, Timing, undisturbed
from eladapt.motion.limits import MotionLimits
from eladapt.motion.shaped import Shaped, shapes
from eladapt.records.record import Record
from eladapt.records.recorder import LONGEST
from eladapt.records.state_file import on_clock
from eladapt.robot.joint_limits import speed
from eladapt.robot.model import Robot
from eladapt.robot.postures import require_holdable, require_within
from eladapt.robot.protocols import BareController, Goal, GoalCourse, require_controller
from eladapt.signals import Measurement

GAP = 1.0  # [s] between two runs whose clocks have nothing to do with each other: filters start afresh
MOVING = 0.02  # of its speed limit: a joint that is faster does not rest; noise and encoders make less
WARM_UP = 20  # steps before the robot starts: they import, allocate and compile


class RobotInterface(Protocol):
    """A robot that takes torque. Each method returns within a fraction of a period, but `start`.

    One whose ``read`` waits for the robot's next cycle may say so: ``keeps_clock = True``. Then the loop
    waits for nothing else.
    """

    def start(self) -> None:
        """Release the brakes, or whatever it takes until torque is followed."""

    def read(self) -> Measurement:
        """The newest measurement; the last one again where there is no newer."""

    def write(self, tau: np.ndarray) -> None:
        """Command a torque (nv,) [N m], held until the next one."""

    def stop(self) -> None:
        """Bring the robot to rest by its own means, its brakes; called once, however the loop ends.

        It returns when the robot rests, and may leave `read` without an answer.
        """


class LoopResult(NamedTuple):
    """What a loop leaves."""

    record: Record
    state: Any  # the controller's last
    timing: Timing
    ended: str  # "duration", "fault", "interrupted" (by a signal) or "stopped" (by ``stop``)
    fault: Any = None  # the gate's, if there is one
    unkept: tuple[str, ...] = ()  # what failed in keeping samples and checkpoints, one text each
    unstopped: str = ""  # which joint still moved when `stop` had returned, and how fast; "": none was seen

    def __str__(self) -> str:
        """In one line, how it ended and why."""
        why = {
            "duration": "went on to its end", "fault": f"ended by the gate: {self.fault}",
            "interrupted": "interrupted by a signal", "stopped": "stopped by its caller",
        }[self.ended]  # fmt: skip
        parts = (f"the loop {why}, after {self.timing.ticks} ticks", self.unstopped, *self.unkept)
        return "; ".join(part for part in parts if part)


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
    stop: Event | None = None,
    priority: int | None = None,
    cpus: Collection[int] | None = None,
    title: str = "",
    shaped: bool = True,
    limits: MotionLimits | None = None,
) -> LoopResult:
    """Regulate a robot for ``duration`` [s], reading and writing once every ``dt`` [s].

    goal: q_d (nq,), a `Reference`, or a callable of the time since the start [s], by the robot's clock, that
    returns either. state: of an earlier run, to go on with what it had learned, also if the robot's clock was
    set since; None begins afresh. When a gate latches a fault, its fallback holds the arm for ``after_fault``
    [s] more, and then the loop ends; in the very tick in which the gate asks for the brakes (``state.brake``)
    it ends at once, since `stop` is what closes them.
    checkpoint: a file to which the state is saved every ``every`` [s] and at the end, for `load_state`; a
    write takes a millisecond or two. It is tried before the robot starts; a write that fails later is warned
    of, once, and the loop goes on. stop: a `threading.Event`; who sets it, in whatever thread, stops the arm
    with the next tick. priority, cpus: see `undisturbed`. shaped: whether the goal becomes a
    reference within ``limits`` (None: `MotionLimits.for_robot`), so that a set-point that jumps makes the arm
    move smoothly, see `Shaped`; the state is that of the controller inside.

    The interface's `stop` is called however the loop ends, and no signal cuts it short. Then the loop reads
    once more, as far as the interface still answers: a joint that moves on is named in ``unstopped``, in the
    LoopError if there is one, and in a BrakesWarning. Ctrl-C ends the loop
    as the end of ``duration`` does; a second one, where `read` or `write` hangs, at once. So do SIGTERM and
    SIGHUP, after which the process ends: `LoopTerminated`, a SystemExit that carries the record, is raised,
    or the handler called that was there before. (This is so in the main thread, the only one that signals
    reach.)

    Raises LoopError, with record, state and timing so far, for whatever the robot, the goal or the controller
    raises. Before the robot starts: StateError for a checkpoint that cannot be written, and ArgumentError for
    one that cannot be named so, for an interface that lacks a method, for what is no goal, a set-point beyond
    the joint limits or one that the effort limits cannot hold.
    """
    dt = require_number("dt", dt, 0)
    steps = round(require_number("duration", duration, 0, LONGEST) / dt)
    if steps < 1:
        raise ArgumentError(f"duration: expected at least one step of {dt:g} s, got {duration:g} s")
    if (fault := getattr(state, "fault", None)) is not None:
        raise ArgumentError(f"state: holds the fault {fault}; clear it with state = controller.reset(state)")
    require_controller(controller)
    require_interface(interface)
    _require_unset(stop)
    _require_reachable(controller.robot, goal)
    shaping = Shaped(controller, limits) if shaped and not shapes(controller) else None
    after_fault = require_number("after_fault", after_fault, 0, closed=True)
    warm = _warm_up(controller, shaping, dt)
    books = Bookkeeping(controller, dt, steps + 1, title, warm if state is None else state, checkpoint, every)
    loop = _Loop(controller, shaping, interface, goal, dt, steps, books, stop)
    with Interruption() as interruption:
        with undisturbed(priority, cpus):
            ended, cause = _driven(loop, state, after_fault, interruption)
        unstopped = _unstopped(loop, interruption)
        books.save(loop.state)
        timing, record = loop.pacer.timing(), books.record()
        if interruption.signals and ended == "duration":
            ended = "interrupted"
    interruption.hand_on()
    ending = interruption.ending
    if cause is not None:
        done = f"{timing.ticks} of {steps} steps{f' and {ending.name}' if ending else ''}"
        moves = f"; {unstopped}" if unstopped else ""
        message = f"the loop ended after {done}: {type(cause).__name__}: {cause}{moves}"
        raise LoopError(message, record, loop.state, timing) from cause
    if ending is not None:
        raise LoopTerminated(ending, record, loop.state, timing)
    if record is None:
        message = books.failures.get("record", "the loop was interrupted before its first step")
        raise LoopError(message, None, loop.state, timing)
    fault, unkept = getattr(loop.state, "fault", None), tuple(books.failures.values())
    return LoopResult(record, loop.state, timing, ended, fault, unkept, unstopped)


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
        books: Bookkeeping,
        stop: Event | None,
    ):
        self.stop = stop
        self.robot = controller.robot
        self.controller, self.shaping, self.interface, self.books = controller, shaping, interface, books
        self.dt, self.steps = dt, steps
        self.goal_at: Callable[[float], Goal] = goal if callable(goal) else (lambda _t: goal)
        keeps_clock = bool(getattr(interface, "keeps_clock", False))
        self.pacer = Pacer(dt, steps + 1, robot_keeps_clock=keeps_clock)
        self.state: Any = None  # the controller's
        self.reference: Any = None  # the shaping's state, where there is one
        self.began = self.latest = 0.0  # [s] by the robot's clock: the first measurement, and the last one

    def run(self, state: Any, after_fault: float, interruption: Interruption) -> str:
        """All ticks, from a state or afresh; returns how they ended."""
        self.begin(state)
        ended, left = "duration", self.steps
        while self.pacer.ticks + self.pacer.missed < self.steps and left > 0:
            if interruption.signals:
                return "interrupted"
            if self.stop and self.stop.is_set():
                return "stopped"
            fault = self.tick()
            if getattr(self.state, "brake", False):
                return "fault"
            self.pacer.wait()
            if fault is not None:
                ended, left = "fault", min(left, round(after_fault / self.dt) + 1) - 1
        return ended

    def begin(self, state: Any) -> None:
        """The first measurement, and a state at it."""
        first = self.interface.read()
        self.began = self.latest = first.t
        self.state = self.controller.init(first) if state is None else self._resumed(state, first)
        if self.shaping:
            self.reference = self.shaping.around(self.state, first)
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
        t = shown_number(getattr(measurement, "t", None))
        self.pacer.began(time.monotonic() - before, t - self.latest)
        goal = self.goal_at(t - self.began)
        seen = self._seen(measurement)  # now: the driver may use its buffers again
        self.latest = t
        if self.shaping:
            self.reference, tau = self.shaping.step(self.reference, measurement, goal, self.dt)
            self.state = self.reference.inner
        else:
            self.state, tau = self.controller.step(self.state, measurement, goal, self.dt)
        sent = np.array(tau, dtype=float)
        try:
            self.interface.write(sent.copy())
        except Exception:
            if not getattr(self.state, "brake", False):  # else the gate's fault is why it ends
                raise
        self.books.keep(*seen, sent, shown_reference(goal, self.robot), self.state, self.pacer.ticks + 1)
        return getattr(self.state, "fault", None)

    def _seen(self, measurement: Any) -> tuple[float, np.ndarray, np.ndarray]:
        """t, q and v as the record shows them."""
        nq, nv = self.robot.nq, self.robot.nv
        q, v = (shown_vector(getattr(measurement, n, None), size) for n, size in (("q", nq), ("v", nv)))
        return shown_number(getattr(measurement, "t", None)), q, v


def _driven(
    loop: _Loop, state: Any, after_fault: float, interruption: Interruption
) -> tuple[str, Exception | None]:
    """How the loop ended, and what it failed with, if it did; the robot is stopped."""
    try:
        try:
            try:
                with interruption.impatient():
                    loop.interface.start()
                ended = loop.run(state, after_fault, interruption)
            finally:
                interruption.settle()
        finally:  # its own, since a signal may raise just before it is settled
            loop.interface.stop()
    except KeyboardInterrupt:
        return "interrupted", None
    except Exception as reason:
        return "failure", reason
    return ended, None


def _unstopped(loop: _Loop, interruption: Interruption) -> str:
    """Which joint moves although the robot was told to stop, and how fast; "" if none is seen to."""
    if not loop.pacer.ticks:
        return ""
    try:
        with interruption.unimportant():
            t, _, v, _ = loop.robot.check_measurement(loop.interface.read())
    except (Exception, KeyboardInterrupt):  # a robot that has stopped need not answer
        return ""
    if not t > loop.latest:  # the last one again
        return ""
    share = np.abs(v) / speed(loop.robot.velocity_limit)
    i = int(share.argmax())
    if share[i] <= MOVING:
        return ""
    said = f"stop returned while {loop.robot.joint_names[i]!r} moves at {v[i]:.3g} rad/s"
    with contextlib.suppress(Warning):  # where warnings are errors, too
        warnings.warn(f"{said}; do its brakes close?", BrakesWarning, stacklevel=3)
    return said


def require_interface(interface: Any) -> None:
    """Raises ArgumentError for what lacks a method of `RobotInterface`: without `stop` nothing may start."""
    methods = ("start", "read", "write", "stop")
    if missing := [name for name in methods if not callable(getattr(interface, name, None))]:
        raise ArgumentError(
            f"interface: expected a robot with the methods {', '.join(methods)}, see RobotInterface; "
            f"{type(interface).__name__} lacks {', '.join(missing)}"
        )


def _require_unset(stop: Any) -> None:
    """Raises ArgumentError for what is no event, and for one that is set already."""
    if stop is not None and not callable(getattr(stop, "is_set", None)):
        raise ArgumentError(f"stop: expected a threading.Event or None, got {stop!r}")
    if stop is not None and stop.is_set():
        raise ArgumentError("stop: is set already, so nothing may move; clear it first: stop.clear()")


def _require_reachable(robot: Robot, goal: GoalCourse) -> None:
    """Raises ArgumentError for what is no goal, for a set-point beyond the joint limits, or one that the
    effort limits cannot hold; a callable is left to the gate."""
    if callable(goal):
        return
    try:
        q = robot.check_goal(goal).q
    except (ArgumentError, TypeError, ValueError) as reason:
        raise ArgumentError(
            f"{reason}; expected q_d ({robot.nq},), a Reference, or a callable of the time [s] that returns "
            f"either, got {goal!r}"
        ) from reason
    require_within(robot, q, "goal")
    require_holdable(robot, q, "goal")


def _warm_up(controller: BareController, shaping: Shaped | None, dt: float) -> Any:
    """A few steps at home that nobody sees; the controller's state after them, None if it refuses."""
    stepped: BareController = shaping or controller
    robot = controller.robot
    q = robot.configuration(robot.home)
    measurement = Measurement(0.0, q, np.zeros(robot.nv), robot.gravity(q))
    try:
        state = stepped.init(measurement)
        for k in range(WARM_UP):
            state, _ = stepped.step(state, measurement._replace(t=k * dt), q, dt)
    except EladaptError:
        return None  # it will be said where it matters, with the robot's own measurement
    return state.inner if shaping else state
