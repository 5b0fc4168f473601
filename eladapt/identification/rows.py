"""Rows y = Omega theta of a log: its force balance, averaged over windows, without acceleration.

Over each step the force balance (399) holds for impulses, and so it does for any weighted sum of steps, the
same weights standing in y and in Omega, and each joint may have weights of its own. In a controller they are
those of a filter, which looks back. A log can be looked at from both sides: here they are a window cos^2
about its middle, so what noise the velocities have is not seen through its increments but through the
derivative of the window (the modulating functions of Shinbrot, 1957).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from eladapt.errors import ArgumentError, printable
from eladapt.estimation.regressions import ForceBalance
from eladapt.identification.log import Log
from eladapt.regressors.regressors import Regressors

LEAST_MOTION = 0.2  # of a window's weight: below, a joint has no row of it
OVERLAP = 4  # windows over each moment

# What acts on the joints beside what `Regressors` knows: (q, v, a) in joint coordinates (nv,) -> (nv,)
Column = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class Rows(NamedTuple):
    """n windows: y = omega @ theta, a row for each joint, where ``holds``; both are 0 where it does not."""

    t: np.ndarray  # (n,) [s] their middles
    y: np.ndarray  # (n, nv) [N m or N]
    omega: np.ndarray  # (n, nv, l)
    holds: np.ndarray  # (n, nv)


def rows_of(
    log: Log,
    regressors: Regressors,
    columns: Mapping[str, Column] | None = None,
    *,
    window: float,
    stiction_speed: float,
    progress: bool = False,
) -> Rows:
    """The rows of a log that has the robot's joints in its order.

    window [s]: of one average, four of which overlap; none reaches over a gap. Steps in which a joint's speed
    is at most stiction_speed [rad/s] do not count in its rows, since it may stick there; above, they count
    more and more, up to twice that speed. A joint that moves little in a window has no row of it. columns:
    further ones, behind theta's. Raises ArgumentError where no piece of the log is as long as a window, and
    for a column that is not one number a joint.
    """
    robot = regressors.robot
    balance = ForceBalance(regressors)
    own = columns or {}
    size = len(regressors) + len(own)
    middles = _middles(log, window)
    n, half = len(middles), 0.5 * window
    y, omega, weight = np.zeros((n, robot.nv)), np.zeros((n, robot.nv, size)), np.zeros(n)
    moving = np.zeros((n, robot.nv))  # the weight of what counts
    x, v = log.q, log.velocity
    q = np.array([robot.configuration(row) for row in x])
    regressor = np.empty((robot.nv, size))
    steps = [k for piece in log.segments for k in range(piece.start, piece.stop - 1)]
    with tqdm(
        steps, desc=f"log of {printable(robot.name)}", unit="step", disable=None if progress else True
    ) as bar:
        for k in bar:
            dt = log.t[k + 1] - log.t[k]
            middle = log.t[k] + 0.5 * dt
            first, last = np.searchsorted(middles, (middle - half, middle + half))
            if first == last:
                continue
            regressor[:] = 0
            for point, velocity, slope in balance.points(q[k], v[k], q[k + 1], v[k + 1], dt):
                row = regressors.torque(point, velocity, slope, check=False)
                place = robot.coordinates(point) if own and robot.nq > robot.nv else point
                regressor += 0.5 * extended(row, own, place, velocity, slope)
            torque = log.tau[k + 1] if log.held else 0.5 * (log.tau[k] + log.tau[k + 1])
            counts = np.clip(0.5 * np.abs(v[k] + v[k + 1]) / stiction_speed - 1, 0.0, 1.0)
            for i in range(first, last):
                share = dt * np.cos(np.pi * (middle - middles[i]) / window) ** 2
                omega[i] += (share * counts)[:, None] * regressor
                y[i] += share * counts * torque
                weight[i] += share
                moving[i] += share * counts
    # a window shorter than a step may have none of its middles
    holds = (weight[:, None] > 0) & (moving >= LEAST_MOTION * weight[:, None])
    share = np.divide(1, weight[:, None], out=np.zeros(holds.shape), where=holds)
    omega *= share[:, :, None]
    y *= share
    return Rows(middles, y, omega, holds)


def _middles(log: Log, window: float) -> np.ndarray:
    found = []
    for piece in log.segments:
        start, end = log.t[piece.start], log.t[piece.stop - 1]
        found.append(np.arange(start + 0.5 * window, end - 0.5 * window, window / OVERLAP))
    middles = np.concatenate(found)
    if not len(middles):
        longest = max(log.t[piece.stop - 1] - log.t[piece.start] for piece in log.segments)
        raise ArgumentError(
            f"window: expected at most the longest piece of the log without a gap, {longest:.3g} s, got "
            f"{window:g} s"
        )
    return middles


def extended(
    regressor: np.ndarray, columns: Mapping[str, Column], x: np.ndarray, v: np.ndarray, a: np.ndarray
) -> np.ndarray:
    """A regressor (nv, l) with these columns behind; x, v, a (nv,) in joint coordinates."""
    if not columns:
        return regressor
    return np.column_stack([regressor, *(_checked(name, f(x, v, a), len(v)) for name, f in columns.items())])


def _checked(name: str, column: np.ndarray, nv: int) -> np.ndarray:
    column = np.asarray(column, dtype=float)
    if column.shape != (nv,) or not np.isfinite(column).all():
        raise ArgumentError(f"columns: {name!r} should give {nv} finite numbers, one a joint, gave {column}")
    return column
