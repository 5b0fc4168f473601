"""The default controller's line in two compiled calls, between those of Pinocchio.

What the blocks do one after the other is done here in the same order by the same kernels; what is saved is
the way between them, a third of a step on two links and a fifth on a Panda. `CompiledLine.of` tells which
controllers have one: all blocks compiled, none exchanged, no friction columns. What is not ordinary (a change
that is noticed, a result that is not finite) is left to the blocks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eladapt.compiling import compiled
from eladapt.control.disturbance import DisturbanceEstimate
from eladapt.control.finite_time import FiniteTimePD
from eladapt.control.proximal import command
from eladapt.control.state import ControllerState
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.estimation.change import ChangeDetector
from eladapt.estimation.excitation import Excitation
from eladapt.estimation.extensions import Information, LeastSquares
from eladapt.estimation.mixing import DUST, Directional
from eladapt.estimation.regressions import FilterState, ForceBalance
from eladapt.estimation.triangle import kernels
from eladapt.signals import Measurement, MixedRegression, Regression

if TYPE_CHECKING:
    from eladapt.control.composite import CompositeController

BLOCKS = {
    "regression": ForceBalance,
    "extension": LeastSquares,
    "mixing": Directional,
    "law": CompositeLaw,
    "control": FiniteTimePD,
}


class CompiledLine:
    """`advance` and `torque` of one controller, whose gains it holds as the kernels want them."""

    def __init__(self, controller: CompositeController):
        nv = controller.robot.nv
        regression, extension, law, control = (
            controller.regression, controller.extension, controller.law, controller.control,
        )  # fmt: skip
        assert isinstance(regression, ForceBalance)
        assert isinstance(extension, LeastSquares)
        assert isinstance(control, FiniteTimePD)
        assert controller.disturbance is not None
        assert controller.detector is not None
        self.effort_limit = limit = np.array(controller.effort_limit)
        self.robot, self.regression, self.detector = controller.robot, regression, controller.detector
        self.extension, self.horizon = extension, control.horizon or 0.0
        self.gains = (
            regression.pole, np.array(regression.weight), extension.alpha, extension.beta, extension.xi, DUST,
            law.b + law.d, law.b, *law.direct_factors, *law.vectors, limit, controller.disturbance.memory,
        )  # fmt: skip
        P, D, D_L = (np.array(np.broadcast_to(gain, nv)) for gain in (control.P, control.D, control.D_L))
        self.feedback = (P, D, D_L, control.a, control.b)

    @classmethod
    def of(cls, controller: CompositeController) -> CompiledLine | None:
        """The line of a controller whose blocks are the default ones, all compiled; None for any other."""
        parts = [(getattr(controller, name), kind) for name, kind in BLOCKS.items()]
        ordinary = (
            all(type(part) is kind and getattr(part, "compiled", False) for part, kind in parts)
            and controller.regression.interpolation == "linear"  # type: ignore[attr-defined]
            and controller.control.evaluation == "semi_implicit"  # type: ignore[attr-defined]
            and controller.law.bounds is None
            and type(controller.detector) is ChangeDetector
            and type(controller.disturbance) is DisturbanceEstimate
            and controller.regressors.n_potential > 0
            and not (controller.compensation or controller.regressors.n_friction)
        )
        return cls(controller) if ordinary else None

    def advance(
        self, state: ControllerState, measurement: Measurement, psi: np.ndarray, e1: np.ndarray, dt: float
    ) -> ControllerState | None:
        """The state at ``measurement``, or None where a change is noticed: the blocks know what to do.

        None too for a state of another controller: one that lacks what this one remembers, or whose mixing
        has other gates.
        """
        before = state.change
        gates_fit = state.excitation.integral.shape == state.theta.shape
        if before is None or state.disturbance is None or not gates_fit:
            return None
        filters, information, mixed = state.filters, state.information, state.mixed
        t, q, v, tau = measurement
        one, two = self.regression.forces(filters, q, v, dt)
        inertial = self.robot.inertial_torque(q, v, (v - state.measurement.v) / dt)
        found = kernels().advance(
            filters.omega, filters.y, information.triangle, information.prior, information.weakest,
            mixed.basis, state.excitation.integral, state.theta, state.disturbance, one, two, tau, v, psi, e1,
            inertial, dt, *self.gains,
        )  # fmt: skip
        y, omega, triangle, kept, innovation, weakest, *mix, gates, integral, theta, disturbance = found
        self.extension.require_kept(kept, dt)
        after = Information(triangle, kept * information.prior, 1.0, innovation, weakest)
        change = self.detector.step(before, information, after, state.theta, t, dt)
        if change.noticed > before.noticed:
            return None
        return ControllerState(
            measurement, theta, FilterState(q, v, y, omega), Regression(y, omega), after,
            MixedRegression(*mix), Excitation(gates, integral), change, None, disturbance,
        )  # fmt: skip

    def torque(
        self, state: ControllerState, psi: np.ndarray, e1: np.ndarray, v: np.ndarray, mass_matrix: np.ndarray,
        dt: float,
    ) -> np.ndarray | None:  # fmt: skip
        """The torque (nv,) [N m], or None where it would not be finite, or for another controller's state."""
        if state.disturbance is None:
            return None
        horizon = max(dt, self.horizon)
        found, finite = compiled(command)(
            e1, v, mass_matrix, state.disturbance, psi, state.theta, *self.feedback, horizon,
            self.effort_limit,
        )  # fmt: skip
        return found if finite else None
