"""Friction of every joint, from the information that the estimator has accumulated anyway."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from eladapt.errors import ArgumentError
from eladapt.estimation.extensions import Information, covariance
from eladapt.regressors.joint_terms import FRICTION_TERMS
from eladapt.regressors.regressors import Regressors

DOUBT = 0.1  # a parameter is known when its standard deviation is below this part of the largest of its kind
HALF = 0.5  # of a parameter: more of it that only the prior says leaves it unknown
LEAST_SIZE = 0.1  # [N m] or [N m s/rad] that a parameter counts as at least, when it is asked what is known


class FrictionEstimate(NamedTuple):
    """tau_f = viscous v + coulomb sign(v) + offset, by joint; nan where there is no such column."""

    viscous: np.ndarray  # (nv,) [N m s/rad]
    coulomb: np.ndarray  # (nv,) [N m]
    offset: np.ndarray  # (nv,) [N m]
    std: np.ndarray  # (3, nv) standard deviations of the three
    known: np.ndarray  # (3, nv) which are known, within a tenth of the largest of its kind
    joints: tuple[str, ...]  # nv names

    def rows(self) -> list[tuple[str, ...]]:
        """A table in words: the head, and a row a joint."""
        head = ("friction", "viscous [N m s/rad]", "Coulomb [N m]", "offset [N m]")
        values = np.array([self.viscous, self.coulomb, self.offset])
        rows = [
            (
                name,
                *(
                    _said(*entry)
                    for entry in zip(values[:, i], self.std[:, i], self.known[:, i], strict=True)
                ),
            )
            for i, name in enumerate(self.joints)
        ]
        return [head, *rows]

    def __str__(self) -> str:
        rows = self.rows()
        wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join(
            "  ".join(cell.ljust(width) for cell, width in zip(row, wide, strict=True)).rstrip()
            for row in rows
        )

    def _repr_html_(self) -> str:
        from eladapt.display import inline

        return inline.friction(self)

    def __repr__(self) -> str:
        found = int(np.sum(self.known))
        return f"FrictionEstimate({len(self.viscous)} joints, {found} of {self.known.size} parameters known)"


def _said(value: float, std: float, known: bool) -> str:
    """One value with its standard deviation, rounded to what that leaves; in words where nothing is told."""
    if np.isnan(value):
        return "not estimated"
    if not np.isfinite(std):
        return "not known"
    rounded = round(value, 1 - math.floor(math.log10(std))) if std > 0 else value
    return f"{rounded + 0.0:.4g} +- {std:.2g}" + ("" if known else " (doubtful)")


def estimate_friction(
    regressors: Regressors,
    theta: np.ndarray,
    information: Information,
    *,
    alpha: float = 1.0,
    correlation: float = 0.1,
) -> FrictionEstimate:
    """theta_F in physical units, with standard deviations that shrink with data.

    theta (l,): the least-squares estimate. The scatter is that of noise whose mean square the residual tells,
    correlated over ``correlation`` [s] (2 / pole for noise of the torque): variance = alpha correlation s^2
    F_ii, alpha [1/s] being the weight of a second of rows. What the prior still holds of a parameter, prior
    F_ii, is not known at all and counts with the largest of its kind. Raises ArgumentError where there are no
    friction columns, or for information of another regression.
    """
    if not regressors.n_friction:
        raise ArgumentError(
            "friction: these regressors have no friction columns; "
            'joint_terms=("viscous", "coulomb", "offset") makes them'
        )
    if len(information.triangle) != len(regressors) + 1:
        raise ArgumentError(
            f"information: expected that of {len(regressors)} parameters, got {len(information.triangle) - 1}"
        )
    diagonal = np.diag(covariance(information))
    noise = alpha * correlation * (information.variance if information.weight else 0.0)
    return friction_of(regressors, theta, np.sqrt(noise * diagonal), information.prior * diagonal)


def friction_of(
    regressors: Regressors, theta: np.ndarray, std: np.ndarray, doubt: np.ndarray | None = None
) -> FrictionEstimate:
    """theta_F in physical units, of theta (l,) and its standard deviations (l,).

    doubt (l,): the part of a parameter about which nothing is known; it counts with the largest of its kind,
    and where it is more than half, nothing is known of the parameter: its standard deviation is inf.
    """
    values, deviations, known = (np.full((3, regressors.robot.nv), np.nan) for _ in range(3))
    for k, name in enumerate(FRICTION_TERMS):
        block = regressors.block(name)
        if block.stop > block.start:
            scale = regressors.scale[block]
            values[k] = theta[block] / scale
            largest = max(LEAST_SIZE, float(np.abs(values[k]).max()))
            unknown = np.zeros(len(scale)) if doubt is None else doubt[block]
            deviations[k] = np.hypot(std[block] / scale, unknown * largest)
            deviations[k, unknown > HALF] = np.inf
            known[k] = deviations[k] < DOUBT * largest
    names = regressors.robot.joint_names
    return FrictionEstimate(values[0], values[1], values[2], deviations, known == 1, names)
