"""The information triangle's equations as numba compiles them: each once, in loops over numbers and arrays.

A triangle T (l + 1, l + 1) is the factor [T t; 0 residual] of square-root information: its block (l, l) has
T'T = prior I + R, R the weighted sum of Omega'Omega, and T't = s of Omega'y. Loops over a column's rest run
over slices, with indices from 0: only so does the compiler vectorise them, four times as fast.
"""

from __future__ import annotations

from math import copysign, inf, sqrt

import numpy as np

from eladapt.compiling import MATRIX, SCALAR, VECTOR, kernel

TINY = 1e-300
REORDERED = {"reassoc", "contract", "nsz"}  # sums in any order, an eighth faster
SWEEPS = 30  # of Jacobi's rotations over a few rows; 3 to 5 are typical
BEYOND = 1 + 1e-9  # rounding
BOUND_SWEEPS = 4
ROTATED = 1e-15  # cosine between two rows that counts as orthogonal


@kernel(fastmath=REORDERED)
def eliminate(triangle: np.ndarray, rows: np.ndarray, added: int) -> None:
    """The triangle of [T; rows] in place, by Householder reflections; ``rows`` is used up.

    The first ``added`` rows count as information that comes, T'T + r r', those after as information that
    goes, T'T - r r' (hyperbolic reflections; stable as long as little of T goes at once). What is left in the
    last column of ``rows`` is what no theta explains.
    """
    size, m = len(triangle), len(rows)
    scratch = np.empty(size)
    for j in range(size - 1):
        square = 0.0
        for i in range(m):
            square += rows[i, j] * rows[i, j] if i < added else -rows[i, j] * rows[i, j]
        if square == 0.0:
            continue
        pivot = triangle[j, j]
        length = -copysign(sqrt(max(pivot * pivot + square, TINY)), pivot)
        triangle[j, j] = length
        inverse, share = 1 / (pivot - length), (length - pivot) / length
        top, product = triangle[j, j + 1 :], scratch[j + 1 :]
        for k in range(len(top)):
            product[k] = top[k]
        for i in range(m):
            row, factor = rows[i, j + 1 :], rows[i, j] * inverse if i < added else -rows[i, j] * inverse
            for k in range(len(row)):
                product[k] += factor * row[k]
        for k in range(len(top)):
            product[k] *= share
            top[k] -= product[k]
        for i in range(m):
            row, factor = rows[i, j + 1 :], rows[i, j] * inverse
            for k in range(len(row)):
                row[k] -= factor * product[k]


@kernel(fastmath=REORDERED)
def solve_transposed(triangle: np.ndarray, x: np.ndarray, most: float) -> float:
    """x <- T'^-1 x in place, and its squared length; not finite where T is singular. It stops where that is
    more than ``most``."""
    n, square = len(x), 0.0
    for j in range(n):
        value = x[j] / triangle[j, j]
        if value == 0.0:
            continue
        x[j] = value
        square += value * value
        if square > most:
            break
        rest, row = x[j + 1 :], triangle[j, j + 1 : n]
        for k in range(len(rest)):
            rest[k] -= row[k] * value
    return square


@kernel(fastmath=REORDERED)
def solve(triangle: np.ndarray, x: np.ndarray) -> float:
    """x <- T^-1 x in place, and its squared length; not finite where T is singular."""
    n, square = len(x), 0.0
    for j in range(n - 1, -1, -1):
        known, row, total = x[j + 1 :], triangle[j, j + 1 : n], 0.0
        for k in range(len(known)):
            total += row[k] * known[k]
        value = (x[j] - total) / triangle[j, j]
        x[j] = value
        square += value * value
    return square


@kernel(MATRIX, SCALAR, SCALAR, MATRIX, VECTOR)
def updated(
    triangle: np.ndarray, kept: float, weight: float, omega: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, float]:
    """(443), (510): the triangle of [sqrt(kept) T; sqrt(weight) [Omega | y]], and the innovation: the size of
    what the rows say that no theta which fits the old ones can, for each unit of weight."""
    size, m = len(triangle), len(y)
    root, scale = sqrt(kept), sqrt(weight)
    after, rows = np.zeros_like(triangle), np.empty((m, size))
    for j in range(size):
        for k in range(j, size):
            after[j, k] = root * triangle[j, k]
    for i in range(m):
        for k in range(size - 1):
            rows[i, k] = scale * omega[i, k]
        rows[i, size - 1] = scale * y[i]
    eliminate(after, rows, m)
    grown = 0.0
    for i in range(m):
        grown += rows[i, size - 1] * rows[i, size - 1]
    corner = after[size - 1, size - 1]
    after[size - 1, size - 1] = sqrt(corner * corner + grown)
    return after, sqrt(grown / weight)


