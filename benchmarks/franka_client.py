"""The maker's client against a Franka that is not there: set-points for a minute, with all limits enforced.

franka-sim serves an FR3 (rotors, friction) over the robot's own network protocol and stops it by the robot's
reflexes. The controller knows the Panda's URDF and is told nothing. Make an environment for the server with

    python -m venv sim && sim/bin/pip install franka-sim && sim/bin/pip install --no-deps franky-sim

and say ELADAPT_FRANKA_SIM_PYTHON=sim/bin/python. Needs two cores for itself.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import table

import eladapt as ea
from eladapt.errors import LoopError
from eladapt.hardware.commissioning import Heard
from eladapt.hardware.franka import FrankaRobot

ADDRESS, DT = "127.0.0.1", 1e-3
GOALS, EACH, FAR = 8, 7.5, 0.4  # set-points of a minute, [s], [rad] from the start
AFTER, REST = 0.5, 1.0  # [s] after a motion, and before the next, in which errors are judged
SLOW = 0.4  # of the Panda's speed limits: the FR3's depend on where it is
LOAD = 1.5  # [kg]
# Its physics and its network each keep a clock: some samples in a thousand are a cycle or four off.
TOLD: dict[str, Any] = {"delay": DT, "jitter": 4 * DT}
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
            assert process.stdout is not None
            while line := process.stdout.readline():
                if line.strip() == "ready":
                    break
            time.sleep(2.0)
            yield
        finally:
            process.kill()


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


def controller_of(robot: ea.Robot) -> ea.GatedController:
    return ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT, **TOLD), DT)


def minute(controller: Any, arm: FrankaRobot, gravity: Gravity, seed: int) -> Run:
    robot = controller.robot
    arm.connect()
    start, heard = arm.posture(), Heard(arm)
    limits = ea.MotionLimits.for_robot(robot, velocity=SLOW)
    rng = np.random.default_rng(seed)
    goals = [start + rng.uniform(-FAR, FAR, 7) for _ in range(GOALS)]
    ends, before = [], start
    for k, goal in enumerate(goals):
        q0, q1 = robot.configuration(before), robot.configuration(goal)
        ends.append(k * EACH + ea.move(robot, q0, q1, limits).duration)
        before = goal

    def asked(t: float) -> np.ndarray:
        return robot.configuration(goals[min(int(max(t, 0.0) / EACH), GOALS - 1)])

    try:
        result: Any = ea.run_loop(controller, heard, asked, GOALS * EACH, DT, limits=limits)
        ended = result.ended if result.fault is None else f"fault {result.fault}"
    except LoopError as reason:
        result, ended = reason, str(reason)
    record = result.record
    if record is None:
        return Run(ended, np.inf, np.inf, np.inf, 0, np.nan, np.nan, None)
    t = record.t - record.t[0]
    wrong = np.abs(np.array([robot.difference(asked(at), q) for at, q in zip(t, record.q, strict=True)])).max(
        axis=1
    )
    after = [wrong[(t > end + AFTER) & (t < (k + 1) * EACH)] for k, end in enumerate(ends)]
    rest = [wrong[(t > (k + 1) * EACH - REST) & (t < (k + 1) * EACH)] for k in range(GOALS)]
    sent = record.tau - np.array([gravity(q) for q in record.q])
    change, cycles = np.abs(np.diff(sent, axis=0)).max(), np.round(np.diff(t) / DT)
    work = result.timing.work
    return Run(
        ended, _largest(after), _largest(rest), float(change), int(np.sum(cycles - 1)), 1e6 * work[0],
        1e6 * work[2], log_of(robot, heard),
    )  # fmt: skip


def log_of(robot: ea.Robot, heard: Heard) -> ea.Log:
    """What was measured."""
    taken = heard.measurements
    t, q, v, tau = (np.array([getattr(m, name) for m in taken]) for name in ("t", "q", "v", "tau"))
    return ea.Log(t, q, v, tau, robot.joint_names, held=True)


def _largest(parts: list[np.ndarray]) -> float:
    return max((float(part.max()) for part in parts if len(part)), default=np.inf)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=10)
    options = parser.parse_args()
    python = os.environ.get("ELADAPT_FRANKA_SIM_PYTHON")
    if python is None:
        sys.exit("skipped: say ELADAPT_FRANKA_SIM_PYTHON, see --help")
    robot, gravity = ea.Robot.load("panda"), firmware_gravity(python)
    rows: list[list[str]] = []
    for load, runs in ((0.0, options.runs), (LOAD, max(1, options.runs // 3))):
        for seed in range(runs):
            with server(python, load):
                arm = FrankaRobot(ADDRESS, robot, gravity=gravity, recover=True)
                done = minute(controller_of(robot), arm, gravity, seed)
            figures = (f"{done.after:.1e}", f"{done.rest:.1e}", f"{done.rate:.3f}", str(done.lost))
            row = [
                f"{load:g}",
                str(seed),
                done.ended[:100],
                *figures,
                f"{done.work:.0f}",
                f"{done.slowest:.0f}",
            ]
            print(row, flush=True)
            rows.append(row)
    head = ["load [kg]", "run", "ended", f"error {AFTER:g} s after motions [rad]", "at rest [rad]",
            "most a cycle [N m]", "cycles lost", "state to command [us], median", "99.9 %"]  # fmt: skip
    notes = (
        f"A minute of {GOALS} set-points up to {FAR:g} rad from the start in each joint. The error is that "
        f"from the set-point, the largest of all joints. The limit of a cycle is 1 N m. Motions keep to "
        f"{SLOW:g} of the Panda's speed limits. The controller is told {TOLD} "
        "and the Panda's URDF. The change is of what is wanted; what is sent changes by 0.99 N m at the most."
    )
    table.write("franka_client", "A Franka that is not there, by its maker's client", head, rows, notes)


if __name__ == "__main__":
    main()
