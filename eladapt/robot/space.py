"""Which vectors are a robot's: of its sizes, finite, and on its configuration space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, is_vector, require_number, require_vector
from eladapt.signals import Measurement, Reference

LARGEST = 1e8  # [rad, rad/s, N m] of a measurement: squares of it, and of its regressors, stay within doubles
LEAST = -float(np.finfo(float).max)
UNIT_CIRCLE_TOLERANCE = 1e-6  # on cos^2 + sin^2 of a continuous joint: single-precision sensors pass


class Circle(NamedTuple):
    """A continuous joint, and where its (cos, sin) begins in q."""

    joint: str
    start: int


@dataclass(frozen=True)
class Space:
    """The configurations q (nq,) of a tree of 1-DoF joints, and their velocities v (nv,)."""

    nq: int
    nv: int
    circles: tuple[Circle, ...]

    @classmethod
    def of(cls, model: pin.Model) -> Space:
        """That of Pinocchio's model."""
        continuous = [joint for joint in range(1, model.njoints) if model.nqs[joint] == 2]
        circles = tuple(Circle(model.names[joint], model.idx_qs[joint]) for joint in continuous)
        return cls(model.nq, model.nv, circles)

    def check_q(self, q: Any, name: str = "q") -> np.ndarray:
        """q as a finite (nq,) vector on the configuration space; raises ArgumentError."""
        q = require_vector(name, q, self.nq)
        self._require_unit_circles(q, name)
        return q

    def check_v(self, v: Any, name: str = "v") -> np.ndarray:
        """v as a finite (nv,) vector; raises ArgumentError."""
        return require_vector(name, v, self.nv)

    def check_reference(self, goal: Reference) -> Reference:
        """The reference in vectors of its own. Raises ArgumentError, naming what is wrong."""
        q, v, a = goal
        q = self.check_q(q, "goal.q")
        return Reference(q, self.check_v(v, "goal.v"), self.check_v(a, "goal.a")).copy()

    def check_measurement(self, measurement: Measurement) -> Measurement:
        """The measurement in vectors of its own; see `Robot.check_measurement`."""
        t, q, v, tau = measurement
        t = require_number("measurement.t", t, LEAST)
        if not (is_vector(q, self.nq) and is_vector(v, self.nv) and is_vector(tau, self.nv)):
            q, v, tau = self._check_vectors(q, v, tau)
        q, v, tau = q.copy(), v.copy(), tau.copy()
        if not q.dot(q) + v.dot(v) + tau.dot(tau) <= LARGEST**2:  # false too where a number is not finite
            self._check_vectors(q, v, tau)
            name, vector = max(
                (("q", q), ("v", v), ("tau", tau)), key=lambda pair: float(np.abs(pair[1]).max())
            )
            raise ArgumentError(f"measurement.{name}: expected sizes up to {LARGEST:g}, got {vector}")
        self._require_unit_circles(q, "measurement.q")
        return Measurement(t, q, v, tau)

    def _check_vectors(self, q: Any, v: Any, tau: Any) -> tuple[np.ndarray, ...]:
        """q, v and tau of a measurement, one by one."""
        return (
            self.check_q(q, "measurement.q"), self.check_v(v, "measurement.v"),
            self.check_v(tau, "measurement.tau"),
        )  # fmt: skip

    def _require_unit_circles(self, q: np.ndarray, name: str) -> None:
        for joint, start in self.circles:
            norm = q[start] ** 2 + q[start + 1] ** 2
            if abs(norm - 1) > UNIT_CIRCLE_TOLERANCE:
                raise ArgumentError(
                    f"{name}: continuous joint {joint!r} expects (cos, sin) at [{start}:{start + 2}], got "
                    f"{q[start : start + 2]}; make q with robot.configuration(angles)"
                )
