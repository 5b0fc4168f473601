"""How much has been excited: gates, their integrals, and interval excitation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import expit, xlogy

from eladapt.estimation.extensions import Information, Kreisselmeier
from eladapt.estimation.triangle import accumulate
from eladapt.signals import MixedRegression, Regression


def saturation(delta: float | np.ndarray, c: float, d: float) -> np.ndarray:
    """f(Delta) = |Delta|^d sign(Delta) / (1 + |Delta|^(c + d)) (fphi)."""
    size = np.abs(delta)
    return np.sign(delta) * size**d / (1 + size ** (c + d))


def zeta_1(delta: float | np.ndarray, b: float, d: float) -> np.ndarray:
    """zeta_1 = f(Delta) |Delta|^b sign(Delta) for c = b, in [0, 1): a logistic curve in log |Delta|."""
    size = np.abs(delta)
    return size / (1 + size) if b + d == 1 else expit(xlogy(b + d, size))


class Excitation(NamedTuple):
    """What the adaptation law has seen: one entry, or one a direction."""

    gates: np.ndarray  # (k,) zeta_1 now
    integral: np.ndarray  # (k,) its integral [s]; (IELSDREM) asks for it to grow


@dataclass(frozen=True)
class GateMonitor:
    """Integrates zeta_1 (476c), the quantity in which both finite-time propositions are stated."""

    b: float = 0.5
    d: float = 0.5

    def init(self, size: int | tuple[int, ...]) -> Excitation:
        """size: how many gates, (k,) or with leading axes (..., k)."""
        return Excitation(np.zeros(size), np.zeros(size))

    def step(self, excitation: Excitation, mixed: MixedRegression, dt: float) -> Excitation:
        gates = zeta_1(mixed.delta, self.b, self.d)
        if gates.shape != excitation.gates.shape:
            gates = np.reshape(gates, excitation.gates.shape)
        return Excitation(gates, excitation.integral + dt * gates)


@dataclass(frozen=True)
class IntervalExcitation:
    """The integral of Omega'Omega since the start (502), kept as a triangle."""

    def init(self, n_parameters: int) -> Information:
        return Kreisselmeier().init(n_parameters)

    def step(self, information: Information, regression: Regression, dt: float) -> Information:
        return information._replace(triangle=accumulate(information.triangle, 1.0, dt, regression))

    @staticmethod
    def level(information: Information) -> float:
        """mu: the smallest eigenvalue of the integral so far."""
        return float(np.linalg.svd(information.triangle[:-1, :-1], compute_uv=False)[-1] ** 2)
