"""What a controller makes of a sample, and of the time between two."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from eladapt.compiling import SCALAR, VECTOR, kernel
from eladapt.errors import ArgumentError, require_number
from eladapt.signals import Measurement

LONGEST_STEP = 10.0  # times the nominal one
CLOCK_ROUNDING = 1e-6  # of a step: time stamps that agree with dt to this part are dt


class Sample(NamedTuple):
    """A measurement, and what follows from it and the reference."""

    measurement: Measurement
    regressor: np.ndarray  # (nv, l) W_r(q, v, v_d, a_d)
    e1: np.ndarray  # (nv,) q - q_d [rad or m]
    e2: np.ndarray  # (nv,) v - v_d
    moving: np.ndarray | None  # (nv, nv) M(q) where the reference moves


@kernel(VECTOR, VECTOR, VECTOR, SCALAR, SCALAR)
def resting(e1: np.ndarray, e2: np.ndarray, v: np.ndarray, near: float, slow: float) -> tuple[bool, bool]:
    """Whether an arm is ``near`` [rad] to a goal at rest, and whether it is slower than ``slow`` [rad/s]."""
    arrived, still = True, True
    for i in range(len(v)):
        arrived = arrived and e2[i] == v[i] and abs(e1[i]) < near
        still = still and abs(v[i]) < slow
    return arrived, still


@kernel(VECTOR, VECTOR, VECTOR, SCALAR)
def free(tau: np.ndarray, v: np.ndarray, limit: np.ndarray, slow: float) -> np.ndarray:
    """(nv,) which joints' torque is below its limit, and which are not slower than ``slow`` [rad/s]."""
    found = np.empty(len(tau), dtype=np.bool_)
    for i in range(len(tau)):
        found[i] = abs(tau[i]) < limit[i] and abs(v[i]) >= slow
    return found


@kernel(VECTOR, VECTOR)
def clipped(tau: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """tau (nv,) within the limits."""
    found = np.empty(len(tau))
    for i in range(len(tau)):
        found[i] = min(max(tau[i], -limit[i]), limit[i])
    return found


def checked_step(dt: float, nominal: float | None) -> float:
    """dt [s], positive and at most LONGEST_STEP times the nominal one. Raises ArgumentError."""
    dt = require_number("dt", dt, 0)
    if nominal is not None and dt > LONGEST_STEP * nominal:
        raise ArgumentError(
            f"dt: expected at most {LONGEST_STEP:g} times the {nominal:g} s that the gains were "
            f"made for, got {dt:g} s; make the controller for the step that it gets"
        )
    return dt


def elapsed(before: float, now: float, dt: float) -> tuple[float, bool]:
    """The time [s] over which to advance, and whether samples are missing in between."""
    passed = now - before
    if passed < 0:
        raise ArgumentError(f"measurement.t: expected {before} s or later, got {now} s")
    if abs(passed - dt) <= CLOCK_ROUNDING * dt + 4 * math.ulp(now):
        return dt, False
    return (passed, False) if abs(passed - dt) <= 0.5 * dt else (dt, True)
