"""The composite adaptive controller: regression, extension, mixing, law and control, in line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from eladapt.control.finite_time import FiniteTimePD
from eladapt.control.gains import Gains, derive_gains, effort, extremes
from eladapt.errors import ArgumentError, require_gain, require_number, require_vector
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.estimation.change import Change, ChangeDetector
from eladapt.estimation.excitation import Excitation, GateMonitor
from eladapt.estimation.extensions import LeastSquares
from eladapt.estimation.friction import (
    CompensationState,
    FrictionCompensation,
    FrictionEstimate,
    estimate_friction,
)
from eladapt.estimation.mixing import Directional
from eladapt.estimation.payload import PayloadEstimate, estimate_payload
from eladapt.estimation.regressions import ForceBalance
from eladapt.robot.model import Robot
from eladapt.robot.regressors import Regressors
from eladapt.signals import Measurement, MixedRegression, Regression


class RegressionBlock(Protocol):
    """What turns measurements into y = Omega theta."""

    def init(self, measurement: Measurement) -> Any: ...
    def step(self, state: Any, measurement: Measurement, dt: float) -> tuple[Any, Regression]: ...


class ExtensionBlock(Protocol):
    """What accumulates regressions."""

    def init(self, n_parameters: int) -> Any: ...
    def step(self, information: Any, regression: Regression, dt: float) -> Any: ...


class MixingBlock(Protocol):
    """What makes scalar regressions of the accumulated ones."""

    def mix(self, information: Any, n_potential: int) -> MixedRegression: ...


class ControlBlock(Protocol):
    """What makes the feedback torque: `FiniteTimePD`, or a law of one's own."""

    def torque(self, e1: np.ndarray, e2: np.ndarray, mass_matrix: np.ndarray, dt: float) -> np.ndarray: ...


class ControllerState(NamedTuple):
    """Everything that the controller remembers; arrays and NamedTuples of arrays only."""

    measurement: Measurement  # the last one seen
    theta: np.ndarray  # (n_potential,) estimate of theta_U
    filters: Any  # of the regression block
    regression: Regression
    information: Any  # of the extension block
    mixed: MixedRegression
    excitation: Excitation
    change: Change | None = None  # what the detector noticed
    compensation: CompensationState | None = None  # what is fed forward against friction


