"""From a log to parameters: the command of this room."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from eladapt.errors import ArgumentError, LogWarning, UnphysicalError, require_number
from eladapt.identification.fitting import Fit, directions, fit
from eladapt.identification.found import Identified
from eladapt.identification.learned import learned
from eladapt.identification.log import Log
from eladapt.identification.log_check import remarks
from eladapt.identification.prediction import doubts, errors_of, torques_of
from eladapt.identification.rows import Column, rows_of
from eladapt.regressors.joint_terms import JOINT_TERMS
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot

if TYPE_CHECKING:
    from eladapt.identification.physical import PhysicalBodies

WINDOW = 0.1  # [s] of one average
STICTION_SPEED = 0.01  # [rad/s]


def identify(
    robot: Robot,
    log: Log | Any,
    *,
    held_out: float = 0.3,
    columns: Mapping[str, Column] | None = None,
    joint_terms: Sequence[str] = JOINT_TERMS,
    physical: bool = True,
    window: float = WINDOW,
    stiction_speed: float = STICTION_SPEED,
    progress: bool = True,
) -> Identified:
    """The parameters of a robot from a log of its motion, or from a controller's state; no acceleration.

    log: a `Log`, whose last part (``held_out``, a share of its time) only judges; or the state of a
    `CompositeController` of this robot, behind a gate or not, for what it has learned so far.

    Its rows are the force balance over windows of ``window`` [s], without what a joint does below
    ``stiction_speed`` [rad/s], where it may stick; they are weighted by the noise that they turn out to have.
    Where the log does not tell, the URDF's values stay, and ``found.untold`` names what they are.
    joint_terms: see `Regressors`. columns: torques beside those, by name: functions of joint coordinates,
    velocities and accelerations (nv,) that give what a unit of the parameter makes in each joint (nv,); for
    example {"viscous(5 with 6)": lambda q, v, a: ...}. physical: also find the physical parameters nearest
    the URDF's that fit as well (extra ``identify``), which `Identified.robot` and `Identified.save_urdf`
    need; where there are none, as with torques of the other sign, the rest is there all the same.

    Warns (LogWarning) of what looks wrong in the log, and of parameters that do not explain it. Raises
    ArgumentError for a log at rest, without torque, or with fewer rows than parameters; UnknownNameError for
    joints that it does not have.
    """
    if not isinstance(robot, Robot):
        raise ArgumentError(f"robot: expected a Robot, got {type(robot).__name__}")
    regressors = Regressors(robot, joint_terms=joint_terms)
    if columns is not None and not isinstance(columns, Mapping):
        raise ArgumentError(f"columns: expected functions by name, got {type(columns).__name__}")
    own = dict(columns or {})
    if taken := [name for name in own if name in regressors.names]:
        raise ArgumentError(f"columns: {', '.join(taken)} is a parameter already; name it otherwise")
    labels = (*regressors.labels, *own)
    bodies = _bodies(regressors, len(own)) if physical else None  # says what is missing before the work
    if not isinstance(log, Log):
        if own:
            raise ArgumentError("columns: a controller's state knows nothing of them; leave them out")
        found = learned(regressors, log)
        return _identified(robot, regressors, found, labels, own, bodies)
    log = log.of(robot)
    if not np.any(log.tau):
        raise ArgumentError("log: its torques are all zero; say which columns are torques, or give gains=")
    told = remarks(log, robot)
    for remark in told:
        warnings.warn(f"log of {robot.name}: {remark}", LogWarning, stacklevel=2)
    if require_number("window", window, 0) <= 2 * log.dt:
        raise ArgumentError(
            f"window: expected more than two steps of the log, {2 * log.dt:.3g} s, got {window:g} s; is its "
            "t in seconds?"
        )
    speed = require_number("stiction_speed", stiction_speed, 0)
    first, last = log.parts(held_out)
    rows = rows_of(first, regressors, own, window=window, stiction_speed=speed, progress=progress)
    start = np.concatenate([regressors.theta, np.zeros(len(own))])
    found = fit(rows, start)
    whole = _identified(robot, regressors, found, labels, own, bodies)
    judged = first if last is None else last
    if last is not None:
        rows = rows_of(judged, regressors, own, window=window, stiction_speed=speed, progress=progress)
    torques = torques_of(judged, regressors, own)
    by = {"URDF": start, "identified": found.theta}
    if whole.physical is not None:
        by["physical"] = whole.physical
    errors = {name: errors_of(rows, torques, theta) for name, theta in by.items()}
    doubted = (*whole.notes, *doubts(errors))
    for doubt in doubted:
        warnings.warn(f"log of {robot.name}: {doubt}", LogWarning, stacklevel=2)
    return dataclasses.replace(
        whole, errors=errors, torques=torques, held_out=held_out, notes=(*log.notes, *told, *doubted)
    )


def _bodies(regressors: Regressors, own: int) -> PhysicalBodies:
    from eladapt.identification.physical import PhysicalBodies

    return PhysicalBodies(regressors, own)


def _identified(
    robot: Robot, regressors: Regressors, found: Fit, labels: tuple[str, ...], own: Mapping[str, Column],
    bodies: PhysicalBodies | None,
) -> Identified:  # fmt: skip
    parameters, theta = None, None
    notes: tuple[str, ...] = ()
    if bodies is not None:
        try:
            parameters, theta = bodies.nearest(found.theta, found.triangle)
        except UnphysicalError as reason:
            notes = (str(reason),)
    return Identified(
        robot, regressors, found, labels, directions(found.untold, (*regressors.names, *own)), physical=theta,
        parameters=parameters, columns=dict(own), notes=notes,
    )  # fmt: skip
