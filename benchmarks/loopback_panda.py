"""Another's Panda behind a firmware whose gravity is a fifth wrong: minutes of set-points, and a load.

The arm is MuJoCo Menagerie's (rotors, damping), with dry friction beside; it stands behind a `RobotInterface`
at 1 kHz that adds gravity by itself, and follows a torque a cycle late and by less than 1 N m a cycle, as
`FrankaRobot` sends it. The controller knows another's URDF. In the midst of each minute a load that nobody
told is hung on the flange, and weighed at its end. The clock is the simulation's, so no cycle is lost.

It needs a folder ../shared beside the repository's root, with plants/panda_menagerie.xml.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from set_points import AFTER, REST, Course, drive, weighed
from table import gathered, write

import eladapt as ea

MODEL = Path(__file__).resolve().parents[2] / "shared" / "plants" / "panda_menagerie.xml"
DT = 1e-3
NUMBER, EACH, FAR = 8, 7.5, 0.4  # set-points of a minute, [s], [rad] from home
COULOMB = np.array([1.0, 1.0, 0.5, 0.5, 0.3, 0.3, 0.2])  # [N m] beside the model's own damping
WRONG = 1.2  # of the true gravity, is what the firmware adds
LOAD = ea.Payload(1.5, frame="panda_link8", attach=NUMBER // 2 * EACH)
KEPT = 0.99  # [N m] of change a cycle, in what is sent


class Loopback:
    """The arm as a `RobotInterface`: what is sent is tau less the gravity that the firmware adds.

    told: whether the interface knows what that is; if not, it takes the URDF's gravity for it.
    """

    keeps_clock = True

    def __init__(self, plant: ea.MujocoPlant, told: bool):
        self.plant = plant
        self.believed: Callable[[np.ndarray], np.ndarray] = self.firmware if told else plant.robot.gravity
        self.model = mujoco.MjModel.from_xml_path(str(MODEL))
        self.data = mujoco.MjData(self.model)
        self.most = 0.0  # [N m] by which what is sent changed in a cycle

    def firmware(self, q: np.ndarray) -> np.ndarray:
        """(7,) [N m] what is added: it does not know the load."""
        self.data.qpos[:], self.data.qvel[:] = q, 0.0
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_fwdVelocity(self.model, self.data)
        return WRONG * np.array(self.data.qfrc_bias)

    def start(self) -> None:
        """The brakes open."""
        self.measurement, self.fresh = self.plant.reset(), True
        self.sent = self.wanted = np.zeros(self.plant.robot.nv)

    def read(self) -> ea.Measurement:
        """The sample of the next cycle."""
        if not self.fresh:
            acts = self.sent
            self._follow()
            m = self.plant.step(acts + self.firmware(self.plant.q), DT)
            self.measurement = m._replace(tau=acts + self.believed(m.q))
        self.fresh = False
        return self.measurement

    def write(self, tau: np.ndarray) -> None:
        """Send a torque for the cycle after the next one."""
        self.wanted = tau - self.believed(self.measurement.q)

    def stop(self) -> None:
        """The brakes close."""
        self.plant.brake()
        while np.abs(self.plant.v).max() > 1e-9:
            self.plant.step(self.plant.tau, DT)

    def _follow(self) -> None:
        """Take what was sent last, as near as it may come."""
        change = np.clip(self.wanted - self.sent, -KEPT, KEPT)
        self.most = max(self.most, float(np.abs(change).max()))
        self.sent = self.sent + change


def minute(seed: int, told: bool) -> dict[str, Any]:
    """A run, as a row."""
    robot = ea.Robot.load("panda")
    start, friction = robot.configuration(robot.home), ea.Friction(coulomb=COULOMB)
    arm = Loopback(ea.MujocoPlant(robot, start, friction=friction, payload=LOAD, mjcf=MODEL), told)
    limits = ea.MotionLimits.for_robot(robot)
    course = Course.around(robot, robot.home, FAR, NUMBER, EACH, limits, seed)
    inner = ea.CompositeController.for_robot(robot, DT, delay=DT)
    controller = ea.GatedController.for_robot(inner, DT)
    driven = drive(controller, arm, course, DT)
    return {
        "told": told, "seed": seed, "ended": driven.ended, **driven.errors._asdict(), "most": arm.most,
        "weighed": weighed(inner, driven, LOAD.frame),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(10)), help="one a minute")
    parser.add_argument("--untold", action="store_true", help="the interface takes the URDF's gravity for it")
    parser.add_argument(
        "--kept", type=Path, default=Path("out/loopback_panda.jsonl"), help="minutes so far, and these"
    )
    options = parser.parse_args()
    if not MODEL.is_file():
        parser.error(f"needs {MODEL}")
    for seed in options.seeds:
        row = minute(seed, not options.untold)
        print(row, flush=True)
        gathered(options.kept, ("told", "seed"), row)
    rows = gathered(options.kept, ("told", "seed"))
    table = [
        [
            "yes" if row["told"] else "no", row["seed"], row["ended"][:100], f"{row['after']:.1e}",
            f"{row['rest']:.1e}", f"{row['most']:.2f}", row["weighed"],
        ]
        for row in sorted(rows, key=lambda row: (not row["told"], row["seed"]))
    ]  # fmt: skip
    head = [
        "firmware's gravity told", "run", "ended", f"error {AFTER:g} s after motions [rad]",
        f"in the last {REST:g} s [rad]", "most a cycle [N m]", "load weighed [kg]",
    ]  # fmt: skip
    notes = (
        f"A minute of {NUMBER} set-points up to {FAR:g} rad from home in each joint, by the simulation's "
        f"clock. The firmware adds {WRONG:g} times the true gravity; the interface is told so, as by a "
        "maker's model, or takes the URDF's gravity for it. The error is that from the set-point, the "
        "largest of all joints and set-points (asked: 1e-3 rad and 1e-4 rad). Most a cycle: the largest "
        f"change of what is sent (asked: under 1 N m), which the interface holds to {KEPT:g} N m. A load of "
        f"{LOAD.mass:g} kg comes after half a minute (asked: within 3 %)."
    )
    write("loopback_panda", "Another's Panda behind a firmware that is wrong", head, table, notes)


if __name__ == "__main__":
    main()
