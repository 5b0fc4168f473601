"""What is done after a fault: the arm is held as long as that helps, else its brakes are wanted.

The torque is that of the gravity estimate, a spring to where the arm was when the fault came, q0, and a
damper,

    tau = g - s M(q) v / H - s K e,    K = M(q0) / (4 H)^2,

which stop all joints at one rate, 1/H, slow enough for torque that is held for a step and comes late. The
gravity estimate is the gradient of a potential whatever its parameters are, and the spring is another one, so
with V = kinetic energy + both potentials, dV/dt = - s v'M v / H <= 0 whatever the arm's true inertia is, if a
torque that is commanded acts and a velocity that is measured is one. Where a joint's effort is less than that
takes, s lets all of them brake less, so that none is left with what another's brake would have asked of it
(limits joint by joint spun a Fetch's wrist).

Whether they are, energy tells. The work of spring and damper is booked as it is commanded, W = integral of
v' (tau - g) dt with what g had lacked when the fault came, and the arm's kinetic energy T is watched: what
it has gained beside W came from somewhere else. With a sensor or a motor of the wrong sign T grows while W
falls. When that gain exceeds a part of what torque without bound but the effort limits could do within the
bridging time, or without a trusted sample for so long, or where gravity leaves so little
effort that s hardly brakes, holding has failed, and ``braking`` begins: nothing
but the last gravity torque, fading while the brakes close. So after the alarm the arm gains no more than in
one bridging time, however wrong its signs are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.errors import ArgumentError, require_gain, require_number
from eladapt.robot.model import Robot
from eladapt.signals import Configuration, JointVector

FADING = 0.2  # [s]
SHARE = 0.25  # of what one bridging time can add, which holding may miss
SLOWEST = 1.0  # [s] in which speed has to fall by e, at the least
MOVES = 0.05  # [rad/s or m/s] above which that is asked


class Hold(NamedTuple):
    """Where the fallback stands."""

    anchor: Configuration  # of the spring
    begun: Configuration  # where the arm was when it took over
    offset: JointVector  # [N m] what the gravity estimate had lacked, fading
    gravity: JointVector  # [N m] the last one at a trusted sample
    q: Configuration  # of the last trusted sample
    kinetic: float  # [J] at the alarm
    work: float  # [J] of spring and damper since
    allowed: float  # [J] that the arm may have gained beside it
    idle: float = 0.0  # [s] for how long an arm that moves has hardly been braked
    braking: float | None = None  # [s] since brakes are wanted
    reason: str = ""  # why they are


@dataclass(frozen=True, eq=False)
class Fallback:
    """Holds an arm after a fault; see the module.

    effort [N m], torque_rate [N m/s]: the limits, (nv,). horizon [s]: H, three steps or more, and twice the
    delay. slack [rad]: further off, the spring's anchor is dragged along. bridging [s]: how long the last
    torque is held without a trusted sample. closing [s]: the time that brakes take. Raises ArgumentError for
    what is not positive.
    """

    robot: Robot
    effort: np.ndarray
    torque_rate: np.ndarray
    horizon: float = 0.01
    slack: float = 0.4
    bridging: float = 0.02
    closing: float = 0.02

    def __post_init__(self) -> None:
        object.__setattr__(self, "effort", require_gain("effort", self.effort, self.robot.nv))
        rate = np.broadcast_to(np.asarray(self.torque_rate, dtype=float), self.robot.nv)
        if not np.all(rate > 0):
            raise ArgumentError(f"torque_rate: expected positive, got {self.torque_rate}")
        object.__setattr__(self, "torque_rate", rate.copy())
        for name in ("horizon", "slack", "bridging", "closing"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    def begin(
        self, q: np.ndarray, v: np.ndarray, gravity: np.ndarray, unexplained: np.ndarray, believed: bool
    ) -> Hold:
        """Held where it is, at q (nq,), v (nv,); gravity (nv,): the estimate there, and what it lacks is what
        the URDF's model has not explained, if sensors and drives are ``believed``: of a reversed one that is
        the fault itself."""
        robot, mass = self.robot, self.robot.mass_matrix(q)
        lacked = robot.gravity(q) - unexplained - gravity if believed else np.zeros(robot.nv)
        offset = np.clip(lacked, -self.effort, self.effort)
        sudden = 0.5 * self.bridging**2 * float(np.sum(self.effort**2 / np.diag(mass)))
        allowed = SHARE * (self.bridging * float(self.effort @ np.abs(v)) + sudden)
        return Hold(q, q, offset, gravity, q, float(0.5 * v @ mass @ v), 0.0, allowed)

    def held(
        self, hold: Hold, q: np.ndarray, v: np.ndarray, gravity: np.ndarray, sent: np.ndarray, dt: float
    ) -> tuple[Hold, np.ndarray]:
        """The torque (nv,), within the limits, at a trusted sample; sent (nv,): that of the step before."""
        hold = self._booked(hold, q, v, gravity, sent, dt)
        e, mass = self.robot.difference(hold.anchor, q), self.robot.mass_matrix(q)
        brake = self.robot.mass_matrix(hold.begun) @ e / (4 * self.horizon) ** 2 + mass @ v / self.horizon
        still = np.clip(gravity + hold.offset, -self.effort, self.effort)
        share = _least(np.where(brake > 0, self.effort + still, self.effort - still), np.abs(brake))
        idle = share < self.horizon / SLOWEST and np.abs(v).max() > MOVES
        hold = hold._replace(idle=hold.idle + dt if idle else 0.0)
        if hold.idle > self.bridging:
            hold = self.braked(hold, "gravity leaves the efforts nothing to brake with")
        tau = still - share * brake
        return hold, sent + _least(self.torque_rate * dt, np.abs(tau - sent)) * (tau - sent)

    def _booked(
        self, hold: Hold, q: np.ndarray, v: np.ndarray, gravity: np.ndarray, sent: np.ndarray, dt: float
    ) -> Hold:
        """The state at a sample, with the work of the step; brakes are wanted where the arm gained more."""
        robot = self.robot
        work = hold.work + float((sent - hold.gravity - hold.offset) @ robot.difference(hold.q, q))
        far = robot.difference(hold.anchor, q)
        anchor = robot.integrate(hold.anchor, far - np.clip(far, -self.slack, self.slack))
        fading = hold.offset * np.exp(-dt / FADING)
        hold = hold._replace(anchor=anchor, offset=fading, gravity=gravity, q=q, work=work)
        gained = robot.kinetic_energy(q, v) - hold.kinetic - work
        if gained <= hold.allowed:
            return hold
        said = f"the arm gained {gained:.3g} J that no torque explains, of {hold.allowed:.3g} J allowed"
        return self.braked(hold, said)

    def braked(self, hold: Hold, reason: str) -> Hold:
        """The state with the brakes wanted; the first reason counts."""
        return hold if hold.braking is not None else hold._replace(braking=0.0, reason=reason)

    def fading(self, hold: Hold, dt: float) -> tuple[Hold, np.ndarray]:
        """The torque (nv,) while brakes close: the last gravity torque, and nothing else."""
        since = hold.braking or 0.0
        left = max(0.0, 1.0 - since / self.closing)
        still = left * (hold.gravity + hold.offset)
        return hold._replace(braking=since + dt), np.clip(still, -self.effort, self.effort)


def _least(room: np.ndarray, needed: np.ndarray) -> float:
    """The least part of what is needed that there is room for, at most all of it."""
    return float(np.min(np.where(needed > room, room / np.where(needed > 0, needed, 1.0), 1.0)))
