"""The composite adaptive controller as typeset, by explicit Euler with the full determinant.

`eladapt.paper` runs it to reproduce C1 and C2 step for step. `CompositeController` is the one to
use: it holds the same equations with numerics for any arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.control.finite_time import FiniteTimePD
from eladapt.control.proximal import signed_power
from eladapt.control.starting import starting_parameters
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.estimation.excitation import saturation
from eladapt.paper.typeset_estimation import (
    EulerFilterState,
    EulerForceBalance,
    EulerKreisselmeier,
    EulerLeastSquares,
    Excitation,
    Extended,
    GateMonitor,
    cramer,
)
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.robot.protocols import Goal
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

    @property
    def labels(self) -> tuple[str, ...]:
        """Those of theta_U, which is all that is estimated."""
        return self.regressors.labels[len(self.regressors) - self.regressors.n_potential :]

    def recorded(self, state: TypesetState) -> dict[str, Any]:
        """theta_U, Delta, zeta_1 and its integral."""
        gates, integral = state.excitation
        return {
            "parameters": state.theta, "theta": state.theta, "delta": np.atleast_1d(state.mixed.gain),
            "zeta": gates, "zeta_integral": integral,
        }  # fmt: skip

    def reviewed(self, state: TypesetState, frame: str | None) -> dict[str, np.ndarray]:
        """Nothing."""
        return {}

    def true_parameters(self, model: pin.Model) -> np.ndarray:
        """(j,) theta_U on an arm with this model. Raises ArgumentError for one with other joints."""
        return self.regressors.theta_of(model)[len(self.regressors) - self.regressors.n_potential :]

    def init(self, measurement: Measurement, theta0: str | np.ndarray | None = None) -> TypesetState:
        """Filters at rest. theta0: "urdf", "zero" (also None), (j,), or (l,) for its last block."""
        measurement = self.robot.check_measurement(measurement)
        j = self.regressors.n_potential
        theta = starting_parameters(theta0, self.regressors)[len(self.regressors) - j :]
        filters = self.regression.init(measurement)
        regression = Regression(filters.y, filters.omega)
        extended = self.extension.init(len(self.regressors))
        excitation = GateMonitor().init()
        return TypesetState(
            measurement, theta, np.zeros(j), filters, regression, extended, cramer(extended), excitation
        )

    def step(
        self, state: TypesetState, measurement: Measurement, goal: Goal, dt: float
    ) -> tuple[TypesetState, np.ndarray]:
        """All states at ``measurement`` from those one dt [s] earlier, and the torque (278) there, to q_d."""
        measurement = self.robot.check_measurement(measurement)
        e1 = self.robot.difference(self.robot.check_goal(goal).q, measurement.q)
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
        law, delta = self.law, float(mixed.gain)
        total = law.gamma1 + law.gamma2
        xi = signed_power(delta * theta - mixed.Y[-len(theta) :], law.b)
        direct = psi.T @ (law.gamma1 * law.d1 * np.tanh(e1) + total * e2)
        return -law.Gamma * direct - total * law.Gamma * law.Upsilon * saturation(delta, law.b, law.d) * xi
