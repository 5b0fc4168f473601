"""What sampling says of a robot, (P1) to (P3).

The bounds are estimates, never proofs: an extreme in a posture that neither the samples nor the optimiser
came near is missed, so that each one errs on the optimistic side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from eladapt.errors import ArgumentError
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot

STARTS = 3  # best samples from which each extreme is refined
EVALUATIONS = 400  # of the objective, for each start


class ModelBounds(NamedTuple):
    """Sampled estimates of what the paper's conditions ask about a robot, within its joint limits."""

    mu_m: float  # smallest eigenvalue of M(q) (P1) [kg m^2]
    mu_M: float  # largest eigenvalue of M(q) (P1) [kg m^2]
    L_c: float  # max ||C(q, v)|| over unit v, the Lipschitz constant of C in v (P2) [kg m^2]
    k_Psi: float  # max ||Psi(q)|| (P3)
    k_g: np.ndarray  # (nv,) max |g_i(q)| (P3) [N m]


def model_bounds(
    model: Robot | Regressors,
    samples: int = 500,
    seed: int = 0,
    evaluations: int = EVALUATIONS,
    *,
    robot: Robot | None = None,
) -> ModelBounds:
    """mu_m, mu_M, L_c, k_Psi and k_g over ``samples`` random postures, then refined.

    model: a Robot, whose Psi is that of ``Regressors(robot)``, or Regressors. evaluations: bound on
    the evaluations of each refinement, of which there are three an extreme. robot: whose M, C and g
    it is about, when that is not the one that Psi was derived from. Norms are 2-norms.
    Raises ArgumentError for anything else, or a count below 1.
    """
    if not isinstance(model, Robot | Regressors):
        raise ArgumentError(f"model: expected a Robot or Regressors, got {type(model).__name__}")
    regressors = Regressors(model) if isinstance(model, Robot) else model
    robot = require_twin(robot, regressors)
    search = Search(robot, samples, seed, evaluations)

    def coriolis(x: np.ndarray, direction: np.ndarray) -> float:
        size = np.linalg.norm(direction)
        unit = direction / size if size > 0 else direction
        return float(np.linalg.norm(robot.coriolis_matrix(robot.configuration(x), unit), 2))

    def gravity(joint: int, x: np.ndarray) -> float:
        return abs(float(robot.gravity(robot.configuration(x))[joint]))

    def psi(x: np.ndarray) -> float:
        value = regressors.gravity(robot.configuration(x))
        return float(np.linalg.norm(value, 2)) if value.size else 0.0

    return ModelBounds(
        mu_m=1 / search.maximum(lambda x: 1 / mass_eigenvalues(robot, x)[0]),
        mu_M=search.maximum(lambda x: mass_eigenvalues(robot, x)[-1]),
        L_c=search.maximum(lambda x: coriolis(x[: robot.nv], x[robot.nv :]), directions=robot.nv),
        k_Psi=search.maximum(psi),
        k_g=np.array([search.maximum(partial(gravity, i)) for i in range(robot.nv)]),
    )


def mass_eigenvalues(robot: Robot, x: np.ndarray, scale: np.ndarray | float = 1.0) -> np.ndarray:
    """(nv,) ascending eigenvalues of diag(scale) M diag(scale) at joint coordinates x (nv,)."""
    scale = np.broadcast_to(scale, (robot.nv,))
    return np.linalg.eigvalsh(robot.mass_matrix(robot.configuration(x)) * np.outer(scale, scale))


class Search:
    """Looks for the largest value of functions of the joint coordinates, within the joint limits.

    Joints without limits are searched over one turn, (-pi, pi).
    """

    def __init__(self, robot: Robot, samples: int, seed: int = 0, evaluations: int = EVALUATIONS):
        self.evaluations = require_count("evaluations", evaluations)
        self.lower = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
        self.upper = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
        self.rng = np.random.default_rng(seed)
        self.samples = self.rng.uniform(
            self.lower, self.upper, size=(require_count("samples", samples), robot.nv)
        )

    def maximum(self, objective: Callable[[np.ndarray], float], directions: int = 0) -> float:
        """The largest value found of objective(x), x = [joint coordinates, random direction]."""
        points = np.hstack([self.samples, self.rng.normal(size=(len(self.samples), directions))])
        values = np.array([objective(x) for x in points])
        scale = best = float(values.max())
        if best <= 0:
            return best
        box = [*zip(self.lower, self.upper, strict=True), *([(None, None)] * directions)]
        for k in np.argsort(values)[-STARTS:]:
            # Relative to the best sample, so that one tolerance serves every quantity.
            found = minimize(
                lambda x: -objective(x) / scale, points[k], method="L-BFGS-B", bounds=box,
                options={"maxfun": self.evaluations, "gtol": 1e-9, "ftol": 1e-14},
            )  # fmt: skip
            best = max(best, -float(found.fun) * scale)
        return best


