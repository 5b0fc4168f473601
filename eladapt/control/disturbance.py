"""What holds or pushes a joint and is in no model: stiction, contact, what is not learned yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eladapt.errors import ArgumentError, require_gain, require_number

CREEPING = 0.3  # [rad/s]


@dataclass(frozen=True, eq=False)
class DisturbanceEstimate:
    """d = low-pass of the torque that acted less what the model with the present theta explains of the
    motion.

    It is fed forward. The model's friction stands at the reference's velocity, as it is fed forward itself;
    so d is what the feed-forward lacks, and where the arm follows its reference and theta is right, d = 0. In
    a joint that sticks nothing moves, and d integrates the control law's torque until it breaks loose; a
    joint that rests within ``tolerance`` of its goal holds its d, or it would hunt about it.

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
        self, d: np.ndarray, residual: np.ndarray, friction: np.ndarray, e1: np.ndarray, v: np.ndarray,
        still: np.ndarray, dt: float,
    ) -> np.ndarray:  # fmt: skip
        """d (nv,) [N m] after a step of dt [s].

        residual (nv,) [N m]: torque less model over the step; friction (nv,) [N m]: how much more there is
        at v than is fed forward, as far as it is known; e1 (nv,) [rad]; v (nv,) [rad/s]; still (nv,): which
        joints are to stand still.
        """
        arrived = still & (np.abs(v) < self.slow) & (np.abs(e1) < self.tolerance)
        d = np.where(arrived, d, d - np.expm1(-dt / self.memory) * (residual - d))
        limit = np.where(np.abs(v) < CREEPING, self.limit, np.minimum(self.limit, self.moving))
        return np.minimum(np.maximum(d, np.minimum(friction, 0.0) - limit), np.maximum(friction, 0.0) + limit)
