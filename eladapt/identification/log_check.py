"""What in a log looks wrong, or will not tell much."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from eladapt.identification.log import Log
from eladapt.robot.model import Robot
from eladapt.robot.postures import turning

STILL = 0.01  # [rad/s or m/s] a joint that is never faster stands still
ONE_WAY = 0.01  # of the time, in which a joint that moves one way moves the other
BEYOND = 0.02  # of a joint's range
TURN = 2 * np.pi
FASTER = 1.1  # times a speed limit
CONSTANT, TIMES = 0.01, 10  # of the samples, and how many at least, at one extreme: it is cut off there
SLOW = 0.05  # [s]
DEGREES = (180 / np.pi, "degrees")
THOUSANDTHS = (1000.0, "thousandths, as of mm, mN m or ms")
NEAR_UNIT = 1.25  # by which factor a ratio may differ from a unit's
NEAR_ONE = 1.5  # by which factor a ratio may differ from 1
ALIKE = 0.7  # correlation of torques and the URDF's gravity, from which on their ratio means something
FEW = 200  # samples that are compared with gravity


def remarks(log: Log, robot: Robot) -> tuple[str, ...]:
    """A sentence for each thing, of a log whose joints are the robot's in its order."""
    found = [*_units(log, robot), *_torques(log, robot), *_motion(log, robot)]
    if log.dt > SLOW:
        found.append(f"samples are {log.dt:.3g} s apart: what happens in between is not seen")
    return tuple(found)


def _motion(log: Log, robot: Robot) -> Iterator[str]:
    v, x, turns = log.velocity, log.q, turning(robot)
    wide = robot.upper - robot.lower
    for k, name in enumerate(robot.joint_names):
        speed, unit = float(np.abs(v[:, k]).max()), "rad/s" if turns[k] else "m/s"
        if speed <= STILL:
            yield (
                f"{name} stands still (at most {speed:.2g} {unit}): its friction, and what only its motion "
                "shows, are not told"
            )
        else:
            ways = np.sort([np.mean(v[:, k] > STILL), np.mean(v[:, k] < -STILL)])
            if ways[0] < ONE_WAY:
                yield (
                    f"{name} moves one way only: its Coulomb friction and its offset are told only together; "
                    "move it both ways"
                )
        low, high = float(x[:, k].min()), float(x[:, k].max())
        if (low < robot.lower[k] - BEYOND * wide[k]) or (high > robot.upper[k] + BEYOND * wide[k]):
            far = turns[k] and max(-low, high) > TURN
            asked = "; are these degrees (degrees=True)?" if far else ""
            yield (
                f"{name} goes from {low:.4g} to {high:.4g}, beyond its limits, {robot.lower[k]:.4g} to "
                f"{robot.upper[k]:.4g}{asked}"
            )
        if speed > FASTER * robot.velocity_limit[k]:
            yield f"{name} reaches {speed:.3g} {unit}; its limit is {robot.velocity_limit[k]:.3g}"


def _units(log: Log, robot: Robot) -> Iterator[str]:
    """Velocities against the derivative of the positions."""
    pieces = [piece for piece in log.segments if piece.stop - piece.start > 2]
    if not pieces:
        return
    rate = np.concatenate([np.gradient(log.q[p], log.t[p], axis=0) for p in pieces])
    v, turns = np.concatenate([log.velocity[p] for p in pieces]), turning(robot)
    for k, name in enumerate(robot.joint_names):
        if np.abs(v[:, k]).max() <= STILL and np.abs(rate[:, k]).max() <= STILL:
            continue
        along = float(v[:, k] @ rate[:, k])  # noise of the derivative averages out
        ratio = float(v[:, k] @ v[:, k]) / along if along else np.inf
        if not 1 / NEAR_ONE < ratio < NEAR_ONE:
            said = f"{name}: the velocities are {ratio:.3g} times the derivative of the positions"
            yield said + _unit_hint(ratio, angle=bool(turns[k]))


def _torques(log: Log, robot: Robot) -> Iterator[str]:
    """Torques that are missing, cut off, or of another unit than the URDF's gravity."""
    for k, name in enumerate(robot.joint_names):
        tau, unit = log.tau[:, k], "N m" if turning(robot)[k] else "N"
        if not tau.any():
            yield f"{name}: its torque is always zero; its parameters will be told as zero"
            continue
        for extreme in (tau.max(), tau.min()):
            share = float(np.mean(tau == extreme))
            if share > CONSTANT and share * len(log) >= TIMES and np.ptp(tau) > 0:
                yield f"{name}: its torque is cut off at {extreme:.4g} {unit} in {share:.0%} of the samples"
        if np.abs(tau).max() > FASTER * robot.effort_limit[k]:
            yield (
                f"{name}: its torque reaches {np.abs(tau).max():.4g} {unit}, beyond its limit, "
                f"{robot.effort_limit[k]:.4g}; currents or another unit (gains=)?"
            )
    which = np.linspace(0, len(log) - 1, min(len(log), FEW)).astype(int)
    gravity = np.array([robot.gravity(robot.configuration(log.q[k])) for k in which])
    tau, size = log.tau[which], float(np.linalg.norm(gravity))
    alike = float(np.sum(tau * gravity)) / max(size * float(np.linalg.norm(tau)), 1e-300)
    if size == 0 or abs(alike) < ALIKE:
        return
    ratio = float(np.linalg.norm(tau)) / size
    if alike < 0:
        yield "the torques are those of the URDF's gravity with the other sign: is it that of the reaction?"
    elif _unit_hint(ratio):
        yield f"the torques are {ratio:.3g} times the URDF's gravity{_unit_hint(ratio)} (gains=)"


def _unit_hint(ratio: float, angle: bool = False) -> str:
    for unit, name in (DEGREES, THOUSANDTHS) if angle else (THOUSANDTHS,):
        for factor, said in ((unit, name), (1 / unit, f"the inverse of {name}")):
            if 1 / NEAR_UNIT < ratio / factor < NEAR_UNIT:
                return f"; {said}?"
    return ""
