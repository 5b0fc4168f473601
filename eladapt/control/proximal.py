"""The scalar problem inside the semi-implicit control law.

K w + A |x|^a sign(x) + B |w|^b sign(w) = u with x = w + s is strictly increasing in w, with infinite
slope at the two kinks w = 0 and x = 0. The kink nearest the root is found from signs, and Newton's
method runs in the power of the distance to it, in which the function is smooth; bisection guards
it. w and x are both measured from the kink, so that neither is a difference of large numbers.
"""

from __future__ import annotations

from math import copysign, inf
from typing import NamedTuple

import numpy as np

ITERATIONS = 80  # bisection alone needs no more for double precision; 3 to 8 are typical
EPS = 8 * float(np.finfo(float).eps)
QUADRATIC = 1e-9  # a Newton step this small leaves an error of its square


class Root(NamedTuple):
    """The solution, with x = w + s to full relative precision."""

    w: float
    x: float
    slope: float  # dw/du in [0, 1/K], 0 at a kink


def signed_power(x: np.ndarray, exponent: float) -> np.ndarray:
    """|x|^exponent sign(x), element by element."""
    return np.sign(x) * np.abs(x) ** exponent


def solve_scalar(u: float, s: float, spring: float, damper: float, linear: float, a: float, b: float) -> Root:
    """The root for spring A > 0, damper B > 0, linear K > 0 and exponents 0 < a <= b <= 1."""

    def excess(w: float, x: float) -> float:
        return linear * w + copysign(spring * abs(x) ** a, x) + copysign(damper * abs(w) ** b, w) - u

    if s == 0:
        at_spring, reach = a < b, inf
    else:
        above_middle = excess(-0.5 * s, 0.5 * s) < 0
        at_spring, reach = above_middle != (s > 0), 0.5 * abs(s)
    at_kink = (-s, 0.0) if at_spring else (0.0, s)
    deficit = -excess(*at_kink)
    if deficit == 0:
        return Root(*at_kink, 0.0)
    side = copysign(1.0, deficit)
    towards_other = side == copysign(1.0, s if at_spring else -s)
    power, strength = (a, spring) if at_spring else (b, damper)
    inverse = 1 / power

    def position(r: float) -> tuple[float, float]:
        offset = side * r**inverse
        return (offset - s, offset) if at_spring else (offset, offset + s)

    def slope(w: float, x: float) -> float:
        """Of all terms but the one whose kink is in use."""
        if at_spring:
            return linear + (b * damper * abs(w) ** (b - 1) if w else inf)
        return linear + (a * spring * abs(x) ** (a - 1) if x else inf)

    # side * excess = 0 in r = distance^power >= 0, increasing from -|deficit|.
    left, right = 0.0, min(abs(deficit) / strength, (abs(deficit) / linear) ** power)
    if towards_other:
        right = min(right, reach**power)
    r = right
    for _ in range(ITERATIONS):
        w, x = position(r)
        value = side * excess(w, x)
        if value == 0:
            break
        if value > 0:
            right = r
        else:
            left = r
        newton = r - value / (slope(w, x) * inverse * r ** (inverse - 1) + strength)
        trusted = left < newton < right
        following = newton if trusted else 0.5 * (left + right)
        change, r = abs(following - r), following
        if change <= (QUADRATIC if trusted else EPS) * r:
            break
    w, x = position(r)
    own = power * strength * r ** (1 - inverse) if r else inf
    return Root(w, x, 1 / (slope(w, x) + own))
