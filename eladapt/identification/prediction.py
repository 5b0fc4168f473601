"""How well parameters predict the torques of a log: filtered, and sample by sample."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from eladapt.identification.log import Log
from eladapt.identification.rows import Column, Rows, extended
from eladapt.regressors.regressors import Regressors

CUTOFF = 10.0  # [Hz] of the zero-phase filter, forwards and backwards, of the second order each
POOR = 0.25  # of the torques, that parameters leave: real arms' leave some 0.02 to 0.1
WORSE, LITTLE = 1.5, 0.05  # times another error and more, what a short log does by chance
MARGIN = 0.2  # [s] at both ends of a piece, which the filter does not see as they are
PER_SECOND = 50.0  # instants that are looked at


class Torques(NamedTuple):
    """Torques at n instants, and the regressor that predicts them: tau = regressor @ theta."""

    t: np.ndarray  # (n,) [s]
    tau: np.ndarray  # (n, nv) [N m or N]
    regressor: np.ndarray  # (n, nv, l)


def torques_of(
    log: Log, regressors: Regressors, columns: Mapping[str, Column], cutoff: float = CUTOFF
) -> Torques:
    """A log's torques below ``cutoff`` [Hz], without phase, and W with the accelerations that they go with.

    Velocities, their signs for Coulomb friction, and torques are put on an even grid and filtered forwards
    and backwards (Butterworth), and the velocities differenced. Where the log is too short or too slow for
    the filter, there are no instants.
    """
    times, torques, found = [], [], []
    dt, robot, coulomb = log.dt, regressors.robot, regressors.block("coulomb")
    if 2 * cutoff * dt < 1:
        filters = butter(2, 2 * cutoff * dt, output="sos")
        stride, margin = max(1, round(1 / (PER_SECOND * dt))), int(MARGIN / dt)
        for piece in log.segments:
            grid = np.arange(log.t[piece.start], log.t[piece.stop - 1], dt)
            if len(grid) <= 2 * margin + stride:
                continue
            even = [
                np.array([np.interp(grid, log.t[piece], column) for column in array[piece].T]).T
                for array in (log.q, log.velocity, log.tau)
            ]
            v, tau, turned = (sosfiltfilt(filters, array, axis=0) for array in (*even[1:], np.sign(even[1])))
            a = np.gradient(v, dt, axis=0)
            for k in range(margin, len(grid) - margin, stride):
                row = regressors.torque(robot.configuration(even[0][k]), v[k], a[k], check=False)
                if regressors.coulomb:
                    np.fill_diagonal(row[:, coulomb], turned[k] / regressors.scale[coulomb])
                found.append(extended(row, columns, even[0][k], v[k], a[k]))
                times.append(grid[k])
                torques.append(tau[k])
    size = len(regressors) + len(columns)
    shape = (len(times), robot.nv)
    return Torques(np.array(times), np.reshape(torques, shape), np.reshape(found, (*shape, size)))


class Errors(NamedTuple):
    """Relative errors of predicted torques, |predicted - measured| / |measured|: by joint, then of all."""

    filtered: np.ndarray  # (nv + 1,) of the averages over windows, without acceleration, where joints move
    raw: np.ndarray  # (nv + 1,) of the torques themselves below 10 Hz


def errors_of(rows: Rows, torques: Torques, theta: np.ndarray) -> Errors:
    """The errors of parameters (l,)."""
    return Errors(
        _relative(rows.omega @ theta - rows.y, rows.y),
        _relative(torques.regressor @ theta - torques.tau, torques.tau),
    )


def percent(error: float) -> str:
    """A relative error in percent; a dash where there was nothing to compare."""
    return f"{100 * error:.2f}" if np.isfinite(error) else "-"


def doubts(errors: Mapping[str, Errors]) -> Iterator[str]:
    """A sentence for each set of parameters that nobody should use, by their names in `Identified.errors`."""
    whole = {name: float(found.filtered[-1]) for name, found in errors.items()}
    urdf, identified = whole["URDF"], whole["identified"]
    if identified > POOR:
        yield (
            f"the parameters leave {identified:.0%} of the torques: is it this robot's log, with joints in "
            "its order, radians, and torques of the motors?"
        )
    elif identified > WORSE * urdf + LITTLE:
        yield (
            f"the parameters predict worse than the URDF's, {identified:.1%} instead of {urdf:.1%}: the log "
            "is too short, or tells too little"
        )
    physical = whole.get("physical", 0.0)
    if physical > WORSE * identified + LITTLE:
        yield (
            f"no bodies that can be fit the log: {physical:.0%} of the torques are left, {identified:.1%} "
            "without that condition; are the torques' unit and sign right, and the URDF's lengths?"
        )


def _relative(wrong: np.ndarray, right: np.ndarray) -> np.ndarray:
    """By column, then of all of them; nan where there is nothing to compare with."""
    parts = [np.linalg.norm(array, axis=0) for array in (wrong, right)]
    whole = [np.append(part, np.linalg.norm(part)) for part in parts]
    return np.divide(whole[0], whole[1], out=np.full(len(whole[0]), np.nan), where=whole[1] > 0)
