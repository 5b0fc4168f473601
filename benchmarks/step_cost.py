"""What one controller step costs, block by block, beside the floor: the calls that it cannot do without.

The floor is the bare Pinocchio and LAPACK calls of the step in a row, with their arguments prepared: three
torque regressors (two along the path since the last sample, one for the feed-forward), the mass matrix, one
inverse dynamics, the row update of the triangle (dtpqrt) and four triangular solves (dtrtrs). Step and floor
take turns in one process; a ratio is the median of the ratios of neighbours. The step follows a `Reference`
that moves, with the whole theta. A closed loop of 20,000 steps gives the share of steps above 1 ms.
``--before PATH`` times the set-point step of a checkout of an earlier release in the same run.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dtpqrt, dtrtrs
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.control.learning import contact_after, disturbance_after, joint_inertia, motion_of
from eladapt.control.stepping import Sample
from eladapt.robot import library

DT = 1e-3
STATES = 100  # along a motion, at which everything is timed
BEFORE = """
import json, sys, time, numpy as np, eladapt as ea
robot = ea.Robot.load(sys.argv[1]); found = {}
for compiled in (False, True):
    controller = ea.CompositeController.for_robot(robot, compiled=compiled)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home)); m = plant.reset()
    state, goal, times = controller.init(m), robot.configuration(robot.target), []
    for _ in range(2500):
        began = time.perf_counter(); state, tau = controller.step(state, m, goal, 1e-3)
        times.append(time.perf_counter() - began); m = plant.step(tau, 1e-3)
    found[str(compiled)] = 1e6 * float(np.median(times[500:]))
