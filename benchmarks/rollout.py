"""Simulated seconds per wall second, in one process, and what they are made of.

A rollout is ``ea.simulate`` of a move from home to the demonstration's target. The bare calls are
Pinocchio's in a step of the plant with their arguments at hand: eight forward dynamics and ten
integrations, without the one that adds noise to what is measured. ``--before PATH`` times a checkout of
an earlier commit too: two processes take turns, so that both have the same machine; a ratio is the median
of the ratios of neighbours.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from table import write

import eladapt as ea

DT = 1e-3
WAYS = ("bare calls", "plant", "composite", "composite's step", "gated and shaped", "its step")


def measures(name: str) -> dict[str, Callable[[int], float]]:
    """[s] that so many steps of a robot take, by way."""
    robot = ea.Robot.load(name)
    home, target = robot.configuration(robot.home), robot.configuration(robot.target)
    composite = ea.CompositeController.for_robot(robot, DT)
    shaped = ea.Shaped(ea.GatedController.for_robot(composite, DT))

    def bare(steps: int) -> float:
        model, data = robot.model, robot.model.createData()
        v, tau = np.full(robot.nv, 0.1), robot.gravity(home)
        start = time.perf_counter()
        for _ in range(steps):
            for _ in range(8):
                pin.aba(model, data, home, v, tau)
            for _ in range(10):
                pin.integrate(model, home, v)
        return time.perf_counter() - start

    def plant(steps: int) -> float:
        arm = ea.PinocchioPlant(robot, home)
        tau = arm.reset().tau
        start = time.perf_counter()
        for _ in range(steps):
            arm.step(tau, DT)
        return time.perf_counter() - start

    def rollout(controller: Any) -> Callable[[int], float]:
        def run(steps: int) -> float:
            arm = ea.PinocchioPlant(robot, home)
            start = time.perf_counter()
            ea.simulate(controller, arm, target, steps * DT, DT, progress=False)
            return time.perf_counter() - start

        return run

    def stepping(controller: Any) -> Callable[[int], float]:
        def run(steps: int) -> float:
            arm = ea.PinocchioPlant(robot, home)
            measurement, took = arm.reset(), 0.0
            state = controller.init(measurement)
            for _ in range(steps):
                start = time.perf_counter()
                state, tau = controller.step(state, measurement, target, DT)
                took += time.perf_counter() - start
                measurement = arm.step(tau, DT)
            return took

        return run

    made = (bare, plant, rollout(composite), stepping(composite), rollout(shaped), stepping(shaped))
    return dict(zip(WAYS, made, strict=True))


def serve(name: str) -> None:
    """Measure when asked: a way and a number of steps on each line of stdin, the seconds on stdout."""
    warnings.simplefilter("ignore")
    found = measures(name)
    for measure in found.values():
        measure(20)
    print("ready", flush=True)
    for line in sys.stdin:
        way, steps = json.loads(line)
        gc.collect()
        print(found[way](steps), flush=True)


class Worker:
    """A process that measures a checkout."""

    def __init__(self, checkout: Path, name: str):
        environment = {**os.environ, "PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, __file__, "--serve", name]
        self._process = subprocess.Popen(
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._read()

    def _read(self) -> str:
        assert self._process.stdout
        return self._process.stdout.readline().strip()

    def seconds(self, way: str, steps: int) -> float:
        assert self._process.stdin
        print(json.dumps([way, steps]), file=self._process.stdin, flush=True)
        return float(self._read())

    def end(self) -> None:
        self._process.communicate()


def rows(name: str, checkouts: list[Path], steps: int, repeats: int) -> list[list[object]]:
    """One for each way: us a step by checkout, the ratio, and simulated seconds per wall second."""
    workers = [Worker(checkout, name) for checkout in checkouts]
    made: list[list[object]] = []
    for way in WAYS:
        found = np.array(
            [[worker.seconds(way, steps) for worker in workers] for _ in range(repeats)]
        )  # (repeats, checkouts)
        each = [f"{1e6 * np.median(column) / steps:.1f}" for column in found.T]
        ratio = [f"{np.median(found[:, 0] / found[:, -1]):.2f}"] if len(workers) > 1 else []
        made.append([name, way, *each, *ratio, f"{steps * DT / np.median(found[:, -1]):.1f}"])
    for worker in workers:
        worker.end()
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", type=int, default=2000, help="of 1 ms, a measurement (default: 2000)")
    parser.add_argument("--repeats", type=int, default=7, help="measurements, of which the median counts")
    parser.add_argument("--robots", nargs="+", default=["two_link", "ur5", "panda"])
    parser.add_argument("--before", type=Path, help="a checkout to compare with, run in the same session")
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        serve(options.serve)
        return
    here = Path(__file__).resolve().parents[1]
    checkouts = [options.before.resolve(), here] if options.before else [here]
    found = [row for name in options.robots for row in rows(name, checkouts, options.steps, options.repeats)]
    columns = ["before [us]", "now [us]", "before / now"] if options.before else ["[us] a step"]
    head = ["robot", "what", *columns, "simulated s per s"]
    notes = (
        "At steps of 1 ms with PinocchioPlant, which takes two Runge-Kutta substeps a step. A rollout is "
        "`ea.simulate` with its record."
    )
    write("rollout", "Simulated seconds per wall second", head, found, notes)


if __name__ == "__main__":
    main()
