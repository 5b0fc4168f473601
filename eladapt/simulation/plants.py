"""Simulated robots: the torque is held over each step, and the measurement carries it back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Protocol

import numpy as np
import pinocchio as pin

from eladapt.compiling import prepare
from eladapt.errors import ArgumentError, SimulationError, require_number
from eladapt.robot.model import Robot
from eladapt.signals import Measurement
from eladapt.simulation.disturbances import Brakes, Friction, Noise, Payload
from eladapt.simulation.runge_kutta import Stages, combined, finite, stage

ACTIVE_SETS = 20  # 2 to 6 are typical
FRICTION_SWEEPS = 2000  # only where the active sets go round
STUCK = 1e-12  # relative change at which the friction forces have settled


class NoiseModel(Protocol):
    """Anything that makes measurement errors."""

    def sample(self, t: float, nv: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]: ...


class PinocchioPlant:
    """A robot simulated by Pinocchio.

    q0 (nq,), v0 (nv,) or None for rest. friction, noise, payload: as in `disturbances`; a bare
    number as payload is a mass [kg] at the tool frame. integrator: "rk4" with ``substeps`` per
    step, Coulomb friction solved implicitly so that it sticks; or "euler", explicit with
    sign(v) for friction, which is how the paper simulates. seed: of the noise. brakes: what `brake` closes.

    `t`, `q` and `v` are the true state. Raises SimulationError when the state is not finite.
    """

    knows_parameters = True  # the robot's own are the true ones

    def __init__(
        self,
        robot: Robot,
        q0: Sequence[float] | np.ndarray,
        v0: Sequence[float] | np.ndarray | None = None,
        friction: Friction | None = None,
        noise: NoiseModel | None = None,
        payload: Payload | float | None = None,
        integrator: Literal["rk4", "euler"] = "rk4",
        *,
        substeps: int = 2,
        seed: int = 0,
        brakes: Brakes | None = None,
    ):
        prepare()
        if integrator not in ("rk4", "euler"):
            raise ArgumentError(f"integrator: expected 'rk4' or 'euler', got {integrator!r}")
        if substeps < 1:
            raise ArgumentError(f"substeps: expected at least 1, got {substeps}")
        self.robot, self.integrator, self.substeps, self.seed = robot, integrator, substeps, seed
        self.q0 = robot.check_q(np.array(q0, dtype=float), "q0")
        self.v0 = np.zeros(robot.nv) if v0 is None else robot.check_v(np.array(v0, dtype=float), "v0")
        self.friction, self.noise = friction or Friction(), noise or Noise()
        self.friction.by_joint(robot.nv)  # refuses another number of joints
        self.brakes = brakes or Brakes()
        self.payload = Payload(float(payload)) if isinstance(payload, int | float) else payload
        self._loaded = robot.model if self.payload is None else self.payload.loaded(robot)
        self._data, self._stages = robot.model.createData(), Stages.of(robot.nv)
        self.reset()

    def __repr__(self) -> str:
        return described(self)

    @property
    def rubbing(self) -> Friction:
        """The friction that acts: what the URDF says of it does not."""
        return self.friction

    def reset(self) -> Measurement:
        """Back to the initial state, with the noise from its seed; an arm at rest has been held there."""
        self._rng = np.random.default_rng(self.seed)
        self.t, self.q, self.v = 0.0, self.q0.copy(), self.v0.copy()
        self._told: float | None = None  # [s] when to brake
        model = self._loaded if self.payload and self.payload.held(0.0) else self.robot.model
        gravity = pin.computeGeneralizedGravity(model, model.createData(), self.q0)
        self.tau = holding(self.robot, gravity, self.v0)
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
        tau = self.robot.check_v(tau, "tau").copy()
        dt = require_number("dt", dt, 0)
        model = self._loaded if self.payload and self.payload.held(self.t) else self.robot.model
        viscous, dry = self._friction_now()
        if self.integrator == "euler":
            self._euler(model, tau, viscous, dry, dt)
        else:
            for _ in range(self.substeps):
                self._runge_kutta(model, tau, viscous, dry, dt / self.substeps)
        self.t, self.tau = self.t + dt, tau
        if not finite(self.q, self.v):
            raise SimulationError(f"the simulated {self.robot.name} diverged before t = {self.t:.4f} s")
        return self._measure()

    def _measure(self) -> Measurement:
        dq, dv = self.noise.sample(self.t, self.robot.nv, self._rng)
        return Measurement(
            self.t, pin.integrate(self.robot.model, self.q, np.asarray(dq)), self.v + dv, self.tau.copy()
        )

    def _friction_now(self) -> tuple[np.ndarray, np.ndarray | None]:
        """(nv,) viscous [N m s/rad], and dry [N m] of joints and closed brakes; None where nothing rubs."""
        viscous, coulomb = self.friction.by_joint(self.robot.nv)
        if self.brakes.closed(self._told, self.t):
            coulomb = coulomb + self._hold
        return viscous, coulomb if np.count_nonzero(coulomb) else None

    def _euler(
        self, model: pin.Model, tau: np.ndarray, viscous: np.ndarray, dry: np.ndarray | None, dt: float
    ) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            lost = viscous * self.v + (0.0 if dry is None else dry * np.sign(self.v))
            acceleration = pin.aba(model, self._data, self.q, self.v, tau - lost)
            self.q = pin.integrate(model, self.q, dt * self.v)
            self.v = self.v + dt * acceleration

    def _runge_kutta(
        self, model: pin.Model, tau: np.ndarray, viscous: np.ndarray, dry: np.ndarray | None, h: float
    ) -> None:
        held = tau if dry is None else tau - self._implicit_coulomb(model, tau, viscous, dry, h)
        q, v, (way, net, slopes) = self.q, self.v, self._stages
        slope, acceleration, accelerations = v, v, []
        for ahead, velocity in zip((0.0, 0.5 * h, 0.5 * h, h), slopes, strict=True):
            stage(v, slope, acceleration, ahead, held, viscous, way, velocity, net)
            slope, moved = velocity, pin.integrate(model, q, way)
            acceleration = pin.aba(model, self._data, moved, velocity, net)
            accelerations.append(acceleration)
        self.v = combined(*slopes, *accelerations, h, way)
        self.q = pin.integrate(model, q, way)

    @np.errstate(over="ignore", invalid="ignore")
    def _implicit_coulomb(
        self, model: pin.Model, tau: np.ndarray, viscous: np.ndarray, bound: np.ndarray, h: float
    ) -> np.ndarray:
        """Friction torques f (nv,) for the substep: |f_i| <= bound_i, f_i = bound_i sign(v_i+) where
        v+ = free velocity - h M^-1 f does not vanish."""
        free = self.v + h * pin.aba(model, self._data, self.q, self.v, tau - viscous * self.v)
        size = self.robot.nv
        inverse = np.array(pin.computeMinverse(model, self._data, self.q)).reshape(size, size)
        inverse = h * (np.triu(inverse) + np.triu(inverse, 1).T)
        force = _active_set(free, inverse, bound)
        return _projected_sweeps(free, inverse, bound) if force is None else force


def holding(robot: Robot, gravity: np.ndarray, v0: np.ndarray) -> np.ndarray:
    """(nv,) [N m] what held an arm until it was let go: its gravity, as far as its motors can, and nothing if
    it is in motion."""
    limit = robot.effort_limit
    return np.zeros(robot.nv) if v0.any() else np.clip(gravity, -limit, limit)


def described(plant: Any, *more: str) -> str:
    """A plant in one line: the robot, the time, and what acts on it that is not nothing."""
    friction, noise, payload = plant.friction, plant.noise, plant.payload
    parts = [repr(plant.robot.name[:40]), f"t = {plant.t:.6g} s", *more]
    if np.any(friction.viscous) or np.any(friction.coulomb):
        viscous, coulomb = np.max(friction.viscous), np.max(friction.coulomb)
        parts.append(f"friction up to {viscous:.3g} N m s/rad and {coulomb:.3g} N m")
    if not isinstance(noise, Noise):
        parts.append(type(noise).__name__)
    elif np.any(noise.position) or np.any(noise.velocity):
        parts.append(f"noise {np.max(noise.position):.3g} rad, {np.max(noise.velocity):.3g} rad/s")
    if payload is not None:
        parts.append(f"{payload.mass:.6g} kg at {(payload.frame or plant.robot.tool)[:40]!r}")
    return f"{type(plant).__name__}({', '.join(parts)})"


def _active_set(free: np.ndarray, inverse: np.ndarray, bound: np.ndarray) -> np.ndarray | None:
    """The forces (nv,), from a guess which joints stick, mended until it holds; None if it goes round."""
    force, velocity, diagonal = np.zeros_like(free), free, np.diag(inverse)
    before = None
    for _ in range(ACTIVE_SETS):
        wanted = force + velocity / diagonal
        sticks = np.abs(wanted) <= bound
        force = np.where(sticks, 0.0, np.copysign(bound, wanted))
        if sticks.any():
            left = free - inverse @ force
            force[sticks] = np.linalg.solve(inverse[np.ix_(sticks, sticks)], left[sticks])
        state = (sticks.tobytes(), np.signbit(np.where(sticks, 0.0, force)).tobytes())
        if state == before:
            return force
        velocity, before = np.where(sticks, 0.0, free - inverse @ force), state
    return None


def _projected_sweeps(free: np.ndarray, inverse: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """The forces (nv,) by projected Gauss-Seidel, which converges for any positive definite M^-1."""
    force, velocity = np.zeros_like(free), free.copy()
    for _ in range(FRICTION_SWEEPS):
        change = 0.0
        for i in range(len(free)):
            wanted = np.clip(force[i] + velocity[i] / inverse[i, i], -bound[i], bound[i])
            difference = wanted - force[i]
            if difference:
                force[i] = wanted
                velocity -= inverse[:, i] * difference
                change = max(change, abs(difference))
        if change <= STUCK * bound.max():
            break
    return force
