"""Dynamic regressor extension: turns y = Omega theta into R theta = s, where R is square.

Least squares (443) and Kreisselmeier's extension (510) accumulate the same information, R' = -forgotten +
alpha Omega'Omega; they differ in what they forget. The triangle of the QR factor is kept instead of its
square, since its error is the square root smaller (1e-13 against 1e-10 in theta_U).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.errors import ArgumentError, require_number
from eladapt.estimation import kernels
from eladapt.signals import Regression

UNKNOWN = np.zeros(0)
EXCITED = 1e-9  # of the largest singular value: a direction with less is not excited


class Information(NamedTuple):
    """What the excitation so far says about theta: T'T = prior I + R and T't = s, with R theta = s.

    With least squares the triangle is that of F^-1 = z f0 I + R itself, so that Phi = I - prior F (488) and
    Y = T^-1 t; with Kreisselmeier's extension there is no prior, Phi = R and Y = s (832).
    """

    triangle: np.ndarray  # (l + 1, l + 1) upper triangular, [T t; 0 residual]
    prior: float  # z f0 with least squares, 0 with Kreisselmeier's extension
    innovation: float = 0.0  # size of what the last rows say that no theta fitting the old ones can
    weight: float = 0.0  # of all rows that the residual remembers, alpha dt each
    weakest: np.ndarray = UNKNOWN  # (l,) direction that is known least, as far as it is known

    def __repr__(self) -> str:
        return f"Information({len(self.triangle) - 1} parameters, prior {self.prior:.3g})"

    @property
    def matrix(self) -> np.ndarray:
        """R (l, l)."""
        upper = self.triangle[:-1, :-1]
        return upper.T @ upper - self.prior * np.eye(len(upper))

    @property
    def vector(self) -> np.ndarray:
        """s (l,)."""
        return self.triangle[:-1, :-1].T @ self.triangle[:-1, -1]

    @property
    def variance(self) -> float:
        """Mean square of what theta does not explain of a row; nan before the first."""
        return float(self.triangle[-1, -1] ** 2 / self.weight) if self.weight > 0 else math.nan

    def told(self, rows: np.ndarray) -> np.ndarray:
        """(m,) from 0 to 1, how much of each combination of parameters, a row c (m, l), the data tell: 1 -
        prior c'F c / c'c; 0 without a prior, since nothing says what is little."""
        if self.prior == 0:
            return np.zeros(len(rows))
        square = np.sum(rows**2, axis=1)
        share = self.prior * kernels.variances(self.triangle, rows) / np.where(square > 0, square, 1.0)
        return np.where(square > 0, 1 - share, 0.0)

    def completed(self, theta: np.ndarray) -> np.ndarray:
        """theta (l,) by least squares where it was excited, as ``theta`` says where it was not."""
        if self.prior > 0:
            return theta + kernels.prediction_error(self.triangle, self.prior, theta)
        upper, t = self.triangle[:-1, :-1], self.triangle[:-1, -1]
        return theta + np.linalg.lstsq(upper, t - upper @ theta, rcond=EXCITED)[0]


@dataclass(frozen=True)
class Kreisselmeier:
    """Constant forgetting (510), exact in the pole.

    forgetting: lambda_2 [1/s]. gain: lambda_3 [1/s].
    """

    forgetting: float = 1.0
    gain: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "forgetting", require_number("forgetting (lambda_2)", self.forgetting, 0))
        object.__setattr__(self, "gain", require_number("gain (lambda_3)", self.gain, 0))

    def init(self, n_parameters: int) -> Information:
        """No information: Phi_1(0) = 0, Phi_2(0) = 0."""
        return Information(np.zeros((n_parameters + 1, n_parameters + 1)), 0.0)

    def step(self, information: Information, regression: Regression, dt: float) -> Information:
        """Forget over dt [s] and add the regression held over it."""
        kept = math.exp(-self.forgetting * dt)
        weight = self.gain * (1 - kept) / self.forgetting
        triangle, innovation = kernels.updated(
            information.triangle, kept, weight, regression.omega, regression.y
        )
        rows = kept * information.weight + weight * len(regression.y)
        return Information(triangle, 0.0, innovation, rows)


@dataclass(frozen=True)
class LeastSquares:
    """Least squares with bounded forgetting (443): F^-1 = z f0 I + R, rho - z f0 F rho_0 = F s.

    alpha [1/s]: gain. beta [1/s]: beta_0, the forgetting rate when information abounds; the rate is beta_0 (1
    - ||F|| / xi), so that no direction is known less than 1/xi. xi >= 1/f0 is the only information floor: put
    it above what the noise accumulates. f0: initial information. It forgets everywhere at once: what a
    resting arm does not tell again, it loses (`SubspaceLeastSquares` does not).
    """

    alpha: float = 1.0
    beta: float = 5.0
    xi: float = 1e8
    f0: float = 1e-3

    def __post_init__(self) -> None:
        for name in ("alpha", "beta", "xi", "f0"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))
        if self.xi * self.f0 < 1 - 1e-12:
            raise ArgumentError(f"xi: expected xi >= 1/f0 = {1 / self.f0:g} (443), got {self.xi:g}")

    def init(self, n_parameters: int) -> Information:
        """No information but the prior: F(0) = I/f0."""
        weakest = np.full(n_parameters, 1 / math.sqrt(max(1, n_parameters)))
        return prior_alone(n_parameters, self.f0)._replace(weakest=weakest)

    def step(self, information: Information, regression: Regression, dt: float) -> Information:
        """Forget over dt [s] at the rate that F allows and add the regression held over it.

        Raises ArgumentError for dt >= 1/beta.
        """
        before, prior, _, weight, weakest = information
        least, weakest = kernels.smallest(before, weakest)
        kept = 1 - dt * self.forgetting(least)
        if not kept > 0:
            raise ArgumentError(f"dt: expected dt < 1/beta = {1 / self.beta:g} s, got {dt:g} s")
        triangle, innovation = kernels.updated(before, kept, self.alpha * dt, regression.omega, regression.y)
        rows = kept * weight + self.alpha * dt * len(regression.y)
        return Information(triangle, kept * prior, innovation, rows, weakest)

    def covariance(self, information: Information) -> np.ndarray:
        """F = (z f0 I + R)^-1 (l, l)."""
        return covariance(information)

    def forgetting(self, smallest: float) -> float:
        """beta = beta_0 (1 - ||F|| / xi) [1/s], never negative; smallest: 1 / ||F||, of z f0 I + R."""
        return max(0.0, self.beta * (1 - 1 / max(smallest * self.xi, kernels.TINY)))


@dataclass(frozen=True)
class SubspaceLeastSquares:
    """Least squares that forgets only along what the new rows say, and keeps the rest for ever.

    With V the directions of the new rows, R <- R - (1 - e^(-beta dt)) R V (V'R V)^-1 V'R + alpha dt
    Omega'Omega: subspace-of-information forgetting (SIFt-RLS of Lai and Bernstein, after Cao and Schwartz). A
    resting arm tells its own posture's gravity again and again; all else that it has learned stays as it was.
    F^-1 = f0 I + R.

    alpha [1/s]: gain. beta [1/s]: forgetting rate along the rows. f0: initial information. floor: rows of
    Omega that are shorter, once made orthogonal to each other, are noise and count for nothing.
    """

    alpha: float = 1.0
    beta: float = 5.0
    f0: float = 1e-3
    floor: float = 0.0

    def __post_init__(self) -> None:
        for name in ("alpha", "beta", "f0"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))
        floor = require_number("floor", self.floor, 0, np.finfo(float).max, closed=True)
        object.__setattr__(self, "floor", floor)

    def init(self, n_parameters: int) -> Information:
        """No information but the prior: F(0) = I/f0."""
        return prior_alone(n_parameters, self.f0)

    def step(self, information: Information, regression: Regression, dt: float) -> Information:
        """Forget over dt [s] along the regression's rows, and add the regression held over it."""
        before, prior, _, weight, weakest = information
        share = -math.expm1(-self.beta * dt)
        y, omega = regression
        triangle, innovation, counted = kernels.subspace_step(
            before, prior, omega, y, self.alpha * dt, share, self.floor
        )
        if counted:
            weight = (1 - share) * weight + self.alpha * dt * counted
        return Information(triangle, prior, innovation, weight, weakest)

    def covariance(self, information: Information) -> np.ndarray:
        """F = (f0 I + R)^-1 (l, l)."""
        return covariance(information)


def covariance(information: Information) -> np.ndarray:
    """F = (prior I + R)^-1 (l, l). Raises numpy's LinAlgError where the triangle is singular."""
    inverse = np.linalg.inv(information.triangle[:-1, :-1])
    return inverse @ inverse.T


def prior_alone(size: int, f0: float) -> Information:
    """The information of f0 I, before anything was seen."""
    triangle = np.zeros((size + 1, size + 1))
    triangle[range(size), range(size)] = math.sqrt(f0)
    return Information(triangle, f0)
