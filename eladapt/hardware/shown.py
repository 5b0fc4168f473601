"""What a record shows of samples and goals that may be anything: nan where they are no such thing."""

from __future__ import annotations

from typing import Any

import numpy as np

from eladapt.robot.model import Robot
from eladapt.signals import Reference


def shown_number(value: Any) -> float:
    """Of a time stamp that may be anything."""
    return float(value) if isinstance(value, int | float | np.number) else float("nan")


def shown_reference(goal: Any, robot: Robot) -> Reference:
    """Of a goal that may be anything."""
    if not isinstance(goal, Reference):
        return Reference(shown_vector(goal, robot.nq), robot.still, robot.still)
    return Reference(
        *(shown_vector(part, n) for part, n in zip(goal, (robot.nq, robot.nv, robot.nv), strict=True))
    )


def shown_vector(value: Any, size: int) -> np.ndarray:
    """Of a vector that may be anything."""
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError):
        return np.full(size, np.nan)
    return vector if vector.shape == (size,) else np.full(size, np.nan)
