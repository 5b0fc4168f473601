"""The classical Runge-Kutta step of a held torque, but for the accelerations, which are Pinocchio's."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from eladapt.compiling import SCALAR, VECTOR, VIEW, kernel


class Stages(NamedTuple):
    """What the stages of a step are written to, (nv,) each."""

    way: np.ndarray  # from where the step began
    net: np.ndarray  # [N m] torque that viscous friction leaves
    slopes: tuple[np.ndarray, ...]  # the velocities of the four stages

    @classmethod
    def of(cls, nv: int) -> Stages:
        """For so many joints."""
        return cls(np.zeros(nv), np.zeros(nv), tuple(np.zeros(nv) for _ in range(4)))


@kernel(VIEW, VIEW, VIEW, SCALAR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
def stage(
    v: np.ndarray, slope: np.ndarray, acceleration: np.ndarray, h: float, held: np.ndarray,
    viscous: np.ndarray, way: np.ndarray, velocity: np.ndarray, net: np.ndarray,
) -> None:  # fmt: skip
    """Write the way, the velocity and the torque that viscous friction leaves of the one held, h [s] along
    the slope of q and the acceleration."""
    for i in range(len(v)):
        way[i] = h * slope[i]
        velocity[i] = v[i] + h * acceleration[i]
        net[i] = held[i] - viscous[i] * velocity[i]


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, VIEW, VIEW, VIEW, VIEW, SCALAR, VECTOR)
def combined(
    v1: np.ndarray, v2: np.ndarray, v3: np.ndarray, v4: np.ndarray, a1: np.ndarray, a2: np.ndarray,
    a3: np.ndarray, a4: np.ndarray, h: float, way: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """The velocity (nv,) h [s] later by the slopes of the four stages; the way there is written."""
    velocity = np.empty(len(v1))
    for i in range(len(v1)):
        way[i] = h / 6 * (v1[i] + 2 * v2[i] + 2 * v3[i] + v4[i])
        velocity[i] = v1[i] + h / 6 * (a1[i] + 2 * a2[i] + 2 * a3[i] + a4[i])
    return velocity


@kernel(VIEW, VIEW)
def finite(q: np.ndarray, v: np.ndarray) -> bool:
    """Whether all numbers are."""
    good = True
    for i in range(len(q)):
        good = good and math.isfinite(q[i])
    for i in range(len(v)):
        good = good and math.isfinite(v[i])
    return good
