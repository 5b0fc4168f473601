"""Faults that pass, and a process that is killed: does the panda get over it, and go on after a reset?

`GatedController.for_robot(CompositeController.for_robot(panda))` at 1 kHz from home to the target of the
library, from theta = 0 and without noise. After a safe stop the brakes are opened and the controller is
reset, as a person would.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fault_cases import MOVING, RESTING
from fault_kinds import HOME, ROBOT, TARGET
from fault_runs import ARRIVED, DT, gated
from table import markdown

import eladapt as ea
from eladapt.errors import SimulationError
from eladapt.records.metrics import largest_speed
from eladapt.records.state_file import StateWriter
from eladapt.robot.protocols import Plant
from eladapt.simulation.faults import BlockedJoints, FrozenSensor, Jitter, LostNumbers, Packets, WeakMotors
from eladapt.simulation.instruments import Delay

SAVED, RESTART = 50, 100  # steps between two saved states; steps until a killed process runs again


class Case(NamedTuple):
    """A fault, when it begins, and the plant that has it."""

    name: str
    begins: float  # [s]
    plant: Callable[[], Plant]
    duration: float = 4.0


class Outcome(NamedTuple):
    """What became of it."""

    inside: bool  # torque finite, within the URDF's limits
    samples: str
    fastest: float  # largest share of a joint's speed limit
    furthest: float  # [rad] largest distance of a joint from the set-point after the fault began
    said: str
    time: str


def arm(**options: Any) -> ea.PinocchioPlant:
    return ea.PinocchioPlant(ROBOT, HOME, **options)


def cases() -> list[Case]:
    """Every fault; one that ends does so while the run goes on."""
    load, blocked = ea.Payload(2.0, com=(0.0, 0.0, 0.05), release=RESTING), ["panda_joint4"]

    def lost(span: float) -> Case:
        return Case(
            f"nan for {1e3 * span:g} ms, moving", MOVING, lambda: LostNumbers(arm(), MOVING, MOVING + span)
        )

    def stuck(end: float) -> Callable[[], Plant]:
        return lambda: BlockedJoints(arm(), blocked, start=MOVING, end=end)

    return [
        Case("none", 0.0, arm),
        lost(1e-3), lost(1e-2), lost(1e-1),
        Case("sensor frozen for 100 ms, moving", MOVING, lambda: FrozenSensor(arm(), MOVING, MOVING + 0.1)),
        Case("sensor frozen for 1 s, at rest", RESTING, lambda: FrozenSensor(arm(), RESTING, RESTING + 1)),
        Case("5 % of packets dropped, both ways", 0.0, lambda: Packets(arm(), dropped=0.05)),
        Case("5 % of packets duplicated", 0.0, lambda: Packets(arm(), duplicated=0.05)),
        Case("samples 0.5 to 3 ms apart", 0.0, lambda: Jitter(arm(), 5e-4, 3e-3)),
        Case("2 kg dropped, at rest", RESTING, lambda: arm(payload=load)),
        Case("joint 4 blocked for 0.7 s, moving", MOVING, stuck(1.0)),
        Case("joint 4 blocked for good, moving", MOVING, stuck(np.inf)),
        Case("torque acts 3 ms late, untold", 0.0, lambda: Delay(arm(), 3e-3)),
        Case("torque saturated at 50 %", 0.0, lambda: WeakMotors(arm(), 0.5)),
    ]  # fmt: skip


NAMES = tuple(case.name for case in cases())


def named(name: str) -> Outcome:
    return run(next(case for case in cases() if case.name == name))


def run(case: Case) -> Outcome:
    plant = case.plant()
    steps = round(case.duration / DT) + 1
    try:
        record = ea.simulate(gated(), plant, TARGET, case.duration, DT, theta0="zero", progress=False)
    except SimulationError as reason:
        return Outcome(False, "-", np.inf, np.inf, f"diverged: {reason}", "-")
    outcome = judged(record, case.begins, f"{len(record)} of {steps}")
    state = record.final_state
    if state.fault is not None:
        gone = "nothing to reset for, the fault is still there"
        if "for good" not in case.name and "untold" not in case.name:
            gone = reset(plant, state)
        outcome = outcome._replace(said=f"{outcome.said}; {gone}")
    return outcome


def judged(record: ea.Record, begins: float, samples: str) -> Outcome:
    """Whether the arm came back to its set-point or was stopped, and when."""
    after = record.t >= begins
    error, speed = np.abs(record.error).max(axis=1), np.abs(record.v).max(axis=1)
    finite = all(np.isfinite(array).all() for array in (record.tau, record.q, record.v, record.theta))
    inside = finite and bool(np.all(np.abs(record.tau) <= ROBOT.effort_limit))
    fastest = record.metrics().speed.value
    fault = next(iter(record.faults or ()), None)
    if fault is None:
        away = record.t[after & (error > ARRIVED)]
        back = away[-1] - begins if len(away) else 0.0
        arrived = error[-1] <= ARRIVED
        said, time = (
            ("recovered", f"at the set-point after {back:.2f} s") if arrived else ("**not back**", "-")
        )
    else:
        still = record.t[(record.t > fault.t) & (speed > 1e-2)]
        rest = (still[-1] if len(still) else fault.t) - begins
        said = f'safe stop, "{fault.name}"' if speed[-1] < 1e-2 else "**still moving**"
        time = f"named after {fault.t - begins:.3f} s, at rest after {rest:.2f} s"
    return Outcome(inside, samples, fastest, float(error[after].max()), said, time)


def reset(plant: Plant, state: Any) -> str:
    """The explicit reset, and two seconds more."""
    plant.release()
    measurement = plant.step(state.gate.tau, DT)
    state = gated().reset(state, measurement)
    for _ in range(2000):
        state, tau = gated().step(state, measurement, TARGET, DT)
        measurement = plant.step(tau, DT)
    left = np.abs(ROBOT.difference(TARGET, plant.q)).max()
    done = state.fault is None and left < ARRIVED
    return f"after reset {left:.0e} rad in 2 s" if done else f"**after reset {left:.0e} rad, {state.fault}**"


def control(pipe: Connection, path: Path, resume: bool) -> None:
    """A process of its own: measurements in, torques out, the state on disk every 50 ms."""
    controller = gated()
    writer = StateWriter(controller)
    state = ea.load_state(path, controller) if resume else None
    pipe.send("ready")
    for k in range(10_000):
        measurement = pipe.recv()
        if measurement is None:
            return
        state = controller.init(measurement, "zero") if state is None else state
        state, tau = controller.step(state, measurement, TARGET, DT)
        if k % SAVED == 0:
            writer.write(path, state)
        pipe.send((tau, state.theta, state.fault))


def killed() -> Outcome:
    """SIGKILL in the middle of the move; the robot brakes, as when nobody answers; a new process goes on."""
    path = Path(tempfile.mkdtemp()) / "state.npz"
    context = multiprocessing.get_context("spawn")
    plant = BlockedJoints(arm(), ROBOT.joint_names, start=MOVING, end=MOVING + RESTART * DT)
    measurement, rows, thetas, fault = plant.reset(), [], [], None

    def began(resume: bool) -> tuple[Any, Connection]:
        here, there = context.Pipe()
        process = context.Process(target=control, args=(there, path, resume))
        process.start()
        here.recv()
        return process, here

    process, pipe = began(False)
    for k in range(4001):
        if k == round(MOVING / DT):
            os.kill(process.pid, signal.SIGKILL)
            process.join()
            for _ in range(RESTART):
                measurement = plant.step(np.zeros(ROBOT.nv), DT)
            process, pipe = began(True)
        pipe.send(measurement)
        tau, theta, fault = pipe.recv()
        rows.append((measurement.t, plant.q, plant.v, tau))
        thetas.append(theta)
        measurement = plant.step(tau, DT)
    pipe.send(None)
    process.join()
    t, q, v, torque = (np.array(column) for column in zip(*rows, strict=True))
    before, after = round(MOVING / DT) - 1, round(MOVING / DT)
    error = np.array([np.abs(ROBOT.difference(TARGET, position)).max() for position in q])
    late = t >= MOVING
    away = t[late & (error > ARRIVED)]
    regressors = gated().regressors
    off = [
        np.abs(regressors.gravity(q[i]) @ (thetas[i] - regressors.theta_potential)).max()
        for i in (before, after)
    ]
    said = "recovered" if fault is None and error[-1] < ARRIVED else f"**{fault}**"
    said += f"; gravity off by {off[0]:.2f} N m before, {off[1]:.2f} N m in the first step after"
    finite = np.isfinite(torque).all() and np.isfinite(q).all()
    return Outcome(
        bool(finite and np.all(np.abs(torque) <= ROBOT.effort_limit)), f"{len(rows)} of 4001",
        largest_speed(t, v, ROBOT.velocity_limit, DT, ROBOT.joint_names).value, float(error[late].max()),
        said, f"at the set-point after {away[-1] - MOVING:.2f} s",
    )  # fmt: skip


def section(outcomes: dict[str, Outcome]) -> str:
    """What became of each, in Markdown."""
    rows = [
        [
            name, "yes" if o.inside else "**no**", o.said, o.time, f"{o.furthest:.2f}", f"{o.fastest:.2f}",
            o.samples,
        ]
        for name, o in outcomes.items()
    ]  # fmt: skip
    head = [
        "fault", "torque inside limits", "recovered, or safe stop", "time",
        "largest error after it began [rad]", "largest share of a speed limit", "samples kept",
    ]  # fmt: skip
    notes = (
        f"Faults begin at {MOVING} s in the middle of the move, at {RESTING:g} s at rest, or last from the "
        f"start. At the set-point: every joint within {ARRIVED:g} rad for good. Samples 0.5 to 3 ms apart: "
        "the controller is told 1 ms; a sample further than half of that from 1 ms restarts its filters, so "
        f"it learns more slowly. The process is killed by SIGKILL; the robot brakes for {RESTART} ms until "
        f"another one runs, whose state is up to {SAVED} ms older than the one that was lost."
    )
    return f"## Faults that pass\n\n{markdown(head, rows)}\n{notes}"
