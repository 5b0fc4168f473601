"""Dynamic regressor extension: turns y = Omega theta into R theta = s, where R is square.

Least squares with forgetting (443) and Kreisselmeier's extension (510) accumulate the same
information, R' = -beta R + alpha Omega'Omega; they differ in how fast they forget and in what
their gates are made of. The triangle of the QR factor is kept instead of R = T'T, since its error
is the square root smaller (1e-13 against 1e-10 in theta_U).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eladapt.batches import aligned, batch_first, batch_last, read_only, triangular
from eladapt.errors import ArgumentError, require_number
from eladapt.estimation.triangle import accumulate, kernels, least_eigenvalue, many_kernels
from eladapt.signals import Regression

TINY = float(np.finfo(float).tiny)
UNKNOWN = np.zeros(0)


class Information(NamedTuple):
    """What the excitation so far says about theta: ``T @ theta = t``, R = T'T, s = T't.

    All arrays, and then ``innovation`` and ``prior`` too, may have leading axes: as many estimators at once.

    An eigenvalue lambda of R opens the gate phi = lambda / (prior + saturation lambda): with least
    squares that is an eigenvalue of Phi = I - z f0 F (488c), in [0, 1); with Kreisselmeier's
    extension, of Phi_2 itself.
    """

    triangle: np.ndarray  # (l + 1, l + 1) upper triangular, [T t; 0 residual]
    prior: Any  # z f0 with least squares, 1 with Kreisselmeier
    saturation: float  # 1 with least squares, 0 with Kreisselmeier
    innovation: Any = 0.0  # size of what the last rows say that no theta fitting the old ones can
    weakest: np.ndarray = UNKNOWN  # (l,) direction that is known least, as far as it is known

    @property
    def matrix(self) -> np.ndarray:
        """R (l, l)."""
        return self.triangle[:-1, :-1].T @ self.triangle[:-1, :-1]

    @property
    def vector(self) -> np.ndarray:
        """s (l,)."""
        return self.triangle[:-1, :-1].T @ self.triangle[:-1, -1]

    def gate(self, eigenvalue: np.ndarray) -> np.ndarray:
        """phi of each eigenvalue (..., k)."""
        prior = self.prior[..., None] if np.ndim(self.prior) else self.prior
        return eigenvalue / (prior + self.saturation * eigenvalue)


@dataclass(frozen=True)
class Kreisselmeier:
    """Constant forgetting (510), exact in the pole.

    forgetting: lambda_2 [1/s]. gain: lambda_3 [1/s]. compiled: by numba (extra ``fast``) instead of LAPACK.
    """

    forgetting: float = 1.0
    gain: float = 1.0
    compiled: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "forgetting", require_number("forgetting (lambda_2)", self.forgetting, 0))
        object.__setattr__(self, "gain", require_number("gain (lambda_3)", self.gain, 0))

    def init(self, n_parameters: int, lead: tuple[int, ...] = ()) -> Information:
        """No information: Phi_1(0) = 0, Phi_2(0) = 0; lead: leading axes, for as many estimators at once."""
        return _nothing(n_parameters, lead, 1.0, 0.0, self.compiled)

    def step(self, information: Information, regression: Regression, dt: float) -> Information:
        """Forget over dt [s] and add the regression held over it."""
        kept = math.exp(-self.forgetting * dt)
        weight = self.gain * (1 - kept) / self.forgetting
        triangle = accumulate(information.triangle, kept, weight, regression, self.compiled)
        innovation = _innovation(information.triangle, triangle, kept, weight)
        return information._replace(triangle=triangle, innovation=innovation)


@dataclass(frozen=True)
class LeastSquares:
    """Least squares with bounded forgetting (443): F^-1 = z f0 I + R, rho - z f0 F rho_0 = F s.

    alpha [1/s]: gain. beta [1/s]: beta_0, the forgetting rate when information abounds; the rate
    is beta_0 (1 - ||F|| / xi), so that no direction is known less than 1/xi. xi >= 1/f0 is the only
    information floor: put it above what the noise accumulates. f0: initial information.
    compiled: by numba (extra ``fast``) instead of LAPACK.
    """

    alpha: float = 1.0
    beta: float = 5.0
    xi: float = 1e8
    f0: float = 1e-3
    compiled: bool = False

    def __post_init__(self) -> None:
        for name in ("alpha", "beta", "xi", "f0"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))
        if self.xi * self.f0 < 1 - 1e-12:
            raise ArgumentError(f"xi: expected xi >= 1/f0 = {1 / self.f0:g} (443), got {self.xi:g}")

    def init(self, n_parameters: int, lead: tuple[int, ...] = ()) -> Information:
        """No information but the prior: F(0) = I/f0; lead: leading axes, for as many estimators at once."""
        return _nothing(n_parameters, lead, self.f0, 1.0, self.compiled)

    def step(self, information: Information, regression: Regression, dt: float) -> Information:
        """Forget over dt [s] at the rate that F allows and add the regression held over it."""
        before, weight = information.triangle, self.alpha * dt
        if self.compiled:
            step = kernels().least_squares_step if before.ndim == 2 else _least_squares_steps
            triangle, kept, innovation, weakest = step(
                before, information.prior, information.weakest, regression.omega, regression.y, self.alpha,
                self.beta, self.xi, dt,
            )  # fmt: skip
            self.require_kept(kept, dt)
        else:
            smallest, weakest = least_eigenvalue(before, information.weakest)
            kept = 1 - dt * self.forgetting(information.prior + smallest)
            self.require_kept(kept, dt)
            triangle = accumulate(before, kept, weight, regression)
            innovation = _innovation(before, triangle, kept, weight)
        return Information(triangle, kept * information.prior, 1.0, innovation, weakest)

    def require_kept(self, kept: Any, dt: float) -> None:
        """Raises ArgumentError where a step of dt [s] would forget more than everything."""
        if not (kept > 0 if isinstance(kept, float) else np.all(kept > 0)):
            raise ArgumentError(f"dt: expected dt < 1/beta = {1 / self.beta:g} s, got {dt:g} s")

    def covariance(self, information: Information) -> np.ndarray:
        """F = (z f0 I + R)^-1 (l, l)."""
        size = len(information.triangle) - 1
        return np.linalg.inv(information.prior * np.eye(size) + information.matrix)

    def forgetting(self, smallest: Any) -> Any:
        """beta = beta_0 (1 - ||F|| / xi) [1/s], never negative; smallest: 1 / ||F||, of z f0 I + R."""
        information = smallest * self.xi
        if isinstance(information, float):
            return max(0.0, self.beta * (1 - 1 / max(information, TINY)))
        return np.maximum(self.beta * (1 - 1 / np.maximum(information, TINY)), 0.0)


def _least_squares_steps(
    triangle: np.ndarray, prior: Any, weakest: np.ndarray, omega: np.ndarray, y: np.ndarray, *gains: float
) -> tuple[np.ndarray, ...]:
    """`kernels.least_squares_step` of a batch; gains: alpha, beta, xi, dt."""
    many, lead = many_kernels(), triangle.shape[:-2]
    triangle, weakest = read_only(batch_last(triangle, 2, lead)), batch_last(weakest, 1, lead)
    prior = np.broadcast_to(prior, lead).ravel()
    updated = triangular(triangle.shape)
    kept, innovation, found = (aligned(array.shape) for array in (prior, prior, weakest))
    many.all_least_squares_step(
        triangle, prior, weakest, batch_last(omega, 2, lead), batch_last(y, 1, lead), *gains,
        many.block_edges(prior.size), updated, kept, innovation, found,
    )  # fmt: skip
    return tuple(batch_first(array, lead) for array in (read_only(updated), kept, innovation, found))


def _nothing(size: int, lead: tuple[int, ...], prior: float, saturation: float, by_rows: bool) -> Information:
    triangle = np.zeros(
        (*lead, size + 1, size + 1), order="C" if by_rows or lead else "F"
    )  # as LAPACK wants it
    weakest = np.full((*lead, size), 1 / math.sqrt(max(1, size)))
    many = np.full(lead, prior) if lead else prior
    return Information(triangle, many, saturation, np.zeros(lead) if lead else 0.0, weakest)


def _innovation(before: np.ndarray, after: np.ndarray, kept: Any, weight: float) -> Any:
    """Root of what the squared residual, the last entry of the triangle, grew by for each unit of weight."""
    if after.ndim == 2:
        return math.sqrt(max(0.0, float(after[-1, -1]) ** 2 - kept * float(before[-1, -1]) ** 2) / weight)
    grown = after[..., -1, -1] ** 2 - kept * before[..., -1, -1] ** 2
    return np.sqrt(np.maximum(grown, 0.0) / weight)
