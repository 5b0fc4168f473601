"""The left arm of TALOS, at whose wrist the rotors outweigh the links: 0.1 kg m^2 a joint.

The same arm, with rotors, is regulated twice: by a controller whose model has no rotors, as in the
URDF, and by one whose model has them. Neither learns joint terms, as the default does, which would
find the rotors. Both arrive, for the law forgives a wrong model. Prints how well each model explains
the motion and what it learned of gravity from it, and writes plot, animation and record under out/.
With --view it also opens the live view in the browser.
"""

import argparse
from pathlib import Path

import numpy as np

import eladapt as ea


def regressions(record: ea.Record, regressors: ea.Regressors) -> tuple[np.ndarray, np.ndarray]:
    """y [N m] and Omega of y = Omega theta, along the whole run."""
    block = ea.ForceBalance(regressors)
    applied = np.vstack([np.zeros(record.tau.shape[1]), record.tau[:-1]])  # over the step before a sample
    samples = zip(record.t, record.q, record.v, applied, strict=True)
    measurements = [ea.Measurement(*sample) for sample in samples]
    state, rows = block.init(measurements[0]), []
    for measurement in measurements[1:]:
        state, regression = block.step(state, measurement, record.dt)
        rows.append(regression)
    return np.concatenate([r.y for r in rows]), np.vstack([r.omega for r in rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--view", action="store_true", help="open the live view, until interrupted")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()

    robot = ea.Robot.load("talos_left_arm")
    bare = ea.Robot.from_urdf(robot.path, robot.package_dirs, robot.locked, tool=robot.tool)  # no armature
    home, goal = robot.configuration(robot.home), robot.configuration(robot.target)
    inertia = [np.diag(arm.mass_matrix(home)) for arm in (bare, robot)]
    print(f"inertia at each joint, without rotors {np.round(inertia[0], 3)} kg m^2")
    print(f"                          with rotors {np.round(inertia[1], 3)} kg m^2")

    records, columns = [], []
    for name, arm in {"model without rotors": bare, "model with rotors": robot}.items():
        controller = ea.CompositeController.for_robot(arm, joint_terms=())
        record = ea.simulate(controller, ea.PinocchioPlant(robot, home), goal, duration=4.0, title=name)
        y, omega = regressions(record, controller.regressors)
        fitted = np.linalg.lstsq(omega, y)[0]
        off = [np.abs(controller.regressors.gravity(q) @ record.theta_error[-1]).max() for q in (goal, home)]
        assert record.excitation is not None
        known = record.excitation[:, 1]  # of the direction best known, 30 times a second
        restarts = np.sum(known[1:] < 0.5 * known[:-1])  # information starts afresh
        column = {
            "parameters": f"{len(controller.regressors)}",
            "unexplained, own": f"{np.abs(y - omega @ controller.regressors.theta).max():.1e} N m",
            "unexplained, best fit": f"{np.abs(y - omega @ fitted).max():.1e} N m",
            "taken for a new load": f"{restarts} times",
            "settled": f"{record.settling_time():.2f} s",
            "gravity off at the goal": f"{off[0]:.1e} N m",
            "gravity off at home": f"{off[1]:.1e} N m",
        }
        columns.append(column)
        records.append(record)
    print(f"\n{'':24} {'model without rotors':>22} {'model with rotors':>22}")
    for row in columns[0]:
        print(f"{row:24} {columns[0][row]:>22} {columns[1][row]:>22}")
    print("unexplained: largest |y - Omega theta| of the filtered torques, which reach "
          f"{np.abs(y).max():.0f} N m, with the")  # fmt: skip
    print("parameters of the model, and with those that fit this motion best; gravity off: error of the")
    print("torque that the estimates give in the end: at the goal, where the arm rests, and at home")

    ea.plot(records, options.out / "talos_armature.png")
    ea.view(records[1], html=options.out / "talos_armature.html")
    records[1].save(options.out / "talos_armature.npz")
    print(f"wrote {options.out}/talos_armature.png, talos_armature.html and talos_armature.npz")
    if options.view:
        ea.view(records[1]).wait()


if __name__ == "__main__":
    main()
