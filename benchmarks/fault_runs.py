"""Runs a fault of `fault_cases` behind a gate, and judges what the gate did about it."""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from fault_cases import HOME, NONE, REFUSED, ROBOT, Case

import eladapt as ea
from eladapt.errors import ArgumentError, SimulationError
from eladapt.robot.protocols import BareController, Plant
from eladapt.simulation.disturbances import Brakes

DT = 1e-3
ARRIVED, STILL = 2e-3, 0.05  # [rad] of the set-point; [rad/s] of an arm at rest, which noise shakes
LIMIT = 1.1  # of a speed limit, at which the gate says so: it must not for what noise adds
PEAK = 1.3  # of a speed limit, beyond which a row misses
PASSED = 0.01  # [s] from passing that limit until brakes are to be asked for
ROUNDING = 1e-9  # [s] of sums of steps
QUIET = 0.3  # [s] at rest behind brakes, after which nothing more happens
NOISE = ea.Noise(1e-5, 1e-3)
BRAKES = Brakes(1.3 * ROBOT.effort_limit)  # a brake holds against its own motor
ENGINES: dict[str, Callable[..., Any]] = {"Pinocchio": ea.PinocchioPlant, "MuJoCo": ea.MujocoPlant}


class Sample(NamedTuple):
    """What a run is judged by."""

    shares: np.ndarray  # (nv,) of the speed limits
    fault: ea.Fault | None
    brake: bool  # whether brakes are asked for

    @property
    def passes(self) -> bool:
        """Whether a joint is beyond its speed limit."""
        return bool(np.any(self.shares > LIMIT))

    @property
    def moves(self) -> bool:
        """Whether the arm is not at rest."""
        return bool(np.any(self.shares * ROBOT.velocity_limit > STILL))


class Outcome(NamedTuple):
    """What became of a run; times [s] are from when the fault began, nan where it did not come to that."""

    name: str  # of the fault that was named
    after: float
    brakes: float  # when they were asked for
    passed: float  # when a joint passed its speed limit
    peak: float  # largest share of a joint's speed limit from when it began
    rest: float  # from when on the arm was at rest
    arrived: bool  # whether it is at its set-point in the end
    message: str  # the gate's
    joint: str  # with the largest share of its speed limit


@functools.cache
def gated() -> ea.GatedController:
    return ea.GatedController.for_robot(ea.CompositeController.for_robot(ROBOT, DT), DT)


@functools.cache
def controller(jumps: bool) -> BareController:
    return gated() if jumps else ea.Shaped(gated())


def plant_of(case: Case, engine: str) -> Plant:
    options = {"q0": HOME, "noise": NOISE, "brakes": BRAKES, **case.arm}
    return case.kind(ENGINES[engine](ROBOT, **options), case.begins)


def run(case: Case, engine: str, at_limit: bool = False) -> Outcome:
    """The run of a case. at_limit: brakes are told to close PASSED after a joint passed its speed limit,
    whatever the gate asks."""
    plant, stepped = plant_of(case, engine), controller(case.jumps)
    measurement = plant.reset()
    try:
        state = stepped.init(measurement, *(["zero"] if case.jumps else []))
    except ArgumentError as reason:
        return Outcome(REFUSED, 0.0, 0.0, math.nan, 0.0, 0.0, False, str(reason), "-")
    samples: list[Sample] = []
    told = 0  # samples since the brakes were told to close, or the limit was passed
    for k in range(round(case.duration / DT)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            state, tau = stepped.step(state, measurement, case.goal(k * DT), DT)
        samples.append(Sample(np.abs(plant.v) / ROBOT.velocity_limit, state.fault, state.brake))
        told += 1 if told else int(samples[-1].passes if at_limit else state.brake)
        if told > (PASSED / DT if at_limit else 0):
            plant.brake()
        if told > QUIET / DT and not any(sample.moves for sample in samples[-round(QUIET / DT) :]):
            break
        try:
            measurement = plant.step(tau, DT)
        except SimulationError:
            break
    return judged(case, samples, plant.q)


def judged(case: Case, samples: list[Sample], q: np.ndarray) -> Outcome:
    """What the samples of a run show, which ended at q (nq,)."""

    def first(flags: list[bool]) -> float:
        return flags.index(True) * DT - case.begins if True in flags else math.nan

    goal = case.goal(case.duration)
    fault = next((sample.fault for sample in samples if sample.fault), None)
    moves = [k for k, sample in enumerate(samples, 1) if sample.moves]
    last = moves[-1] if moves else 0
    shares = np.array([sample.shares for sample in samples[round(case.begins / DT) :]])
    return Outcome(
        fault.name if fault else NONE,
        first([sample.fault is not None for sample in samples]),
        first([sample.brake for sample in samples]),
        first([sample.passes for sample in samples]),
        float(shares.max()),
        math.nan if last == len(samples) else max(0.0, last * DT - case.begins),
        bool(np.isfinite(goal).all() and np.abs(q - goal).max() < ARRIVED),
        fault.message if fault else "",
        ROBOT.joint_names[int(shares.max(axis=0).argmax())],
    )


def silent(case: Case, outcome: Outcome) -> bool:
    """Whether something is wrong and nothing says so."""
    wrong = NONE not in case.owed.named or outcome.passed < math.inf or not outcome.arrived
    return outcome.name == NONE and wrong and not case.unsaid


def allowed(case: Case, engine: str) -> float:
    """The peak that physics leaves: PEAK, or that of a gate which asks for brakes at the last moment."""
    return max(PEAK, run(case, engine, at_limit=True).peak) if case.faster else PEAK


def misses(case: Case, outcome: Outcome, most: float) -> set[str]:
    """What was owed and not done: "name", "brakes", "peak" (above ``most``), "rest", "silent"."""
    due = min(case.owed.brakes, outcome.passed + PASSED if outcome.passed < math.inf else math.inf)
    found = {
        "name": outcome.name not in case.owed.named or outcome.after < 0,
        "brakes": due < math.inf and not outcome.brakes <= due + ROUNDING,
        "peak": outcome.peak > most,
        "rest": outcome.name != NONE and math.isnan(outcome.rest),
        "silent": silent(case, outcome),
    }
    return {what for what, there in found.items() if there}
