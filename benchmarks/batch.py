"""Many estimators in one call: 256 along a leading axis against 256 calls.

A call advances the force balance, the information, the mixing and the adaptation law by one sample. "without
regression" leaves out the force balance: on the numpy path, its Pinocchio calls are one a robot however they
are called; the compiled path has a kernel of its own for the regressors of a batch. Ratios are medians over
turns of both ways, and of the shortest times, which other work on the machine disturbs least.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.estimation.excitation import GateMonitor

DT, WARM, CALLS = 1e-3, 50, 5


class Line:
    """The line of estimation, single or with a leading axis, at some point of a motion."""

    def __init__(self, reg: ea.Regressors, lead: tuple[int, ...], compiled: bool):
        self.reg, self.lead = reg, lead
        self.regression = ea.ForceBalance(reg, compiled=compiled)
        self.extension = ea.LeastSquares(compiled=compiled)
        self.mixing, self.law, self.monitor = (
            ea.Directional(compiled),
            ea.CompositeLaw(compiled=compiled),
            GateMonitor(),
        )
        self.still, self.psi = (
            np.zeros((*lead, reg.robot.nv)),
            np.zeros((*lead, reg.robot.nv, reg.n_potential)),
        )

    def start(self, measurements: list[ea.Measurement]) -> None:
        self.filters = self.regression.init(measurements[0])
        self.information = self.extension.init(len(self.reg), self.lead)
        self.mixed = self.mixing.mix(self.information, self.reg.n_potential)
        self.excitation = self.monitor.init(np.shape(self.mixed.delta))
        self.theta = np.zeros((*self.lead, self.reg.n_potential))
        for measurement in measurements[1:-1]:
            self.filters, self.found = self.regression.step(self.filters, measurement, DT)
            self.information, self.mixed, self.excitation, self.theta = self.estimate()
        self.last = measurements[-1]

    def estimate(self) -> tuple[Any, ...]:
        information = self.extension.step(self.information, self.found, DT)
        mixed = self.mixing.mix(information, self.reg.n_potential, self.mixed)
        excitation = self.monitor.step(self.excitation, mixed, DT)
        gates, still = excitation.gates, self.still
        return (
            information,
            mixed,
            excitation,
            self.law.step(self.theta, self.psi, still, still, mixed, DT, gates),
        )

    def whole(self) -> None:
        self.regression.step(self.filters, self.last, DT)
        self.estimate()


def times(call: Callable[[], Any]) -> list[float]:
    """[s] of CALLS calls."""
    found = []
    for _ in range(CALLS):
        start = time.perf_counter()
        call()
        found.append(time.perf_counter() - start)
    return found


def measure(name: str, many: int, repeats: int, compiled: bool) -> list[object]:
    reg, rng = ea.Regressors(ea.Robot.load(name)), np.random.default_rng(0)
    robot = reg.robot
    effort = 0.2 * np.where(np.isfinite(robot.effort_limit), robot.effort_limit, 5.0)
    runs = []
    for _ in range(many):
        plant = ea.PinocchioPlant(robot, robot.random_configuration(rng))
        runs.append(
            [plant.reset(), *(plant.step(effort * rng.normal(size=robot.nv), DT) for _ in range(WARM))]
        )
    singles = [Line(reg, (), compiled) for _ in runs]
    for line, run in zip(singles, runs, strict=True):
        line.start(run)
    together = Line(reg, (many,), compiled)
    together.start([
        ea.Measurement(each[0].t, *(np.array([m[i] for m in each]) for i in (1, 2, 3)))
        for each in zip(*runs, strict=True)
    ])  # fmt: skip
    alike = max(
        float(np.abs(line.theta - together.theta[b]).max(initial=0)) for b, line in enumerate(singles)
    )
    row: list[object] = [name, len(reg), "compiled" if compiled else "numpy"]
    for part in ("whole", "estimate"):
        one, all_at_once = [], []
        for _ in range(repeats):  # in turn, so that the machine's speed cancels
            one.append(times(lambda: [getattr(line, part)() for line in singles]))  # noqa: B023
            all_at_once.append(times(getattr(together, part)))
        apart, joint = np.array(one) / many * 1e6, np.array(all_at_once) / many * 1e6
        ratio = np.median(np.median(apart, axis=1) / np.median(joint, axis=1))
        row += [f"{np.median(apart):.1f}", f"{np.median(joint):.1f}", f"{ratio:.1f}"]
        row += [f"{apart.min() / joint.min():.1f}"]
    return [*row, f"{alike:.0e}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--many", type=int, default=256, help="estimators (default: 256)")
    parser.add_argument("--repeats", type=int, default=9)
    options = parser.parse_args()
    head = [
        "robot", "parameters", "path", "one call each [us]", "in one call [us each]", "ratio",
        "of the shortest", "without regression [us]", "in one call [us each]", "ratio", "of the shortest",
        "largest difference of theta",
    ]  # fmt: skip
    jobs = [(name, compiled) for name in ("two_link", "ur5", "panda") for compiled in (False, True)]
    rows = [measure(name, options.many, options.repeats, compiled) for name, compiled in tqdm(jobs)]
    notes = "compiled: numba (extra `fast`), whose loop over the estimators uses all processors."
    write("batch", f"{options.many} estimators in one call", head, rows, notes)


if __name__ == "__main__":
    main()
