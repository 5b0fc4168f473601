"""Which mixing: determinant, smallest eigenvalue or none, of all parameters or of gravity's part alone.

One move from home to the target at 1 kHz, from theta = 0, with `CompositeController.for_robot(robot)` and
only the mixing exchanged, so that gains, extension and control law are the same. "Learned" is when the
gravity torque that the estimate gives at the arm's posture stays within the limit.
"""

from __future__ import annotations

import argparse
import dataclasses
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.gains.extremes import extremes

DT = 1e-3
LOOK = 33  # samples between two looks at Delta
MIXINGS: dict[str, Any] = {
    "Determinant, all parameters (the paper)": ea.Determinant(scope="all"),
    "SmallestEigenvalue, all parameters": ea.SmallestEigenvalue(scope="all"),
    "Determinant, gravity's parameters": ea.Determinant(scope="potential"),
    "SmallestEigenvalue, gravity's parameters": ea.SmallestEigenvalue(scope="potential"),
    "Unmixed, gravity's parameters": ea.Unmixed(scope="potential"),
    "Unmixed, all parameters": ea.Unmixed(scope="all"),
    "Unmixed, with joint terms (default)": ea.Unmixed(scope="all"),
}
DEFAULT = list(MIXINGS)[-1]


class Run(NamedTuple):
    """What one mixing gave on one robot."""

    robot: str
    mixing: str
    direct: bool
    learned: float  # [s] gravity error below 0.1 N m
    learned_1: float  # [s] gravity error below 1 % of the bound
    settled: float  # [s] below 1e-3 rad
    steady: float  # [rad]
    gravity: float  # [N m] error at the end
    delta: float  # largest Delta, or smallest eigenvalue of Phi, on the way


def run(job: tuple[str, str, bool, float]) -> Run:
    name, mixing, direct, duration = job
    robot = ea.Robot.load(name)
    terms: dict[str, Any] = {} if mixing == DEFAULT else {"joint_terms": ()}
    controller = ea.CompositeController.for_robot(robot, DT, **terms)
    law = dataclasses.replace(controller.law, direct=direct)
    controller = dataclasses.replace(controller, mixing=MIXINGS[mixing], law=law)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    deltas = []

    def look(t: float, q: np.ndarray, goal: np.ndarray, state: ea.ControllerState) -> None:
        if round(t / DT) % LOOK == 0:
            deltas.append(least(controller.mixed(state).gain))

    record = ea.simulate(controller, plant, goal, duration, DT, theta0="zero", progress=False, observer=look)
    reg, bound = controller.regressors, extremes(robot).gravity.max()
    errors = np.array(
        [np.abs(reg.gravity(q) @ wrong).max() for q, wrong in zip(record.q, record.theta_error, strict=True)]
    )
    metrics = record.metrics()
    return Run(
        name, mixing, direct, since(record.t, errors < 0.1), since(record.t, errors < 0.01 * bound),
        record.settling_time(1e-3), metrics.steady_error, float(errors[-1]), max(deltas),
    )  # fmt: skip


def least(gain: float | np.ndarray) -> float:
    """Delta, or the smallest eigenvalue of Phi, which is a difference of ones and so has 12 digits."""
    return max(0.0, round(float(np.linalg.eigvalsh(gain)[0]), 12)) if np.ndim(gain) else float(gain)


def since(t: np.ndarray, inside: np.ndarray) -> float:
    """[s] from when on ``inside`` holds; inf if it does not at the end."""
    outside = np.flatnonzero(~inside)
    if not len(outside):
        return float(t[0])
    return float("inf") if outside[-1] == len(t) - 1 else float(t[outside[-1] + 1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--duration", type=float, default=4.0, help="[s] of each run (default: 4)")
    parser.add_argument("--robots", nargs="*", default=["two_link", "panda"], help="default: two_link panda")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    jobs = [
        (name, mixing, direct, options.duration)
        for name in options.robots
        for direct in (True, False)
        for mixing in MIXINGS
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        runs = list(tqdm(pool.map(run, jobs), total=len(jobs), unit="run"))
    head = [
        "robot", "mixing", "direct term", "gravity error below 0.1 N m after [s]",
        "below 1 % of its bound after [s]",
        "error below 1e-3 rad after [s]", "steady error [rad]", "gravity error at the end [N m]",
        "largest Delta",
    ]  # fmt: skip
    rows: list[list[object]] = [
        [
            r.robot, r.mixing, "yes" if r.direct else "no", _time(r.learned), _time(r.learned_1),
            _time(r.settled), f"{r.steady:.0e}", f"{r.gravity:.0e}", f"{r.delta:.1e}",
        ]
        for r in runs
    ]  # fmt: skip
    bounds = ", ".join(f"{n}: {extremes(ea.Robot.load(n)).gravity.max():.3g} N m" for n in options.robots)
    sizes = {name: ea.Regressors(ea.Robot.load(name)) for name in options.robots}
    factors = ", ".join(f"{len(reg)} or {reg.n_potential} on {name}" for name, reg in sizes.items())
    notes = (
        f"Largest gravity torques: {bounds}. Runs of {options.duration:g} s. Without the direct term only "
        "the mixed regression teaches. Largest Delta: of what the mixing multiplies theta with; unmixed, the "
        f"smallest eigenvalue of Phi. A determinant is a product of factors below one: {factors}. The "
        "smallest eigenvalue waits for the direction that is excited last; unmixed, each is learned when it "
        "is excited. The comparison is without joint terms: a joint that has moved one way only does not "
        "tell its offset from its Coulomb friction, and one direction that is not excited makes Delta 0."
    )
    write("mixing", "Mixing: what the estimate waits for", head, rows, notes)


def _time(seconds: float) -> str:
    return f"{seconds:.2f}" if np.isfinite(seconds) else "never"


if __name__ == "__main__":
    main()
