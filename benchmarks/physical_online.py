"""Parameters that stay physical while they are learned: what it is good for, and what it costs.

From home to the robot's goal within its limits and 2 s of rest, 1 kg attached after 1.5 s where the arm can
carry it, from the URDF's theta and from zero; with a `CompositeController` alone, and within `Physical`.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
import table
from tqdm import tqdm

import eladapt as ea
from eladapt.identification.learned import learned
from eladapt.identification.physical import PhysicalBodies

ARMS = ("panda", "ur5", "xarm7", "z1", "kinova", "talos_left_arm")
NOISES = {"none": 0.0, "1e-4 rad, 1e-3 rad/s": 1e-4}
DT, EVERY, POSTURES = 1e-3, 0.1, 5
STRONG = 30.0  # [N m] of its largest effort limit: such an arm carries 1 kg


class Told(NamedTuple):
    """Of one run."""

    physical: float  # share of instants and postures at which M(q) of what it tells is positive definite
    used: float  # the same of what the law uses
    settled: float  # [s]
    steady: float  # [rad]
    elsewhere: float  # [N m] the largest error of gravity in other postures, at the end


def mass_matrix(regressors: ea.Regressors, q: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """M(q) of parameters."""
    still = np.zeros(regressors.robot.nv)
    rest = regressors.torque(q, still, still) @ theta
    return np.array([regressors.torque(q, still, e) @ theta - rest for e in np.eye(len(still))])


def run(name: str, noise: float, theta0: str, physical: bool) -> Told:
    robot = ea.Robot.load(name)
    controller = ea.CompositeController.for_robot(robot, DT, position_noise=noise, velocity_noise=10 * noise)
    used = ea.Physical(controller) if physical else controller
    start, goal = robot.configuration(robot.home), robot.configuration(robot.target)
    carries = np.max(robot.effort_limit[np.isfinite(robot.effort_limit)], initial=0) > STRONG
    plant = ea.PinocchioPlant(
        robot, start, noise=ea.Noise(noise, 10 * noise) if noise else None,
        payload=ea.Payload(1.0, attach=1.5) if carries else None,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    postures = [robot.random_configuration(rng) for _ in range(POSTURES)]
    good: dict[str, list[bool]] = {"told": [], "used": []}

    def look(t: float, _q: np.ndarray, _goal: np.ndarray, state: Any) -> None:
        if round(t / DT) % round(EVERY / DT):
            return
        inner = getattr(state, "inner", state)
        for kind, theta in (
            ("told", getattr(state, "physical", inner.parameters)),
            ("used", inner.parameters),
        ):
            least = [np.linalg.eigvalsh(mass_matrix(controller.regressors, q, theta))[0] for q in postures]
            good[kind].extend(value > 0 for value in least)

    motion = ea.move(robot, start, goal)
    record = ea.simulate(
        used, plant, motion, max(4.0, motion.duration + 2), DT, theta0=theta0, progress=False, observer=look
    )
    wrong = [controller.regressors.gravity(q) @ record.theta_error[-1] for q in postures]
    return Told(
        float(np.mean(good["told"])), float(np.mean(good["used"])), record.settling_time(),
        float(np.abs(record.error[-500:]).max()), float(np.abs(wrong).max()),
    )  # fmt: skip


def costs(name: str) -> list[object]:
    """[us] a step without and with it, between questions; [ms] an answer."""
    robot = ea.Robot.load(name)
    q = robot.configuration(robot.home)
    controller = ea.CompositeController.for_robot(robot, DT)
    rng, took = np.random.default_rng(0), []
    around: list[Any] = [controller, ea.Physical(controller, period=1e6, lag=0.0)]
    for used in around:
        state = used.init(ea.Measurement(0.0, q, np.zeros(robot.nv), robot.gravity(q)))
        times = []
        for k in range(1, 2001):
            v = 0.01 * rng.normal(size=robot.nv)
            sample = ea.Measurement(k * DT, q, v, robot.gravity(q))
            began = time.perf_counter()
            state, _ = used.step(state, sample, q, DT)
            times.append(time.perf_counter() - began)
        took.append(1e6 * float(np.median(times)))
    bodies, inner = PhysicalBodies(controller.regressors), state.inner
    answers = []
    for _ in range(20):
        began = time.perf_counter()
        bodies.nearest(inner.parameters, learned(controller.regressors, inner).triangle)
        answers.append(time.perf_counter() - began)
    return [
        name,
        f"{took[0]:.0f}",
        f"{took[1]:.0f}",
        f"{1e3 * np.median(answers):.0f} ({1e3 * max(answers):.0f})",
    ]


def main() -> None:
    rows = []
    jobs = [(arm, noise, theta0) for arm in ARMS for noise in NOISES for theta0 in ("urdf", "zero")]
    for arm, noise, theta0 in tqdm(jobs, desc="runs", disable=None):
        alone, kept = (run(arm, NOISES[noise], theta0, physical) for physical in (False, True))
        shares = (f"{100 * share:.0f} %" for share in (alone.used, kept.used, kept.physical))
        rows.append([
            arm, noise, theta0, *shares,
            *(f"{before:.3g} / {after:.3g}" for before, after in zip(alone[2:], kept[2:], strict=True)),
        ])  # fmt: skip
    head = [
        "arm", "noise", "from", "M > 0, alone", "M > 0, within Physical", "M > 0 of what it tells",
        "settled [s]", "steady error [rad]", "gravity elsewhere [N m]",
    ]  # fmt: skip
    prices = table.markdown(
        ["arm", "step [us]", "step within Physical [us]", "an answer [ms], median (largest)"],
        [costs(arm) for arm in ARMS],
    )
    notes = f"""
M > 0: share of instants, every {EVERY:g} s, and of {POSTURES} random postures at which M(q) of the learned
theta is positive definite. Then without / within Physical: time until the error stays below 1e-3 rad, the
largest error of the last half second, and the largest error of the learned gravity in those postures at the
end.

{prices}
An answer is asked for every 0.1 s, beside the loop where an executor is given; between, a step costs what the
table says.
"""
    title = "Parameters that stay physical while they are learned"
    table.write("physical_online", title, head, rows, notes)


if __name__ == "__main__":
    main()
