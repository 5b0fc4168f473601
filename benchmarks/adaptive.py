"""The same random worlds for every controller: who is good in how many, how exact, with how much torque.

A controller is one entry of CONTROLLERS: a function of robot, what is told of the world's hardware, and dt,
at the top of a module. All stand behind the same gate, follow the same motions and start from the URDF's
parameters. Add one in a file of its own, with ``--add module:function`` for a module that Python finds.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import tempfile
from pathlib import Path

import numpy as np
from table import write

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD, adaptive_pd, indirect
from eladapt.gains.sensing import Hardware
from eladapt.robot.protocols import BareController
from eladapt.worlds.trials import ControllerFor, careful

HEAD = [
    "arm", "controller", "good", "settled", "steady [rad], median", "95 %", "while moving [rad], median",
    "95 %", "torque / limit, median", "ripple [N m], median", "failures",
]  # fmt: skip


def composite(robot: ea.Robot, told: Hardware, dt: float) -> ea.CompositeController:
    """With every gain derived for what is told."""
    return ea.CompositeController.for_robot(robot, dt, **vars(told))


def gated(controller: BareController, dt: float) -> BareController:
    """As `careful` has it."""
    return ea.Shaped(ea.GatedController.for_robot(controller, dt))


def paper_form(robot: ea.Robot, told: Hardware, dt: float) -> BareController:
    """The paper's (278) with (318): what is beside them in `CompositeController` left out."""
    made = composite(robot, told, dt)
    bare = dataclasses.replace(made, detector=None, disturbance=None, joints=None, touch=None, rest_speed=0.0)
    return gated(bare, dt)


def slotine_li(robot: ea.Robot, told: Hardware, dt: float) -> BareController:
    """Slotine and Li's composite controller; its gains know of dt alone."""
    return gated(ea.SlotineLi.for_robot(robot, dt), dt)


def adaptive(robot: ea.Robot, told: Hardware, dt: float) -> BareController:
    """Tomei's adaptive PD, a = b = 1."""
    return gated(adaptive_pd(composite(robot, told, dt)), dt)


def indirect_scheme(robot: ea.Robot, told: Hardware, dt: float) -> BareController:
    """The composite controller whose estimate follows the regression alone."""
    return gated(indirect(composite(robot, told, dt)), dt)


def pd_gravity(robot: ea.Robot, told: Hardware, dt: float) -> BareController:
    """The same control law with the URDF's gravity, and nothing that learns."""
    return gated(KnownGravityPD(robot, composite(robot, told, dt).control), dt)


def urdf_dynamics(robot: ea.Robot, told: Hardware, dt: float) -> BareController:
    """The same control law with the URDF's whole dynamics at the reference, and nothing that learns."""
    made = composite(robot, told, dt)
    law = dataclasses.replace(made.law, direct=False, indirect=False)
    fixed = dataclasses.replace(made, law=law, detector=None, disturbance=None, joints=None, touch=None)
    return gated(fixed, dt)


CONTROLLERS: dict[str, ControllerFor] = {
    "composite": careful,
    "(278) with (318) alone": paper_form,
    "Slotine-Li composite": slotine_li,
    "adaptive PD": adaptive,
    "indirect": indirect_scheme,
    "the URDF's dynamics, fixed": urdf_dynamics,
    "PD with the URDF's gravity": pd_gravity,
}


def row_of(name: str, result: ea.Stress) -> list[object]:
    """One line of the table."""
    rows, robot = result.rows, result.trials.robot.name
    settled = np.count_nonzero(np.isfinite(rows["settling"]))

    def at(column: str, quantile: float) -> str:
        known = rows[column][~np.isnan(rows[column])]
        return f"{np.quantile(known, quantile, method='higher'):.2g}" if len(known) else "-"

    failures = ", ".join(f"{count} {cause}" for cause, count in result.causes.items())
    return [
        robot, name, f"{np.count_nonzero(result.good)}/{result.worlds}", f"{settled}/{result.worlds}",
        at("steady", 0.5), at("steady", 0.95), at("tracking", 0.5), at("tracking", 0.95), at("torque", 0.5),
        at("chatter", 0.5), failures or "none",
    ]  # fmt: skip


def added(given: str) -> tuple[str, ControllerFor]:
    """A controller of another's, by ``module:function``."""
    module, _, name = given.partition(":")
    made: ControllerFor = getattr(importlib.import_module(module), name)
    return name, made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--arms", nargs="+", default=["panda", "ur5"])
    parser.add_argument("--worlds", type=int, default=300, help="for each arm and controller (default: 300)")
    parser.add_argument("--only", nargs="+", choices=CONTROLLERS, default=list(CONTROLLERS), metavar="NAME")
    parser.add_argument("--add", action="append", default=[], metavar="MODULE:FUNCTION")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="of the rows (default: a temporary one)")
    parser.add_argument("--output", default="adaptive", help="in benchmarks/results, or a path without .md")
    options = parser.parse_args()
    controllers = {name: CONTROLLERS[name] for name in options.only} | dict(map(added, options.add))
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        for arm in options.arms:
            robot = ea.Robot.load(arm)
            for name, controller in controllers.items():
                out = folder / f"{arm}-{controller.__name__}"
                result = ea.stress(
                    robot, controller, options.worlds, jobs=options.jobs, out=out, theta0="urdf"
                )
                rows.append(row_of(name, result))
    notes = (
        "The same worlds, motions and gate for all, from the URDF's parameters. Good: as `ea.Criteria` has "
        "it; settled: below 1e-3 rad to the end. (278) with (318) alone: no disturbance estimate, no "
        "detection of loads, no contact; mixed as a vector as ours, since no determinant of 69 parameters is "
        "a number. The URDF's dynamics, fixed: W_r theta of the URDF under the same control law. Ripple: of "
        "the torque at rest."
    )
    write(options.output, "Adaptive controllers in the same worlds", HEAD, rows, notes)


if __name__ == "__main__":
    main()
