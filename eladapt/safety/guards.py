"""What shows that a closed loop is coming apart, from positions, velocities and torques alone.

Five signs, joint by joint: an error that grows far beyond what the set-point asked for, half-waves of
velocity that grow with alternate sign (an ordinary move has none, whatever its frequency; the kinetic energy
of a joint grows with their squares), half-waves that do not end although the goal rests, and full torque for
a long time without motion, or for a while against a motion that it does not slow down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.compiling import SCALAR, VECTOR, kernel
from eladapt.errors import require_number
from eladapt.robot.model import Robot


class Swing(NamedTuple):
    """Half-waves of each joint's velocity; a half-wave ends where the velocity changes sign."""

    sign: np.ndarray  # (nv,) of the half-wave that lasts
    peak: np.ndarray  # (nv,) [rad/s] its largest speed so far
    before: np.ndarray  # (nv,) [rad/s] the largest speed of the one before
    growths: np.ndarray  # (nv,) how many in a row were larger than the one before
    length: np.ndarray  # (nv,) [s] the half-wave has lasted so far
    lasting: np.ndarray  # (nv,) how many in a row were quick and no smaller, while the goal rested


class GuardState(NamedTuple):
    """What the guards remember."""

    asked: np.ndarray  # (nv,) [rad] the errors that the set-points asked for, slowly forgotten
    goal: np.ndarray  # (nq,) the last set-point
    swing: Swing
    stalled: np.ndarray  # (nv,) [s] at full torque without motion
    yielding: np.ndarray  # (nv,) [s] at full torque against the motion
    yielded: np.ndarray  # (nv,) [rad/s] the speed when that began


class Alarm(NamedTuple):
    """What a guard saw: the name of the fault, and what it was in words."""

    name: str
    message: str


@kernel(*[VECTOR] * 14, *[SCALAR] * 8)
def watched(
    asked: np.ndarray, sign: np.ndarray, peak: np.ndarray, before: np.ndarray, growths: np.ndarray,
    length: np.ndarray, lasting: np.ndarray, stalled: np.ndarray, yielding: np.ndarray, yielded: np.ndarray,
    error: np.ndarray, moved: np.ndarray, v: np.ndarray, full: np.ndarray, kept: float, margin: float,
    stall_speed: float, least: float, slowest: float, growth: float, decay: float, dt: float,
) -> np.ndarray:  # fmt: skip
    """(10, nv): asked, the swing's six, stalled, yielding and yielded a sample later, see
    `DivergenceGuard`."""
    n, moves = len(v), False
    after = np.empty((10, n))
    for i in range(n):
        moves = moves or moved[i] != 0.0
    for i in range(n):
        after[0, i] = kept * asked[i]
        if moves:  # a new set-point asks for the error it makes, however far off the old one was
            far = abs(moved[i]) > margin
            after[0, i] = abs(error[i]) if far else after[0, i] + abs(moved[i])
        speed, waves = abs(v[i]), 0.0 if moves else lasting[i]
        after[7, i] = stalled[i] + dt if full[i] != 0.0 and speed < stall_speed else 0.0
        after[8, i] = yielding[i] + dt if full[i] * v[i] < 0.0 else 0.0
        after[9, i] = yielded[i] if yielding[i] > 0.0 else speed
        if v[i] == 0.0 or np.sign(v[i]) == sign[i]:
            after[1, i], after[2, i], after[3, i] = sign[i], max(peak[i], speed), before[i]
            after[4, i], after[5, i], after[6, i] = growths[i], length[i] + dt, waves
            continue
        # The first half-wave after rest has nothing to be compared with; slow ones are moves there and back.
        swings = peak[i] > least and before[i] > 0.0 and length[i] + dt < slowest
        after[1, i], after[2, i], after[3, i] = np.sign(v[i]), speed, peak[i]
        after[4, i] = growths[i] + 1.0 if swings and peak[i] > growth * before[i] else 0.0
        after[5, i] = 0.0
        after[6, i] = waves + 1.0 if swings and peak[i] > decay * before[i] else 0.0
    return after


@kernel(*[VECTOR] * 8, *[SCALAR] * 7)
def diverging(
    error: np.ndarray, asked: np.ndarray, v: np.ndarray, growths: np.ndarray, lasting: np.ndarray,
    stalled: np.ndarray, yielding: np.ndarray, yielded: np.ndarray, factor: float, margin: float,
    most_growths: float, most_waves: float, longest: float, longest_yielding: float, least: float,
) -> tuple[int, int]:  # fmt: skip
    """The first sign of divergence, in the order of the module's text, and the joint that shows it most;
    (-1, -1): there is none."""
    excess, worst, growing, waving, stalling = 0.0, -1, 0, 0, 0
    for i in range(len(error)):
        more = abs(error[i]) - (factor * asked[i] + margin)
        if more > excess:
            excess, worst = more, i
        growing = i if growths[i] > growths[growing] else growing
        waving = i if lasting[i] > lasting[waving] else waving
        stalling = i if stalled[i] > stalled[stalling] else stalling
    if worst >= 0:
        return 0, worst
    if growths[growing] >= most_growths:
        return 1, growing
    if lasting[waving] >= most_waves:
        return 2, waving
    if stalled[stalling] > longest:
        return 3, stalling
    for i in range(len(error)):
        if yielding[i] > longest_yielding and abs(v[i]) > yielded[i] + least:
            return 4, i
    return -1, -1


