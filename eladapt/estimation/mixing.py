"""Mixing: from R theta = s to scalar regressions Y = delta (basis' theta_S).

Only theta_U is wanted. With columns ordered [M, friction, U], the bottom block of the triangle is
the exact elimination of all the rest, T_UU theta_U = t_U: it needs only theta_U to be excited, and
its determinant has n_potential factors instead of l.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from eladapt.errors import ArgumentError
from eladapt.estimation.extensions import Information
from eladapt.signals import MixedRegression

Scope = Literal["all", "potential"]

# A direction whose singular value is below this part of the whole triangle's norm is numerical dust: solving
# for it would leave fewer than nine digits (measured on panda and two_link). Its gate is shut.
DUST = 1e-6
LOG_LIMIT = 600.0  # |log delta| beyond this leaves the range of doubles once multiplied


class Spectrum(NamedTuple):
    """The information about theta_S by direction."""

    estimate: np.ndarray  # (k,) least-squares theta_S along each direction; 0 where there is none
    gates: np.ndarray  # (k,) phi, descending
    basis: np.ndarray  # (k, k) directions, one a column


def spectrum(information: Information, n_potential: int, scope: Scope) -> Spectrum:
    """Singular directions of the (eliminated) triangle with their gates and estimates."""
    triangle, vector = information.triangle[:-1, :-1], information.triangle[:-1, -1]
    start = len(vector) - n_potential if scope == "potential" else 0
    left, singular, right = np.linalg.svd(triangle[start:, start:])
    excited = singular > DUST * max(np.linalg.norm(triangle), np.finfo(float).tiny)
    estimate = np.zeros_like(singular)
    estimate[excited] = (left.T @ vector[start:])[excited] / singular[excited]
    gates = np.where(excited, information.gate(singular**2), 0.0)
    return Spectrum(estimate, gates, right.T)


@dataclass(frozen=True)
class Determinant:
    """delta = det Phi (488), (832), as the paper has it; by logarithms, without adjugate."""

    scope: Scope = "potential"

    def __post_init__(self) -> None:
        _require_scope(self.scope)

    def mix(self, information: Information, n_potential: int) -> MixedRegression:
        """Scalar regressions with one common delta."""
        estimate, gates, basis = spectrum(information, n_potential, self.scope)
        if not np.all(gates > 0):
            return _common(0.0, estimate, basis)
        log_delta = np.clip(np.sum(np.log(gates)), -LOG_LIMIT, LOG_LIMIT)
        return _common(float(np.exp(log_delta)), estimate, basis)


@dataclass(frozen=True)
class SmallestEigenvalue:
    """delta = lambda_min(Phi): the same regression, not shrunk by the product of all factors."""

    scope: Scope = "potential"

    def __post_init__(self) -> None:
        _require_scope(self.scope)

    def mix(self, information: Information, n_potential: int) -> MixedRegression:
        """Scalar regressions with one common delta."""
        estimate, gates, basis = spectrum(information, n_potential, self.scope)
        return _common(float(gates.min(initial=1.0)), estimate, basis)


@dataclass(frozen=True)
class Directional:
    """One delta for each eigendirection of the eliminated information about theta_U.

    What is excited is learned at once, whatever else is not. The paper's Lyapunov argument keeps
    (zeta_1 becomes the smallest gate) for a scalar Gamma Upsilon; element-wise monotonicity is lost.
    """

    def mix(self, information: Information, n_potential: int) -> MixedRegression:
        """Scalar regressions, one a direction."""
        estimate, gates, basis = spectrum(information, n_potential, "potential")
        return MixedRegression(gates * estimate, gates, basis)


def _common(delta: float, estimate: np.ndarray, basis: np.ndarray) -> MixedRegression:
    return MixedRegression(delta * (basis @ estimate), delta, np.eye(len(estimate)))


def _require_scope(scope: str) -> None:
    if scope not in ("all", "potential"):
        raise ArgumentError(f"scope: expected 'all' or 'potential', got {scope!r}")
