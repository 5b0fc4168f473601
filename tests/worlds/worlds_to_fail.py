"""Controllers that tests stress, at the top of a module so that other processes find them."""

from __future__ import annotations

import os
import time

import numpy as np

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD
from eladapt.control.finite_time import FiniteTimePD
from eladapt.gains.sensing import Hardware


class Raising(KnownGravityPD):
    """Raises in the first step of some worlds, and pushes in others till the arm has diverged."""

    def step(self, state, measurement, goal, dt):
        state, tau = super().step(state, measurement, goal, dt)
        if measurement.t == 0 and measurement.q[0] > 1:
            raise RuntimeError("the first joint is at more than 1 rad")
        return state, tau if measurement.q[0] > -1 else 1e120 * np.ones_like(tau)


def pd(robot: ea.Robot, told: Hardware, dt: float) -> KnownGravityPD:
    """The URDF's gravity and a PD law."""
    return KnownGravityPD(robot, FiniteTimePD(30.0, 10.0, 10.0, horizon=0.01 + 3 * told.delay))


def raising(robot: ea.Robot, told: Hardware, dt: float) -> KnownGravityPD:
    return Raising(robot, pd(robot, told, dt).control)


def deadly(robot: ea.Robot, told: Hardware, dt: float) -> KnownGravityPD:
    """Ends its process in some worlds."""
    if told.delay > 1.5e-3:
        os._exit(1)
    return pd(robot, told, dt)


def slow(robot: ea.Robot, told: Hardware, dt: float) -> KnownGravityPD:
    """Takes long enough to be killed meanwhile."""
    time.sleep(0.2)
    return pd(robot, told, dt)