class Terms(NamedTuple):
    """What the model contributes at a state; the Lyapunov functions need no more of it."""

    momentum: np.ndarray  # (..., nv) M(q) e2
    gradient: np.ndarray  # (..., nv) C(q, e2)' e2
    gravity: np.ndarray  # (..., nv) Psi(q) theta_error


def model_terms(
    robot: Robot, regressors: Regressors, q: np.ndarray, e2: np.ndarray, theta_error: np.ndarray
) -> Terms:
    """`Terms` at every state of arrays of them: q (..., nq), e2 (..., nv), theta_error (..., j or more), the
    last j of theta_U."""
    shape = np.broadcast_shapes(q.shape[:-1], e2.shape[:-1], theta_error.shape[:-1])
    rows = [np.broadcast_to(x, (*shape, x.shape[-1])).reshape(-1, x.shape[-1]) for x in (q, e2, theta_error)]
    momentum, gradient, gravity = np.empty((3, len(rows[0]), robot.nv))
    for k, (q_k, v_k, error_k) in enumerate(zip(*rows, strict=True)):
        momentum[k] = robot.mass_matrix(q_k) @ v_k
        gradient[k] = robot.coriolis_matrix(q_k, v_k).T @ v_k
        gravity[k] = regressors.gravity(q_k) @ error_k[len(error_k) - regressors.n_potential :]
    return Terms(*(x.reshape(*shape, robot.nv) for x in (momentum, gradient, gravity)))


class States(NamedTuple):
    """A grid of errors at one posture: every combination of three sizes."""

    e1: np.ndarray  # (K, 1, 1, nv)
    e2: np.ndarray  # (1, K, 1, nv)
    theta_error: np.ndarray  # (1, 1, K, j)
    terms: Terms


def sample_states(
    robot: Robot, regressors: Regressors, sizes: np.ndarray, adapted: int, *, errors: np.ndarray,
    postures: int, seed: int,
) -> Iterator[States]:  # fmt: skip
    """Grids of states in random postures and directions: ||e1|| and ||e2|| in ``sizes``, ||theta_error||
    in ``errors``, of the last ``adapted`` parameters.

    Every other posture has e2 against e1, and every fourth both along the heaviest direction of M:
    there the cross terms of the Lyapunov functions are at their worst.
    """
    rng = np.random.default_rng(seed)
    nv = robot.nv
    for k in range(require_count("samples", postures)):
        q = robot.random_configuration(rng)
        u1, u2, u3 = (_unit(rng.normal(size=size)) for size in (nv, nv, adapted))
        if k % 4 == 1:
            u1 = np.linalg.eigh(robot.mass_matrix(q))[1][:, -1]
        if k % 2:
            u2 = -u1
        at = model_terms(robot, regressors, q, u2, u3)
        s1, s2 = sizes[:, None, None, None], sizes[:, None, None]
        s3 = errors[:, None]
        yield States(s1 * u1, s2 * u2, s3 * u3, Terms(s2 * at.momentum, s2**2 * at.gradient, s3 * at.gravity))


def _unit(x: np.ndarray) -> np.ndarray:
    return x / max(float(np.linalg.norm(x)), np.finfo(float).tiny)


def require_twin(robot: Robot | None, regressors: Regressors) -> Robot:
    """The regressors' robot, or another one with as many joints."""
    nominal = regressors.robot
    if robot is None:
        return nominal
    if not isinstance(robot, Robot) or (robot.nq, robot.nv) != (nominal.nq, nominal.nv):
        raise ArgumentError(
            f"robot: expected one with the {nominal.nv} joints of {nominal.name}, got {robot!r}"
        )
    return robot


def require_count(name: str, value: int) -> int:
    """A whole number of at least 1."""
    if not isinstance(value, int | np.integer) or value < 1:
        raise ArgumentError(f"{name}: expected a whole number of at least 1, got {value!r}")
    return int(value)
