"""What torque a current makes, from two logs of currents: with and without a load whose mass is known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from eladapt.errors import ArgumentError, require_number
from eladapt.estimation.payload import payload_regressor
from eladapt.identification.fitting import fit
from eladapt.identification.identify import STICTION_SPEED, WINDOW
from eladapt.identification.log import Log
from eladapt.identification.rows import Rows, rows_of
from eladapt.regressors.joint_terms import JOINT_TERMS
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot


class CurrentGains(NamedTuple):
    """Torque by current, by joint, with standard deviations; inf where the logs do not tell."""

    gains: np.ndarray  # (nv,) [N m/A]
    std: np.ndarray  # (nv,)


def current_gains(
    robot: Robot,
    empty: Log,
    loaded: Log,
    mass: float,
    frame: str | None = None,
    *,
    window: float = WINDOW,
    stiction_speed: float = STICTION_SPEED,
    progress: bool = True,
) -> CurrentGains:
    """The torque that a current makes in each joint [N m/A], where the torques of both logs are currents.

    One log cannot tell: gains and all parameters grow together. A load of known ``mass`` [kg] gives the
    unit: k_i current_i = Omega_i theta + (Omega A)_i x, x = (m, m c, I) of the load, of which m is known, in
    ``frame`` (the tool if None), is linear in the gains k, theta and the rest of x, and both logs' rows are
    one least-squares problem. Friction counts as the same with and without the load. A joint whose torque the
    load does not change, and that moves too little mass otherwise, has a large standard deviation. Noise of
    the currents makes gains too small, by its share of their variance over a window. Raises ArgumentError for
    a mass that is not positive and what is no log, and what `identify` raises.
    """
    mass = require_number("mass", mass, 0)
    for name, log in (("empty", empty), ("loaded", loaded)):
        if not isinstance(log, Log):
            raise ArgumentError(f"{name}: expected a Log, got {type(log).__name__}")
    regressors = Regressors(robot, joint_terms=JOINT_TERMS)
    parts = [
        rows_of(
            log.of(robot), regressors, window=window, stiction_speed=stiction_speed, progress=progress
        )
        for log in (empty, loaded)
    ]  # fmt: skip
    effect = payload_regressor(regressors, robot.tool if frame is None else frame)  # (l, 10)
    size, nv = len(regressors), robot.nv
    rows = []
    for part, carries in zip(parts, (0.0, 1.0), strict=True):
        load = carries * part.omega @ effect
        currents = -part.y[:, :, None] * np.eye(nv)
        omega = np.concatenate([part.omega, load[:, :, 1:], currents], axis=2)
        rows.append(Rows(part.t, -mass * load[:, :, 0], omega, part.holds))
    t, y, omega, holds = (np.concatenate(part) for part in zip(*rows, strict=True))
    if not np.any(y):
        raise ArgumentError("frame: no joint moves the load; say in which frame it hangs")
    start = np.concatenate([regressors.theta, np.zeros(9), np.ones(nv)])
    found = fit(Rows(t, y, omega, holds), start)
    return CurrentGains(found.theta[size + 9 :], found.std[size + 9 :])
