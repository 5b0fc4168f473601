"""Faults of sensors, buses, motors and arms, between a plant and a controller; each has a plant's face.

``start`` and ``end`` [s] are by the plant's clock: the fault lasts while start <= t < end.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eladapt.errors import ArgumentError, require_number
from eladapt.robot.protocols import Plant
from eladapt.signals import Measurement
from eladapt.simulation.disturbances import Friction
from eladapt.simulation.instruments import _Wrapper
from eladapt.simulation.plants import PinocchioPlant


class _Fault(_Wrapper):
    """A plant with something wrong from ``start`` to ``end`` [s]."""

    def __init__(self, plant: Plant, start: float = 0.0, end: float = np.inf):
        super().__init__(plant)
        if not start < end:
            raise ArgumentError(f"start, end: expected start < end, got {start}, {end}")
        self.start, self.end = start, end

    def active(self, t: float) -> bool:
        """Whether the fault is there at t [s]; half a microsecond of rounding is forgiven."""
        return self.start <= t + 5e-7 < self.end

    def reset(self) -> Measurement:
        """The plant's first measurement."""
        return self.plant.reset()

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque tau (nv,) for dt [s]."""
        return self.plant.step(tau, dt)


class LostNumbers(_Fault):
    """Measured positions and velocities are nan; the time stamp and the torque are right."""

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """A step, of which the sensors say nothing."""
        measurement = self.plant.step(tau, dt)
        if not self.active(measurement.t):
            return measurement
        return measurement._replace(q=np.full_like(self.q, np.nan), v=np.full_like(self.v, np.nan))


class FrozenSensor(_Fault):
    """Positions and velocities stay what they were when it began; time stamps go on."""

    _seen: Measurement | None = None

    def reset(self) -> Measurement:
        """The plant's first measurement."""
        self._seen = self.plant.reset()
        return self._seen.copy()

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """A step, of which the sensors do not tell."""
        measurement = self.plant.step(tau, dt)
        if self._seen is None or not self.active(measurement.t):
            self._seen = measurement
        return measurement._replace(q=self._seen.q, v=self._seen.v).copy()


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
        self._seen = self.plant.reset()
        self._held, self._t = self._seen.tau, self._seen.t
        return self._seen.copy()

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """A step with the command that arrived last, and the measurement that arrived last."""
        away, back, twice = self._rng.random(3)
        active = self.active(self._t)
        if not (active and away < self.dropped):
            self._held = np.array(tau, dtype=float)
        measurement = self.plant.step(self._held, dt)
        self._t = measurement.t
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
        self._t = 0.0
        return self.plant.reset()

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque for as long as it lasts until the next sample."""
        late = self._rng.uniform(self.least, self.most)
        measurement = self.plant.step(tau, late if self.active(self._t) else dt)
        self._t = measurement.t
        return measurement


class WeakMotors(_Fault):
    """Motors that saturate at ``share`` of the URDF's effort limits, and report the torque that acted."""

    def __init__(self, plant: Plant, share: float, *, start: float = 0.0, end: float = np.inf):
        super().__init__(plant, start, end)
        self.share = require_number("share", share, 0, 1, closed=True)
        self._t = 0.0

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold what the motors can of the torque."""
        limit = self.share * self.robot.effort_limit
        measurement = self.plant.step(np.clip(tau, -limit, limit) if self.active(self._t) else tau, dt)
        self._t = measurement.t
        return measurement


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
        self._pinocchio.friction = self._stuck if self.active(self._pinocchio.t) else self._free
        return self.plant.step(tau, dt)
