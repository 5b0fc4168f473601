"""The composite adaptive controller: regression, extension, mixing, law and control, in line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from eladapt.control.blocks import ControlBlock, ExtensionBlock, RegressionBlock
from eladapt.control.disturbance import DisturbanceEstimate
from eladapt.control.finite_time import FiniteTimePD
from eladapt.control.learned_joints import LearnedJoints
from eladapt.control.learning import advanced, joint_inertia, snapshot
from eladapt.control.patience import Patience
from eladapt.control.reports import carried
from eladapt.control.starting import friction_bounds, starting_parameters
from eladapt.control.state import ControllerState
from eladapt.control.stepping import Sample, checked_step, clipped
from eladapt.errors import ArgumentError, require_gain, require_vector
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.estimation.change import ChangeDetector
from eladapt.estimation.contact import ContactDetector
from eladapt.estimation.extensions import SubspaceLeastSquares
from eladapt.estimation.mistimed import MistimedSteps
from eladapt.estimation.mixing import Mixing, Unmixed, spectrum
from eladapt.estimation.regressions import ForceBalance
from eladapt.gains.derived import Gains, derive_gains
from eladapt.gains.extremes import effort, extremes
from eladapt.gains.sensing import Hardware
from eladapt.regressors.joint_terms import JOINT_TERMS
from eladapt.regressors.regressors import Regressors
from eladapt.robot.joint_limits import require_limit, speed
from eladapt.robot.model import Robot
from eladapt.signals import Measurement, MixedRegression, Reference, Regression

RIPPLE = 0.01  # of the effort limit: what makes a joint swing
SLOW = 0.02  # of its speed limit: what a joint that breaks loose has not reached


@dataclass(frozen=True, eq=False)
class CompositeController:
    """(278) with (318): finite-time regulation and tracking that learns the whole theta on the way.

    tau = control law (e1, e2) + W_r(q, v, v_d, a_d) theta, e1 = q - q_d, e2 = v - v_d. At a set-point W_r
    theta is Psi theta_U and what the joint offsets add: (278) to the letter. What the paper proves, it proves
    for set-points; that the same law follows a moving reference is measured (benchmarks/results/tracking.md).

    control: `FiniteTimePD`, or any law with its ``torque`` and ``b``; b must agree with law.b (c = b).
    joints: what has been learned of rotors and viscous friction, which the law's M(q) has beside the URDF's
    links. effort_limit (nv,) [N m]: the torque is clipped to it; the estimator sees the torque that was
    applied, so clipping corrupts nothing, and the direct term rests in the joints whose torque is clipped.
    detector: notices a load that comes or goes; filters and information then start afresh, and the estimate
    goes on from where it was. disturbance: feeds forward what the model does not explain. touch: tells a
    contact from a load, and lets learning rest while it lasts. timing: leaves out steps whose time stamps are
    wrong. patience: looks further ahead where a delay that nobody told makes the loop swing. gains: which
    rule set each gain, where `for_robot` did. rest_speed [rad/s]: a joint that is slower feeds no direct
    term, which would integrate noise and stiction as long as the arm rests; what pushes it is the
    disturbance's. nominal_dt [s]: the step that the gains were made for, None if any will do.
    """

    regressors: Regressors
    regression: RegressionBlock
    extension: ExtensionBlock
    mixing: Mixing
    law: CompositeLaw
    control: ControlBlock
    joints: LearnedJoints | None = None
    effort_limit: float | np.ndarray = np.inf
    detector: ChangeDetector | None = None
    disturbance: DisturbanceEstimate | None = None
    touch: ContactDetector | None = None
    timing: MistimedSteps | None = None
    patience: Patience | None = None
    gains: Gains | None = None
    rest_speed: float = 0.0
    nominal_dt: float | None = None

    def __post_init__(self) -> None:
        nv, j = self.regressors.robot.nv, self.regressors.n_potential
        for name in ("Gamma", "Upsilon"):
            if np.ndim(getattr(self.law, name)):
                require_gain(name, getattr(self.law, name), j)
        self.law.check_bounds(j, len(self.regressors))
        if isinstance(self.control, FiniteTimePD):
            self.control.gains(nv)
        if abs(self.law.b - self.control.b) > 1e-12:
            raise ArgumentError(
                f"law.b: expected the control law's exponent b = {self.control.b:g} (c = b, (471)), "
                f"got {self.law.b:g}"
            )
        if isinstance(self.mixing, Unmixed) and not self.law.scalar_rate:
            raise ArgumentError("Gamma, Upsilon: Unmixed needs one common value of Gamma * Upsilon")
        object.__setattr__(self, "effort_limit", require_limit("effort_limit", self.effort_limit, nv))

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
        jitter: float = 0.0,
        joint_terms: Sequence[str] = JOINT_TERMS,
        **given: Any,
    ) -> CompositeController:
        """Every gain derived from the URDF, for steps of dt [s]; those ``given`` by name are kept.

        The whole theta is learned: bodies, and of each joint its rotor, viscous and Coulomb friction and
        offset (`joint_terms` leaves some out).

        position_noise [rad], velocity_noise [rad/s]: standard deviations, scalar or (nv,); delay [s]: from a
        measurement to the torque that answers it, beyond the step; velocity_lag [s]: of a filter in the
        measured velocity; jitter [s]: what time stamps are off by. What is known of them goes in here, see
        `eladapt.gains.sensing.Hardware`; the control law's horizon, the noise floor of the rows and how slow
        a joint counts as stuck follow from it.

        Names: P, D, D_L, rotors, horizon, pole, row_weight, alpha, beta, f0, floor, stiction_speed, Gamma,
        Upsilon, disturbance_limit, moving_limit, memory, tolerance, still_speed, in the units of
        `eladapt.gains.derived.Gains`. ``print(controller.gains)`` says which rule set each. Raises
        ArgumentError, with the joint and a dt that would do, for an arm that cannot be controlled at dt.
        """
        regressors = Regressors(robot, joint_terms=joint_terms)
        hardware = Hardware(position_noise, velocity_noise, delay, velocity_lag, jitter)
        gains = derive_gains(regressors, dt, given, hardware)
        limit = effort(robot, extremes(robot))
        slow = SLOW * speed(robot.velocity_limit) if regressors.coulomb else None
        return cls(
            regressors=regressors,
            regression=ForceBalance(
                regressors, gains.pole, gains.row_weight, stiction_speed=gains.stiction_speed
            ),
            extension=SubspaceLeastSquares(gains.alpha, gains.beta, gains.f0, gains.floor),
            mixing=Unmixed(),
            law=CompositeLaw(
                Gamma=gains.Gamma,
                Upsilon=gains.Upsilon,
                bounds=friction_bounds(regressors, gains.friction_limit, gains.offset_limit),
            ),
            control=FiniteTimePD(gains.P, gains.D, gains.D_L, horizon=gains.horizon),
            joints=LearnedJoints(regressors, gains.rotors, gains.horizon, gains.alpha, gains.pole),
            effort_limit=robot.effort_limit,
            detector=ChangeDetector(slow=slow, pole=gains.pole),
            disturbance=DisturbanceEstimate(
                gains.disturbance_limit,
                gains.moving_limit,
                gains.memory,
                gains.tolerance,
                gains.still_speed,
            ),
            touch=ContactDetector(regressors, limit),
            timing=MistimedSteps(gains.pole),
            patience=Patience(RIPPLE * limit),
            gains=gains,
            rest_speed=gains.stiction_speed,
            nominal_dt=dt,
        )

    def __repr__(self) -> str:
        blocks = (self.regression, self.extension, self.mixing, self.law, self.control)
        names = ", ".join(type(block).__name__ for block in blocks)
        return f"CompositeController({self.robot.name}, {len(self.regressors)} parameters: {names})"

    @property
    def robot(self) -> Robot:
        """The arm as its file has it."""
        return self.regressors.robot

    def init(
        self,
        measurement: Measurement,
        theta0: Literal["urdf", "zero"] | Sequence[float] | np.ndarray | None = "urdf",
    ) -> ControllerState:
        """Filters at rest at the first measurement.

        theta0: "urdf", the robot file's own parameters; "zero"; (l,) the whole theta, or (n_potential,)
        theta_U, with the URDF's for the rest.
        """
        measurement = self.robot.check_measurement(measurement)
        theta = starting_parameters(theta0, self.regressors, "urdf")
        filters = self.regression.init(measurement)
        information = self.extension.init(len(self.regressors))
        state = ControllerState(
            measurement=measurement,
            parameters=theta,
            n_potential=self.regressors.n_potential,
            filters=filters,
            regression=Regression(filters.y, filters.omega),
            information=information,
            disturbance=self.disturbance.init(self.robot.nv) if self.disturbance else None,
            noise=np.zeros(len(filters.y)),
            ripple=self.patience.init(self.robot.nv) if self.patience else None,
            steps=self.timing.init(self.robot.nv) if self.timing else None,
            inertia=np.zeros(self.robot.nv) if self.joints else None,
        )
        if self.detector:
            state = state._replace(change=self.detector.init(snapshot(state), self.robot.nv))
        return state._replace(contact=self.touch.init()) if self.touch else state

    def step(
        self, state: ControllerState, measurement: Measurement, goal: np.ndarray | Reference, dt: float
    ) -> tuple[ControllerState, np.ndarray]:
        """The state at ``measurement`` and the torque (nv,) [N m] to hold until the next one.

        goal: q_d (nq,), or a `Reference`. dt [s]: time since the measurement before, and until the next. What
        the time stamps say is what counts: a measurement with the stamp of the last one (as the first after
        `init`) is the same sample, and nothing is advanced; one that is late or early by up to half of dt
        advances everything by the true time; with a larger gap the torque in between is not known, so the
        filters start afresh, which makes them exact from their next step, and the information stays. So they
        do where ``timing`` finds that a stamp is wrong.

        Raises ArgumentError for wrong shapes, numbers that are not finite or no arm's, time running back,
        and a dt that is not positive or above ten times ``nominal_dt``; the state given stays valid.
        """
        robot = self.robot
        measurement = robot.check_measurement(measurement)
        reference = robot.check_goal(goal)
        dt = checked_step(dt, self.nominal_dt)
        _, q, v, _ = measurement
        e1, e2 = pin.difference(robot.model, reference.q, q), v - reference.v
        regressor = self.regressors.slotine_li(q, v, reference.v, reference.a, check=False)
        mass_matrix = robot.mass_matrix(q, check=False)
        if self.joints:
            diagonal = mass_matrix.ravel(order="K")[:: robot.nv + 1]  # a view, whatever the order in memory
            diagonal += joint_inertia(self, state)
        if measurement.t != state.measurement.t:
            moving = mass_matrix if reference.v.any() or reference.a.any() else None
            state = advanced(self, state, Sample(measurement, regressor, e1, e2, moving), dt)
            if self.patience and state.ripple:
                state = state._replace(ripple=self.patience.step(state.ripple, e1, e2, mass_matrix, dt))
        feedback = self._feedback(state, e1, e2, mass_matrix, dt)
        wanted = feedback + regressor @ state.parameters
        if state.disturbance is not None:
            wanted += state.disturbance
        wanted = require_vector("torque of the control law", wanted, robot.nv)
        return state, clipped(wanted, self.effort_limit)

    def _feedback(
        self, state: ControllerState, e1: np.ndarray, e2: np.ndarray, mass_matrix: np.ndarray, dt: float
    ) -> np.ndarray:
        """(nv,) [N m] of the control law, which looks further ahead where it has a horizon that may grow."""
        if state.ripple and isinstance(self.control, FiniteTimePD):
            return self.control.torque(e1, e2, mass_matrix, dt, state.ripple.ahead)
        return self.control.torque(e1, e2, mass_matrix, dt)

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of all parameters, see `Regressors.labels`."""
        return self.regressors.labels

    def recorded(self, state: ControllerState) -> dict[str, np.ndarray]:
        """What a record keeps of every sample."""
        innovation = np.asarray(getattr(state.information, "innovation", np.nan))
        kept = {"parameters": state.parameters, "theta": state.theta, "innovation": innovation}
        return {**kept, "external": state.external} if state.contact else kept

    def reviewed(self, state: ControllerState, frame: str | None) -> dict[str, np.ndarray]:
        """What a record keeps 30 times a second: how much of gravity is known, and the load."""
        gates = spectrum(state.information, state.n_potential, "potential").gates
        kept = {"excitation": gates}
        if frame is not None or (state.change and state.change.noticed):
            load = carried(self, state, frame)
            kept["carried"] = np.array([load.mass, *load.com, load.misfit])
        return kept

    def true_parameters(self, model: pin.Model) -> np.ndarray:
        """(l,) what theta should become on an arm with this model."""
        return self.regressors.theta_of(model)

    def mixed(self, state: ControllerState) -> MixedRegression:
        """(Y, gain) that theta followed at ``state``: for records and theory, made when asked for."""
        return self.mixing.mix(state.information, self.regressors.n_potential)
