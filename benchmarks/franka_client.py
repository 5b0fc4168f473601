"""The maker's client against a Franka that is not there: set-points for a minute, with all limits enforced.

franka-sim serves an FR3 (rotors, friction) over the robot's own network protocol and stops it by the robot's
reflexes. The controller knows the Panda's URDF. Make an environment for the server with

    python -m venv sim && sim/bin/pip install franka-sim && sim/bin/pip install --no-deps franky-sim

and say ELADAPT_FRANKA_SIM_PYTHON=sim/bin/python. Needs two cores for itself.
"""

from __future__ import annotations

import argparse
import itertools
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from typing import Any, NamedTuple

import mujoco
import numpy as np
import table
from set_points import AFTER, Course, drive

import eladapt as ea
from eladapt.hardware.commissioning import Heard
from eladapt.hardware.franka import FrankaRobot

ADDRESS, DT = "127.0.0.1", 1e-3
GOALS, EACH, FAR = 8, 7.5, 0.4  # set-points of a minute, [s], [rad] from the start
SLOW = 0.4  # of the Panda's speed limits: the FR3's depend on where it is
LOAD = 1.5  # [kg]
# Its physics and its network each keep a clock: some samples in a thousand are a cycle or four off.
TOLD: dict[str, dict[str, Any]] = {
    "nothing": {}, "delay": {"delay": DT}, "delay and jitter": {"delay": DT, "jitter": 4 * DT},
}  # fmt: skip
ALL = "delay and jitter"
PATIENCE = 30.0  # [s] for the server to start

Gravity = Callable[[np.ndarray], np.ndarray]


class Run(NamedTuple):
    """A minute."""

    ended: str
    after: float  # [rad] the largest error 0.5 s after the motions
    rest: float  # [rad] in the last second of each set-point
    rate: float  # [N m] the largest change of torque from cycle to cycle
    lost: int  # cycles that the robot had without a read
    work: float  # [us] from state to command, median
    slowest: float  # [us] 99.9 %
    log: ea.Log | None


@contextmanager
def server(python: str, load: float) -> Iterator[None]:
    script = Path(__file__).with_name("franka_sim_server.py")
    command = [python, str(script), "--load", str(load)]
    environment = {**os.environ, "MUJOCO_GL": "disable", "PYTHONPATH": ""}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    ) as process:
        try:
            _require_ready(process)
            time.sleep(2.0)
            yield
        finally:
            process.kill()


def _require_ready(process: subprocess.Popen[str]) -> None:
    """Raises RuntimeError for a server that ends, or is ended after `PATIENCE`, before it says so."""
    assert process.stdout is not None
    too_late = Timer(PATIENCE, process.kill)
    too_late.start()
    try:
        if not any(line.strip() == "ready" for line in process.stdout):
            raise RuntimeError(f"franka-sim did not start within {PATIENCE:g} s: {process.args!r}")
    finally:
        too_late.cancel()


def firmware_gravity(python: str) -> Gravity:
    """That of the server's arm: its state does not say where down is, which the maker's model asks for."""
    found = "import importlib.util as u; print(u.find_spec('franky_sim').submodule_search_locations[0])"
    folder = Path(
        subprocess.run([python, "-c", found], capture_output=True, text=True, check=True).stdout.strip()
    )
    text = (folder / "assets" / "fr3.xml").read_text()
    model = mujoco.MjModel.from_xml_string(
        re.sub(r'meshdir="[^"]*"', f'meshdir="{folder}/assets/meshes"', text)
    )
    data = mujoco.MjData(model)

    def gravity(q: np.ndarray) -> np.ndarray:
        data.qpos[:7], data.qvel[:] = q, 0
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        return np.array(data.qfrc_bias[:7])

    return gravity


def controller_of(robot: ea.Robot, told: str = ALL) -> ea.GatedController:
    return ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT, **TOLD[told]), DT)


def minute(controller: Any, arm: FrankaRobot, gravity: Gravity, seed: int) -> Run:
    robot = controller.robot
    start, heard = arm.posture(), Heard(arm)
    limits = ea.MotionLimits.for_robot(robot, velocity=SLOW)
    course = Course.around(robot, start, FAR, GOALS, EACH, limits, seed)
    ended, errors, result = drive(controller, heard, course, DT)
    record = result.record
    if record is None:
        return Run(ended, errors.after, errors.rest, np.inf, 0, np.nan, np.nan, None)
    sent = record.tau - np.array([gravity(q) for q in record.q])
    change, cycles = np.abs(np.diff(sent, axis=0)).max(), np.round(np.diff(record.t) / DT)
    work = result.timing.work
    return Run(
        ended, errors.after, errors.rest, float(change), int(np.sum(cycles - 1)), 1e6 * work[0],
        1e6 * work[2], heard.log(robot),
    )  # fmt: skip


def row_of(load: float, told: str, seed: int, done: Run) -> dict[str, Any]:
    return {
        "load": load, "told": told, "seed": seed, "ended": done.ended[:100], "after": done.after,
        "rest": done.rest, "rate": done.rate, "lost": done.lost, "work": done.work, "slowest": done.slowest,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(10)), help="(default: 0 to 9)")
    parser.add_argument(
        "--loads", type=float, nargs="*", default=[0.0, LOAD], help=f"[kg] (default: 0 {LOAD})"
    )
    parser.add_argument("--told", choices=list(TOLD), nargs="*", default=list(TOLD), help="(default: all)")
    parser.add_argument(
        "--kept", type=Path, default=Path("out/franka_client.jsonl"), help="runs so far, and these"
    )
    options = parser.parse_args()
    python = os.environ.get("ELADAPT_FRANKA_SIM_PYTHON")
    if python is None:
        sys.exit("skipped: say ELADAPT_FRANKA_SIM_PYTHON, see --help")
    robot, gravity, case = ea.Robot.load("panda"), firmware_gravity(python), ("load", "told", "seed")
    for load, told, seed in itertools.product(options.loads, options.told, options.seeds):
        with server(python, load):
            arm = FrankaRobot(ADDRESS, robot, gravity=gravity, recover=True)
            row = row_of(load, told, seed, minute(controller_of(robot, told), arm, gravity, seed))
        print(row, flush=True)
        table.gathered(options.kept, case, row)
    rows = sorted(table.gathered(options.kept, case), key=lambda row: [row[name] for name in case])
    cells = [
        [
            f"{row['load']:g}", row["told"], row["seed"], row["ended"], f"{row['after']:.1e}",
            f"{row['rest']:.1e}", f"{row['rate']:.3f}", row["lost"], f"{row['work']:.0f}",
            f"{row['slowest']:.0f}",
        ]
        for row in rows
    ]  # fmt: skip
    head = ["load [kg]", "told", "run", "ended", f"error {AFTER:g} s after motions [rad]", "at rest [rad]",
            "most a cycle [N m]", "cycles lost", "state to command [us], median", "99.9 %"]  # fmt: skip
    notes = (
        f"A minute of {GOALS} set-points up to {FAR:g} rad from the start in each joint. The error is that "
        f"from the set-point, the largest of all joints. The limit of a cycle is 1 N m. Motions keep to "
        f"{SLOW:g} of the Panda's speed limits. Told, beside the Panda's URDF: "
        f"{'; '.join(f'{name}, {given}' for name, given in TOLD.items())}. "
        "The change is of what is wanted; what is sent changes by 0.99 N m at the most."
    )
    table.write("franka_client", "A Franka that is not there, by its maker's client", head, cells, notes)


if __name__ == "__main__":
    main()
