"""Regressors in the standard parameters: ten a body, and one for each rotor.

Order: [m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] about the joint frame's origin, for each
moving body, then the armature of each joint that has one. Nothing here is differenced.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.robot.model import Robot

ZERO = 1e-12  # relative to the largest parameter

BODY_LABELS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


class StandardRegressors:
    """Kinetic and potential regressors in the s standard parameters of a robot."""

    def __init__(self, robot: Robot):
        self.robot = robot
        self._data = robot.model.createData()
        self._weightless = robot.weightless
        self._rotors = np.flatnonzero(robot.armature)
        self._rotor_columns = np.eye(robot.nv)[:, self._rotors]
        self._still = np.zeros(robot.nv)

    @property
    def parameters(self) -> np.ndarray:
        """(s,) the values in the URDF."""
        bodies = [inertia.toDynamicParameters() for inertia in list(self.robot.model.inertias)[1:]]
        return np.concatenate([*bodies, self.robot.armature[self._rotors]])

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
        return bodies + [f"Ir({names[i]})" for i in self._rotors]

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(nv, s): the regressor of M a + C v + g; with leading axes, of as many states."""
        if q.ndim > 1:
            return np.array([self.torque(*state) for state in zip(q, v, a, strict=True)])
        bodies = pin.computeJointTorqueRegressor(self.robot.model, self._data, q, v, a)
        return self._with_rotors(bodies, a)

    def kinetic_torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(nv, s): the regressor of M a + C v."""
        bodies = pin.computeJointTorqueRegressor(self._weightless, self._data, q, v, a)
        return self._with_rotors(bodies, a)

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """(nv, s): the regressor of g; the potential energy's gradient."""
        return self.torque(q, self._still, self._still)

    def momentum(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(nv, s): [M_k(q) v]_k, the torque of the acceleration v from rest without weight."""
        return self.kinetic_torque(q, self._still, v)

    def kinetic_gradient(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(nv, s): [1/2 grad_q v' M_k v]_k = sum_i (dv_i/dq)' H(v_i), v_i the velocity of body i
        and H(v_i) = bodyRegressor(0, v_i) its momentum's regressor; rotors add nothing."""
        model, data = self.robot.model, self._data
        pin.computeForwardKinematicsDerivatives(model, data, q, v, v)
        gradient = np.zeros((model.nv, 10 * (model.njoints - 1) + len(self._rotors)))
        still = pin.Motion.Zero()
        for joint in range(1, model.njoints):
            by_position, _ = pin.getJointVelocityDerivatives(model, data, joint, pin.LOCAL)
            momentum = pin.bodyRegressor(still, data.v[joint])
            by_joint = np.reshape(by_position, (6, model.nv)).T
            gradient[:, 10 * (joint - 1) : 10 * joint] = by_joint @ momentum
        return gradient

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(s,): the regressor of 1/2 v' M v."""
        bodies = pin.computeKineticEnergyRegressor(self.robot.model, self._data, q, v)
        return np.concatenate([bodies, 0.5 * v[self._rotors] ** 2])

    def potential_energy(self, q: np.ndarray) -> np.ndarray:
        """(s,): the regressor of U."""
        bodies = pin.computePotentialEnergyRegressor(self.robot.model, self._data, q)
        return np.concatenate([bodies, np.zeros(len(self._rotors))])

    def _with_rotors(self, bodies: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(nv, s), also where Pinocchio's bindings return the only row as a vector."""
        if self.robot.nv == 1:
            bodies = bodies.reshape(1, -1)
        return np.hstack([bodies, self._rotor_columns * a[:, None]]) if len(self._rotors) else bodies
