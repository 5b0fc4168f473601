"""Parameters that an arm can have: pseudo-inertias positive definite, rotors and friction not negative.

theta leaves the standard parameters open: what an arm's motion cannot tell apart. Of all that are physical,
the nearest to the URDF's are taken that fit as well: the solution of a conic program, by clarabel.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg
import scipy.sparse

from eladapt.errors import UnphysicalError, needing
from eladapt.gains.extremes import effort, extremes
from eladapt.regressors.regressors import Regressors
from eladapt.regressors.standard import pseudo_inertia
from eladapt.robot.rotors import ASSUMED_ROTOR_ACCELERATION

with needing("physical parameters need clarabel", "identify"):
    import clarabel

# How little the URDF counts: as much as a measurement of each entry of a pseudo-inertia, in units of the
# URDF's own, with this standard deviation.
PRIOR = 1.0
LEAST = 1e-3  # of the URDF's pseudo-inertia, or of a typical one, that is left of a body
LARGE = 10.0  # [N m s/rad, N m] of friction and offset, whose distance from the URDF's hardly counts
NOTHING = 1e-7  # [kg m^2, N m s/rad, N m] of a rotor or friction: the solver's zero
LIGHTEST = 1e-9  # [kg] of a body that can be measured by
THIN = 1e-2  # of a body's size: how thin the URDF's may be, as a measure of what is near


class PhysicalBodies:
    """The parameters that an arm can have, and the nearest of them to what data say.

    Of standard parameters x that are physical, those that minimise |T (theta(x) - theta)|^2 + |J0^-1/2 (J(x)
    - J0) J0^-1/2|_F^2 / PRIOR^2 over all bodies, J being their pseudo-inertias (4, 4) and J0 the URDF's: the
    second term is, to second order, the distance of Lee, Wensing and Park (Geometric robot dynamic
    identification, 2020). J(x) >= LEAST J0; rotors, viscous and Coulomb friction are not negative.

    own: how many parameters behind theta's are free. It can be sent to another process.
    """

    def __init__(self, regressors: Regressors, own: int = 0):
        nominal, bodies = regressors.robot_parameters, regressors.robot.nv
        self._standard = len(nominal)
        self._to_theta = _theta_of(regressors, own)
        rest = slice(len(nominal), self._to_theta.shape[1])  # friction, offsets and one's own
        start = np.zeros(rest.stop)
        start[: len(nominal)] = nominal
        friction = slice(rest.start, rest.start + regressors.n_friction)
        start[friction] = (regressors.theta / regressors.scale)[regressors.friction]
        unit = np.ones(len(start))  # of a change that is a large one
        rotors = slice(10 * bodies, len(nominal))
        unit[rotors], unit[rest] = _rotor_units(regressors), LARGE
        near, cones, bounds = np.diag(1 / unit), [], []
        for k in range(bodies):
            body = slice(10 * k, 10 * k + 10)
            thick, measure = _measure(nominal[body])
            near[body, body] = measure
            cone = np.zeros((10, len(start)))
            cone[:, body] = -measure
            cones.append(cone)
            bounds.append(-LEAST * measure @ thick)
        self._positive = np.r_[rotors]
        for name in ("viscous", "coulomb"):
            block = np.r_[regressors.block(name)]
            self._positive = np.append(self._positive, rest.start - regressors.n_inertial + block)
        self._cones = np.vstack([*cones, -np.eye(len(start))[self._positive]])
        self._bounds = np.concatenate([*bounds, np.zeros(len(self._positive))])
        self._bodies = bodies
        self._near, self._wanted = near / PRIOR, near @ start / PRIOR

    def nearest(self, theta: np.ndarray, triangle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(standard parameters (s,), theta (l,) of them).

        theta (l,) as data tell it, triangle (l, l): T with T'T the inverse of its covariance. Raises
        UnphysicalError where the solver finds none.
        """
        rows = np.vstack([triangle @ self._to_theta, self._near])
        x = self._solved(rows, np.concatenate([triangle @ theta, self._wanted]))
        x[self._positive] = np.where(x[self._positive] > NOTHING, x[self._positive], 0)
        return x[: self._standard], self._to_theta @ x

    def _solved(self, rows: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """x in the cones that minimises |rows x - wanted|.

        In y = R (x - x0), rows = Q R and x0 without cones: the least |y|, whatever the sizes in ``rows`` are.
        """
        unit = 1 / np.linalg.norm(rows, axis=0)
        triangle = scipy.linalg.qr(np.column_stack([rows * unit, wanted]), mode="r")[0]
        size = rows.shape[1]
        root, free = triangle[:size, :size], triangle[:size, size]
        loosest = scipy.linalg.solve_triangular(root, free)
        constraints = self._cones * unit
        turned = scipy.linalg.solve_triangular(root, constraints.T, trans="T").T
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_iter = False, 500
        cones = [clarabel.PSDTriangleConeT(4)] * self._bodies + [
            clarabel.NonnegativeConeT(len(self._positive))
        ]
        solver = clarabel.DefaultSolver(
            scipy.sparse.eye(size, format="csc"), np.zeros(size), scipy.sparse.csc_matrix(turned),
            self._bounds - constraints @ loosest, cones, settings,
        )  # fmt: skip
        found = solver.solve()
        if found.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
            raise UnphysicalError(
                f"there are no bodies that can be and fit (the solver says {found.status}): what fits is too "
                "far from any; are the torques' sign and unit right?"
            )
        step = scipy.linalg.solve_triangular(root, np.array(found.x))
        return np.asarray((loosest + step) * unit)


def _theta_of(regressors: Regressors, own: int) -> np.ndarray:
    """(l + own, s + friction + own): theta of [standard parameters; friction; one's own]."""
    size, friction, standard = len(regressors), regressors.n_friction, len(regressors.robot_parameters)
    found = np.zeros((size + own, standard + friction + own))
    found[regressors.inertial, :standard] = regressors.basis.projection
    found[regressors.friction, standard : standard + friction] = np.eye(friction)
    found[:size] *= regressors.scale[:, None]
    found[size:, standard + friction :] = np.eye(own)
    return found


def _rotor_units(regressors: Regressors) -> np.ndarray:
    """[kg m^2] the size of a rotor for each that there may be."""
    robot = regressors.robot
    typical = effort(robot, extremes(robot)) / ASSUMED_ROTOR_ACCELERATION
    return np.maximum(typical, robot.armature)[regressors.rotor_joints]


def _measure(nominal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(the ten parameters of a body like the nominal one, but thick enough to measure by; (10, 10) of the
    vector of R^-1 J R^-T, with R R' that one's pseudo-inertia)."""
    values, vectors = np.linalg.eigh(pseudo_inertia(nominal))
    values = np.maximum(values, THIN * max(values.max(), LIGHTEST))
    inverse = (vectors / np.sqrt(values)).T
    columns = [_vector(inverse @ pseudo_inertia(one) @ inverse.T) for one in np.eye(10)]
    measure = np.array(columns).T
    return np.linalg.solve(measure, _vector(np.eye(4))), measure


def _vector(matrix: np.ndarray) -> np.ndarray:
    """(10,) the upper triangle of (4, 4), column by column, off-diagonal entries times sqrt(2): its length is
    the matrix's Frobenius norm, and clarabel's form of it."""
    rows = [row for column in range(4) for row in range(column + 1)]
    columns = [column for column in range(4) for _ in range(column + 1)]
    weight = np.where(np.array(rows) == np.array(columns), 1.0, math.sqrt(2))
    return weight * matrix[rows, columns]