@kernel(VECTOR, VECTOR, VECTOR, SCALAR)
def usual(error: np.ndarray, asked: np.ndarray, growths: np.ndarray, margin: float) -> bool:
    """Whether no error is more than ``margin`` beyond what was asked for, and nothing has grown twice."""
    quiet = True
    for i in range(len(error)):
        quiet = quiet and abs(error[i]) <= asked[i] + margin and growths[i] < 2.0
    return quiet


@dataclass(frozen=True)
class DivergenceGuard:
    """Names a closed loop that diverges; see the module.

    error_factor, error_margin [rad or m]: an error is out of hand beyond error_factor * asked +
    error_margin. The margin is what a load that comes or goes may cost: 2 kg on a panda cost 0.1 rad. memory
    [s]: in which the asked error fades. growth, growths: a swing that grows by ``growth`` from half-wave to
    half-wave, ``growths`` times in a row, above ``least_speed`` [rad/s] and each shorter than ``slowest``
    [s]. decay, waves, slowest [s]: a swing that keeps more than ``decay`` of itself from half-wave to
    half-wave, ``waves`` times in a row, above ``least_speed`` and each shorter than ``slowest``, at a goal
    that rests. stall [s]: at full torque and below ``stall_speed`` [rad/s] for so long. yielding [s]: at full
    torque against the motion for so long, and by ``least_speed`` faster than when that began.
    """

    error_factor: float = 1.5
    error_margin: float = 0.5
    memory: float = 5.0
    growth: float = 1.1
    growths: int = 4
    least_speed: float = 0.1
    decay: float = 0.9
    waves: int = 8
    slowest: float = 0.4
    stall: float = 1.0
    stall_speed: float = 0.02
    yielding: float = 0.1

    def __post_init__(self) -> None:
        for name in ("error_factor", "growth"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 1))
        require_number("decay", self.decay, 0, 1)
        for name in (
            "error_margin", "memory", "growths", "least_speed", "waves", "slowest", "stall", "stall_speed",
            "yielding",
        ):  # fmt: skip
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    def init(self, goal: np.ndarray, nv: int) -> GuardState:
        """Nothing seen; ``goal`` (nq,): where the robot stands."""
        zero = np.zeros(nv)
        return GuardState(zero, goal, Swing(*[zero] * 6), zero, zero, zero)

    def step(
        self,
        state: GuardState,
        error: np.ndarray,
        moved: np.ndarray,
        goal: np.ndarray,
        v: np.ndarray,
        full: np.ndarray,
        dt: float,
    ) -> GuardState:
        """One more sample: error, v, how far the set-point moved, and where full torques turn, all (nv,)."""
        found = watched(
            state.asked, *state.swing, state.stalled, state.yielding, state.yielded, error, moved, v, full,
            math.exp(-dt / self.memory), self.error_margin, self.stall_speed, self.least_speed, self.slowest,
            self.growth, self.decay, dt,
        )  # fmt: skip
        asked, *swing, stalled, yielding, yielded = found
        return GuardState(asked, goal, Swing(*swing), stalled, yielding, yielded)

    def alarm(self, state: GuardState, error: np.ndarray, v: np.ndarray, robot: Robot) -> Alarm | None:
        """The first sign of divergence, in the joint that shows it most."""
        swing = state.swing
        why, i = diverging(
            error, state.asked, v, swing.growths, swing.lasting, state.stalled, state.yielding, state.yielded,
            self.error_factor, self.error_margin, self.growths, self.waves, self.stall, self.yielding,
            self.least_speed,
        )  # fmt: skip
        if why < 0:
            return None
        name, allowed = repr(robot.joint_names[i]), self.error_factor * state.asked[i] + self.error_margin
        speed = f"{swing.before[i]:.3g} rad/s"
        return (
            Alarm(
                "error growth", f"error of {name} grew to {abs(error[i]):.3g}, expected at most {allowed:.3g}"
            ),
            Alarm(
                "energy growth",
                f"{name} swings ever faster, {speed} after {int(swing.growths[i])} growing half-waves",
            ),
            Alarm("oscillation", f"{name} swings at {speed} about a goal that rests"),
            Alarm("stall", f"{name} has not moved under full torque for {state.stalled[i]:.3g} s"),
            Alarm("stall", f"{name} moves at {v[i]:.3g} rad/s against its full torque, ever faster"),
        )[why]

    def quiet(self, state: GuardState, error: np.ndarray) -> bool:
        """Whether nothing points to divergence, so that what was learned by now can be trusted."""
        return usual(error, state.asked, state.swing.growths, 0.5 * self.error_margin)
