"""What flows along the line, from the sensors to the adaptation law."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Measurement(NamedTuple):
    """What is known of the robot at time ``t``.

    ``tau`` is the torque that was *applied* over the step that ends at ``t`` (after saturation),
    so no block has to remember what it commanded and clipping corrupts no filter.
    """

    t: float  # [s]
    q: np.ndarray  # (nq,)
    v: np.ndarray  # (nv,) [rad/s or m/s]
    tau: np.ndarray  # (nv,) [N m or N]


class Regression(NamedTuple):
    """Filtered linear regression ``y = omega @ theta`` (NLRPE), (LREq)."""

    y: np.ndarray  # (m,): m = nv for the force balance, 1 for the power balance
    omega: np.ndarray  # (m, l)


class MixedRegression(NamedTuple):
    """Scalar regressions ``Y = delta * (basis.T @ theta_S)`` (LSREq), (465).

    theta_S is theta_U with scope "potential" (k = n_potential), the whole theta with scope "all"
    (k = l). ``delta`` is one number, or one number per direction.
    """

    Y: np.ndarray  # (k,)
    delta: float | np.ndarray  # scalar or (k,)
    basis: np.ndarray  # (k, k) orthogonal; the identity when delta is one number
