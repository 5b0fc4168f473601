"""Controllers that learn nothing: computed torque, and the joint impedance of a maker's example."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import eladapt as ea
from eladapt.robot.protocols import Goal, Unrecorded

NATURAL = 20.0  # [rad/s] of computed torque, critically damped
STIFFNESS = np.array([600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0])  # [N m/rad]
DAMPING = np.array([50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0])  # [N m s/rad]


@dataclass(frozen=True, eq=False)
class Stateless(Unrecorded, ABC):
    """A torque that depends on measurement and reference alone, held to the effort limits."""

    robot: ea.Robot

    @abstractmethod
    def torque(self, measurement: ea.Measurement, reference: ea.Reference) -> np.ndarray:
        """(nv,) [N m]"""

    def init(self, measurement: ea.Measurement, theta0: object = None) -> None:
        return None

    def step(
        self, state: None, measurement: ea.Measurement, goal: Goal, dt: float
    ) -> tuple[None, np.ndarray]:
        tau = self.torque(measurement, self.robot.check_goal(goal))
        return None, np.clip(tau, -self.robot.effort_limit, self.robot.effort_limit)


@dataclass(frozen=True, eq=False)
class ComputedTorque(Stateless):
    """tau = M (a_d - w^2 e1 - 2 w e2) + C v + g of the URDF."""

    def torque(self, measurement: ea.Measurement, reference: ea.Reference) -> np.ndarray:
        """(nv,) [N m]"""
        _, q, v, _ = measurement
        e1, e2 = self.robot.difference(reference.q, q), v - reference.v
        return self.robot.inverse_dynamics(q, v, reference.a - NATURAL**2 * e1 - 2 * NATURAL * e2)


@dataclass(frozen=True, eq=False)
class JointImpedance(Stateless):
    """tau = K (q_d - q) - D v + C v + g, with stiffness and damping of the maker's example for a Panda.

    gravity: g of the firmware, q (7,) -> (7,) [N m].
    """

    gravity: Callable[[np.ndarray], np.ndarray]

    def torque(self, measurement: ea.Measurement, reference: ea.Reference) -> np.ndarray:
        """(7,) [N m]"""
        _, q, v, _ = measurement
        spring = -STIFFNESS * self.robot.difference(reference.q, q)
        return spring - DAMPING * v + self.robot.coriolis_matrix(q, v) @ v + self.gravity(q)
