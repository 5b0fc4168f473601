"""Whether a sample can be of this arm, coming after the one before it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.robot.model import Robot
from eladapt.safety.guards import Alarm
from eladapt.signals import Measurement

FASTEST = 1e3  # [rad/s] no arm turns at 10,000 rpm; where the URDF sets no limit, this one holds


class SampleJudge(NamedTuple):
    """velocity (nv,) [rad/s]: the limits; max_age [s]: how long is bridged; resolution [rad]: what a moving
    joint must show."""

    robot: Robot
    velocity: np.ndarray
    max_age: float
    resolution: float

    def set_back(self, last: Measurement, t: float) -> float:
        """[s] by how much the robot's clock was set back, 0 where a sample that says t is merely late."""
        back = last.t - t
        return back if back > self.max_age else 0.0

    def doubt(
        self, last: Measurement, measurement: Measurement, age: float, dt: float, first: bool
    ) -> Alarm | None:
        """Why a finite sample is not to be trusted. age [s]: of ``last``, the last one that was; first: none
        was yet but that of `init`, which may come again."""
        elapsed = measurement.t - last.t
        if elapsed == 0 and first:
            return None
        if elapsed <= 0:
            return Alarm("watchdog", f"its time stamp {measurement.t:.6g} s is not after {last.t:.6g} s")
        if np.abs(measurement.v).max() > FASTEST:
            return Alarm("jump", f"a speed of {np.abs(measurement.v).max():.3g} is no arm's")
        moved = pin.difference(self.robot.model, last.q, measurement.q)
        if self._frozen(last, measurement, moved, age + dt):
            i = int(np.argmax(np.abs(last.v)))
            said = f"{self.robot.joint_names[i]!r} moves at {last.v[i]:.3g} rad/s and stays in one place"
            return Alarm("frozen", said)
        return self._jump(last, measurement, moved, elapsed, dt)

    def _frozen(self, last: Measurement, measurement: Measurement, moved: np.ndarray, age: float) -> bool:
        same = not moved.any() and np.array_equal(measurement.v, last.v)
        return bool(same and np.abs(last.v).max() * age > self.resolution)

    def _jump(
        self, last: Measurement, measurement: Measurement, moved: np.ndarray, elapsed: float, dt: float
    ) -> Alarm | None:
        jump = np.abs(moved) - 2 * self.velocity * (elapsed + dt)
        change = np.abs(measurement.v - last.v) - self.velocity * (1 + elapsed / self.max_age)
        for what, beyond, unit in (("position", jump, "rad"), ("velocity", change, "rad/s")):
            i = int(beyond.argmax())
            if beyond[i] > 0:
                said = f"the {what} of {self.robot.joint_names[i]!r} is {beyond[i]:.3g} {unit} out of reach"
                return Alarm("jump", said)
        return None