@kernel(MATRIX, VECTOR)
def smallest(triangle: np.ndarray, start: np.ndarray) -> tuple[float, np.ndarray]:
    """One step of inverse iteration: (the smallest eigenvalue of T'T, its direction), from ``start`` of unit
    length; (0, start) where T is singular."""
    n = len(start)
    direction = start.copy()
    square = solve_transposed(triangle, direction, inf)
    if not 0.0 < square < inf:
        return 0.0, start
    for k in range(n):
        direction[k] /= sqrt(square)
    square = solve(triangle, direction)
    if not 0.0 < square < inf:
        return 0.0, start
    for k in range(n):
        direction[k] /= sqrt(square)
    return 1 / square, direction


@kernel()
def orthogonal_rows(rows: np.ndarray) -> None:
    """Rotates rows [Omega | y] among each other, in place, until those of Omega are orthogonal.

    One-sided Jacobi, on the Gram matrix and the rotation that belongs to it: nothing is lost of y = Omega
    theta.
    """
    m, n = len(rows), rows.shape[1] - 1
    gram, turned = np.empty((m, m)), np.eye(m)
    for p in range(m):
        for q in range(p, m):
            total = 0.0
            for k in range(n):
                total += rows[p, k] * rows[q, k]
            gram[p, q] = gram[q, p] = total
    for _ in range(SWEEPS):
        settled = True
        for p in range(m - 1):
            for q in range(p + 1, m):
                cross = gram[p, q]
                if cross * cross <= ROTATED * ROTATED * abs(gram[p, p] * gram[q, q]) + TINY:
                    continue
                settled = False
                zeta = (gram[q, q] - gram[p, p]) / (2 * cross)
                tangent = copysign(1.0, zeta) / (abs(zeta) + sqrt(1 + zeta * zeta))
                cosine = 1 / sqrt(1 + tangent * tangent)
                sine = cosine * tangent
                for k in range(m):
                    a, b = gram[k, p], gram[k, q]
                    gram[k, p], gram[k, q] = cosine * a - sine * b, sine * a + cosine * b
                for k in range(m):
                    a, b = gram[p, k], gram[q, k]
                    gram[p, k], gram[q, k] = cosine * a - sine * b, sine * a + cosine * b
                    a, b = turned[p, k], turned[q, k]
                    turned[p, k], turned[q, k] = cosine * a - sine * b, sine * a + cosine * b
        if settled:
            break
    before = rows.copy()
    for p in range(m):
        into = rows[p]
        for k in range(n + 1):
            into[k] = 0.0
        for q in range(m):
            share, row = turned[p, q], before[q]
            for k in range(n + 1):
                into[k] += share * row[k]


@kernel(fastmath=REORDERED)
def forgotten_rows(
    triangle: np.ndarray, prior: float, rows: np.ndarray, share: float, into: np.ndarray
) -> None:
    """What is forgotten along ``rows`` (m, l + 1), orthogonal: rows g of T'T - g'g and of T't, written to
    ``into``.

    Subspace-of-information forgetting: R <- R - share R V (V'R V)^-1 V'R, and s likewise, V the directions of
    the rows. A direction about which less is known than the prior is left alone.
    """
    m, size = rows.shape
    n = size - 1
    unit, image = np.zeros((m, n)), np.zeros((m, n))
    for d in range(m):
        square = 0.0
        for k in range(n):
            square += rows[d, k] * rows[d, k]
        if square > 0.0:
            inverse = 1 / sqrt(square)
            for k in range(n):
                unit[d, k] = rows[d, k] * inverse
    for i in range(n):
        row = triangle[i, i:n]
        for d in range(m):
            direction, total = unit[d, i:], 0.0
            for k in range(len(row)):
                total += row[k] * direction[k]
            image[d, i] = total
    for d in range(m):
        goes = into[d]
        for k in range(n):
            goes[k] = -prior * unit[d, k]
        goes[n] = 0.0
        for i in range(n):
            rest, row, factor = goes[i:], triangle[i, i:], image[d, i]
            for k in range(len(row)):
                rest[k] += factor * row[k]
    # Gram-Schmidt in R: rows of L^-1 V'[R s], L L' = V'R V
    for d in range(m):
        goes, pivot = into[d], 0.0
        for k in range(n):
            pivot += goes[k] * unit[d, k]
        scale = 1 / sqrt(pivot) if pivot > prior else 0.0
        for k in range(size):
            goes[k] *= scale
        for e in range(d + 1, m):
            later, direction, cross = into[e], unit[e], 0.0
            for k in range(n):
                cross += goes[k] * direction[k]
            for k in range(size):
                later[k] -= cross * goes[k]
    root = sqrt(share)
    for d in range(m):
        for k in range(size):
            into[d, k] *= root


