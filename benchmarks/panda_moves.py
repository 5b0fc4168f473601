"""A Panda with dry friction as published for it, moved within its limits.

2 kg at the tool that nobody told, noise and a late bus that are told; jerk-limited moves from the URDF's
theta, behind the gate at the maker's 1000 N m/s.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from any_arm import reachable
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.simulation.instruments import Delay

DT, LATE = 1e-3, 1e-3  # [s]
COULOMB = np.array([0.55, 0.87, 0.64, 1.28, 0.84, 0.30, 0.57])  # [N m]
NOISE = ea.Noise(1e-5, 1e-3)
TOLD: dict[str, Any] = {"position_noise": 1e-5, "velocity_noise": 1e-3, "delay": LATE}
LOAD = 2.0  # [kg]
RATE = 1000.0  # [N m/s]
BEGUN, AFTER = 0.2, 2.0  # [s] in which joints break loose; after the move


class Run(NamedTuple):
    """What a move gave."""

    duration: float  # [s]
    moving: float  # [rad] largest error during the move
    begun: float  # [rad] the same without its first `BEGUN`
    after: float  # [rad] `AFTER` later
    rate: float  # [N m/s] largest
    fault: str


def run(seed: int | None) -> Run:
    """From home to the target, or between two random postures."""
    robot, rng = ea.Robot.load("panda"), np.random.default_rng(seed)
    places = [robot.configuration(x) for x in (robot.home, robot.target)]
    start, goal = places if seed is None else (reachable(robot, rng), reachable(robot, rng))
    inner = ea.CompositeController.for_robot(robot, DT, **TOLD)
    controller = ea.Shaped(ea.GatedController.for_robot(inner, DT, torque_rate=RATE))
    friction, load = ea.Friction(coulomb=COULOMB), ea.Payload(LOAD)
    arm = ea.PinocchioPlant(robot, start, friction=friction, noise=NOISE, payload=load, seed=1)
    motion = ea.move(robot, start, goal)
    record = ea.simulate(
        controller, Delay(arm, LATE), motion, motion.duration + AFTER + 0.5, DT, progress=False
    )
    error, moving = np.abs(record.error).max(axis=1), record.t <= motion.duration
    return Run(
        motion.duration, float(error[moving].max()), float(error[moving & (record.t > BEGUN)].max()),
        float(error[record.t >= motion.duration + AFTER].max()),
        float(np.abs(np.diff(record.tau, axis=0)).max() / DT), record.metrics().faults_said,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--moves", type=int, default=6, help="random ones beside the library's (default: 6)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--output", default="panda_moves", help="table in benchmarks/results, or a path without .md"
    )
    options = parser.parse_args()
    seeds = [None, *range(options.moves)]
    with ProcessPoolExecutor(options.jobs) as pool:
        runs = list(tqdm(pool.map(run, seeds), total=len(seeds), unit="move"))
    head = [
        "move", "planned [s]", "largest error, moving [rad]", f"the same after {BEGUN:g} s",
        f"{AFTER:g} s later [rad]", "torque rate [N m/s]", "fault",
    ]  # fmt: skip
    rows = [
        ["home to target" if seed is None else f"random, {seed}", f"{r.duration:.2f}", f"{r.moving:.1e}",
         f"{r.begun:.1e}", f"{r.after:.1e}", f"{r.rate:.0f}", r.fault]
        for seed, r in zip(seeds, runs, strict=True)
    ]  # fmt: skip
    notes = (
        f"{LOAD:g} kg that nobody told; noise of {NOISE.position:g} rad and {NOISE.velocity:g} rad/s and "
        f"{1e3 * LATE:g} ms of delay, told. Asked: 1e-2 rad during the move, 2e-4 rad later, at most "
        f"{RATE:g} N m/s, no fault."
    )
    write(
        options.output, "A Panda with its friction and an unknown load, within its limits", head, rows, notes
    )


if __name__ == "__main__":
    main()
