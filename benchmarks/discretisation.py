"""Three ways to evaluate the control law in sampled time, on arms at rest at their set-point.

One move from home to the target of each robot, from theta = 0, with the gains of
`CompositeController.for_robot(robot, dt)`; only the evaluation of the law differs, and whether a disturbance
estimate is fed forward. Ripple, standard deviation and steady error are the largest of any joint over the
last second. Where a joint sticks is a matter of luck in a single move: friction at 1 kHz is also measured
between random postures. Writes results/discretisation.md and docs/discretisation.png.
"""

from __future__ import annotations

import argparse
import dataclasses
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from any_arm import reachable
from table import write

import eladapt as ea
from eladapt.files import atomic_write

matplotlib.use("Agg")
from matplotlib import pyplot as plt

FIGURE = Path(__file__).parents[1] / "docs" / "discretisation.png"
RATES = (250, 500, 1000, 2000, 4000)  # [Hz]
NOISE: dict[str, Any] = {"position_noise": 1e-4, "velocity_noise": 1e-3}  # [rad], [rad/s]
MOVES = 6  # between random postures
FRICTION = ea.Friction(coulomb=1.0)
CASES: dict[str, dict[str, Any]] = {  # what the plant has and the controller is not told
    "nothing unknown": {},
    "2 kg at the tool": {"payload": 2.0},
    "1 N m Coulomb friction": {"friction": FRICTION},
    "noise 1e-4 rad, 1e-3 rad/s": {"noise": ea.Noise(1e-4, 1e-3)},
}
IDEAL, LOADED, STICKING, NOISY = CASES
WAYS = {
    "explicit": "C3",
    "slope-limited": "C1",
    "semi-implicit, no disturbance estimate": "C4",
    "semi-implicit": "C0",
    "semi-implicit, told the noise": "C2",
}
EXPLICIT, _, BLIND, DEFAULT, TOLD = WAYS


class Job(NamedTuple):
    """One move."""

    robot: str
    rate: int  # [Hz]
    case: str
    way: str
    seed: int | None = None  # of random postures instead of home and target


class Outcome(NamedTuple):
    """What the last second of it looked like."""

    ripple: float  # [N m]
    deviation: float  # [N m]
    steady: float  # [rad]
    settled: float  # [s] below 1e-3 rad


def controller(job: Job) -> ea.CompositeController:
    robot = ea.Robot.load(job.robot)
    told: dict[str, Any] = NOISE if job.way == TOLD else {}
    derived = ea.CompositeController.for_robot(robot, 1 / job.rate, **told)
    if job.way in (DEFAULT, TOLD):
        return derived
    evaluation: Any = "semi_implicit" if job.way == BLIND else job.way.replace("-", "_")
    law = dataclasses.replace(derived.control, evaluation=evaluation)  # type: ignore[type-var]
    return dataclasses.replace(derived, control=law, disturbance=None)


def ends(job: Job) -> tuple[np.ndarray, np.ndarray]:
    robot = ea.Robot.load(job.robot)
    if job.seed is None:
        return robot.configuration(robot.home), robot.configuration(robot.target)
    rng = np.random.default_rng(job.seed)
    return reachable(robot, rng), reachable(robot, rng)


def plant(job: Job) -> ea.PinocchioPlant:
    return ea.PinocchioPlant(ea.Robot.load(job.robot), ends(job)[0], **CASES[job.case])


def goal(job: Job) -> np.ndarray:
    return ends(job)[1]


def outcome(result: Any) -> Outcome:
    if not isinstance(result, ea.Record):
        return Outcome(np.inf, np.inf, np.inf, np.inf)
    last = result.t > result.t[-1] - 1
    tau = result.tau[last]
    return Outcome(
        float(np.ptp(tau, axis=0).max()), float(tau.std(axis=0).max()),
        float(np.abs(result.error[last]).max()), result.settling_time(1e-3),
    )  # fmt: skip


def measure(jobs: list[Job], duration: float, workers: int) -> dict[Job, Outcome]:
    """All jobs, one rate after the other."""
    found: dict[Job, Outcome] = {}
    with ProcessPoolExecutor(workers) as pool:
        for rate in sorted({job.rate for job in jobs}):
            some = [job for job in jobs if job.rate == rate]
            controllers, plants, goals = map(controller, some), map(plant, some), map(goal, some)
            records = ea.simulate_many(
                controllers, plants, goals, duration, 1 / rate, executor=pool, theta0="zero",
                title=f"{rate} Hz",
            )  # fmt: skip
            found |= {job: outcome(record) for job, record in zip(some, records, strict=True)}
    return found


def planned(rates: list[int], extra_robots: list[str]) -> list[Job]:
    swept = [Job("panda", rate, case, way) for rate in rates for case in CASES for way in WAYS]
    others = [Job(name, 1000, case, way) for name in extra_robots for case in CASES for way in WAYS]
    moves = [
        Job("panda", 1000, STICKING, way, seed) for way in (EXPLICIT, BLIND, DEFAULT) for seed in range(MOVES)
    ]
    paper = [Job("two_link", 2000, IDEAL, way) for way in WAYS]
    return [job for job in swept + others + moves + paper if job.way != TOLD or job.case == NOISY]


