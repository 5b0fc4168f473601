"""Any arm, nothing to tune: random set-points, gains from the URDF alone.

From rest at a random posture to a random set-point, both within the joint limits, at 1 kHz for 4.5 s, with
`CompositeController.for_robot(robot)` and nothing else: once from theta = 0, which knows no mass at all, and
once from the URDF's theta. The arms are those of the library, and URDF files that nobody here made, in a
folder ../shared/arms beside the repository's root, or wherever --arms says.
"""

from __future__ import annotations

import argparse
import functools
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.errors import EladaptError, SimulationError
from eladapt.gains.extremes import extremes

FILES = Path(__file__).resolve().parents[2] / "shared" / "arms"  # beside the repository
OPTIONS: dict[str, dict[str, Any]] = {  # what `Robot.from_urdf` has to be told of a file
    "fetch": {"locked": ["base_joint*"]},
    "jaco_j2s7s300": {"locked": ["*finger*"]},
    "rizon4": {"armature": {"joint7": 0.01}},  # its last link has no inertia about its axis
}
STARTS = {"zero": "from theta = 0", "urdf": "from the URDF's theta"}
DURATION, DT = 4.5, 1e-3
THRESHOLD, LATEST = 1e-3, 4.0  # [rad] and [s] by which every joint is to stay below it
MARGIN = 0.1  # of the joint range kept free at both ends


class Arm(NamedTuple):
    """One of the library, or a file."""

    name: str
    file: Path | None = None

    @property
    def shown(self) -> str:
        """In the table."""
        return self.name if self.file is None else self.file.name


class Job(NamedTuple):
    """One set-point."""

    arm: Arm
    start: str
    seed: int


class Run(NamedTuple):
    """What it gave."""

    settled: float  # [s] below 1e-3 rad; inf if it does not
    steady: float  # [rad] largest error of the last half second
    gravity: float  # error of the gravity torque at the end, of the arm's bound
    effort: float  # largest share of a torque limit
    failed: str = ""

    @property
    def good(self) -> bool:
        """Whether it settled, in time to tell what is left."""
        return self.settled <= LATEST


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


@functools.cache
def controller_of(arm: Arm) -> ea.CompositeController:
    """Raises EladaptError for an arm that the library refuses."""
    if arm.file is None:
        return ea.CompositeController.for_robot(ea.Robot.load(arm.name), DT)
    robot = ea.Robot.from_urdf(arm.file, name=arm.name, **OPTIONS.get(arm.name, {}))
    return ea.CompositeController.for_robot(robot, DT)


def refusal(arm: Arm) -> str:
    """Why the library does not control an arm, the last of its reasons; nothing where it does."""
    try:
        controller_of(arm)
    except EladaptError as reason:
        return str(reason).splitlines()[-1].strip(" -")
    return ""


def run(job: Job) -> Run:
    controller, rng = controller_of(job.arm), np.random.default_rng(job.seed)
    robot = controller.robot
    start, goal = reachable(robot, rng), reachable(robot, rng)
    plant = ea.PinocchioPlant(robot, start)
    try:
        record = ea.simulate(controller, plant, goal, DURATION, DT, theta0=job.start, progress=False)
    except SimulationError as reason:
        return Run(np.inf, np.inf, np.inf, np.inf, str(reason))
    bound = max(extremes(robot).gravity.max(), 1e-6)
    error = controller.regressors.gravity(record.q[-1]) @ record.theta_error[-1]
    last = record.t >= DURATION - 0.5
    return Run(
        record.settling_time(THRESHOLD), float(np.abs(record.error[last]).max()),
        float(np.abs(error).max() / bound), float(np.max(np.abs(record.tau) / record.effort_limit)),
    )  # fmt: skip


def measure(arms: list[Arm], seeds: int, workers: int) -> dict[tuple[Arm, str], list[Run]]:
    """The runs of every arm, from every start."""
    jobs = [Job(arm, start, seed) for start in STARTS for arm in arms for seed in range(seeds)]
    found: dict[tuple[Arm, str], list[Run]] = {}
    with ProcessPoolExecutor(workers) as pool:
        for job, result in zip(jobs, tqdm(pool.map(run, jobs), total=len(jobs), unit="run"), strict=True):
            found.setdefault((job.arm, job.start), []).append(result)
            if not result.good:
                tqdm.write(f"{job.arm.name}, {STARTS[job.start]}, {job.seed}: {result}")
    return found


def median_of(runs: list[Run]) -> str:
    return f"{np.median([r.settled for r in runs]):.2f}"


def row_of(arm: Arm, start: str, runs: list[Run]) -> list[object]:
    bad = [f"{seed} ({r.settled:.1f} s, {r.steady:.0e} rad)" for seed, r in enumerate(runs) if not r.good]
    return [
        arm.shown, STARTS[start], f"{sum(r.good for r in runs)}/{len(runs)}", median_of(runs),
        f"{max(r.settled for r in runs):.2f}", f"{max(r.steady for r in runs):.0e}",
        f"{max(r.gravity for r in runs):.0e}", f"{max(r.effort for r in runs):.2f}", ", ".join(bad) or "-",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=20, help="set-points an arm and start (default: 20)")
    parser.add_argument("--robots", nargs="*", help="by name, of the library and of --arms (default: all)")
    parser.add_argument("--arms", type=Path, default=FILES, help="folder with other URDF files")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--output", default="any_arm", help="table in benchmarks/results, or a path without .md"
    )
    options = parser.parse_args()
    groups = {
        "The library's arms": [Arm(name) for name in ea.robots()],
        "Others' arms": [Arm(path.stem, path) for path in sorted(options.arms.glob("*.urdf"))],
    }
    rows: list[list[object]] = []
    summary: list[str] = []
    for group, arms in groups.items():
        if not arms:
            summary.append(f"- {group}: skipped, there is no folder {options.arms.name!r} with URDF files.")
            continue
        chosen = [arm for arm in arms if options.robots is None or arm.name in options.robots]
        refused = {arm.name: reason for arm in chosen if (reason := refusal(arm))}
        found = measure([arm for arm in chosen if arm.name not in refused], options.runs, options.jobs)
        rows += [row_of(*key, runs) for key, runs in found.items()]
        for start, title in STARTS.items():
            if runs := [r for (_, begun), some in found.items() if begun == start for r in some]:
                good = f"{sum(r.good for r in runs)} of {len(runs)} settle"
                summary.append(f"- {group}, {title}: {good}, median {median_of(runs)} s.")
        summary += [f"- Refused: {name}. {reason}" for name, reason in refused.items()]
    head = [
        "robot", "start", "settled", "median settling [s]", "worst settling [s]", "worst steady error [rad]",
        "worst gravity error / bound", "largest effort / limit", "failures (set-point seeds)",
    ]  # fmt: skip
    notes = (
        f"Settled: from {LATEST:g} s on at the latest every joint is within {THRESHOLD:g} rad, and stays "
        "there. Steady error: the largest of the last half second. Gravity error: of the torque at the end. "
        "Others' arms are named by their files."
    )
    write(options.output, "Any arm, nothing to tune", head, rows, "\n".join([notes, "", *summary]))


if __name__ == "__main__":
    main()
