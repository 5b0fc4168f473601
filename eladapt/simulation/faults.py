"""Faults of sensors, buses, motors and arms, between a plant and a controller; each has a plant's face.

``start`` and ``end`` [s] are by the clock of the plant inside: the fault lasts while start <= t < end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, require_number, require_vector
from eladapt.robot.protocols import Plant
from eladapt.robot.reading import frame_index
from eladapt.signals import Measurement
from eladapt.simulation.disturbances import ROUNDING, Friction
from eladapt.simulation.instruments import Wrapper
from eladapt.simulation.plants import PinocchioPlant

Reading = Callable[[Measurement, Measurement], Measurement]
Drive = Callable[[np.ndarray, np.ndarray], np.ndarray]
Force = Callable[[float, np.ndarray, np.ndarray], np.ndarray]


class _Fault(Wrapper):
    """A plant with something wrong from ``start`` to ``end`` [s]."""

    def __init__(self, plant: Plant, start: float = 0.0, end: float = np.inf):
        super().__init__(plant)
        if not start < end:
            raise ArgumentError(f"start, end: expected start < end, got {start}, {end}")
        self.start, self.end, self._t = start, end, 0.0

    @property
    def active(self) -> bool:
        """Whether the fault is there now."""
        return self.start <= self._t + ROUNDING < self.end

    def reset(self) -> Measurement:
        """The plant's first measurement."""
        measurement = self.plant.reset()
        self._t = measurement.t
        return measurement

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque tau (nv,) for dt [s]."""
        measurement = self.plant.step(tau, dt)
        self._t = measurement.t
        return measurement


class Misread(_Fault):
    """Sensors that say ``change(measurement, good)``, good being the last measurement before it began.

    Both are copies that may be written to. Where it begins with the first measurement, that one is good.
    """

    def __init__(self, plant: Plant, change: Reading, start: float = 0.0, end: float = np.inf):
        super().__init__(plant, start, end)
        self.change = change

    def reset(self) -> Measurement:
        """The first measurement, as it is read."""
        self._good = super().reset()
        return self._read(self._good)

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque tau (nv,) for dt [s]; the measurement as it is read."""
        return self._read(super().step(tau, dt))

    def _read(self, measurement: Measurement) -> Measurement:
        if not self.active:
            self._good = measurement
            return measurement.copy()
        return self.change(measurement.copy(), self._good.copy())


def _lost(measurement: Measurement, _good: Measurement) -> Measurement:
    return measurement._replace(q=np.nan * measurement.q, v=np.nan * measurement.v)


def _frozen(measurement: Measurement, good: Measurement) -> Measurement:
    return measurement._replace(q=good.q, v=good.v)


class LostNumbers(Misread):
    """Measured positions and velocities are nan; the time stamp and the torque are right."""

    def __init__(self, plant: Plant, start: float = 0.0, end: float = np.inf):
        super().__init__(plant, _lost, start, end)


class FrozenSensor(Misread):
    """Positions and velocities stay what they were when it began; time stamps go on."""

    def __init__(self, plant: Plant, start: float = 0.0, end: float = np.inf):
        super().__init__(plant, _frozen, start, end)


class Misdriven(_Fault):
    """Drives that do ``change(tau, good)`` and report tau, which was commanded; both (nv,) [N m].

    good: the last command before it began, or the torque that the plant began with. Both are copies that may
    be written to.
    """

    def __init__(self, plant: Plant, change: Drive, start: float = 0.0, end: float = np.inf):
        super().__init__(plant, start, end)
        self.change = change

    def reset(self) -> Measurement:
        """The plant's first measurement."""
        measurement = super().reset()
        self._good = measurement.tau.copy()
        return measurement

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold what the drives make of the torque tau (nv,) for dt [s]."""
        if not self.active:
            self._good = np.array(tau, dtype=float)
            return super().step(tau, dt)
        acting = self.change(np.array(tau, dtype=float), self._good.copy())
        return super().step(acting, dt)._replace(tau=np.array(tau, dtype=float))


class Push(_Fault):
    """A force on a frame, [N] in world axes, of which no measurement tells. It belongs next to the arm.

    force: (3,), or a callable of t [s] and of the frame's position [m] and velocity [m/s], (3,) each, that
    returns it. frame: the tool if None. ramp [s]: in which it comes from ``start`` on, and goes from ``end``
    on.
    """

    def __init__(
        self,
        plant: Plant,
        force: Sequence[float] | np.ndarray | Force,
        frame: str | None = None,
        start: float = 0.0,
        end: float = np.inf,
        *,
        ramp: float = 0.0,
    ):
        super().__init__(plant, start, end)
        self.force = force if callable(force) else require_vector("force", force, 3)
        self.ramp = require_number("ramp", ramp, 0, np.finfo(float).max, closed=True)
        robot = plant.robot
        self._frame = frame_index(robot.model, robot.tool if frame is None else frame)
        self._data = robot.model.createData()

    @property
    def share(self) -> float:
        """The part of the force that acts now."""
        if not self.ramp:
            return float(self.active)
        here = min(self._t - self.start, self.end + self.ramp - self._t) / self.ramp
        return float(np.clip(here, 0, 1))

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque tau (nv,) for dt [s], beside the force as it is when the step begins."""
        if not (share := self.share):
            return super().step(tau, dt)
        measurement = super().step(tau + share * self._torque(), dt)
        return measurement._replace(tau=np.array(tau, dtype=float))

    def _torque(self) -> np.ndarray:
        """(nv,) [N m] that the whole force makes."""
        model, data = self.robot.model, self._data
        jacobian = pin.computeFrameJacobian(model, data, self.q, self._frame, pin.LOCAL_WORLD_ALIGNED)[:3]
        if not callable(self.force):
            return np.array(jacobian.T @ self.force)
        position = pin.updateFramePlacement(model, data, self._frame).translation.copy()
        return np.array(jacobian.T @ self.force(self._t, position, jacobian @ self.v))


