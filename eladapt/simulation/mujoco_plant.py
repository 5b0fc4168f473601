"""The same robots simulated by MuJoCo: dynamics, integrator and friction that were written elsewhere.

MuJoCo reads the URDF by itself; only what the dynamics do not need (shapes, limits, couplings of locked
joints) is left out of it. Its mass matrix and bias agree with Pinocchio's to 1e-12 on every robot of
the library. What differs is real: it applies the URDF's joint damping and friction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, EladaptError, Finding, SimulationError, UrdfError, require_number
from eladapt.robot.model import Robot
from eladapt.robot.reading import frame_index
from eladapt.signals import Measurement
from eladapt.simulation.disturbances import Friction, Noise, Payload
from eladapt.simulation.plants import NoiseModel
from eladapt.urdf.checks import read_urdf

try:
    import mujoco
except ImportError as reason:
    raise EladaptError(
        f'MujocoPlant needs MuJoCo, which is not installed ({reason}): pip install "eladapt[mujoco]"'
    ) from reason

Integrator = Literal["rk4", "implicitfast"]

COMPILER = {"discardvisual": "true", "fusestatic": "false", "balanceinertia": "false"}
SHAPES = ("visual", "collision")
LIMITS = ("limit", "mimic", "safety_controller")
DISABLED = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT  # no shapes are loaded
    | mujoco.mjtDisableBit.mjDSBL_LIMIT
    | mujoco.mjtDisableBit.mjDSBL_AUTORESET  # what diverges is an error, not a fresh start
)
# RK4 is stable up to h rate = 2.78 for damping of that rate [1/s]; at 2 its error is 1e-5 rad/s (xarm7).
STIFFEST = 2.0
LEAST_SUBSTEPS, MOST_SUBSTEPS = 2, 16
POSTURES = 50
# Friction is a constraint: as hard as MuJoCo allows, at rest within one substep, and then cleared of the
# compliance that would let a stuck joint creep (at 1e-5 rad/s on the panda's wrist).
HARD = (0.9999, 0.9999, 0.001, 0.5, 2.0)
FRICTION_SWEEPS, TOLERANCE = 50, 1e-14


class MujocoPlant:
    """A robot simulated by MuJoCo, with the face of `PinocchioPlant`.

    q0 (nq,), v0 (nv,) or None for rest. friction, noise, payload: as in `disturbances`; a bare number
    as payload is a mass [kg] at the tool frame. joint_friction: whether the URDF's damping and friction
    act; the caller's ``friction`` is added to them. Coulomb friction is MuJoCo's dry friction
    constraint, and it sticks. seed: of the noise.

    integrator, substeps: chosen where None. "rk4", with two substeps or as many as the stiffest viscous
    damping needs to be stable (eight on xarm7 at 1 ms); "implicitfast", of first order, where that would
    take more than 16. Over half a second at 25 rad/s, RK4 at 1 ms was off by 2e-8 rad, implicitfast by
    3e-2; with Coulomb friction both are of first order, 1e-3 rad at 5 rad/s.

    Joint limits are off, as in PinocchioPlant: a set-point inside them needs none, and hitting one is
    not modelled. Contacts are off too. `t`, `q` and `v` are the true state. Raises SimulationError
    when the state is not finite, UrdfError when MuJoCo refuses the robot.
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
    ):
        if integrator not in (None, "rk4", "implicitfast"):
            raise ArgumentError(f"integrator: expected 'rk4', 'implicitfast' or None, got {integrator!r}")
        if substeps is not None and substeps < 1:
            raise ArgumentError(f"substeps: expected at least 1, got {substeps}")
        self.robot, self.integrator, self.substeps, self.seed = robot, integrator, substeps, seed
        self.q0 = robot.check_q(np.asarray(q0, dtype=float), "q0")
        self.v0 = np.zeros(robot.nv) if v0 is None else robot.check_v(np.asarray(v0, dtype=float), "v0")
        self.friction, self.noise = friction or Friction(), noise or Noise()
        self.joint_friction = joint_friction
        self.payload = Payload(float(payload)) if isinstance(payload, int | float) else payload
        self._bare = self._model(None)
        self._loaded = self._bare if self.payload is None else self._model(self.payload)
        self._addresses = np.array([self._bare.joint(name).dofadr[0] for name in robot.joint_names])
        self._rate = self._stiffness()
        self.reset()

    def reset(self) -> Measurement:
        """Back to the initial state, with the noise from its seed."""
        self._rng = np.random.default_rng(self.seed)
        self.t, self.q, self.v = 0.0, self.q0.copy(), self.v0.copy()
        self.tau = np.zeros(self.robot.nv)
        self._x = self.robot.coordinates(self.q0)
        self._model_now, self._data = self._bare, mujoco.MjData(self._bare)
        return self._measure()

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
            self.t, pin.integrate(self.robot.model, self.q, np.asarray(dq)), self.v + dv, self.tau
        )

    def _stiffness(self) -> float:
        """[1/s] the fastest decay by viscous friction, the largest eigenvalue of M^-1 D over sampled q."""
        damping = self._bare.dof_damping[self._addresses]
        if not damping.any():
            return 0.0
        rng, root = np.random.default_rng(0), np.sqrt(damping)
        postures = [self.q0, *(self.robot.random_configuration(rng) for _ in range(POSTURES))]
        scaled = [root[:, None] * np.linalg.inv(self.robot.mass_matrix(q)) * root for q in postures]
        return float(np.linalg.eigvalsh(scaled).max())

    def _model(self, payload: Payload | None) -> mujoco.MjModel:
        """The compiled robot; every load is a body of its own, so that attaching one switches models."""
        robot = self.robot
        try:
            spec = _specification(robot)
            if payload is not None:
                _attach(spec, robot, payload)
            model = spec.compile()
        except ValueError as reason:
            said, remedy = " ".join(str(reason).split()), "Mend it, or simulate it with PinocchioPlant"
            finding = Finding("file", said, "MuJoCo refused it", remedy)
            raise UrdfError(robot.path, [finding]) from reason
        for name, viscous, coulomb in zip(
            robot.joint_names,
            np.broadcast_to(self.friction.viscous, (robot.nv,)),
            np.broadcast_to(self.friction.coulomb, (robot.nv,)),
            strict=True,
        ):
            k = model.joint(name).dofadr[0]
            model.dof_damping[k] = self.joint_friction * model.dof_damping[k] + viscous
            model.dof_frictionloss[k] = self.joint_friction * model.dof_frictionloss[k] + coulomb
        model.dof_solimp[:] = HARD
        return model


