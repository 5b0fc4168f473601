"""Many estimators in one compiled call (extra ``fast``): the kernels of `kernels`, for a batch.

The arrays of a batch stand with its axis last in memory, and a block of estimators is advanced side by side:
the innermost loops go over them, so that they are long and vectorised whatever the size of a triangle is. All
functions want contiguous arrays with the batch last; `Information` and the rest show it first, as views.
The blocks run in numba's threads, which a process forked after they ran cannot use. One file, since numba's
cache of a kernel does not see when a function that it calls changes in another.
"""

from __future__ import annotations

import functools
from math import copysign, sqrt

import numpy as np
from numba import get_num_threads, njit, prange

VECTOR = 8  # doubles that a processor takes at once; in twice the time where they straddle lines
NARROW, WIDE = 32, 128  # estimators side by side; fewer leave the loops short, more do not fit the cache
ROTATED = 1e-15  # cosine between two columns that counts as orthogonal
SETTLED = 1e-7  # a sweep of rotations this small leaves cosines of its square: it was the last
SWEEPS = 40  # of rotations; 3 or 4 from the sample before (panda)
TINY = 1e-300
REORDERED = {"reassoc", "contract", "nsz"}  # sums in any order


@functools.lru_cache(maxsize=64)
def block_edges(many: int) -> np.ndarray:
    """Where the blocks begin, and the end: one a processor, if that makes them neither narrow nor wide."""
    blocks = max(1, -(-many // WIDE), min(get_num_threads(), -(-many // NARROW)))
    edges = np.arange(blocks + 1) * many // blocks
    edges[:-1] -= edges[:-1] % VECTOR
    return edges


@njit(cache=True)
def empty(count: int, width: int) -> np.ndarray:
    """(count, width) where vectors want it."""
    size = count * width
    memory = np.empty(size + VECTOR)
    skipped = -(memory.ctypes.data // 8) % VECTOR
    return memory[skipped : skipped + size].reshape(count, width)


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def add_product(x: np.ndarray, y: np.ndarray, into: np.ndarray) -> None:
    """into += x y."""
    for lane in range(len(into)):
        into[lane] += x[lane] * y[lane]


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def subtract_product(x: np.ndarray, y: np.ndarray, into: np.ndarray) -> None:
    """into -= x y."""
    for lane in range(len(into)):
        into[lane] -= x[lane] * y[lane]


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def add_products(x: np.ndarray, y: np.ndarray, into: np.ndarray) -> None:
    """into += x'y of two stacks (n, lanes)."""
    for i in range(len(x)):
        add_product(x[i], y[i], into)


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def find_reflection(
    column: np.ndarray, top: np.ndarray, factors: np.ndarray, share: np.ndarray, inverse: np.ndarray,
    occupied: np.ndarray,
) -> None:  # fmt: skip
    """The reflection that makes a column (m, lanes) zero and what stands above it, top, its length.

    Fills in factors and share, with which a column [t; r] becomes [t - p; r - factors p] for
    p = share (t + factors'r); occupied (m,): which rows take part at all. inverse (lanes,): scratch.
    """
    share[:] = 0.0
    for i in range(len(column)):
        square = 0.0
        for lane in range(len(top)):
            share[lane] += column[i, lane] * column[i, lane]
            square += column[i, lane] * column[i, lane]
        occupied[i] = square != 0.0
    for lane in range(len(top)):
        square = share[lane]
        length = -copysign(sqrt(top[lane] * top[lane] + square), top[lane])
        nothing = square == 0.0
        gap = 1.0 if nothing else top[lane] - length
        inverse[lane] = 1 / gap
        share[lane] = 0.0 if nothing else -gap / length
        top[lane] = top[lane] if nothing else length
    for i in range(len(column)):
        for lane in range(len(top)):
            factors[i, lane] = inverse[lane] * column[i, lane]


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def update_block(
    triangle: np.ndarray, kept: np.ndarray, weight: float, omega: np.ndarray, y: np.ndarray, lo: int, hi: int,
    updated: np.ndarray,
) -> None:  # fmt: skip
    """`kernels.update_triangle` of the estimators from lo to hi."""
    size, m, width = len(triangle), len(y), hi - lo
    rows, factors = empty(size * m, width).reshape(size, m, width), empty(m, width)
    scratch, occupied = empty(3, width), np.empty(m, np.bool_)
    root, share, product = scratch[0], scratch[1], scratch[2]
    root[:] = np.sqrt(kept[lo:hi])
    for i in range(m):
        for k in range(size - 1):
            rows[k, i] = sqrt(weight) * omega[i, k, lo:hi]
        rows[size - 1, i] = sqrt(weight) * y[i, lo:hi]
    for j in range(size):
        updated[j, j, lo:hi] = root * triangle[j, j, lo:hi]
        find_reflection(rows[j], updated[j, j, lo:hi], factors, share, product, occupied)
        for k in range(j + 1, size):
            before, top, row = triangle[j, k, lo:hi], updated[j, k, lo:hi], rows[k]
            product[:] = 0.0
            for i in range(m):
                if occupied[i]:
                    add_product(factors[i], row[i], product)
            for lane in range(width):
                scaled = root[lane] * before[lane]
                product[lane] = share[lane] * (scaled + product[lane])
                top[lane] = scaled - product[lane]
            for i in range(m):
                if occupied[i]:
                    subtract_product(factors[i], product, row[i])


@njit(cache=True, parallel=True)
def all_update_triangle(
    triangle: np.ndarray, kept: np.ndarray, weight: float, omega: np.ndarray, y: np.ndarray,
    edges: np.ndarray, updated: np.ndarray,
) -> None:  # fmt: skip
    """`kernels.update_triangle` of B: triangle (l + 1, l + 1, B), kept (B,), omega (m, l, B), y (m, B).

    Here and below edges are of the blocks, as `block_edges` has them, and what follows is filled in: of
    updated, the triangle.
    """
    for block in prange(len(edges) - 1):
        lo, hi = edges[block], edges[block + 1]
        update_block(triangle, kept, weight, omega, y, lo, hi, updated)


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def invert_block(
    triangle: np.ndarray, start: np.ndarray, lo: int, hi: int, smallest: np.ndarray, direction: np.ndarray
) -> None:
    """`kernels.inverse_iteration` of the estimators from lo to hi."""
    size, width = len(start), hi - lo
    half, whole, scratch = empty(size, width), empty(size, width), empty(3, width)
    regular, pivot, square = scratch[0], scratch[1], scratch[2]
    regular[:], square[:] = 1.0, 0.0
    for j in range(size):
        half[j] = start[j, lo:hi]
    for j in range(size):
        diagonal, value = triangle[j, j, lo:hi], half[j]
        for lane in range(width):
            regular[lane] = 0.0 if diagonal[lane] == 0.0 else regular[lane]
            value[lane] /= 1.0 if diagonal[lane] == 0.0 else diagonal[lane]
            square[lane] += value[lane] * value[lane]
        for k in range(j + 1, size):
            subtract_product(value, triangle[j, k, lo:hi], half[k])
    for lane in range(width):
        regular[lane] = regular[lane] if 0.0 < square[lane] < np.inf else 0.0
        pivot[lane] = 1 / sqrt(square[lane]) if regular[lane] > 0.0 else 0.0
        square[lane] = 0.0
    for j in range(size - 1, -1, -1):
        diagonal, value = triangle[j, j, lo:hi], whole[j]
        for lane in range(width):
            value[lane] = half[j, lane] * pivot[lane]
        for k in range(j + 1, size):
            subtract_product(triangle[j, k, lo:hi], whole[k], value)
        for lane in range(width):
            value[lane] /= 1.0 if diagonal[lane] == 0.0 else diagonal[lane]
            square[lane] += value[lane] * value[lane]
    for lane in range(width):
        found = regular[lane] > 0.0 and 0.0 < square[lane] < np.inf
        smallest[lo + lane] = 1 / square[lane] if found else 0.0
        pivot[lane] = 1 / sqrt(square[lane]) if found else 0.0
    for j in range(size):
        for lane in range(width):
            known = whole[j, lane] * pivot[lane]
            direction[j, lo + lane] = known if pivot[lane] > 0.0 else start[j, lo + lane]


@njit(cache=True, parallel=True, error_model="numpy")
def all_least_squares_step(
    triangle: np.ndarray, prior: np.ndarray, weakest: np.ndarray, omega: np.ndarray, y: np.ndarray,
    alpha: float, beta: float, xi: float, dt: float, edges: np.ndarray, updated: np.ndarray,
    kept: np.ndarray, innovation: np.ndarray, direction: np.ndarray,
) -> None:  # fmt: skip
    """`kernels.least_squares_step` of B: triangle (l + 1, l + 1, B), prior (B,), weakest (l, B), y (m, B).

    Where kept (B,) <= 0, the rest is without meaning.
    """
    for block in prange(len(edges) - 1):
        lo, hi = edges[block], edges[block + 1]
        invert_block(triangle, weakest, lo, hi, kept, direction)
        for b in range(lo, hi):
            information = max((prior[b] + kept[b]) * xi, TINY)
            kept[b] = 1 - dt * max(0.0, beta * (1 - 1 / information))
        update_block(triangle, kept, alpha * dt, omega, y, lo, hi, updated)
        for b in range(lo, hi):
            grown = updated[-1, -1, b] ** 2 - kept[b] * triangle[-1, -1, b] ** 2
            innovation[b] = sqrt(max(grown, 0.0) / (alpha * dt))


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def orthonormalise(work: np.ndarray, product: np.ndarray, scale: np.ndarray) -> None:
    """Gram and Schmidt's way with the vectors work[p, n:], or rounding would add up from sample to sample."""
    n = len(work)
    for p in range(n):
        for q in range(p):
            product[:] = 0.0
            add_products(work[p, n:], work[q, n:], product)
            for i in range(n, 2 * n):
                subtract_product(product, work[q, i], work[p, i])
        product[:] = 0.0
        add_products(work[p, n:], work[p, n:], product)
        for lane in range(len(scale)):
            scale[lane] = 1 / sqrt(product[lane])
        for i in range(n, 2 * n):
            vector = work[p, i]
            for lane in range(len(scale)):
                vector[lane] *= scale[lane]


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def find_rotations(
    alpha: np.ndarray, beta: np.ndarray, gamma: np.ndarray, unsettled: np.ndarray, rotation: np.ndarray,
    moved: np.ndarray,
) -> bool:  # fmt: skip
    """Whether p and q are to be rotated in any lane, and by what cosines and sines, rotation (2, lanes).

    Makes them orthogonal and p the longer. alpha, beta: p'p and q'q, of before and then of after; gamma: p'q.
    moved counts the rotations that are more than rounding, and where q was longer, since the sweep then
    does not see all pairs. Lanes that are settled, with unsettled 0, are left alone.
    """
    turning = 0.0
    for lane in range(len(gamma)):
        longer, shorter = max(alpha[lane], beta[lane]), min(alpha[lane], beta[lane])
        gap, square, whole = longer - shorter, gamma[lane] * gamma[lane], longer * shorter
        orthogonal = (square <= ROTATED * ROTATED * whole) | (shorter < TINY)
        tangent = 2 * gamma[lane] / (gap + sqrt(gap * gap + 4 * square) + TINY)
        tangent = 0.0 if orthogonal | (unsettled[lane] == 0.0) else tangent
        c = 1 / sqrt(1 + tangent * tangent)
        s = c * tangent
        swapped = (alpha[lane] < beta[lane]) & (unsettled[lane] != 0.0)
        rotation[0, lane], rotation[1, lane] = s if swapped else c, c if swapped else s
        settled = unsettled[lane] == 0.0
        alpha[lane] = alpha[lane] if settled else longer + tangent * gamma[lane]
        beta[lane] = beta[lane] if settled else max(shorter - tangent * gamma[lane], 0.0)
        large = (abs(tangent) > SETTLED) | ((square > SETTLED * SETTLED * whole) & (tangent != 0.0))
        moved[lane] += 1.0 if swapped | large else 0.0
        turning += 1.0 if swapped | (tangent != 0.0) else 0.0
    return turning > 0.0


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def rotate(p: np.ndarray, q: np.ndarray, cosine: np.ndarray, sine: np.ndarray) -> None:
    """p, q = cosine p + sine q, cosine q - sine p of two stacks (n, lanes)."""
    for i in range(len(p)):
        x, y = p[i], q[i]
        for lane in range(len(cosine)):
            u, v = x[lane], y[lane]
            x[lane], y[lane] = cosine[lane] * u + sine[lane] * v, cosine[lane] * v - sine[lane] * u


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def diagonalise(work: np.ndarray, squares: np.ndarray) -> None:
    """Rotate the columns work[p] = [T V, V][:, p] until those of T V are orthogonal.

    work (n, 2 n, lanes); fills in squares (n, lanes), of the lengths of T V's columns.
    """
    n, width = len(work), work.shape[2]
    scratch = empty(5, width)
    product, rotation, unsettled, moved = scratch[0], scratch[1:3], scratch[3], scratch[4]
    unsettled[:] = 1.0
    for _ in range(SWEEPS):
        moved[:] = 0.0
        squares[:] = 0.0
        for p in range(n):
            add_products(work[p, :n], work[p, :n], squares[p])
        for p in range(n - 1):
            for q in range(p + 1, n):
                product[:] = 0.0
                add_products(work[p, :n], work[q, :n], product)
                if find_rotations(squares[p], squares[q], product, unsettled, rotation, moved):
                    rotate(work[p], work[q], rotation[0], rotation[1])
        unsettled[:] = moved
        if np.sum(moved) == 0.0:
            return


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def mix_block(
    triangle: np.ndarray, first: int, basis: np.ndarray, prior: np.ndarray, saturation: float, dust: float,
    lo: int, hi: int, Y: np.ndarray, gates: np.ndarray, vectors: np.ndarray,
) -> None:  # fmt: skip
    """`kernels.directional_mix` of the estimators from lo to hi."""
    size, n, width = len(triangle) - 1, len(basis), hi - lo
    work, squares = empty(2 * n * n, width).reshape(n, 2 * n, width), empty(n, width)
    scratch = empty(2, width)
    scale, projected = scratch[0], scratch[1]
    for p in range(n):
        for i in range(n):
            work[p, i] = 0.0
            work[p, n + i] = basis[i, p, lo:hi]
    orthonormalise(work, scale, projected)
    for p in range(n):
        for i in range(n):
            for k in range(i, n):
                add_product(triangle[first + i, first + k, lo:hi], work[p, n + k], work[p, i])
    diagonalise(work, squares)
    scale[:] = 0.0
    for i in range(size):
        for k in range(i, size):
            add_product(triangle[i, k, lo:hi], triangle[i, k, lo:hi], scale)
    for p in range(n):
        projected[:] = 0.0
        for i in range(n):
            add_product(work[p, i], triangle[first + i, size, lo:hi], projected)
            vectors[i, p, lo:hi] = work[p, n + i]
        for lane in range(width):
            excited = squares[p, lane] > dust * dust * max(scale[lane], TINY)
            gate = squares[p, lane] / (prior[lo + lane] + saturation * squares[p, lane])
            gates[p, lo + lane] = gate if excited else 0.0
            Y[p, lo + lane] = gate * projected[lane] / squares[p, lane] if excited else 0.0


@njit(cache=True, parallel=True)
def all_directional_mix(
    triangle: np.ndarray, first: int, basis: np.ndarray, prior: np.ndarray, saturation: float, dust: float,
    edges: np.ndarray, Y: np.ndarray, gates: np.ndarray, vectors: np.ndarray,
) -> None:  # fmt: skip
    """`kernels.directional_mix` of B: triangle (l + 1, l + 1, B), basis (n, n, B), prior (B,).

    Y and gates (n, B), vectors (n, n, B).
    """
    for block in prange(len(edges) - 1):
        lo, hi = edges[block], edges[block + 1]
        mix_block(triangle, first, basis, prior, saturation, dust, lo, hi, Y, gates, vectors)


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def adapt_block(
    theta: np.ndarray, psi: np.ndarray, e1: np.ndarray, e2: np.ndarray, position: float, velocity: float,
    Gamma: np.ndarray, rate: float, b: float, Y: np.ndarray, delta: np.ndarray, gates: np.ndarray,
    basis: np.ndarray, dt: float, lo: int, hi: int, adapted: np.ndarray,
) -> None:  # fmt: skip
    """`kernels.adapt` of the estimators from lo to hi."""
    n, width = len(theta), hi - lo
    moved, scratch = empty(n, width), empty(2, width)
    error, change = scratch[0], scratch[1]
    for p in range(n):
        moved[p] = theta[p, lo:hi]
    for lane in range(width):
        for i in range(e1.shape[1]):
            drive = dt * (position * np.tanh(e1[lo + lane, i]) + velocity * e2[lo + lane, i])
            for p in range(n):
                moved[p, lane] -= Gamma[p % len(Gamma)] * psi[lo + lane, i, p] * drive
    for p in range(n):
        adapted[p, lo:hi] = moved[p]
    for p in range(n):
        error[:] = 0.0
        for i in range(n):
            add_product(basis[i, p, lo:hi], moved[i], error)
        for lane in range(width):
            excited = delta[p, lo + lane] > 0.0
            error[lane] -= Y[p, lo + lane] / (delta[p, lo + lane] if excited else 1.0)
            size, speed = abs(error[lane]), dt * rate * gates[p, lo + lane]
            if b == 0.5:
                left = max(sqrt(size) - 0.5 * speed, 0.0) ** 2
            elif b == 1.0:
                left = size * np.exp(-speed)
            else:
                left = max(size ** (1 - b) - (1 - b) * speed, 0.0) ** (1 / (1 - b))
            change[lane] = copysign(left, error[lane]) - error[lane] if excited else 0.0
        for i in range(n):
            direction, into = basis[i, p, lo:hi], adapted[i, lo:hi]
            for lane in range(width):  # where there is no excitation, the direction may be anything
                into[lane] += direction[lane] * change[lane] if change[lane] != 0.0 else 0.0


@njit(cache=True, parallel=True)
def all_adapt(
    theta: np.ndarray, psi: np.ndarray, e1: np.ndarray, e2: np.ndarray, position: float, velocity: float,
    Gamma: np.ndarray, rate: float, b: float, Y: np.ndarray, delta: np.ndarray, gates: np.ndarray,
    basis: np.ndarray, dt: float, edges: np.ndarray, adapted: np.ndarray,
) -> None:  # fmt: skip
    """`kernels.adapt` of B, with one delta for each direction.

    Batch first: psi (B, nv, n), e1 and e2 (B, nv). Batch last: theta, Y, delta, gates and adapted (n, B), and
    basis (n, n, B).
    """
    for block in prange(len(edges) - 1):
        lo, hi = edges[block], edges[block + 1]
        adapt_block(
            theta, psi, e1, e2, position, velocity, Gamma, rate, b, Y, delta, gates, basis, dt, lo, hi,
            adapted,
        )  # fmt: skip
