"""Base parameters: the combinations of the standard parameters that the motion can tell apart.

Sampled regressors are stacked; a pivoted QR factorisation picks independent columns, and what the
other columns repeat is folded into them (Gautier 1991). The rank is where the singular values
drop most, and how far they drop is reported.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg

from eladapt.errors import ArgumentError, RankWarning
from eladapt.regressors.standard import StandardRegressors

SAMPLES = 120  # states; Panda's ranks and gaps are the same from 20 on
CLEAR_GAP = 100.0
ROUNDING = 1e-10  # relative; sampled regressors are accurate to some 1e-14


@dataclass(frozen=True, eq=False)
class ParameterBasis:
    """theta = projection @ standard parameters, and the regressors that go with it.

    With W_kin and W_pot the regressors in the s standard parameters, the ones of this basis are
    W_kin @ kinetic and W_pot @ potential. The last ``n_potential`` parameters are theta_U.
    ``rank_gap``: by which factor the singular values drop behind the last one kept.
    """

    projection: np.ndarray  # (p, s)
    kinetic: np.ndarray  # (s, p)
    potential: np.ndarray  # (s, p), zero in all but the last n_potential columns
    n_potential: int
    labels: tuple[str, ...]
    rank_gap: float = np.inf

    def __repr__(self) -> str:
        p, s = self.projection.shape
        return f"ParameterBasis({p} of {s} standard parameters, {self.n_potential} of gravity)"

    def __post_init__(self) -> None:
        p, s = self.projection.shape
        if self.kinetic.shape != (s, p) or self.potential.shape != (s, p) or len(self.labels) != p:
            raise ArgumentError(
                f"basis: expected kinetic and potential of shape ({s}, {p}) and {p} labels, got "
                f"{self.kinetic.shape}, {self.potential.shape} and {len(self.labels)}"
            )
        if not 0 <= self.n_potential <= p:
            raise ArgumentError(f"basis: n_potential must be in 0..{p}, got {self.n_potential}")

    @classmethod
    def from_rows(
        cls, kinetic_rows: np.ndarray, potential_rows: np.ndarray, labels: Sequence[str]
    ) -> ParameterBasis:
        """A basis of one's own: theta_M = kinetic_rows @ pi, theta_U = potential_rows @ pi.

        kinetic_rows (i, s), potential_rows (j, s) of the s standard parameters pi; labels: i + j names. The
        rows must make up this robot's torque, which `Regressors` verifies.
        """
        kinetic_rows, potential_rows = np.atleast_2d(kinetic_rows), np.atleast_2d(potential_rows)
        i, j, s = len(kinetic_rows), len(potential_rows), kinetic_rows.shape[1]
        kinetic, potential = np.zeros((s, i + j)), np.zeros((s, i + j))
        kinetic[:, :i] = np.linalg.pinv(kinetic_rows)
        potential[:, i:] = np.linalg.pinv(potential_rows)
        return cls(np.vstack([kinetic_rows, potential_rows]), kinetic, potential, j, tuple(labels))


class Samples(NamedTuple):
    """Regressors stacked over random states: unit-variance velocities and accelerations."""

    kinetic: np.ndarray  # (SAMPLES nv, s)
    gravity: np.ndarray  # (SAMPLES nv, s)
    velocity: np.ndarray  # (SAMPLES, nv) [rad/s]


def sample(standard: StandardRegressors, count: int = SAMPLES, seed: int = 0) -> Samples:
    """Regressors at ``count`` random states within the joint limits; absent parameters have none."""
    rng = np.random.default_rng(seed)
    robot = standard.robot
    kinetic, gravity, velocity = [], [], []
    for _ in range(count):
        q, v, a = robot.random_configuration(rng), rng.normal(size=robot.nv), rng.normal(size=robot.nv)
        kinetic.append(standard.kinetic_torque(q, v, a))
        gravity.append(standard.gravity(q))
        velocity.append(v)
    samples = Samples(np.vstack(kinetic), np.vstack(gravity), np.array(velocity))
    for stacked in (samples.kinetic, samples.gravity):
        stacked[:, standard.absent] = 0
    return samples


def independent_basis(standard: StandardRegressors, samples: Samples) -> ParameterBasis:
    """theta_M and theta_U as unrelated parameters, as the paper has them (Ttavector)."""
    kinetic, potential = _reduce(samples.kinetic), _reduce(samples.gravity)
    i, j, s = len(kinetic.columns), len(potential.columns), samples.kinetic.shape[1]
    names = standard.labels
    e_kinetic, e_potential = np.zeros((s, i + j)), np.zeros((s, i + j))
    e_kinetic[kinetic.columns, np.arange(i)] = 1
    e_potential[potential.columns, i + np.arange(j)] = 1
    projection = np.vstack([kinetic.fold, potential.fold])
    return ParameterBasis(
        projection, e_kinetic, e_potential, j, _labels(projection, names), _clear(kinetic, potential)
    )


def shared_basis(standard: StandardRegressors, samples: Samples) -> ParameterBasis:
    """One base for motion and gravity: [what gravity does not see; the gravity base].

    The gravity base comes first; every other column is then freed of gravity by subtracting its
    combination of that base, so that theta_U alone makes g(q) and the rest is a complement.
    """
    gravity = _reduce(samples.gravity)
    j, s = len(gravity.columns), samples.kinetic.shape[1]
    select = np.zeros((s, j))
    select[gravity.columns, np.arange(j)] = 1
    freed = np.eye(s) - select @ gravity.fold  # column k: standard parameter k without its weight
    everything = _reduce(samples.kinetic + samples.gravity)
    rank = len(everything.columns) - j
    rest = _reduce((samples.kinetic + samples.gravity) @ freed, rank)
    kinetic = np.hstack([freed[:, rest.columns], select])
    potential = np.hstack([np.zeros((s, rank)), select])
    projection = np.vstack([rest.fold, gravity.fold])
    gap = _clear(gravity, everything)
    return ParameterBasis(projection, kinetic, potential, j, _labels(projection, standard.labels), gap)


class _Reduction(NamedTuple):
    columns: np.ndarray  # (r,) indices of independent columns
    fold: np.ndarray  # (r, s): stacked = stacked[:, columns] @ fold
    gap: float  # ratio of the singular values on both sides of the rank


def _reduce(stacked: np.ndarray, rank: int | None = None) -> _Reduction:
    """Independent columns of a stacked regressor, and how they make up the others."""
    s = stacked.shape[1]
    norms = np.linalg.norm(stacked, axis=0)
    present = np.flatnonzero(norms > ROUNDING * norms.max(initial=0))
    if not len(present) or rank == 0:
        return _Reduction(np.zeros(0, int), np.zeros((0, s)), np.inf)
    scaled = stacked[:, present] / norms[present]
    gap = np.inf
    if rank is None:
        rank, gap = _rank(np.linalg.svd(scaled, compute_uv=False))
    triangle, pivots = scipy.linalg.qr(scaled, mode="r", pivoting=True)
    chosen, others = np.sort(pivots[:rank]), pivots[rank:]
    # Columns back in the order of the bodies read better than in the order of the pivots.
    order = np.argsort(pivots[:rank])
    combination = scipy.linalg.solve_triangular(triangle[:rank, :rank], triangle[:rank, rank:])[order]
    combination *= norms[present[others]] / norms[present[chosen]][:, None]
    combination[np.abs(combination) < ROUNDING] = 0
    fold = np.zeros((rank, s))
    fold[np.arange(rank), present[chosen]] = 1
    fold[:, present[others]] = combination
    return _Reduction(present[chosen], fold, gap)


def _rank(singular: np.ndarray) -> tuple[int, float]:
    """The rank where the singular values drop most, and the factor by which they do."""
    floor = singular[0] * len(singular) * np.finfo(float).eps
    padded = np.maximum(np.append(singular, 0.0), floor)
    drops = padded[:-1] / padded[1:]
    rank = int(np.argmax(drops)) + 1
    return rank, float(drops[rank - 1])


def _clear(*reductions: _Reduction) -> float:
    gap = min(reduction.gap for reduction in reductions)
    if gap < CLEAR_GAP:
        warnings.warn(
            f"the rank of the base parameters is not clear: singular values drop only by a factor "
            f"{gap:.3g} (clear: {CLEAR_GAP:g} or more); some parameters are hardly identifiable",
            RankWarning,
            stacklevel=4,
        )
    return gap


def _labels(projection: np.ndarray, names: Sequence[str]) -> tuple[str, ...]:
    return tuple(_combination(row, names) for row in projection)


def _combination(row: np.ndarray, names: Sequence[str], terms: int = 4) -> str:
    """``mx(j2) + 0.3 m(j3)``: the largest terms of a linear combination, the leading one first."""
    columns = [int(k) for k in np.argsort(-np.abs(row), kind="stable") if abs(row[k]) > 1e-6]
    text = ""
    for k in columns[:terms]:
        size = "" if abs(abs(row[k]) - 1) < 1e-9 else f"{abs(row[k]):.3g} "
        sign = "-" if row[k] < 0 else "+"
        text += f" {sign} {size}{names[k]}" if text else ("-" if sign == "-" else "") + size + names[k]
    return text + (" + ..." if len(columns) > terms else "")
