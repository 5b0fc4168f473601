"""Where a point of the robot is in another's model of the same arm, whose body frames may be others.

Two models of one arm need agree on no frame but on the axes of the joints: a UR5e of another author has a
base turned by a quarter and link frames of another convention. So the bases are laid on each other by the
axes, at many postures, and points are carried over through the world.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError
from eladapt.robot.model import Robot

POSTURES = 20
# [m] Vendors' and others' figures of one arm differ by 1 mm; another zero shows in decimetres.
FARTHEST = 0.02
GRAVITY_WEIGHT = 1e-3  # decides only what the axes leave open
PARALLEL = 0.1  # sine of an angle below which two axes span a line


class Screws(NamedTuple):
    """The axes of all joints in the world, (nv, 3) each: unit directions, and feet of the origin on them."""

    directions: np.ndarray
    feet: np.ndarray


def point_in_body(
    robot: Robot, joint: int, point: np.ndarray, model: mujoco.MjModel, joint_ids: np.ndarray
) -> np.ndarray:
    """(3,) a point [m] of the frame of the robot's joint, in the body that this joint moves in ``model``.

    joint: Pinocchio's index. joint_ids (nv,): the robot's joints in ``model``. Raises ArgumentError when the
    point does not rest in that body over sampled postures: the models are not of one arm, or count positions
    from another zero or the other way round.
    """
    rng, ours, theirs = np.random.default_rng(0), robot.model.createData(), mujoco.MjData(model)
    seen, others, points, bodies = [], [], [], []
    body = model.jnt_bodyid[joint_ids[robot.model.idx_vs[joint]]]
    for _ in range(POSTURES):
        q = robot.random_configuration(rng)
        theirs.qpos[model.jnt_qposadr[joint_ids]] = robot.coordinates(q)
        mujoco.mj_kinematics(model, theirs)
        jacobian = np.array(pin.computeJointJacobians(robot.model, ours, q)).reshape(6, robot.nv)
        seen.append(_screws(jacobian))
        others.append(_foreign_screws(theirs, joint_ids))
        points.append(ours.oMi[joint].act(point))
        bodies.append(pin.SE3(theirs.xmat[body].reshape(3, 3).copy(), theirs.xpos[body].copy()))
    turning = model.jnt_type[joint_ids] == mujoco.mjtJoint.mjJNT_HINGE
    base = _base(seen, others, turning, robot.model.gravity.linear, model.opt.gravity)
    found = np.array([at.actInv(base.act(p)) for at, p in zip(bodies, points, strict=True)])
    spread = float(np.linalg.norm(found - found.mean(axis=0), axis=1).max())
    if spread > FARTHEST:
        raise ArgumentError(
            f"mjcf: a load at the robot's frame would move by {spread:.2g} m in the body that carries it; "
            "expected joint axes, zero positions and directions as in the URDF"
        )
    return found.mean(axis=0)


def _screws(jacobian: np.ndarray) -> Screws:
    """From a Jacobian (6, nv) [linear, angular] at the origin of the world."""
    linear, angular = jacobian[:3].T, jacobian[3:].T
    turning = np.linalg.norm(angular, axis=1, keepdims=True) > 0.5  # 1 or 0
    return Screws(np.where(turning, angular, linear), np.cross(angular, linear))


def _foreign_screws(data: mujoco.MjData, joint_ids: np.ndarray) -> Screws:
    directions, anchors = data.xaxis[joint_ids], data.xanchor[joint_ids]
    along = np.sum(directions * anchors, axis=1, keepdims=True)
    return Screws(directions, anchors - along * directions)


def _base(
    ours: list[Screws], theirs: list[Screws], turning: np.ndarray, gravity: np.ndarray, foreign: np.ndarray
) -> pin.SE3:
    """What lays the robot's world on the other's, in the least squares of the axes of both."""
    pairs = [_vectors(screws, turning) for screws in ours], [_vectors(screws, turning) for screws in theirs]
    one, two = (
        np.vstack([*vectors, GRAVITY_WEIGHT * g])
        for vectors, g in zip(pairs, (gravity, foreign), strict=True)
    )
    left, _, right = np.linalg.svd(two.T @ one)
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    rows, sides = [], []
    for mine, other in zip(ours, theirs, strict=True):
        for k in np.flatnonzero(turning):
            across = np.eye(3) - np.outer(other.directions[k], other.directions[k])
            rows.append(across)
            sides.append(across @ (other.feet[k] - rotation @ mine.feet[k]))
    if not rows:  # nothing turns: a load weighs the same wherever it is
        return pin.SE3(rotation, np.zeros(3))
    shift = np.linalg.lstsq(np.vstack(rows), np.concatenate(sides), rcond=1e-9)[0]
    return pin.SE3(rotation, shift)


def _vectors(screws: Screws, turning: np.ndarray) -> np.ndarray:
    """(m, 3) vectors that belong to the axes alone: directions, and the way across from each to the next."""
    vectors = [screws.directions]
    at = np.flatnonzero(turning)
    for i, j in itertools.pairwise(at):
        _, sizes, spanned = np.linalg.svd(screws.directions[[i, j]])
        spanned = spanned[:2][sizes > PARALLEL]
        way = screws.feet[j] - screws.feet[i]
        vectors.append((way - spanned.T @ (spanned @ way))[None])
    return np.vstack(vectors)
