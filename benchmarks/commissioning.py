"""Commissioning of arms whose hardware is drawn at random: what ten seconds of small motion tell of it.

Delay of 0 to 4 ms, velocities differenced from encoders of 2^19 counts through a filter of 1 to 6 ms, noise
on top, viscous and Coulomb friction. Then a controller that is told what was found moves each joint by 0.3
rad.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import table
from tqdm import tqdm

import eladapt as ea
from eladapt.errors import EladaptError
from eladapt.hardware.commissioning import Heard, Swing, assessed, careful
from eladapt.signals import Measurement
from eladapt.simulation.instruments import Delay, Encoders, NoisyReadings

ARMS, DT, DURATION, REACH = ("panda", "ur5"), 1e-3, 10.0, 0.15
COUNTS, STRONGEST = 2**19, 0.05  # friction as a share of the effort limit, at most
WITHIN = 0.2


class Told(NamedTuple):
    """Of one seed: found / true, nan where it is not known."""

    fault: str
    position_noise: float
    velocity_noise: float
    delay: float  # [s] off
    velocity_lag: float
    coulomb: np.ndarray
    viscous: np.ndarray
    settled: bool


class Bench:
    """A plant behind the four methods, as fast as it goes."""

    def __init__(self, plant: Any, dt: float = DT):
        self.plant, self.dt, self.measurement = plant, dt, plant.reset()

    def start(self) -> None:
        self.measurement = self.plant.reset()

    def read(self) -> Measurement:
        return self.measurement

    def write(self, tau: np.ndarray) -> None:
        self.measurement = self.plant.step(tau, self.dt)

    def stop(self) -> None:
        self.plant.brake()


def moved(robot: ea.Robot, plant: Any, duration: float = DURATION) -> tuple[Heard, Any]:
    """What `commission` hears of a plant, without waiting for the clock, and the fault that ended it."""
    heard, controller = Heard(Bench(plant)), careful(robot, DT)
    motion = Swing(robot, heard, np.full(robot.nv, REACH), duration)
    heard.start()
    state = controller.init(heard.read())
    for _ in range(round(duration / DT)):
        measurement = heard.read()
        state, tau = controller.step(state, measurement, motion(measurement.t), DT)
        heard.write(tau)
        if state.fault is not None:
            break
    return heard, state.fault


def one(seed: int) -> Told:
    rng = np.random.default_rng(seed)
    robot = ea.Robot.load(ARMS[seed % len(ARMS)])
    limit = robot.effort_limit
    coulomb = rng.uniform(0.005, STRONGEST, robot.nv) * limit
    viscous = rng.uniform(0.005, STRONGEST, robot.nv) * limit
    delay, lag, noise = int(rng.integers(0, 5)) * DT, rng.uniform(1e-3, 6e-3), 10 ** rng.uniform(-5, -4)
    start = robot.configuration(robot.home)
    arm = ea.PinocchioPlant(robot, start, friction=ea.Friction(viscous, coulomb))
    plant = NoisyReadings(Delay(Encoders(arm, COUNTS, lag), delay), ea.Noise(noise, 10 * noise), seed)
    heard, fault = moved(robot, plant)
    if fault is not None:
        nothing = np.full(robot.nv, np.nan)
        return Told(str(fault), np.nan, np.nan, np.nan, np.nan, nothing, nothing, False)
    found = assessed(robot, heard, DT)
    known, friction = found.friction.known, found.friction
    noises = [float(np.median(each)) for each in (found.position_noise, found.velocity_noise)]
    return Told(
        "", noises[0] / noise, noises[1] / (10 * noise), found.delay - delay, found.velocity_lag / lag,
        np.where(known[1], friction.coulomb / coulomb, np.nan),
        np.where(known[0], friction.viscous / viscous, np.nan), settles(robot, found, plant),
    )  # fmt: skip


def settles(robot: ea.Robot, found: ea.Commissioning, plant: Any) -> bool:
    """Whether a controller that knows what was found takes each joint 0.3 rad away, to 1e-3 rad in 4 s."""
    start, goal = robot.configuration(robot.home), robot.configuration(robot.home + 0.3)
    try:
        controller = ea.CompositeController.for_robot(robot, DT, **found.hardware)
        record = ea.simulate(controller, plant, ea.move(robot, start, goal), 4.0, DT, progress=False)
    except EladaptError:
        return False
    return bool(np.abs(record.error[-500:]).max() < 1e-3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs) as pool:
        told = list(tqdm(pool.map(one, range(options.seeds)), total=options.seeds, disable=None))
    through = [each for each in told if not each.fault]
    rows = [["went through with it", f"{len(through)} of {len(told)}", ""]]
    for name in ("position_noise", "velocity_noise", "velocity_lag", "coulomb", "viscous"):
        ratios = np.concatenate([np.atleast_1d(getattr(each, name)) for each in through])
        known = np.isfinite(ratios)
        right = np.abs(ratios[known] - 1) < WITHIN
        rows.append([f"{name}, known", f"{100 * np.mean(known):.0f} %", f"{100 * np.mean(right):.1f} %"])
    late = np.array([each.delay for each in through])
    rows.append(
        [
            "delay, known",
            f"{100 * np.mean(np.isfinite(late)):.0f} %",
            f"{100 * np.mean(np.abs(late) < 1e-9):.1f} %",
        ]
    )
    rows.append(
        ["settled with what was found", f"{sum(each.settled for each in through)} of {len(through)}", ""]
    )
    notes = str(__doc__).split("\n\n", 1)[1] + "\n" + "\n".join(each.fault for each in told if each.fault)
    table.write(
        "commissioning",
        f"Commissioning, {options.seeds} arms",
        ["", "share", "of these within 20 %"],
        rows,
        notes,
    )


if __name__ == "__main__":
    main()
