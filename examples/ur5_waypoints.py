"""A UR5 visits four waypoints: what it learns of gravity on the first move serves on all the others.

The goal is a function of time that jumps from waypoint to waypoint. Gravity is unknown at first.
Prints each move, and the last one once more from no knowledge, and writes plot, animation and
record under out/. With --view it also opens the live view in the browser.
"""

import argparse
from pathlib import Path

import numpy as np

import eladapt as ea

WAYPOINTS = [  # joint angles [rad]
    [0.8, -1.0, 1.1, -1.9, -1.0, 0.7],
    [-0.6, -1.9, 1.9, -0.8, -2.0, 1.6],
    [-1.4, -0.9, 0.6, -2.4, -0.6, -0.8],
    [0.4, -1.4, 1.4, -1.2, -1.4, 0.5],
]
DWELL = 2.0  # [s] at each waypoint, the move to it included
DT = 1e-3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--view", action="store_true", help="open the live view, until interrupted")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()

    robot = ea.Robot.load("ur5")
    controller = ea.CompositeController.for_robot(robot, DT)
    home = robot.configuration(robot.home)
    goals = [robot.configuration(angles) for angles in WAYPOINTS]

    def goal(t: float) -> np.ndarray:
        return goals[min(int((t + DT / 2) / DWELL), len(goals) - 1)]

    route = ea.PinocchioPlant(robot, home)
    title = "ur5, four waypoints"
    record = ea.simulate(controller, route, goal, DWELL * len(goals), DT, theta0="zero", title=title)
    steps = round(DWELL / DT)
    moves = {f"waypoint {k + 1}": (record, range(k * steps, (k + 1) * steps)) for k in range(len(goals))}
    alone = ea.PinocchioPlant(robot, goals[-2])
    afresh = ea.simulate(controller, alone, goals[-1], DWELL, DT, theta0="zero", title="from no knowledge")
    moves["waypoint 4, from no knowledge"] = (afresh, range(steps))

    print(f"\n{'':30} {'settled':>9} {'gravity off, at first':>22} {'at most':>12} {'known after':>12}")
    for name, (run, samples) in moves.items():
        far = np.abs(run.error[samples]).max(axis=1) >= 1e-3
        torques = [controller.regressors.gravity(run.q[k]) @ run.theta_error[k] for k in samples]
        off = np.abs(torques).max(axis=1)  # [N m], largest over the joints
        settled, known = (DT * (1 + max(np.flatnonzero(x), default=-1)) for x in (far, off > 0.1))
        print(f"{name:30} {settled:7.2f} s {off[0]:18.1e} N m {off.max():8.1e} N m {known:10.2f} s")
    print("settled: every joint below 1e-3 rad from then on; gravity off: error of the estimated gravity")
    print("torque; known: below 0.1 N m from then on. Gravity, once known, is known wherever the arm goes.")

    ea.plot(record, options.out / "ur5_waypoints.png")
    ea.view(record, html=options.out / "ur5_waypoints.html")
    record.save(options.out / "ur5_waypoints.npz")
    print(f"wrote {options.out}/ur5_waypoints.png, ur5_waypoints.html and ur5_waypoints.npz")
    if options.view:
        ea.view(record).wait()


if __name__ == "__main__":
    main()