def _specification(robot: Robot) -> mujoco.MjSpec:
    """The URDF as MuJoCo reads it: no shapes, no limits, locked joints welded where the robot has them."""
    urdf = ElementTree.Element("robot", name=robot.model.name)
    ElementTree.SubElement(ElementTree.SubElement(urdf, "mujoco"), "compiler", COMPILER)
    for element in read_urdf(robot.path):
        if element.tag not in ("link", "joint"):
            continue
        for child in list(element):
            if child.tag in (*SHAPES, *LIMITS):
                element.remove(child)
        if element.get("name") in robot.locked and element.tag == "joint":
            element.set("type", "fixed")
        elif element.get("type") == "revolute":
            element.set("type", "continuous")  # the same joint without limits
        urdf.append(element)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(urdf, "unicode"))
    for element in urdf.findall("joint"):
        if element.get("name") in robot.locked:
            _weld(spec, robot.model, element)
    for name, armature in zip(robot.joint_names, robot.armature, strict=True):
        spec.joint(name).armature = armature
    spec.option.gravity = robot.model.gravity.linear
    spec.option.disableflags = int(DISABLED)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # RK4 is called by name
    spec.option.noslip_iterations, spec.option.noslip_tolerance = FRICTION_SWEEPS, TOLERANCE
    spec.option.tolerance = TOLERANCE
    return spec


def _weld(spec: mujoco.MjSpec, model: pin.Model, joint: ElementTree.Element) -> None:
    """Put the child link of a locked joint where it is in the robot's model."""
    ends = {end: joint.find(end).get("link", "") for end in ("parent", "child")}  # type: ignore[union-attr]
    parent, child = (model.frames[frame_index(model, ends[end])].placement for end in ("parent", "child"))
    place = parent.actInv(child)
    body, quaternion = spec.body(ends["child"]), pin.Quaternion(place.rotation)
    body.pos = place.translation
    body.quat = [quaternion.w, quaternion.x, quaternion.y, quaternion.z]


def _attach(spec: mujoco.MjSpec, robot: Robot, payload: Payload) -> None:
    """A point mass, fixed to the body that the payload's frame moves with."""
    frame = robot.model.frames[frame_index(robot.model, payload.frame or robot.tool)]
    if frame.parentJoint == 0:
        return  # it stands on the base
    carrier = spec.joint(robot.model.names[frame.parentJoint]).parent
    place = frame.placement.act(np.asarray(payload.com, dtype=float))
    carrier.add_body(pos=place, mass=payload.mass, ipos=[0, 0, 0], inertia=[0, 0, 0], explicitinertial=True)
