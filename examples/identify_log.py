"""A real Panda's log, or your own arm's: what it tells, and how well that predicts.

Without arguments the log is that of Gaz and others (2019) in ../shared/logs beside the repository; where it
is not, nothing is done. With LOG and ROBOT it is yours: see `eladapt identify --help`, which does the same.
"""

import argparse
from pathlib import Path

import eladapt as ea

LOG = Path(__file__).resolve().parents[2] / "shared" / "logs" / "panda_exciting.npz"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("log", type=Path, nargs="?", default=LOG, help="a table, .npz, record or ROS 2 bag")
    parser.add_argument("--robot", default="panda", help="a name of the library, or a URDF (default: panda)")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()
    if options.log == LOG and not LOG.is_file():
        print("skipped: the log of a real Panda is not in ../shared/logs; give one of your own")
        return

    named = options.robot in ea.robots()
    robot = ea.Robot.load(options.robot) if named else ea.Robot.from_urdf(options.robot)
    log = ea.Log.read(options.log)
    print(log)
    for remark in log.check(robot):
        print(f"- {remark}")
    log.plot(options.out / "identify_log_motion.png")

    found = ea.identify(robot, log)
    print(f"\n{found}\n\n{found.friction}\n")
    for said in found.merged:
        print(f"- {said}")
    found.save_urdf(options.out / "identify_log.urdf")
    found.report(options.out / "identify_log.html")
    print(f"wrote {options.out}/identify_log.urdf, .html and identify_log_motion.png")


if __name__ == "__main__":
    main()
