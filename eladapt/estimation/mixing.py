"""Mixing: from R theta = s to regressions Y = gain theta_S that say how theta moves.

`Unmixed` takes (488) as it stands before the adjugate, Y = Phi theta, as a vector: no eigenvectors, no
determinant. `Determinant` and `SmallestEigenvalue` are the paper's way and its nearest relative, one number
for all parameters, by singular vectors and far from the control loop's fast path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np

from eladapt.errors import ArgumentError
from eladapt.estimation import kernels
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.estimation.excitation import zeta_1
from eladapt.estimation.extensions import Information, covariance
from eladapt.signals import MixedRegression

Scope = Literal["all", "potential"]

# A direction whose singular value is below this part of the whole triangle's norm is numerical dust: solving
# for it would leave fewer than nine digits (measured on panda and two_link). Its gate is shut.
DUST = 1e-6
EPS, TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)
LOG_LIMIT = 600.0  # |log delta| beyond this leaves the range of doubles once multiplied


class Mixing(Protocol):
    """What makes regressions of the accumulated ones, and moves theta along them."""

    def mix(self, information: Information, n_potential: int) -> MixedRegression: ...
    def follow(
        self, law: CompositeLaw, information: Information, theta: np.ndarray, n_potential: int, dt: float
    ) -> np.ndarray: ...
    def gate(self, law: CompositeLaw, information: Information, n_potential: int) -> float: ...


class Spectrum(NamedTuple):
    """The information about theta_S by direction."""

    estimate: np.ndarray  # (k,) least-squares theta_S along each direction; 0 where there is none
    gates: np.ndarray  # (k,) eigenvalues of Phi, descending
    basis: np.ndarray  # (k, k) directions, one a column


def bare_rows(information: Information) -> np.ndarray:
    """(l, l + 1): rows [A c] with A'A = R, A'c = s, the prior taken out.

    By the singular values of the whole triangle; what is below rounding of the largest is nothing.
    """
    upper, t = information.triangle[:-1, :-1], information.triangle[:-1, -1]
    if information.prior == 0:
        return information.triangle[:-1]
    left, singular, right = np.linalg.svd(upper)
    square = singular**2 - information.prior
    told = square > len(square) * EPS * max(float(singular.max(initial=0.0)), TINY) * singular
    length = np.sqrt(np.where(told, square, 1.0))
    share = np.where(told, singular / length, 0.0)
    return np.column_stack([np.where(told, length, 0.0)[:, None] * right, share * (left.T @ t)])


def spectrum(information: Information, n_potential: int, scope: Scope) -> Spectrum:
    """Singular directions of what is left of R and s when all parameters outside the scope are eliminated.

    What the others explain of the rows is projected out, which needs only theta_U to be excited.
    """
    rows = bare_rows(information)
    size = rows.shape[1] - 1
    start = size - n_potential if scope == "potential" else 0
    whole = max(float(np.linalg.norm(rows[:, :size])), TINY)
    span, told, _ = np.linalg.svd(rows[:, :start], full_matrices=False)
    span = span[:, told > size * EPS * whole]
    rest = rows[:, start:] - span @ (span.T @ rows[:, start:])
    left, singular, right = np.linalg.svd(rest[:, :-1], full_matrices=False)
    excited = singular > DUST * whole
    estimate = np.divide(left.T @ rest[:, -1], singular, where=excited, out=np.zeros(len(singular)))
    square = singular**2
    gates = square / (information.prior + square) if information.prior else square
    return Spectrum(estimate, np.where(excited, gates, 0.0), right.T)


@dataclass(frozen=True)
class Unmixed:
    """Y = Phi theta (488), (832) as a vector: theta' = rate r / |r|^(1 - b), r = Y - Phi theta_hat.

    For V = |theta_hat - theta|^2 / 2 and the Phi of least squares, whose eigenvalues are below 1, V' <= -rate
    lambda_min(Phi) |theta_hat - theta|^(1 + b): the paper's (588) with the smallest eigenvalue of Phi in
    place of the determinant's power. What is excited is learned at once, whatever else is not. Gamma Upsilon
    must be one number.
    """

    scope: Scope = "all"

    def __post_init__(self) -> None:
        _require_scope(self.scope)

    def mix(self, information: Information, n_potential: int) -> MixedRegression:
        """Y and Phi; an inverse, for records and theory: the law does without."""
        prior = information.prior
        if self.scope == "all":
            if prior == 0:
                return MixedRegression(information.vector, information.matrix)
            inverse = np.linalg.inv(information.triangle[:-1, :-1])
            return MixedRegression(
                inverse @ information.triangle[:-1, -1],
                np.eye(len(inverse)) - prior * covariance(information),
            )
        estimate, gates, basis = spectrum(information, n_potential, "potential")
        return MixedRegression(basis @ (gates * estimate), (basis * gates) @ basis.T)

    def follow(
        self, law: CompositeLaw, information: Information, theta: np.ndarray, n_potential: int, dt: float
    ) -> np.ndarray:
        """theta (l,) after dt [s] along r; with scope "potential" its last block alone moves."""
        if self.scope == "all":
            error = kernels.prediction_error(information.triangle, information.prior, theta)
            return law.arrive(theta, error, dt, information.triangle if information.prior > 0 else None)
        start = len(theta) - n_potential
        mixed = self.mix(information, n_potential)
        moved = law.arrive(theta[start:], mixed.Y - mixed.gain @ theta[start:], dt)
        return np.concatenate([theta[:start], moved])

    def gate(self, law: CompositeLaw, information: Information, n_potential: int) -> float:
        """The largest g known with V' <= -rate g |theta_hat - theta|^(1 + b): lambda_min / lambda_max^(1 - b)
        of Phi, for theory."""
        gates = spectrum(information, n_potential, self.scope).gates
        least, most = float(gates.min(initial=1.0)), float(gates.max(initial=1.0 if not gates.size else 0.0))
        return min(1.0, least / most ** (1 - law.b)) if most > 0 else 0.0


@dataclass(frozen=True)
class _Scalar:
    """One number for all parameters, which then move each for itself."""

    scope: Scope = "potential"

    def __post_init__(self) -> None:
        _require_scope(self.scope)

    def delta(self, gates: np.ndarray) -> float:
        """Of the eigenvalues of Phi."""
        raise NotImplementedError

    def mix(self, information: Information, n_potential: int) -> MixedRegression:
        """Scalar regressions with one common delta."""
        estimate, gates, basis = spectrum(information, n_potential, self.scope)
        delta = self.delta(gates)
        return MixedRegression(delta * (basis @ estimate), delta)

    def follow(
        self, law: CompositeLaw, information: Information, theta: np.ndarray, n_potential: int, dt: float
    ) -> np.ndarray:
        """theta (l,) after dt [s], parameter by parameter."""
        return law.scalar_flow(theta, self.mix(information, n_potential), dt)

    def gate(self, law: CompositeLaw, information: Information, n_potential: int) -> float:
        """zeta_1 (476c), in [0, 1)."""
        return float(zeta_1(float(self.mix(information, n_potential).gain), law.b, law.d))


@dataclass(frozen=True)
class Determinant(_Scalar):
    """delta = det Phi (488), (832), as the paper has it; by logarithms, without adjugate."""

    def delta(self, gates: np.ndarray) -> float:
        """det Phi of the eigenvalues (k,) of Phi."""
        with np.errstate(divide="ignore"):
            log_delta = np.sum(np.log(gates))
        return float(np.exp(np.clip(log_delta, -LOG_LIMIT, LOG_LIMIT)) * np.all(gates > 0))


@dataclass(frozen=True)
class SmallestEigenvalue(_Scalar):
    """delta = lambda_min(Phi): the same regression, not shrunk by the product of all factors."""

    def delta(self, gates: np.ndarray) -> float:
        """The smallest of the eigenvalues (k,) of Phi."""
        return float(gates.min(initial=1.0))


def _require_scope(scope: str) -> None:
    if scope not in ("all", "potential"):
        raise ArgumentError(f"scope: expected 'all' or 'potential', got {scope!r}")
