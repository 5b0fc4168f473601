"""Whether joints are within their limits, and torque within its own."""

from __future__ import annotations

import numpy as np

from eladapt.compiling import SCALAR, VECTOR, kernel

FULL = 0.99  # of the effort limit


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, SCALAR)
def near(
    tau: np.ndarray, last: np.ndarray, rate: np.ndarray, effort: np.ndarray, dt: float
) -> np.ndarray:  # fmt: skip
    """tau (nv,), no further from the last torque than the rate allows in dt [s], within the effort."""
    found = np.empty(len(tau))
    for i in range(len(tau)):
        step = rate[i] * dt
        found[i] = min(max(min(max(tau[i], last[i] - step), last[i] + step), -effort[i]), effort[i])
    return found


@kernel(VECTOR, VECTOR, VECTOR)
def at_limit(tau: np.ndarray, sent: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """(nv,) 1 or -1 for joints whose torque, that acted or that was sent, is all that there is, by where it
    turns them; 0 for others."""
    full = np.zeros(len(tau))
    for i in range(len(tau)):
        larger = tau[i] if abs(tau[i]) >= abs(sent[i]) else sent[i]
        if abs(larger) >= FULL * effort[i]:
            full[i] = 1.0 if larger > 0.0 else -1.0
    return full


@kernel(VECTOR, VECTOR)
def too_fast(v: np.ndarray, velocity: np.ndarray) -> int:
    """The joint that is most beyond its speed limit, -1 where none is."""
    worst, farthest = -1, 0.0
    for i in range(len(v)):
        if abs(v[i]) - velocity[i] > farthest:
            worst, farthest = i, abs(v[i]) - velocity[i]
    return worst


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, SCALAR)
def leaving(x: np.ndarray, v: np.ndarray, lower: np.ndarray, upper: np.ndarray, lookahead: float) -> int:
    """The joint that ``lookahead`` [s] on will be furthest out of the range that it moves to, -1 where none
    will."""
    worst, farthest = -1, 0.0
    for i in range(len(x)):
        ahead = x[i] + lookahead * v[i]
        beyond = ahead - upper[i] if v[i] > 0.0 else lower[i] - ahead if v[i] < 0.0 else 0.0
        if beyond > farthest:
            worst, farthest = i, beyond
    return worst
