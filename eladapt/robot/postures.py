"""Whether an arm can be in a posture, and stay there."""

from __future__ import annotations

import numpy as np

from eladapt.errors import ArgumentError
from eladapt.robot.model import Robot

TURN = 2 * np.pi  # [rad] by more than that nobody means a joint to be beyond its range


def beyond(robot: Robot, x: np.ndarray, lower: np.ndarray, upper: np.ndarray, slack: float = 0.0) -> str:
    """Which joint coordinates x (nv,) are beyond lower, upper (nv,) by more than ``slack`` [rad or m], with
    all figures, and whether they look like degrees; "" where none are."""
    off = np.maximum(x - upper, lower - x)
    outside = np.flatnonzero(off > slack)
    if not len(outside):
        return ""
    said = [(robot.joint_names[k], f"{x[k]:.4g}", f"{lower[k]:.4g} to {upper[k]:.4g}") for k in outside]
    if len(said) == 1:
        name, value, limits = said[0]
        text = f"{name} at {value} is beyond its limits, {limits}"
    else:
        each = ", ".join(f"{name} at {value} ({limits})" for name, value, limits in said)
        text = f"beyond their limits: {each}"
    read = np.deg2rad(x[outside])
    degrees = np.all((lower[outside] <= read) & (read <= upper[outside])) and turning(robot)[outside].all()
    far = off.max() > TURN or len(outside) == robot.nv
    return text + ("; are these degrees?" if degrees and far else "")


def turning(robot: Robot) -> np.ndarray:
    """(nv,) which joints turn, and do not slide."""
    kinds = [joint.shortname() for joint in list(robot.model.joints)[1:]]
    return np.array([not kind.startswith("JointModelP") for kind in kinds])  # prismatic


def require_within(
    robot: Robot,
    q: np.ndarray,
    name: str,
    *,
    lower: np.ndarray | None = None,
    upper: np.ndarray | None = None,
    slack: float = 0.0,
) -> None:
    """Raises ArgumentError, with joints and figures, where q (nq,) is beyond joint limits by more than
    ``slack`` [rad or m]; lower, upper (nv,): None for the robot's."""
    lower, upper = robot.lower if lower is None else lower, robot.upper if upper is None else upper
    if said := beyond(robot, robot.coordinates(q), lower, upper, slack):
        raise ArgumentError(f"{name}: {said}")


def unholdable(robot: Robot, q: np.ndarray, effort: np.ndarray | None = None) -> str:
    """Which joint cannot be held, since gravity at q (nq,) takes more than the effort (nv,) [N m], None for
    the robot's, with figures; "" where all can."""
    effort = robot.effort_limit if effort is None else effort
    gravity = robot.gravity(q)
    k = int(np.argmax(np.abs(gravity) / effort))
    if abs(gravity[k]) <= effort[k]:
        return ""
    return (
        f"{robot.joint_names[k]} cannot be held there: gravity takes {abs(gravity[k]):.4g} N m, "
        f"the effort limit is {effort[k]:.4g} N m; are masses and lengths in kg and m?"
    )


def require_holdable(robot: Robot, q: np.ndarray, name: str, effort: np.ndarray | None = None) -> None:
    """Raises ArgumentError, with joint and figures, where q (nq,) is `unholdable`."""
    if said := unholdable(robot, q, effort):
        raise ArgumentError(f"{name}: {said}")
