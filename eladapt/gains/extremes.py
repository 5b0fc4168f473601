"""How heavy and how fast an arm can get, over sampled configurations: what gains are derived from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.robot.reading import frame_index

_EXTREMES: WeakKeyDictionary[Robot, dict[tuple[int, int], Extremes]] = WeakKeyDictionary()
SAMPLES = 200  # configurations over which the extremes of M and g are taken


class Extremes(NamedTuple):
    """Largest values over sampled configurations, by joint: estimates, not bounds."""

    gravity: np.ndarray  # (nv,) max |g_i| [N m]
    inertia: np.ndarray  # (nv,) max M_ii [kg m^2]


class Mode(NamedTuple):
    """The fastest motion that only sampled feedback sees, over sampled configurations."""

    frequency: float  # [rad/s]
    joint: str  # the one that moves most in it


def extremes(robot: Robot, samples: int = SAMPLES, seed: int = 0) -> Extremes:
    """Over configurations within the joint limits; of a robot once, since gains, gate and plant all ask."""
    known = _EXTREMES.setdefault(robot, {})
    if (samples, seed) not in known:
        known[samples, seed] = _extremes(robot, configurations(robot, samples, seed))
    return known[samples, seed]


def _extremes(robot: Robot, postures: Sequence[np.ndarray]) -> Extremes:
    gravity = np.max([np.abs(robot.gravity(q)) for q in postures], axis=0)
    inertia = np.max([np.diag(robot.mass_matrix(q)) for q in postures], axis=0)
    for largest in (gravity, inertia):
        largest.setflags(write=False)
    return Extremes(gravity, inertia)


def effort(robot: Robot, largest: Extremes) -> np.ndarray:
    """(nv,) [N m] the URDF's effort limits; where it sets none, max(3 max|g_i|, 20 max M_ii)."""
    assumed = np.maximum(3 * largest.gravity, 20 * largest.inertia)
    return np.where(np.isfinite(robot.effort_limit), robot.effort_limit, assumed)


def levers(robot: Robot, samples: int = SAMPLES, seed: int = 0) -> np.ndarray:
    """(nv,) [m], 1 for a prismatic joint: by how much a joint moves the tool at most, over configurations."""
    model, frame = robot.model, frame_index(robot.model, robot.tool)
    data, longest = model.createData(), np.zeros(robot.nv)
    for q in configurations(robot, samples, seed):
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
        longest = np.maximum(longest, np.linalg.norm(jacobian, axis=0))
    return longest


def adaptation_mode(regressors: Regressors, Gamma: float, samples: int = SAMPLES, seed: int = 0) -> Mode:
    """omega^2 = lambda_max(M^-1 Psi Gamma Psi'): the direct term acts as a spring on the arm."""
    robot, fastest = regressors.robot, Mode(0.0, regressors.robot.joint_names[0])
    for q in configurations(robot, samples, seed):
        psi = regressors.gravity(q)
        scale = np.linalg.inv(np.linalg.cholesky(robot.mass_matrix(q)))
        stiffness = scale @ (Gamma * psi @ psi.T) @ scale.T
        values, vectors = np.linalg.eigh(stiffness)
        frequency = float(np.sqrt(max(values[-1], 0.0)))
        if frequency > fastest.frequency:
            motion = np.abs(scale.T @ vectors[:, -1])
            fastest = Mode(frequency, robot.joint_names[int(np.argmax(motion))])
    return fastest


def fall_mode(robot: Robot, samples: int = SAMPLES, seed: int = 0) -> Mode:
    """omega^2 = lambda_max(M^-1 dg/dq): how fast gravity changes under an arm between two samples."""
    fastest, step = Mode(0.0, robot.joint_names[0]), 1e-6
    for q in configurations(robot, samples, seed):
        columns = [
            robot.gravity(robot.integrate(q, e)) - robot.gravity(robot.integrate(q, -e))
            for e in step * np.eye(robot.nv)
        ]
        values, vectors = np.linalg.eig(
            np.linalg.solve(robot.mass_matrix(q), np.array(columns).T / (2 * step))
        )
        k = int(np.argmax(np.abs(values)))
        frequency = float(np.sqrt(np.abs(values[k])))
        if frequency > fastest.frequency:
            fastest = Mode(frequency, robot.joint_names[int(np.argmax(np.abs(vectors[:, k])))])
    return fastest


def configurations(robot: Robot, samples: int, seed: int) -> list[np.ndarray]:
    """Random ones within the joint limits, the same for the same seed."""
    rng = np.random.default_rng(seed)
    return robot.random_configurations(rng, samples)
