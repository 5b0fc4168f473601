"""Whether a sample can be of this arm, coming after the one before it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.compiling import SCALAR, VECTOR, kernel
from eladapt.robot.model import Robot
from eladapt.safety.guards import Alarm
from eladapt.signals import Measurement

FASTEST = 1e3  # [rad/s] no arm turns at 10,000 rpm; where the URDF sets no limit, this one holds


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, SCALAR, SCALAR, SCALAR, SCALAR, SCALAR)
def unlikely(
    moved: np.ndarray, before: np.ndarray, v: np.ndarray, velocity: np.ndarray, elapsed: float, dt: float,
    age: float, max_age: float, resolution: float,
) -> tuple[int, int]:  # fmt: skip
    """Why a sample cannot follow one of ``age`` [s], and the joint that shows it most: 0, it is too fast for
    any arm; 1, it moved and is the same to the last bit; 2, its position is out of reach; 3, its velocity.
    (-1, -1): it can."""
    n, quick, quicker, same = len(v), 0, 0, True
    for i in range(n):
        quick = i if abs(v[i]) > abs(v[quick]) else quick
        quicker = i if abs(before[i]) > abs(before[quicker]) else quicker
        same = same and moved[i] == 0.0 and v[i] == before[i]
    if abs(v[quick]) > FASTEST:
        return 0, quick
    if same and abs(before[quicker]) * age > resolution:
        return 1, quicker
    for why in (2, 3):
        worst, farthest = -1, 0.0
        for i in range(n):
            if why == 2:
                beyond = abs(moved[i]) - 2 * velocity[i] * (elapsed + dt)
            else:
                beyond = abs(v[i] - before[i]) - velocity[i] * (1 + elapsed / max_age)
            if beyond > farthest:
                worst, farthest = i, beyond
        if worst >= 0:
            return why, worst
    return -1, -1


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
        moved = pin.difference(self.robot.model, last.q, measurement.q)
        why, i = unlikely(
            moved, last.v, measurement.v, self.velocity, elapsed, dt, age + dt, self.max_age, self.resolution
        )
        return None if why < 0 else self._said(why, i, moved, last, measurement)

    def _said(
        self, why: int, i: int, moved: np.ndarray, last: Measurement, measurement: Measurement
    ) -> Alarm:
        """In words what `unlikely` found in joint i."""
        name, v = self.robot.joint_names[i], measurement.v[i]
        return (
            Alarm("jump", f"a speed of {abs(v):.3g} is no arm's"),
            Alarm("frozen", f"{name!r} moves at {last.v[i]:.3g} rad/s and stays in one place"),
            Alarm("jump", f"the position of {name!r} has moved by {abs(moved[i]):.3g} rad, out of reach"),
            Alarm(
                "jump",
                f"the velocity of {name!r} has changed by {abs(v - last.v[i]):.3g} rad/s, out of reach",
            ),
        )[why]