print(json.dumps(found))
"""


class Situation(NamedTuple):
    """A step about to be made."""

    state: ea.ControllerState
    measurement: ea.Measurement
    goal: ea.Reference


class Cost(NamedTuple):
    """Medians over the situations."""

    blocks: dict[str, float]  # [us]
    floor: float  # [us]
    ratio: float


def swing(robot: ea.Robot, t: float) -> ea.Reference:
    """All joints about home, at 0.3 Hz."""
    w, one = 2 * np.pi * 0.3, np.ones(robot.nv)
    q = robot.configuration(robot.home + 0.25 * (1 - np.cos(w * t)))
    return ea.Reference(q, 0.25 * w * np.sin(w * t) * one, 0.25 * w * w * np.cos(w * t) * one)


def situations(controller: ea.CompositeController) -> list[Situation]:
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement = plant.reset()
    state, kept = controller.init(measurement), []
    for k in range(20 * STATES):
        goal = swing(robot, measurement.t)
        if k % 20 == 19:
            kept.append(Situation(state, measurement, goal))
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
    return kept


def blocks(controller: ea.CompositeController, now: Situation) -> dict[str, Callable[[], Any]]:
    """The parts of a step, each with its inputs at hand."""
    robot, reg, law = controller.robot, controller.regressors, controller.law
    state, measurement, goal = now
    q, v = measurement.q, measurement.v
    e1, e2, mass = robot.difference(goal.q, q), v - goal.v, robot.mass_matrix(q)
    regressor = reg.slotine_li(q, v, goal.v, goal.a)
    _, regression = controller.regression.step(state.filters, measurement, DT)
    information = controller.extension.step(state.information, regression, DT)
    theta, j = state.parameters, reg.n_potential
    motion = reg.torque(q, v, (v - state.measurement.v) / DT)
    sample = Sample(measurement, regressor, e1, e2, None)
    return {
        "checks": lambda: (robot.check_measurement(measurement), robot.check_goal(goal)),
        "feed-forward": lambda: reg.slotine_li(q, v, goal.v, goal.a, check=False) @ theta,
        "regression": lambda: controller.regression.step(state.filters, measurement, DT),
        "extension": lambda: controller.extension.step(state.information, regression, DT),
        "law": lambda: controller.mixing.follow(
            law, information, law.descend(theta, regressor, e1, e2, DT), j, DT
        ),
        "motion": lambda: motion_of(controller, state, sample, DT),
        "contact": lambda: contact_after(controller, state, sample, motion, DT),
        "disturbance": lambda: disturbance_after(controller, state, sample, motion, DT),
        "inertia": lambda: (
            robot.mass_matrix(q, check=False),
            joint_inertia(controller, state),
        ),
        "control law": lambda: controller.control.torque(e1, e2, mass, DT),
        "whole step": lambda: controller.step(state, measurement, goal, DT),
    }


def floor(controller: ea.CompositeController, now: Situation) -> Callable[[], None]:
    """The bare calls, in a row."""
    robot, size = controller.robot, len(controller.regressors)
    model, data = robot.model, robot.model.createData()
    _, q, v, _ = now.measurement
    a = now.goal.a
    triangle = np.asfortranarray(np.triu(now.state.information.triangle) + np.eye(size + 1))
    rows = np.asfortranarray(np.ones((robot.nv, size + 1)))
    upper, right = np.asfortranarray(triangle[:size, :size]), np.ones(size)

    def calls() -> None:
        for _ in range(3):
            pin.computeJointTorqueRegressor(model, data, q, v, a)
        pin.crba(model, data, q)
        pin.rnea(model, data, q, v, a)
        dtpqrt(0, 8, triangle, rows)
        for trans in (0, 0, 1, 0):
            dtrtrs(upper, right, trans=trans)

    return calls


def timed(call: Callable[[], Any]) -> float:
    began = time.perf_counter()
    call()
    return 1e6 * (time.perf_counter() - began)


def cost(robot: ea.Robot, repeats: int) -> Cost:
    controller = ea.CompositeController.for_robot(robot, DT)
    parts: dict[str, list[float]] = {}
    floors, ratios = [], []
    for now in situations(controller):
        calls, bare = blocks(controller, now), floor(controller, now)
        for _ in range(repeats):
            pair = [timed(bare), timed(calls["whole step"])]
            floors.append(pair[0])
            ratios.append(pair[1] / pair[0])
            for name, call in calls.items():
                parts.setdefault(name, []).append(timed(call))
    medians = {name: float(np.median(times)) for name, times in parts.items()}
    return Cost(medians, float(np.median(floors)), float(np.median(ratios)))


def late_steps(robot: ea.Robot, steps: int) -> tuple[int, float]:
    """How many steps of a closed loop took more than 1 ms, and the longest [ms]."""
    controller = ea.CompositeController.for_robot(robot, DT)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement = plant.reset()
    state, late, longest = controller.init(measurement), 0, 0.0
    gc.collect()
    for k in range(steps):
        goal = swing(robot, measurement.t)
        began = time.perf_counter()
        state, tau = controller.step(state, measurement, goal, DT)
        took = time.perf_counter() - began
        if k > 100:
            late, longest = late + (took > 1e-3), max(longest, took)
        measurement = plant.step(tau, DT)
    return late, 1e3 * longest


def earlier(checkout: Path, name: str) -> dict[str, float]:
    """[us] the median step of another checkout's controller, numpy and compiled."""
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    done = subprocess.run(
        [sys.executable, "-c", BEFORE, name],
        env=environment,
        cwd=checkout,
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(done.stdout.splitlines()[-1])
    return {"numpy": found["False"], "compiled": found["True"]}


def talos_both_arms() -> ea.Robot:
    """Both arms of TALOS, 14 joints, all else locked."""
    root = library.example_robot_data()
    return ea.Robot.from_urdf(
        root / "talos_data/robots/talos_reduced.urdf", [root, root.parent.parent],
        ["leg*", "torso*", "head*", "gripper*"], name="talos, both arms",
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repeats", type=int, default=20, help="of every state (default: 20)")
    parser.add_argument("--steps", type=int, default=20000, help="of the closed loop (default: 20000)")
    parser.add_argument("--before", type=Path, help="a checkout to compare with, run in the same session")
    options = parser.parse_args()
    robots = [ea.Robot.load(name) for name in ("two_link", "ur5", "panda")] + [talos_both_arms()]
    rows: list[list[object]] = []
    names: list[str] = []
    for robot in tqdm(robots, unit="robot"):
        found = cost(robot, options.repeats)
        late, longest = late_steps(robot, options.steps)
        names = list(found.blocks)
        row: list[object] = [robot.name, robot.nv, len(ea.CompositeController.for_robot(robot).regressors)]
        row += [f"{us:.1f}" for us in found.blocks.values()]
        row += [f"{found.floor:.1f}", f"{found.ratio:.2f}", f"{late} of {options.steps}", f"{longest:.1f}"]
        if options.before:
            was = earlier(options.before, robot.name) if robot.name in ea.robots() else {}
            row += [f"{was[way]:.0f}" if way in was else "-" for way in ("numpy", "compiled")]
        rows.append(row)
    head = ["robot", "joints", "l", *(f"{name} [us]" for name in names)]
    head += ["floor [us]", "step / floor", "steps above 1 ms", "longest [ms]"]
    if options.before:
        head += ["0.1.0, numpy [us]", "0.1.0, compiled [us]"]
    notes = (
        "Medians over 100 states of a swing of all joints, which the controller follows with the whole "
        "theta. Asked: step / floor at most 2.5 on two_link, 1.8 on panda, 1.6 on 14 joints; at most 1 step "
        "in 1,000 above 1 ms. "
        "Version 0.1.0 learned gravity alone, at a set-point; it was timed in the same run."
    )
    write("step_cost", "What a controller step costs", head, rows, notes)


if __name__ == "__main__":
    main()
