"""What all curves have in common, on paper and on a page."""

from __future__ import annotations

import numpy as np

from eladapt.records.record import Record

# Neighbours differ in lightness, so that they differ in grey too.
COLOURS = (
    "#14213d", "#e07a1f", "#1d6f8a", "#d6609a", "#2f6b22", "#9c8af0",
    "#8c2f1b", "#45b5a6", "#5b2a86", "#b5a01a", "#5c6773", "#e39b8b",
)  # fmt: skip
FAULT_COLOUR = "#c1121f"
SMALLEST = 1e-12  # the end of a logarithmic axis: what is below is rounding
MOST_POINTS = 3000  # of one curve; its extremes are kept
ARRIVED = 1e-3  # [rad], the error below which the arm counts as settled

FELT = 0.05  # of the largest torque of the run; less from outside may be noise


def felt(record: Record) -> bool:
    """Whether torque from outside was recorded and is something to be shown."""
    if record.external is None:
        return False
    most = [float(np.nanmax(np.abs(torque), initial=0.0)) for torque in (record.external, record.tau)]
    return most[0] > FELT * most[1]


def reduced(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The curve by at most `MOST_POINTS` points: the least and the greatest value of each interval."""
    width = -(-2 * len(t) // MOST_POINTS)
    if width <= 2:
        return t, values
    starts = np.arange(0, len(t), width)
    extremes = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    return np.repeat(t[starts], 2), np.stack(extremes, axis=1).ravel()