@dataclass(frozen=True, eq=False)
class CompositeController:
    """(278) with (318): finite-time regulation that learns theta_U on the way.

    control: `FiniteTimePD`, or any law with its ``torque``; an exponent b must agree with law.b (c = b).
    effort_limit (nv,) [N m]: the torque is clipped to it; the estimator sees the torque that was applied,
    so clipping corrupts nothing, and the direct term rests in the joints whose torque is clipped.
    detector: notices a load that comes or goes; filters and information then start afresh, and the
    estimate goes on from where it was. compensation: feeds friction forward, at the velocity w that the
    law is about to make, M (w - v) = H tau. gains: which rule set each gain, where `for_robot` did.
    """

    regressors: Regressors
    regression: RegressionBlock
    extension: ExtensionBlock
    mixing: MixingBlock
    law: CompositeLaw
    control: ControlBlock
    effort_limit: float | np.ndarray = np.inf
    detector: ChangeDetector | None = None
    gains: Gains | None = None
    compensation: FrictionCompensation | None = None

    def __post_init__(self) -> None:
        nv, j = self.regressors.robot.nv, self.regressors.n_potential
        for name in ("Gamma", "Upsilon"):
            require_gain(name, getattr(self.law, name), j)
        if isinstance(self.control, FiniteTimePD):
            for name in ("P", "D", "D_L"):
                require_gain(name, getattr(self.control, name), nv, zero=name == "D_L")
        exponent = getattr(self.control, "b", self.law.b)
        if abs(self.law.b - exponent) > 1e-12:
            raise ArgumentError(
                f"law.b: expected the control law's exponent b = {exponent:g} (c = b, (471)), "
                f"got {self.law.b:g}"
            )
        if isinstance(self.mixing, Directional) and not self.law.scalar_rate:
            raise ArgumentError(
                "Gamma, Upsilon: Directional mixing needs one common value of Gamma * Upsilon"
            )
        limit = np.asarray(self.effort_limit, dtype=float)
        if limit.shape not in ((), (nv,)) or np.isnan(limit).any() or np.any(limit <= 0):
            raise ArgumentError(
                f"effort_limit: expected positive, scalar or ({nv},), got {self.effort_limit!r}"
            )
        object.__setattr__(self, "effort_limit", np.broadcast_to(limit, (nv,)))

    @classmethod
    def for_robot(
        cls,
        robot: Robot,
        dt: float = 1e-3,
        *,
        friction: bool | Literal["viscous", "coulomb"] = False,
        friction_feedforward: bool = True,
        **given: Any,
    ) -> CompositeController:
        """Every gain derived from the URDF, for steps of dt [s]; those ``given`` by name are kept.

        Names: P, D, D_L, pole, row_weight, alpha, beta, xi, f0, Gamma, Upsilon, in the units of
        `eladapt.control.gains.Gains`. ``print(controller.gains)`` says which rule set each. Raises
        ArgumentError, with the joint and a dt that would do, for an arm that cannot be controlled at dt.

        friction: False, "viscous", "coulomb" or True (both): which friction is estimated beside gravity, see
        `friction`; friction_feedforward: whether what is found is fed forward.
        """
        regressors = Regressors(robot, friction=friction)
        gains = derive_gains(regressors, dt, given)
        compensation = None
        if friction and friction_feedforward:
            limit = 0.5 * effort(robot, extremes(robot))
            compensation = FrictionCompensation(regressors, limit)
        return cls(
            regressors=regressors,
            regression=ForceBalance(regressors, gains.pole, weight=gains.row_weight),
            extension=LeastSquares(gains.alpha, gains.beta, gains.xi, gains.f0),
            mixing=Directional(),
            law=CompositeLaw(Gamma=gains.Gamma, Upsilon=gains.Upsilon),
            control=FiniteTimePD(gains.P, gains.D, gains.D_L),
            effort_limit=robot.effort_limit,
            detector=ChangeDetector(),
            gains=gains,
            compensation=compensation,
        )

    @property
    def robot(self) -> Robot:
        return self.regressors.robot

    def init(
        self, measurement: Measurement, theta0: Sequence[float] | np.ndarray | None = None
    ) -> ControllerState:
        """Filters at rest at the first measurement, theta_U = theta0 (n_potential,), or zero."""
        self.robot.check_measurement(measurement)
        j = self.regressors.n_potential
        theta = np.zeros(j) if theta0 is None else require_vector("theta0", theta0, j)
        filters = self.regression.init(measurement)
        information = self.extension.init(len(self.regressors))
        mixed = self.mixing.mix(information, j)
        empty = Regression(filters.y, filters.omega)
        excitation = GateMonitor().init(np.size(mixed.delta))
        change = self.detector.init(information, j) if self.detector else None
        compensation = self.compensation.init() if self.compensation else None
        return ControllerState(
            measurement, theta, filters, empty, information, mixed, excitation, change, compensation
        )

    def step(
        self, state: ControllerState, measurement: Measurement, goal: np.ndarray, dt: float
    ) -> tuple[ControllerState, np.ndarray]:
        """The state at ``measurement`` and the torque (nv,) [N m] to hold until the next one.

        goal: q_d (nq,). dt [s]: time since the measurement before, and until the next. A measurement
        with the time stamp of the last one (as the first after `init`) is the same sample: nothing
        is advanced. Raises ArgumentError for wrong shapes, non-finite numbers, or time running back.
        """
        self.robot.check_measurement(measurement)
        goal = self.robot.check_q(goal, "goal")
        dt = require_number("dt", dt, 0)
        e1 = self.robot.difference(goal, measurement.q)
        psi = self.regressors.gravity(measurement.q)
        if measurement.t > state.measurement.t:
            state = self._advance(state, measurement, psi, e1, dt)
        elif measurement.t < state.measurement.t:
            raise ArgumentError(
                f"measurement.t: expected {state.measurement.t} s or later, got {measurement.t} s"
            )
        mass_matrix = self.robot.mass_matrix(measurement.q)
        feedback = self.control.torque(e1, measurement.v, mass_matrix, dt)
        if self.compensation and state.compensation:
            horizon = max(dt, getattr(self.control, "horizon", None) or dt)
            predicted = measurement.v + horizon * np.linalg.solve(mass_matrix, feedback)
            feedback = feedback + self.compensation.torque(state.compensation, measurement.v, predicted)
        tau = np.clip(feedback + psi @ state.theta, -self.effort_limit, self.effort_limit)
        return state, tau

    def friction(self, state: ControllerState) -> FrictionEstimate:
        """Friction of every joint by least squares, nan where it was not excited.

        Raises ArgumentError when the controller has no friction columns.
        """
        if not self.regressors.n_friction:
            raise ArgumentError(
                "friction: this controller has no friction columns; for_robot(robot, friction=True) makes one"
            )
        return estimate_friction(self.regressors, state.information)

    def payload(self, state: ControllerState, frame: str | None = None) -> PayloadEstimate:
        """The load that came or went with the last change noticed, in ``frame`` (the tool if None).

        Standard deviations are those of noise in the measured velocity, which the filters leave white.
        Raises ArgumentError when the controller has noticed no change.
        """
        change = state.change
        if change is None or change.noticed == 0:
            raise ArgumentError(
                "state: expected one in which a change was noticed; state.change says none was"
            )
        rows = state.filters.y.size * max(1, change.steps)
        return estimate_payload(
            self.regressors, change.theta_before, state.theta, state.information,
            change.information_before, samples=rows if rows > len(self.regressors) else None, frame=frame,
        )  # fmt: skip

    def carried(self, state: ControllerState, frame: str | None = None) -> PayloadEstimate:
        """What the arm carries beyond the URDF's own bodies, in ``frame`` (the tool if None).

        The estimate less the URDF's parameters, where it was excited; right if the URDF's masses are.
        """
        regressors = self.regressors
        nominal = regressors.theta_potential
        return estimate_payload(regressors, nominal, state.theta, state.information, frame=frame)

    def _advance(
        self, state: ControllerState, measurement: Measurement, psi: np.ndarray, e1: np.ndarray, dt: float
    ) -> ControllerState:
        filters, regression = self.regression.step(state.filters, measurement, dt)
        information = self.extension.step(state.information, regression, dt)
        change = state.change
        if self.detector and change:
            t, before = measurement.t, state.information
            change = self.detector.step(change, before, information, state.theta, t, dt)
            if change.noticed > state.change.noticed:  # type: ignore[union-attr]
                filters = self.regression.init(measurement)
                regression = Regression(filters.y, filters.omega)
                information = self.extension.init(len(self.regressors))
        mixed = self.mixing.mix(information, self.regressors.n_potential)
        free = np.abs(measurement.tau) < self.effort_limit
        theta = self.law.step(state.theta, psi, free * e1, free * measurement.v, mixed, dt)
        excitation = GateMonitor(self.law.b, self.law.d).step(state.excitation, mixed, dt)
        compensation = state.compensation
        if self.compensation and compensation:
            before, known = state.measurement, psi @ theta
            compensation = self.compensation.step(
                compensation, information, before, measurement, known, e1, dt
            )
        return ControllerState(
            measurement, theta, filters, regression, information, mixed, excitation, change, compensation
        )
