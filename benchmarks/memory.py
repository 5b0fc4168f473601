"""Memory of the process over many controller steps: a loop that runs for weeks must not grow.

The Panda's whole step, with noise so that nothing ever settles, a set-point that changes every second and a
load that comes and goes, on the Pinocchio plant. Prints the resident set at intervals, and its growth over
the second half: a leak of one array of seven numbers a step would make 80 MB there in a million steps.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import psutil
from table import write
from tqdm import tqdm

import eladapt as ea

DT = 1e-3
INTERVALS = 10
ALLOWED = 1.0  # [MB] over the second half: what allocators give and take
HEAD = ["steps", "resident [MB]", "steps/s"]
CHANGE, LOADED = 1000, 5000  # steps between set-points, and between attaching and releasing the load


class Sample(NamedTuple):
    """One look at the process."""

    steps: int
    resident: float  # [MB]
    rate: float  # [steps/s]


def loop(robot: ea.Robot, steps: int, every: int) -> Iterator[int]:
    """Step the closed loop, and yield the number of steps done after every interval."""
    controller = ea.CompositeController.for_robot(robot, DT, velocity_noise=1e-3)
    noise = ea.Noise(1e-5, 1e-3)
    start = robot.configuration(robot.home)
    plants = [ea.PinocchioPlant(robot, start, noise=noise, payload=load) for load in (None, 1.0)]
    goals = [robot.configuration(robot.target), start]
    plant = plants[0]
    measurement = plant.reset()
    state = controller.init(measurement)
    for k in range(1, steps + 1):
        state, tau = controller.step(state, measurement, goals[k // CHANGE % 2], DT)
        measurement = plant.step(tau, DT)
        if k % LOADED == 0:
            before, plant = plant, plants[k // LOADED % 2]
            plant.t, plant.q, plant.v = before.t, before.q, before.v
        if k % every == 0:
            yield k


def measure(steps: int) -> list[Sample]:
    robot, process = ea.Robot.load("panda"), psutil.Process()
    every, samples = max(1, steps // INTERVALS), []
    before = time.perf_counter()
    for done in tqdm(loop(robot, steps, every), total=INTERVALS, unit="interval"):
        now = time.perf_counter()
        samples.append(Sample(done, process.memory_info().rss / 1e6, every / (now - before)))
        before = now
    return samples


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", type=int, default=1_000_000, help="(default: 1,000,000)")
    options = parser.parse_args()
    samples = measure(options.steps)
    half = samples[len(samples) // 2 :]
    growth = half[-1].resident - half[0].resident
    slope = np.polyfit([s.steps for s in half], [s.resident for s in half], 1)[0]
    rows = [[f"{s.steps:,}", f"{s.resident:.2f}", f"{s.rate:.0f}"] for s in samples]
    verdict = "no growth" if growth <= ALLOWED else "GROWTH"
    change = f"{growth:+.2f} MB over the second half (at most {ALLOWED:g}), {1e6 * slope:+.2f} bytes a step"
    write("memory", "Memory over many controller steps", HEAD, rows, f"{verdict}: {change}.")


if __name__ == "__main__":
    main()
