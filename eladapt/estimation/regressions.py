"""Filtered regressions y = Omega theta that need no acceleration: force balance and power balance.

Both filters are exact in the pole: with rho = exp(-pole dt), the same weight (1 - rho)/dt stands
before the torque's impulse in y and before what it changed in Omega, so that y = Omega theta holds
whatever the weight is. lambda_0 = lambda_1 = pole. Both start at y = 0, Omega = 0, which is the
initial state z(0) = -lambda_0 phi_3(0) of (419) and z(0) = -lambda_0 omega(0) of (361).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.compiling import MATRIX, SCALAR, VECTOR, kernel
from eladapt.errors import ArgumentError, require_gain, require_number
from eladapt.regressors.regressors import Regressors
from eladapt.signals import Measurement, Regression

Interpolation = Literal["linear", "hermite"]

# Gauss's two points: exact for polynomials of the third degree.
GAUSS = np.array([0.5 - math.sqrt(3) / 6, 0.5 + math.sqrt(3) / 6])
NEVER = -1.0  # [rad/s] a speed that every joint is above
JITTER_RATE = 1.0  # [1/s] at which the noise measured in the velocity is forgotten
SURELY_MOVING = 5.0  # times that noise, but no more than
MOST = 3.0  # times the speed that is given: what breaks loose changes its speed like noise


class FilterState(NamedTuple):
    """Where the force balance stands: the last sample, and its outputs."""

    q: np.ndarray  # (nq,)
    v: np.ndarray  # (nv,)
    y: np.ndarray  # (nv,)
    omega: np.ndarray  # (nv, l)
    change: np.ndarray  # (nv,) of the velocity over the last step
    jitter: np.ndarray  # (nv,) mean square of the velocity's white noise


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, SCALAR)
def path_points(
    points: np.ndarray, moved: np.ndarray, before: np.ndarray, after: np.ndarray, dt: float
) -> np.ndarray:
    """(5, nv): two offsets and two velocities at points (2,) in [0, 1] of a path whose velocity is linear,
    and its acceleration."""
    path = np.empty((5, len(moved)))
    for i in range(len(moved)):
        change = after[i] - before[i]
        for k in range(2):
            path[k, i] = points[k] * moved[i] - (dt / 12) * change
            path[2 + k, i] = before[i] + points[k] * change
        path[4, i] = change / dt
    return path


@kernel(VECTOR, VECTOR, VECTOR, SCALAR)
def white_noise(mean: np.ndarray, before: np.ndarray, after: np.ndarray, share: float) -> np.ndarray:
    """(nv,) ``share`` of the way from ``mean`` to the squares of the white noise that two changes in
    succession show by their difference, whose variance is six times the noise's."""
    found = np.empty(len(mean))
    for i in range(len(mean)):
        found[i] = mean[i] + share * ((after[i] - before[i]) ** 2 / 6 - mean[i])
    return found


