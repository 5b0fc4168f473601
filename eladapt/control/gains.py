"""Gains from the URDF alone.

The scaling is the homogeneous one: D = 1.5 P^(3/4) M^(1/4) makes the damping ratio independent of
the amplitude for a = 1/3, b = 1/2. The constants were measured on panda, ur5, xarm7, finger_edu,
double_pendulum and random 5-joint arms, from theta_U = 0 in random postures.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from eladapt.errors import ArgumentError, require_number
from eladapt.robot.model import Robot

SAMPLES = 200  # configurations over which the extremes of M and g are taken


class Gains(NamedTuple):
    """What `CompositeController.for_robot` uses; arrays are (nv,)."""

    P: np.ndarray  # [N m/rad^(1/3)]
    D: np.ndarray  # [N m (s/rad)^(1/2)]
    D_L: np.ndarray  # [N m s/rad]
    pole: float  # [1/s]
    row_weight: np.ndarray  # [1/(N m)]
    alpha: float  # [1/s]
    beta: float  # [1/s]
    xi: float
    f0: float
    Gamma: float
    Upsilon: float


class SlidingGains(NamedTuple):
    """What the `for_robot` of the sliding-variable controllers uses; arrays are (nv,)."""

    K1: np.ndarray  # [N m s/rad]
    K2: np.ndarray  # [1/s]
    K_s: np.ndarray  # [N m]
    pole: float  # [1/s]
    row_weight: np.ndarray  # [1/(N m)]
    alpha: float  # [1/s]
    beta: float  # [1/s]
    xi: float
    f0: float


class Extremes(NamedTuple):
    """Largest values over sampled configurations, by joint."""

    gravity: np.ndarray  # (nv,) max |g_i| [N m]
    inertia: np.ndarray  # (nv,) max M_ii [kg m^2]


def extremes(robot: Robot, samples: int = SAMPLES, seed: int = 0) -> Extremes:
    """Sampled estimates, not bounds."""
    rng = np.random.default_rng(seed)
    configurations = [robot.random_configuration(rng) for _ in range(samples)]
    gravity = np.max([np.abs(robot.gravity(q)) for q in configurations], axis=0)
    inertia = np.max([np.diag(robot.mass_matrix(q)) for q in configurations], axis=0)
    return Extremes(gravity, inertia)


def effort(robot: Robot, largest: Extremes) -> np.ndarray:
    """(nv,) [N m] the URDF's effort limits; where it sets none, max(3 max|g_i|, 20 max M_ii)."""
    assumed = np.maximum(3 * largest.gravity, 20 * largest.inertia)
    return np.where(np.isfinite(robot.effort_limit), robot.effort_limit, assumed)


def derive_sliding_gains(robot: Robot, dt: float) -> SlidingGains:
    """Gains of the Slotine-Li and terminal-sliding controllers, for a torque held over dt [s].

    K1 damps the largest inertia at 10/s, and no joint faster than a tenth of the sampling rate.
    """
    dt = require_number("dt", dt, 0)
    largest = extremes(robot)
    limit = effort(robot, largest)
    K1 = np.minimum(10.0, 0.1 / dt) * largest.inertia + 0.1 * largest.gravity
    return SlidingGains(
        K1=K1, K2=np.full(robot.nv, 2.0), K_s=0.005 * limit, pole=20.0, row_weight=1 / limit,
        alpha=10.0, beta=5.0, xi=1e4, f0=0.1,
    )  # fmt: skip


def derive_gains(robot: Robot, dt: float) -> Gains:
    """Gains for a torque that is held over dt [s]."""
    dt = require_number("dt", dt, 0)
    if dt > 0.02:
        raise ArgumentError(f"dt: expected at most 0.02 s for derived gains, got {dt:g} s")
    largest = extremes(robot)
    gravity, inertia = largest
    limit = effort(robot, largest)
    spare = np.maximum(limit - gravity, 0.3 * limit)
    P = np.minimum(spare, 4 * gravity + 60 * inertia)
    D = 1.5 * P**0.75 * inertia**0.25
    Gamma = 0.2
    # |theta_U| is about max g in scaled columns: its fractional term arrives within about 0.3 s.
    rate = np.sqrt(3 * max(gravity.max(), 1e-3)) / 0.045
    return Gains(
        P=P, D=D, D_L=0.1 * D, pole=20.0, row_weight=1 / limit,
        alpha=1.0, beta=5.0, xi=1e8, f0=1e-3, Gamma=Gamma, Upsilon=rate / Gamma,
    )  # fmt: skip
