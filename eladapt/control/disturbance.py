"""What holds or pushes a joint and is in no model: stiction, contact, what is not learned yet."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from math import copysign, expm1

import numpy as np

from eladapt.compiling import COUNT, MATRIX, SCALAR, VECTOR, kernel
from eladapt.errors import ArgumentError, require_gain, require_number

CREEPING = 0.3  # [rad/s]
HELD_FAR = 5e-4  # [rad or m] from its goal: a joint that sticks there is pushed harder and harder,
HARDER = 30.0  # [1/s] at this rate: from a thousandth of what frees it to all of it in a quarter of a second


@kernel(VECTOR, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, SCALAR, COUNT, COUNT, COUNT)
def unexplained(
    tau: np.ndarray, moved: np.ndarray, wanted: np.ndarray, theta: np.ndarray, e1: np.ndarray, e2: np.ndarray,
    v: np.ndarray, slow: float, first: int, offset: int, end: int,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """(nv,) [N m] the torque that acted less what theta explains of the motion, and (nv, l) the rows of the
    friction that there is beside what is fed forward.

    moved: W(q, v, a); wanted: W_r(q, v, v_d, a_d), fed forward; their columns first to end are friction, from
    ``offset`` on offsets. Friction is explained as it is fed forward, so that the residual overcomes the rest
    of it. But in a joint that leaves its reference, faster than ``slow`` [rad/s] so that it cannot stick, the
    rest helps as long as it resists, and is explained as it is.
    """
    n, size = moved.shape
    residual, rows = np.empty(n), np.zeros((n, size))
    for i in range(n):
        left, rest = tau[i], 0.0
        for k in range(size):
            if first <= k < end:
                more = moved[i, k] - wanted[i, k]
                # A joint that has moved one way tells the sum of friction and offset alone.
                rows[i, k] = moved[i, k] if k >= offset else more
                left -= wanted[i, k] * theta[k]
                rest += more * theta[k]
            else:
                left -= moved[i, k] * theta[k]
        leaves = abs(v[i]) > slow and e1[i] * e2[i] > 0.0
        residual[i] = left - rest if leaves and rest * e2[i] > 0.0 else left
    return residual, rows


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, SCALAR, SCALAR, SCALAR)
def followed(
    d: np.ndarray, residual: np.ndarray, e1: np.ndarray, e2: np.ndarray, v: np.ndarray, limit: np.ndarray,
    moving: np.ndarray, memory: np.ndarray, tolerance: float, slow: float, dt: float,
) -> tuple[np.ndarray, bool]:  # fmt: skip
    """d after dt, and whether any of it is beyond its limits, see `DisturbanceEstimate.step`."""
    after, beyond = d.copy(), False
    for i in range(len(d)):
        if not (e2[i] == v[i] and abs(v[i]) < slow and abs(e1[i]) < tolerance):
            after[i] -= expm1(-dt / memory[i]) * (residual[i] - d[i])
            if abs(v[i]) < slow and abs(e1[i]) > HELD_FAR:
                after[i] -= copysign(HARDER * dt * d[i], e1[i])
        beyond = beyond or abs(after[i]) > (limit[i] if abs(v[i]) < CREEPING else moving[i])
    return after, beyond


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
def bounded(
    d: np.ndarray, friction: np.ndarray, v: np.ndarray, limit: np.ndarray, moving: np.ndarray
) -> np.ndarray:
    """d within its limits beyond what overcomes friction."""
    after = np.empty(len(d))
    for i in range(len(d)):
        most = limit[i] if abs(v[i]) < CREEPING else moving[i]
        after[i] = min(max(d[i], min(friction[i], 0.0) - most), max(friction[i], 0.0) + most)
    return after


@dataclass(frozen=True, eq=False)
class DisturbanceEstimate:
    """d = low-pass of the torque that acted less what the model with the present theta explains of the
    motion.

    It is fed forward. The model's friction stands at the reference's velocity, as it is fed forward itself,
    but in a joint that leaves its reference, see `unexplained`; so d is what the feed-forward lacks, and
    where the arm follows its reference and theta is right, d = 0. In a joint that sticks nothing moves, and d
    integrates the control law's torque until it breaks loose, far from its goal with a growing part of
    itself: that torque suits the inertia that is known, and may be a hundredth of the friction. A joint that
    rests within ``tolerance`` of its goal holds its d, or it would hunt about it.

    limit (nv,) [N m]: largest d, beyond what overcomes the friction that is known, of a joint that creeps or
    rests; moving (nv,) [N m]: of a faster one, which it could throw. memory (nv,) [s] of the low-pass:
    velocity noise s costs about M s / memory [N m]. tolerance [rad], slow [rad/s]: within which a joint has
    arrived.
    """

    limit: np.ndarray | float
    moving: np.ndarray | float = np.inf
    memory: np.ndarray | float = 0.01
    tolerance: float = 5e-6
    slow: float = 1e-5

    def __post_init__(self) -> None:
        for name in ("limit", "memory"):
            object.__setattr__(self, name, require_gain(name, getattr(self, name)))
        if np.any(np.isnan(self.moving)) or np.any(np.asarray(self.moving) <= 0):
            raise ArgumentError(f"moving: expected positive values [N m], got {self.moving!r}")
        for name in ("tolerance", "slow"):
            value = require_number(name, getattr(self, name), 0, np.finfo(float).max, closed=True)
            object.__setattr__(self, name, value)

    def init(self, nv: int) -> np.ndarray:
        """d = 0 (nv,): nothing is known to push."""
        return np.zeros(nv)

    def step(
        self, d: np.ndarray, residual: np.ndarray, friction: Callable[[], np.ndarray], e1: np.ndarray,
        e2: np.ndarray, v: np.ndarray, dt: float,
    ) -> np.ndarray:  # fmt: skip
        """d (nv,) [N m] after a step of dt [s].

        residual (nv,) [N m]: torque less model over the step; friction: makes (nv,) [N m], how much more
        there is at v than is fed forward, as far as it is known, and is asked only where d would be beyond
        its limits without; e1 (nv,) [rad], e2, v (nv,) [rad/s]: joints with e2 = v are to stand still.
        """
        limit, moving, memory = self._by_joint(len(d))
        after, beyond = followed(d, residual, e1, e2, v, limit, moving, memory, self.tolerance, self.slow, dt)
        return bounded(after, friction(), v, limit, moving) if beyond else after

    def _by_joint(self, nv: int) -> tuple[np.ndarray, ...]:
        """limit, moving and memory, (nv,) each."""
        if nv not in self._sized:
            given = (self.limit, np.minimum(self.limit, self.moving), self.memory)
            self._sized[nv] = tuple(np.array(np.broadcast_to(value, nv), dtype=float) for value in given)
        return self._sized[nv]

    @functools.cached_property
    def _sized(self) -> dict[int, tuple[np.ndarray, ...]]:
        return {}
