"""What is done after a fault: the arm is held as long as that helps, else its brakes are wanted.

Spring and damper pull each joint by itself, tau_i = g_i - P_i e_i - D_i v_i, with e the way from where the
arm was when the fault came. The gravity estimate is the gradient of a potential whatever its parameters are,
and the spring is another one, so with V = kinetic energy + both potentials

    dV/dt = - sum_i D_i v_i^2 <= 0

whatever the arm's inertia is, if a torque that is commanded acts and a velocity that is measured is one. D_i
is so small that this stays true of torque that is held for a step and comes late, and no joint's torque
depends on what the others can bear (a law that solves for all joints at once, M (w - v) = H (...), gave a
Fetch's wrist the torque that its saturated shoulder needed, and spun it).

Whether they are, energy tells. The work of spring and damper is booked as it is commanded, W = integral of
v' (tau - g) dt with what g had lacked when the fault came, and the arm's kinetic energy T is watched: what
it has gained beside W came from somewhere else. With a sensor or a motor of the wrong sign T grows while W
falls. When that gain exceeds a part of what torque without bound but the effort limits could do within the
bridging time, or without a trusted sample for so long, holding has failed, and ``braking`` begins: nothing
but the last gravity torque, fading while the brakes close. So after the alarm the arm gains no more than in
one bridging time, however wrong its signs are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eladapt.errors import UnknownNameError, require_gain, require_number
from eladapt.gains.extremes import Extremes, configurations
from eladapt.robot.model import Robot
from eladapt.signals import Configuration, JointVector

FADING = 0.2  # [s]
SHARE = 0.25  # of what one bridging time can add, which holding may miss
SAMPLES = 50  # postures over which the lightest inertia of a joint is taken


class Hold(NamedTuple):
    """Where the fallback stands."""

    anchor: Configuration  # of the spring
    offset: JointVector  # [N m] what the gravity estimate had lacked, fading
    gravity: JointVector  # [N m] the last one at a trusted sample
    q: Configuration  # of the last trusted sample
    kinetic: float  # [J] at the alarm
    work: float  # [J] of spring and damper since
    allowed: float  # [J] that the arm may have gained beside it
    braking: float | None = None  # [s] since brakes are wanted
    reason: str = ""  # why they are


@dataclass(frozen=True, eq=False)
class Fallback:
    """Holds an arm after a fault; see the module. P [N m/rad], D [N m s/rad]: (nv,).

    effort (nv,) [N m]: the limits. slack [rad]: further off, the spring's anchor is dragged along. bridging
    [s]: how long the last torque is held without a trusted sample. closing [s]: the time that brakes take.
    Raises ArgumentError for what is not positive.
    """

    robot: Robot
    effort: np.ndarray
    P: np.ndarray
    D: np.ndarray
    slack: float = 0.4
    bridging: float = 0.02
    closing: float = 0.02

    def __post_init__(self) -> None:
        for name in ("effort", "P", "D"):  # a fallback without bound would be none
            object.__setattr__(self, name, require_gain(name, getattr(self, name), self.robot.nv))
        for name in ("slack", "bridging", "closing"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    @classmethod
    def for_robot(
        cls, robot: Robot, effort: np.ndarray, largest: Extremes, horizon: float, **given: Any
    ) -> Fallback:
        """P: all effort at half a radian. D: critical for a joint's largest inertia, and no more than stops
        its lightest in a ``horizon`` [s], which is to be three steps or more and twice the delay. Those
        ``given`` by name are kept. Raises UnknownNameError."""
        legal = [name for name in cls.__dataclass_fields__ if name not in ("robot", "effort")]
        if unknown := [name for name in given if name not in legal]:
            raise UnknownNameError("setting of the fallback", unknown, legal)
        lightest = np.min([_alone(robot, q) for q in configurations(robot, SAMPLES, 0)], axis=0)
        D = np.minimum(2 * np.sqrt(2 * effort * largest.inertia), lightest / horizon)
        P = np.minimum(2 * effort, D**2 / (4 * lightest))
        return cls(robot, effort, **{"P": P, "D": D, **given})

    def begin(self, q: np.ndarray, v: np.ndarray, gravity: np.ndarray, unexplained: np.ndarray) -> Hold:
        """Held where it is, at q (nq,), v (nv,); gravity (nv,): the estimate there, and what it lacks is what
        the URDF's model has not explained."""
        robot, mass = self.robot, self.robot.mass_matrix(q)
        offset = np.clip(robot.gravity(q) - unexplained - gravity, -self.effort, self.effort)
        sudden = 0.5 * self.bridging**2 * float(np.sum(self.effort**2 / np.diag(mass)))
        allowed = SHARE * (self.bridging * float(self.effort @ np.abs(v)) + sudden)
        return Hold(q, offset, gravity, q, float(0.5 * v @ mass @ v), 0.0, allowed)

    def held(
        self, hold: Hold, q: np.ndarray, v: np.ndarray, gravity: np.ndarray, sent: np.ndarray, dt: float
    ) -> tuple[Hold, np.ndarray]:
        """The torque (nv,) at a trusted sample; sent (nv,): that of the step before."""
        robot = self.robot
        moved = robot.difference(hold.q, q)
        work = hold.work + float((sent - hold.gravity - hold.offset) @ moved)
        far = robot.difference(hold.anchor, q)
        e = np.clip(far, -self.slack, self.slack)
        hold = hold._replace(
            anchor=robot.integrate(hold.anchor, far - e), offset=hold.offset * np.exp(-dt / FADING),
            gravity=gravity, q=q, work=work,
        )  # fmt: skip
        gained = robot.kinetic_energy(q, v) - hold.kinetic - work
        if gained > hold.allowed:
            said = f"the arm gained {gained:.3g} J that no torque explains, of {hold.allowed:.3g} J allowed"
            hold = self.braked(hold, said)
        return hold, gravity + hold.offset - self.P * e - self.D * v

    def braked(self, hold: Hold, reason: str) -> Hold:
        """The state with the brakes wanted; the first reason counts."""
        return hold if hold.braking is not None else hold._replace(braking=0.0, reason=reason)

    def fading(self, hold: Hold, dt: float) -> tuple[Hold, np.ndarray]:
        """The torque (nv,) while brakes close: the last gravity torque, and nothing else."""
        since = hold.braking or 0.0
        left = max(0.0, 1.0 - since / self.closing)
        return hold._replace(braking=since + dt), np.clip(left * hold.gravity, -self.effort, self.effort)


def _alone(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(nv,) [kg m^2] the inertia that a torque on one joint alone moves, 1 / (M^-1)_ii."""
    return 1.0 / np.diag(np.linalg.inv(robot.mass_matrix(q)))
