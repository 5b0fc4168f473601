"""What theta tells of rotors and viscous friction, for the control law's M(q)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eladapt.compiling import MATRIX, SCALAR, VECTOR, kernel
from eladapt.errors import require_gain
from eladapt.estimation import kernels
from eladapt.estimation.extensions import Information
from eladapt.regressors.regressors import Regressors
from eladapt.signals import Regression

# Of a change of theta, a rotor's part is the least change of standard parameters that makes it, a body's
# parameter being this much less ready to change than a rotor inertia.
BODY_EASE = 1e-3
NOISE_RATE = 20.0  # [1/s] at which the mean square of what theta leaves of a row is forgotten
SURE = 10.0  # an inertia counts as far as the data tell more than nine tenths of it
# Where friction c is all that resists, u = s c (w - v) over a step leaves v <- s (w - v), e <- e + dt v with
# w = -e/H: stable for s < 2 / (2 + dt/H), 0.72 at H = 1.3 dt. Well below that, for a rotor that is none.
VISCOUS_SHARE = 0.3
DEVIATIONS = 3.0  # by how many standard deviations the residual must leave it above zero


@kernel(VECTOR, VECTOR, MATRIX, VECTOR, SCALAR)
def left_of_rows(
    before: np.ndarray, y: np.ndarray, omega: np.ndarray, theta: np.ndarray, share: float
) -> np.ndarray:
    """(m,) ``share`` of the way from ``before`` to the squares of y - Omega theta, in rows that are not 0."""
    after = before.copy()
    for i in range(len(y)):
        left, length = y[i], 0.0
        for k in range(len(theta)):
            left -= omega[i, k] * theta[k]
            length += omega[i, k] * omega[i, k]
        if length > 0.0:
            after[i] += share * (left * left - before[i])
    return after


@kernel(VECTOR, VECTOR, VECTOR, VECTOR)
def resisting(
    known: np.ndarray, largest: np.ndarray, reach: np.ndarray, before: np.ndarray
) -> np.ndarray:  # fmt: skip
    """(nv,) rotors, at most the largest, and viscous friction over its reach, not less than ``before``;
    ``known`` (2 nv,): both."""
    n = len(largest)
    inertia = np.empty(n)
    for i in range(n):
        now = min(max(known[i], 0.0), largest[i]) + reach[i] * max(known[n + i], 0.0)
        inertia[i] = max(now, before[i])
    return inertia


@dataclass(frozen=True, eq=False)
class LearnedJoints:
    """From theta and its information to what resists each joint beyond the URDF's links, (nv,) [kg m^2].

    The control law's torque near rest is M (e / H^2 + v / H): with an M that is many times too small it is
    slack and swings, with one that is many times too large it chatters. So an inertia counts once it is
    known. Over a horizon H a change of velocity is resisted by viscous friction c as by an inertia of c H,
    of which a share counts: without it the law is slack in a joint whose gear resists more than its link.

    largest (nv,) [kg m^2]: no rotor is taken for larger. horizon (nv,) [s]: of the control law. alpha [1/s],
    pole [1/s]: of the estimator, for the scatter.
    """

    regressors: Regressors
    largest: np.ndarray | float
    horizon: np.ndarray | float
    alpha: float = 1.0
    pole: float = 20.0

    def __post_init__(self) -> None:
        nv = self.regressors.robot.nv
        object.__setattr__(self, "largest", require_gain("largest", self.largest, nv, zero=True))
        object.__setattr__(self, "horizon", require_gain("horizon", self.horizon, nv, zero=True))
        object.__setattr__(self, "_map", np.vstack([self._rotor_rows(), self._viscous_rows()]))
        object.__setattr__(self, "_nominal", self.regressors.theta)
        object.__setattr__(self, "_reach", VISCOUS_SHARE * self.horizon)

    def noise(self, before: np.ndarray, regression: Regression, theta: np.ndarray, dt: float) -> np.ndarray:
        """(m,) mean square of what theta leaves of each row, over the last `NOISE_RATE` of a second; rows
        that say nothing leave it as it was."""
        return left_of_rows(before, regression.y, regression.omega, theta, min(1.0, NOISE_RATE * dt))

    def inertia(
        self, theta: np.ndarray, information: Information, noise: np.ndarray, before: np.ndarray
    ) -> np.ndarray:
        """(nv,) [kg m^2], never less than ``before`` (nv,), which is 0 or more; theta (l,); noise (m,): see
        `noise`."""
        more = theta - self._nominal  # type: ignore[attr-defined]
        known = self.surely(self._map, more, information, noise, least=0.0)  # type: ignore[attr-defined]
        return resisting(known, self.largest, self._reach, before)  # type: ignore[attr-defined]

    def surely(
        self, rows: np.ndarray, theta: np.ndarray, information: Information, noise: np.ndarray,
        *, least: float = -np.inf,
    ) -> np.ndarray:  # fmt: skip
        """(m,) rows @ theta, nearer to zero by all that the data leave open; rows (m, l), joint by joint.
        What is not above ``least`` counts as 0."""
        if information.prior == 0 or information.weight == 0:
            return np.zeros(len(rows))
        return kernels.surely(
            information.triangle, information.prior, rows, theta, noise, self.alpha * (2 / self.pole), SURE,
            DEVIATIONS, least,
        )  # fmt: skip

    def _viscous_rows(self) -> np.ndarray:
        """(nv, l): viscous coefficients that a change of theta makes."""
        reg, nv = self.regressors, self.regressors.robot.nv
        rows, block = np.zeros((nv, len(reg))), reg.block("viscous")
        if "viscous" in reg.joint_terms:
            rows[np.arange(nv), np.arange(block.start, block.stop)] = 1 / reg.scale[block]
        return rows

    def _rotor_rows(self) -> np.ndarray:
        """(nv, l): rotor inertias that a change of theta makes."""
        reg, nv = self.regressors, self.regressors.robot.nv
        rows = np.zeros((nv, len(reg)))
        if "rotor" in reg.joint_terms:
            bodies = reg.basis.projection.shape[1] - nv
            ease = np.concatenate([np.full(bodies, BODY_EASE), np.ones(nv)])
            inverse = ease[:, None] * np.linalg.pinv(reg.basis.projection * ease, rcond=1e-9)
            rows[:, reg.inertial] = inverse[bodies:] / reg.scale[reg.inertial]
        return rows
