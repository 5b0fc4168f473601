"""Weighted least squares on the rows of a log, with standard deviations that its residuals justify."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg

from eladapt.errors import ArgumentError
from eladapt.estimation.payload import reduced
from eladapt.identification.row_noise import noise_covariances
from eladapt.identification.rows import OVERLAP, Rows

ROUNDS = 8  # of weighting each joint's rows by the noise that they turn out to have; 3 are typical
STEADY = 1e-3  # relative change of the noise at which they end
DOUBT = 0.1  # of the typical torque: what a direction's torque may be wrong by, and count as told
DUST = 1e-10  # relative: below, a direction is not seen at all
LEAST_NOISE = 1e-6  # of the typical torque: what acceleration does within a step is not seen
LEAST_VARIANCE = 1e-3  # of the largest, of combinations whose estimate came out smaller
UNTOLD = 0.01  # of a parameter in directions that are not told
NAMED = 0.2  # of a direction's largest part: what is named of it


class Fit(NamedTuple):
    """theta (l,) with its covariance, and what of it the rows do not tell."""

    theta: np.ndarray  # (l,) where the log does not tell, the start's
    covariance: np.ndarray  # (l, l) within what is told
    noise: np.ndarray  # (nv,) [N m] RMS of the residuals, by joint
    triangle: np.ndarray  # (l, l) upper triangle T, T'T the inverse of the covariance within what is told
    untold: np.ndarray  # (k, l) orthonormal directions of theta that the log does not tell

    @property
    def std(self) -> np.ndarray:
        """(l,) standard deviations of theta; inf for a parameter with a part in what is not told."""
        part = np.linalg.norm(self.untold, axis=0) if len(self.untold) else np.zeros(len(self.theta))
        return np.where(part > UNTOLD, np.inf, np.sqrt(np.diag(self.covariance)))


def fit(rows: Rows, start: np.ndarray) -> Fit:
    """theta of the rows, nearest ``start`` (l,) in the directions that they do not tell.

    Each joint's rows are weighted by the noise that they turn out to have, in rounds. Noise of a log is not
    white (windows overlap, and what a model lacks lasts), nor independent between joints. So the covariance
    is F S F, F = (sum omega' omega)^-1 of weighted rows and S the sum over lags k of omega(t)' C(k)
    omega(t + k), with C(k) of `noise_covariances`. Raises ArgumentError where fewer independent
    rows hold than there are parameters.
    """
    _, y, omega, holds = rows
    counts, size = holds.sum(axis=0), len(start)
    if counts.sum() < OVERLAP / 2 * size:  # rows that overlap say partly the same
        raise ArgumentError(
            f"log: {counts.sum()} rows in which a joint moves, for {size} parameters: it is too short, or "
            "most of it is at rest. Record a motion in which every joint moves (see `excitation`)"
        )
    typical = float(np.sqrt(np.sum(y**2) / counts.sum()))
    noise, least = np.full(len(counts), typical), 0.0  # what is left out would pass for noise, and stay out
    for _ in range(ROUNDS):
        change, told = _least_squares((y - omega @ start) / noise, omega / noise[:, None], least)
        theta = start + change
        residual = np.where(holds, y - omega @ theta, 0.0)
        free = np.maximum(1.0, counts * (1 - size / counts.sum()))
        before, noise = noise, np.sqrt(np.sum(residual**2, axis=0) / free)
        noise = np.where(counts > 0, np.maximum(noise, LEAST_NOISE * typical), typical)
        if least and np.abs(noise / before - 1).max() < STEADY:
            break
        least = 1 / (DOUBT * typical)
    values, vectors = np.linalg.eigh(_spread(residual / noise, omega / noise[:, None], holds, told))
    values = np.maximum(values, LEAST_VARIANCE * values.max())
    half = (vectors * np.sqrt(values)).T / told.singular @ told.right  # covariance = half' half
    root = np.zeros((size, size))
    root[: len(values)] = (vectors / np.sqrt(values)).T * told.singular @ told.right
    untold = np.linalg.svd(told.right)[2][len(told.right) :]
    return Fit(theta, half.T @ half, noise, triangle_of(root), untold)


class _Told(NamedTuple):
    """Singular values (k,) and directions (k, l) of weighted rows."""

    singular: np.ndarray
    right: np.ndarray


def _least_squares(y: np.ndarray, omega: np.ndarray, least: float) -> tuple[np.ndarray, _Told]:
    """The least change (l,), and what is told, by singular values above least."""
    size = omega.shape[-1]
    stacked = np.column_stack([omega.reshape(-1, size), y.ravel()])
    triangle = triangle_of(stacked)
    left, singular, right = np.linalg.svd(triangle[:size, :size])
    told = (singular > DUST * singular[0]) & (singular > least)
    along = left.T @ triangle[:size, size]
    return right[told].T @ (along[told] / singular[told]), _Told(singular[told], right[told])


def triangle_of(rows: np.ndarray) -> np.ndarray:
    """(l, l) upper triangular T with T'T that of rows (n, l); fewer rows than columns give as many."""
    return np.asarray(scipy.linalg.qr(rows, mode="r")[0][: rows.shape[1]])


def _spread(residual: np.ndarray, omega: np.ndarray, holds: np.ndarray, told: _Told) -> np.ndarray:
    """(k, k) S of `fit` along the directions that are told, in units of what white noise would make."""
    n, nv, _ = omega.shape
    seen = (omega.reshape(n * nv, -1) @ told.right.T).reshape(n, nv, -1)
    size = len(told.singular)
    total = np.zeros((size, size))
    for lag, alike in enumerate(noise_covariances(residual, seen, told.singular**-2.0, holds)):
        ahead = np.einsum("ij,njk->nik", alike, seen[lag:], optimize=True)
        part = seen[: n - lag].reshape(-1, size).T @ ahead.reshape(-1, size)
        total += part if lag == 0 else part + part.T
    return total / np.multiply.outer(told.singular, told.singular)


def directions(untold: np.ndarray, labels: tuple[str, ...]) -> tuple[str, ...]:
    """The directions (k, l) of theta in words, in a basis that shares as few terms as possible."""
    said = []
    for row in reduced(untold):
        main = [i for i in np.argsort(-np.abs(row), kind="stable") if abs(row[i]) > NAMED][:3]
        said.append(" with ".join(labels[i] for i in main))
    return tuple(said)
