"""What all curves have in common, on paper and on a page."""

from __future__ import annotations

import numpy as np

# Neighbours differ in lightness, so that they differ in grey too.
COLOURS = (
    "#14213d", "#e07a1f", "#1d6f8a", "#d6609a", "#2f6b22", "#9c8af0",
    "#8c2f1b", "#45b5a6", "#5b2a86", "#b5a01a", "#5c6773", "#e39b8b",
)  # fmt: skip
SMALLEST = 1e-12  # the end of a logarithmic axis: what is below is rounding
MOST_POINTS = 3000  # of one curve; its extremes are kept
ARRIVED = 1e-3  # [rad], the error below which the arm counts as settled


def reduced(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The curve by at most `MOST_POINTS` points: the least and the greatest value of each interval."""
    width = -(-2 * len(t) // MOST_POINTS)
    if width <= 2:
        return t, values
    starts = np.arange(0, len(t), width)
    extremes = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    return np.repeat(t[starts], 2), np.stack(extremes, axis=1).ravel()
