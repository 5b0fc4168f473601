"""The last thing before torque leaves: what is measured is judged, what is sent is bounded.

A sample is trusted, or it is not: not finite, of the wrong shape, not newer than the last, the same numbers
although the robot moves, or further off than the robot can have come. Without a trusted sample for
``max_age``, or when a trusted one shows that a limit is passed, that the loop diverges or that a sensor or a
drive is not to be believed, the gate latches a fault: a name and a time. From then on it does not take the
controller's torque but holds the arm by its `Fallback`, or asks for brakes where no torque is known to help.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.compiling import prepare
from eladapt.errors import ArgumentError, UnknownNameError, require_gain, require_number, require_vector
from eladapt.gains.extremes import effort, extremes
from eladapt.gains.rules import shown
from eladapt.robot.joint_limits import require_limit
from eladapt.robot.model import Robot
from eladapt.robot.postures import require_holdable, require_within
from eladapt.robot.protocols import Goal
from eladapt.safety.barrier import Barrier, rotored
from eladapt.safety.belief import Belief, BeliefState
from eladapt.safety.fallback import Fallback, Hold
from eladapt.safety.guards import Alarm, DivergenceGuard, GuardState
from eladapt.safety.limiting import at_limit, leaving, near, too_fast
from eladapt.safety.samples import FASTEST, SampleJudge
from eladapt.signals import Fault, Measurement, Reference

FAULTS = (
    "measurement", "watchdog", "frozen", "jump", "goal", "velocity", "joint limit", "error growth",
    "energy growth", "oscillation", "stall", "reversed", "unresponsive", "sensor", "contact", "controller",
    "torque",
)  # fmt: skip

LONGEST_HORIZON = 0.2  # [s] of the barrier: slower torque than that is no brake
FAR = 0.1  # [rad or m] beyond its range a joint is not where it is seen, or nowhere to start from
EDGE = 1e-3  # [rad or m] by which a goal may be beyond
RANGE = ("lower", "upper")  # may be negative
LIMITS = ("torque_rate", "velocity", "contact", *RANGE)
ROUNDING = 1e-9  # of max_age: steps of dt that sum up to it do not exceed it


class GateState(NamedTuple):
    """What the gate remembers."""

    measurement: Measurement  # the last trusted one
    goal: Reference  # the last valid one
    age: float  # [s] of the last trusted measurement; 0 when it is this sample's
    clock: float  # [s] from the robot's clock to the gate's, which is never set back
    tau: np.ndarray  # (nv,) [N m] what left last
    unexplained: np.ndarray  # (nv,) [N m] what acts on the arm beside the torque and the model
    guard: GuardState
    belief: BeliefState
    seen: int = 0  # trusted samples judged since `init`
    fault: Fault | None = None
    hold: Hold | None = None  # where the fallback stands, once there is a fault

    def __repr__(self) -> str:
        return f"GateState({self.seen} samples judged, fault: {self.fault or 'none'})"

    @property
    def q(self) -> np.ndarray:
        """(nq,) where the arm was seen last."""
        return self.measurement.q

    @property
    def v(self) -> np.ndarray:
        """(nv,) [rad/s] how fast."""
        return self.measurement.v


@dataclass(frozen=True, eq=False)
class TorqueGate:
    """Limits, and what is done beyond them; arrays are (nv,), in the order of the joints.

    effort [N m]; torque_rate [N m/s]; velocity [rad/s]; lower, upper [rad]: what may not be passed, inf
    where nothing is set. A joint limit counts as passed when the velocity would carry the joint over it
    within ``lookahead`` [s]. contact [N m]: of the external torque that the controller estimates,
    ``state.external``; inf: none stops the arm. max_age [s]: how long the last torque is held without a
    trusted measurement. resolution [rad]: what a moving joint must show for its sensor not to be called
    frozen. fallback: what holds the arm after a fault. guard: what counts as divergence. barrier: None
    leaves the controller's torque as it is below the limits. Raises ArgumentError for what is not positive.
    """

    robot: Robot
    effort: np.ndarray
    torque_rate: np.ndarray
    velocity: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    fallback: Fallback
    belief: Belief
    contact: float | np.ndarray = np.inf
    max_age: float = 0.02
    lookahead: float = 0.02
    resolution: float = 1e-4
    guard: DivergenceGuard = field(default_factory=DivergenceGuard)
    barrier: Barrier | None = None

    def __repr__(self) -> str:
        return f"TorqueGate({self.robot.name}, effort {shown(self.effort)}, velocity {shown(self.velocity)})"

    def __post_init__(self) -> None:
        prepare()
        nv = self.robot.nv
        object.__setattr__(self, "effort", require_gain("effort", self.effort, nv))
        for name in LIMITS:
            object.__setattr__(
                self, name, require_limit(name, getattr(self, name), nv, positive=name not in RANGE)
            )
        if np.any(self.lower >= self.upper):
            raise ArgumentError(f"lower, upper: expected lower < upper, got {self.lower} and {self.upper}")
        for name in ("max_age", "resolution"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))
        ahead = require_number("lookahead", self.lookahead, 0, np.finfo(float).max, closed=True)
        object.__setattr__(self, "lookahead", ahead)

    @classmethod
    def for_robot(cls, robot: Robot, dt: float = 1e-3, **given: Any) -> TorqueGate:
        """Limits from the URDF; those ``given`` by name are kept.

        effort: the URDF's, or max(3 max|g|, 20 max M) where it sets none. torque_rate: all of it in 10 ms,
        or ten steps of dt, and no more than the maker allows. velocity: the URDF's and a tenth
        more, for the noise of what is measured. max_age: 20 ms, or five steps. fallback: with a horizon of
        10 ms, or three steps. belief: `Belief.for_robot`. Raises UnknownNameError for a name that is no
        limit, ArgumentError for a limit that is no number.
        """
        dt = require_number("dt", dt, 0)
        legal = [name for name in cls.__dataclass_fields__ if name != "robot"]
        if unknown := [name for name in given if name not in legal]:
            raise UnknownNameError("limit", unknown, legal)
        for name in [name for name in ("effort", *LIMITS) if name in given]:
            given[name] = require_limit(name, given[name], robot.nv, positive=name not in RANGE)
        if "max_age" in given:
            require_number("max_age", given["max_age"], 0)
        limit = given.get("effort", effort(robot, extremes(robot)))
        rate = limit / max(0.01, 10 * dt)
        if "torque_rate" in robot.published:
            rate = np.minimum(rate, robot.published["torque_rate"])
        derived = {
            "effort": limit, "torque_rate": rate, "max_age": max(0.02, 5 * dt),
            "velocity": 1.1 * robot.velocity_limit, "lower": robot.lower, "upper": robot.upper,
        }  # fmt: skip
        limits = {**derived, **given}
        velocity, lower, upper = (limits[name] for name in ("velocity", "lower", "upper"))
        reversing = limit / limits["torque_rate"]
        horizon = np.maximum(max(0.01, 10 * dt), np.minimum(reversing, LONGEST_HORIZON))
        time, moved = np.maximum(0.1, 4 * horizon), rotored(robot, limit)
        barrier = Barrier(moved, velocity, lower, upper, time=time, horizon=horizon)
        fallback = Fallback(
            robot, limit, limits["torque_rate"], max(0.01, 3 * dt), bridging=limits["max_age"]
        )
        belief = Belief.for_robot(robot, limit, velocity)
        return cls(robot, **{"barrier": barrier, "fallback": fallback, "belief": belief, **limits})

    def init(self, measurement: Measurement) -> GateState:
        """Nothing is wrong at the first measurement. Raises ArgumentError if that is not an arm's."""
        measurement = self.robot.check_measurement(measurement)
        _, q, v, tau = measurement
        if np.abs(v).max() > FASTEST:
            raise ArgumentError(f"measurement.v: expected at most {FASTEST:g} rad/s, got {v}")
        require_within(self.robot, q, "measurement.q", lower=self.lower, upper=self.upper, slack=FAR)
        tau = np.clip(tau, -self.effort, self.effort)
        nv = self.robot.nv
        here = Reference(q, np.zeros(nv), np.zeros(nv))
        nothing = np.zeros(nv)
        return GateState(
            measurement, here, 0.0, 0.0, tau, nothing, self.guard.init(q, nv), self.belief.init()
        )

    def watch(self, state: GateState, measurement: Measurement, goal: Goal, dt: float) -> GateState:
        """Judge a sample and a goal; `age` is 0 if they are trusted, and `fault` says what is wrong."""
        try:
            state = state._replace(goal=self._possible(state.goal, self.robot.check_goal(goal)))
        except ArgumentError as reason:
            state = self.latch(state, "goal", str(reason))
        try:
            measurement = self.robot.check_measurement(measurement)
        except (ArgumentError, TypeError, ValueError, OverflowError) as reason:
            doubt: Alarm | None = Alarm("measurement", str(reason))
        else:
            last, age = state.measurement, state.age
            if back := self._samples.set_back(last, measurement.t + state.clock):
                state = state._replace(clock=state.clock + back + age + dt)
            measurement = measurement._replace(t=measurement.t + state.clock)
            doubt = self._samples.doubt(last, measurement, age, dt, first=state.seen == 0)
        if doubt is None:
            return self._guarded(state, measurement, dt)
        age = state.age + dt
        state = state._replace(age=age)
        if age > self.max_age * (1 + ROUNDING):
            said = f"no trusted measurement for {age:.3g} s; the last one: {doubt.message}"
            state = self.latch(state, doubt.name, said)
        return state

    def latch(self, state: GateState, name: str, message: str) -> GateState:
        """The state with this fault, unless there is one already: the first one counts."""
        if state.fault is not None:
            return state
        return state._replace(fault=Fault(name, state.measurement.t + state.age - state.clock, message))

    def touched(self, state: GateState, external: np.ndarray | None) -> GateState:
        """The state with the fault "contact" where external torque (nv,) is beyond the limit."""
        if external is None or not np.any(np.abs(external) > self.contact):
            return state
        i = int(np.argmax(np.abs(external) / self.contact))
        said = f"{external[i]:.3g} N m act on {self.robot.joint_names[i]!r} from outside, limit "
        return self.latch(state, "contact", f"{said}{self.contact[i]:.3g}")  # type: ignore[index]

    def slowed(self, state: GateState, tau: np.ndarray) -> np.ndarray:
        """tau (nv,) within what the barrier allows at the trusted sample."""
        if self.barrier is None:
            return tau
        slowed = self.barrier.torque(state.q, state.v, tau, state.unexplained)
        return slowed if np.isfinite(slowed).all() else tau

    def limited(self, state: GateState, tau: np.ndarray, dt: float) -> np.ndarray:
        """tau (nv,), finite, no further from the last torque than the rate allows, within the effort."""
        return near(tau, state.tau, self.torque_rate, self.effort, dt)

    def stopped(self, state: GateState, gravity: np.ndarray, dt: float) -> tuple[GateState, np.ndarray]:
        """The torque (nv,) after a fault; gravity (nv,): the trusted estimate at ``state.q``."""
        fallback, tau = self.fallback, state.tau
        danger = self._danger(state)
        hold = state.hold or fallback.begin(state.q, state.v, gravity, state.unexplained, danger is None)
        if danger:
            hold = fallback.braked(hold, danger.message)
        if state.age > self.max_age * (1 + ROUNDING):
            hold = fallback.braked(hold, f"no trusted measurement for {state.age:.3g} s")
        if hold.braking is None and state.age == 0:
            hold, tau = fallback.held(hold, state.q, state.v, gravity, state.tau, dt)
        if hold.braking is not None:
            hold, tau = fallback.fading(hold, dt)
        tau = tau if np.isfinite(tau).all() else state.tau
        return state._replace(hold=hold, tau=tau), tau

    def _possible(self, before: Reference, goal: Reference) -> Reference:
        """The goal. Raises ArgumentError where it is beyond the limits, or rests where the arm cannot."""
        if not np.array_equal(goal.q, before.q):
            require_within(self.robot, goal.q, "goal", lower=self.lower, upper=self.upper, slack=EDGE)
            if not goal.v.any():
                require_holdable(self.robot, goal.q, "goal", self.effort)
        return goal

    @functools.cached_property
    def _samples(self) -> SampleJudge:
        return SampleJudge(self.robot, self.velocity, self.max_age, self.resolution)

    def _guarded(self, state: GateState, measurement: Measurement, dt: float) -> GateState:
        """The state at a trusted sample, with a fault if it shows one."""
        robot, goal, (_, q, v, tau) = self.robot, state.goal.q, measurement
        error = pin.difference(robot.model, goal, q)
        moved = pin.difference(robot.model, state.guard.goal, goal)
        full = at_limit(tau, state.tau, self.effort)
        guard = self.guard.step(state.guard, error, moved, goal, v, full, dt)
        unexplained, last, belief = state.unexplained, state.measurement, state.belief
        elapsed = measurement.t - last.t
        moved_by = pin.difference(robot.model, last.q, q)
        if state.age == 0 and 0 < elapsed < 2 * dt:
            a = (v - last.v) / elapsed
            needed = robot.inverse_dynamics(q, v, a, check=False)
            belief = self.belief.step(belief, moved_by, last.v, v, tau, needed, elapsed)
            if self.barrier:
                now = self.barrier.robot.inverse_dynamics(q, v, a, check=False) - tau
                unexplained = self.barrier.unexplained(unexplained, now, elapsed)
        elif elapsed > 0:
            belief = self.belief.after_gap(belief, moved_by, last.v, v, elapsed)
        state = state._replace(
            measurement=measurement, age=0.0, guard=guard, unexplained=unexplained,
            belief=belief, seen=state.seen + 1,
        )  # fmt: skip
        if state.fault is not None:
            return state
        alarm = self._danger(state) or self._beyond(state) or self.guard.alarm(guard, error, v, robot)
        return self.latch(state, *alarm) if alarm else state

    def _danger(self, state: GateState) -> Alarm | None:
        """What says that torque may not help: a joint too fast, or not to be believed."""
        i = too_fast(state.v, self.velocity)
        if i >= 0:
            said = f"{self.robot.joint_names[i]!r} at {state.v[i]:.3g} rad/s, limit {self.velocity[i]:.3g}"
            return Alarm("velocity", said)
        return self.belief.alarm(state.belief)

    def _beyond(self, state: GateState) -> Alarm | None:
        """The joint that is about to leave its range."""
        x, v = self.robot.coordinates(state.q, check=False), state.v
        i = leaving(x, v, self.lower, self.upper, self.lookahead)
        if i < 0:
            return None
        said = (
            f"{self.robot.joint_names[i]!r} at {x[i]:.4g} rad with {v[i]:.3g} rad/s, limits "
            f"{self.lower[i]:.4g} and {self.upper[i]:.4g}"
        )
        return Alarm("joint limit", said)


def checked_torque(tau: Any, nv: int) -> np.ndarray:
    """tau as a finite float vector of its own; raises ArgumentError. Clamping a nan would hide it."""
    return np.array(require_vector("torque", tau, nv))
