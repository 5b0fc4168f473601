"""The last thing before torque leaves: what is measured is judged, what is sent is bounded.

A sample is trusted, or it is not: not finite, of the wrong shape, not newer than the last, the same numbers
although the robot moves, or further off than the robot can have come. Without a trusted sample for
``max_age``, or when a trusted one shows that a limit is passed or that the loop diverges, the gate latches a
fault: a name and a time. From then on it does not take the controller's torque but holds the arm: damping, a
spring to where it was, and the last trusted gravity estimate. That estimate is the gradient of a potential
whatever its parameters are, and the spring is another, so damping takes energy out even if both are wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, UnknownNameError, require_gain, require_number, require_vector
from eladapt.gains.extremes import effort, extremes
from eladapt.robot.model import Robot
from eladapt.robot.protocols import Goal
from eladapt.safety.barrier import Barrier
from eladapt.safety.guards import Alarm, DivergenceGuard, GuardState
from eladapt.signals import Fault, Measurement, Reference

FAULTS = (
    "measurement", "watchdog", "frozen", "jump", "goal", "velocity", "joint limit", "error growth",
    "energy growth", "stall", "controller", "torque",
)  # fmt: skip

FULL = 0.99  # of the effort limit
FADING = 0.2  # [s]
LONGEST_HORIZON = 0.2  # [s] of the barrier: slower torque than that is no brake
FAR = 1.0  # [rad or m] beyond its range no joint is where it is seen
FASTEST = 1e3  # [rad/s] no arm turns at 10,000 rpm; where the URDF sets no limit, this one holds
ROUNDING = 1e-9  # of max_age: steps of dt that sum up to it do not exceed it


class GateState(NamedTuple):
    """What the gate remembers."""

    measurement: Measurement  # the last trusted one
    goal: Reference  # the last valid one
    age: float  # [s] of the last trusted measurement; 0 when it is this sample's
    suspicion: str  # why the samples since were not trusted
    q: np.ndarray  # (nq,) where the robot is believed to be: measured, or predicted since
    v: np.ndarray  # (nv,)
    tau: np.ndarray  # (nv,) [N m] what left last
    unexplained: np.ndarray  # (nv,) [N m] what acts on the arm beside the torque and the model
    guard: GuardState
    seen: int = 0  # trusted samples judged since `init`
    fault: Fault | None = None
    anchor: np.ndarray | None = None  # (nq,) where the fallback holds the arm
    offset: np.ndarray | None = None  # (nv,) [N m] what the trusted gravity estimate had lacked, fading


@dataclass(frozen=True, eq=False)
class TorqueGate:
    """Limits, and what is done beyond them; arrays are (nv,), in the order of the joints.

    effort [N m]; torque_rate [N m/s]; velocity [rad/s]; lower, upper [rad]: what may not be passed, inf where
    nothing is set. A joint limit counts as passed when the velocity would carry the joint over it within
    ``lookahead`` [s]. max_age [s]: how long the last torque is held without a trusted measurement. resolution
    [rad]: what a moving joint must show for its sensor not to be called frozen. P [N m/rad], D [N m s/rad]:
    spring and damper of the fallback; slack [rad]: further off, the spring's anchor is dragged along; horizon
    [s]: how far ahead the fallback evaluates its law; 10 ms bear a delay of 5 ms on a panda. guard: what
    counts as divergence. barrier: None leaves the controller's torque as it is below the limits. Raises
    ArgumentError for what is not positive.
    """

    robot: Robot
    effort: np.ndarray
    torque_rate: np.ndarray
    velocity: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    P: np.ndarray
    D: np.ndarray
    slack: float = 0.4
    horizon: float = 0.01
    max_age: float = 0.02
    lookahead: float = 0.02
    resolution: float = 1e-4
    guard: DivergenceGuard = field(default_factory=DivergenceGuard)
    barrier: Barrier | None = None

    def __post_init__(self) -> None:
        nv = self.robot.nv
        for name in ("effort", "P", "D"):  # a fallback without bound would be none
            object.__setattr__(self, name, require_gain(name, getattr(self, name), nv))
        for name in ("torque_rate", "velocity"):
            limit = np.asarray(getattr(self, name), dtype=float)
            if limit.shape not in ((), (nv,)) or not np.all(limit > 0):
                raise ArgumentError(f"{name}: expected positive, scalar or ({nv},), got {limit}")
            object.__setattr__(self, name, np.broadcast_to(limit, (nv,)).copy())
        for name in ("lower", "upper"):
            limit = np.asarray(getattr(self, name), dtype=float)
            if limit.shape not in ((), (nv,)) or np.isnan(limit).any():
                raise ArgumentError(f"{name}: expected numbers, scalar or ({nv},), got {limit}")
            object.__setattr__(self, name, np.broadcast_to(limit, (nv,)).copy())
        if np.any(self.lower >= self.upper):
            raise ArgumentError(f"lower, upper: expected lower < upper, got {self.lower} and {self.upper}")
        for name in ("max_age", "resolution", "slack", "horizon"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))
        ahead = require_number("lookahead", self.lookahead, 0, np.finfo(float).max, closed=True)
        object.__setattr__(self, "lookahead", ahead)

    @classmethod
    def for_robot(cls, robot: Robot, dt: float = 1e-3, **given: Any) -> TorqueGate:
        """Limits from the URDF; those ``given`` by name are kept.

        effort: the URDF's, or max(3 max|g|, 20 max M) where it sets none. torque_rate: all of it in 10 ms, or
        ten steps of dt, and no more than the maker allows. velocity: 1.1 times the URDF's, 1 for what a noisy
        sensor adds. max_age: 20 ms, or five steps. P: all effort at half a radian; D: critical for the
        largest inertia. Raises UnknownNameError for a name that is no limit.
        """
        dt = require_number("dt", dt, 0)
        legal = [name for name in cls.__dataclass_fields__ if name != "robot"]
        if unknown := [name for name in given if name not in legal]:
            raise UnknownNameError("limit", unknown, legal)
        largest = extremes(robot)
        limit = np.broadcast_to(np.asarray(given.get("effort", effort(robot, largest)), float), robot.nv)
        P = np.broadcast_to(np.asarray(given.get("P", 2 * limit), float), robot.nv)
        rate = limit / max(0.01, 10 * dt)
        if "torque_rate" in robot.published:
            rate = np.minimum(rate, robot.published["torque_rate"])
        derived = {
            "effort": limit, "torque_rate": rate, "max_age": max(0.02, 5 * dt),
            "horizon": max(0.01, 3 * dt),
            "velocity": 1.1 * robot.velocity_limit, "lower": robot.lower, "upper": robot.upper,
            "P": P, "D": 2 * np.sqrt(P * largest.inertia),
        }  # fmt: skip
        limits = {**derived, **given}
        velocity, lower, upper = (
            np.broadcast_to(np.asarray(limits[name], dtype=float), robot.nv)
            for name in ("velocity", "lower", "upper")
        )
        reversing = np.asarray(limits["effort"]) / np.asarray(limits["torque_rate"])
        horizon = np.maximum(max(0.01, 10 * dt), np.minimum(reversing, LONGEST_HORIZON))
        barrier = Barrier(robot, velocity, lower, upper, time=np.maximum(0.1, 4 * horizon), horizon=horizon)
        return cls(robot, **{"barrier": barrier, **limits})

    def init(self, measurement: Measurement) -> GateState:
        """Nothing is wrong at the first measurement. Raises ArgumentError if that is not an arm's."""
        measurement = self.robot.check_measurement(measurement)
        _, q, v, tau = measurement
        if np.abs(v).max() > FASTEST:
            raise ArgumentError(f"measurement.v: expected at most {FASTEST:g} rad/s, got {v}")
        x = self.robot.coordinates(q)
        beyond = np.maximum(x - self.upper, self.lower - x)
        if beyond.max() > FAR:
            k = int(beyond.argmax())
            degrees = self.lower[k] <= np.deg2rad(x[k]) <= self.upper[k]
            raise ArgumentError(
                f"measurement.q: {self.robot.joint_names[k]} at {x[k]:.4g} is far beyond its limits, "
                f"{self.lower[k]:.4g} to {self.upper[k]:.4g}{'; are these degrees?' if degrees else ''}"
            )
        tau = np.clip(tau, -self.effort, self.effort)
        nv = self.robot.nv
        here = Reference(q, np.zeros(nv), np.zeros(nv))
        return GateState(measurement, here, 0.0, "", q, v, tau, np.zeros(nv), self.guard.init(q, nv))

    def watch(self, state: GateState, measurement: Measurement, goal: Goal, dt: float) -> GateState:
        """Judge a sample and a goal; `age` is 0 if they are trusted, and `fault` says what is wrong."""
        try:
            given = self.robot.check_goal(goal)
            state = state._replace(goal=Reference(*(np.array(part) for part in given)))
        except ArgumentError as reason:
            state = self.latch(state, "goal", str(reason))
        try:
            measurement = self.robot.check_measurement(measurement)
        except (ArgumentError, TypeError, ValueError, OverflowError) as reason:
            doubt: Alarm | None = Alarm("measurement", str(reason))
        else:
            doubt = self._doubt(state, measurement, dt)
        if doubt is None:
            return self._guarded(state, measurement, dt)
        age = state.age + dt
        state = state._replace(age=age, suspicion=doubt.name)
        if age > self.max_age * (1 + ROUNDING):
            said = f"no trusted measurement for {age:.3g} s; the last one: {doubt.message}"
            state = self.latch(state, doubt.name, said)
        return state

    def latch(self, state: GateState, name: str, message: str) -> GateState:
        """The state with this fault, unless there is one already: the first one counts."""
        if state.fault is not None:
            return state
        return state._replace(fault=Fault(name, state.measurement.t + state.age, message))

    def slowed(self, state: GateState, tau: np.ndarray) -> np.ndarray:
        """tau (nv,) within what the barrier allows at the trusted sample."""
        if self.barrier is None:
            return tau
        slowed = self.barrier.torque(state.q, state.v, tau, state.unexplained)
        return slowed if np.isfinite(slowed).all() else tau

    def limited(self, state: GateState, tau: np.ndarray, dt: float) -> np.ndarray:
        """tau (nv,), finite, no further from the last torque than the rate allows, within the effort."""
        step = self.torque_rate * dt
        near = np.minimum(np.maximum(tau, state.tau - step), state.tau + step)
        return np.minimum(np.maximum(near, -self.effort), self.effort)

    def coast(self, state: GateState, dt: float) -> GateState:
        """Where the arm goes under the torque that is held, by the model and what it had not explained."""
        robot = self.robot
        acceleration = robot.forward_dynamics(state.q, state.v, state.tau + state.unexplained)
        v = state.v + dt * acceleration
        return _believed(robot, state, v, dt)

    def fallback(self, state: GateState, gravity: np.ndarray, dt: float) -> tuple[GateState, np.ndarray]:
        """Brake and hold: the torque (nv,) a horizon H ahead, M (w - v) = H (-P (e + H w) - D w).

        gravity (nv,): the trusted estimate at ``state.q``. As long as nothing is measured, what it lacked
        when the fault came stays, and w is where the arm is believed to go: braking goes on blindly, and
        fades as it must have taken effect. An arm that is never measured again needs its brakes.
        """
        robot, offset = self.robot, state.offset
        if offset is None:
            lacking = robot.gravity(state.q) - state.unexplained - gravity
            offset = np.clip(lacking, -self.effort, self.effort)
        anchor = state.q if state.anchor is None else state.anchor
        far = robot.difference(anchor, state.q)
        e = np.clip(far, -self.slack, self.slack)
        anchor = robot.integrate(anchor, far - e)
        mass_matrix, ahead = robot.mass_matrix(state.q), max(dt, self.horizon)
        implicit = mass_matrix + np.diag(ahead * self.D + ahead**2 * self.P)
        w = np.linalg.solve(implicit, mass_matrix @ state.v - ahead * self.P * e)
        tau = gravity + offset - self.P * (e + ahead * w) - self.D * w
        if state.age > 0:
            v = state.v + dt / ahead * (w - state.v)
            return _believed(robot, state, v, dt)._replace(anchor=anchor, offset=offset), tau
        return state._replace(anchor=anchor, offset=offset * np.exp(-dt / FADING)), tau

    def _doubt(self, state: GateState, measurement: Measurement, dt: float) -> Alarm | None:
        """Why a finite sample is not to be trusted."""
        last, robot = state.measurement, self.robot
        elapsed = measurement.t - last.t
        if elapsed == 0 and state.seen == 0:
            return None  # the first sample is that of `init`
        if elapsed <= 0:
            return Alarm("watchdog", f"its time stamp {measurement.t:.6g} s is not after {last.t:.6g} s")
        if np.abs(measurement.v).max() > FASTEST:
            return Alarm("jump", f"a speed of {np.abs(measurement.v).max():.3g} is no arm's")
        moved = pin.difference(robot.model, last.q, measurement.q)
        same = not moved.any() and np.array_equal(measurement.v, last.v)
        if same and np.abs(last.v).max() * (state.age + dt) > self.resolution:
            i = int(np.argmax(np.abs(last.v)))
            said = f"{robot.joint_names[i]!r} moves at {last.v[i]:.3g} rad/s and stays in one place"
            return Alarm("frozen", said)
        jump = np.abs(moved) - 2 * self.velocity * (elapsed + dt)
        change = np.abs(measurement.v - last.v) - self.velocity * (1 + elapsed / self.max_age)
        for what, beyond, unit in (("position", jump, "rad"), ("velocity", change, "rad/s")):
            i = int(beyond.argmax())
            if beyond[i] > 0:
                said = f"the {what} of {robot.joint_names[i]!r} is {beyond[i]:.3g} {unit} out of reach"
                return Alarm("jump", said)
        return None

    def _guarded(self, state: GateState, measurement: Measurement, dt: float) -> GateState:
        """The state at a trusted sample, with a fault if it shows one."""
        robot, goal, (_, q, v, tau) = self.robot, state.goal.q, measurement
        error = pin.difference(robot.model, goal, q)
        moved = pin.difference(robot.model, state.guard.goal, goal)
        full = np.maximum(np.abs(tau), np.abs(state.tau)) >= FULL * self.effort
        guard = self.guard.step(state.guard, error, moved, goal, v, full, dt)
        unexplained, last = state.unexplained, state.measurement
        elapsed = measurement.t - last.t
        if self.barrier and state.age == 0 and 0 < elapsed < 2 * dt:
            unexplained = self.barrier.unexplained(unexplained, last, measurement, elapsed)
        anchor = state.anchor if state.age == 0 else None  # what was predicted blindly is no place to hold
        state = state._replace(
            measurement=measurement, age=0.0, suspicion="", q=q, v=v, anchor=anchor, guard=guard,
            unexplained=unexplained, seen=state.seen + 1,
        )  # fmt: skip
        if state.fault is not None:
            return state
        x = robot.coordinates(q)
        ahead = x + self.lookahead * v
        beyond = np.where(v > 0, ahead - self.upper, np.where(v < 0, self.lower - ahead, -np.inf))
        i = int(beyond.argmax())
        if beyond[i] > 0:
            said = (
                f"{robot.joint_names[i]!r} at {x[i]:.4g} rad with {v[i]:.3g} rad/s, limits "
                f"{self.lower[i]:.4g} and {self.upper[i]:.4g}"
            )
            return self.latch(state, "joint limit", said)
        fast = np.abs(v) - self.velocity
        i = int(fast.argmax())
        if fast[i] > 0:
            said = f"{robot.joint_names[i]!r} at {v[i]:.3g} rad/s, limit {self.velocity[i]:.3g}"
            return self.latch(state, "velocity", said)
        alarm = self.guard.alarm(guard, error, robot)
        return self.latch(state, *alarm) if alarm else state


def _believed(robot: Robot, state: GateState, v: np.ndarray, dt: float) -> GateState:
    """The state with the arm dt [s] further at v (nv,), unless that is no motion of an arm."""
    if not np.all(np.abs(v) < FASTEST):
        return state
    return state._replace(q=robot.integrate(state.q, dt * v), v=v)


def checked_torque(tau: Any, nv: int) -> np.ndarray:
    """tau as a finite float vector of its own; raises ArgumentError. Clamping a nan would hide it."""
    return np.array(require_vector("torque", tau, nv))
