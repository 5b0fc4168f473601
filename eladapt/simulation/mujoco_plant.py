"""The same robots simulated by MuJoCo: dynamics, integrator and friction that were written elsewhere.

MuJoCo reads the URDF by itself; its mass matrix and bias agree with Pinocchio's to 1e-12 on every robot of
the library. What differs is real: it applies the URDF's joint damping and friction. Or it is given another's
model of the same arm, of which the controller knows nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, SimulationError, needing, require_gain, require_number
from eladapt.robot.model import Robot
from eladapt.signals import Measurement
from eladapt.simulation.disturbances import Brakes, Friction, Noise, Payload
from eladapt.simulation.plants import NoiseModel, described, holding

with needing("MujocoPlant needs MuJoCo", "mujoco"):
    import mujoco

    from eladapt.simulation.mujoco_models import mjcf_models, urdf_models

Integrator = Literal["rk4", "implicitfast"]

# RK4 is stable up to h rate = 2.78 for damping of that rate [1/s]; at 2 its error is 1e-5 rad/s (xarm7).
STIFFEST = 2.0
LEAST_SUBSTEPS, MOST_SUBSTEPS = 2, 16
POSTURES = 50
# Friction is a constraint: as hard as MuJoCo allows, at rest within one substep, and then cleared of the
# compliance that would let a stuck joint creep (at 1e-5 rad/s on the panda's wrist).
HARD = (0.9999, 0.9999, 0.001, 0.5, 2.0)


class MujocoPlant:
    """A robot simulated by MuJoCo, with the face of `PinocchioPlant`.

    q0 (nq,), v0 (nv,) or None for rest. friction, noise, payload: as in `disturbances`; a bare number
    as payload is a mass [kg] at the tool frame. joint_friction: whether the URDF's (or the MJCF's) damping
    and friction act; the caller's ``friction`` is added to them. Coulomb friction is MuJoCo's dry friction
    constraint, and it sticks. armature: a number or (nv,) rotor inertias [kg m^2] in place of the model's,
    or None. seed: of the noise. brakes: what `brake` closes.

    mjcf: a path, or the text, of another's MuJoCo model of the same arm, or None. Inertias, rotors, damping,
    dry friction and gravity are then that model's; its actuators are left out, and torques act on the joints.
    Its joints are the robot's by name where names agree, the others in order, and are as many. Both models
    count positions from the same zero; their body frames and bases may differ, since the load is hung where
    the robot's frame is beside the joint axes.

    integrator, substeps: chosen where None. "rk4", with two substeps or as many as the stiffest viscous
    damping needs to be stable (eight on xarm7 at 1 ms); "implicitfast", of first order, where that would
    take more than 16. Over half a second at 25 rad/s, RK4 at 1 ms was off by 2e-8 rad, implicitfast by
    3e-2; with Coulomb friction both are of first order, 1e-3 rad at 5 rad/s.

    Joint limits are off, as in PinocchioPlant: a set-point inside them needs none, and hitting one is
    not modelled. Contacts are off too. `t`, `q` and `v` are the true state. Raises SimulationError
    when the state is not finite, UrdfError when MuJoCo refuses the robot, ArgumentError when it does not
    load the MJCF or that is of another arm.
    """

    def __init__(
        self,
        robot: Robot,
        q0: Sequence[float] | np.ndarray,
        v0: Sequence[float] | np.ndarray | None = None,
        friction: Friction | None = None,
        noise: NoiseModel | None = None,
        payload: Payload | float | None = None,
        integrator: Integrator | None = None,
        *,
        substeps: int | None = None,
        seed: int = 0,
        joint_friction: bool = True,
        mjcf: str | Path | None = None,
        armature: float | Sequence[float] | np.ndarray | None = None,
        brakes: Brakes | None = None,
    ):
        if integrator not in (None, "rk4", "implicitfast"):
            raise ArgumentError(f"integrator: expected 'rk4', 'implicitfast' or None, got {integrator!r}")
        if substeps is not None and substeps < 1:
            raise ArgumentError(f"substeps: expected at least 1, got {substeps}")
        self.robot, self.integrator, self.substeps, self.seed = robot, integrator, substeps, seed
        self.q0 = robot.check_q(np.array(q0, dtype=float), "q0")
        self.v0 = np.zeros(robot.nv) if v0 is None else robot.check_v(np.array(v0, dtype=float), "v0")
        self.friction, self.noise = friction or Friction(), noise or Noise()
        self.friction.by_joint(robot.nv)  # refuses another number of joints
        self.brakes = brakes or Brakes()
        self.joint_friction = joint_friction
        self.payload = Payload(float(payload)) if isinstance(payload, int | float) else payload
        self.mjcf = None if mjcf is None else str(mjcf)
        self.armature = None if armature is None else require_gain("armature", armature, robot.nv, zero=True)
        models = (
            urdf_models(robot, self.payload)
            if self.mjcf is None
            else mjcf_models(robot, self.mjcf, self.payload)
        )
        self._bare, self._loaded = models.bare, models.loaded
        # The same in qpos: each joint has one coordinate.
        self._addresses = self._bare.jnt_dofadr[models.joint_ids]
        self._dry: dict[bool, np.ndarray] = {}  # of the joints, by whether the model is loaded
        for model in {id(model): model for model in (self._bare, self._loaded)}.values():
            self._furnish(model)
        self._rate = self._stiffness()
        self.reset()

    def __repr__(self) -> str:
        return described(self, *(["dynamics of another's MJCF"] if self.mjcf is not None else []))

    def reset(self) -> Measurement:
        """Back to the initial state, with the noise from its seed; an arm at rest has been held there."""
        self._rng = np.random.default_rng(self.seed)
        self.t, self.q, self.v = 0.0, self.q0.copy(), self.v0.copy()
        self._told: float | None = None  # [s] when to brake
        self.tau = holding(self.robot, self.bias(self.q0, self.v0), self.v0)
        self._x = self.robot.coordinates(self.q0)
        self._model_now, self._data = self._bare, mujoco.MjData(self._bare)
        return self._measure()

    def brake(self) -> None:
        """Tell the brakes to close; they stay closed until `release` or `reset`."""
        if self._told is None:
            self._told, self._hold = self.t, self.brakes.hold(self.robot)

    def release(self) -> None:
        """Open the brakes."""
        self._told = None

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque tau (nv,) [N m] for dt [s]."""
        tau = self.robot.check_v(tau, "tau")
        dt = require_number("dt", dt, 0)
        integrator, substeps = self.scheme(dt)
        model = self._loaded if self.payload and self.payload.held(self.t) else self._bare
        if model is not self._model_now:
            self._model_now, self._data = model, mujoco.MjData(model)
        data, h = self._data, dt / substeps
        model.opt.timestep = h
        model.dof_solref[:] = (-1.0, -1.0 / h)  # friction asks for v = 0 at the end of the substep
        held = self._hold if self.brakes.closed(self._told, self.t) else 0.0
        model.dof_frictionloss[self._addresses] = self._dry[model is self._loaded] + held
        data.qpos[self._addresses], data.qvel[self._addresses] = self._x, self.v
        data.qfrc_applied[self._addresses] = tau
        # mj_step would do the same and write its warnings to a file in the working folder.
        for _ in range(substeps):
            mujoco.mj_forward(model, data)
            if integrator == "rk4":
                mujoco.mj_RungeKutta(model, data, 4)
            else:
                mujoco.mj_implicit(model, data)
        self._x, self.v = data.qpos[self._addresses], data.qvel[self._addresses]
        self.t, self.tau = self.t + dt, tau.copy()
        if not (np.isfinite(self._x).all() and np.isfinite(self.v).all()):
            raise SimulationError(f"the simulated {self.robot.name} diverged before t = {self.t:.4f} s")
        self.q = self.robot.configuration(self._x)
        return self._measure()

    def scheme(self, dt: float) -> tuple[Integrator, int]:
        """The integrator and the substeps of a step of dt [s]."""
        needed = max(LEAST_SUBSTEPS, math.ceil(dt * self._rate / STIFFEST))
        substeps = self.substeps or min(needed, MOST_SUBSTEPS)
        stable = dt * self._rate <= STIFFEST * substeps
        return self.integrator or ("rk4" if stable else "implicitfast"), substeps

    @property
    def knows_parameters(self) -> bool:
        """Whether the robot's own parameters are the true ones here: not with ``mjcf`` or other rotors."""
        rotors = self.armature is None or np.array_equal(self.armature, self.robot.armature)
        return self.mjcf is None and rotors

    @property
    def rubbing(self) -> Friction:
        """The friction that acts, with the URDF's; of another's model it is not told."""
        viscous = self.joint_friction * self.robot.damping + self.friction.viscous
        return Friction(viscous, self.joint_friction * self.robot.friction + self.friction.coulomb)

    def mass_matrix(self, q: np.ndarray, t: float = 0.0) -> np.ndarray:
        """MuJoCo's M(q) (nv, nv) in the robot's joint order, with the load if it is held at t."""
        return self._evaluate(q, np.zeros(self.robot.nv), t)[0]

    def bias(self, q: np.ndarray, v: np.ndarray, t: float = 0.0) -> np.ndarray:
        """MuJoCo's C(q, v) v + g(q) (nv,), with the load if it is held at t."""
        return self._evaluate(q, v, t)[1]

    def _evaluate(self, q: np.ndarray, v: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        model = self._loaded if self.payload and self.payload.held(t) else self._bare
        data, at, nv = mujoco.MjData(model), self._addresses, self.robot.nv
        data.qpos[at], data.qvel[at] = self.robot.coordinates(q), self.robot.check_v(v)
        mujoco.mj_forward(model, data)
        mass_matrix = np.zeros((nv, nv))
        mujoco.mj_fullM(model, data, mass_matrix)
        return mass_matrix[np.ix_(at, at)], data.qfrc_bias[at]

    def _measure(self) -> Measurement:
        dq, dv = self.noise.sample(self.t, self.robot.nv, self._rng)
        return Measurement(
            self.t, pin.integrate(self.robot.model, self.q, np.asarray(dq)), self.v + dv, self.tau.copy()
        )

    def _stiffness(self) -> float:
        """[1/s] the fastest decay by viscous friction, the largest eigenvalue of M^-1 D over sampled q."""
        damping = self._bare.dof_damping[self._addresses]
        if not damping.any():
            return 0.0
        rng, root = np.random.default_rng(0), np.sqrt(damping)
        postures = [self.q0, *(self.robot.random_configuration(rng) for _ in range(POSTURES))]
        scaled = [root[:, None] * np.linalg.inv(self.mass_matrix(q)) * root for q in postures]
        return float(np.linalg.eigvalsh(scaled).max())

    def _furnish(self, model: mujoco.MjModel) -> None:
        """Give a compiled model the rotors and the friction that were asked for."""
        at = self._addresses
        if self.armature is not None:
            model.dof_armature[at] = self.armature
            mujoco.mj_setConst(model, mujoco.MjData(model))  # what follows from it
        model.dof_damping[at] = self.joint_friction * model.dof_damping[at] + self.friction.viscous
        dry = self.joint_friction * model.dof_frictionloss[at] + self.friction.coulomb
        self._dry[model is self._loaded] = dry
        model.dof_frictionloss[at] = dry
        model.dof_solimp[:] = HARD
