"""Where a Panda's tool comes to rest when it is sent to a pose with a load that nobody told.

`ea.reach` plans to each pose by inverse kinematics; the error is that of the tool's true pose once the arm
rests, on a plant without friction and on one with the Panda's published friction, and noise and a late bus
that are told.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from any_arm import reachable
from panda_moves import COULOMB, DT, LATE, LOAD, NOISE, TOLD
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.robot.reading import frame_index
from eladapt.simulation.instruments import Delay

AFTER, OVER = 2.0, 0.5  # [s] after the move, and over how long the arm counts as resting there


class Arrival(NamedTuple):
    """How far the tool is from its pose."""

    duration: float  # [s] of the move
    position: float  # [m]
    angle: float  # [rad]


def pose(robot: ea.Robot, q: np.ndarray) -> pin.SE3:
    """Of the tool, in the base's frame."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[frame_index(robot.model, robot.tool)].copy()


def run(case: tuple[int, bool]) -> Arrival:
    """To the pose of a random posture, from home."""
    seed, measured = case
    robot = ea.Robot.load("panda")
    home, wanted = robot.configuration(robot.home), pose(robot, reachable(robot, np.random.default_rng(seed)))
    motion = ea.reach(robot, home, wanted)
    trouble: dict[str, Any] = (
        {"friction": ea.Friction(coulomb=COULOMB), "noise": NOISE, "seed": 1} if measured else {}
    )
    arm = ea.PinocchioPlant(robot, home, payload=ea.Payload(LOAD), **trouble)
    plant: ea.PinocchioPlant | Delay = Delay(arm, LATE) if measured else arm
    controller = ea.Shaped(ea.CompositeController.for_robot(robot, DT, **(TOLD if measured else {})))
    record = ea.simulate(controller, plant, motion, motion.duration + AFTER + OVER, DT, progress=False)
    resting = record.t >= motion.duration + AFTER
    between = [wanted.actInv(pose(robot, q)) for q in record.q[resting][::10]]
    return Arrival(
        motion.duration,
        max(float(np.linalg.norm(m.translation)) for m in between),
        max(float(np.linalg.norm(pin.log3(m.rotation))) for m in between),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--poses", type=int, default=10, help="from random postures (default: 10)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--output", default="reach", help="table in benchmarks/results, or a path without .md"
    )
    options = parser.parse_args()
    cases = [(seed, measured) for seed in range(options.poses) for measured in (False, True)]
    with ProcessPoolExecutor(options.jobs) as pool:
        found = dict(zip(cases, tqdm(pool.map(run, cases), total=len(cases), unit="run"), strict=True))
    head = ["pose", "move [s]", "no friction [mm]", "[mrad]", "friction, noise, delay [mm]", "[mrad]"]
    rows = []
    for seed in range(options.poses):
        ideal, real = found[seed, False], found[seed, True]
        errors = (ideal.position, ideal.angle, real.position, real.angle)
        rows.append([str(seed), f"{ideal.duration:.2f}", *(f"{1e3 * error:.1e}" for error in errors)])
    notes = (
        f"Panda, {LOAD:g} kg at the tool that nobody told; worst over {OVER:g} s from {AFTER:g} s after the "
        f"move's end. Measured: Coulomb friction as published, noise of {NOISE.position:g} rad and "
        f"{NOISE.velocity:g} rad/s, {1e3 * LATE:g} ms late; the last two are told. "
        "Asked: 0.1 mm and 0.1 mrad."
    )
    write(options.output, "Where a tool arrives, with a load that nobody told", head, rows, notes)


if __name__ == "__main__":
    main()
