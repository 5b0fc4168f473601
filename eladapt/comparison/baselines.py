"""What an engineer compares with: adaptive PD, PD with known gravity, and the indirect scheme."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.control.blocks import ControlBlock
from eladapt.control.composite import CompositeController
from eladapt.control.finite_time import FiniteTimePD
from eladapt.errors import ArgumentError
from eladapt.robot.model import Robot
from eladapt.robot.protocols import Goal, Unrecorded
from eladapt.signals import Measurement


def adaptive_pd(controller: CompositeController, faster: float = 20.0) -> CompositeController:
    """Tomei's adaptive PD: the same gains with a = b = 1, the direct term alone and nothing else that learns.

    ``faster`` multiplies Gamma, since that term now has all to learn: 20 is where the two-link arm
    settles soonest. Raises ArgumentError for a controller with another law than `FiniteTimePD`.
    """
    if not isinstance(controller.control, FiniteTimePD):
        raise ArgumentError(f"control: expected a FiniteTimePD, got {type(controller.control).__name__}")
    law = dataclasses.replace(
        controller.law, b=1.0, indirect=False, Gamma=faster * np.asarray(controller.law.Gamma)
    )
    control = dataclasses.replace(controller.control, linear=True)
    return dataclasses.replace(
        controller, control=control, law=law, detector=None, disturbance=None, joints=None, rest_speed=0.0
    )


def indirect(controller: CompositeController) -> CompositeController:
    """The indirect scheme: the same controller, whose estimate follows the mixed regression alone."""
    return dataclasses.replace(controller, law=dataclasses.replace(controller.law, direct=False))


class KnownGravityState(NamedTuple):
    """A PD law remembers nothing but what it saw."""

    measurement: Measurement


@dataclass(frozen=True, eq=False)
class KnownGravityPD(Unrecorded):
    """tau = control law + g(q), with g from the URDF: what a perfect model gives."""

    robot: Robot
    control: ControlBlock

    def init(self, measurement: Measurement, theta0: object = None) -> KnownGravityState:
        """Nothing to estimate, wherever it should start."""
        return KnownGravityState(self.robot.check_measurement(measurement))

    def step(
        self, state: KnownGravityState, measurement: Measurement, goal: Goal, dt: float
    ) -> tuple[KnownGravityState, np.ndarray]:
        """The torque (nv,) to hold for dt [s], within the effort limits; of a goal that moves, to q_d."""
        measurement = self.robot.check_measurement(measurement)
        _, q, v, _ = measurement
        e1 = self.robot.difference(self.robot.check_goal(goal).q, q)
        tau = self.control.torque(e1, v, self.robot.mass_matrix(q), dt) + self.robot.gravity(q)
        limit = self.robot.effort_limit
        return KnownGravityState(measurement), np.clip(tau, -limit, limit)
