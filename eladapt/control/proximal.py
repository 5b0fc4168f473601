"""The convex problem of the semi-implicit control law: M (w - v) = H law(e + H w, w).

The scalar problem K w + A |x|^a sign(x) + B |w|^b sign(w) = u with x = w + s is strictly increasing in w,
with infinite slope at the two kinks w = 0 and x = 0. The kink nearest the root is found from signs, and
Newton's method runs in the power of the distance to it, in which the function is smooth; bisection
guards it. w and x are both measured from the kink, so that neither is a difference of large numbers.

The coupled problem runs Newton's method in u, with w = prox(u) the solution of the scalar problems: it is
linear when the joints do not couple, and smooth where the law is not.
"""

from __future__ import annotations

from math import copysign, inf, nan, sqrt
from typing import NamedTuple

import numpy as np

from eladapt.compiling import COUNT, MATRIX, SCALAR, VECTOR, kernel

SCALAR_ITERATIONS = 80  # bisection alone needs no more for double precision; 3 to 8 are typical
ITERATIONS = 40  # of the coupled problem; 3 to 6 are typical
CONVERGED = 1e-11  # residual relative to the momenta of the first iterate: below 1e-10 of those of the last
LEAST_FRACTION = 1e-3  # of a Newton step that still is worth trying
EPS = 8 * float(np.finfo(float).eps)
TINY = float(np.finfo(float).tiny)
QUADRATIC = 1e-9  # a Newton step this small leaves an error of its square


class Root(NamedTuple):
    """The solution, with x = w + s to full relative precision."""

    w: float
    x: float
    slope: float  # dw/du in [0, 1/K], 0 at a kink


class Solution(NamedTuple):
    """Of the coupled problem."""

    e1: np.ndarray  # (nv,) e + H w
    w: np.ndarray  # (nv,)
    torque: np.ndarray  # (nv,) the law at (e1, w)
    evaluations: int
    residual: float  # of the momentum equation, relative to the momenta involved


def signed_power(x: np.ndarray, exponent: float) -> np.ndarray:
    """|x|^exponent sign(x), element by element."""
    return np.sign(x) * np.abs(x) ** exponent


@kernel()
def power(x: float, exponent: float) -> float:
    """x^exponent for x >= 0, without the logarithm where there is a shorter way."""
    if exponent == 0.5:
        return sqrt(x)
    if exponent == 2.0:
        return x * x
    if exponent == 3.0:
        return x * x * x
    return x**exponent


@kernel()
def solve_scalar(u: float, s: float, spring: float, damper: float, linear: float, a: float, b: float) -> Root:
    """The root for spring A > 0, damper B > 0, linear K > 0 and exponents 0 < a <= b <= 1."""
    at_spring, reach = a < b, inf
    if s != 0:
        half = 0.5 * abs(s)
        middle = spring * power(half, a) - damper * power(half, b) - linear * half
        reach, at_spring = half, ((middle if s > 0 else -middle) < u) != (s > 0)
    if at_spring:
        deficit = u + linear * s + copysign(damper * power(abs(s), b), s)
        own, other, strength, weight = a, b, spring, damper
    else:
        deficit = u - copysign(spring * power(abs(s), a), s)
        own, other, strength, weight = b, a, damper, spring
    if deficit == 0:
        return Root(-s, 0.0, 0.0) if at_spring else Root(0.0, s, 0.0)
    side, inverse = copysign(1.0, deficit), 1 / own

    # In r = distance^own >= 0, side * excess increases from -|deficit|, and its own term is linear.
    left, right = 0.0, min(abs(deficit) / strength, power(abs(deficit) / linear, own))
    if side == copysign(1.0, s if at_spring else -s):
        right = min(right, power(reach, own))
    r = right
    near = far = slope = 0.0
    shift = -s if at_spring else s
    for _ in range(SCALAR_ITERATIONS):
        distance = power(r, inverse)
        near, far = side * distance, side * distance + shift
        w = far if at_spring else near
        size = abs(far)
        pull = weight * power(size, other)
        slope = linear + (other * pull / size if size > 0 else inf)
        value = side * (linear * w + copysign(pull, far) - u) + strength * r
        if value == 0:
            break
        if value > 0:
            right = r
        else:
            left = r
        newton = r - value / (slope * inverse * distance / r + strength) if r > 0 else -1.0
        trusted = left <= newton <= right  # equal where it has converged
        following = newton if trusted else 0.5 * (left + right)
        change, r = abs(following - r), following
        if change <= (QUADRATIC if trusted else EPS) * r:
            break
    distance = power(r, inverse)
    near, far = side * distance, side * distance + shift
    size = abs(far)
    slope = linear + (other * weight * power(size, other) / size if size > 0 else inf)
    slope += own * strength * r / distance if distance > 0 else inf
    return Root(far, near, 1 / slope) if at_spring else Root(near, far, 1 / slope)


