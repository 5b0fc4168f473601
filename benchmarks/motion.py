"""Set-points that jump, as motions within an arm's limits: every arm, ten random ones each.

From rest at a random posture to a random set-point, both within the joint limits, at 1 kHz, by
``Shaped(GatedController.for_robot(controller))`` and, from the URDF's theta, beside it by the bare controller
with the jump as it is. The arms are those of the library and those of ../shared/arms beside the repository's
root, or wherever --arms says.
"""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from any_arm import DT, FILES, Arm, controller_of, reachable, refusal
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.errors import SimulationError

WAYS = ("shaped, urdf", "shaped, zero", "jump, urdf")
LATE, SLACK = 1.2, 0.3  # arrival within so many planned durations and so many [s] more
STAY = 1.0  # [s] of rest after that
TAKEN_OVER = 0.1  # [s] by then the torque has risen from 0 to what holds the arm, which nobody held before
ARRIVED = 1e-3  # [rad]
FASTEST_TORQUE = 10.0  # effort limits a second


class Job(NamedTuple):
    """One set-point."""

    arm: Arm
    way: str
    seed: int


class Run(NamedTuple):
    """What it gave."""

    speed: float  # largest |v| of its limit, nan where the arm has none
    planned: float  # [s]
    arrived: float  # [s] below `ARRIVED` for good
    steady: float  # [rad] largest error of the last half second
    rate: float  # largest torque rate, in effort limits a second
    fault: str = ""

    @property
    def in_time(self) -> bool:
        """Whether it arrived when it should."""
        return self.arrived <= LATE * self.planned + SLACK


def run(job: Job) -> Run:
    bare, rng = controller_of(job.arm), np.random.default_rng(job.seed)
    robot = bare.robot
    start, goal = reachable(robot, rng), reachable(robot, rng)
    planned = ea.move(robot, start, goal).duration
    shaped = job.way.startswith("shaped")
    controller = ea.Shaped(ea.GatedController.for_robot(bare, DT)) if shaped else bare
    plant = ea.PinocchioPlant(robot, start)
    fault, theta0 = "", "zero" if job.way.endswith("zero") else "urdf"
    try:
        duration = LATE * planned + SLACK + STAY
        record = ea.simulate(controller, plant, goal, duration, DT, theta0=theta0, progress=False)
    except SimulationError as reason:
        if reason.record is None:
            return Run(np.inf, planned, np.inf, np.inf, np.inf, str(reason))
        record, fault = reason.record, str(reason)
    if record.faults:
        fault = record.faults[0].name
    last = record.t >= record.t[-1] - 0.5
    rate = np.abs(np.diff(record.tau[record.t >= TAKEN_OVER], axis=0)) / DT / robot.effort_limit
    return Run(
        record.metrics().speed.value, planned, record.settling_time(ARRIVED),
        float(np.abs(record.error[last]).max()), float(rate.max()), fault,
    )  # fmt: skip


def share(value: float) -> str:
    """Of a limit, as the table shows it."""
    if np.isnan(value):
        return "no limit"
    return f"{value:.2f}" if value < 100 else f"{value:.0e}"


