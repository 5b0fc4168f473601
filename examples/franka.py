"""A Franka Panda or FR3: commissioned, moved to set-points, and what it learned.

With the ADDRESS of a robot this moves a real arm: read docs/hardware.md first, and keep a hand on the stop.
Without one it talks to franka-sim on this machine, if ELADAPT_FRANKA_SIM_PYTHON says which Python has it (see
benchmarks/franka_client.py); where there is none, nothing is done.
"""

import argparse
import contextlib
import os
import sys
from pathlib import Path

import numpy as np

import eladapt as ea

DT, EACH, FAR = 1e-3, 6.0, 0.25  # [s], [s] for a set-point, [rad] from where the arm is


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("address", nargs="?", metavar="ADDRESS", help="of the robot's control")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()
    python = os.environ.get("ELADAPT_FRANKA_SIM_PYTHON")
    if options.address is None and python is None:
        print("skipped: give the address of a robot, or say ELADAPT_FRANKA_SIM_PYTHON; see --help")
        return
    from eladapt.hardware.franka import FrankaRobot

    robot = ea.Robot.load("panda")
    gravity = None
    with contextlib.ExitStack() as running:
        if options.address is None:
            sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
            from franka_client import firmware_gravity, server

            running.enter_context(server(str(python), 0.0))
            gravity = firmware_gravity(str(python))
        arm = FrankaRobot(
            options.address or "127.0.0.1", robot, gravity=gravity, recover=options.address is None
        )

        told = ea.commission(robot, arm, dt=DT)
        print(f"{told}\n")

        controller = ea.GatedController.for_robot(
            ea.CompositeController.for_robot(robot, DT, **told.hardware), DT
        )
        start = arm.posture()
        sides = np.sign(np.cos(np.outer(np.arange(4), np.arange(1, 8))))
        goals = [robot.configuration(start + FAR * side) for side in sides]
        result = ea.run_loop(
            controller,
            arm,
            lambda t: goals[min(int(max(t, 0) / EACH), 3)],
            4 * EACH,
            DT,
            title="Franka, four set-points",
        )
    print(result.timing)
    print(
        f"fault: {result.fault}"
        if result.fault
        else f"left at the last set-point: {np.abs(result.record.error[-1]).max():.1e} rad"
    )
    print(ea.friction(controller.controller, result.state.inner))
    result.record.save(options.out / "franka.npz")
    ea.report(result.record, options.out / "franka.html", animation=False)
    print(f"wrote {options.out}/franka.npz and .html")


if __name__ == "__main__":
    main()
