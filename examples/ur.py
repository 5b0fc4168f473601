"""A Universal Robots arm: learns gravity and friction by a slow move, then set-points, then an unknown load.

With the ADDRESS of a robot this moves a real arm, half a radian either way: read docs/hardware.md first, and
keep a hand on the stop. Without one it drives a stand-in: a UR5 with friction, whose firmware takes it for a
fifth heavier than it is, and on which 1.5 kg are hung that nobody tells of.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import eladapt as ea
from eladapt.hardware.ur import URRobot
from eladapt.hardware.ur_stand_in import URStandIn

DT, SWEEP, EACH, FAR = 2e-3, 8.0, 3.0, 0.3  # [s], [s], [s] for a set-point, [rad] from where the arm is
LOAD = ea.Payload(1.5, attach=30.0)  # of the stand-in: a second after the last set-points began


def stand_in(robot: ea.Robot) -> URStandIn:
    friction = ea.Friction(viscous=1.0, coulomb=np.array([3.0, 3.0, 2.0, 0.8, 0.8, 0.8]))
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), friction=friction, payload=LOAD)
    return URStandIn(plant, gravity=lambda q: 1.2 * robot.gravity(q), delay=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("address", nargs="?", metavar="ADDRESS", help="of the robot")
    parser.add_argument("--robot", default="ur5", help="of the library, or a URDF (default: ur5)")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()
    path = Path(options.robot)
    robot = ea.Robot.from_urdf(path) if path.suffix else ea.Robot.load(options.robot)
    library = None if options.address else stand_in(robot)
    arm = URRobot(options.address or "stand-in", robot, library=library)

    told = ea.commission(robot, arm, dt=DT)
    print(f"{told}\n")
    inner = ea.CompositeController.for_robot(robot, DT, **told.hardware)
    controller = ea.GatedController.for_robot(inner, DT)
    start = arm.posture()
    slow = ea.MotionLimits.for_robot(robot, velocity=0.15)
    sweep = ea.excitation(robot, SWEEP, slow, q0=robot.configuration(start), rounds=0, progress=False)
    sides = np.array([[1, 1, -1, 1, 1, -1], [-1, 0, 1, 1, -1, 1], [0, 0, 0, 0, 0, 0]])
    goals = [robot.configuration(start + FAR * side) for side in sides]

    def visited(t: float) -> np.ndarray:
        return goals[min(int(max(t, 0.0) / EACH), 2)]

    state: Any = None
    for title, goal, duration in (
        ("slow move", sweep, SWEEP),
        ("set-points", visited, 3 * EACH),
        ("set-points with a load", visited, 3 * EACH),
    ):
        if options.address and state and title.endswith("load"):
            input("hang a load on the tool that nobody told the robot, and press Enter: ")
        result = ea.run_loop(controller, arm, goal, duration, DT, state=state, title=title)
        state = result.state
        print(f"{title}: {result}; {np.abs(result.record.error[-1]).max():.1e} rad left")
        if result.fault:
            break
    else:
        print(f"the load: {ea.payload(inner, state.inner)}")
    learned = [inner.regressors.gravity(q) @ state.theta - robot.gravity(q) for q in goals]
    off = np.abs(learned).max()
    print(f"learned beside the URDF's gravity, for the load and the firmware: up to {off:.2g} N m")
    print(ea.friction(inner, state.inner))
    ea.plot(result.record, options.out / "ur.png")
    result.record.save(options.out / "ur.npz")
    ea.report(result.record, options.out / "ur.html", animation=False)
    print(f"wrote {options.out}/ur.png, ur.npz and ur.html")


if __name__ == "__main__":
    main()
