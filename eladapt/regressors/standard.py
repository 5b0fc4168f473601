"""Regressors in the standard parameters: ten a body, and one for each rotor.

Order: [m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] about the joint frame's origin, for each
moving body, then the rotor inertia of each joint that has one, or of every joint. Nothing here is
differenced.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.robot.model import Robot
from eladapt.scratch import Scratch

ZERO = 1e-12  # relative to the largest parameter

BODY_LABELS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


class StandardRegressors:
    """Kinetic and potential regressors in the s standard parameters of a robot.

    every_rotor: whether each joint has a rotor inertia, or only those to which the model gives one.
    """

    def __init__(self, robot: Robot, *, every_rotor: bool = False):
        self.robot = robot
        self._scratch = Scratch(robot.model.createData)
        self._weightless = robot.weightless
        self.rotors = np.arange(robot.nv) if every_rotor else np.flatnonzero(robot.armature)  # their joints
        self._rotor_columns = np.eye(robot.nv)[:, self.rotors]
        self._still = np.zeros(robot.nv)
        self.n_body_parameters = 10 * (robot.model.njoints - 1)

    @property
    def parameters(self) -> np.ndarray:
        """(s,) the values in the URDF."""
        return self.parameters_of(self.robot.model)

    def parameters_of(self, model: pin.Model) -> np.ndarray:
        """(s,) of a model with the same joints."""
        bodies = [inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]]
        return np.concatenate([*bodies, np.array(model.armature)[self.rotors]])

    @property
    def absent(self) -> np.ndarray:
        """Indices of the parameters that the robot's symmetry makes zero.

        Raises UnknownNameError for a name that is none, ArgumentError where the URDF says otherwise.
        """
        labels, names = self.labels, self.robot.zero_parameters
        unknown = [name for name in names if name not in labels]
        if unknown:
            raise UnknownNameError("standard parameter", unknown, labels)
        indices = np.array([labels.index(name) for name in names], dtype=int)
        values = self.parameters
        for name, index in zip(names, indices, strict=True):
            if abs(values[index]) > ZERO * np.abs(values).max():
                raise ArgumentError(f"zero_parameters: {name} is {values[index]:g} in the URDF, expected 0")
        return indices

    @property
    def labels(self) -> list[str]:
        names = self.robot.joint_names
        bodies = [f"{label}({name})" for name in names for label in BODY_LABELS]
        return bodies + [f"Ir({names[i]})" for i in self.rotors]

    def bodies(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, *, weight: bool = True) -> np.ndarray:
        """(nv, 10 bodies): the regressor of M a + C v + g without rotors; without g unless ``weight``."""
        model = self.robot.model if weight else self._weightless
        found = pin.computeJointTorqueRegressor(model, self._scratch.own, q, v, a)
        # Pinocchio's bindings return an only row as a vector.
        return found if self.robot.nv > 1 else found.reshape(1, -1)

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(nv, s): the regressor of M a + C v + g."""
        return self._with_rotors(self.bodies(q, v, a), a)

    def kinetic_torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(nv, s): the regressor of M a + C v."""
        return self._with_rotors(self.bodies(q, v, a, weight=False), a)

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """(nv, s): the regressor of g; the potential energy's gradient."""
        return self.torque(q, self._still, self._still)

    def kinetic_gradient(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(nv, 10 bodies): [1/2 grad_q v' M_k v]_k = sum_i (dv_i/dq)' H(v_i), v_i the velocity of body i
        and H(v_i) = bodyRegressor(0, v_i) its momentum's regressor; rotors have none."""
        model, data = self.robot.model, self._scratch.own
        pin.computeForwardKinematicsDerivatives(model, data, q, v, v)
        gradient = np.zeros((model.nv, self.n_body_parameters))
        still = pin.Motion.Zero()
        for joint in range(1, model.njoints):
            by_position, _ = pin.getJointVelocityDerivatives(model, data, joint, pin.LOCAL)
            momentum = pin.bodyRegressor(still, data.v[joint])
            by_joint = np.reshape(by_position, (6, model.nv)).T
            gradient[:, 10 * (joint - 1) : 10 * joint] = by_joint @ momentum
        return gradient

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(s,): the regressor of 1/2 v' M v."""
        bodies = pin.computeKineticEnergyRegressor(self.robot.model, self._scratch.own, q, v)
        return np.concatenate([bodies, 0.5 * v[self.rotors] ** 2])

    def potential_energy(self, q: np.ndarray) -> np.ndarray:
        """(s,): the regressor of U."""
        bodies = pin.computePotentialEnergyRegressor(self.robot.model, self._scratch.own, q)
        return np.concatenate([bodies, np.zeros(len(self.rotors))])

    def _with_rotors(self, bodies: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(nv, s)"""
        return np.hstack([bodies, self._rotor_columns * a[:, None]]) if len(self.rotors) else bodies


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """(4, 4) pseudo-inertia [[S, m c], [m c', m]] of a body's ten parameters in the order above, S the second
    moments of its mass; positive definite for a body that can be."""
    inertia = np.zeros((3, 3))
    inertia[np.tril_indices(3)] = parameters[4:]
    inertia = inertia + np.tril(inertia, -1).T
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return np.block([[second, parameters[1:4, None]], [parameters[None, 1:4], parameters[:1, None]]])
