"""What the parts of a controller must offer: the faces by which they are exchanged for one another."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from eladapt.signals import Measurement, Regression


class RegressionBlock(Protocol):
    """What turns measurements into y = Omega theta."""

    def init(self, measurement: Measurement) -> Any: ...
    def step(self, state: Any, measurement: Measurement, dt: float) -> tuple[Any, Regression]: ...


class ExtensionBlock(Protocol):
    """What accumulates regressions."""

    def init(self, n_parameters: int) -> Any: ...
    def step(self, information: Any, regression: Regression, dt: float) -> Any: ...


class CovarianceBlock(ExtensionBlock, Protocol):
    """An extension that also has the covariance F (l, l) of (LSorginal)."""

    def covariance(self, information: Any) -> np.ndarray: ...


class ControlBlock(Protocol):
    """What makes the feedback torque: `FiniteTimePD`, or a law of one's own."""

    @property
    def b(self) -> float: ...  # exponent of the velocity error, that of the adaptation law (471)
    def torque(self, e1: np.ndarray, e2: np.ndarray, mass_matrix: np.ndarray, dt: float) -> np.ndarray: ...
