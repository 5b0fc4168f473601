"""Whether an arm can be in a posture, and stay there."""

from __future__ import annotations

import numpy as np

from eladapt.errors import ArgumentError
from eladapt.robot.model import Robot


def require_within(
    robot: Robot,
    q: np.ndarray,
    name: str,
    *,
    lower: np.ndarray | None = None,
    upper: np.ndarray | None = None,
    slack: float = 0.0,
) -> None:
    """Raises ArgumentError, with joint and figures, where q (nq,) is beyond a joint's limits by more than
    ``slack`` [rad or m]; lower, upper (nv,): None for the robot's."""
    lower, upper = robot.lower if lower is None else lower, robot.upper if upper is None else upper
    x = robot.coordinates(q)
    beyond = np.maximum(x - upper, lower - x)
    k = int(beyond.argmax())
    if beyond[k] > slack:
        degrees = lower[k] <= np.deg2rad(x[k]) <= upper[k]
        raise ArgumentError(
            f"{name}: {robot.joint_names[k]} at {x[k]:.4g} is beyond its limits, {lower[k]:.4g} to "
            f"{upper[k]:.4g}{'; are these degrees?' if degrees else ''}"
        )


def require_holdable(robot: Robot, q: np.ndarray, name: str, effort: np.ndarray | None = None) -> None:
    """Raises ArgumentError, with joint and figures, where gravity at q (nq,) takes more than the effort (nv,)
    [N m], None for the robot's."""
    effort = robot.effort_limit if effort is None else effort
    gravity = robot.gravity(q)
    k = int(np.argmax(np.abs(gravity) / effort))
    if abs(gravity[k]) > effort[k]:
        raise ArgumentError(
            f"{name}: {robot.joint_names[k]} cannot be held there: gravity takes {abs(gravity[k]):.4g} N m, "
            f"the effort limit is {effort[k]:.4g} N m; are masses and lengths in kg and m?"
        )
