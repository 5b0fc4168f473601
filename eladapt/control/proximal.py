"""The convex problem of the semi-implicit control law: M (w - v) = H law(e + H w, w).

The scalar problem K w + A |x|^a sign(x) + B |w|^b sign(w) = u with x = w + s is strictly increasing in w,
with infinite slope at the two kinks w = 0 and x = 0. The kink nearest the root is found from signs, and
Newton's method runs in the power of the distance to it, in which the function is smooth; bisection
guards it. w and x are both measured from the kink, so that neither is a difference of large numbers.

The coupled problem runs Newton's method in u, with w = prox(u) the solution of the scalar problems: it is
linear when the joints do not couple, and smooth where the law is not.
"""

from __future__ import annotations

from math import copysign, inf, sqrt
from typing import NamedTuple

import numpy as np

from eladapt.compiling import jitable

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


@jitable
def power(x: float, exponent: float) -> float:
    """x^exponent for x >= 0, without the logarithm where there is a shorter way."""
    if exponent == 0.5:
        return sqrt(x)
    if exponent == 2.0:
        return x * x
    if exponent == 3.0:
        return x * x * x
    return x**exponent


@jitable
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


@jitable
def solve_coupled(
    e1: np.ndarray, e2: np.ndarray, mass_matrix: np.ndarray, P: np.ndarray, D: np.ndarray, D_L: np.ndarray,
    a: float, b: float, horizon: float,
) -> Solution:  # fmt: skip
    """w of M (w - e2) = H law(e1 + H w, w), all gains (nv,).

    w is the minimiser of a strictly convex function, so it exists and is unique. A Newton step that does not
    lower the residual is halved; if even a thousandth of it does not, or after ITERATIONS, the best iterate
    is returned, at which the torque is still the law's, with the residual that it leaves.
    """
    n = len(e2)
    diagonal = np.diag(mass_matrix).copy()
    coupling = mass_matrix - np.diag(diagonal)
    root_mass = np.sqrt(diagonal)
    ratio = horizon / diagonal
    offset, spring = e1 / horizon, ratio * P * horizon**a
    damper, linear = ratio * D, 1 + ratio * D_L
    u, best = e2.copy(), e2.copy()
    w, x, slope = np.zeros(n), np.zeros(n), np.zeros(n)
    trial = np.zeros((3, n))
    residual = step = np.zeros(n)
    size, scale, fraction = inf, 0.0, 1.0
    evaluations = 0
    while evaluations < ITERATIONS:
        for i in range(n):
            root = solve_scalar(
                float(u[i]), float(offset[i]), float(spring[i]), float(damper[i]), float(linear[i]), a, b
            )
            trial[0, i], trial[1, i], trial[2, i] = root.w, root.x, root.slope
        evaluations += 1
        misfit = diagonal * (u - e2) + coupling @ (trial[0] - e2)
        found = sqrt(np.sum((misfit / root_mass) ** 2))
        if found < size:
            best, size, residual = u, found, misfit
            w, x, slope = trial[0].copy(), trial[1].copy(), trial[2].copy()
            if scale == 0.0:
                scale = sqrt(np.sum((root_mass * (np.abs(e2) + np.abs(w))) ** 2)) + TINY
            if size <= CONVERGED * scale:
                break
            step, fraction = np.linalg.solve(coupling * slope + np.diag(diagonal), residual), 1.0
        else:
            fraction /= 2
            if not fraction > LEAST_FRACTION:
                break
        u = best - fraction * step
    end = horizon * x
    torque = -P * np.sign(x) * np.abs(end) ** a - D * np.sign(w) * np.abs(w) ** b - D_L * w
    return Solution(end, w, torque, evaluations, size / scale if scale > 0.0 else 0.0)


def command(
    e1: np.ndarray, v: np.ndarray, mass_matrix: np.ndarray, disturbance: np.ndarray, psi: np.ndarray,
    theta: np.ndarray, P: np.ndarray, D: np.ndarray, D_L: np.ndarray, a: float, b: float, horizon: float,
    effort_limit: np.ndarray,
) -> tuple[np.ndarray, bool]:  # fmt: skip
    """The torque (nv,) [N m] of feedback and known gravity, clipped, and whether it is finite.

    disturbance d (nv,) [N m]: the prediction starts from v + H M^-1 d, see `eladapt.control.disturbance`.
    psi (nv, n_potential), theta (n_potential,): known gravity; the rest as in `solve_coupled`.
    """
    if not np.isfinite(disturbance).all():  # a solver would raise
        return np.zeros_like(v), False
    pushed = v + horizon * np.linalg.solve(mass_matrix, disturbance)
    if not np.isfinite(pushed).all():  # the search would find nothing better than no torque
        return np.zeros_like(v), False
    wanted = solve_coupled(e1, pushed, mass_matrix, P, D, D_L, a, b, horizon).torque + psi @ theta
    finite = bool(np.isfinite(wanted).all())
    return np.minimum(np.maximum(wanted, -effort_limit), effort_limit), finite
