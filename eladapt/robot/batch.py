"""Many states of one robot at once: positions along paths, and torque regressors in one compiled call."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.batches import aligned, batch_first, batch_last
from eladapt.compiling import kernel_module
from eladapt.robot.model import Robot


class Positions:
    """Differences and sums of positions q (..., nq) as pin.difference and pin.integrate have them.

    The angle between two positions of a continuous joint is that of their directions, also where they are a
    little off the unit circle.
    """

    def __init__(self, model: pin.Model):
        joints = range(1, model.njoints)
        self.first = np.array([model.idx_qs[joint] for joint in joints])  # where each joint stands in q
        self.continuous = np.array([model.nqs[joint] == 2 for joint in joints])
        self.cosines = self.first[self.continuous]
        self.sines = self.cosines + 1

    def difference(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
        """(..., nv) from q0 to q1; the short way round on continuous joints."""
        change = np.subtract(q1[..., self.first], q0[..., self.first], dtype=float)
        if len(self.cosines):
            c0, s0, c1, s1 = (q[..., at] for q in (q0, q1) for at in (self.cosines, self.sines))
            change[..., self.continuous] = np.arctan2(c0 * s1 - s0 * c1, c0 * c1 + s0 * s1)
        return change

    def integrate(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """(..., nq): q (..., nq) moved by dq (..., nv)."""
        moved = np.empty((*np.broadcast_shapes(q.shape[:-1], dq.shape[:-1]), q.shape[-1]))
        moved[..., self.first] = q[..., self.first] + dq
        if len(self.cosines):
            c, s, angle = q[..., self.cosines], q[..., self.sines], dq[..., self.continuous]
            length = (3 - c * c - s * s) / 2  # back to the unit circle, to first order
            cosine, sine = length * np.cos(angle), length * np.sin(angle)
            moved[..., self.cosines] = c * cosine - s * sine
            moved[..., self.sines] = s * cosine + c * sine
        return moved


class Path(NamedTuple):
    """From one sample to the next, of B robots, and where on it regressors are wanted."""

    q0: np.ndarray  # (B, nq)
    v0: np.ndarray  # (B, nv)
    q1: np.ndarray
    v1: np.ndarray
    dt: float  # [s]
    points: np.ndarray  # (P,) in [0, 1]
    hermite: bool  # whether the velocity inside is taken from the positions too


class TorqueRegressors:
    """W(q, v, a) along many paths by one compiled call, in combinations of the standard parameters."""

    def __init__(
        self, robot: Robot, standard_map: np.ndarray, *, weightless: bool = False, still: bool = False
    ):
        """standard_map (s, l): regressors in standard parameters @ standard_map are the ones wanted.

        weightless: of M a + C v alone; still: of g alone.
        """
        model, positions = robot.model, Positions(robot.model)
        joints = range(1, model.njoints)
        axes = np.array([_axis(model, joint) for joint in joints])
        frames = [model.jointPlacements[joint] for joint in joints]
        self._kernels = kernels = kernel_module("eladapt.robot.kernels")
        turning = np.where(positions.continuous, kernels.CONTINUOUS, kernels.TURNING)
        self.tree = (
            np.where(np.any(axes[:, :3] != 0, axis=1), kernels.SLIDING, turning),
            positions.first,
            np.array([model.parents[joint] - 1 for joint in joints]),
            np.array([_turns(frame.rotation, axis[3:]) for frame, axis in zip(frames, axes, strict=True)]),
            np.array([frame.translation for frame in frames]),
            np.array([frame.rotation @ axis[:3] for frame, axis in zip(frames, axes, strict=True)]),
            axes,
        )
        gravity = np.zeros(3) if weightless else model.gravity.linear
        rotors = np.flatnonzero(robot.armature)
        self.map = (*_entries(standard_map, rotors), np.array(gravity), 0.0 if still else 1.0)

    def filtered(self, omega: np.ndarray, rho: float, weight: np.ndarray, path: Path) -> np.ndarray:
        """rho omega + weight W (B, nv, l), W the mean over the points of each path; omega (B, nv, l)."""
        before = batch_last(omega, 2, path.v0.shape[:1])
        found = aligned(before.shape)
        ends = map(np.ascontiguousarray, path[:4])
        gains = (before, rho, weight, found)
        self._kernels.filtered_regressors(*self.tree, *self.map, *ends, *path[4:], *gains)
        return batch_first(found, path.v0.shape[:1])


def _axis(model: pin.Model, joint: int) -> np.ndarray:
    """(6,) the motion [linear, angular] of a joint at unit velocity, in its own frame."""
    data = model.joints[joint].createData()
    model.joints[joint].calc(data, pin.neutral(model))
    return np.array(data.S).reshape(6)


def _turns(rotation: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(3, 3, 3): rotation times what stands by 1, cosine and sine in Rodrigues' formula about ``axis``."""
    if not axis.any():  # a sliding joint, whose cosine is 1 and sine 0
        return np.array([rotation, np.zeros((3, 3)), np.zeros((3, 3))])
    along = np.outer(axis, axis)
    return rotation @ np.array([along, np.eye(3) - along, pin.skew(axis)])


def _entries(standard_map: np.ndarray, rotors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(starts (n + 1,), entries (e, 2), factors (e,)) of a map, as `filtered_regressors` wants them."""
    standard, wanted = np.nonzero(standard_map)
    factors = standard_map[standard, wanted]
    bodies = (len(standard_map) - len(rotors)) // 10
    starts = np.searchsorted(standard, 10 * np.arange(bodies + 1))
    of_rotor = standard >= 10 * bodies
    standard[~of_rotor] %= 10
    standard[of_rotor] = rotors[standard[of_rotor] - 10 * bodies]
    return starts, np.column_stack([standard, wanted]), factors
