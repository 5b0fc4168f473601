"""What flows along the line, from the sensors to the adaptation law."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

# Arrays whose type says how long they are, by the robot.
Configuration = Annotated[np.ndarray, "nq"]
JointVector = Annotated[np.ndarray, "nv"]


class Measurement(NamedTuple):
    """What is known of the robot at time ``t``.

    ``tau`` is the torque that was *applied* over the step that ends at ``t`` (after saturation),
    so no block has to remember what it commanded and clipping corrupts no filter.
    """

    t: float  # [s]
    q: np.ndarray  # (nq,)
    v: np.ndarray  # (nv,) [rad/s or m/s]
    tau: np.ndarray  # (nv,) [N m or N]

    def copy(self) -> Measurement:
        """The same numbers in arrays of its own."""
        return Measurement(self.t, self.q.copy(), self.v.copy(), self.tau.copy())


class Reference(NamedTuple):
    """Where the robot should be, and how it should move there: a goal that moves.

    A goal that stands still is q_d (nq,) alone, wherever a goal is taken.
    """

    q: np.ndarray  # (nq,)
    v: np.ndarray  # (nv,) [rad/s or m/s]
    a: np.ndarray  # (nv,) [rad/s^2 or m/s^2]

    def copy(self) -> Reference:
        """The same numbers in arrays of its own."""
        return Reference(self.q.copy(), self.v.copy(), self.a.copy())


class Fault(NamedTuple):
    """Why a torque gate does not let the controller's torque through any more."""

    name: str  # one of the gate's FAULTS
    t: float  # [s] by the robot's clock, as far as it is known
    message: str

    def __str__(self) -> str:
        return f"{self.name} at t = {self.t:.4f} s: {self.message}"


class Braking(NamedTuple):
    """When a torque gate asked for the brakes, and why."""

    t: float  # [s] by the robot's clock, as far as it is known
    reason: str

    def __str__(self) -> str:
        return f"brakes asked for at t = {self.t:.4f} s: {self.reason}"


class Regression(NamedTuple):
    """Filtered linear regression ``y = omega @ theta`` (NLRPE), (LREq)."""

    y: np.ndarray  # (m,): m = nv for the force balance, 1 for the power balance
    omega: np.ndarray  # (m, l)


class MixedRegression(NamedTuple):
    """``Y = gain @ theta_S`` with a matrix gain, ``Y = gain * theta_S`` with a number (LSREq), (465).

    theta_S is theta_U with scope "potential" (k = n_potential), the whole theta with scope "all" (k = l).
    """

    Y: np.ndarray  # (k,)
    gain: float | np.ndarray  # Delta, or Phi (k, k), symmetric; of least squares with eigenvalues in [0, 1)

    def __repr__(self) -> str:
        gain = f"gain {self.gain:.6g}" if np.ndim(self.gain) == 0 else f"gain of shape {np.shape(self.gain)}"
        return f"MixedRegression({len(self.Y)} equations, {gain})"
