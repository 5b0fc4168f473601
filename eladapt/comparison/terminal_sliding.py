"""The terminal-sliding-mode composite controller (C3), with its discontinuous estimator.

Away from the goal, or when fast, a linear sliding surface; elsewhere a terminal one. Unit vectors in
the torque and in the adaptation make both arrive in finite time, and chatter. From the paper's reference
NaMaHeReBa2015, as the paper restates it in (795), (stsmvar) and (63).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eladapt.comparison.learns_all import LearnsAll
from eladapt.comparison.slotine_li import SlidingReference, linear_reference
from eladapt.control.blocks import ExtensionBlock, RegressionBlock
from eladapt.control.proximal import signed_power
from eladapt.control.starting import starting_parameters
from eladapt.errors import require_gain, require_number
from eladapt.estimation.extensions import Kreisselmeier
from eladapt.estimation.regressions import ForceBalance
from eladapt.gains.derived import derive_sliding_gains
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.robot.protocols import Goal
from eladapt.signals import Measurement, Regression


class TerminalSlidingState(NamedTuple):
    """Everything that the controller remembers."""

    measurement: Measurement
    theta: np.ndarray  # (l,) estimate of all parameters
    theta_rate: np.ndarray  # (l,) right side of (63) at this sample
    filters: Any
    regression: Regression
    information: Any
    terminal: bool  # whether the terminal surface was in use

    def __repr__(self) -> str:
        return f"TerminalSlidingState(t = {self.measurement.t:.6g} s, {len(self.theta)} parameters)"

    @property
    def level(self) -> float:
        """Smallest eigenvalue of Phi_2 (510)."""
        return float(np.linalg.eigvalsh(self.information.matrix)[0])


class AdaptationGain(NamedTuple):
    """Gamma and k of (63), in one of the two regions."""

    Gamma: float
    k: float


SLOW, FAST = AdaptationGain(0.001, 5000.0), AdaptationGain(1.0, 50.0)  # as given in the paper


@dataclass(frozen=True, eq=False)
class TerminalSliding(LearnsAll):
    """tau = W_r theta - K1 s - K_s s/||s||, theta' = -Gamma W_r' s - Gamma k Phi_2' Theta/||Theta|| (63).

    Theta = Phi_2 theta - Phi_1. The terminal surface s = e2 + K2 |e1|^a sign(e1) is used while (795) is
    not positive, e2' M e2 <= lambda_max(M) ||K2 |e1|^a||^2, with the true M(q), the nominal one here;
    otherwise s = e2 + K2 e1 and theta' = -Gamma W_r' s - Gamma k Theta.

    The terminal reference acceleration -a K2 |e1|^(a-1) e2 is singular at e1 = 0, and (795) does not keep
    the joints one by one away from there: |e1| is taken as no smaller than ``floor`` [rad] in it. Below
    the floor the feedforward is too small, which K_s must dominate.

    K1 [N m s/rad], K2 [1/s], K_s [N m]: scalar or (nv,); a in (0, 1). theta is stepped by explicit Euler.
    Raises ArgumentError for gains that are not positive.
    """

    regressors: Regressors
    regression: RegressionBlock
    extension: ExtensionBlock
    K1: float | np.ndarray
    K2: float | np.ndarray
    K_s: float | np.ndarray
    a: float = 1 / 3
    floor: float = 1e-3
    slow: AdaptationGain = SLOW
    fast: AdaptationGain = FAST
    effort_limit: float | np.ndarray = np.inf

    def __repr__(self) -> str:
        return f"TerminalSliding({self.robot.name}, {len(self.regressors)} parameters)"

    def __post_init__(self) -> None:
        nv = self.regressors.robot.nv
        for name in ("K1", "K2", "K_s"):
            object.__setattr__(self, name, require_gain(name, getattr(self, name), nv))
        object.__setattr__(self, "a", require_number("a", self.a, 0, 1))
        object.__setattr__(self, "floor", require_number("floor", self.floor, 0))
        for name in ("slow", "fast"):
            for field, value in getattr(self, name)._asdict().items():
                require_number(f"{name}.{field}", value, 0)

    @classmethod
    def for_robot(cls, robot: Robot, dt: float = 1e-3) -> TerminalSliding:
        """Gains from the URDF, for steps of dt [s]."""
        gains = derive_sliding_gains(robot, dt)
        regressors = Regressors(robot)
        # The paper's slow gains adapt gravity too slowly where Phi_2 spans ten decades, as on a Panda; its
        # floor lets the inertia columns of the direct term run away. These were measured on panda and ur5.
        return cls(
            regressors, ForceBalance(regressors, gains.pole), Kreisselmeier(), gains.K1, gains.K2, gains.K_s,
            floor=1e-2, slow=AdaptationGain(1.0, 2.0), fast=AdaptationGain(1.0, 5.0),
            effort_limit=robot.effort_limit,
        )  # fmt: skip

    def recorded(self, state: TerminalSlidingState) -> dict[str, Any]:
        """The whole estimate and the smallest eigenvalue of Phi_2."""
        return self.estimate(state.theta) | {"level": state.level}

    def init(self, measurement: Measurement, theta0: str | np.ndarray | None = None) -> TerminalSlidingState:
        """Filters at rest. theta0: "urdf", "zero" (also None), (l,), or (n_potential,) gravity's alone."""
        measurement = self.robot.check_measurement(measurement)
        size, theta = len(self.regressors), starting_parameters(theta0, self.regressors)
        filters = self.regression.init(measurement)
        regression = Regression(filters.y, filters.omega)
        information = self.extension.init(size)
        return TerminalSlidingState(
            measurement, theta, np.zeros(size), filters, regression, information, True
        )

    def step(
        self, state: TerminalSlidingState, measurement: Measurement, goal: Goal, dt: float
    ) -> tuple[TerminalSlidingState, np.ndarray]:
        """The state at ``measurement`` from the one dt [s] earlier, and the torque (nv,) there.

        Of a goal that moves only q_d is used: the scheme is one for set-points.
        """
        measurement = self.robot.check_measurement(measurement)
        target = self.robot.check_goal(goal).q
        if measurement.t > state.measurement.t:
            theta = state.theta + dt * state.theta_rate
            filters, regression = self.regression.step(state.filters, measurement, dt)
            information = self.extension.step(state.information, regression, dt)
            state = state._replace(
                theta=theta, filters=filters, regression=regression, information=information
            )
        _, q, v, _ = measurement
        e1 = self.robot.difference(target, q)
        terminal = self.region(q, e1, v) <= 0
        s, vr, ar = (
            self.terminal_reference(e1, v) if terminal else linear_reference(e1, v, np.asarray(self.K2))
        )
        regressor = self.regressors.slotine_li(q, v, vr, ar)
        error = state.information.matrix @ state.theta - state.information.vector
        correction = state.information.matrix.T @ unit(error) if terminal else error
        Gamma, k = self.slow if terminal else self.fast
        rate = -Gamma * (regressor.T @ s) - Gamma * k * correction
        tau = regressor @ state.theta - self.K1 * s - self.K_s * unit(s)
        tau = np.clip(tau, -self.effort_limit, self.effort_limit)
        return state._replace(measurement=measurement, theta_rate=rate, terminal=terminal), tau

    def region(self, q: np.ndarray, e1: np.ndarray, e2: np.ndarray) -> float:
        """(795): the terminal surface is in use where this is not positive."""
        mass_matrix = self.robot.mass_matrix(q)
        surface = self.K2 * signed_power(e1, self.a)
        return float(e2 @ mass_matrix @ e2 - np.linalg.eigvalsh(mass_matrix)[-1] * (surface @ surface))

    def terminal_reference(self, e1: np.ndarray, e2: np.ndarray) -> SlidingReference:
        """s = e2 + K2 |e1|^a, vr = -K2 |e1|^a, ar = -a K2 max(|e1|, floor)^(a-1) e2 (stsmvar)."""
        surface = self.K2 * signed_power(e1, self.a)
        steepness = self.a * self.K2 * np.maximum(np.abs(e1), self.floor) ** (self.a - 1)
        return SlidingReference(e2 + surface, -surface, -steepness * e2)


def unit(x: np.ndarray) -> np.ndarray:
    """x / ||x||, and 0 at 0."""
    norm = np.linalg.norm(x)
    return x / norm if norm > 0 else np.zeros_like(x)
