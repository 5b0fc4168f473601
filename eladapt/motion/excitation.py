"""Motions that tell as much of an arm's parameters as they can, within its limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize
from tqdm import tqdm

from eladapt.errors import ArgumentError, printable, require_number
from eladapt.gains.extremes import effort, extremes
from eladapt.motion.limits import MotionLimits
from eladapt.motion.motions import Course, Motion
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.robot.postures import require_holdable, require_within

HARMONICS = 5
POINTS = 120  # at which a motion is judged
RANDOM = 10  # others that it is compared with, the best of which is where the search begins
ROUNDS = 40  # of the search
BETWEEN = 0.98  # of the limits, since a motion is judged at some points
STEP = 1e-3  # of its finite differences: larger than what sign(v) does at one point
BISECTIONS = 12
SMOOTH_TERMS = ("rotor", "viscous", "offset")  # what tells viscous friction and offset tells Coulomb's too
MARGIN, SPARE = 0.05, 0.1  # kept free of the joint range, of the effort limits
WIDEST = np.pi / 2  # [rad or m] about the start where the range is not limited


@dataclass(frozen=True, eq=False)
class Excitation(Motion):
    """A motion with the condition number of its stacked torque regressor, and those of random ones."""

    condition: float = np.inf
    random: tuple[float, ...] = ()

    def __repr__(self) -> str:
        others = ", ".join(f"{c:.3g}" for c in sorted(self.random))
        return (
            f"Excitation({self.robot.name}, {self.duration:.4g} s: condition number {self.condition:.3g}, "
            f"of random ones {others})"
        )


def excitation(
    robot: Robot,
    duration: float = 10.0,
    limits: MotionLimits | None = None,
    *,
    q0: np.ndarray | None = None,
    regressors: Regressors | None = None,
    rounds: int = ROUNDS,
    seed: int = 0,
    progress: bool = True,
) -> Excitation:
    """A Fourier series of ``duration`` [s] from rest to rest at q0 (nq,) whose torque tells the parameters
    best.

    The condition number of the torque regressor W, stacked over the motion, is lowered from the best of ten
    random ones, within positions, velocities, accelerations and, by the URDF's dynamics, efforts (after
    Swevers et al., Optimal robot excitation and identification, 1997). W's columns are in the units of
    ``regressors``: None for the whole theta but Coulomb friction, scaled. limits: None for
    `MotionLimits.for_robot`. q0: None for home. rounds: of the search, half a second each on a Panda. Raises
    ArgumentError for a q0 beyond its limits or that cannot be held, and a duration that is not positive.
    """
    duration = require_number("duration", duration, 0)
    q0 = robot.configuration(robot.home) if q0 is None else robot.check_q(q0, "q0")
    require_within(robot, q0, "q0")
    require_holdable(robot, q0, "q0")
    if rounds < 0:
        raise ArgumentError(f"rounds: expected 0 or more, got {rounds}")
    limits = limits or MotionLimits.for_robot(robot)
    regressors = regressors or Regressors(robot, joint_terms=SMOOTH_TERMS)
    problem = _Problem(robot, q0, duration, limits, regressors)
    rng = np.random.default_rng(seed)
    tried = [rng.normal(size=problem.size) for _ in range(RANDOM)]
    random = [problem.condition(z) for z in tried]
    best = tried[int(np.argmin(random))]
    found = best
    if rounds:
        quiet = None if progress else True
        said = f"excitation of {printable(robot.name)}"
        with tqdm(total=rounds, desc=said, unit="round", disable=quiet) as bar:
            search = minimize(
                lambda z: np.log(problem.condition(z)), best, method="L-BFGS-B",
                callback=lambda _: bar.update(),
                options={"maxiter": rounds, "maxfun": 10**6, "eps": STEP},
            )  # fmt: skip
        found = min((search.x, best), key=problem.condition)
    scale = problem.scale(found)
    return Excitation(
        robot, q0.copy(), duration, lambda t: Course(*(part[0] for part in problem.series(found, scale, t))),
        "excitation", problem.condition(found), tuple(random),
    )  # fmt: skip


class _Problem:
    """From free numbers to a motion within the limits, and what it tells."""

    def __init__(
        self, robot: Robot, q0: np.ndarray, duration: float, limits: MotionLimits, regressors: Regressors
    ):
        self.robot, self.q0, self.limits, self.regressors = robot, q0, limits, regressors
        self.w = 2 * np.pi / duration
        self.order = np.arange(1, HARMONICS + 1)
        # v = sum a_k cos + b_k sin, from rest: sum a_k = 0, and sum k b_k = 0 for the acceleration.
        self.even = _null_space(np.ones(HARMONICS))
        self.odd = _null_space(self.order.astype(float))
        self.size = robot.nv * 2 * (HARMONICS - 1)
        self.times = np.linspace(0, duration, POINTS, endpoint=False)
        x = robot.coordinates(q0)
        room = (np.minimum(robot.upper, x + WIDEST) - x, x - np.maximum(robot.lower, x - WIDEST))
        self.up, self.down = ((1 - MARGIN) * np.maximum(part, 1e-6) for part in room)
        self.data = robot.model.createData()
        self.effort = (1 - SPARE) * effort(robot, extremes(robot))

    def series(self, z: np.ndarray, scale: np.ndarray, t: float | np.ndarray) -> Course:
        """The motion at times t, (n, nv) each; scale (nv,): of each joint's."""
        first, second = np.reshape(z, (2, HARMONICS - 1, self.robot.nv))
        a, b = self.even @ first * scale, self.odd @ second * scale  # (harmonics, nv)
        turn = self.w * np.multiply.outer(np.atleast_1d(t), self.order)
        sine, cosine, rate = np.sin(turn), np.cos(turn), self.w * self.order
        x = (sine / rate) @ a + ((1 - cosine) / rate) @ b
        return Course(x, cosine @ a + sine @ b, -(sine * rate) @ a + (cosine * rate) @ b)

    def scale(self, z: np.ndarray) -> np.ndarray:
        """(nv,) by which each joint comes within positions, velocities and accelerations, and then all of
        them within the efforts."""
        one = np.ones(self.robot.nv)
        x, v, a = self.series(z, one, self.times)
        over = [
            x.max(axis=0) / self.up, -x.min(axis=0) / self.down,
            np.abs(v).max(axis=0) / self.limits.velocity, np.abs(a).max(axis=0) / self.limits.acceleration,
        ]  # fmt: skip
        scale = BETWEEN / np.maximum(np.max(over, axis=0), 1e-9)
        if self._used(z, scale) <= 1:
            return scale
        low, high = 0.0, 1.0  # in between, some share of the motion is just within the efforts
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._used(z, middle * scale) <= 1 else (low, middle)
        return low * scale

    def condition(self, z: np.ndarray) -> float:
        """Of the regressor, stacked over the motion, each row by its effort limit."""
        x, v, a = self.series(z, self.scale(z), self.times)
        rows = [
            self.regressors.torque(pin.integrate(self.robot.model, self.q0, dx), *rate, check=False)
            / self.effort[:, None]
            for dx, *rate in zip(x, v, a, strict=True)
        ]
        singular = np.linalg.svd(np.concatenate(rows), compute_uv=False)
        return float(singular[0] / max(singular[-1], 1e-300))

    def _used(self, z: np.ndarray, scale: np.ndarray) -> float:
        """The largest share of an effort limit that the URDF's arm needs."""
        model, data = self.robot.model, self.data
        torque = [
            pin.rnea(model, data, pin.integrate(model, self.q0, dx), dv, da) / self.effort
            for dx, dv, da in zip(*self.series(z, scale, self.times), strict=True)
        ]
        return float(np.abs(torque).max())


def _null_space(row: np.ndarray) -> np.ndarray:
    """(n, n - 1) an orthonormal basis of what a row (n,) is blind to."""
    return np.linalg.svd(row[None])[2][1:].T
