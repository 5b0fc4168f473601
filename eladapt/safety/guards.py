"""What shows that a closed loop is coming apart, from positions, velocities and torques alone.

Four signs, joint by joint: an error that grows far beyond what the set-point asked for, half-waves of
velocity that grow with alternate sign (an ordinary move has none, whatever its frequency; the kinetic energy
of a joint grows with their squares), half-waves that do not end although the goal rests, and full torque for
a long time without motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

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


class Alarm(NamedTuple):
    """What a guard saw: the name of the fault, and what it was in words."""

    name: str
    message: str


@dataclass(frozen=True)
class DivergenceGuard:
    """Names a closed loop that diverges; see the module.

    error_factor, error_margin [rad or m]: an error is out of hand beyond error_factor * asked +
    error_margin. The margin is what a load that comes or goes may cost: 2 kg on a panda cost 0.1 rad. memory
    [s]: in which the asked error fades. growth, growths: a swing that grows by ``growth`` from half-wave to
    half-wave, ``growths`` times in a row, above ``least_speed`` [rad/s] and each shorter than ``slowest``
    [s]. decay, waves, slowest [s]: a swing that keeps more than ``decay`` of itself from half-wave to
    half-wave, ``waves`` times in a row, above ``least_speed`` and each shorter than ``slowest``, at a goal
    that rests. stall [s]: at full torque and below ``stall_speed`` [rad/s] for so long.
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

    def __post_init__(self) -> None:
        for name in ("error_factor", "growth"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 1))
        require_number("decay", self.decay, 0, 1)
        for name in (
            "error_margin", "memory", "growths", "least_speed", "waves", "slowest", "stall", "stall_speed",
        ):  # fmt: skip
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    def init(self, goal: np.ndarray, nv: int) -> GuardState:
        """Nothing seen; ``goal`` (nq,): where the robot stands."""
        zero = np.zeros(nv)
        return GuardState(zero, goal, Swing(*[zero] * 6), zero)

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
        """One more sample: error, v, how far the set-point moved, which torques are full, all (nv,)."""
        asked = state.asked * math.exp(-dt / self.memory)
        if moved.any():
            # a new set-point asks for the error it makes, however far off the old one was
            asked = np.where(np.abs(moved) > self.error_margin, np.abs(error), asked + np.abs(moved))
        stalled = np.where(full & (np.abs(v) < self.stall_speed), state.stalled + dt, 0.0)
        return GuardState(asked, goal, self._swing(state.swing, v, bool(moved.any()), dt), stalled)

    def alarm(self, state: GuardState, error: np.ndarray, robot: Robot) -> Alarm | None:
        """The first sign of divergence, in the joint that shows it most."""
        allowed = self.error_factor * state.asked + self.error_margin
        excess = np.abs(error) - allowed
        growing, stalled = state.swing.growths.max(), state.stalled.max()
        lasting = state.swing.lasting.max()
        well = growing < self.growths and lasting < self.waves and stalled <= self.stall
        if well and excess.max() <= 0:
            return None
        names = robot.joint_names
        if excess.max() > 0:
            i = int(np.argmax(excess))
            said = f"error of {names[i]!r} grew to {abs(error[i]):.3g}, expected at most {allowed[i]:.3g}"
            return Alarm("error growth", said)
        if growing >= self.growths:
            i = int(np.argmax(state.swing.growths))
            said = (
                f"{names[i]!r} swings ever faster, {state.swing.before[i]:.3g} rad/s after "
                f"{int(growing)} growing half-waves"
            )
            return Alarm("energy growth", said)
        if lasting >= self.waves:
            i = int(np.argmax(state.swing.lasting))
            said = f"{names[i]!r} swings at {state.swing.before[i]:.3g} rad/s about a goal that rests"
            return Alarm("oscillation", said)
        i = int(np.argmax(state.stalled))
        return Alarm("stall", f"{names[i]!r} has not moved under full torque for {stalled:.3g} s")

    def quiet(self, state: GuardState, error: np.ndarray) -> bool:
        """Whether nothing points to divergence, so that what was learned by now can be trusted."""
        usual = np.abs(error) <= state.asked + 0.5 * self.error_margin
        return bool(usual.all() and state.swing.growths.max() < 2)

    def _swing(self, swing: Swing, v: np.ndarray, moved: bool, dt: float) -> Swing:
        sign, speed = np.sign(v), np.abs(v)
        turned = (sign != swing.sign) & (sign != 0)
        swing = swing._replace(length=swing.length + dt)
        if moved and swing.lasting.any():
            swing = swing._replace(lasting=np.zeros_like(v))
        if not turned.any():
            return swing._replace(peak=np.maximum(swing.peak, speed))
        # The first half-wave after rest has nothing to be compared with; slow ones are moves there and back.
        swings = (swing.peak > self.least_speed) & (swing.before > 0) & (swing.length < self.slowest)
        grew = swings & (swing.peak > self.growth * swing.before)
        lasts = swings & (swing.peak > self.decay * swing.before)
        return Swing(
            sign=np.where(turned, sign, swing.sign),
            peak=np.where(turned, speed, np.maximum(swing.peak, speed)),
            before=np.where(turned, swing.peak, swing.before),
            growths=np.where(turned, np.where(grew, swing.growths + 1, 0.0), swing.growths),
            length=np.where(turned, 0.0, swing.length),
            lasting=np.where(turned, np.where(lasts, swing.lasting + 1, 0.0), swing.lasting),
        )
