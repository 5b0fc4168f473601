"""What pushes on the arm and is in no model: the disturbance estimate of the semi-implicit control law.

The semi-implicit law asks for the torque at the end of the horizon, as M(q) and the torque would lead
there. A joint held by friction does not get there: the law believes that it arrives, and pushes too
little. With the torque d that was missing over the last moments the prediction is
M (w - v) = H (law(e + H w, w) + d), the same equation from the velocity v + H M^-1 d. The torque is still the
law's, d is not added to it: a friction f stops a joint within (f/P)^(1/a) of its goal, where the law itself
pushes with f.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from eladapt.errors import require_number

LEAST_MEMORY = 0.03  # [s]
HORIZONS = 5.0


@dataclass(frozen=True)
class DisturbanceEstimate:
    """d = low-pass of M a + C v - feedback, a the difference of two measured velocities over their time.

    M and C are the URDF's; feedback is what of the applied torque the law commanded, all but the gravity
    that is known. So d holds friction, contact, and what of gravity and inertia is estimated wrong; where the
    model is right, d = 0.

    memory [s]: of the low-pass. Velocity noise s makes about M s / memory of d, which moves the law's
    velocity by s H / memory: at five times H it adds a tenth to the torque's noise (panda, encoders of
    2^17 counts), at H more than half. Friction of 1 N m on the panda left least error at 0.03 s.
    """

    memory: float = LEAST_MEMORY

    def __post_init__(self) -> None:
        object.__setattr__(self, "memory", require_number("memory", self.memory, 0))

    @classmethod
    def for_horizon(cls, horizon: float) -> DisturbanceEstimate:
        """The memory that suits the law's horizon [s]."""
        return cls(max(LEAST_MEMORY, HORIZONS * horizon))

    def init(self, nv: int) -> np.ndarray:
        """d = 0 (nv,): nothing is known to push."""
        return np.zeros(nv)

    def step(self, d: np.ndarray, inertial: np.ndarray, feedback: np.ndarray, dt: float) -> np.ndarray:
        """d (nv,) [N m] after feedback (nv,) was held for dt [s] and made inertial = M a + C v (nv,)."""
        return d - math.expm1(-dt / self.memory) * (inertial - feedback - d)

    def velocity(self, d: np.ndarray, v: np.ndarray, mass_matrix: np.ndarray, horizon: float) -> np.ndarray:
        """v + H M^-1 d (nv,) [rad/s], from which the semi-implicit law's prediction includes d."""
        _, change, _ = dposv(mass_matrix, d)  # a fifth of the time of a general solver
        return v + horizon * change