def shown(found: dict[Job, Outcome]) -> str:
    """The points that the default must show, with their figures."""

    def pair(case: str) -> tuple[Outcome, Outcome]:
        return found[Job("panda", 1000, case, EXPLICIT)], found[Job("panda", 1000, case, DEFAULT)]

    lines = ["Panda at 1 kHz, default against explicit; asked in brackets:", ""]
    for case in (IDEAL, LOADED):
        explicit, ours = pair(case)
        lines.append(
            f"- {case}: ripple ratio {ours.ripple / explicit.ripple:.1e} (1e-2), "
            f"steady error {ours.steady:.1e} rad ({explicit.steady:.1e})"
        )
    explicit, ours = pair(STICKING)
    lines.append(
        f"- {STICKING}: steady error {ours.steady:.1e} rad, ratio {ours.steady / explicit.steady:.2f} (1.2); "
        f"torque ripple {ours.ripple:.1e} N m against {explicit.ripple:.1e} N m"
    )
    theirs = np.array([found[Job("panda", 1000, STICKING, EXPLICIT, k)].steady for k in range(MOVES)])
    for way in (BLIND, DEFAULT):
        errors = [found[Job("panda", 1000, STICKING, way, k)].steady for k in range(MOVES)]
        ratios = ", ".join(f"{ratio:.2f}" for ratio in np.sort(errors / theirs))
        lines.append(
            f"- the same between {MOVES} pairs of random postures, {way}: ratios {ratios}; "
            f"median error {np.median(errors):.1e} rad, explicit {np.median(theirs):.1e} rad"
        )
    explicit, ours = pair(NOISY)
    told = found[Job("panda", 1000, NOISY, TOLD)]
    lines.append(
        f"- {NOISY}: torque standard deviation ratio {ours.deviation / explicit.deviation:.3f} (0.6), "
        f"told the noise {told.deviation / explicit.deviation:.3f}"
    )
    paper = found[Job("two_link", 2000, IDEAL, DEFAULT)]
    lines += ["", f"two_link at 5e-4 s: ripple {paper.ripple:.1e} N m (1e-6; the paper's 0.015)."]
    return "\n".join(lines)


def draw(found: dict[Job, Outcome], rates: list[int]) -> None:
    """Ripple and steady error of the panda over the sampling rate."""
    figure, axes = plt.subplots(
        2, len(CASES), figsize=(13, 6), sharex=True, sharey="row", layout="constrained"
    )
    rows = (("ripple", "torque ripple [N m]"), ("steady", "steady error [rad]"))
    for column, case in enumerate(CASES):
        axes[0, column].set_title(case, fontsize=11)
        axes[1, column].set_xlabel("sampling rate [Hz]")
        for row, (field, label) in enumerate(rows):
            for way, colour in WAYS.items():
                jobs = [Job("panda", rate, case, way) for rate in rates]
                if jobs[0] not in found:
                    continue
                values = [max(getattr(found[job], field), 1e-16) for job in jobs]
                axes[row, column].loglog(
                    rates, values, marker="o", markersize=4, color=colour, label=way,
                    linestyle="--" if way in (BLIND, TOLD) else "-",
                )  # fmt: skip
            axes[row, column].grid(alpha=0.3)
            axes[row, 0].set_ylabel(label)
            axes[row, column].set_xticks(rates, [str(rate) for rate in rates])
            axes[row, column].minorticks_off()
    handles, labels = axes[0, -1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    with atomic_write(FIGURE) as temporary:
        figure.savefig(temporary, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rates", nargs="*", type=int, default=RATES, help="[Hz] (default: 250 to 4000)")
    parser.add_argument("--robots", nargs="*", default=["ur5", "xarm7"], help="beside the panda, at 1 kHz")
    parser.add_argument("--duration", type=float, default=4.0, help="[s] of each run (default: 4)")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    rates = sorted({1000, *options.rates})
    found = measure(planned(rates, options.robots), options.duration, options.jobs)
    draw(found, rates)
    head = [
        "robot", "rate [Hz]", "the plant has, untold", "evaluation", "torque ripple [N m]",
        "standard deviation [N m]", "steady error [rad]", "below 1e-3 rad after [s]",
    ]  # fmt: skip
    rows: list[list[object]] = []
    for job, got in found.items():
        if job.seed is not None:
            continue
        rows.append(
            [
                job.robot, job.rate, job.case, job.way, f"{got.ripple:.1e}", f"{got.deviation:.1e}",
                f"{got.steady:.1e}", f"{got.settled:.2f}",
            ]
        )  # fmt: skip
    write("discretisation", "Evaluations of the control law in sampled time", head, rows, shown(found))


if __name__ == "__main__":
    main()
