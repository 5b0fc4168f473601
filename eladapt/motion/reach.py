"""To where a tool should be: a posture by inverse kinematics, and a move there."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, needing, require_vector
from eladapt.motion.limits import MotionLimits
from eladapt.motion.motions import Motion, move
from eladapt.robot.model import Robot
from eladapt.robot.postures import require_within, turning, unholdable
from eladapt.robot.reading import frame_index

with needing("reach needs pink", "motion"):
    import pink
    from pink.limits import ConfigurationLimit, VelocityLimit

STARTS = 30  # postures to start from: q0, then random ones, from a fixed seed
STEPS = 200  # from each
TIME = 0.1  # [s] of each at the joints' full speed: as far as a step goes
EXACT = 1e-9  # [m and rad] at which a posture is taken
DAMPING = 1e-3  # Levenberg's, of the error squared
RIGID = 1e-6  # by how much a rotation given may miss being one
TARGET = "pose to reach"


class Miss(NamedTuple):
    """How far a posture leaves the frame from its pose."""

    position: float  # [m]
    angle: float  # [rad]


def reach(
    robot: Robot,
    q0: np.ndarray,
    pose: pin.SE3 | np.ndarray | Sequence[float],
    frame: str | None = None,
    limits: MotionLimits | None = None,
) -> Motion:
    """The `move` from q0 (nq,) that brings a frame to a pose, by pink's inverse kinematics.

    pose: of the frame in the base's, pin.SE3 or (4, 4) homogeneous; or (3,) [m], its position alone,
    whichever way it points. frame: a link's or joint's name; None for the robot's tool. Of the postures
    that reach it to 1e-9 m and rad, within the joint limits and torque to hold them, it takes the one found
    on the way from q0, else the nearest to q0 of those found from random starts. Raises ArgumentError where
    none is found, with what the nearest leaves, and for a position further off than all links are long;
    UnknownNameError for a frame that is none.
    """
    q0 = robot.check_q(q0, "q0")
    require_within(robot, q0, "q0")
    kinematics = _Kinematics(robot, frame or robot.tool, pose)
    rng, nearest, reached = np.random.default_rng(0), Miss(np.inf, np.inf), []
    for start in itertools.chain([q0], (robot.random_configuration(rng) for _ in range(STARTS - 1))):
        q, miss = kinematics.descended(start)
        nearest = min(nearest, miss, key=sum)
        if sum(miss) < EXACT and not unholdable(robot, q):
            reached.append(q)
            if start is q0:
                break
    if reached:
        q1 = min(reached, key=lambda q: float(np.linalg.norm(robot.difference(q0, q))))
        return replace(move(robot, q0, q1, limits), name="reach")
    if sum(nearest) < EXACT:
        raise ArgumentError("pose: every posture found there takes more torque than the effort limits allow")
    raise ArgumentError(
        f"pose: no posture within the joint limits was found from {STARTS} starts; the nearest leaves the "
        f"frame {1e3 * nearest.position:.3g} mm and {nearest.angle:.3g} rad from it"
    )


class _Kinematics:
    """A frame on its way to a pose, step by step."""

    def __init__(self, robot: Robot, frame: str, pose: pin.SE3 | np.ndarray | Sequence[float]):
        self.wanted, self.turned = _wanted(pose)
        # A frame of its own: pink looks frames up by name, which a joint and a link may share.
        self.model = robot.model.copy()
        tool = robot.model.frames[frame_index(robot.model, frame)]
        self.model.addFrame(pin.Frame(TARGET, tool.parentJoint, tool.placement, pin.FrameType.OP_FRAME))
        self.robot, self.lower, self.upper = robot, robot.lower, robot.upper
        distance, longest = float(np.linalg.norm(self.wanted.translation)), _longest(robot, tool)
        if distance > longest:
            raise ArgumentError(
                f"pose: its position is {distance:.4g} m from the base, {frame} reaches {longest:.4g} m at "
                "most; is it in metres, in the base's frame?"
            )
        self.limits = [ConfigurationLimit(self.model), VelocityLimit(self.model)]
        self.task = pink.FrameTask(TARGET, 1.0, float(self.turned), lm_damping=DAMPING)

    def descended(self, q: np.ndarray) -> tuple[np.ndarray, Miss]:
        """Where steps from q (nq,) end, and how far that leaves the frame."""
        place = pink.Configuration(self.model, self.model.createData(), q)
        for _ in range(STEPS):
            now = place.get_transform_frame_to_world(TARGET)
            target = self.wanted if self.turned else pin.SE3(now.rotation, self.wanted.translation)
            between = target.actInv(now)
            miss = Miss(
                float(np.linalg.norm(between.translation)), float(np.linalg.norm(pin.log3(between.rotation)))
            )
            if sum(miss) < EXACT:
                break
            self.task.set_target(target)
            try:
                v = pink.solve_ik(place, [self.task], TIME, "daqp", limits=self.limits, safety_break=False)
            except pink.exceptions.NoSolutionFound:
                break
            q = self.robot.coordinates(place.integrate(v, TIME))  # beyond the limits by what pink rounds
            place.update(self.robot.configuration(np.clip(q, self.lower, self.upper)))
        return place.q.copy(), miss


def _longest(robot: Robot, frame: pin.Frame) -> float:
    """[m] that a frame can be from the base at most: all links stretched out in one line."""
    model, path = robot.model, list(robot.model.supports[frame.parentJoint])[1:]
    links = sum(float(np.linalg.norm(model.jointPlacements[joint].translation)) for joint in path)
    sliding = [model.idx_vs[joint] for joint in path if not turning(robot)[model.idx_vs[joint]]]
    slid = np.maximum(np.abs(robot.lower), np.abs(robot.upper))[sliding].sum()
    return links + float(slid) + float(np.linalg.norm(frame.placement.translation)) + EXACT


def _wanted(pose: pin.SE3 | np.ndarray | Sequence[float]) -> tuple[pin.SE3, bool]:
    """A pose, and whether its rotation counts."""
    if isinstance(pose, pin.SE3):
        pose = pose.homogeneous
    legal = "pin.SE3, (4, 4) homogeneous, or (3,) a position alone, in the base's frame [m]"
    try:
        shape = np.shape(pose)
    except ValueError:  # lists of different lengths
        shape = ()
    if shape not in ((3,), (4, 4)):
        raise ArgumentError(f"pose: expected {legal}; got {f'shape {shape}' if shape else repr(pose)}")
    given = require_vector("pose", np.ravel(pose), int(np.prod(shape)))
    if shape == (3,):
        return pin.SE3(np.eye(3), given), False
    matrix = given.reshape(4, 4)
    R = matrix[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > RIGID or np.linalg.det(R) < 0 or np.any(matrix[3] != (0, 0, 0, 1)):
        raise ArgumentError(
            f"pose: expected {legal}, whose (3, 3) is a rotation and whose last row is 0, 0, 0, 1; got "
            f"{matrix.tolist()}"
        )
    return pin.SE3(R, matrix[:3, 3]), True
