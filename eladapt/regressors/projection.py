"""The kernel behind every regressor: W = [standard regressor] @ map, and the joint columns.

A base parameter is a combination of a few standard parameters (44 numbers make all 43 columns of a Panda), so
of the map from standard parameters to theta only the entries that are not zero are kept and multiplied.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from eladapt.compiling import COUNT, COUNT_MATRIX, COUNTS, MATRIX, SCALAR, VECTOR, VIEW, kernel


class Columns(NamedTuple):
    """The columns of a regressor in theta: the last arguments of `project`.

    ``values[k]`` stands at row at[0, k] and column at[1, k] of the map (s, l). The joint columns begin at
    ``first``, in the order viscous, Coulomb, offset; -1: there are none.
    """

    at: np.ndarray  # (2, entries) int64; a rotor's row is 10 bodies + its joint
    values: np.ndarray  # (entries,)
    first: np.ndarray  # (3,) int64
    size: np.ndarray  # (3, nv) what the joint columns are multiplied by
    width: int  # l


@kernel(MATRIX, VIEW, VIEW, SCALAR, COUNT_MATRIX, VECTOR, COUNTS, MATRIX, COUNT)
def project(
    bodies: np.ndarray,
    a: np.ndarray,
    w: np.ndarray,
    speed: float,
    at: np.ndarray,
    values: np.ndarray,
    first: np.ndarray,
    size: np.ndarray,
    width: int,
) -> np.ndarray:
    """(nv, l): the regressor in theta of one in standard parameters; `Columns` has the other arguments.

    bodies (nv, 10 bodies): Pinocchio's; a (nv,): what the rotors are multiplied by; w (nv,) [rad/s]: the
    velocity of the joint columns, which are diag(w), diag(tanh(w / speed)) and the identity. speed [rad/s];
    with 0, Coulomb's column is diag(sign w).
    """
    n, standard = bodies.shape
    out = np.zeros((n, width))
    for i in range(n):
        for k in range(values.size):
            row = at[0, k]
            if row < standard:
                out[i, at[1, k]] += values[k] * bodies[i, row]
            elif row == standard + i:
                out[i, at[1, k]] += values[k] * a[i]
        if first[0] >= 0:
            out[i, first[0] + i] = size[0, i] * w[i]
        if first[1] >= 0:
            direction = math.tanh(w[i] / speed) if speed > 0 else np.sign(w[i])
            out[i, first[1] + i] = size[1, i] * direction
        if first[2] >= 0:
            out[i, first[2] + i] = size[2, i]
    return out