@kernel(MATRIX, VECTOR, SCALAR, SCALAR, VECTOR, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, SCALAR, VECTOR)
def filter_rows(
    omega: np.ndarray, y: np.ndarray, rho: float, gain: float, weight: np.ndarray, one: np.ndarray,
    two: np.ndarray, tau: np.ndarray, before: np.ndarray, after: np.ndarray, speed: float,
    jitter: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """The force balance (419) after a step: rho [Omega y] + gain weight [(one + two)/2, tau], and zero in the
    rows of joints that are not faster than ``speed`` [rad/s], and than their noise, both before and after it;
    in no row where ``speed`` is negative."""
    rows, outputs = np.zeros_like(omega), np.zeros_like(y)
    for i in range(len(y)):
        slow = max(speed, min(SURELY_MOVING * math.sqrt(jitter[i]), MOST * speed))
        if speed >= 0.0 and min(abs(before[i]), abs(after[i])) <= slow:
            continue
        outputs[i] = rho * y[i] + gain * weight[i] * tau[i]
        share, into, old, first, second = 0.5 * gain * weight[i], rows[i], omega[i], one[i], two[i]
        for k in range(len(into)):
            into[k] = rho * old[k] + share * (first[k] + second[k])
    return outputs, rows


@dataclass(frozen=True)
class ForceBalance:
    """y = filtered tau, one row a joint (399), (419).

    d/dt (M_k v) - 1/2 grad(v' M_k v) + grad U_k + friction = tau, integrated over each step along a path
    between its two samples, by Gauss's rule at two points. On a path whose acceleration is known the left
    side is W(q, v, a), so one torque regressor a point makes all of it; the path's acceleration is no
    measurement, its integral is the momentum's increment.

    interpolation: "linear" in velocity (default), so that noise is not amplified; at 1 kHz y = Omega theta
    is off by 2e-8 to 2e-6 of the largest y, what the change of acceleration within a step makes. "hermite"
    takes the velocity inside the step from the positions too, is off by 1e-10, and wants positions
    without noise, since it divides their difference by dt.

    In stiction Coulomb friction is not sign(v): with Coulomb columns, row i is zero and its filter starts
    afresh over every step at one of whose ends |v_i| is not above ``stiction_speed``. A filter that
    starts afresh is exact from its first step, so nothing of the stiction is remembered and no data of
    the sliding are lost. Each row holds for itself: a stuck joint costs the others nothing.

    pole [1/s]; weight: scalar or (nv,), multiplies each row of y and Omega. stiction_speed [rad/s]: five
    times the velocity noise or more; where there are no Coulomb columns it is not used.
    """

    regressors: Regressors
    pole: float = 20.0
    weight: float | np.ndarray = 1.0
    interpolation: Interpolation = "linear"
    stiction_speed: float = 0.01

    def __post_init__(self) -> None:
        object.__setattr__(self, "pole", require_number("pole", self.pole, 0))
        object.__setattr__(self, "weight", require_gain("weight", self.weight, self.regressors.robot.nv))
        speed = require_number("stiction_speed", self.stiction_speed, 0, np.finfo(float).max, closed=True)
        object.__setattr__(self, "stiction_speed", speed)
        if self.interpolation not in ("linear", "hermite"):
            raise ArgumentError(f"interpolation: expected 'linear' or 'hermite', got {self.interpolation!r}")

    def init(self, measurement: Measurement) -> FilterState:
        """The filter at rest at the first sample."""
        _, q, v, _ = measurement
        none = np.zeros(len(v))
        return FilterState(q, v, none, np.zeros((len(v), len(self.regressors))), none, none)

    def step(self, state: FilterState, measurement: Measurement, dt: float) -> tuple[FilterState, Regression]:
        """Advance over the dt [s] that ended at ``measurement``."""
        _, q, v, tau = measurement
        one, two = self.forces(state, q, v, dt)
        rho, gain = math.exp(-self.pole * dt), -math.expm1(-self.pole * dt)
        speed = self.stiction_speed if self.regressors.coulomb else NEVER
        change = v - state.v
        jitter = white_noise(state.jitter, state.change, change, min(1.0, JITTER_RATE * dt))
        y, omega = filter_rows(
            state.omega, state.y, rho, gain, self.weight, one, two, tau, state.v, v, speed, jitter
        )
        return FilterState(q, v, y, omega, change, jitter), Regression(y, omega)

    def forces(self, state: FilterState, q: np.ndarray, v: np.ndarray, dt: float) -> list[np.ndarray]:
        """W(q, v, a) (nv, l) at Gauss's two points of the path from ``state`` to (q, v)."""
        torque = self.regressors.torque
        return [torque(*point, check=False) for point in self.points(state.q, state.v, q, v, dt)]

    def points(self, q0: np.ndarray, v0: np.ndarray, q: np.ndarray, v: np.ndarray, dt: float) -> list[Any]:
        """(q, v, a) at Gauss's two points of the path from (q0, v0) to (q, v), dt [s] later."""
        model = self.regressors.robot.model
        moved = pin.difference(model, q0, q)
        if self.interpolation == "linear":
            way, further, one, two, slope = path_points(GAUSS, moved, v0, v, dt)
            return [
                (pin.integrate(model, q0, way), one, slope),
                (pin.integrate(model, q0, further), two, slope),
            ]
        ways, rates = self._bent_path(moved, v0, v, dt)
        return [(pin.integrate(model, q0, way), *rate) for way, rate in zip(ways, rates, strict=True)]

    def _bent_path(self, moved: np.ndarray, before: np.ndarray, after: np.ndarray, dt: float) -> Any:
        """Offsets from the first position, and (velocity, acceleration), at Gauss's points of a cubic
        path."""
        s, change = GAUSS[:, None], after - before
        bend = 6 * (moved / dt - 0.5 * (before + after))
        # The path's ends are the two positions, whatever the mean of its velocity is; s (1 - s) = 1/6.
        offset = s * moved - (dt / 12) * change + dt / 36 * (2 * s - 1) * bend
        velocity = before + s * change + bend / 6
        return offset, list(zip(velocity, change / dt + (1 - 2 * s) / dt * bend, strict=True))


class EnergyState(NamedTuple):
    """Where the power balance stands: the last sample, what was computed there, and its outputs."""

    q: np.ndarray  # (nq,)
    energy: np.ndarray  # (1, l) at the last sample
    dissipation: np.ndarray  # (1, l) power lost at the last sample
    y: np.ndarray  # (1,)
    omega: np.ndarray  # (1, l)


@dataclass(frozen=True)
class PowerBalance:
    """y = filtered v'tau, one equation for the whole robot (372), (361).

    Energy gained plus energy lost to friction equals the work of the held torque, tau'(q+ - q):
    exact without friction. In stiction nothing moves and nothing is lost, so Coulomb columns |v_i| need no
    gate. ``weight`` is a positive scalar. One equation excites few directions of a large arm: 32 of 43 on a
    Panda's regulation move.
    """

    regressors: Regressors
    pole: float = 20.0
    weight: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "pole", require_number("pole", self.pole, 0))
        object.__setattr__(self, "weight", require_number("weight", self.weight, 0))

    def init(self, measurement: Measurement) -> EnergyState:
        """The filter at rest at the first sample."""
        energy, dissipation = self._energy_and_dissipation(measurement)
        y = np.zeros(energy.shape[:-1])
        return EnergyState(measurement.q, energy, dissipation, y, np.zeros_like(energy))

    def step(self, state: EnergyState, measurement: Measurement, dt: float) -> tuple[EnergyState, Regression]:
        """Advance over the dt [s] that ended at ``measurement``."""
        rho, gain = _decay(self.pole, dt)
        energy, dissipation = self._energy_and_dissipation(measurement)
        gained = energy - state.energy + 0.5 * dt * (state.dissipation + dissipation)
        moved = self.regressors.robot.difference(state.q, measurement.q)
        work = measurement.tau @ moved
        omega = rho * state.omega + self.weight * gain * gained
        y = rho * state.y + self.weight * gain * work
        return EnergyState(measurement.q, energy, dissipation, y, omega), Regression(y, omega)

    def _energy_and_dissipation(self, measurement: Measurement) -> tuple[np.ndarray, np.ndarray]:
        reg, (_, q, v, _) = self.regressors, measurement
        energy = reg.energy(q, v)[None]
        dissipation = v[None] @ reg.joint_torque(v) if reg.n_friction else np.zeros_like(energy)
        return energy, dissipation


def _decay(pole: float, dt: float) -> tuple[float, float]:
    """rho = exp(-pole dt) and the weight (1 - rho)/dt."""
    return math.exp(-pole * dt), -math.expm1(-pole * dt) / dt
