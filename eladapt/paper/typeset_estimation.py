"""The paper's estimation equations as typeset, by explicit Euler.

These are for reproducing the paper, step for step; `regressions`, `extensions` and `mixing` hold the
same mathematics with numerics that survive large arms. Every block advances from the last sample
with the derivatives at the last sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.estimation.excitation import zeta_1
from eladapt.regressors.regressors import Regressors
from eladapt.signals import Measurement, MixedRegression, Regression


class EulerFilterState(NamedTuple):
    """z, Omega_D2 and y of (399), (419), and their inputs at the last sample."""

    z: np.ndarray  # (nv, l)
    potential: np.ndarray  # (nv, l) Omega_D2
    y: np.ndarray  # (nv,)
    omega: np.ndarray  # (nv, l)
    phi1: np.ndarray  # (nv, l)
    phi2: np.ndarray  # (nv, l)


@dataclass(frozen=True)
class EulerForceBalance:
    """(399), (419) with lambda_0 = lambda_1 = pole [1/s], z(0) = -lambda_0 phi_3(0)."""

    regressors: Regressors
    pole: float

    def init(self, measurement: Measurement) -> EulerFilterState:
        """y(0) = 0, Omega(0) = 0."""
        momentum, phi1, phi2 = self._inputs(measurement)
        zero = np.zeros_like(momentum)
        return EulerFilterState(-self.pole * momentum, zero, np.zeros(len(momentum)), zero, phi1, phi2)

    def step(
        self, state: EulerFilterState, measurement: Measurement, dt: float
    ) -> tuple[EulerFilterState, Regression]:
        """One Euler step over the dt [s] that ended at ``measurement``."""
        pole = self.pole
        z = state.z + dt * (-pole * (state.z + state.phi1))
        potential = state.potential + dt * (-pole * state.potential + pole * state.phi2)
        y = state.y + dt * (-pole * state.y + pole * measurement.tau)
        momentum, phi1, phi2 = self._inputs(measurement)
        omega = z + pole * momentum + potential
        return EulerFilterState(z, potential, y, omega, phi1, phi2), Regression(y, omega)

    def _inputs(self, measurement: Measurement) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """phi_3, phi_1 and phi_2 over all l columns."""
        reg, (_, q, v, _) = self.regressors, measurement
        momentum = reg.momentum(q, v)
        return momentum, self.pole * momentum + reg.kinetic_gradient(q, v), reg.potential_gradient(q)


class Extended(NamedTuple):
    """``matrix @ theta = vector``, (488) or (832), and what the next Euler step needs."""

    matrix: np.ndarray  # Phi (l, l)
    vector: np.ndarray  # (l,)
    memory: tuple[np.ndarray, ...]
    regression: Regression


@dataclass(frozen=True)
class EulerLeastSquares:
    """(443) with rho_0 = 0: Phi = I - z f0 F, vector = rho."""

    alpha: float = 10.0
    beta: float = 10.0
    xi: float = 10.0
    f0: float = 1.0

    def init(self, n_parameters: int) -> Extended:
        """F(0) = I/f0, rho(0) = 0, z(0) = 1."""
        memory = (np.eye(n_parameters) / self.f0, np.zeros(n_parameters), np.array(1.0))
        return Extended(*_nothing(n_parameters), memory, _no_regression(n_parameters))

    def step(self, extended: Extended, regression: Regression, dt: float) -> Extended:
        """One Euler step with the regression at the last sample; keeps the new one for the next."""
        covariance, rho, z = extended.memory
        y, omega = extended.regression
        rate = self.beta * (1 - np.linalg.norm(covariance, 2) / self.xi)
        gain = self.alpha * covariance @ omega.T
        memory = (
            covariance + dt * (-gain @ omega @ covariance + rate * covariance),
            rho + dt * (gain @ (y - omega @ rho)),
            z + dt * (-rate * z),
        )
        covariance, rho, z = memory
        return Extended(np.eye(len(rho)) - z * self.f0 * covariance, rho, memory, regression)

    def covariance(self, extended: Extended) -> np.ndarray:
        """F (l, l); P of (LSorginal)."""
        return extended.memory[0]


@dataclass(frozen=True)
class EulerKreisselmeier:
    """(510): Phi = Phi_2, vector = Phi_1. forgetting: lambda_2, gain: lambda_3 [1/s]."""

    forgetting: float = 1.0
    gain: float = 1.0

    def init(self, n_parameters: int) -> Extended:
        """Phi_1(0) = 0, Phi_2(0) = 0."""
        return Extended(*_nothing(n_parameters), (), _no_regression(n_parameters))

    def step(self, extended: Extended, regression: Regression, dt: float) -> Extended:
        """One Euler step with the regression at the last sample; keeps the new one for the next."""
        y, omega = extended.regression
        phi = extended.matrix + dt * (-self.forgetting * extended.matrix + self.gain * omega.T @ omega)
        vector = extended.vector + dt * (-self.forgetting * extended.vector + self.gain * omega.T @ y)
        return Extended(phi, vector, (), regression)


def _nothing(size: int) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((size, size)), np.zeros(size)


def _no_regression(size: int) -> Regression:
    return Regression(np.zeros(1), np.zeros((1, size)))


def cramer(extended: Extended) -> MixedRegression:
    """Y = adj{Phi} vector by Cramer's rule, Delta = det{Phi}, over the whole theta."""
    size = len(extended.vector)
    replaced = np.repeat(extended.matrix[None], size, axis=0)
    replaced[np.arange(size), :, np.arange(size)] = extended.vector
    return MixedRegression(np.linalg.det(replaced), float(np.linalg.det(extended.matrix)))


class Excitation(NamedTuple):
    """What the adaptation law has seen."""

    gates: np.ndarray  # (1,) zeta_1 now
    integral: np.ndarray  # (1,) its integral [s]; (IELSDREM) asks for it to grow


@dataclass(frozen=True)
class GateMonitor:
    """Integrates zeta_1 (476c), the quantity in which both finite-time propositions are stated."""

    b: float = 0.5
    d: float = 0.5

    def init(self) -> Excitation:
        """Nothing seen."""
        return Excitation(np.zeros(1), np.zeros(1))

    def step(self, excitation: Excitation, mixed: MixedRegression, dt: float) -> Excitation:
        gates = np.reshape(zeta_1(float(mixed.gain), self.b, self.d), 1)
        return Excitation(gates, excitation.integral + dt * gates)
