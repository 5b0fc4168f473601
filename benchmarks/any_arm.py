"""Any arm, nothing to tune: random set-points on every robot of the library, gains from the URDF alone.

From theta_U = 0 and rest at a random posture to a random set-point, both within the joint limits, at 1 kHz
for 4.5 s, with `CompositeController.for_robot(robot)` and nothing else.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np
from table import COMPILED, write
from tqdm import tqdm

import eladapt as ea
from eladapt.control.gains import extremes
from eladapt.errors import SimulationError

DURATION, DT = 4.5, 1e-3
MARGIN = 0.1  # of the joint range kept free at both ends


class Run(NamedTuple):
    """What one set-point gave."""

    robot: str
    seed: int
    settled: float  # [s] below 1e-3 rad
    steady: float  # [rad]
    gravity: float  # error of the gravity torque at the end, of the arm's bound
    effort: float  # largest share of a torque limit
    diverged: bool

    @property
    def good(self) -> bool:
        """All that is asked of a run."""
        return self.settled <= 4 and self.gravity < 0.01 and self.steady <= 1e-5 and self.effort <= 1


def posture(robot: ea.Robot, rng: np.random.Generator) -> np.ndarray:
    lower = np.where(np.isfinite(robot.lower), np.maximum(robot.lower, -np.pi), -np.pi)
    upper = np.where(np.isfinite(robot.upper), np.minimum(robot.upper, np.pi), np.pi)
    free = MARGIN * (upper - lower)
    return robot.configuration(rng.uniform(lower + free, upper - free))


def reachable(robot: ea.Robot, rng: np.random.Generator) -> np.ndarray:
    """A random posture that the torque limits can hold with a tenth to spare."""
    while True:
        q = posture(robot, rng)
        if np.all(np.abs(robot.gravity(q)) < 0.9 * robot.effort_limit):
            return q


def run(job: tuple[str, int]) -> Run:
    name, seed = job
    robot, rng = ea.Robot.load(name), np.random.default_rng(seed)
    start, goal = reachable(robot, rng), reachable(robot, rng)
    controller = ea.CompositeController.for_robot(robot, DT, compiled=COMPILED)
    plant = ea.PinocchioPlant(robot, start)
    try:
        record = ea.simulate(controller, plant, goal, DURATION, DT, progress=False)
    except SimulationError as reason:
        return Run(name, seed, np.inf, np.inf, np.inf, np.nan, reason.record is not None)
    bound = max(extremes(robot).gravity.max(), 1e-6)
    error = controller.regressors.gravity(record.q[-1]) @ record.theta_error[-1]
    last = np.abs(record.error[record.t >= DURATION - 0.5]).max()
    effort = np.max(np.abs(record.tau) / record.effort_limit)
    return Run(
        name, seed, record.settling_time(1e-3), float(last), float(np.abs(error).max(initial=0) / bound),
        float(effort), False,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=20, help="set-points a robot (default: 20)")
    parser.add_argument("--robots", nargs="*", default=ea.robots(), help="default: all")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--output", default="any_arm",
        help="name of the table in benchmarks/results, or a path without .md, for a part of the runs "
        "(default: any_arm)",
    )  # fmt: skip
    options = parser.parse_args()
    jobs = [(name, seed) for name in options.robots for seed in range(options.runs)]
    with ProcessPoolExecutor(options.jobs) as pool:
        runs = []
        for result in tqdm(pool.map(run, jobs), total=len(jobs), unit="run"):
            runs.append(result)
            if not result.good:
                tqdm.write(str(result))
    head = [
        "robot", "good", "median settling [s]", "worst settling [s]", "worst steady error [rad]",
        "worst gravity error / bound", "largest effort / limit", "failures (set-point seeds)",
    ]  # fmt: skip
    rows: list[list[object]] = []
    for name in options.robots:
        mine = [r for r in runs if r.robot == name]
        bad = ", ".join(
            f"{r.seed} ({r.settled:.1f} s, {r.steady:.0e} rad, {r.gravity:.0e})" for r in mine if not r.good
        )
        rows.append(
            [
                name, f"{sum(r.good for r in mine)}/{len(mine)}",
                f"{np.median([r.settled for r in mine]):.2f}",
                f"{max(r.settled for r in mine):.2f}", f"{max(r.steady for r in mine):.0e}",
                f"{max(r.gravity for r in mine):.0e}", f"{max(r.effort for r in mine):.2f}", bad or "-",
            ]
        )  # fmt: skip
    good, median = sum(r.good for r in runs), np.median([r.settled for r in runs])
    notes = f"Good: {good} of {len(runs)} ({good / len(runs):.1%}); median settling {median:.2f} s."
    write(options.output, "Any arm, nothing to tune", head, rows, notes)


if __name__ == "__main__":
    main()
