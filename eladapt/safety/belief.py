"""Whether sensors and drives can be believed, joint by joint, from what the arm itself must do.

Four questions, none of which needs a quantity that is not measured:

Does a joint answer its torque? The model says what torque the motion that followed needs, s = M a + C v + g,
with a the mean over a few samples. Whatever else acts (a load, a person, friction, parameters that are wrong)
acts beside the torque, so what s and tau *change* by over some milliseconds agrees, z = x. Where z is opposed
to x all the time, encoder or drive turn the wrong way; where z is nothing although tau has changed by more
than friction bears, even for an arm with the largest rotor that is believed, one of them is dead or stuck, or
something holds the joint. So it is where the arm moves for a while as if so large a torque did not act, and
did not before: a load that the URDF does not know takes torque all the time. A load or a push that comes at
once spoils some samples and not a run of them.

Does the position go where the velocity says? Over some milliseconds its integral is compared with the way.

Does a sensor still show the noise that it had at rest? One that did and is the same number to the last bit
for a while is dead.

Does a joint that moves halt between two samples? None can.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.compiling import COUNTS, CUBE, MATRIX, SCALAR, VECTOR, kernel
from eladapt.errors import require_gain
from eladapt.gains.derived import LEAST_ROTOR_ACCELERATION
from eladapt.gains.extremes import levers
from eladapt.robot.joint_limits import speed
from eladapt.robot.model import Robot
from eladapt.safety.guards import Alarm

SPANS = np.array([3, 15])  # samples of a mean; x and z are between two that follow each other
ENOUGH = 2 * SPANS + 2  # samples in a row: a step of something else spoils two spans
PUSH, HAND = 24.0, 0.05  # [N] that a person adds or takes at once, at the tool; [m] beside its frame
OPPOSED = -0.15  # z of x, below which a joint turns against its torque
DEAF = 0.3  # (z with the rotor) of x, below which it does not answer
MEMORY = 0.02  # [s] over which position and velocity are compared
CONTRADICTION = 0.2  # of the way, by which they may differ
LIVELY_MEMORY, LIVELY = 0.15, 0.45  # [s]; share of samples at rest that turn back, of white noise two thirds
SAME = 20  # samples in a row without any noise
IDLE, UNFELT = 20, 0.15  # samples in a row that need less than this part of a torque
FELT, LATELY = 0.2, 100  # part of a torque that was needed but for that, at most so many samples before
HALTED = (3, 5)  # samples in a row after which a joint that moved has halted at once
BRIDGED = 0.05  # [s] over which the mean of two velocities tells a way
SPREAD = 8.0  # standard deviations of the position's white noise that a way may be off by beside
SMALLEST = 1e-8  # [rad, rad/s] a change that is noise and not the tail of something


class BeliefState(NamedTuple):
    """What is remembered of torques and motions: by sample, the newest last, and by joint."""

    rows: np.ndarray  # (3, 2 max SPAN, nv) [N m] torque that acted, needed, and with the largest rotor
    opposed: np.ndarray  # (spans, nv) samples in a row that turned against their torque
    turned: np.ndarray  # [N m] by how much torque changed in them, to and fro
    deaf: np.ndarray  # samples in a row that did not answer it
    pushed: np.ndarray  # [N m] by how much torque changed in them, from first to last
    idle: np.ndarray  # (nv,) samples in a row as if no torque acted, though much does
    felt: np.ndarray  # samples since a torque was felt last
    drift: np.ndarray  # (nv,) [rad] of the position, beside the integral of the velocity
    way: np.ndarray  # [rad] the larger of both
    jitter: np.ndarray  # [rad^2] mean square of the position's white noise
    step: np.ndarray  # [rad] of the position at the last sample
    change: np.ndarray  # [rad/s] of the velocity there
    lively: np.ndarray  # share of samples at rest at which position or velocity turned back
    same: np.ndarray  # samples in a row that were like the one before
    paced: np.ndarray  # [rad/s] how fast it was when its position changed last


@kernel(CUBE, MATRIX, MATRIX, MATRIX, MATRIX, VECTOR, COUNTS, SCALAR, SCALAR)
def runs(
    rows: np.ndarray, opposed: np.ndarray, turned: np.ndarray, deaf: np.ndarray, pushed: np.ndarray,
    least: np.ndarray, spans: np.ndarray, against: float, silent: float,
) -> np.ndarray:  # fmt: skip
    """(4, spans, nv): opposed, turned, deaf and pushed a sample later; a sample whose torque hardly changed
    says nothing, one that answers ends the run."""
    found = np.empty((4, len(spans), len(least)))
    last = rows.shape[1]
    for s in range(len(spans)):
        span = spans[s]
        for i in range(len(least)):
            change = np.zeros(3)
            for what in range(3):
                for k in range(span):
                    change[what] += (rows[what, last - 1 - k, i] - rows[what, last - 1 - span - k, i]) / span
            x, z, heavy = abs(change[0]), change[1] * np.sign(change[0]), change[2] * np.sign(change[0])
            for k, bad, run, so_far, by in (
                (0, z < against * x, opposed[s, i], turned[s, i], x),
                (2, heavy < silent * x, deaf[s, i], pushed[s, i], change[0]),
            ):
                if x <= least[i]:
                    found[k, s, i], found[k + 1, s, i] = run, so_far
                elif bad:
                    found[k, s, i], found[k + 1, s, i] = run + 1.0, so_far + by / span
                else:
                    found[k, s, i], found[k + 1, s, i] = 0.0, 0.0
    return found


@kernel(*[VECTOR] * 12, SCALAR, SCALAR, SCALAR)
def sensed(
    moved: np.ndarray, before: np.ndarray, v: np.ndarray, drift: np.ndarray, way: np.ndarray,
    jitter: np.ndarray, step: np.ndarray, change: np.ndarray, lively: np.ndarray, same: np.ndarray,
    paced: np.ndarray, still: np.ndarray, elapsed: float, memory: float, forgotten: float,
) -> np.ndarray:  # fmt: skip
    """(6, nv): drift, way, jitter, lively, same and paced a sample later."""
    found = np.empty((6, len(v)))
    keep, share = math.exp(-elapsed / memory), 1.0 - math.exp(-elapsed / forgotten)
    for i in range(len(v)):
        along = 0.5 * (before[i] + v[i]) * elapsed
        found[0, i] = keep * drift[i] + moved[i] - along
        found[1, i] = keep * way[i] + max(abs(moved[i]), abs(along))
        found[2, i] = jitter[i] + share * ((moved[i] - step[i]) ** 2 / 6 - jitter[i])
        faster = v[i] - before[i]
        moves, changes = abs(moved[i]) > SMALLEST, abs(faster) > SMALLEST
        back = (moves and moved[i] * step[i] < 0.0) or (changes and faster * change[i] < 0.0)
        found[3, i] = lively[i]
        if abs(v[i]) < still[i]:
            found[3, i] += share * ((1.0 if back else 0.0) - lively[i])
        found[4, i] = same[i] + 1.0 if moved[i] == 0.0 and faster == 0.0 else 0.0
        found[5, i] = abs(v[i]) if moved[i] != 0.0 else paced[i]
    return found


@kernel(MATRIX, MATRIX, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, COUNTS, *[VECTOR] * 8)
def doubted(
    opposed: np.ndarray, turned: np.ndarray, deaf: np.ndarray, pushed: np.ndarray, idle: np.ndarray,
    against: np.ndarray, silent: np.ndarray, enough: np.ndarray, drift: np.ndarray, way: np.ndarray,
    jitter: np.ndarray, contradiction: np.ndarray, same: np.ndarray, paced: np.ndarray, halting: np.ndarray,
    lively: np.ndarray,
) -> int:  # fmt: skip
    """nv times the number of the first reason that a joint gives, and the joint; -1 where none gives any."""
    n = len(drift)
    for i in range(n):
        for s in range(len(enough)):
            if opposed[s, i] >= enough[s] and turned[s, i] > against[i]:
                return i
    for i in range(n):
        for s in range(len(enough)):
            if deaf[s, i] >= enough[s] and abs(pushed[s, i]) > silent[i]:
                return n + i
        if idle[i] >= IDLE:
            return n + i
    worst, farthest = -1, 0.0
    for i in range(n):
        allowed = contradiction[i] + CONTRADICTION * way[i] + SPREAD * math.sqrt(jitter[i])
        if abs(drift[i]) - allowed > farthest:
            worst, farthest = 2 * n + i, abs(drift[i]) - allowed
    if worst >= 0:
        return worst
    for i in range(n):
        if HALTED[0] <= same[i] <= HALTED[1] and paced[i] > halting[i]:
            return 3 * n + i
    for i in range(n):
        if same[i] >= SAME and lively[i] > LIVELY:
            return 4 * n + i
    return -1


@dataclass(frozen=True, eq=False)
class Belief:
    """Thresholds, (nv,): what torque has to change by before a joint is judged by how it answers.

    least [N m]: the change over SPAN samples that says something at all. against [N m]: that in a run that
    is opposed; silent [N m]: in one without an answer, from its first to its last, which friction alone may
    cause: twice itself, where it holds a joint in both directions; and the torque that is missed where it is
    not felt. rotor [kg m^2]: the largest that is believed. contradiction [rad]: by how much a position may
    leave its velocity's integral beside a share of the way. still [rad/s]: below it a joint rests; halting:
    above it none halts between two samples. Raises ArgumentError for what is not positive.
    """

    robot: Robot
    least: np.ndarray
    against: np.ndarray
    silent: np.ndarray
    rotor: np.ndarray
    contradiction: np.ndarray
    still: np.ndarray
    halting: np.ndarray

    def __post_init__(self) -> None:
        for name in ("least", "against", "silent", "rotor", "contradiction", "still", "halting"):
            object.__setattr__(self, name, require_gain(name, getattr(self, name), self.robot.nv))

    @classmethod
    def for_robot(cls, robot: Robot, effort: np.ndarray, velocity: np.ndarray) -> Belief:
        """From the limits, (nv,).

        least: 1 % of the effort. against: 4 %, or what a person who pushes the tool makes. silent: 25 % and
        the URDF's friction, or 1.5 times that push. rotor: one that the effort turns at 50 rad/s^2.
        contradiction: 1.5 ms at the speed limit. still: 0.5 % of the speed limit. halting: 10 % of it.
        """
        fastest, pushed = speed(velocity), PUSH * (levers(robot) + HAND)
        return cls(
            robot,
            least=0.01 * effort,
            against=np.maximum(0.04 * effort, pushed),
            silent=np.maximum(0.25 * effort + robot.friction, 1.5 * pushed),
            rotor=effort / LEAST_ROTOR_ACCELERATION,
            contradiction=1.5e-3 * fastest,
            still=5e-3 * fastest,
            halting=0.1 * fastest,
        )

    def init(self) -> BeliefState:
        """Nothing seen."""
        none, runs = np.zeros(self.robot.nv), np.zeros((len(SPANS), self.robot.nv))
        return BeliefState(
            rows=np.zeros((3, 2 * max(SPANS), self.robot.nv)), opposed=runs, turned=runs, deaf=runs,
            pushed=runs, idle=none, felt=none + LATELY, drift=none, way=none, jitter=none, step=none,
            change=none, lively=none,
            same=none, paced=none,
        )  # fmt: skip

    def step(
        self,
        state: BeliefState,
        moved: np.ndarray,
        before: np.ndarray,
        v: np.ndarray,
        torque: np.ndarray,
        needed: np.ndarray,
        elapsed: float,
    ) -> BeliefState:
        """One more sample, ``elapsed`` [s] after the last: how far the positions moved, the velocities before
        and now, the torque that acted and the one that the motion needed, (nv,) each."""
        heaviest = needed + self.rotor * (v - before) / elapsed
        rows = np.empty_like(state.rows)
        rows[:, :-1] = state.rows[:, 1:]
        rows[0, -1], rows[1, -1], rows[2, -1] = torque, needed, heaviest
        opposed, turned, deaf, pushed = runs(
            rows, state.opposed, state.turned, state.deaf, state.pushed, self.least, SPANS, OPPOSED, DEAF
        )
        unfelt = (np.abs(torque) > self.silent) & (np.abs(needed) < UNFELT * np.abs(torque))
        felt = (np.abs(torque) > 0.5 * self.silent) & (np.abs(needed - torque) < FELT * np.abs(torque))
        since = np.where(felt, 0.0, state.felt + 1.0)
        idle = np.where(unfelt & ((state.idle > 0) | (since < LATELY)), state.idle + 1.0, 0.0)
        state = state._replace(
            rows=rows, opposed=opposed, turned=turned, deaf=deaf, pushed=pushed, idle=idle, felt=since
        )
        return self._sensed(state, moved, before, v, elapsed)

    def after_gap(
        self, state: BeliefState, moved: np.ndarray, before: np.ndarray, v: np.ndarray, elapsed: float
    ) -> BeliefState:
        """The same where samples are missing in between, so that nobody knows which torque acted."""
        kept = self.init()._replace(jitter=state.jitter, lively=state.lively)
        if elapsed >= BRIDGED:
            return kept
        # A way that was not seen is no noise.
        return self._sensed(kept, moved, before, v, elapsed)._replace(jitter=state.jitter)

    def _sensed(
        self, state: BeliefState, moved: np.ndarray, before: np.ndarray, v: np.ndarray, elapsed: float
    ) -> BeliefState:
        drift, way, jitter, lively, same, paced = sensed(
            moved, before, v, state.drift, state.way, state.jitter, state.step, state.change, state.lively,
            state.same, state.paced, self.still, elapsed, MEMORY, LIVELY_MEMORY,
        )  # fmt: skip
        return state._replace(
            drift=drift, way=way, jitter=jitter, step=moved, change=v - before, lively=lively, same=same,
            paced=paced,
        )  # fmt: skip

    def alarm(self, state: BeliefState) -> Alarm | None:
        """The joint that is not to be believed, and why."""
        found = doubted(
            state.opposed, state.turned, state.deaf, state.pushed, state.idle, self.against, self.silent,
            ENOUGH, state.drift, state.way, state.jitter, self.contradiction, state.same, state.paced,
            self.halting, state.lively,
        )  # fmt: skip
        if found < 0:
            return None
        why, i = divmod(found, self.robot.nv)
        name = repr(self.robot.joint_names[i])
        said = (
            (
                "reversed",
                f"{name} turns against its torque: encoder or drive reversed, or something stronger?",
            ),
            (
                "unresponsive",
                f"{name} does not answer its torque: encoder or drive are dead, something holds it, or what "
                "it carries is too heavy",
            ),
            (
                "sensor",
                f"{name} is {state.drift[i]:.3g} rad off where its velocity leads within {MEMORY:g} s",
            ),
            (
                "sensor",
                f"{name} moved at {state.paced[i]:.3g} rad/s and stands in one place from one sample on",
            ),
            ("sensor", f"{name} shows no noise any more: is its encoder dead?"),
        )
        return Alarm(*said[why])
