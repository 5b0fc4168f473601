"""One load, the same set-points: joint impedance, computed torque with the URDF, and eladapt.

Joint impedance is that of the maker's example, with its stiffness and damping: tau = K (q_d - q) - D v + C v,
beside the firmware's gravity. All three go through the same interface, on the same references within the same
limits, and the server enforces what a robot does; see `franka_client.py` for the environment.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import franka_client as client
import table
from model_based import DAMPING, STIFFNESS, ComputedTorque, JointImpedance
from set_points import AFTER

import eladapt as ea
from eladapt.hardware.franka import FrankaRobot

LOADS, SEED = (0.0, client.LOAD), 0


def weighed(robot: ea.Robot, empty: ea.Log | None, loaded: ea.Log | None) -> str:
    """What the load is by both logs, without and with it."""
    if empty is None or loaded is None:
        return "it is not weighed, since a minute left no log"
    before, after = (ea.identify(robot, log, held_out=0, physical=False) for log in (empty, loaded))
    return f"from the logs of ours it is weighed {after.load_since(before, 'panda_link8')}"


def main() -> None:
    python = os.environ.get("ELADAPT_FRANKA_SIM_PYTHON")
    if python is None:
        sys.exit("skipped: say ELADAPT_FRANKA_SIM_PYTHON, see franka_client.py --help")
    robot, gravity = ea.Robot.load("panda"), client.firmware_gravity(python)
    controllers: dict[str, Any] = {
        "joint impedance": JointImpedance(robot, gravity),
        "computed torque, URDF": ComputedTorque(robot),
        "eladapt": client.controller_of(robot, "nothing"),
    }
    rows, logs = [], []
    for load in LOADS:
        for name, controller in controllers.items():
            with client.server(python, load):
                arm = FrankaRobot(client.ADDRESS, robot, gravity=gravity, recover=True)
                done = client.minute(controller, arm, gravity, SEED)
            row = [f"{load:g}", name, done.ended[:100], f"{done.after:.1e}", f"{done.rest:.1e}"]
            print(row, flush=True)
            rows.append(row)
        logs.append(done.log)  # of the last one, ours
    head = [
        "load [kg]",
        "controller",
        "ended",
        f"error {AFTER:g} s after motions [rad]",
        "at rest [rad]",
    ]
    notes = (
        f"A minute of {client.GOALS} set-points up to {client.FAR:g} rad from the start in each joint, the "
        f"largest error of all joints. K = {STIFFNESS.tolist()} N m/rad, D = {DAMPING.tolist()} N m s/rad. "
        f"The load is told to nobody; {weighed(robot, *logs)}."
    )
    table.write("franka_controllers", "Three controllers on a Franka that is not there", head, rows, notes)


if __name__ == "__main__":
    main()
