"""How much has been excited: the gates of a scalar mixing, and interval excitation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import expit, xlogy

from eladapt.estimation import kernels
from eladapt.estimation.extensions import Information, Kreisselmeier
from eladapt.signals import Regression


def saturation(delta: float | np.ndarray, c: float, d: float) -> np.ndarray:
    """f(Delta) = |Delta|^d sign(Delta) / (1 + |Delta|^(c + d)) (fphi)."""
    size = np.abs(delta)
    return np.sign(delta) * size**d / (1 + size ** (c + d))


def zeta_1(delta: float | np.ndarray, b: float, d: float) -> np.ndarray:
    """zeta_1 = f(Delta) |Delta|^b sign(Delta) for c = b, in [0, 1): a logistic curve in log |Delta|."""
    size = np.abs(delta)
    return size / (1 + size) if b + d == 1 else expit(xlogy(b + d, size))


@dataclass(frozen=True)
class IntervalExcitation:
    """The integral of Omega'Omega since the start (502), kept as a triangle."""

    def init(self, n_parameters: int) -> Information:
        """Nothing was excited yet."""
        return Kreisselmeier().init(n_parameters)

    def step(self, information: Information, regression: Regression, dt: float) -> Information:
        """Add the regression held over dt [s]."""
        return information._replace(
            triangle=kernels.updated(information.triangle, 1.0, dt, regression.omega, regression.y)[0]
        )

    @staticmethod
    def level(information: Information) -> float:
        """mu: the smallest eigenvalue of the integral so far."""
        return float(np.linalg.svd(information.triangle[:-1, :-1], compute_uv=False)[-1] ** 2)
