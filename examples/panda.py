"""A Panda, regulated from no knowledge of gravity: the class that regulates the 2-link arm.

Every gain comes from the URDF. Prints how the run went and writes plot, animation and record
under out/. With --view it also opens the live view in the browser.
"""

import argparse
from pathlib import Path

import numpy as np

import eladapt as ea


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--view", action="store_true", help="open the live view, until interrupted")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()

    robot = ea.Robot.load("panda")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    record = ea.simulate(controller, plant, goal, duration=4.0, theta0="zero")

    m = record.metrics()
    torque_error = [
        np.abs(controller.regressors.gravity(q) @ error).max()
        for q, error in zip(record.q, record.theta_error, strict=True)
    ]
    print(f"all joints below 1e-3 rad after {m.settling_time:.2f} s, steady error {m.steady_error:.1e} rad")
    print(f"gravity torque off by {torque_error[0]:.1f} N m at first, {torque_error[-1]:.1e} N m at the end")
    print(f"torque ripple at rest {m.chatter:.1e} N m; largest share of a torque limit used "
          f"{np.max(np.abs(record.tau) / record.effort_limit):.0%}")  # fmt: skip

    ea.plot(record, options.out / "panda.png")
    ea.view(record, html=options.out / "panda.html")
    record.save(options.out / "panda.npz")
    print(f"wrote {options.out}/panda.png, panda.html and panda.npz")
    if options.view:
        ea.view(record).wait()


if __name__ == "__main__":
    main()
