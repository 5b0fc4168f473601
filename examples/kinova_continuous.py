"""A Kinova Jaco whose goal lies on the other side of the half turn: its joints take the short way.

Joints 1, 4 and 6 turn without end, so that their angles jump from pi to -pi. A controller that
subtracts angles would unwind them by almost a full turn. Here the error is taken on the circle.
Prints what each of them turned, and writes plot, animation and record under out/. With --view it
also opens the live view in the browser.
"""

import argparse
from pathlib import Path

import numpy as np

import eladapt as ea

START = [2.6, 2.9, 1.0, -2.5, 1.4, 3.0]  # [rad]
GOAL = [-2.6, 2.5, 1.5, 2.5, 1.9, -2.9]


def turned(robot: ea.Robot, record: ea.Record) -> np.ndarray:
    """(N, nv) [rad] what each joint turned since the start, full turns included."""
    steps = [robot.difference(a, b) for a, b in zip(record.q[:-1], record.q[1:], strict=True)]
    return np.vstack([np.zeros(robot.nv), np.cumsum(steps, axis=0)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--view", action="store_true", help="open the live view, until interrupted")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()

    robot = ea.Robot.load("kinova")
    controller = ea.CompositeController.for_robot(robot)
    start, goal = robot.configuration(START), robot.configuration(GOAL)
    print(f"{robot.nv} joints, {robot.nq} numbers in q: a continuous joint is (cos, sin)")
    plant = ea.PinocchioPlant(robot, start)
    title = "kinova, across the half turn"
    record = ea.simulate(controller, plant, goal, duration=3.0, theta0="zero", title=title)

    known = ea.simulate(controller, plant, goal, 1.0, theta0="urdf", title="gravity known")

    short = robot.difference(start, goal)
    travel = turned(robot, record)
    way = np.sign(short)
    beyond, informed = (np.max(way * (turned(robot, run) - short), axis=0) for run in (record, known))
    print(f"\n{'joint':16} {'from':>6} {'to':>6} {'subtracted':>11} {'short way':>10}   turned   beyond")
    for j in np.flatnonzero(~np.isfinite(robot.upper)):
        print(
            f"{robot.joint_names[j]:16} {START[j]:6.2f} {GOAL[j]:6.2f} {GOAL[j] - START[j]:11.2f} "
            f"{short[j]:10.2f} {travel[-1, j]:8.2f} {max(beyond[j], 0):8.2f} ({max(informed[j], 0):.2f})"
        )
    print("all in rad; turned: from first to last; beyond: how far it went past the goal on the way, and in")
    print("brackets when gravity is known from the start. Joint 6 turns but "
          f"{robot.mass_matrix(start)[-1, -1]:.0e} kg m^2: little swings it.")  # fmt: skip

    m = record.metrics()
    print(f"\nall joints below 1e-3 rad after {m.settling_time:.2f} s, steady error {m.steady_error:.1e} rad")
    print(f"largest share of a torque limit used {np.max(np.abs(record.tau) / robot.effort_limit):.0%}")

    ea.plot(record, options.out / "kinova_continuous.png")
    ea.view(record, html=options.out / "kinova_continuous.html")
    record.save(options.out / "kinova_continuous.npz")
    print(f"wrote {options.out}/kinova_continuous.png, kinova_continuous.html and kinova_continuous.npz")
    if options.view:
        ea.view(record).wait()


if __name__ == "__main__":
    main()
