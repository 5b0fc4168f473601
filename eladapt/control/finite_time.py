"""The continuous finite-time PD law (278), and three ways to evaluate it in sampled time.

Fractional powers have infinite slope at zero: held over a step, they chatter. The semi-implicit
evaluation asks for the torque that the law would command at the end of the step; the slope limit
rounds the powers off where a step cannot resolve them; the explicit one is the paper's.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eladapt.compiling import prepare
from eladapt.control.proximal import ITERATIONS, Solution, signed_power, solve_coupled, solved_torque
from eladapt.errors import ArgumentError, require_gain, require_number

Evaluation = Literal["explicit", "slope_limited", "semi_implicit"]


@dataclass(frozen=True)
class FiniteTimePD:
    """tau = -P |e1|^a sign(e1) - D |e2|^b sign(e2) - D_L e2 (278).

    P [N m/rad^a], D [N m (s/rad)^b], D_L [N m s/rad]: scalar or (nv,), P, D > 0, D_L >= 0.
    r1, r2: weights with 2 r2 > r1 > r2 > 0, a = (2 r2 - r1)/r1, b = (2 r2 - r1)/r2 (ExponeHom).
    linear: a = b = 1, Tomei's PD; r1 and r2 are not used.
    evaluation: "semi_implicit" (default), "slope_limited" or "explicit". The default measures best: on a
        panda at rest at 1 kHz torque ripples by 1e-10 N m, 0.3 and 170, and 1e-7 rad, 6e-5 and 8e-5 of
        error are left. So it is from 250 Hz to 4 kHz, and with 2 kg that M(q) does not know. Against 1 N m
        of unknown friction it takes a disturbance estimate (benchmarks/results/discretisation.md).
    horizon: H [s] of the semi-implicit evaluation, the step by default; longer where noise asks
        for it, since the slope near rest is M/H.

    Raises ArgumentError for gains outside their range.
    """

    P: float | np.ndarray
    D: float | np.ndarray
    D_L: float | np.ndarray = 0.0
    r1: float = 1.5
    r2: float = 1.0
    linear: bool = False
    evaluation: Evaluation = "semi_implicit"
    horizon: float | np.ndarray | None = None

    def __post_init__(self) -> None:
        prepare()
        object.__setattr__(self, "P", require_gain("P", self.P))
        object.__setattr__(self, "D", require_gain("D", self.D))
        object.__setattr__(self, "D_L", require_gain("D_L", self.D_L, zero=True))
        for name in ("r1", "r2"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))
        if not self.linear and not 2 * self.r2 > self.r1 > self.r2:
            raise ArgumentError(f"r1, r2: expected 2 r2 > r1 > r2 > 0 (ExponeHom), got {self.r1}, {self.r2}")
        if self.evaluation not in ("explicit", "slope_limited", "semi_implicit"):
            raise ArgumentError(
                "evaluation: expected 'explicit', 'slope_limited' or 'semi_implicit', "
                f"got {self.evaluation!r}"
            )
        if self.horizon is not None:
            object.__setattr__(self, "horizon", require_gain("horizon", self.horizon))

    @functools.cached_property
    def a(self) -> float:
        """Exponent of the position error."""
        return 1.0 if self.linear else (2 * self.r2 - self.r1) / self.r1

    @functools.cached_property
    def b(self) -> float:
        """Exponent of the velocity."""
        return 1.0 if self.linear else (2 * self.r2 - self.r1) / self.r2

    def gains(self, nv: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """P, D, D_L and horizon, (nv,) each, 0 where it is the step. Raises ArgumentError for another number
        of joints."""
        found = self._by_joint.get(nv)
        if found is None:
            found = self._by_joint[nv] = (
                require_gain("P", self.P, nv),
                require_gain("D", self.D, nv),
                require_gain("D_L", self.D_L, nv, zero=True),
                require_gain("horizon", 0.0 if self.horizon is None else self.horizon, nv, zero=True),
            )
        return found

    @functools.cached_property
    def _by_joint(self) -> dict[int, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        return {}

    def law(self, e1: np.ndarray, e2: np.ndarray) -> np.ndarray:
        """The law itself (nv,), at one state."""
        return -self.P * signed_power(e1, self.a) - self.D * signed_power(e2, self.b) - self.D_L * e2

    def torque(
        self, e1: np.ndarray, e2: np.ndarray, mass_matrix: np.ndarray, dt: float, ahead: float = 0.0
    ) -> np.ndarray:
        """The torque (nv,) to hold for the next dt [s]; mass_matrix: M(q), as far as it is known; ahead: how
        many steps the horizon is at least."""
        if self.evaluation == "explicit":
            return self.law(e1, e2)
        if self.evaluation == "slope_limited":
            return self._slope_limited(e1, e2, mass_matrix, dt)
        P, D, D_L, horizon = self.gains(len(e2))
        if ahead > 1.0:
            horizon = np.maximum(horizon, ahead * dt)
        return solved_torque(e1, e2, mass_matrix, P, D, D_L, self.a, self.b, horizon, dt)

    def _slope_limited(
        self, e1: np.ndarray, e2: np.ndarray, mass_matrix: np.ndarray, dt: float
    ) -> np.ndarray:
        """Each power's slope bounded by what a sample can resolve.

        The inertia that a single joint can count on is c M_ii, c the smallest eigenvalue of the
        diagonally normalised M: right for small arms and good postures; where c is small (0.01 on
        a Panda) the law is underdamped.
        """
        diagonal = np.diag(mass_matrix)
        scale = 1 / np.sqrt(diagonal)
        mass = 0.5 * np.linalg.eigvalsh(mass_matrix * np.outer(scale, scale))[0] * diagonal
        a, b = self.a, self.b
        if a == 1:
            return self.law(e1, e2)
        de = (dt * self.D / mass) ** (1 / (1 - b))
        dx = (dt**2 * self.P / (0.2 * mass)) ** (1 / (1 - a))
        position = e1 / (np.abs(e1) + dx) ** (1 - a)
        velocity = e2 / (np.abs(e2) + de) ** (1 - b)
        return -self.P * position - self.D * velocity - self.D_L * e2


def semi_implicit_solution(
    law: FiniteTimePD,
    e1: np.ndarray,
    e2: np.ndarray,
    mass_matrix: np.ndarray,
    horizon: float | np.ndarray,
    most: int = ITERATIONS,
) -> Solution:
    """(e1 + H w, w) with M (w - e2) = H law(e1 + H w, w), the torque there, and what it took to find it.

    `proximal.solve_coupled` has the equation for a horizon H of each joint's own.
    """
    P, D, D_L, _ = law.gains(len(e2))
    if np.ndim(horizon) == 0:
        horizon = np.full(len(e2), horizon)
    return solve_coupled(e1, e2, mass_matrix, P, D, D_L, law.a, law.b, horizon, most)
