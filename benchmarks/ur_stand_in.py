"""A UR5e that is not there, at 500 Hz through ur-rtde's classes: set-points with a firmware that is wrong.

`URRobot` drives `URStandIn`, whose arm is MuJoCo Menagerie's UR5e, another model than the controller's URDF;
with the servo's damping that it has there (200 N m s/rad in the shoulder), or with friction instead. Its
protective stops are on. The clock is the stand-in's.

It needs a folder ../shared beside the repository's root, with plants/ur5e_menagerie.xml and arms/ur5e.urdf.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np
from set_points import AFTER, REST, Course, drive, weighed
from table import gathered, write

import eladapt as ea
from eladapt.hardware.ur import URRobot
from eladapt.hardware.ur_stand_in import PERIOD, URStandIn

SHARED = Path(__file__).resolve().parents[2] / "shared"
MODEL, URDF = SHARED / "plants" / "ur5e_menagerie.xml", SHARED / "arms" / "ur5e.urdf"
START = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])
NUMBER, EACH, FAR = 4, 5.0, 0.4  # set-points, [s], [rad] from the start
SERVO, RUBBING = "servo's damping", "friction"
SLOW = {SERVO: 0.1, RUBBING: 0.5}  # of the speed limits
FRICTION = ea.Friction(viscous=1.0, coulomb=np.array([4.0, 4.0, 3.0, 1.0, 1.0, 1.0]))
FIRMWARE = {"the arm's": 1.0, "a fifth too much": 1.2, "a fifth too little": 0.8, "none": 0.0}
ROTOR = 0.05  # [kg m^2] told of each joint; they are twice that
PATIENT = {SERVO: 4.0, RUBBING: 1.0}  # times as much torque as usual before a joint counts as unresponsive
LOAD = ea.Payload(1.5, attach=NUMBER // 2 * EACH)
CASES = (
    *itertools.product((RUBBING, SERVO), FIRMWARE, (0.0,), range(4)),
    *itertools.product((RUBBING, SERVO), ("a fifth too much",), (ROTOR,), range(2)),
)


def robot_told(rotor: float) -> ea.Robot:
    """The URDF's, with these rotors."""
    robot = ea.Robot.from_urdf(URDF)
    told = dict.fromkeys(robot.joint_names, rotor)
    return ea.Robot.from_urdf(URDF, armature=told) if rotor else robot


def controller_of(robot: ea.Robot, patient: float) -> ea.GatedController:
    """Behind a gate that bears the friction that there is."""
    inner = ea.CompositeController.for_robot(robot, PERIOD, delay=PERIOD)
    gated = ea.GatedController.for_robot(inner, PERIOD)
    belief = dataclasses.replace(gated.gate.belief, silent=patient * gated.gate.belief.silent)
    return dataclasses.replace(gated, gate=dataclasses.replace(gated.gate, belief=belief))


def run(rubbing: str, firmware: str, rotor: float, seed: int) -> dict[str, Any]:
    """A row."""
    robot, damped = robot_told(rotor), rubbing == SERVO
    plant = ea.MujocoPlant(
        robot, robot.configuration(START), friction=None if damped else FRICTION, joint_friction=damped,
        payload=LOAD, mjcf=MODEL,
    )  # fmt: skip
    still, share = np.zeros(robot.nv), FIRMWARE[firmware]
    arm = URStandIn(plant, gravity=lambda q: share * plant.bias(q, still, t=-1.0))
    controller = controller_of(robot, PATIENT[rubbing])
    limits = ea.MotionLimits.for_robot(robot, velocity=SLOW[rubbing])
    course = Course.around(robot, START, FAR, NUMBER, EACH, limits, seed)
    interface = URRobot("stand-in", robot, library=arm)
    driven = drive(controller, interface, course, PERIOD)
    return {
        "case": [rubbing, firmware, rotor, seed], "ended": (arm.tripped or driven.ended)[:100],
        **driven.errors._asdict(), "weighed": weighed(controller.controller, driven),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--cases", type=int, nargs="*", default=list(range(len(CASES))), help="(default: all)"
    )
    parser.add_argument(
        "--kept", type=Path, default=Path("out/ur_stand_in.jsonl"), help="runs so far, and these"
    )
    options = parser.parse_args()
    if missing := [str(path) for path in (MODEL, URDF) if not path.is_file()]:
        parser.error(f"needs {', '.join(missing)}")
    for case in options.cases:
        row = run(*CASES[case])
        print(row, flush=True)
        gathered(options.kept, ("case",), row)
    rows = gathered(options.kept, ("case",))
    order = [list(case) for case in CASES]
    table = [
        [*row["case"], row["ended"], f"{row['after']:.1e}", f"{row['rest']:.1e}", row["weighed"]]
        for row in sorted(rows, key=lambda row: order.index(row["case"]))
    ]
    head = [
        "what rubs", "gravity that the firmware adds", "rotors told [kg m^2]", "run", "ended",
        f"error {AFTER:g} s after motions [rad]", f"in the last {REST:g} s [rad]", "load weighed [kg]",
    ]  # fmt: skip
    notes = (
        f"{NUMBER} set-points up to {FAR:g} rad from the start in each joint, {EACH:g} s each, by the "
        "stand-in's clock; a torque acts a period late. The interface takes the URDF's gravity for the "
        "firmware's, so that the difference is learned. The error is that from the set-point, the largest of "
        f"all joints and set-points (asked: 1e-3 rad). A load of {LOAD.mass:g} kg that nobody told comes "
        f"after {LOAD.attach:g} s. Friction: {FRICTION.viscous:g} N m s/rad and Coulomb friction of "
        f"{', '.join(f'{c:g}' for c in np.atleast_1d(FRICTION.coulomb))} N m. The rotors are 0.1 kg m^2. "
        "The URDF has none, and 1.3e-4 kg m^2 in the last wrist. With the servo's damping the gate bears "
        f"{PATIENT[SERVO]:g} times the usual friction, or it would take it for a dead joint."
    )
    write("ur_stand_in", "A UR5e that is not there, at 500 Hz", head, table, notes)


if __name__ == "__main__":
    main()
