"""Friction of every joint, from the information that the estimator has accumulated anyway.

Friction columns are nuisance parameters to the controller. Ordered [theta_M, theta_U, theta_F] instead
of [theta_M, theta_F, theta_U], the triangle's bottom block T_FF theta_F = t_F is the exact elimination of
all the rest: it needs only friction to be excited.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from eladapt.errors import ArgumentError
from eladapt.estimation.extensions import Information
from eladapt.estimation.mixing import DUST
from eladapt.robot.regressors import Regressors

# A parameter is unknown when more than this part of it lies in directions that are not excited.
UNSEEN = 1e-3


class FrictionEstimate(NamedTuple):
    """tau_f = viscous v + coulomb sign(v), by joint; nan where it is not known."""

    viscous: np.ndarray  # (nv,) [N m s/rad]
    coulomb: np.ndarray  # (nv,) [N m]
    known: np.ndarray  # (2, nv) which of viscous, coulomb were excited, joint by joint


def estimate_friction(regressors: Regressors, information: Information) -> FrictionEstimate:
    """Least squares over all that was seen, in physical units, of the friction columns there are.

    A joint that has not moved, or at one speed only, leaves a direction without information: what
    lies in it is nan and not ``known``. Raises ArgumentError for information of another regression.
    """
    nv, start, n = regressors.robot.nv, regressors.n_inertial, regressors.n_friction
    triangle = information.triangle
    if len(triangle) != len(regressors) + 1:
        raise ArgumentError(
            f"information: expected that of {len(regressors)} parameters, got {len(triangle) - 1}"
        )
    values = np.full((2, nv), np.nan)
    asked = np.array([regressors.viscous, regressors.coulomb])
    if n:
        values[asked] = _solve(triangle, start, n).reshape(-1, nv)
    return FrictionEstimate(values[0], values[1], np.isfinite(values))


def _solve(triangle: np.ndarray, start: int, n: int) -> np.ndarray:
    """(n,) parameters ``start`` to ``start + n`` by least squares, nan where they are not known."""
    rest = triangle[start:-1, start:]  # [F U t], all before it eliminated
    reordered = np.hstack([rest[:, n:-1], rest[:, :n], rest[:, -1:]])
    bottom = np.linalg.qr(reordered, mode="r")[-n:]
    block, vector = bottom[:, -n - 1 : -1], bottom[:, -1]
    left, singular, right = np.linalg.svd(block)
    excited = singular > DUST * max(np.linalg.norm(triangle[:-1, :-1]), np.finfo(float).tiny)
    values = right[excited].T @ ((left.T @ vector)[excited] / singular[excited])
    unseen = np.linalg.norm(right[~excited], axis=0)
    return np.where(unseen > UNSEEN, np.nan, values)
