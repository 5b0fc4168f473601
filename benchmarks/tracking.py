"""Sines in all joints on every robot of the library: how closely the arm follows while it learns, and after.

0.25 rad at 0.3 Hz, beginning smoothly within a second, at 1 kHz, with `CompositeController.for_robot(robot)`
and nothing else: from theta = 0, and from the URDF's theta with a tenth of the arm's mass at the tool, of
which nobody told.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.errors import EladaptError, SimulationError

DT = 1e-3
AMPLITUDE, FREQUENCY, START = 0.25, 0.3, 1.0  # [rad], [Hz], [s]
ROOM = (
    0.6  # [rad] of the joint range kept free at both ends: the sines reach 2 AMPLITUDE from where they begin
)
TARGET = 1e-5  # [rad] after three seconds
CASES = {"from zero": "zero", "from the URDF, loaded": "urdf"}


class Run(NamedTuple):
    """What one run gave: the largest errors of any joint [rad]."""

    robot: str
    case: str
    first: float  # in the first second
    second: float  # from 1 to 3 s
    after: float  # from 3 s
    effort: float  # largest share of a torque limit
    failed: str


def sines(robot: ea.Robot, x0: np.ndarray) -> Callable[[float], ea.Reference]:
    """The reference at t [s]: x0 + AMPLITUDE b(t) [sin(w t + phase) - sin(phase)].

    b is a smooth step within START; the joints' phases are spread over 2 rad.
    """
    w, phase = 2 * np.pi * FREQUENCY, np.linspace(0, 2, robot.nv)

    def reference(t: float) -> ea.Reference:
        u = min(t / START, 1.0)
        b = u**3 * (10 - 15 * u + 6 * u**2)
        b1 = 30 * u**2 * (1 - u) ** 2 / START
        b2 = 60 * u * (1 - u) * (1 - 2 * u) / START**2
        s = np.sin(w * t + phase) - np.sin(phase)
        s1, s2 = w * np.cos(w * t + phase), -(w**2) * np.sin(w * t + phase)
        q, v, a = b * s, b1 * s + b * s1, b2 * s + 2 * b1 * s1 + b * s2
        return ea.Reference(robot.configuration(x0 + AMPLITUDE * q), AMPLITUDE * v, AMPLITUDE * a)

    return reference


def middle(robot: ea.Robot) -> np.ndarray:
    """(nv,) joint coordinates: home, with room for the sines."""
    lower = np.where(np.isfinite(robot.lower), robot.lower, -np.inf)
    upper = np.where(np.isfinite(robot.upper), robot.upper, np.inf)
    room = np.minimum(ROOM, (upper - lower) / 2)
    return np.clip(robot.home, lower + room, upper - room)


def run(job: tuple[str, str, float]) -> Run:
    name, case, duration = job
    robot = ea.Robot.load(name)
    x0 = middle(robot)
    mass = sum(body.mass for body in list(robot.model.inertias)[1:])
    payload = 0.1 * mass if CASES[case] == "urdf" else None
    plant = ea.PinocchioPlant(robot, robot.configuration(x0), payload=payload)
    failed = ""
    try:
        controller = ea.CompositeController.for_robot(robot, DT)
        goal = sines(robot, x0)
        record = ea.simulate(controller, plant, goal, duration, DT, theta0=CASES[case], progress=False)
    except SimulationError as reason:
        if reason.record is None:
            return Run(name, case, np.inf, np.inf, np.inf, np.nan, str(reason))
        record, failed = reason.record, str(reason)
    except EladaptError as reason:
        return Run(name, case, np.inf, np.inf, np.inf, np.nan, str(reason))
    error = np.abs(record.error).max(axis=1)
    first, second = record.t < 1, (record.t >= 1) & (record.t < 3)
    after = np.inf if failed else error[record.t >= 3].max()
    limited = np.isfinite(record.effort_limit)
    effort = np.max(np.abs(record.tau[:, limited]) / record.effort_limit[limited], initial=0.0)
    return Run(
        name, case, float(error[first].max()), float(error[second].max(initial=0.0)), float(after),
        float(effort), failed,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", nargs="*", default=ea.robots(), help="default: all")
    parser.add_argument("--duration", type=float, default=6.0, help="[s] of each run (default: 6)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--output", default="tracking", help="table in benchmarks/results, or a path without .md"
    )
    options = parser.parse_args()
    if options.duration <= 3:
        parser.error("--duration: expected more than 3 s")
    jobs = [(name, case, options.duration) for name in options.robots for case in CASES]
    with ProcessPoolExecutor(options.jobs) as pool:
        runs = {(r.robot, r.case): r for r in tqdm(pool.map(run, jobs), total=len(jobs), unit="run")}
    for result in runs.values():
        if result.failed:
            print(f"{result.robot}, {result.case}: {result.failed}")
    spans = ("first second", "1 to 3 s", "after 3 s")
    head = ["robot", *(f"{case}: {span}" for case in CASES for span in spans), "largest effort / limit"]
    rows: list[list[object]] = []
    for name in options.robots:
        mine = [runs[name, case] for case in CASES]
        figures = [f"{error:.0e}" for r in mine for error in (r.first, r.second, r.after)]
        rows.append([name, *figures, f"{max(r.effort for r in mine):.2f}"])
    met = sum(r.after <= TARGET for r in runs.values())
    missed = ", ".join(f"{r.robot} {r.case} ({r.after:.0e})" for r in runs.values() if not r.after <= TARGET)
    notes = (
        f"Largest errors of any joint [rad], over {options.duration:g} s. Target after 3 s: {TARGET:.0e} "
        f"rad, met in {met} of {len(runs)}{f'; not by {missed}' if missed else ''}."
    )
    write(options.output, "Sines, from nothing and with a load that nobody told of", head, rows, notes)


if __name__ == "__main__":
    main()
