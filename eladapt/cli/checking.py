"""``eladapt robots`` and ``eladapt check``: what there is, and what a URDF is good for."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from eladapt.cli.saying import Outcome, say, say_table, warn
from eladapt.errors import ArgumentError, EladaptError, UrdfError, require_number
from eladapt.gains.derived import derive_gains
from eladapt.gains.extremes import effort, extremes
from eladapt.regressors.regressors import Regressors
from eladapt.robot import library
from eladapt.robot.model import Robot
from eladapt.urdf.weighing import require_density


def robots(_options: argparse.Namespace) -> Outcome:
    """One line a robot."""
    described = {name: library.entry(name).description for name in library.robots()}
    for name, description in described.items():
        say(f"{name:16} {description}")
    return Outcome(described)


def find(options: argparse.Namespace) -> Robot:
    """The robot of a command: by name from the library, else the URDF at that path.

    Raises UnknownNameError for what looks like a name and is none, UrdfError for a file.
    """
    given = str(options.robot)
    is_path = Path(given).suffix or "/" in given or Path(given).exists()
    if not is_path or given in library.robots():
        if options.lock or options.package_dir or options.mend or options.density is not None:
            raise ArgumentError(
                f"--lock, --package-dir, --mend, --density: {given} is the library's; "
                "they go with the path of a URDF"
            )
        return Robot.load(given)
    density = None if options.density is None else require_density("--density", options.density)
    return Robot.from_urdf(given, options.package_dir, options.lock, mend=options.mend, density=density)


def check(options: argparse.Namespace) -> Outcome:
    """All that can be said before a motor is on. Raises EladaptError where the arm cannot be controlled."""
    dt = require_number("--dt", options.dt, 0)
    try:
        robot = find(options)
    except UrdfError as reason:
        if len(reason.findings) > 1:
            for finding in reason.findings:
                say(f"- {finding}")
            raise EladaptError(f"{reason.path}: {len(reason.findings)} faults, listed above") from reason
        raise
    locked = ", ".join(robot.locked) or "none"
    say(robot.path)
    say(f"{robot.name}: no faults found; {robot.nv} joints, locked: {locked}; tool {robot.tool}")
    if robot.weighed:
        masses = ", ".join(f"{name} {body.mass:.3g} kg" for name, body in robot.weighed.items())
        say(f"without <inertial>, weighed by their shapes at {robot.density:g} kg/m^3: {masses}")
    regressors = Regressors(robot)
    say(f"base parameters: {len(regressors)} of {10 * robot.nv} standard ones, "
          f"{regressors.n_potential} of gravity; "
          f"the singular values drop {regressors.rank_gap:.0e}-fold behind the last")  # fmt: skip
    assumed = effort(robot, extremes(robot))
    _limits(robot, assumed)
    _drawable(robot)
    try:
        gains = derive_gains(regressors, dt)
    except ArgumentError as reason:
        raise EladaptError(f"no gains at {1 / dt:g} Hz: {reason}") from reason
    say_table(f"\ngains exist at {1 / dt:g} Hz:\n{gains}")
    columns = {
        "name": robot.joint_names, "lower": robot.lower, "upper": robot.upper,
        "velocity": robot.velocity_limit, "effort": robot.effort_limit, "effort_assumed": assumed,
    }  # fmt: skip
    return Outcome({
        "robot": robot.name, "urdf": robot.path, "tool": robot.tool, "locked": robot.locked,
        "joints": [dict(zip(columns, joint, strict=True)) for joint in zip(*columns.values(), strict=True)],
        "base_parameters": regressors.names, "gravity_parameters": regressors.n_potential,
        "rank_gap": regressors.rank_gap, "dt": dt,
        "gains": {rule.gain: getattr(gains, rule.gain) for rule in gains.rules}, "rules": gains.rules,
    })  # fmt: skip


def _limits(robot: Robot, assumed: np.ndarray) -> None:
    wide = max(5, *map(len, robot.joint_names))
    say("")
    say(f"{'joint':{wide}} {'from':>8} {'to':>8} {'velocity':>9} {'effort':>8}")
    for k, name in enumerate(robot.joint_names):
        unset = "" if np.isfinite(robot.effort_limit[k]) else f"  (gains assume {assumed[k]:.3g})"
        say(f"{name:{wide}} {robot.lower[k]:8.3g} {robot.upper[k]:8.3g} {robot.velocity_limit[k]:9.3g} "
              f"{robot.effort_limit[k]:8.3g}{unset}")  # fmt: skip
    say("rad, rad/s, N m (m, m/s, N of sliding joints); inf: the URDF sets none")
    if robot.damping.any() or robot.friction.any():
        say(
            "the URDF has joint damping or friction: the controller starts from it, --plant mujoco applies it"
        )


def _drawable(robot: Robot) -> None:
    from eladapt.viewing.scene import visuals_of

    try:
        say(f"visual shapes: {len(visuals_of(robot))}")
    except EladaptError as reason:
        warn(f"it can be controlled but not drawn: {reason}")
