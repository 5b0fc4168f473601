"""Where the parameters of a controller start, and where they stay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eladapt.errors import ArgumentError, UnknownNameError, require_vector
from eladapt.regressors.regressors import Regressors

NOTHING = 2e-3  # of the largest Coulomb friction, and the same number of viscous friction [N m s/rad]


def starting_parameters(
    theta0: str | Sequence[float] | np.ndarray | None, regressors: Regressors, default: str = "zero"
) -> np.ndarray:
    """(l,) the whole theta to begin with.

    theta0: "urdf", the URDF's values; "zero"; all l of them; or the n_potential gravity parameters, the rest
    being that of ``default``, which also holds where theta0 is None. Raises UnknownNameError for another
    name, ArgumentError for another length or numbers that are not finite.
    """
    size, j = len(regressors), regressors.n_potential
    if theta0 is None or isinstance(theta0, str):
        name = default if theta0 is None else theta0
        if name not in ("urdf", "zero"):
            raise UnknownNameError("theta0", [name], ("urdf", "zero"))
        return np.array(regressors.theta) if name == "urdf" else np.zeros(size)
    if np.shape(theta0) not in ((size,), (j,)):
        raise ArgumentError(
            f'theta0: expected "urdf", "zero", the whole theta ({size},) or theta_U ({j},), '
            f"got shape {np.shape(theta0)}"
        )
    if len(theta0) == j != size:
        start = starting_parameters(default, regressors)
        start[size - j :] = require_vector("theta0", theta0, j)
        return start
    return np.array(require_vector("theta0", theta0, size))


def friction_bounds(regressors: Regressors, coulomb: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(l, 2) intervals of theta: friction is not negative, Coulomb friction at most ``coulomb`` (nv,) [N m],
    an offset at most ``offset`` (nv,) [N m]; whatever else is free. `NOTHING` is left below zero, or an arm
    without friction would be at its bounds for ever."""
    bounds = np.full((len(regressors), 2), (-np.inf, np.inf))
    least = -NOTHING * coulomb
    for name, limits in (
        ("viscous", (least, least + np.inf)), ("coulomb", (least, coulomb)), ("offset", (-offset, offset))
    ):  # fmt: skip
        block = regressors.block(name)
        bounds[block] = (regressors.scale[block] * limits).T if block.stop > block.start else bounds[block]
    return bounds
