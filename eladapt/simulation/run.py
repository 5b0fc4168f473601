"""Closed-loop runs: a controller, a plant and a goal make a record."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from tqdm import tqdm

from eladapt.errors import EladaptError, SimulationError, require_number
from eladapt.records.record import Record, Recorder
from eladapt.robot.model import Robot
from eladapt.signals import Measurement

Goal = np.ndarray | Callable[[float], np.ndarray]
Observer = Callable[[float, np.ndarray, np.ndarray, Any], object]  # t [s], q, goal, the controller's state


class Controller(Protocol):
    """What `simulate` needs of a controller."""

    def init(self, measurement: Measurement, theta0: Any = None) -> Any: ...
    def step(
        self, state: Any, measurement: Measurement, goal: np.ndarray, dt: float
    ) -> tuple[Any, np.ndarray]: ...


class Plant(Protocol):
    """What `simulate` needs of a plant: the same face for every simulator. q, v: the true state."""

    @property
    def robot(self) -> Robot: ...
    @property
    def q(self) -> np.ndarray: ...
    @property
    def v(self) -> np.ndarray: ...
    def reset(self) -> Measurement: ...
    def step(self, tau: np.ndarray, dt: float) -> Measurement: ...


def simulate(
    controller: Controller,
    plant: Plant,
    goal: Goal,
    duration: float = 5.0,
    dt: float = 1e-3,
    *,
    theta0: Any = None,
    progress: bool = True,
    title: str = "",
    observer: Observer | None = None,
) -> Record:
    """Run the loop for ``duration`` [s] at steps of ``dt`` [s], from the plant's initial state.

    goal: q_d (nq,), or a callable of t [s]. The record has round(duration / dt) + 1 samples, the
    first at t = 0; its tau is what the controller commanded at that sample. Raises
    SimulationError, with the record so far, when controller or plant fail on the way.
    observer: called with (t, q, goal, state) after each step of the controller, as a live view is.
    """
    dt = require_number("dt", dt, 0)
    steps = round(require_number("duration", duration, 0) / dt)
    robot = plant.robot
    goal_at = goal if callable(goal) else (lambda _t: goal)
    recorder = Recorder(robot, controller, dt, steps + 1, title, plant)
    measurement = plant.reset()
    state = controller.init(measurement, theta0)
    bar = tqdm(range(steps + 1), desc=title or robot.name, unit="step", disable=not progress, leave=False)
    try:
        for k in bar:
            target = robot.check_q(np.asarray(goal_at(measurement.t), dtype=float), "goal")
            state, tau = controller.step(state, measurement, target, dt)
            recorder.add(measurement.t, plant.q, plant.v, tau, target, state)
            if observer is not None:
                observer(measurement.t, plant.q, target, state)
            if k < steps:
                measurement = plant.step(tau, dt)
    except EladaptError as reason:
        if recorder.count == 0:
            raise
        message = f"the run ended after {recorder.count} of {steps + 1} samples: {reason}"
        raise SimulationError(message, recorder.record()) from reason
    return recorder.record()