class Packets(_Fault):
    """A bus that loses and repeats: measurements come twice instead of the next, commands not at all.

    dropped, duplicated: parts of all packets, each way. When a measurement is lost, or comes a second time in
    the place of the next one, the controller gets the one before again; when a command is lost, the robot
    holds the torque before.
    """

    def __init__(
        self,
        plant: Plant,
        dropped: float = 0.0,
        duplicated: float = 0.0,
        *,
        start: float = 0.0,
        end: float = np.inf,
        seed: int = 0,
    ):
        super().__init__(plant, start, end)
        self.dropped = require_number("dropped", dropped, 0, 1, closed=True)
        self.duplicated = require_number("duplicated", duplicated, 0, 1, closed=True)
        self.seed = seed

    def reset(self) -> Measurement:
        """The plant's first measurement, with the losses from their seed."""
        self._rng = np.random.default_rng(self.seed)
        self._seen = super().reset()
        self._held = self._seen.tau
        return self._seen.copy()

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """A step with the command that arrived last, and the measurement that arrived last."""
        away, back, twice = self._rng.random(3)
        active = self.active
        if not (active and away < self.dropped):
            self._held = np.array(tau, dtype=float)
        measurement = super().step(self._held, dt)
        if not (active and (back < self.dropped or twice < self.duplicated)):
            self._seen = measurement
        return self._seen.copy()


class Jitter(_Fault):
    """Samples that come irregularly: a step lasts between ``least`` and ``most`` [s], whatever dt says."""

    def __init__(
        self,
        plant: Plant,
        least: float,
        most: float,
        *,
        start: float = 0.0,
        end: float = np.inf,
        seed: int = 0,
    ):
        super().__init__(plant, start, end)
        self.least = require_number("least", least, 0)
        self.most = require_number("most", most, self.least)
        self.seed = seed

    def reset(self) -> Measurement:
        """The plant's first measurement, with the jitter from its seed."""
        self._rng = np.random.default_rng(self.seed)
        return super().reset()

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque for as long as it lasts until the next sample."""
        late = self._rng.uniform(self.least, self.most)
        return super().step(tau, late if self.active else dt)


class WeakMotors(_Fault):
    """Motors that saturate at ``share`` of the URDF's effort limits, and report the torque that acted."""

    def __init__(self, plant: Plant, share: float, *, start: float = 0.0, end: float = np.inf):
        super().__init__(plant, start, end)
        self.share = require_number("share", share, 0, 1, closed=True)

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold what the motors can of the torque."""
        limit = self.share * self.robot.effort_limit
        return super().step(np.clip(tau, -limit, limit) if self.active else tau, dt)


class BlockedJoints(_Fault):
    """Joints that something holds: dry friction that no motor overcomes. On a `PinocchioPlant` alone."""

    HOLDS = 1e4  # [N m] per joint

    def __init__(
        self, plant: PinocchioPlant, joints: Sequence[str], *, start: float = 0.0, end: float = np.inf
    ):
        super().__init__(plant, start, end)
        robot = plant.robot
        if unknown := [name for name in joints if name not in robot.joint_names]:
            raise ArgumentError(
                f"joints: no joint {unknown[0]!r}; legal names: {', '.join(robot.joint_names)}"
            )
        self._pinocchio, self._free = plant, plant.friction
        held = np.isin(robot.joint_names, list(joints))
        coulomb = np.where(held, self.HOLDS, np.broadcast_to(self._free.coulomb, robot.nv))
        self._stuck = Friction(self._free.viscous, coulomb)

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque, against the block while it is there."""
        self._pinocchio.friction = self._stuck if self.active else self._free
        return super().step(tau, dt)
