"""Keeps joints below their speed limits and within their range, by as little torque as that takes.

A joint may accelerate towards a bound on its speed by what is left of it in a horizon h,
a_i <= (bound_i - v_i) / h. The bound is the speed limit, or what is left to the end of the range in ``time``,
whichever is less. Torque that would accelerate a joint more is corrected, in the joints concerned alone (a
control barrier function). What the model does not explain (a load, friction) is estimated as a torque, from
what the arm does. The model is the URDF's, with the rotors that such motors have at least, see `rotored`.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from eladapt.compiling import SCALAR, VECTOR, kernel
from eladapt.errors import require_gain, require_number
from eladapt.gains.extremes import configurations
from eladapt.robot.model import Robot

# [rad/s^2] With all its effort no motor turns its joint faster than that: twenty times what geared joints do
# (a UR5e's wrists 280, a Panda's 50 to 400).
LIVELIEST = 8000.0
# Nor is more added than so many times the inertia that a joint's torque moves, or an arm that has no rotors
# chatters about its bound (an xArm7's last joint does at ten times).
MOST, POSTURES = 6.0, 20
SWEEPS = 4  # correcting one joint may accelerate another; more than two sweeps were never needed


@kernel(VECTOR, VECTOR, VECTOR, SCALAR)
def low_passed(before: np.ndarray, now: np.ndarray, memory: np.ndarray, dt: float) -> np.ndarray:
    """(nv,) the low-pass of what is ``now``, dt [s] after it was ``before``."""
    after = np.empty(len(before))
    for i in range(len(before)):
        after[i] = before[i] - math.expm1(-dt / memory[i]) * (now[i] - before[i])
    return after


@kernel(*[VECTOR] * 6, SCALAR, VECTOR, VECTOR)
def room(
    x: np.ndarray, v: np.ndarray, acceleration: np.ndarray, velocity: np.ndarray, lower: np.ndarray,
    upper: np.ndarray, share: float, time: np.ndarray, horizon: np.ndarray,
) -> tuple[np.ndarray, bool]:  # fmt: skip
    """(3, nv): the least and the largest acceleration that a joint may have, and its own as far as it may;
    and whether any has more."""
    found, passed = np.empty((3, len(x))), False
    for i in range(len(x)):
        fastest = min(share * velocity[i], max(upper[i] - x[i], 0.0) / time[i])
        slowest = max(-share * velocity[i], min(lower[i] - x[i], 0.0) / time[i])
        least, most = (slowest - v[i]) / horizon[i], (fastest - v[i]) / horizon[i]
        found[0, i], found[1, i] = least, most
        found[2, i] = min(max(acceleration[i], least), most)
        passed = passed or found[2, i] != acceleration[i]
    return found, passed


def rotored(robot: Robot, effort: np.ndarray) -> Robot:
    """The robot with the rotors that it has at least; effort (nv,) [N m].

    Where a file leaves rotors out, torque that suits a link of 1e-4 kg m^2 alone overcomes no friction.
    """
    postures = configurations(robot, POSTURES, 0)
    moved = 1 / np.max([np.diag(np.linalg.inv(robot.mass_matrix(q))) for q in postures], axis=0)
    model = robot.model.copy()
    lacking = np.clip(effort / LIVELIEST - moved, 0.0, MOST * moved)
    model.armature = model.armature + lacking
    return dataclasses.replace(robot, model=model)


@dataclass(frozen=True, eq=False)
class Barrier:
    """Bounds of speed; velocity, lower, upper (nv,), inf where nothing is set.

    share: of the speed limit that is used. time [s]: to the end of the range, scalar or (nv,); braking from
    the speed limit takes v / time [rad/s^2]. horizon: h [s], scalar or (nv,), not below the time in which
    torque can change from none to all. memory [s], scalar or (nv,): of the torque that the model does not
    explain; where that is off by d, the speed exceeds its bound by up to h d / M, M the inertia of the joint.
    """

    robot: Robot
    velocity: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    share: float = 0.86
    time: float | np.ndarray = 0.1
    horizon: float | np.ndarray = 0.01
    memory: float | np.ndarray = 0.005

    def __post_init__(self) -> None:
        object.__setattr__(self, "share", require_number("share", self.share, 0, 1, closed=True))
        for name in ("time", "horizon", "memory"):
            object.__setattr__(self, name, require_gain(name, getattr(self, name), self.robot.nv))

    def unexplained(self, before: np.ndarray, now: np.ndarray, dt: float) -> np.ndarray:
        """(nv,) [N m] what acts on the arm beside torque and model; ``before``: a sample ago, ``now``: by the
        last dt [s] alone."""
        return low_passed(before, now, self.memory, dt)

    def torque(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, unexplained: np.ndarray) -> np.ndarray:
        """tau (nv,), corrected where a joint would pass its bound."""
        robot = self.robot
        acceleration = robot.forward_dynamics(q, v, tau + unexplained, check=False)
        (least, most, allowed), passed = room(
            robot.coordinates(q, check=False), v, acceleration, self.velocity, self.lower, self.upper,
            self.share, self.time, self.horizon,
        )  # fmt: skip
        if not passed:
            return tau
        bound = allowed != acceleration
        inverse = np.linalg.inv(robot.mass_matrix(q))
        for _ in range(SWEEPS):
            change = np.zeros(robot.nv)
            wanted = allowed[bound] - acceleration[bound]
            change[bound] = np.linalg.solve(inverse[np.ix_(bound, bound)], wanted)
            tau, acceleration = tau + change, acceleration + inverse @ change
            allowed = np.clip(acceleration, least, most)
            further = np.abs(allowed - acceleration) > 1e-9 * (1 + np.abs(acceleration))
            if not further.any():
                break
            bound |= further
            allowed = np.where(further, allowed, acceleration)
        return tau
