"""The composite adaptive controller as typeset, by explicit Euler with the full determinant.

`eladapt.paper` runs it to reproduce C1 and C2 step for step. `CompositeController` is the one to
use: it holds the same equations with numerics for any arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.control.finite_time import FiniteTimePD
from eladapt.control.proximal import signed_power
from eladapt.errors import require_vector
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.estimation.excitation import Excitation, GateMonitor, saturation
from eladapt.paper.typeset_estimation import (
    EulerFilterState,
    EulerForceBalance,
    EulerKreisselmeier,
    EulerLeastSquares,
    Extended,
    cramer,
)
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.signals import Measurement, MixedRegression, Regression


class TypesetState(NamedTuple):
    """All states of (278), (318), (399), (419) and (443) or (510) at one sample."""

    measurement: Measurement
    theta: np.ndarray  # (j,)
    theta_rate: np.ndarray  # (j,) right side of (318) at this sample
    filters: EulerFilterState
    regression: Regression
    information: Extended
    mixed: MixedRegression
    excitation: Excitation


@dataclass(frozen=True, eq=False)
class TypesetComposite:
    """(278), (318), (419), (443)/(510), (488)/(832) with every derivative stepped explicitly."""

    regressors: Regressors
    regression: EulerForceBalance
    extension: EulerLeastSquares | EulerKreisselmeier
    law: CompositeLaw
    control: FiniteTimePD

    @property
    def robot(self) -> Robot:
        return self.regressors.robot

    def init(self, measurement: Measurement, theta0: np.ndarray | None = None) -> TypesetState:
        """Filters at rest, theta_U = theta0 (j,) or zero."""
        j = self.regressors.n_potential
        theta = np.zeros(j) if theta0 is None else require_vector("theta0", theta0, j)
        filters = self.regression.init(measurement)
        regression = Regression(filters.y, filters.omega)
        extended = self.extension.init(len(self.regressors))
        excitation = GateMonitor().init(1)
        return TypesetState(
            measurement, theta, np.zeros(j), filters, regression, extended, cramer(extended), excitation
        )

    def step(
        self, state: TypesetState, measurement: Measurement, goal: np.ndarray, dt: float
    ) -> tuple[TypesetState, np.ndarray]:
        """All states at ``measurement`` from those one dt [s] earlier, and the torque (278) there."""
        e1 = self.robot.difference(goal, measurement.q)
        psi = self.regressors.gravity(measurement.q)
        if measurement.t > state.measurement.t:
            filters, regression = self.regression.step(state.filters, measurement, dt)
            extended = self.extension.step(state.information, regression, dt)
            mixed = cramer(extended)
            # The left Riemann sum, as explicit Euler integrates zeta_1.
            excitation = GateMonitor(self.law.b, self.law.d).step(state.excitation, state.mixed, dt)
            theta = state.theta + dt * state.theta_rate
            state = state._replace(
                theta=theta, filters=filters, regression=regression, information=extended,
                mixed=mixed, excitation=excitation,
            )  # fmt: skip
        rate = self._rate(state.theta, psi, e1, measurement.v, state.mixed)
        state = state._replace(measurement=measurement, theta_rate=rate)
        return state, self.control.law(e1, measurement.v) + psi @ state.theta

    def _rate(
        self, theta: np.ndarray, psi: np.ndarray, e1: np.ndarray, e2: np.ndarray, mixed: MixedRegression
    ) -> np.ndarray:
        """The right side of (318)."""
        law, delta = self.law, mixed.delta
        total = law.gamma1 + law.gamma2
        xi = signed_power(delta * theta - mixed.Y[-len(theta) :], law.b)
        direct = psi.T @ (law.gamma1 * law.d1 * np.tanh(e1) + total * e2)
        return -law.Gamma * direct - total * law.Gamma * law.Upsilon * saturation(delta, law.b, law.d) * xi
