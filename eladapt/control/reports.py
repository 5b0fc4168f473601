"""What a controller's state tells of the arm: its friction, the load that came, the load that it carries."""

from __future__ import annotations

from typing import Any

import numpy as np

from eladapt.errors import ArgumentError
from eladapt.estimation.friction import FrictionEstimate, estimate_friction
from eladapt.estimation.payload import PayloadEstimate, estimate_payload

# A direction about which the data say less than this many times the prior is not identified.
SEEN = 3.0


def friction(controller: Any, state: Any) -> FrictionEstimate:
    """Friction and offset of every joint by least squares on all that is remembered, with standard
    deviations.

    Raises ArgumentError where the controller has no friction columns.
    """
    return estimate_friction(
        controller.regressors, state.information.completed(state.parameters), state.information,
        **_scatter(controller),
    )  # fmt: skip


def payload(controller: Any, state: Any, frame: str | None = None) -> PayloadEstimate:
    """The load that came or went with the last change noticed, in ``frame`` (the tool if None).

    Weighed by least squares on what was seen before and since. Standard deviations are those of noise that
    the filters leave correlated for 2 / pole. What the arm's motion does not tell is not identified: at rest
    the place of the load along the vertical; a move tells it. Raises ArgumentError when the controller has
    noticed no change.
    """
    change = state.change
    if change is None or change.noticed == 0:
        raise ArgumentError("state: expected one in which a change was noticed; state.change says none was")
    regressors = controller.regressors
    known = change.before
    seen_before, seen = known.information, state.information
    before = seen_before.completed(known.parameters)
    after = seen.completed(state.parameters)
    scatter = _scatter(controller)
    variance = scatter["alpha"] * scatter["correlation"] * seen.variance
    return estimate_payload(
        regressors, before, after, seen, seen_before,
        variance=variance if np.isfinite(variance) else None, floor=SEEN * seen.prior, frame=frame,
    )  # fmt: skip


def carried(controller: Any, state: Any, frame: str | None = None) -> PayloadEstimate:
    """What the arm carries beyond the URDF's own bodies, in ``frame`` (the tool if None).

    The estimate less the URDF's parameters, where it was excited; right if the URDF's masses are.
    """
    regressors, seen = controller.regressors, state.information
    theta = seen.completed(state.parameters)
    return estimate_payload(regressors, regressors.theta, theta, seen, floor=SEEN * seen.prior, frame=frame)


def _scatter(controller: Any) -> dict[str, float]:
    """The weight of a second of rows, and for how long [s] the filter keeps their noise correlated."""
    alpha, pole = getattr(controller.extension, "alpha", 1.0), getattr(controller.regression, "pole", 20.0)
    return {"alpha": alpha, "correlation": 2 / pole}
