"""Mixing: from R theta = s to scalar regressions Y = delta (basis' theta_S).

Only theta_U is wanted. With columns ordered [M, friction, U], the bottom block of the triangle is
the exact elimination of all the rest, T_UU theta_U = t_U: it needs only theta_U to be excited, and
its determinant has n_potential factors instead of l.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from eladapt.batches import aligned, batch_first, batch_last, read_only
from eladapt.errors import ArgumentError
from eladapt.estimation.extensions import Information
from eladapt.estimation.triangle import directions, kernels, many_kernels
from eladapt.signals import MixedRegression

Scope = Literal["all", "potential"]

# A direction whose singular value is below this part of the whole triangle's norm is numerical dust: solving
# for it would leave fewer than nine digits (measured on panda and two_link). Its gate is shut.
DUST = 1e-6
TINY = float(np.finfo(float).tiny)
LOG_LIMIT = 600.0  # |log delta| beyond this leaves the range of doubles once multiplied


class Spectrum(NamedTuple):
    """The information about theta_S by direction."""

    estimate: np.ndarray  # (k,) least-squares theta_S along each direction; 0 where there is none
    gates: np.ndarray  # (k,) phi, descending
    basis: np.ndarray  # (k, k) directions, one a column


def spectrum(information: Information, n_potential: int, scope: Scope) -> Spectrum:
    """Singular directions of the (eliminated) triangle with their gates and estimates."""
    triangle = information.triangle
    size = triangle.shape[-1] - 1
    start = size - n_potential if scope == "potential" else 0
    found = directions(triangle, start)
    least = DUST * np.maximum(found.scale, TINY)
    excited = found.singular > (least[..., None] if np.ndim(least) else least)
    gates = information.gate(found.singular**2)
    return Spectrum(np.where(excited, found.estimate, 0.0), np.where(excited, gates, 0.0), found.basis)


@dataclass(frozen=True)
class Determinant:
    """delta = det Phi (488), (832), as the paper has it; by logarithms, without adjugate."""

    scope: Scope = "potential"

    def __post_init__(self) -> None:
        _require_scope(self.scope)

    def mix(self, information: Information, n_potential: int) -> MixedRegression:
        """Scalar regressions with one common delta."""
        estimate, gates, basis = spectrum(information, n_potential, self.scope)
        with np.errstate(divide="ignore"):
            log_delta = np.sum(np.log(gates), axis=-1)
        delta = np.exp(np.clip(log_delta, -LOG_LIMIT, LOG_LIMIT)) * np.all(gates > 0, axis=-1)
        return _common(delta, estimate, basis)


@dataclass(frozen=True)
class SmallestEigenvalue:
    """delta = lambda_min(Phi): the same regression, not shrunk by the product of all factors."""

    scope: Scope = "potential"

    def __post_init__(self) -> None:
        _require_scope(self.scope)

    def mix(self, information: Information, n_potential: int) -> MixedRegression:
        """Scalar regressions with one common delta."""
        estimate, gates, basis = spectrum(information, n_potential, self.scope)
        return _common(gates.min(axis=-1, initial=1.0), estimate, basis)


@dataclass(frozen=True)
class Directional:
    """One delta for each eigendirection of the eliminated information about theta_U.

    What is excited is learned at once, whatever else is not. The paper's Lyapunov argument keeps
    (zeta_1 becomes the smallest gate) for a scalar Gamma Upsilon; element-wise monotonicity is lost.

    compiled: by numba (extra ``fast``), which begins with the directions of the sample before.
    """

    compiled: bool = False

    def mix(
        self, information: Information, n_potential: int, before: MixedRegression | None = None
    ) -> MixedRegression:
        """Scalar regressions, one a direction; before: that of the sample before, if there is one."""
        if self.compiled and n_potential:
            triangle, basis = information.triangle, np.eye(n_potential) if before is None else before.basis
            mix = kernels().directional_mix if triangle.ndim == 2 else _directional_mixes
            first, prior = triangle.shape[-1] - 1 - n_potential, information.prior
            return MixedRegression(*mix(triangle, first, basis, prior, information.saturation, DUST))
        estimate, gates, basis = spectrum(information, n_potential, "potential")
        return MixedRegression(gates * estimate, gates, basis)


def _directional_mixes(
    triangle: np.ndarray, first: int, basis: np.ndarray, prior: Any, saturation: float, dust: float
) -> tuple[np.ndarray, ...]:
    """`kernels.directional_mix` of a batch."""
    many, lead = many_kernels(), triangle.shape[:-2]
    basis = batch_last(basis, 2, lead)
    prior = np.broadcast_to(prior, lead).ravel()
    found = [aligned(basis.shape[1:]), aligned(basis.shape[1:]), aligned(basis.shape)]
    many.all_directional_mix(
        read_only(batch_last(triangle, 2, lead)), first, basis, prior, saturation, dust,
        many.block_edges(prior.size), *found,
    )  # fmt: skip
    return tuple(batch_first(array, lead) for array in found)


def _common(delta: float | np.ndarray, estimate: np.ndarray, basis: np.ndarray) -> MixedRegression:
    delta = np.asarray(delta)
    theta = (basis @ estimate[..., None])[..., 0]
    return MixedRegression(
        delta[..., None] * theta, delta if delta.ndim else float(delta), np.eye(theta.shape[-1])
    )


def _require_scope(scope: str) -> None:
    if scope not in ("all", "potential"):
        raise ArgumentError(f"scope: expected 'all' or 'potential', got {scope!r}")
