"""What a controller has learned, as a fit."""

from __future__ import annotations

from typing import Any

import numpy as np

from eladapt.control.reports import SEEN
from eladapt.errors import ArgumentError
from eladapt.estimation.extensions import Information
from eladapt.identification.fitting import LEAST_NOISE, Fit, triangle_of
from eladapt.regressors.regressors import Regressors

CORRELATION = 0.1  # [s] of what disturbs a controller's filtered rows: 2 / pole


def learned(regressors: Regressors, state: Any) -> Fit:
    """What a controller's state knows: its parameters, and the information that they rest on.

    Raises ArgumentError for what is no state of a controller that learns all of these regressors' parameters.
    """
    information = getattr(state, "information", None)
    size = len(regressors)
    if not isinstance(information, Information) or np.shape(state.parameters) != (size,):
        raise ArgumentError(
            f"log: expected a Log, or the state of a CompositeController of {regressors.robot.name} that "
            f"learns {size} parameters, got {type(state).__name__}"
        )
    triangle, prior = information.triangle[:size, :size], information.prior
    values, vectors = np.linalg.eigh(triangle.T @ triangle - prior * np.eye(size))
    told = values > SEEN * prior
    variance = 1.0
    if information.weight > 0:
        typical = float(np.sum(information.triangle[:, -1] ** 2)) / information.weight  # of a row, squared
        variance = max(CORRELATION * information.variance, LEAST_NOISE**2 * typical)
    along = vectors[:, told].T
    root = np.zeros((size, size))
    root[: len(along)] = np.sqrt(values[told] / variance)[:, None] * along
    return Fit(
        information.completed(state.parameters), (along.T * (variance / values[told])) @ along,
        np.full(regressors.robot.nv, np.sqrt(variance)), triangle_of(root), vectors[:, ~told].T,
    )  # fmt: skip
