"""The estimator's inner loops, compiled by numba (extra ``fast``).

What LAPACK does otherwise: a row update of a triangle, one step of inverse iteration, and singular vectors by
one-sided Jacobi rotations, which start from the vectors of the sample before and so are done sooner. All
arrays are contiguous, by rows. `lanes` has the same for a batch.
"""

from __future__ import annotations

from math import copysign, exp, expm1, sqrt

import numpy as np
from numba import njit

ROTATED = 1e-15  # cosine between two columns that counts as orthogonal
SETTLED = 1e-7  # a sweep of rotations this small leaves cosines of its square: it was the last
SWEEPS = 40  # 5 or 6 from nothing, 2 or 3 from the sample before (panda)
TINY = 1e-300
REORDERED = {"reassoc", "contract", "nsz"}  # sums in any order, an eighth faster


@njit(cache=True, error_model="numpy")
def update_triangle(
    triangle: np.ndarray, kept: float, weight: float, omega: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """The triangle of [sqrt(kept) T; sqrt(weight) [Omega | y]] by Householder reflections."""
    size, m = len(triangle), len(y)
    updated = sqrt(kept) * triangle
    rows = np.empty((m, size))
    rows[:, : size - 1] = sqrt(weight) * omega
    rows[:, size - 1] = sqrt(weight) * y
    scratch = np.empty(size)
    for j in range(size):
        square = 0.0
        for i in range(m):
            square += rows[i, j] * rows[i, j]
        if square == 0.0:
            continue
        pivot = updated[j, j]
        length = -copysign(sqrt(pivot * pivot + square), pivot)
        updated[j, j] = length
        inverse, share = 1 / (pivot - length), (length - pivot) / length
        # Slices from j + 1 on, with indices from 0: only so are the loops vectorised, four times as fast.
        top, product = updated[j, j + 1 :], scratch[j + 1 :]
        for k in range(len(top)):
            product[k] = top[k]
        for i in range(m):
            row, factor = rows[i, j + 1 :], rows[i, j] * inverse
            for k in range(len(row)):
                product[k] += factor * row[k]
        for k in range(len(top)):
            product[k] *= share
            top[k] -= product[k]
        for i in range(m):
            row, factor = rows[i, j + 1 :], rows[i, j] * inverse
            for k in range(len(row)):
                row[k] -= factor * product[k]
    return updated


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def inverse_iteration(triangle: np.ndarray, start: np.ndarray) -> tuple[float, np.ndarray]:
    """(1 / ||z||^2, z / ||z||) of R z = x / ||T'^-1 x||, R = T'T; (0, start) where R is singular."""
    size = len(start)
    half, whole, square = start.copy(), np.empty(size), 0.0
    for j in range(size):
        if triangle[j, j] == 0.0:
            return 0.0, start
        value = half[j] / triangle[j, j]
        half[j] = value
        square += value * value
        rest, row = half[j + 1 :], triangle[j, j + 1 : size]
        for k in range(len(rest)):
            rest[k] -= row[k] * value
    if not 0.0 < square < np.inf:
        return 0.0, start
    scale, square = sqrt(square), 0.0
    for j in range(size - 1, -1, -1):
        known, row, total = whole[j + 1 :], triangle[j, j + 1 : size], 0.0
        for k in range(len(known)):
            total += row[k] * known[k]
        value = (half[j] / scale - total) / triangle[j, j]
        whole[j] = value
        square += value * value
    if not 0.0 < square < np.inf:
        return 0.0, start
    return 1 / square, whole / sqrt(square)


@njit(cache=True, fastmath=REORDERED)
def singular_directions(
    triangle: np.ndarray, first: int, basis: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """(singular values descending, V' theta_U, V) of T_UU theta_U = t_U, from row ``first`` on, and ||T||.

    basis: orthogonal, the V of a triangle nearby, or the identity.
    """
    n = len(triangle) - 1 - first
    columns, vectors = np.zeros((n, n)), basis.T.copy()  # one column of T V, or of V, a row
    for p in range(n):  # Gram-Schmidt, or rounding would add up from sample to sample
        for q in range(p):
            overlap = 0.0
            for i in range(n):
                overlap += vectors[p, i] * vectors[q, i]
            for i in range(n):
                vectors[p, i] -= overlap * vectors[q, i]
        length = 0.0
        for i in range(n):
            length += vectors[p, i] * vectors[p, i]
        for i in range(n):
            vectors[p, i] /= sqrt(length)
        for i in range(n):
            total = 0.0
            for k in range(i, n):
                total += triangle[first + i, first + k] * vectors[p, k]
            columns[p, i] = total
    for _ in range(SWEEPS):
        settled = True
        for p in range(n - 1):
            for q in range(p + 1, n):
                alpha = beta = gamma = 0.0
                for i in range(n):
                    alpha += columns[p, i] * columns[p, i]
                    beta += columns[q, i] * columns[q, i]
                    gamma += columns[p, i] * columns[q, i]
                if alpha < beta:  # the longer column stands first; this sweep will not see all its pairs
                    settled = False
                    for i in range(n):
                        columns[p, i], columns[q, i] = columns[q, i], -columns[p, i]
                        vectors[p, i], vectors[q, i] = vectors[q, i], -vectors[p, i]
                    alpha, beta, gamma = beta, alpha, -gamma
                square, whole = gamma * gamma, alpha * beta
                if square <= ROTATED * ROTATED * whole or beta < TINY:
                    continue
                zeta = (beta - alpha) / (2 * gamma)
                tangent = copysign(1.0, zeta) / (abs(zeta) + sqrt(1 + zeta * zeta))
                settled &= abs(tangent) <= SETTLED and square <= SETTLED * SETTLED * whole
                cosine = 1 / sqrt(1 + tangent * tangent)
                sine = cosine * tangent
                for i in range(n):
                    a, b = columns[p, i], columns[q, i]
                    columns[p, i], columns[q, i] = cosine * a - sine * b, sine * a + cosine * b
                    a, b = vectors[p, i], vectors[q, i]
                    vectors[p, i], vectors[q, i] = cosine * a - sine * b, sine * a + cosine * b
        if settled:
            break
    singular, estimate = np.zeros(n), np.zeros(n)
    for p in range(n):
        square = projected = 0.0
        for i in range(n):
            square += columns[p, i] * columns[p, i]
            projected += columns[p, i] * triangle[first + i, first + n]
        singular[p] = sqrt(square)
        estimate[p] = projected / square if square > TINY else 0.0
    total = 0.0
    for i in range(n + first):
        for k in range(i, n + first):
            total += triangle[i, k] * triangle[i, k]
    return singular, estimate, vectors.T.copy(), sqrt(total)


@njit(cache=True)
def path_points(
    points: np.ndarray, moved: np.ndarray, before: np.ndarray, after: np.ndarray, dt: float
) -> np.ndarray:
    """(5, nv): two offsets and two velocities at points (2, 1) in [0, 1] of a path whose velocity is linear,
    and its acceleration."""
    path = np.empty((5, len(moved)))
    for i in range(len(moved)):
        change = after[i] - before[i]
        for k in range(2):
            path[k, i] = points[k, 0] * moved[i] - (dt / 12) * change
            path[2 + k, i] = before[i] + points[k, 0] * change
        path[4, i] = change / dt
    return path


@njit(cache=True)
def filter_rows(
    omega: np.ndarray, y: np.ndarray, rho: float, weight: np.ndarray, one: np.ndarray, two: np.ndarray,
    tau: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """The force balance after a step: rho [Omega y] + weight [(one + two)/2, tau]."""
    rows, outputs = np.empty_like(omega), np.empty_like(y)
    for i in range(len(y)):
        outputs[i] = rho * y[i] + weight[i] * tau[i]
        share, into, before, first, second = 0.5 * weight[i], rows[i], omega[i], one[i], two[i]
        for k in range(len(into)):
            into[k] = rho * before[k] + share * (first[k] + second[k])
    return outputs, rows


@njit(cache=True)
def least_squares_step(
    triangle: np.ndarray, prior: float, weakest: np.ndarray, omega: np.ndarray, y: np.ndarray, alpha: float,
    beta: float, xi: float, dt: float,
) -> tuple[np.ndarray, float, float, np.ndarray]:  # fmt: skip
    """`LeastSquares.step`: (triangle, kept, innovation, weakest)."""
    smallest, direction = inverse_iteration(triangle, weakest)
    kept = 1 - dt * max(0.0, beta * (1 - 1 / max((prior + smallest) * xi, TINY)))
    if kept <= 0:
        return triangle, kept, 0.0, direction
    updated = update_triangle(triangle, kept, alpha * dt, omega, y)
    grown = updated[-1, -1] ** 2 - kept * triangle[-1, -1] ** 2
    return updated, kept, sqrt(max(grown, 0.0) / (alpha * dt)), direction


@njit(cache=True)
def directional_mix(
    triangle: np.ndarray, first: int, basis: np.ndarray, prior: float, saturation: float, dust: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`Directional.mix`: (Y, gates, V)."""
    singular, estimate, vectors, scale = singular_directions(triangle, first, basis)
    Y, gates = np.zeros_like(singular), np.zeros_like(singular)
    for p in range(len(singular)):
        if singular[p] > dust * max(scale, TINY):
            square = singular[p] * singular[p]
            gates[p] = square / (prior + saturation * square)
            Y[p] = gates[p] * estimate[p]
    return Y, gates, vectors


@njit(cache=True)
def adapt(
    theta: np.ndarray, psi: np.ndarray, e1: np.ndarray, e2: np.ndarray, position: float, velocity: float,
    Gamma: np.ndarray, rate: np.ndarray, b: float, Y: np.ndarray, delta: np.ndarray, gates: np.ndarray,
    basis: np.ndarray, dt: float,
) -> np.ndarray:  # fmt: skip
    """`CompositeLaw.step` without bounds: the direct term, then each direction's flow.

    position, velocity: the factors of tanh(e1) and e2. Gamma, rate: one entry, or one a parameter; delta,
    gates: one entry, or one a direction of ``basis``.
    """
    j = len(theta)
    moved = theta.copy()
    for i in range(len(e1)):
        drive = dt * (position * np.tanh(e1[i]) + velocity * e2[i])
        for p in range(j):
            moved[p] -= Gamma[p % len(Gamma)] * psi[i, p] * drive
    directional, offset = len(delta) == j and basis.shape[0] == j, len(Y) - j
    result = moved.copy()
    for p in range(j):
        d = p % len(delta)
        if not delta[d] > 0.0:
            continue
        error = -Y[offset + p] / delta[d]
        if directional:
            for i in range(j):
                error += basis[i, p] * moved[i]
        else:
            error += moved[p]
        size, speed = abs(error), dt * rate[p % len(rate)] * gates[d]
        if b == 1.0:
            left = size * np.exp(-speed)
        else:
            left = max(size ** (1 - b) - (1 - b) * speed, 0.0) ** (1 / (1 - b))
        change = copysign(left, error) - error
        if directional:
            for i in range(j):
                result[i] += basis[i, p] * change
        else:
            result[p] += change
    return result


@njit(cache=True)
def advance(
    omega: np.ndarray, y: np.ndarray, triangle: np.ndarray, prior: float, weakest: np.ndarray,
    basis: np.ndarray, integral: np.ndarray, theta: np.ndarray, disturbance: np.ndarray,
    one: np.ndarray, two: np.ndarray, tau: np.ndarray, v: np.ndarray, psi: np.ndarray, e1: np.ndarray,
    inertial: np.ndarray, dt: float,
    pole: float, row_weight: np.ndarray, alpha: float, beta: float, xi: float, dust: float,
    gate_exponent: float, b: float, position: float, velocity: float, Gamma: np.ndarray, rate: np.ndarray,
    effort_limit: np.ndarray, memory: float,
) -> tuple[
    np.ndarray, np.ndarray, np.ndarray, float, float, np.ndarray, np.ndarray, np.ndarray, np.ndarray,
    np.ndarray, np.ndarray, np.ndarray, np.ndarray,
]:  # fmt: skip
    """The default blocks in line, from the force balance to theta and the disturbance estimate.

    Arguments: the state, the sample (one, two: W at Gauss's points; inertial: M a + C v), and from pole on
    the gains of the blocks, in their order; gate_exponent = b + d, memory: of the disturbance estimate.
    Returns y, omega, triangle, kept, innovation, weakest, Y, delta, basis, gates, integral, theta,
    disturbance; all but y and disturbance are without meaning where kept <= 0.
    """
    y, omega = filter_rows(omega, y, exp(-pole * dt), -expm1(-pole * dt) * row_weight, one, two, tau)
    triangle, kept, innovation, weakest = least_squares_step(
        triangle, prior, weakest, omega, y, alpha, beta, xi, dt
    )
    Y, delta, basis = directional_mix(
        triangle, triangle.shape[0] - 1 - len(theta), basis, kept * prior, 1.0, dust
    )
    gates = np.empty_like(delta)
    for p in range(len(delta)):
        size = delta[p] ** gate_exponent
        gates[p] = size / (1 + size)
    moving_e1, moving_v = e1.copy(), v.copy()
    for i in range(len(v)):
        if not abs(tau[i]) < effort_limit[i]:  # clipped: the direct term rests
            moving_e1[i] = moving_v[i] = 0.0
    share, following = -expm1(-dt / memory), disturbance.copy()
    for i in range(len(v)):
        feedback = tau[i]
        for p in range(len(theta)):
            feedback -= psi[i, p] * theta[p]
        following[i] += share * (inertial[i] - feedback - disturbance[i])
    theta = adapt(
        theta, psi, moving_e1, moving_v, position, velocity, Gamma, rate, b,
        Y, delta, gates, basis, dt,
    )  # fmt: skip
    return (
        y, omega, triangle, kept, innovation, weakest, Y, delta, basis, gates, integral + dt * gates, theta,
        following,
    )  # fmt: skip