@kernel()
def solve_linear(matrix: np.ndarray, x: np.ndarray) -> None:
    """x <- matrix^-1 x in place, by elimination without pivots: diagonally dominant or close to it. The
    matrix is used up."""
    n = len(x)
    for j in range(n):
        for i in range(j + 1, n):
            factor = matrix[i, j] / matrix[j, j]
            for k in range(j + 1, n):
                matrix[i, k] -= factor * matrix[j, k]
            x[i] -= factor * x[j]
    for j in range(n - 1, -1, -1):
        total = x[j]
        for k in range(j + 1, n):
            total -= matrix[j, k] * x[k]
        x[j] = total / matrix[j, j]


@kernel(VECTOR, VECTOR, MATRIX, VECTOR, VECTOR, VECTOR, SCALAR, SCALAR, VECTOR, COUNT)
def solve_coupled(
    e1: np.ndarray, e2: np.ndarray, mass_matrix: np.ndarray, P: np.ndarray, D: np.ndarray, D_L: np.ndarray,
    a: float, b: float, horizon: np.ndarray, most: int = ITERATIONS,
) -> Solution:  # fmt: skip
    """w of H^-1/2 M H^-1/2 (w - e2) = law(e1 + H w, w), all gains and horizons H (nv,).

    w is the minimiser of a strictly convex function, so it exists and is unique. A Newton step that does not
    lower the residual is halved; if even a thousandth of it does not, or after ``most``, the best iterate
    is returned, at which the torque is still the law's, with the residual that it leaves.
    """
    n = len(e2)
    mass = np.empty((n, n))
    for i in range(n):
        for k in range(n):
            mass[i, k] = mass_matrix[i, k] / sqrt(horizon[i] * horizon[k])
    jacobian = np.empty((n, n))
    u, best = e2.copy(), e2.copy()
    w, x, slope = np.zeros(n), np.zeros(n), np.zeros(n)
    trial_w, trial_x, trial_slope = np.zeros(n), np.zeros(n), np.zeros(n)
    misfit, step = np.zeros(n), np.zeros(n)
    size, scale, fraction = inf, 0.0, 1.0
    evaluations = 0
    while evaluations < most:
        for i in range(n):
            ratio = 1 / mass[i, i]
            root = solve_scalar(
                u[i],
                e1[i] / horizon[i],
                ratio * P[i] * horizon[i] ** a,
                ratio * D[i],
                1 + ratio * D_L[i],
                a,
                b,
            )
            trial_w[i], trial_x[i], trial_slope[i] = root.w, root.x, root.slope
        evaluations += 1
        found = 0.0
        for i in range(n):
            total = mass[i, i] * (u[i] - e2[i])
            for k in range(n):
                if k != i:
                    total += mass[i, k] * (trial_w[k] - e2[k])
            misfit[i] = total
            found += total * total / mass[i, i]
        found = sqrt(found)
        if found < size:
            size = found
            for i in range(n):
                best[i], w[i], x[i], slope[i] = u[i], trial_w[i], trial_x[i], trial_slope[i]
            if scale == 0.0:
                for i in range(n):
                    scale += mass[i, i] * (abs(e2[i]) + abs(w[i])) ** 2
                scale = sqrt(scale) + TINY
            if size <= CONVERGED * scale:
                break
            for i in range(n):
                step[i] = misfit[i]
                for k in range(n):
                    jacobian[i, k] = mass[i, k] * (1.0 if i == k else slope[k])
            solve_linear(jacobian, step)
            fraction = 1.0
        elif scale == 0.0:  # the arguments are not finite: nor is what is made of them
            w[:] = nan
            x[:] = nan
            break
        else:
            fraction /= 2
            if not fraction > LEAST_FRACTION:
                break
        for i in range(n):
            u[i] = best[i] - fraction * step[i]
    torque = np.empty(n)
    for i in range(n):
        x[i] *= horizon[i]
        torque[i] = (
            -P[i] * copysign(abs(x[i]) ** a, x[i]) - D[i] * copysign(abs(w[i]) ** b, w[i]) - D_L[i] * w[i]
        )
    return Solution(x, w, torque, evaluations, size / scale if scale > 0.0 else 0.0)


@kernel(VECTOR, VECTOR, MATRIX, VECTOR, VECTOR, VECTOR, SCALAR, SCALAR, VECTOR, SCALAR)
def solved_torque(
    e1: np.ndarray, e2: np.ndarray, mass_matrix: np.ndarray, P: np.ndarray, D: np.ndarray, D_L: np.ndarray,
    a: float, b: float, horizon: np.ndarray, least: float,
) -> np.ndarray:  # fmt: skip
    """(nv,) the torque of `solve_coupled`, for horizons that are ``least`` or more."""
    longer = np.empty(len(horizon))
    for i in range(len(horizon)):
        longer[i] = max(horizon[i], least)
    return solve_coupled(e1, e2, mass_matrix, P, D, D_L, a, b, longer, np.int64(ITERATIONS)).torque
