"""Your own arm: what its URDF says, the gains that follow from it, and a move from home to a goal.

Prints what the checks found, the base parameters, the limits and the gains, runs the move from no
knowledge of gravity, and writes plot, record and animation under out/. Angles are in rad, the
positions of sliding joints in m. What is wrong with a URDF is said on stderr, with exit code 1.

  python examples/own_urdf.py my_arm.urdf --package-dir my_ws/src --lock "finger_*"
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import eladapt as ea
from eladapt.errors import require_vector
from eladapt.gains.extremes import effort, extremes
from eladapt.robot.postures import require_within


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("urdf", type=Path, metavar="PATH", help="the URDF of a fixed-base arm")
    parser.add_argument("--package-dir", action="append", default=[], metavar="FOLDER",
                        help="where package://NAME/ is found; repeatable")  # fmt: skip
    parser.add_argument("--lock", action="append", default=[], metavar="JOINT",
                        help="a joint to hold still, * matches any characters; repeatable")  # fmt: skip
    parser.add_argument("--goal", type=float, nargs="+", metavar="X",
                        help="one number a joint (default: within 0.8 of home, always the same)")  # fmt: skip
    parser.add_argument("--duration", type=float, default=4.0, help="of the run [s] (default: 4)")
    parser.add_argument("--view", action="store_true", help="open the live view, until interrupted")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    try:
        run(parser.parse_args())
    except ea.EladaptError as reason:
        sys.exit(f"error: {reason}")


def run(options: argparse.Namespace) -> None:
    robot = ea.Robot.from_urdf(options.urdf, options.package_dir, options.lock)
    print(f"{robot.name}: no faults found; {robot.nv} joints, locked: {', '.join(robot.locked) or 'none'}")
    near = np.random.default_rng(0).uniform(-0.8, 0.8, robot.nv)
    goal = np.clip(robot.home + near, robot.lower, robot.upper) if options.goal is None else options.goal
    q_goal = robot.configuration(require_vector("--goal", goal, robot.nv))
    require_within(robot, q_goal, "--goal")

    controller = ea.CompositeController.for_robot(robot)
    regressors, assumed = controller.regressors, effort(robot, extremes(robot))
    print(f"{len(regressors)} base parameters, {regressors.n_potential} of gravity; the singular values drop "
          f"{regressors.rank_gap:.0e}-fold behind the last")  # fmt: skip
    print(f"\n{'joint':28} {'from':>8} {'to':>8} {'velocity':>9} {'effort':>8}   {'home':>7} {'goal':>7}")
    for k, name in enumerate(robot.joint_names):
        unset = "" if np.isfinite(robot.effort_limit[k]) else f" (gains assume {assumed[k]:.3g})"
        print(f"{name:28} {robot.lower[k]:8.3g} {robot.upper[k]:8.3g} {robot.velocity_limit[k]:9.3g} "
              f"{robot.effort_limit[k]:8.3g}   {robot.home[k]:7.2f} {goal[k]:7.2f}{unset}")  # fmt: skip
    print("inf: the URDF sets no limit")
    if robot.damping.any() or robot.friction.any():
        print("the URDF's joint damping and friction are left out of this simulation")
    print(f"\n{controller.gains}\n")

    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    record = ea.simulate(controller, plant, q_goal, options.duration, theta0="zero", title=robot.name)
    last = np.abs(controller.regressors.gravity(record.q[-1]) @ record.theta_error[-1]).max(initial=0)
    arrived = record.settling_time()
    print(f"all joints below 1e-3 after {arrived:.2f} s" if arrived < np.inf else "did not settle below 1e-3")
    print(f"error at the end {np.abs(record.error[-1]).max():.1e}, gravity torque off by {last:.1e} N m")
    print(f"largest share of a torque limit used, set or assumed {np.max(np.abs(record.tau) / assumed):.0%}")
    stem = options.out / f"own_{options.urdf.stem}"
    ea.plot(record, f"{stem}.png")
    record.save(f"{stem}.npz")
    ea.view(record, html=f"{stem}.html")
    print(f"wrote {stem}.png, {stem.name}.npz and {stem.name}.html")
    if options.view:
        ea.view(record).wait()


if __name__ == "__main__":
    main()
