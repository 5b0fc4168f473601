"""The triangle of square-root information, and the three questions that the estimators ask of it.

T is the triangular factor of the rows [Omega | y] seen so far, as they are weighted now; its last column
is t, its last entry the residual. Each question has one answer by LAPACK (default) and one along leading
axes in numpy; `kernels` and `lanes` have those that numba compiles. All agree to rounding.
"""

from __future__ import annotations

import math
from types import ModuleType
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dnrm2
from scipy.linalg.lapack import dgesdd, dtpqrt, dtrtrs

from eladapt.batches import batch_first, batch_last, read_only, triangular
from eladapt.compiling import kernel_module
from eladapt.errors import ArgumentError
from eladapt.signals import Regression

LAPACK_BLOCK = 8  # columns; 4 to 16 cost the same within 10 %, 32 a quarter more, 1 twice as much (l = 43)


class Directions(NamedTuple):
    """Singular directions of the block [T_SS t_S] that is left when all other parameters are eliminated."""

    singular: np.ndarray  # (..., k), descending
    estimate: np.ndarray  # (..., k) V' theta_S; without meaning where a singular value is rounding
    basis: np.ndarray  # (..., k, k) V, one direction a column
    scale: float | np.ndarray  # (...) Frobenius norm of the whole T


def kernels() -> ModuleType:
    """The compiled loops. Raises EladaptError without numba."""
    return kernel_module("eladapt.estimation.kernels")


def many_kernels() -> ModuleType:
    """The compiled loops for a batch. Raises EladaptError without numba."""
    return kernel_module("eladapt.estimation.lanes")


def accumulate(
    triangle: np.ndarray,
    kept: float | np.ndarray,
    weight: float,
    regression: Regression,
    compiled: bool = False,
) -> np.ndarray:
    """The triangle (..., l + 1, l + 1) of [sqrt(kept) T; sqrt(weight) [Omega | y]]; kept: scalar or (...)."""
    y, omega = regression
    if triangle.ndim > 2:
        return _accumulate_many(triangle, np.asarray(kept), weight, y, omega, compiled)
    if compiled:
        return kernels().update_triangle(triangle, kept, weight, omega, y)
    size = len(triangle)
    rows = np.empty((len(y), size), order="F")
    rows[:, :-1], rows[:, -1] = omega, y
    rows *= math.sqrt(weight)
    shrunk = math.sqrt(kept) * triangle
    updated, _, _, refused = dtpqrt(
        0, min(LAPACK_BLOCK, size), shrunk, rows, overwrite_a=True, overwrite_b=True
    )
    if refused:
        raise ArgumentError(f"regression: LAPACK dtpqrt refused argument {-refused}; shapes {rows.shape}")
    return updated


def least_eigenvalue(triangle: np.ndarray, weakest: np.ndarray) -> tuple[float | np.ndarray, np.ndarray]:
    """The smallest eigenvalue of R = T'T (a Rayleigh quotient, never below it), and its direction (..., l).

    One step of inverse iteration from ``weakest``, that of the sample before. R changes little from one
    sample to the next, so the direction keeps up with it, at a fifteenth of the cost of singular values.
    """
    if triangle.ndim > 2:
        return _least_eigenvalues(triangle, weakest)
    factor = np.asfortranarray(triangle[:-1, :-1])
    half, singular = dtrtrs(factor, weakest, trans=1)
    scale = dnrm2(half)
    if singular or not 0 < scale < np.inf:
        return 0.0, weakest
    whole, _ = dtrtrs(factor, half / scale)
    length = dnrm2(whole)
    if not 0 < length < np.inf:
        return 0.0, weakest
    return (1 / length) ** 2, whole / length


def directions(triangle: np.ndarray, start: int) -> Directions:
    """Of the parameters from ``start`` on."""
    size = triangle.shape[-1] - 1
    k = size - start
    if k == 0 or triangle.ndim > 2:
        left, singular, right = np.linalg.svd(triangle[..., start:size, start:size])
        projected = (triangle[..., None, start:size, size] @ left)[..., 0, :]
        right = np.swapaxes(right, -1, -2)
        scale = np.linalg.norm(triangle[..., :size], axis=(-2, -1))
    else:
        left, singular, right, failed = dgesdd(triangle[start:size, start:size])
        if failed:
            raise ArgumentError("information: expected a finite triangle, LAPACK found no singular values")
        projected, right = triangle[start:size, size] @ left, right.T
        factor = triangle[:, :size]
        scale = math.sqrt(np.vdot(factor, factor))
    return Directions(singular, projected / np.maximum(singular, np.finfo(float).tiny), right, scale)


def _accumulate_many(
    triangle: np.ndarray, kept: np.ndarray, weight: float, y: np.ndarray, omega: np.ndarray, compiled: bool
) -> np.ndarray:
    """Householder reflections, column by column, of all triangles at once."""
    lead, size = triangle.shape[:-2], triangle.shape[-1]
    kept = np.broadcast_to(kept, lead)
    if compiled:
        many, arrays = many_kernels(), [batch_last(array, own, lead) for array, own in ((omega, 2), (y, 1))]
        before, edges = read_only(batch_last(triangle, 2, lead)), many.block_edges(kept.size)
        updated = triangular(before.shape)
        many.all_update_triangle(before, kept.ravel(), weight, *arrays, edges, updated)
        return batch_first(read_only(updated), lead)
    updated = np.sqrt(kept)[..., None, None] * triangle
    rows = np.sqrt(weight) * np.concatenate([omega, y[..., None]], axis=-1)
    for j in range(size):
        column, pivot = rows[..., j], updated[..., j, j]
        square = np.einsum("...i,...i", column, column)
        length = -np.copysign(np.sqrt(pivot * pivot + square), pivot)
        nothing = square == 0
        gap, length = np.where(nothing, 1.0, pivot - length), np.where(nothing, pivot, length)
        mirror = column / gap[..., None]
        top = updated[..., j, j + 1 :]
        share = np.where(nothing, 0.0, (length - pivot) / np.where(length == 0, 1.0, length))
        product = share[..., None] * (top + (mirror[..., None, :] @ rows[..., j + 1 :])[..., 0, :])
        rows[..., j + 1 :] -= mirror[..., :, None] * product[..., None, :]
        updated[..., j, j + 1 :], updated[..., j, j] = top - product, length
    return updated


def _least_eigenvalues(triangle: np.ndarray, weakest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two substitutions of all triangles at once."""
    size = weakest.shape[-1]
    half, whole = weakest.copy(), np.zeros_like(weakest)
    diagonal = np.diagonal(triangle, axis1=-2, axis2=-1)[..., :-1]
    regular = np.all(diagonal != 0, axis=-1)
    pivot = np.where(regular[..., None], diagonal, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        for j in range(size):
            half[..., j] /= pivot[..., j]
            half[..., j + 1 :] -= half[..., j, None] * triangle[..., j, j + 1 : size]
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        for j in range(size - 1, -1, -1):
            known = np.einsum("...k,...k", triangle[..., j, j + 1 : size], whole[..., j + 1 :])
            whole[..., j] = (half[..., j] - known) / pivot[..., j]
        length = np.linalg.norm(whole, axis=-1)
        found = regular & np.isfinite(length) & (length > 0)
        length = np.where(found, length, 1.0)
        direction = np.where(found[..., None], whole / length[..., None], weakest)
        return np.where(found, length**-2.0, 0.0), direction
