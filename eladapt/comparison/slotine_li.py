"""Slotine and Li's composite adaptive controller with bounded-gain-forgetting least squares (C4).

The classical composite scheme, for comparison: it needs the whole theta, a reference velocity and
the regressor W_r of it, and converges asymptotically. The paper cites Slotine and Li (1989).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eladapt.comparison.learns_all import LearnsAll
from eladapt.control.blocks import CovarianceBlock, RegressionBlock
from eladapt.control.starting import starting_parameters
from eladapt.errors import require_gain, require_number
from eladapt.estimation.excitation import IntervalExcitation
from eladapt.estimation.extensions import Information, LeastSquares
from eladapt.estimation.regressions import ForceBalance
from eladapt.gains.derived import derive_sliding_gains
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.robot.protocols import Goal
from eladapt.signals import Measurement, Regression


class SlotineLiState(NamedTuple):
    """Everything that the controller remembers."""

    measurement: Measurement
    theta: np.ndarray  # (l,) estimate of all parameters
    theta_rate: np.ndarray  # (l,) right side of (LSSlotineLi) at this sample
    filters: Any
    regression: Regression
    information: Any
    excited: Information  # of (502)

    def __repr__(self) -> str:
        return f"SlotineLiState(t = {self.measurement.t:.6g} s, {len(self.theta)} parameters)"

    @property
    def level(self) -> float:
        """Smallest eigenvalue of the integral of Omega'Omega so far (502)."""
        return IntervalExcitation.level(self.excited)


class SlidingReference(NamedTuple):
    """The sliding variable and the reference motion that it measures the distance from."""

    s: np.ndarray  # (nv,)
    vr: np.ndarray  # (nv,)
    ar: np.ndarray  # (nv,)


def linear_reference(e1: np.ndarray, e2: np.ndarray, K2: np.ndarray) -> SlidingReference:
    """s = e2 + K2 e1, vr = -K2 e1, ar = -K2 e2 (AsymptoticAC)."""
    return SlidingReference(e2 + K2 * e1, -K2 * e1, -K2 * e2)


@dataclass(frozen=True, eq=False)
class SlotineLi(LearnsAll):
    """tau = W_r theta - K1 s (AsymptoticAC), theta' = -P [W_r' s + w Omega' e_p] (LSSlotineLi).

    P follows (LSorginal): ``extension`` is `LeastSquares`, or `EulerLeastSquares`, as typeset. weight:
    w = 1 as typeset; the Lyapunov argument needs w >= alpha/2, for which w = alpha is the usual choice.
    K1 [N m s/rad], K2 [1/s]: scalar or (nv,). theta is stepped by explicit Euler. track: keep the
    integral of Omega'Omega, for `SlotineLiState.level`.

    Raises ArgumentError for gains that are not positive.
    """

    regressors: Regressors
    regression: RegressionBlock
    extension: CovarianceBlock
    K1: float | np.ndarray
    K2: float | np.ndarray
    weight: float = 1.0
    effort_limit: float | np.ndarray = np.inf
    track: bool = False

    def __repr__(self) -> str:
        return f"SlotineLi({self.robot.name}, {len(self.regressors)} parameters)"

    def __post_init__(self) -> None:
        nv = self.regressors.robot.nv
        object.__setattr__(self, "K1", require_gain("K1", self.K1, nv))
        object.__setattr__(self, "K2", require_gain("K2", self.K2, nv))
        object.__setattr__(self, "weight", require_number("weight (w)", self.weight, 0))

    @classmethod
    def for_robot(cls, robot: Robot, dt: float = 1e-3) -> SlotineLi:
        """Gains from the URDF, for steps of dt [s], with w = alpha."""
        gains = derive_sliding_gains(robot, dt)
        regressors = Regressors(robot)
        regression = ForceBalance(regressors, gains.pole, weight=gains.row_weight)
        extension = LeastSquares(gains.alpha, gains.beta, gains.xi, gains.f0)
        return cls(regressors, regression, extension, gains.K1, gains.K2, gains.alpha, robot.effort_limit)

    def recorded(self, state: SlotineLiState) -> dict[str, Any]:
        """The whole estimate, and the level of what was excited where it is tracked."""
        kept = self.estimate(state.theta)
        return kept | {"level": state.level} if self.track else kept

    def init(self, measurement: Measurement, theta0: str | np.ndarray | None = None) -> SlotineLiState:
        """Filters at rest. theta0: "urdf", "zero" (also None), (l,), or (n_potential,) gravity's alone."""
        measurement = self.robot.check_measurement(measurement)
        size, theta = len(self.regressors), starting_parameters(theta0, self.regressors)
        filters = self.regression.init(measurement)
        regression = Regression(filters.y, filters.omega)
        information = self.extension.init(size)
        return SlotineLiState(
            measurement, theta, np.zeros(size), filters, regression, information,
            IntervalExcitation().init(size),
        )  # fmt: skip

    def step(
        self, state: SlotineLiState, measurement: Measurement, goal: Goal, dt: float
    ) -> tuple[SlotineLiState, np.ndarray]:
        """The state at ``measurement`` from the one dt [s] earlier, and the torque (nv,) there.

        For a goal that moves s, vr and ar are those of v - v_d, as Slotine and Li have it.
        """
        measurement = self.robot.check_measurement(measurement)
        goal = self.robot.check_goal(goal)
        if measurement.t > state.measurement.t:
            theta = state.theta + dt * state.theta_rate
            excited = state.excited
            if self.track:
                excited = IntervalExcitation().step(excited, state.regression, dt)
            filters, regression = self.regression.step(state.filters, measurement, dt)
            information = self.extension.step(state.information, regression, dt)
            state = state._replace(
                theta=theta, filters=filters, regression=regression, information=information,
                excited=excited,
            )  # fmt: skip
        _, q, v, _ = measurement
        e1, e2 = self.robot.difference(goal.q, q), v - goal.v
        s, vr, ar = linear_reference(e1, e2, np.asarray(self.K2))
        regressor = self.regressors.slotine_li(q, v, goal.v + vr, goal.a + ar)
        y, omega = state.regression
        covariance = self.extension.covariance(state.information)
        prediction_error = omega @ state.theta - y
        rate = -covariance @ (regressor.T @ s + self.weight * omega.T @ prediction_error)
        tau = np.clip(regressor @ state.theta - self.K1 * s, -self.effort_limit, self.effort_limit)
        return state._replace(measurement=measurement, theta_rate=rate), tau
