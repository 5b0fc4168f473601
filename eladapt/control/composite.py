"""The composite adaptive controller: regression, extension, mixing, law and control, in line."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from eladapt.control.blocks import ControlBlock, ExtensionBlock, MixingBlock, RegressionBlock
from eladapt.control.disturbance import DisturbanceEstimate
from eladapt.control.finite_time import FiniteTimePD
from eladapt.control.gains import Gains, derive_gains, effort, extremes
from eladapt.control.line import CompiledLine
from eladapt.control.sensing import QUIET_XI, Hardware
from eladapt.control.state import ControllerState
from eladapt.control.stepping import checked_step, elapsed
from eladapt.errors import ArgumentError, require_gain, require_vector
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.estimation.change import ChangeDetector
from eladapt.estimation.excitation import GateMonitor
from eladapt.estimation.extensions import LeastSquares
from eladapt.estimation.friction import FrictionCompensation, FrictionEstimate, estimate_friction
from eladapt.estimation.mixing import Directional
from eladapt.estimation.payload import PayloadEstimate, completed, estimate_payload
from eladapt.estimation.regressions import ForceBalance
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.signals import Measurement, MixedRegression, Regression


@dataclass(frozen=True, eq=False)
class CompositeController:
    """(278) with (318): finite-time regulation that learns theta_U on the way.

    control: `FiniteTimePD`, or any law with its ``torque``; an exponent b must agree with law.b (c = b).
    effort_limit (nv,) [N m]: the torque is clipped to it; the estimator sees the torque that was applied,
    so clipping corrupts nothing, and the direct term rests in the joints whose torque is clipped.
    detector: notices a load that comes or goes; filters and information then start afresh, and the
    estimate goes on from where it was. compensation: feeds friction forward, at the velocity w that the
    law is about to make, M (w - v) = H tau. disturbance: lets the semi-implicit law's prediction know what
    holds the arm; not together with compensation, which takes that away, nor with another evaluation.
    gains: which rule set each gain, where `for_robot` did. nominal_dt [s]: the step that the gains were made
    for, None if any will do.
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
    nominal_dt: float | None = None
    disturbance: DisturbanceEstimate | None = None

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
        if self.disturbance and (
            self.compensation or getattr(self.control, "evaluation", "") != "semi_implicit"
        ):
            raise ArgumentError(
                "disturbance: expected None with a compensation, or with a law that is not evaluated "
                "semi-implicitly; dataclasses.replace(controller, disturbance=None) leaves it out"
            )
        limit = np.asarray(self.effort_limit, dtype=float)
        if limit.shape not in ((), (nv,)) or np.isnan(limit).any() or np.any(limit <= 0):
            raise ArgumentError(
                f"effort_limit: expected positive, scalar or ({nv},), got {self.effort_limit!r}"
            )
        object.__setattr__(self, "effort_limit", np.broadcast_to(limit, (nv,)).copy())

    @classmethod
    def for_robot(
        cls,
        robot: Robot,
        dt: float = 1e-3,
        *,
        position_noise: float | np.ndarray = 0.0,
        velocity_noise: float | np.ndarray = 0.0,
        delay: float = 0.0,
        velocity_lag: float = 0.0,
        friction: bool | Literal["viscous", "coulomb"] = False,
        friction_feedforward: bool = True,
        compiled: bool = False,
        **given: Any,
    ) -> CompositeController:
        """Every gain derived from the URDF, for steps of dt [s]; those ``given`` by name are kept.

        position_noise [rad], velocity_noise [rad/s], delay [s], velocity_lag [s]: what is known of the
        hardware, see `eladapt.control.sensing.Hardware`; the control law's horizon, the information floor
        and the speed below which a joint counts as stuck follow from it.

        Names: P, D, D_L, horizon, pole, row_weight, alpha, beta, xi, f0, Gamma, Upsilon, in the units of
        `eladapt.control.gains.Gains`. ``print(controller.gains)`` says which rule set each. Raises
        ArgumentError, with the joint and a dt that would do, for an arm that cannot be controlled at dt.

        friction: False, "viscous", "coulomb" or True (both): which friction is estimated beside gravity, see
        `friction`; friction_feedforward: whether what is found is fed forward. compiled: whether numba (extra
        ``fast``) compiles what is written in Python, see benchmarks/results/step_cost.md.
        """
        regressors = Regressors(robot, friction=friction)
        hardware = Hardware(position_noise, velocity_noise, delay, velocity_lag)
        gains = derive_gains(regressors, dt, given, hardware)
        compensation = None
        if friction and friction_feedforward:
            limit = 0.5 * effort(robot, extremes(robot))
            still = max(1e-4, 3 * float(np.max(hardware.position_noise)))
            # A velocity predicted a horizon ahead: 1 rad/s^2 is what it tells from rest.
            compensation = FrictionCompensation(regressors, limit, speed=gains.horizon, tolerance=still)
        return cls(
            regressors=regressors,
            regression=ForceBalance(
                regressors,
                gains.pole,
                gains.row_weight,
                stiction_speed=max(0.01, 5 * float(np.max(hardware.velocity_noise))),
                compiled=compiled,
            ),
            extension=LeastSquares(gains.alpha, gains.beta, gains.xi, gains.f0, compiled),
            mixing=Directional(compiled),
            law=CompositeLaw(Gamma=gains.Gamma, Upsilon=gains.Upsilon, compiled=compiled),
            control=FiniteTimePD(gains.P, gains.D, gains.D_L, horizon=gains.horizon, compiled=compiled),
            effort_limit=robot.effort_limit,
            detector=ChangeDetector(),
            gains=gains,
            compensation=compensation,
            nominal_dt=dt,
            disturbance=None if compensation else DisturbanceEstimate.for_horizon(gains.horizon),
        )

    @property
    def robot(self) -> Robot:
        return self.regressors.robot

    def init(
        self, measurement: Measurement, theta0: Sequence[float] | np.ndarray | None = None
    ) -> ControllerState:
        """Filters at rest at the first measurement, theta_U = theta0 (n_potential,), or zero."""
        measurement = self.robot.check_measurement(measurement)
        j = self.regressors.n_potential
        theta = np.zeros(j) if theta0 is None else require_vector("theta0", theta0, j)
        filters = self.regression.init(measurement)
        information = self.extension.init(len(self.regressors))
        mixed = self.mixing.mix(information, j)
        empty = Regression(filters.y, filters.omega)
        excitation = self._monitor.init(np.size(mixed.delta))
        change = self.detector.init(information, j) if self.detector else None
        compensation = self.compensation.init() if self.compensation else None
        disturbance = self.disturbance.init(self.robot.nv) if self.disturbance else None
        return ControllerState(
            measurement, theta, filters, empty, information, mixed, excitation, change, compensation,
            disturbance,
        )  # fmt: skip

    def step(
        self, state: ControllerState, measurement: Measurement, goal: np.ndarray, dt: float
    ) -> tuple[ControllerState, np.ndarray]:
        """The state at ``measurement`` and the torque (nv,) [N m] to hold until the next one.

        goal: q_d (nq,). dt [s]: time since the measurement before, and until the next. What the time stamps
        say is what counts: a measurement with the stamp of the last one (as the first after `init`) is the
        same sample, and nothing is advanced; one that is late or early by up to half of dt advances
        everything by the true time; with a larger gap the torque in between is not known, so the filters
        start afresh, which makes them exact from their next step, and the information stays.

        Raises ArgumentError for wrong shapes, numbers that are not finite or no arm's, time running back,
        and a dt that is not positive or above ten times ``nominal_dt``; the state given stays valid.
        """
        robot = self.robot
        measurement = robot.check_measurement(measurement)
        goal = robot.check_q(goal, "goal")
        dt = checked_step(dt, self.nominal_dt)
        _, q, v, _ = measurement
        e1 = pin.difference(robot.model, goal, q)
        psi = self.regressors.gravity(q, check=False)
        if measurement.t != state.measurement.t:
            state = self._advance(state, measurement, psi, e1, dt)
        mass_matrix = robot.mass_matrix(q, check=False)
        tau = self._line.torque(state, psi, e1, v, mass_matrix, dt) if self._line else None
        return state, self._torque(state, psi, e1, v, mass_matrix, dt) if tau is None else tau

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

        Weighed by least squares on what was seen before and since. Standard deviations are those of noise
        in the measured velocity, which the filters leave white. Where `for_robot` was told of noise, what
        the arm's motion does not tell above it is not identified: at rest the place of the load along the
        vertical; a move tells it. Raises ArgumentError when the controller has noticed no change.
        """
        change = state.change
        if change is None or change.noticed == 0:
            raise ArgumentError(
                "state: expected one in which a change was noticed; state.change says none was"
            )
        rows = state.filters.y.size * max(1, change.steps)
        before = completed(change.theta_before, change.information_before)
        after = completed(state.theta, state.information)
        samples = rows if rows > len(self.regressors) else None
        xi = getattr(self.extension, "xi", QUIET_XI)
        return estimate_payload(
            self.regressors, before, after, state.information, change.information_before,
            samples=samples, floor=1 / xi if xi < QUIET_XI else 0.0, frame=frame,
        )  # fmt: skip

    def carried(self, state: ControllerState, frame: str | None = None) -> PayloadEstimate:
        """What the arm carries beyond the URDF's own bodies, in ``frame`` (the tool if None).

        The estimate less the URDF's parameters, where it was excited; right if the URDF's masses are.
        """
        regressors = self.regressors
        nominal = regressors.theta_potential
        return estimate_payload(regressors, nominal, state.theta, state.information, frame=frame)

    @functools.cached_property
    def _monitor(self) -> GateMonitor:
        return GateMonitor(self.law.b, self.law.d)

    @functools.cached_property
    def _line(self) -> CompiledLine | None:
        return CompiledLine.of(self)

    def _torque(
        self, state: ControllerState, psi: np.ndarray, e1: np.ndarray, v: np.ndarray, mass_matrix: np.ndarray,
        dt: float,
    ) -> np.ndarray:  # fmt: skip
        """The torque (nv,) [N m] of feedback and feed-forward, clipped. Raises ArgumentError, not finite."""
        horizon = max(dt, getattr(self.control, "horizon", None) or dt)
        if self.disturbance and state.disturbance is not None:
            v = self.disturbance.velocity(state.disturbance, v, mass_matrix, horizon)
        v = require_vector("velocity that the control law starts from", v, self.robot.nv)
        feedback = self.control.torque(e1, v, mass_matrix, dt)
        if self.compensation and state.compensation:
            predicted = v + horizon * np.linalg.solve(mass_matrix, feedback)
            feedback = feedback + self.compensation.torque(state.compensation, v, predicted)
        wanted = require_vector("torque of the control law", feedback + psi @ state.theta, self.robot.nv)
        limit = self.effort_limit
        return np.minimum(np.maximum(wanted, -limit), limit)  # a third of np.clip's time

    def _mix(self, information: Any, before: MixedRegression) -> MixedRegression:
        j = self.regressors.n_potential
        if isinstance(self.mixing, Directional) and self.mixing.compiled:
            return self.mixing.mix(information, j, before)
        return self.mixing.mix(information, j)

    def _advance(
        self, state: ControllerState, measurement: Measurement, psi: np.ndarray, e1: np.ndarray, dt: float
    ) -> ControllerState:
        before, information, change = state.measurement, state.information, state.change
        dt, gap = elapsed(before.t, measurement.t, dt)
        if self._line and not gap:
            following = self._line.advance(state, measurement, psi, e1, dt)
            if following:
                return following
        if gap:
            filters = self.regression.init(measurement)
            regression = Regression(filters.y, filters.omega)
        else:
            filters, regression = self.regression.step(state.filters, measurement, dt)
            information = self.extension.step(information, regression, dt)
        if self.detector and change and not gap:
            change = self.detector.step(
                change, state.information, information, state.theta, measurement.t, dt
            )
            if change.noticed > state.change.noticed:  # type: ignore[union-attr]
                filters = self.regression.init(measurement)
                regression = Regression(filters.y, filters.omega)
                information = self.extension.init(len(self.regressors))
        mixed = self._mix(information, state.mixed)
        excitation = self._monitor.step(state.excitation, mixed, dt)
        free = np.abs(measurement.tau) < self.effort_limit
        theta = self.law.step(
            state.theta, psi, free * e1, free * measurement.v, mixed, dt, excitation.gates
        )  # fmt: skip
        compensation = state.compensation
        if self.compensation and compensation and not gap:
            known = psi @ theta
            compensation = self.compensation.step(
                compensation, information, before, measurement, known, e1, dt
            )
        disturbance = state.disturbance
        if self.disturbance and disturbance is not None and not gap:
            _, q, v, tau = measurement
            inertial = self.robot.inertial_torque(q, v, (v - before.v) / dt)
            feedback = tau - psi @ state.theta
            disturbance = self.disturbance.step(disturbance, inertial, feedback, dt)
        return ControllerState(
            measurement, theta, filters, regression, information, mixed, excitation, change, compensation,
            disturbance,
        )  # fmt: skip
