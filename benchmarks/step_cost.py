"""What one controller step costs, block by block, beside the floor: the calls that it cannot do without.

The floor is the bare Pinocchio, BLAS and LAPACK calls of the step in a row, with their arguments prepared:
three torque regressors (two along the path since the last sample, one for gravity) and their products with
the base, the mass matrix, inverse dynamics and a Cholesky solve for the disturbance estimate, differences
of configurations, the row update of the triangle, two triangular solves, the singular vectors of gravity's
block, and one linear solve for each evaluation of the control law's convex problem. Step and floor take
turns in one process; a ratio is the median of the ratios of neighbours. A closed loop of 20,000 steps gives
the share of steps above 1 ms.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dgesdd, dgesv, dposv, dtpqrt, dtrtrs
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.control.finite_time import semi_implicit_solution
from eladapt.estimation.excitation import GateMonitor
from eladapt.robot import library

DT = 1e-3
STATES = 100  # along a regulation move, at which everything is timed


class Situation(NamedTuple):
    """A step about to be made."""

    state: ea.ControllerState
    measurement: ea.Measurement


def situations(controller: ea.CompositeController, goal: np.ndarray) -> list[Situation]:
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement = plant.reset()
    state, kept = controller.init(measurement), []
    for k in range(20 * STATES):
        if k % 20 == 19:
            kept.append(Situation(state, measurement))
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
    return kept


def blocks(
    controller: ea.CompositeController, goal: np.ndarray, now: Situation
) -> dict[str, Callable[[], Any]]:
    """The parts of a step, each with its inputs at hand."""
    robot, reg = controller.robot, controller.regressors
    state, measurement = now
    q, v = measurement.q, measurement.v
    e1, psi, mass = robot.difference(goal, q), reg.gravity(q), robot.mass_matrix(q)
    _, regression = controller.regression.step(state.filters, measurement, DT)
    information = controller.extension.step(state.information, regression, DT)
    mixed = controller.mixing.mix(information, reg.n_potential)
    monitor = GateMonitor(controller.law.b, controller.law.d)
    gates = monitor.step(state.excitation, mixed, DT).gates
    return {
        "checks": lambda: (robot.check_measurement(measurement), robot.check_q(goal)),
        "gravity regressor": lambda: reg.gravity(q, check=False),
        "regression": lambda: controller.regression.step(state.filters, measurement, DT),
        "extension": lambda: controller.extension.step(state.information, regression, DT),
        "mixing": lambda: controller._mix(information, state.mixed),
        "gates and law": lambda: (
            monitor.step(state.excitation, mixed, DT),
            controller.law.step(state.theta, psi, e1, v, mixed, DT, gates),
        ),
        "mass matrix": lambda: robot.mass_matrix(q),
        "control law": lambda: controller.control.torque(e1, v, mass, DT),
        "whole step": lambda: controller.step(state, measurement, goal, DT),
    }


def floor(controller: ea.CompositeController, goal: np.ndarray, now: Situation) -> Callable[[], Any]:
    """The bare calls of one step."""
    robot, reg = controller.robot, controller.regressors
    model, data, (state, (_, q, v, _)) = robot.model, robot.model.createData(), now
    kinetic, gravity = reg._kinetic_map, reg._gravity_map
    change, still = v / DT, np.zeros(robot.nv)
    size, nv = len(reg) + 1, robot.nv
    triangle = np.asfortranarray(state.information.triangle + 1e-3 * np.eye(size))
    factor, bottom = (
        np.asfortranarray(triangle[:-1, :-1]),
        np.asfortranarray(triangle[reg.n_inertial : -1, reg.n_inertial : -1]),
    )
    rows, vector = np.asfortranarray(np.ones((nv, size))), np.ones(size - 1)
    e1, mass = robot.difference(goal, q), robot.mass_matrix(q)
    assert isinstance(controller.control, ea.FiniteTimePD)
    solves = semi_implicit_solution(controller.control, e1, v, mass, DT).evaluations
    before = state.measurement.q

    def calls() -> None:
        pin.difference(model, goal, q)
        pin.difference(model, before, q)
        for _ in range(2):
            pin.integrate(model, before, still)
            pin.computeJointTorqueRegressor(model, data, q, v, change) @ kinetic
        pin.computeJointTorqueRegressor(model, data, q, still, still) @ gravity
        pin.crba(model, data, q)
        pin.rnea(model, data, q, v, change)
        dposv(mass, e1)
        dtpqrt(0, min(8, size), triangle, rows)
        dtrtrs(factor, vector, trans=1)
        dtrtrs(factor, vector)
        if len(bottom):
            dgesdd(bottom)
        for _ in range(solves):
            dgesv(mass, e1)

    return calls


def clocked(call: Callable[[], Any], repeats: int) -> float:
    """[us] a call, over a few in a row."""
    start = time.perf_counter()
    for _ in range(repeats):
        call()
    return (time.perf_counter() - start) / repeats * 1e6


class Cost(NamedTuple):
    """Medians [us]."""

    blocks: dict[str, float]
    floor: float
    ratio: float


def cost(robot: ea.Robot, compiled: bool, repeats: int) -> Cost:
    goal = robot.configuration(robot.target)
    controller = ea.CompositeController.for_robot(robot, DT, compiled=compiled)
    times: dict[str, list[float]] = {}
    floors, ratios = [], []
    gc.disable()
    for now in tqdm(situations(controller, goal), desc=robot.name, leave=False):
        bare, parts = floor(controller, goal, now), blocks(controller, goal, now)
        for call in (bare, *parts.values()):
            call()
        for name, call in parts.items():
            times.setdefault(name, []).append(clocked(call, repeats))
        pairs = [(clocked(parts["whole step"], repeats), clocked(bare, repeats)) for _ in range(3)]
        floors += [b for _, b in pairs]
        ratios += [a / b for a, b in pairs]
    gc.enable()
    return Cost(
        {name: float(np.median(t)) for name, t in times.items()},
        float(np.median(floors)),
        float(np.median(ratios)),
    )


def late_steps(robot: ea.Robot, compiled: bool, steps: int) -> tuple[int, float]:
    """How many of ``steps`` in closed loop took more than 1 ms, and the longest [ms]."""
    controller = ea.CompositeController.for_robot(robot, DT, compiled=compiled)
    goals = [robot.configuration(robot.target), robot.configuration(robot.home)]
    plant = ea.PinocchioPlant(robot, goals[1])
    measurement = plant.reset()
    state = controller.init(measurement)
    times = np.empty(steps)
    for k in tqdm(range(steps), desc=f"{robot.name}, closed loop", leave=False):
        goal = goals[k // 2500 % 2]
        start = time.perf_counter()
        state, tau = controller.step(state, measurement, goal, DT)
        times[k] = time.perf_counter() - start
        measurement = plant.step(tau, DT)
    return int(np.sum(times[1:] > 1e-3)), float(times[1:].max() * 1e3)


def both_arms() -> ea.Robot:
    """Both arms of TALOS, 14 joints, all else locked."""
    root = library.example_robot_data()
    move = [0.4, 0.3, -0.5, -1.0, 0.2, 0.1, 0.1, 0.4, -0.3, 0.5, -1.0, -0.2, 0.1, -0.1]
    return ea.Robot.from_urdf(
        root / "talos_data/robots/talos_reduced.urdf", [root, root.parent.parent],
        ["leg*", "torso*", "head*", "gripper*"], name="talos, both arms", target=move,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", type=int, default=20_000, help="of the closed loop (default: 20000)")
    parser.add_argument("--repeats", type=int, default=10, help="calls in a row that are timed together")
    options = parser.parse_args()
    robots = [*map(ea.Robot.load, ("two_link", "ur5", "panda")), both_arms()]
    head: list[str] = []
    rows: list[list[object]] = []
    whole: dict[bool, list[float]] = {False: [], True: []}
    for robot in robots:
        for compiled in (False, True):
            found = cost(robot, compiled, options.repeats)
            late, longest = late_steps(robot, compiled, options.steps)
            whole[compiled].append(found.blocks["whole step"])
            head = [
                "robot",
                "joints",
                "path",
                *(f"{name} [us]" for name in found.blocks),
                "floor [us]",
                "step / floor",
                "steps above 1 ms",
                "longest [ms]",
            ]
            costs = [f"{value:.1f}" for value in (*found.blocks.values(), found.floor)]
            path = "compiled" if compiled else "numpy"
            share = f"{late} of {options.steps}"
            rows.append([robot.name, robot.nv, path, *costs, f"{found.ratio:.2f}", share, f"{longest:.1f}"])
    joints = np.array([robot.nv for robot in robots])[[0, 2, 3]]
    exponents = {
        path: np.polyfit(np.log(joints), np.log(np.array(whole[path])[[0, 2, 3]]), 1)[0] for path in whole
    }
    notes = (
        "numpy: the default. compiled: `for_robot(robot, compiled=True)`, extra `fast`; its blocks are timed "
        "one by one, while the whole step runs them in line, in two calls. Medians over "
        f"{STATES} states of a regulation move. From 2 to 7 to 14 joints the whole step grows as joints^"
        f"{exponents[False]:.2f} with numpy and joints^{exponents[True]:.2f} compiled."
    )
    write("step_cost", "Cost of one controller step", head, rows, notes)


if __name__ == "__main__":
    main()
