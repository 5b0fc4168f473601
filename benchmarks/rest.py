"""Long rest in noise, then one joint swaying for as long: does the arm still know itself?

A panda with 2 kg at its tool, of which nobody told, learns them in moves. Then it rests for an hour (--hour),
and one joint sways for another; the measurements carry 1e-4 rad and 1e-3 rad/s of noise, told or untold.
Every minute the gravity that theta tells is compared with the arm's over 50 random postures. The same move
before, between and after shows whether the torque jumps, and a load that comes afterwards is weighed by
moves.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.robot.protocols import Goal

DT = 1e-3
NOISE = ea.Noise(1e-4, 1e-3)
FIRST, COM = 2.0, (0.0, 0.0, 0.05)  # [kg] from the start, [m] in the tool frame
SECOND = 1.0  # [kg] that come after the hours
POSTURES, MINUTE = 50, 60.0
MOVE, MOVES = 4.0, 8  # [s], and how many of them teach the arm
JOINT, SWAY, FREQUENCY = 3, 0.25, 0.3  # which joint sways, [rad], [Hz]


class Stretch(NamedTuple):
    """Some time of a run."""

    told: bool
    what: str
    gravity: float  # largest error over the postures at the worst minute, of the largest torque
    error: float  # [rad] largest of the last second
    jump: float  # [N m] largest |torque - gravity| of the first half second
    weighed: str = ""


class Arm:
    """A plant under its controller."""

    def __init__(self, told: bool, comes: float, seed: int = 0):
        known: dict[str, Any] = {}
        if told:
            known = {"position_noise": NOISE.position, "velocity_noise": NOISE.velocity}
        self.told, self.robot = told, ea.Robot.load("panda")
        self.controller = ea.CompositeController.for_robot(self.robot, DT, **known)
        rng = np.random.default_rng(seed)
        known_places = [self.robot.configuration(x) for x in (self.robot.home, self.robot.target)]
        self.places = [*known_places, *(self.robot.random_configuration(rng) for _ in range(MOVES - 1))]
        self.loaded = dataclasses.replace(self.robot, model=ea.Payload(FIRST, COM).loaded(self.robot))
        second = ea.Payload(SECOND, COM, attach=comes)
        self.plant = ea.PinocchioPlant(
            self.loaded, self.places[0], payload=second, noise=NOISE, seed=seed, substeps=1
        )
        self.measurement = self.plant.reset()
        self.state = self.controller.init(self.measurement)
        self.postures = [self.robot.random_configuration(rng) for _ in range(POSTURES)]

    def follow(self, what: str, goal: Callable[[float], Goal], duration: float) -> Stretch:
        """Follow a goal, a function of the time from now [s]."""
        began, steps = self.measurement.t, round(duration / DT)
        wrong, jump, last = 0.0, 0.0, 0.0
        for k in tqdm(range(steps), desc=f"{'told' if self.told else 'untold'}: {what}", leave=False):
            wanted = goal(self.measurement.t - began)
            self.state, tau = self.controller.step(self.state, self.measurement, wanted, DT)
            self.measurement = self.plant.step(tau, DT)
            if k < 0.5 / DT:
                jump = max(jump, float(np.abs(tau - self.loaded.gravity(self.plant.q)).max()))
            if k % round(MINUTE / DT) == 0:
                wrong = max(wrong, self.gravity_error())
            if k >= steps - 1 / DT:
                reference = self.robot.check_goal(wanted)
                last = max(last, float(np.abs(self.robot.difference(reference.q, self.plant.q)).max()))
        return Stretch(self.told, what, max(wrong, self.gravity_error()), last, jump)

    def gravity_error(self) -> float:
        """Largest error of theta's gravity over the postures, of the largest torque."""
        true = np.array([self.loaded.gravity(q) for q in self.postures])
        learned = np.array([self.controller.regressors.gravity(q) @ self.state.theta for q in self.postures])
        return float(np.abs(learned - true).max() / np.abs(true).max())

    def sway(self, t: float) -> ea.Reference:
        """One joint about the first place, the others at rest; begins smoothly within a second."""
        w, u = 2 * np.pi * FREQUENCY, min(t, 1.0)
        b, b1, b2 = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)
        s, s1, s2 = np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)
        one = SWAY * np.eye(self.robot.nv)[JOINT]
        q = self.robot.integrate(self.places[0], b * s * one)
        return ea.Reference(q, (b1 * s + b * s1) * one, (b2 * s + 2 * b1 * s1 + b * s2) * one)


def run(job: tuple[bool, float]) -> list[Stretch]:
    """Learn, move, rest, move, sway, move, and be loaded."""
    told, hour = job
    arm = Arm(told, comes=MOVE * (MOVES + 2) + 2 * (hour + 2 * MOVE))
    home, there, *_ = arm.places
    for k in range(MOVES):
        arm.follow("learning", lambda t, k=k: arm.places[(k + 1) % len(arm.places)], MOVE)  # type: ignore[misc]
    found = [arm.follow("a move, after learning", lambda t: there, MOVE)]
    arm.follow("back", lambda t: home, MOVE)
    for what, goal in (("rest", lambda t: home), ("sway", arm.sway)):
        found.append(arm.follow(what, goal, hour))
        found.append(arm.follow(f"the same move, after {what}", lambda t: there, MOVE))
        arm.follow("back", lambda t: home, MOVE)
    arm.follow("loaded", lambda t: home, 1.0)
    for k in range(2):
        last = arm.follow("loaded", lambda t, k=k: arm.places[k + 1], MOVE)  # type: ignore[misc]
    estimate = ea.payload(arm.controller, arm.state)
    weighed = f"{estimate.mass:.4f} +- {estimate.mass_std:.0e} kg"
    return [*found, last._replace(what="moves with a load that came", gravity=np.nan, weighed=weighed)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--hour", type=float, default=3600.0, help="[s] (default: 3600)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--output", default="rest", help="table in benchmarks/results, or a path without .md")
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs) as pool:
        found = [s for run_ in pool.map(run, [(True, options.hour), (False, options.hour)]) for s in run_]
    head = [
        "noise", "what", "gravity error of its largest", "error of the last second [rad]",
        "torque beside gravity, first half second [N m]", f"load of {SECOND:g} kg",
    ]  # fmt: skip
    rows = [
        ["told" if s.told else "untold", s.what, "-" if np.isnan(s.gravity) else f"{s.gravity:.1e}",
         f"{s.error:.0e}", f"{s.jump:.2f}", s.weighed or "-"]
        for s in found
    ]  # fmt: skip
    notes = (
        f"Panda at 1 kHz with {FIRST:g} kg at {COM} m of its tool frame from the start, noise of "
        f"{NOISE.position:g} rad and {NOISE.velocity:g} rad/s. Hours of {options.hour:g} s; moves of "
        f"{MOVE:g} s; {SWAY:g} rad at {FREQUENCY:g} Hz of joint {JOINT + 1}. Gravity over {POSTURES} random "
        "postures, once a minute and at the end; errors of the true state."
    )
    write(options.output, "Long rest in noise, and one joint swaying as long", head, rows, notes)


if __name__ == "__main__":
    main()
