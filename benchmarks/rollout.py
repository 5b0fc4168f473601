"""Simulated seconds per wall second: the plant alone, and the plant with its controller in closed loop."""

from __future__ import annotations

import argparse
import time

import numpy as np
from table import write

import eladapt as ea

DT = 1e-3


def rate(robot: ea.Robot, engine: str, controlled: bool, steps: int) -> float:
    """Simulated seconds per wall second."""
    goal = robot.configuration(robot.target)
    plant = getattr(ea, engine)(robot, robot.configuration(robot.home))
    measurement, tau = plant.reset(), robot.gravity(robot.configuration(robot.home))
    if controlled:
        controller = ea.CompositeController.for_robot(robot, DT)
        state = controller.init(measurement)
        controller.step(controller.step(state, measurement, goal, DT)[0], plant.step(tau, DT), goal, DT)
        measurement = plant.reset()
    start = time.perf_counter()
    for _ in range(steps):
        if controlled:
            state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
    return steps * DT / (time.perf_counter() - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", type=int, default=2000, help="of 1 ms, a measurement (default: 2000)")
    parser.add_argument("--repeats", type=int, default=5, help="measurements, of which the median counts")
    options = parser.parse_args()
    ways = {"plant alone": False, "with controller": True}
    rows: list[list[object]] = []
    for name in ("two_link", "ur5", "panda"):
        robot = ea.Robot.load(name)
        for engine in ("PinocchioPlant", "MujocoPlant"):
            found: dict[str, list[float]] = {way: [] for way in ways}
            for _ in range(options.repeats):
                for way, controlled in ways.items():
                    found[way].append(rate(robot, engine, controlled, options.steps))
            rows.append([name, engine, *(f"{np.median(figures):.1f}" for figures in found.values())])
    head = ["robot", "plant", *ways]
    notes = "At steps of 1 ms; the Pinocchio plant takes two Runge-Kutta substeps a step."
    write("rollout", "Simulated seconds per wall second", head, rows, notes)


if __name__ == "__main__":
    main()