def costs(robot: ea.Robot) -> str:
    """What planning takes, as a sentence."""
    start, goal = robot.configuration(robot.home), robot.configuration(robot.target)
    limits = ea.MotionLimits.for_robot(robot)
    shaped = ea.Shaped(ea.CompositeController.for_robot(robot, DT), limits)
    moves, steps, wanted = [], [], robot.check_goal(goal)
    for _ in range(20):
        began = time.perf_counter()
        ea.move(robot, start, goal, limits)
        moves.append(time.perf_counter() - began)
        reference = robot.check_goal(start)
        for _ in range(500):
            began = time.perf_counter()
            reference = shaped.follow(reference, wanted, DT)
            steps.append(time.perf_counter() - began)
    return (
        f"Planning a move of the {robot.name} takes {1e3 * np.median(moves):.2f} ms, a step of Shaped "
        f"{1e6 * np.median(steps):.0f} us on its way (medians; asked: 1 ms and 30 us)."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", nargs="*", default=ea.robots(), help="of the library (default: all)")
    parser.add_argument(
        "--arms", type=Path, default=FILES, help="folder of URDF files (default: ../shared/arms)"
    )
    parser.add_argument("--seeds", type=int, default=10, help="set-points of each arm (default: 10)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--output", default="motion", help="table in benchmarks/results, or a path without .md"
    )
    options = parser.parse_args()
    files = sorted(options.arms.glob("*.urdf")) if options.arms.is_dir() else []
    arms = [Arm(name) for name in options.robots] + [Arm(file.stem, file) for file in files]
    refused = {arm: reason for arm in arms if (reason := refusal(arm))}
    arms = [arm for arm in arms if arm not in refused]
    spent = costs(ea.Robot.load("panda"))
    jobs = [Job(arm, way, seed) for arm in arms for way in WAYS for seed in range(options.seeds)]
    with ProcessPoolExecutor(options.jobs) as pool:
        found = dict(zip(jobs, tqdm(pool.map(run, jobs), total=len(jobs), unit="run"), strict=True))
    rows, missed = [], []
    for arm in arms:
        row: list[object] = [arm.shown]
        for way in WAYS:
            runs = [found[Job(arm, way, seed)] for seed in range(options.seeds)]
            row.append(share(max(r.speed for r in runs)))
            if way == "shaped, zero":
                row.append(f"{sum(not r.fault for r in runs)}/{len(runs)}")
                continue
            if way == "shaped, urdf":
                row.append(f"{min(r.planned for r in runs):.1f} to {max(r.planned for r in runs):.1f}")
                row.append(f"{sum(r.in_time for r in runs)}/{len(runs)}")
                row.append(f"{sum(not r.fault for r in runs)}/{len(runs)}")
            row += [f"{max(r.steady for r in runs):.0e}", f"{max(r.rate for r in runs):.2g}"]
        rows.append(row)
    for job, r in found.items():
        why = [r.fault] if r.fault else []
        why += [f"{share(r.speed)} of the speed"] if r.speed > 1 else []
        why += (
            []
            if r.in_time or job.way == "shaped, zero"
            else [f"arrives after {r.arrived:.2f} s of {r.planned:.2f}"]
        )
        why += (
            [f"torque rate {r.rate:.0f}/s"] if r.rate > FASTEST_TORQUE and job.way == "shaped, urdf" else []
        )
        if why and job.way != "jump, urdf":
            missed.append(f"- {job.arm.name}, {job.way}, {job.seed}: {', '.join(why)}")
    head = [
        "arm", "shaped: speed of its limit", "planned [s]", "in time", "without fault", "steady error [rad]",
        "torque rate [effort/s]", "from zero: speed", "from zero: without fault", "jump: speed",
        "jump: steady error [rad]", "jump: torque rate [effort/s]",
    ]  # fmt: skip
    notes = (
        f"{options.seeds} set-points each, from the URDF's theta where nothing else is said; shaped runs "
        f"behind the gate. Largest speeds and torque rates of all joints and runs. In time: below "
        f"{ARRIVED:g} rad within {LATE:g} planned durations and {SLACK:g} s. Torque rates are taken "
        f"from {TAKEN_OVER:g} s on, when the arm is held. Targets: speed 1, torque rate "
        f"{FASTEST_TORQUE:g}/s, all in time and without fault. {spent}\n\n"
        + ("Missed:\n\n" + "\n".join(missed) if missed else "All are met.")
        + (
            "\n\nRefused: " + "; ".join(f"{arm.shown}: {why}" for arm, why in refused.items())
            if refused
            else ""
        )
    )
    write(options.output, "Set-points as motions within the limits", head, rows, notes)


if __name__ == "__main__":
    main()