@kernel(MATRIX, SCALAR, MATRIX, VECTOR, SCALAR, SCALAR, SCALAR)
def subspace_step(
    triangle: np.ndarray, prior: float, omega: np.ndarray, y: np.ndarray, weight: float, share: float,
    floor: float,
) -> tuple[np.ndarray, float, int]:  # fmt: skip
    """Least squares that forgets ``share`` of what it knows along the new rows, and nothing else.

    Rows are made orthogonal first; those of Omega no longer than ``floor`` carry nothing but noise and count
    for nothing. Returns the triangle, the innovation and how many rows counted.
    """
    size, m = len(triangle), len(y)
    rows = np.empty((2 * m, size))
    for i in range(m):
        for k in range(size - 1):
            rows[i, k] = omega[i, k]
        rows[i, size - 1] = y[i]
    orthogonal_rows(rows[:m])
    scale, counted = sqrt(weight), 0
    for i in range(m):
        square = 0.0
        for k in range(size - 1):
            square += rows[i, k] * rows[i, k]
        if square > floor * floor:
            for k in range(size):
                rows[counted, k] = scale * rows[i, k]
            counted += 1
    if counted == 0:
        return triangle, 0.0, 0
    forgotten_rows(triangle, prior, rows[:counted], share, rows[counted : 2 * counted])
    after = triangle.copy()
    eliminate(after, rows[: 2 * counted], counted)
    grown = 0.0
    for i in range(counted):
        grown += rows[i, size - 1] * rows[i, size - 1]
    corner = triangle[size - 1, size - 1]
    after[size - 1, size - 1] = sqrt((1 - share) * corner * corner + grown)
    return after, sqrt(grown / weight), counted


@kernel(MATRIX, SCALAR, VECTOR)
def prediction_error(triangle: np.ndarray, prior: float, theta: np.ndarray) -> np.ndarray:
    """r = Y - Phi theta of (488), Phi = (prior I + R)^-1 R, by three triangular solves, without Phi.

    Y = T^-1 t and Phi = I - prior (T'T)^-1. With prior = 0 it is Kreisselmeier's, Y = T't and Phi = T'T.
    """
    n = len(theta)
    error = np.empty(n)
    if prior > 0.0:
        for k in range(n):
            error[k] = triangle[k, n]
        solve(triangle, error)
        regular = theta.copy()
        solve_transposed(triangle, regular, inf)
        solve(triangle, regular)
        for k in range(n):
            error[k] += prior * regular[k] - theta[k]
        return error
    unexplained = np.empty(n)
    for j in range(n):
        unexplained[j] = triangle[j, n]
        for k in range(j, n):
            unexplained[j] -= triangle[j, k] * theta[k]
        error[j] = 0.0
    for j in range(n):
        for k in range(j, n):
            error[k] += triangle[j, k] * unexplained[j]
    return error


@kernel(MATRIX, VECTOR, VECTOR, VECTOR)
def kept_within(triangle: np.ndarray, theta: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """theta (l,) within its bounds, the nearest to it by the information, d'T'T d: what a bound takes from
    one parameter goes to those that the data hardly tell from it.

    One bound after the other, along F e_k, a few times over: what is left of it is for a plain limit.
    """
    n, after = len(theta), theta.copy()
    column = np.empty(n)
    for _ in range(BOUND_SWEEPS):
        inside = True
        for k in range(n):
            beyond = after[k] - min(max(after[k], low[k]), high[k])
            if beyond == 0.0:
                continue
            inside = False
            for j in range(n):
                column[j] = 0.0
            column[k] = 1.0
            solve_transposed(triangle, column, inf)
            solve(triangle, column)
            share = beyond / column[k]
            for j in range(n):
                after[j] -= share * column[j]
            after[k] = min(max(after[k], low[k]), high[k])
        if inside:
            break
    for k in range(n):
        after[k] = min(max(after[k], low[k]), high[k])
    return after


@kernel(MATRIX, MATRIX)
def variances(triangle: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(m,) c'F c of combinations of parameters, rows c (m, l), F = (T'T)^-1."""
    result = np.empty(len(rows))
    for i in range(len(rows)):
        x = rows[i].copy()
        result[i] = solve_transposed(triangle, x, inf)
    return result


@kernel(MATRIX, SCALAR, MATRIX, VECTOR, VECTOR, SCALAR, SCALAR, SCALAR, SCALAR)
def surely(
    triangle: np.ndarray, prior: float, rows: np.ndarray, theta: np.ndarray, noise: np.ndarray,
    scatter: float, doubted: float, deviations: float, least: float,
) -> np.ndarray:  # fmt: skip
    """(m,) c theta of combinations c (m, l), nearer to zero by what the data leave open.

    By ``doubted`` times the prior's share of what is known of c, and by ``deviations`` standard deviations;
    scatter times noise is the variance that c'F c multiplies, of row i that of i modulo its length. Each of
    the two leaves nothing from some c'F c on, beyond which that is not worked out. What is not above
    ``least`` counts as 0.
    """
    m, n = rows.shape
    found = np.zeros(m)
    for i in range(m):
        x, value, square = rows[i].copy(), 0.0, 0.0
        for k in range(n):
            value += x[k] * theta[k]
            square += x[k] * x[k]
        if square > 0.0 and value > least:
            error = scatter * noise[i % len(noise)]
            most = min(square / (doubted * prior), value * value / (deviations * deviations * error))
            variance = solve_transposed(triangle, x, BEYOND * most)
            size = abs(value) * max(0.0, 1 - doubted * prior * variance / square)
            size -= deviations * sqrt(error * variance)
            found[i] = copysign(max(size, 0.0), value)
    return found
