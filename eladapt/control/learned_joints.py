"""What theta tells of rotors and viscous friction, for the control law's M(q)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eladapt.errors import require_gain
from eladapt.estimation import kernels
from eladapt.estimation.extensions import Information
from eladapt.regressors.regressors import Regressors

# Of a change of theta, a rotor's part is the least change of standard parameters that makes it, a body's
# parameter being this much less ready to change than a rotor inertia.
BODY_EASE = 1e-3
TINY = 1e-300
SURE = 10.0  # an inertia counts as far as the data tell more than nine tenths of it
# Where friction c is all that resists, u = s c (w - v) over a step leaves v <- s (w - v), e <- e + dt v with
# w = -e/H: stable for s < 2 / (2 + dt/H), 0.72 at H = 1.3 dt. Well below that, for a rotor that is none.
VISCOUS_SHARE = 0.3
DEVIATIONS = 3.0  # by how many standard deviations the residual must leave it above zero


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

    def inertia(self, theta: np.ndarray, information: Information, noise: float) -> np.ndarray:
        """(nv,) [kg m^2], never less than 0; theta (l,); noise: mean square of what theta leaves of a row."""
        nv = self.regressors.robot.nv
        known = self.surely(self._map, theta - self._nominal, information, noise)  # type: ignore[attr-defined]
        rotor, viscous = np.maximum(known[:nv], 0.0), np.maximum(known[nv:], 0.0)
        return np.minimum(rotor, self.largest) + VISCOUS_SHARE * self.horizon * viscous

    def surely(
        self, rows: np.ndarray, theta: np.ndarray, information: Information, noise: float
    ) -> np.ndarray:
        """(m,) rows @ theta, nearer to zero by all that the data leave open; rows (m, l)."""
        if information.prior == 0 or information.weight == 0:
            return np.zeros(len(rows))
        value, variances = rows @ theta, kernels.variances(information.triangle, rows)
        square = np.maximum(np.einsum("ij,ij->i", rows, rows), TINY)
        doubt = information.prior * variances / square
        spread = np.sqrt(self.alpha * (2 / self.pole) * noise * variances)
        size = np.abs(value) * np.maximum(0.0, 1 - SURE * doubt) - DEVIATIONS * spread
        return np.copysign(np.maximum(size, 0.0), value)

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
