"""Parameters that an arm can have: pseudo-inertias positive definite, rotors and friction not negative.

theta leaves the standard parameters open: what an arm's motion cannot tell apart. Of all that are physical,
the nearest to the URDF's are taken that fit as well: the solution of a conic program, by clarabel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy.sparse

from eladapt.errors import EladaptError
from eladapt.gains.extremes import effort, extremes
from eladapt.regressors.regressors import Regressors
from eladapt.regressors.standard import pseudo_inertia
from eladapt.robot.rotors import ASSUMED_ROTOR_ACCELERATION

try:
    import clarabel
except ImportError as reason:
    raise EladaptError(
        f"physical parameters need clarabel, which is not installed ({reason}): "
        'pip install "eladapt[identify]"'
    ) from reason

# How little the URDF counts: as much as a measurement of each entry of a pseudo-inertia, in units of the
# URDF's own, with this standard deviation.
PRIOR = 1.0
LEAST = 1e-3  # of the URDF's pseudo-inertia, or of a typical one, that is left of a body
NOTHING = 1e-7  # [kg m^2, N m s/rad, N m] of a rotor or friction: the solver's zero
THIN = 1e-2  # of a body's size: how thin the URDF's may be, as a measure of what is near


def physical_parameters(
    regressors: Regressors, theta: np.ndarray, triangle: np.ndarray, own: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """(standard parameters (s,), theta (l,) of them): physical, near the URDF's, and fitting as well.

    Minimises |T (theta(x) - theta)|^2 + |J0^-1/2 (J(x) - J0) J0^-1/2|_F^2 / PRIOR^2 over all bodies, J being
    their pseudo-inertias (4, 4) and J0 the URDF's: the second term is, to second order, the distance of Lee,
    Wensing and Park (Geometric robot dynamic identification, 2020). J(x) >= LEAST J0; rotors, viscous and
    Coulomb friction are not negative.

    triangle (l, l): T of a `Fit`. own: how many parameters behind theta's are free. Raises EladaptError where
    the solver finds none.
    """
    size, nv = len(regressors), regressors.robot.nv
    nominal = regressors.robot_parameters
    bodies = 10 * nv
    n_rotors = len(nominal) - bodies
    friction = regressors.n_friction
    count = len(nominal) + friction + own
    # theta = map @ x, x = [standard parameters; friction; own]
    to_theta = np.zeros((size + own, count))
    to_theta[regressors.inertial, : len(nominal)] = regressors.basis.projection
    to_theta[regressors.friction, len(nominal) : len(nominal) + friction] = np.eye(friction)
    to_theta[:size] *= regressors.scale[:, None]
    to_theta[size:, len(nominal) + friction :] = np.eye(own)

    start = np.zeros(count)
    start[: len(nominal)] = nominal
    units = [_measure(nominal[10 * k : 10 * k + 10]) for k in range(nv)]
    prior, cones, blocks = [], [], []
    for k, (root, floor) in enumerate(units):
        columns = np.zeros((10, count))
        inverse = np.linalg.inv(root)
        basis = np.array([_vector(inverse @ pseudo_inertia(e) @ inverse.T) for e in np.eye(10)]).T
        columns[:, 10 * k : 10 * k + 10] = basis
        prior.append(columns)
        blocks.append((-columns, -_vector(LEAST * inverse @ floor @ inverse.T)))
        cones.append(clarabel.PSDTriangleConeT(4))
    rotor = np.zeros((n_rotors, count))
    unit = effort(regressors.robot, extremes(regressors.robot)) / ASSUMED_ROTOR_ACCELERATION
    unit = np.maximum(unit, regressors.robot.armature)[regressors.rotor_joints]
    rotor[:, bodies : bodies + n_rotors] = np.diag(1 / unit)
    prior.append(rotor)
    positive = np.r_[bodies : len(nominal)]
    for name in ("viscous", "coulomb"):
        block = regressors.block(name)
        positive = np.append(positive, len(nominal) - regressors.n_inertial + np.r_[block])
    blocks.append((-np.eye(count)[positive], np.zeros(len(positive))))
    cones.append(clarabel.NonnegativeConeT(len(positive)))

    near = np.vstack(prior) / PRIOR
    rows, wanted = np.vstack([triangle @ to_theta, near]), np.concatenate([triangle @ theta, near @ start])
    x = _solved(rows, wanted, blocks, cones)
    x[positive] = np.where(x[positive] > NOTHING, x[positive], 0)
    return x[: len(nominal)], to_theta @ x


def _solved(
    rows: np.ndarray, wanted: np.ndarray, blocks: Sequence[tuple[np.ndarray, np.ndarray]], cones: list
) -> np.ndarray:
    """x that minimises |rows x - wanted| with b - A x in the cones, for (A, b) in blocks.

    What is left, r = rows x - wanted, is a variable of its own, so that nothing is squared.
    """
    unit = 1 / np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    size, left = rows.shape[1], len(rows)
    constraints = [np.hstack([rows * unit, -np.eye(left)])]
    constraints += [np.hstack([a * unit, np.zeros((len(a), left))]) for a, _ in blocks]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_iter = False, 500
    solver = clarabel.DefaultSolver(
        scipy.sparse.block_diag([scipy.sparse.csc_matrix((size, size)), scipy.sparse.eye(left)], "csc"),
        np.zeros(size + left), scipy.sparse.csc_matrix(np.vstack(constraints)),
        np.concatenate([wanted, *(b for _, b in blocks)]), [clarabel.ZeroConeT(left), *cones], settings,
    )  # fmt: skip
    found = solver.solve()
    if found.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        raise EladaptError(f"no physical parameters found: the solver says {found.status}")
    return np.array(found.x[:size]) * unit


def _measure(nominal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(root R of J0 = R R' made thick enough to measure by, J0 thick)."""
    body = pseudo_inertia(nominal)
    values, vectors = np.linalg.eigh(body)
    thick = np.maximum(values, THIN * max(values.max(), 1e-9))
    return vectors * np.sqrt(thick), (vectors * thick) @ vectors.T


def _vector(matrix: np.ndarray) -> np.ndarray:
    """(10,) the upper triangle of (4, 4), column by column, off-diagonal entries times sqrt(2): its length is
    the matrix's Frobenius norm, and clarabel's form of it."""
    rows, columns = [], []
    for column in range(4):
        for row in range(column + 1):
            rows.append(row)
            columns.append(column)
    weight = np.where(np.array(rows) == np.array(columns), 1.0, math.sqrt(2))
    return weight * matrix[rows, columns]
