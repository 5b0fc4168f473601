"""Random postures and directions that several benchmarks draw."""

from __future__ import annotations

import numpy as np

import eladapt as ea

ROOM, EASY = 0.1, 0.7  # [rad] from the joint limits; share of the effort that holds a posture, without a load


def posture(robot: ea.Robot, rng: np.random.Generator) -> np.ndarray:
    """A random q inside the joint limits that the motors hold, with a load as well."""
    while True:
        q = robot.configuration(rng.uniform(robot.lower + ROOM, robot.upper - ROOM))
        if np.all(np.abs(robot.gravity(q)) < EASY * robot.effort_limit):
            return q


def direction(rng: np.random.Generator) -> np.ndarray:
    """(3,) of length 1."""
    vector = rng.normal(size=3)
    return np.array(vector / np.linalg.norm(vector))
