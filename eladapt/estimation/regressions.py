"""Filtered regressions y = Omega theta that need no acceleration: force balance and power balance.

Both filters are exact in the pole: with rho = exp(-pole dt), the same weight (1 - rho)/dt stands
before the torque's impulse in y and before what it changed in Omega, so that y = Omega theta holds
whatever the weight is. lambda_0 = lambda_1 = pole. Both start at y = 0, Omega = 0, which is the
initial state z(0) = -lambda_0 phi_3(0) of (419) and z(0) = -lambda_0 omega(0) of (361).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from eladapt.errors import ArgumentError, require_gain, require_number
from eladapt.robot.regressors import Regressors
from eladapt.signals import Measurement, Regression

Quadrature = Literal["trapezoid", "simpson", "hermite"]


class FilterState(NamedTuple):
    """Where a filter stands: the last sample, what was computed there, and its outputs."""

    q: np.ndarray  # (nq,)
    v: np.ndarray  # (nv,)
    stored: np.ndarray  # (nv, l) momentum, or (1, l) energy, at the last sample
    rate: np.ndarray  # (nv, l) or (1, l): what is integrated over the step, at the last sample
    y: np.ndarray  # (m,)
    omega: np.ndarray  # (m, l)


@dataclass(frozen=True)
class ForceBalance:
    """y = filtered tau, one row a joint (399), (419).

    d/dt (M_k v) - 1/2 grad(v' M_k v) + grad U_k + friction = tau; the momentum's increment is exact,
    the gradients are integrated over each step. At 1 kHz y = Omega theta is off by up to 3e-5 of the
    largest y with the trapezoid, by 1e-6 with Simpson's rule and the mean velocity in the middle
    (default: noise is not amplified), by 1e-9 with the Hermite interpolant's velocity, which divides
    a position difference by dt and wants positions without noise.

    In stiction Coulomb friction is not sign(v): with Coulomb columns, row i is zero and its filter starts
    afresh over every step in which |v_i| falls below ``stiction_speed`` or v_i changes sign. A filter that
    starts afresh is exact from its first step, so nothing of the stiction is remembered and no data of
    the sliding are lost. Each row holds for itself: a stuck joint costs the others nothing.

    pole [1/s]; weight: scalar or (nv,), multiplies each row of y and Omega. stiction_speed [rad/s]: five
    times the velocity noise or more; where there are no Coulomb columns it is not used.
    """

    regressors: Regressors
    pole: float = 20.0
    weight: float | np.ndarray = 1.0
    quadrature: Quadrature = "simpson"
    stiction_speed: float = 0.01

    def __post_init__(self) -> None:
        object.__setattr__(self, "pole", require_number("pole", self.pole, 0))
        object.__setattr__(self, "weight", require_gain("weight", self.weight, self.regressors.robot.nv))
        speed = require_number("stiction_speed", self.stiction_speed, 0, np.finfo(float).max, closed=True)
        object.__setattr__(self, "stiction_speed", speed)
        if self.quadrature not in ("trapezoid", "simpson", "hermite"):
            raise ArgumentError(
                f"quadrature: expected 'trapezoid', 'simpson' or 'hermite', got {self.quadrature!r}"
            )

    def init(self, measurement: Measurement) -> FilterState:
        """The filter at rest at the first sample."""
        q, v = measurement.q, measurement.v
        momentum = self.regressors.momentum(q, v)
        zero = np.zeros_like(momentum)
        return FilterState(q, v, momentum, self._force(q, v), np.zeros(len(zero)), zero)

    def step(self, state: FilterState, measurement: Measurement, dt: float) -> tuple[FilterState, Regression]:
        """Advance over the dt [s] that ended at ``measurement``."""
        rho, gain = _decay(self.pole, dt)
        q, v = measurement.q, measurement.v
        momentum, force = self.regressors.momentum(q, v), self._force(q, v)
        impulse = momentum - state.stored + dt * self._mean_force(state, force, q, v, dt)
        weight = gain * np.asarray(self.weight)
        omega = rho * state.omega + weight[:, None] * impulse
        y = rho * state.y + weight * dt * measurement.tau
        if self.regressors.coulomb:
            sliding = self._sliding(state.v, v)
            y, omega = np.where(sliding, y, 0.0), np.where(sliding[:, None], omega, 0.0)
        return FilterState(q, v, momentum, force, y, omega), Regression(y, omega)

    def _mean_force(
        self, state: FilterState, force: np.ndarray, q: np.ndarray, v: np.ndarray, dt: float
    ) -> np.ndarray:
        if self.quadrature == "trapezoid":
            return 0.5 * (state.rate + force)
        robot = self.regressors.robot
        moved = robot.difference(state.q, q)
        middle = robot.integrate(state.q, 0.5 * moved + dt / 8 * (state.v - v))
        mean = 0.5 * (state.v + v)
        velocity = mean if self.quadrature == "simpson" else 1.5 * moved / dt - 0.5 * mean
        return (state.rate + 4 * self._force(middle, velocity) + force) / 6

    def _sliding(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """(nv,) which joints slid one way all along a step."""
        slowest = np.where(before > 0, np.minimum(before, after), -np.maximum(before, after))
        return slowest > self.stiction_speed

    def _force(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """What the torque does besides changing the momentum (nv, l)."""
        reg = self.regressors
        force = reg.potential_gradient(q) - reg.kinetic_gradient(q, v)
        return force + reg.friction_torque(v) if reg.n_friction else force


@dataclass(frozen=True)
class PowerBalance:
    """y = filtered v'tau, one equation for the whole robot (372), (361).

    Energy gained plus energy lost to friction equals the work of the held torque, tau'(q+ - q):
    exact without friction. In stiction nothing moves and nothing is lost, so Coulomb columns |v_i| need no
    gate. ``weight`` is a positive scalar. One equation excites few directions
    of a large arm: 32 of 43 on a Panda's regulation move.
    """

    regressors: Regressors
    pole: float = 20.0
    weight: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "pole", require_number("pole", self.pole, 0))
        object.__setattr__(self, "weight", require_number("weight", self.weight, 0))

    def init(self, measurement: Measurement) -> FilterState:
        """The filter at rest at the first sample."""
        energy, dissipation = self._energy_and_dissipation(measurement)
        return FilterState(*measurement[1:3], energy, dissipation, np.zeros(1), np.zeros_like(energy))

    def step(self, state: FilterState, measurement: Measurement, dt: float) -> tuple[FilterState, Regression]:
        """Advance over the dt [s] that ended at ``measurement``."""
        rho, gain = _decay(self.pole, dt)
        energy, dissipation = self._energy_and_dissipation(measurement)
        gained = energy - state.stored + 0.5 * dt * (state.rate + dissipation)
        moved = self.regressors.robot.difference(state.q, measurement.q)
        work = measurement.tau @ moved
        omega = rho * state.omega + self.weight * gain * gained
        y = rho * state.y + self.weight * gain * work
        return FilterState(*measurement[1:3], energy, dissipation, y, omega), Regression(y, omega)

    def _energy_and_dissipation(self, measurement: Measurement) -> tuple[np.ndarray, np.ndarray]:
        reg, (_, q, v, _) = self.regressors, measurement
        energy = reg.energy(q, v)[None]
        dissipation = v[None] @ reg.friction_torque(v) if reg.n_friction else np.zeros_like(energy)
        return energy, dissipation


def _decay(pole: float, dt: float) -> tuple[float, float]:
    """rho = exp(-pole dt) and the weight (1 - rho)/dt."""
    return float(np.exp(-pole * dt)), float(-np.expm1(-pole * dt) / dt)
