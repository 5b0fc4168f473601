"""How late and how unevenly a robot tells and does, from what it told of a motion and what it was sent."""

from __future__ import annotations

import numpy as np
from scipy.signal import savgol_filter

from eladapt.identification.log import Log

LONGEST_DELAY = 0.02  # [s]
ALIKE = 0.05  # of what is sent, by which the reported torque may differ from it
SMOOTH = 0.03  # [s] of the window that tells velocities and accelerations from positions
MOVING = 0.3  # of the largest speed: slower samples do not tell how long they took
LEAST_SAMPLES = 50


def reporting_delay(sent: np.ndarray, reported: np.ndarray, dt: float) -> float:
    """[s] by which the reported torque comes behind the command that it answers, beyond the step that holds
    it; nan where they are not alike."""
    changing = sent - np.nanmean(sent, axis=0)
    best, least = float("nan"), ALIKE
    for late in range(1, round(LONGEST_DELAY / dt) + 2):
        pair = np.isfinite(sent[:-late]).all(axis=1)
        wrong = float(np.linalg.norm((reported[late:] - sent[:-late])[pair]))
        share = wrong / max(float(np.linalg.norm(changing[:-late][pair])), 1e-12)
        if share < least:
            best, least = (late - 1) * dt, share
    return best


def velocity_lag(log: Log) -> float:
    """[s] by which the measured velocities come behind the derivative of the positions: of both, smoothed
    alike, v - dq/dt = - lag dv/dt."""
    window = 2 * int(0.5 * SMOOTH / log.dt) + 1
    if window < 5 or len(log) < 4 * window:
        return float("nan")
    across = np.zeros(2)
    for piece in log.segments:
        if piece.stop - piece.start < 2 * window:
            continue
        smooth = {"window_length": window, "polyorder": 3, "delta": log.dt, "axis": 0}
        rate = savgol_filter(log.q[piece], deriv=1, **smooth)
        v = savgol_filter(log.velocity[piece], **smooth)
        change = savgol_filter(log.velocity[piece], deriv=1, **smooth)
        inner = slice(window, -window)
        across += [np.sum(-(v - rate)[inner] * change[inner]), np.sum(change[inner] ** 2)]
    return max(0.0, float(across[0] / across[1])) if across[1] > 0 else float("nan")


def stamp_jitter(log: Log, position_noise: np.ndarray) -> float:
    """[s] standard deviation of what time stamps are off by, from one sample to the next.

    A sample took x = v.dq / v.v of the arm's own time, with v the mean of the velocities at both ends. What
    the spread of x beside the stamps is more than noise of the positions (nv,) makes is jitter. nan where too
    little moves.
    """
    longer: list[np.ndarray] = [np.zeros(0)]
    made: list[np.ndarray] = [np.zeros(0)]
    for piece in log.segments:
        way = np.diff(log.q[piece], axis=0)
        v = 0.5 * (log.velocity[piece][1:] + log.velocity[piece][:-1])
        square = np.sum(v**2, axis=1)
        fast = square > MOVING**2 * float(np.max(square, initial=0.0))
        took: np.ndarray = np.sum(way * v, axis=1)[fast] / square[fast]
        longer.append(took - np.diff(log.t[piece])[fast])
        made.append(2 * np.sum((v * position_noise) ** 2, axis=1)[fast] / square[fast] ** 2)
    if len(beside := np.concatenate(longer)) < LEAST_SAMPLES:
        return float("nan")
    return float(np.sqrt(max(0.0, np.var(beside) - np.mean(np.concatenate(made)))))
